"""A page of cells as a file for download: a Python script, and the executed notebook.

A notebook that was downloaded stands alone: what it links to is the site's, by its address.
"""

import json
import posixpath
import re
from pathlib import Path

PARTS = re.compile(r"^```{code-cell}\n(?::[^\n]*\n)*(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\[([^\]]*)\]\(([^):#\s]+)\.md(#[\w-]*)?\)")
FOOT = re.compile(r"\n---\n+This page as a notebook.*", re.DOTALL)
SHOW = "# %%\nimport matplotlib.pyplot as plt\n\nplt.show()\n"


def script(page):
    """The text of a page as a script: prose in comments, cells as they are, figures shown at the
    end.

    Editors that know the mark ``# %%`` run it cell by cell.
    """
    # without the head, and the line of downloads at the foot
    body = page.split("---\n", 2)[2].split("\n---\n")[0]
    pieces, cells = PARTS.split(body), []
    for i, piece in enumerate(pieces):
        if i % 2:
            cells.append(f"# %%\n{piece}")
        elif piece.strip():
            lines = [f"# {line}".rstrip() for line in piece.strip().splitlines()]
            cells.append("\n".join(["# %% [markdown]", *lines, ""]))
    if any(re.search(r"plot|plt", cell) for cell in pieces[1::2]):
        cells.append(SHOW)
    return "\n".join(cells)


def linked(text, folder, titles, address):
    """Markdown of a page in `folder` with links to the site's `address`; without one their words
    alone.

    `titles` are those of all pages, for links that have no words of their own.
    """

    def link(match):
        page = posixpath.normpath(posixpath.join(folder, match[2]))
        words = match[1] or titles[page]
        return f"[{words}]({address.rstrip('/')}/{page}.html{match[3] or ''})" if address else words

    return LINK.sub(link, text)


def standing_alone(notebook, folder, titles, address):
    """An executed notebook for download: links as in `linked`, no line of downloads, and each
    output once.
    """
    for cell in notebook["cells"]:
        if cell["cell_type"] == "markdown":
            text = FOOT.sub("", "\n" + "".join(cell["source"]))[1:]
            cell["source"] = linked(text, folder, titles, address).splitlines(keepends=True)
        elif cell["cell_type"] == "code":
            kept, last = [], ""
            for output in cell["outputs"]:
                text = "".join(output.get("text", ""))
                # streams that were merged
                if output.get("name") != "stderr" and not (text and last.endswith(text)):
                    kept.append(output)
                    last = text
            cell["outputs"] = kept
    return notebook


def notebooks_for_download(app, env):
    """Before the pages are written: the notebooks of all tutorials, as they are copied for
    download.
    """
    titles = {name: title.astext() for name, title in env.titles.items()}
    folder = Path(env.mystnb_config.output_folder)
    for path in sorted(folder.rglob("*.ipynb")):
        if (page := path.relative_to(folder).with_suffix("").as_posix()) in titles:
            notebook = json.loads(path.read_text(encoding="utf-8"))
            alone = standing_alone(
                notebook, posixpath.dirname(page), titles, app.config.html_baseurl
            )
            path.write_text(
                json.dumps(alone, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
            )

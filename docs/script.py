"""A page of cells as other files: a Python script, and the executed notebook.

    python docs/script.py docs/jupyter_execute [--check]

writes the notebooks of the tutorials that a build of the documentation has executed into
docs/notebooks. With --check it compares them instead, by cells and kinds of outputs.
A notebook for download stands alone: its links go to the site, by its address.
"""

import argparse
import base64
import io
import json
import posixpath
import re
import sys
from pathlib import Path

NOTEBOOKS = Path(__file__).with_name("notebooks")
COLOURS = 48  # of a picture in a committed notebook: curves on white, at a third of the bytes

PARTS = re.compile(r"^```{code-cell}\n(?::[^\n]*\n)*(.*?)^```$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\[([^\]]*)\]\(([^):#\s]+)\.md(#[\w-]*)?\)")
FOOT = re.compile(r"\n---\n+This page as a notebook.*", re.DOTALL)
SHOW = "# %%\nimport matplotlib.pyplot as plt\n\nplt.show()\n"


def script(page):
    """The text of a page as a script: prose in comments, cells as they are, figures shown at the
    end.

    Editors that know the mark ``# %%`` run it cell by cell.
    """
    texts = []
    for kind, source in cells(page):
        if kind == "code":
            texts.append(f"# %%\n{source}\n")
        else:
            lines = [f"# {line}".rstrip() for line in source.splitlines()]
            texts.append("\n".join(["# %% [markdown]", *lines, ""]))
    if any(kind == "code" and re.search(r"plot|plt", source) for kind, source in cells(page)):
        texts.append(SHOW)
    return "\n".join(texts)


def cells(page):
    """The cells of a page in order, as pairs (kind, source): "markdown" or "code"."""
    # without the head, and the line of downloads at the foot
    body = page.split("---\n", 2)[2].split("\n---\n")[0]
    pieces = enumerate(PARTS.split(body))
    pairs = [("code" if i % 2 else "markdown", piece.strip("\n")) for i, piece in pieces]
    return [
        (kind, source.strip() if kind == "markdown" else source)
        for kind, source in pairs
        if source.strip()
    ]


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


def smaller(picture):
    """A PNG in base64 with at most `COLOURS` colours."""
    from PIL import Image  # only where notebooks are written; matplotlib brings it

    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    content = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(content, "PNG", optimize=True)
    return base64.b64encode(content.getvalue()).decode("ascii") + "\n"


def committed(page, executed):
    """The notebook of docs/notebooks: the cells of a page, with the outputs of its execution.

    Identifiers and metadata do not change from build to build, so that a difference is one of
    contents. Links go to the pages, which lie in folders beside.
    """
    results = []
    executions = iter([cell for cell in executed["cells"] if cell["cell_type"] == "code"])
    for number, (kind, source) in enumerate(cells(page)):
        if kind == "markdown":
            # Pages of this folder are notebooks here; all others keep their place.
            source = re.sub(r"\]\((\w+)\.md(?=[#)])", r"](\1.ipynb", source)
        result = {"cell_type": kind, "id": f"cell-{number}", "metadata": {}}
        if kind == "code":
            cell = next(executions)
            for output in cell["outputs"]:
                if "text" in output:
                    # Folders of a page are temporary, and have another name at each build.
                    text = re.sub(r"\S*/tmp\w+/", "", "".join(output["text"]))
                    output["text"] = text.splitlines(keepends=True)
                if "image/png" in output.get("data", {}):
                    output["data"]["image/png"] = smaller(output["data"]["image/png"])
            result |= {"execution_count": cell["execution_count"], "outputs": cell["outputs"]}
        results.append(result | {"source": source.splitlines(keepends=True)})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": results, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def outline(notebook):
    """Cells of a notebook and the kinds of their outputs, without numbers and pictures.

    Streams that follow each other are one: how they are cut depends on the time of printing.
    """
    rows = []
    for cell in notebook["cells"]:
        kinds = []
        for output in cell.get("outputs", ()):
            kind = output["output_type"], sorted(output.get("data", ()))
            if kind[0] != "stream" or not kinds or kinds[-1] != kind:
                kinds.append(kind)
        rows.append(("".join(cell["source"]), kinds))
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("built", type=Path, help="the folder jupyter_execute beside a build")
    parser.add_argument("--check", action="store_true", help="compare, and write nothing")
    options = parser.parse_args()
    stale = []
    for source in sorted(NOTEBOOKS.parent.glob("tutorials/*.md")):
        executed = json.loads(
            (options.built / "tutorials" / f"{source.stem}.ipynb").read_text("utf-8")
        )
        notebook = committed(source.read_text(encoding="utf-8"), executed)
        target = NOTEBOOKS / f"{source.stem}.ipynb"
        if not options.check:
            NOTEBOOKS.mkdir(exist_ok=True)
            target.write_text(
                json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
            )
        elif outline(json.loads(target.read_text(encoding="utf-8"))) != outline(notebook):
            stale.append(target.name)
    if stale:
        sys.exit(
            f"notebooks must be those of the pages; {', '.join(stale)} are not. Write them anew."
        )


if __name__ == "__main__":
    main()

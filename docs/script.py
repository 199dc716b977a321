"""A page of cells as a Python script, and the role that offers it for download: {script-download}`name.py`."""

import os
import re
from pathlib import Path

from docutils import nodes
from sphinx.addnodes import download_reference
from sphinx.util.docutils import ReferenceRole

PARTS = re.compile(r"^```{code-cell}\n(?::[^\n]*\n)*(.*?)^```$", re.DOTALL | re.MULTILINE)
SHOW = "# %%\nimport matplotlib.pyplot as plt\n\nplt.show()\n"


def script(page):
    """The text of a page as a script: prose in comments, cells as they are, figures shown at the end.

    Editors that know the mark ``# %%`` run it cell by cell.
    """
    body = page.split("---\n", 2)[2].split("\n---\n")[0]  # without the head, and the line of downloads at the foot
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


class ScriptDownload(ReferenceRole):
    """Write the page that holds the role as a script beside its executed notebook, and link to it."""

    def run(self):
        target = Path(self.env.mystnb_config.output_folder, *self.env.docname.split("/")[:-1], self.target)
        target.parent.mkdir(parents=True, exist_ok=True)
        page = Path(self.env.doc2path(self.env.docname)).read_text(encoding="utf-8")
        target.write_text(script(page), encoding="utf-8")
        node = download_reference(self.rawtext, reftarget="/" + os.path.relpath(target, self.env.srcdir))
        self.set_source_info(node)
        node += nodes.literal(self.rawtext, self.target, classes=["xref", "download"])
        return [node], []

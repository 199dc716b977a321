"""Sphinx configuration: pages in MyST, the tutorial executed when it is built, offline."""

import os
import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # figures appear below their cell

project = "onepulse"
author = "The onepulse authors"
copyright = "2026, the onepulse authors"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["dollarmath", "amsmath"]
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
napoleon_google_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
html_theme = "furo"
html_title = "onepulse"
exclude_patterns = ["_build", "jupyter_execute"]
html_math_renderer = "mathml"


def setup(app):
    """Formulas as MathML, which browsers draw by themselves: the pages need no network."""

    def inline(self, node):
        self.body.append(convert(node.astext()))
        raise nodes.SkipNode

    def display(self, node):
        self.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
        raise nodes.SkipNode

    app.add_html_math_renderer("mathml", (inline, None), (display, None))

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
napoleon_use_ivar = True  # attributes are read, not linked to: many classes have an f and an n
autodoc_member_order = "bysource"
autodoc_typehints = "none"
html_theme = "furo"
html_title = "onepulse"
html_static_path = ["static"]
html_css_files = ["formula.css"]
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

    def source_first(app, what, name, obj, options, lines):
        """Move a closing "Source: ..." above the sections, where it is a sentence and not a parameter."""
        starts = [i for i, line in enumerate(lines) if line.startswith("Source:")]
        sections = [i for i, line in enumerate(lines) if i and line and set(line) == {"-"}]
        if starts and sections and starts[-1] > sections[0]:
            source = lines[starts[-1] :]
            del lines[starts[-1] :]
            lines[sections[0] - 1 : sections[0] - 1] = [*source, ""]

    app.connect("autodoc-process-docstring", source_first, priority=100)
    app.add_html_math_renderer("mathml", (inline, None), (display, None))

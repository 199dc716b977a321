"""Sphinx configuration: pages in MyST, executed when they are built, offline; a page of the API
per public name.
"""

import importlib
import inspect
import os
import re
import sys
from pathlib import Path

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.addnodes import download_reference
from sphinx.util.docutils import ReferenceRole

sys.path[:0] = [str(Path(__file__).resolve().parent.parent), str(Path(__file__).resolve().parent)]
# figures appear below their cell
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"
# what a cell draws itself looks like the library's figures
os.environ["MATPLOTLIBRC"] = str(Path(__file__).with_name("matplotlibrc"))

script = importlib.import_module("script")  # docs/script.py, which the line above lets Python find

project = "onepulse"
author = "The onepulse authors"
copyright = "2026, the onepulse authors"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence", "dollarmath", "amsmath"]
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "remove"  # warnings are printed where a page is about them
napoleon_google_docstring = False
napoleon_use_param = False  # parameters that share a line share its words
napoleon_use_ivar = True  # attributes are read, not linked to: many classes have an f and an n
autodoc_member_order = "bysource"
autodoc_typehints = "none"
# an example of the reference is copied without its output
copybutton_exclude = ".linenos, .gp, .go"
templates_path = ["templates"]
html_theme = "furo"
html_title = "onepulse"
html_baseurl = os.environ.get("READTHEDOCS_CANONICAL_URL", "")  # what downloaded notebooks link to
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_extra_path = ["llms.txt"]  # at the root of the site, where assistants look for it
exclude_patterns = ["_build", "jupyter_execute", "notebooks", "templates"]
html_math_renderer = "mathml"


def parts(thing):
    """Public methods and properties of a class of ours, its bases' included, for its page."""
    ours = {}
    for base in reversed(thing.__mro__):
        if base.__module__.split(".")[0] in ("plant", "identification", "ctc"):
            ours |= {
                key: value
                for key, value in vars(base).items()
                if not key.startswith("_") and inspect.getdoc(value)
            }
    callable_ones = (classmethod, staticmethod)
    methods = [
        key
        for key, value in ours.items()
        if inspect.isfunction(value) or isinstance(value, callable_ones)
    ]
    return sorted(methods), sorted(
        key for key, value in ours.items() if isinstance(value, property)
    )


PACKAGES = [importlib.import_module(package) for package in ("plant", "identification", "ctc")]
PUBLIC = {
    f"{package.__name__}.{name}": getattr(package, name)
    for package in PACKAGES
    for name in package.__all__
}
PAGE = Path(__file__).with_name("reference") / "api.md"
# what functions return
for place in re.findall(r"^   ~([\w.]+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE):
    PUBLIC[place] = getattr(
        importlib.import_module(place.rpartition(".")[0]), place.rpartition(".")[2]
    )
autosummary_context = {
    "parts": {name: parts(thing) for name, thing in PUBLIC.items() if inspect.isclass(thing)}
}
# names that differ in capitals alone would be one file on some machines
autosummary_filename_map = {
    f"{package.__name__}.{name}": f"{package.__name__}.{name}-function"
    for package in PACKAGES
    for name in package.__all__
    if name.islower() and any(name != other and name == other.lower() for other in package.__all__)
}


class ScriptDownload(ReferenceRole):
    """{script-download}`name.py`: write the page as a script beside its executed notebook, and
    link to it.
    """

    def run(self):
        target = Path(
            self.env.mystnb_config.output_folder, *self.env.docname.split("/")[:-1], self.target
        )
        target.parent.mkdir(parents=True, exist_ok=True)
        page = Path(self.env.doc2path(self.env.docname)).read_text(encoding="utf-8")
        target.write_text(script.script(page), encoding="utf-8")
        node = download_reference(
            self.rawtext, reftarget="/" + os.path.relpath(target, self.env.srcdir)
        )
        self.set_source_info(node)
        node += nodes.literal(self.rawtext, self.target, classes=["xref", "download"])
        return [node], []


def setup(app):
    """Formulas as MathML, which browsers draw by themselves: the pages need no network."""

    def inline(self, node):
        self.body.append(convert(node.astext()))
        raise nodes.SkipNode

    def display(self, node):
        self.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
        raise nodes.SkipNode

    def source_first(app, what, name, obj, options, lines):
        """Move a closing "Source: ..." above the sections, where it is a sentence and not a
        parameter.
        """
        starts = [i for i, line in enumerate(lines) if line.startswith("Source:")]
        sections = [i for i, line in enumerate(lines) if i and line and set(line) == {"-"}]
        if starts and sections and starts[-1] > sections[0]:
            source = lines[starts[-1] :]
            del lines[starts[-1] :]
            lines[sections[0] - 1 : sections[0] - 1] = [*source, ""]

    app.connect("autodoc-process-docstring", source_first, priority=100)
    app.add_role("script-download", ScriptDownload())
    app.connect("env-updated", script.notebooks_for_download)
    app.add_html_math_renderer("mathml", (inline, None), (display, None))

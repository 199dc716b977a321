"""The example of every public name: it is there, it runs as it is printed, and what it refers to
is public.
"""

import doctest
import importlib
import inspect
import re

import pytest

import ctc
import identification
import plant

NAMES = [
    f"{package.__name__}.{name}"
    for package in (plant, identification, ctc)
    for name in package.__all__
]
OPTIONS = doctest.NORMALIZE_WHITESPACE | doctest.REPORT_ONLY_FIRST_FAILURE


def documented(name):
    """What a dotted public name stands for, and the docstrings of it and of its public members."""
    package, _, attribute = name.partition(".")
    thing = getattr(importlib.import_module(package), attribute)
    texts = {name: inspect.getdoc(thing) or ""}
    if inspect.isclass(thing):
        members = {key: value for key, value in vars(thing).items() if not key.startswith("_")}
        texts |= {f"{name}.{key}": inspect.getdoc(value) or "" for key, value in members.items()}
    return thing, texts


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.filterwarnings("ignore::identification.IdentificationWarning")
def test_the_example_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    thing, texts = documented(name)
    assert inspect.ismodule(thing) or ">>>" in texts[name]
    for place, text in texts.items():
        said = []
        test = doctest.DocTestParser().get_doctest(text, {"__name__": "__main__"}, place, None, 0)
        failed, _ = doctest.DocTestRunner(optionflags=OPTIONS, verbose=False).run(
            test, out=said.append
        )
        assert not failed, "".join(said)


@pytest.mark.parametrize("name", NAMES)
def test_what_the_example_refers_to_is_public(name):
    thing, texts = documented(name)
    section = re.search(r"^See Also\n-+\n((?:\S.*\n?)+)", texts[name], re.MULTILINE)
    assert inspect.ismodule(thing) or section
    for other in re.findall(r"[\w.]+", section[1] if section else ""):
        assert other in NAMES
        assert other != name

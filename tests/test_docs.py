"""README and docs: code that runs, links and files that are there, every public name in the
reference.
"""

import ast
import importlib
import importlib.util
import json
import re
import shlex
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import ctc
import identification
import plant

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]


def blocks(page):
    return re.findall(
        r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


def test_the_code_of_the_architecture_page_runs():
    code = "\n".join(blocks(ROOT / "docs" / "architecture.md"))
    space = {"__name__": "page"}
    exec(code, space)  # noqa: S102 - our own page
    record = space["record"]
    assert abs(record.error_pulses).max() > 0
    np.testing.assert_allclose(space["stepped"], record.torque, rtol=1e-12, atol=1e-12)  # rounding
    assert (Path(space["folder"]) / "controller.c").stat().st_size > 0


def test_the_readme_s_code_runs_and_keeps_its_promise(capsys):
    names = {}
    for block in blocks(ROOT / "README.md"):
        exec(block, names)  # noqa: S102 - our own page
    assert capsys.readouterr().out.endswith("True\n")
    assert max(abs(names["log"].error_pulses).max(axis=0)) == 10
    assert max(names["report"].max_error_pulses) == 1


def test_the_readme_is_read_in_a_minute():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 600
    (code,) = blocks(ROOT / "README.md")
    assert len([line for line in code.splitlines() if line.strip()]) == 9
    (picture,) = re.findall(r'<img src="([^"]+)" alt="[^"]+" width="\d+">', text)
    assert (ROOT / picture).stat().st_size <= 600_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_files_are_there(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[\w-]*)?\)", text):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"
    # Pictures of directives, whose options stand one a line.
    pictures = re.findall(r"^(?::img-top:|```{figure}) (\S+)$", text, re.MULTILINE)
    assert len(pictures) == text.count(":img-top:") + text.count("{figure}")
    assert all((page.parent / picture).exists() for picture in pictures)
    for path in re.findall(
        r"`((?:tests|examples|docs|plant|identification|ctc|\.ci)/[\w./]*\w)`", text
    ):
        assert (ROOT / path).exists(), f"{page.name}: {path}"
    for path in re.findall(r"(?:python|bash) ((?:tests|examples|docs|\.ci)/[\w./]*\w)", text):
        assert (ROOT / path).exists(), f"{page.name}: {path}"


@pytest.mark.parametrize(
    "package", [plant, identification, ctc], ids=lambda package: package.__name__
)
def test_every_public_name_is_in_the_reference(package):
    page = "".join(
        (ROOT / "docs/reference" / name).read_text(encoding="utf-8")
        for name in ("api.md", "robots.md")
    )
    listed = re.findall(
        rf"^(?:\.\. automodule::|  ) {package.__name__}\.(\w+)$", page, re.MULTILINE
    )
    assert sorted(listed) == sorted(package.__all__)


def test_what_pages_import_is_public():
    """A user's script never names a room."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        code = blocks(page) + re.findall(
            r"^```{code-cell}\n(.*?)^```", text, re.DOTALL | re.MULTILINE
        )
        for block in code:
            for line in re.findall(
                r"^(?:from|import) (?:plant|identification|ctc)\b.*$", block, re.MULTILINE
            ):
                module = re.match(r"(?:from|import) ([\w.]+)", line)[1]
                assert "." not in module, f"{page.name}: {line}"
    for script in (ROOT / "examples").glob("*.py"):
        for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in (
                "plant",
                "identification",
                "ctc",
            ):
                assert "." not in node.module, f"{script.name}: {node.module}"


def test_what_assistants_read_names_what_is_public_and_pages_that_are_there():
    text = (ROOT / "docs" / "llms.txt").read_text(encoding="utf-8")
    section = text.split("## Ten names\n")[1].split("\n## ")[0]
    assert len(re.findall("^- ", section, re.MULTILINE)) == 10
    for package, name in re.findall(r"\b(plant|identification|ctc)\.(\w+)", text):
        assert name in importlib.import_module(package).__all__, name
    for page in re.findall(r"^- ([\w/]+)\.html", text, re.MULTILINE):
        assert (ROOT / "docs" / f"{page}.md").exists(), page


def test_the_picture_shows_every_room():
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        import house
    finally:
        sys.path.pop(0)
    for package, rows in house.floors().items():
        folders = {
            path.name
            for path in (ROOT / package).iterdir()
            if path.is_dir() and path.name != "__pycache__"
        }
        assert folders <= {room for row in rows for room in row}
        assert all(house.sentence(package, room) for row in rows for room in row)


EXECUTED_BY_TESTS = {"docs/architecture.md", "README.md"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_of_a_page_is_executed_when_the_page_is_built(page):
    text, name = page.read_text(encoding="utf-8"), str(page.relative_to(ROOT))
    assert not blocks(page) or name in EXECUTED_BY_TESTS
    assert ("{code-cell}" in text) == text.startswith("---\nfile_format: mystnb\n")


def test_the_contents_name_every_page():
    index = set((ROOT / "docs" / "index.md").read_text(encoding="utf-8").splitlines())
    pages = {
        page.relative_to(ROOT / "docs").with_suffix("").as_posix()
        for page in PAGES
        if "docs" in page.relative_to(ROOT).parts
    }
    assert pages - index == {"index"}


def test_the_front_page_is_found_by_the_words_of_the_field():
    text = (ROOT / "docs" / "index.md").read_text(encoding="utf-8").lower()
    words = """inverse dynamics, gravity compensation, inertial parameters, friction identification,
        feed-forward, disturbance observer, hand guiding"""
    for word in words.split(","):
        assert word.strip() in text, word
    for door in ("Simulate", "Identify", "Control", "Verify"):
        assert f"{{grid-item-card}} {door.lower()}\n" in text, door


def test_every_tutorial_can_be_downloaded():
    for page in sorted((ROOT / "docs" / "tutorials").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        assert f"{{nb-download}}`{page.stem}.ipynb`" in text
        assert f"{{script-download}}`{page.stem}.py`" in text
        # How long it takes, and what one has then, before anything else.
        assert re.search(
            r"^# .+\n\n\*Time: \d+ minutes,.* Result: ", text, re.MULTILINE | re.DOTALL
        )


def test_the_script_of_a_tutorial_holds_its_cells_and_its_prose(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    script = importlib.import_module("script").script
    for page in sorted((ROOT / "docs" / "tutorials").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        cells = re.findall(
            r"^```{code-cell}\n(?::[^\n]*\n)*(.*?)^```", text, re.DOTALL | re.MULTILINE
        )
        given, expected = script(text), ast.parse("\n".join(cells)).body
        shown = 2 if "plt.show()" in given else 0
        assert ast.dump(ast.Module(ast.parse(given).body[: len(expected)], [])) == ast.dump(
            ast.Module(expected, [])
        )
        assert len(ast.parse(given).body) == len(expected) + shown
        assert re.search(r"^# # .+", given, re.MULTILINE)
        assert "-download}" not in given
        assert "file_format" not in given
    plain = (
        "---\nfile_format: mystnb\n---\n\n# A\n\nText.\n\n```{code-cell}\n:tags: [x]\na ="
        " 1\n```\n\n---\n\nfoot\n"
    )
    assert script(plain) == "# %% [markdown]\n# # A\n#\n# Text.\n\n# %%\na = 1\n"


def test_a_downloaded_notebook_stands_alone(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    standing_alone = importlib.import_module("script").standing_alone
    source = (
        "See [the\nchecks](../guides/check.md#a-1), [](own_log.md),"
        " [numba](https://numba.org/a.md).\n"
    )
    foot = "\n---\n\nThis page as a notebook, {nb-download}`a.ipynb`, and more."
    streams = [{"name": "stdout", "text": ["a\n", "b\n"]}, {"name": "stdout", "text": "b\n"}]
    streams += [{"name": "stderr", "text": "w"}, {"data": {}}, {"name": "stdout", "text": "b\n"}]
    for address, text in (
        ("", "See the\nchecks, Logs, [numba](https://numba.org/a.md).\n"),
        (
            "https://x.org/en/",
            (
                "See [the\nchecks](https://x.org/en/guides/check.html#a-1),"
                " [Logs](https://x.org/en/tutorials/own_log.html),"
                " [numba](https://numba.org/a.md).\n"
            ),
        ),
    ):
        cells = [{"cell_type": "markdown", "source": (source + foot).splitlines(keepends=True)}]
        cells += [{"cell_type": "code", "source": "", "outputs": list(streams)}]
        first, second = standing_alone(
            {"cells": cells}, "tutorials", {"tutorials/own_log": "Logs"}, address
        )["cells"]
        assert "".join(first["source"]) == text
        assert second["outputs"] == [streams[0], streams[3], streams[4]]


def test_committed_notebooks_are_the_tutorials_executed(monkeypatch):
    """CI executes the pages, and compares outputs by kind: docs/script.py --check."""
    nbformat = pytest.importorskip("nbformat")
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    script = importlib.import_module("script")
    pages = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
    notebooks = sorted((ROOT / "docs" / "notebooks").glob("*"))
    assert [path.name for path in notebooks] == [f"{page.stem}.ipynb" for page in pages]
    for page, path in zip(pages, notebooks, strict=True):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        nbformat.validate(nbformat.from_dict(notebook))
        code = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
        expected = script.committed(page.read_text(encoding="utf-8"), {"cells": code})
        sources = [cell["source"] for cell in expected["cells"]]
        assert [cell["source"] for cell in notebook["cells"]] == sources, path.name
        assert [cell["execution_count"] for cell in code] == list(range(1, len(code) + 1))
        outputs = [output for cell in code for output in cell["outputs"]]
        assert outputs
        assert all(output["output_type"] != "error" for output in outputs)
        assert path.stat().st_size < 300_000, path.name
        for cell in notebook["cells"]:
            for target in re.findall(r"\]\(([^)#\s]+)", "".join(cell["source"])):
                assert "://" in target or (path.parent / target).exists(), f"{path.name}: {target}"


def commands(page):
    """Commands of a page as words: its blocks of the shell, and what stands between backticks."""
    text = page.read_text(encoding="utf-8")
    lines = re.findall(r"`((?:python3?|onepulse|pip|bash) [^`]+)`", text)
    for block in re.findall(r"^```(?:sh|text)\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        if not re.match(r"\w+ +\w+ \+", block):  # a table of the packages is no command
            lines += block.splitlines()
    for line in lines:
        for command in re.split(r" && ", " ".join(line.split())):
            if words := shlex.split(command, comments=True):
                yield words


TESTED_ELSEWHERE = {
    "make": "tests/plant/realtime/test_c_target.py",
    "./controller": "tests/plant/realtime/test_c_export.py",
    "cmake": "tests/plant/realtime/test_c_target.py",
}
"""Programs of exported C, and the test that calls them."""

NEEDS = {
    "colcon": "On the machine that runs ROS 2",
    "source": "On the machine that runs ROS 2",
    "ros2": "On the machine that runs ROS 2",
    "python3": "With Python 3.11 or newer",
    ".venv/bin/pip": "With Python 3.11 or newer",
    ".venv/bin/python": "With Python 3.11 or newer",
}
"""Programs of another machine or environment, and the words by which a page says so."""


def extras_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project["optional-dependencies"]


def packages_of(extras):
    """Names of the packages that some extras install."""
    return {re.split(r"[ >\[;]", line)[0] for lines in extras.values() for line in lines}


def problem_of(words, text):
    """Why a command of a page cannot run; None where it can."""
    program, arguments = Path(words[0]).name, words[1:]
    options = [word.split("=")[0] for word in arguments if word.startswith("--")]
    if words[0] in NEEDS:
        return None if NEEDS[words[0]] in text else "the page must say where this runs"
    if words[0] in TESTED_ELSEWHERE:
        tested = (ROOT / TESTED_ELSEWHERE[words[0]]).read_text(encoding="utf-8")
        return None if words[0].removeprefix("./") in tested else "no test runs it"
    if program == "pip":
        extras = extras_of_the_project()
        wanted = re.search(r"(?:onepulse|\.)\[(.+)\]", arguments[-1])
        # Jupyter opens the notebooks; nothing of the project needs it.
        packages = {"jupyterlab"} | packages_of(extras)
        is_known = set(wanted[1].split(",")) <= set(extras) if wanted else arguments[-1] in packages
        return None if is_known else "no such extra"
    if program == "onepulse":
        parser = importlib.import_module("ctc.commandline.main").command_parser()
        if arguments[:1] == ["COMMAND"] or (len(arguments) == 1 and arguments[0] in text):
            arguments = ["robots"]  # the page is about the command as such
        try:
            parser.parse_args(arguments)
        except SystemExit as end:
            return f"status {end.code}"
        return None
    if arguments[0] == "-m":
        # The extra of the documentation need not be installed where the tests run.
        is_known = arguments[1] in packages_of(extras_of_the_project())
        return None if is_known or importlib.util.find_spec(arguments[1]) else "no such module"
    file = ROOT / arguments[0]
    if not file.exists():
        return "no such file"
    source = file.read_text(encoding="utf-8")
    # A script may leave its options to another of its folder.
    for name in re.findall(r"^(?:import|from) (\w+)", source, re.MULTILINE):
        if (file.parent / f"{name}.py").exists():
            source += (file.parent / f"{name}.py").read_text(encoding="utf-8")
    missing = [option for option in options if f'"{option}"' not in source]
    return f"no option {missing}" if missing else None


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_a_page_run_or_it_says_where(page):
    text = page.read_text(encoding="utf-8")
    problems = [(" ".join(words), problem_of(words, text)) for words in commands(page)]
    assert not [problem for problem in problems if problem[1]]


def test_a_command_that_cannot_run_is_a_problem():
    for command in (
        "python tests/benchmarks/absent.py",
        "python tests/benchmarks/certify.py --absent",
        "python -m absent_module",
        "onepulse certify found.json --absent",
        "onepulse absent",
        "pip install onepulse[absent]",
        "colcon build",
    ):
        assert problem_of(shlex.split(command), ""), command

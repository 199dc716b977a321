"""The shape of the project: who imports whom, one home per equation, and what no source may
contain.
"""

import ast
import importlib
import inspect
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("plant", "identification", "ctc")
SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in SOURCES
    if path.name != "__main__.py"
)


def run(*command, path=(ROOT,), cwd=ROOT):
    """Run a command with these folders first on Python's path, and hand back what it said."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(str(p) for p in path)}
    return subprocess.run(  # noqa: S603 - the commands are those below
        [str(part) for part in command],
        env=environment,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )


def python(code, **options):
    return run(sys.executable, "-c", code, **options)


def tool(name):
    """A command line tool of this environment."""
    path = Path(sys.executable).with_name(name)
    if not path.exists():
        pytest.skip(f"{name} is not installed")
    return path


# -- imports -------------------------------------------------------------------------------------
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
    "contracts"
]


def test_imports_go_one_way():
    said = run(tool("lint-imports"), "--no-cache")
    assert said.returncode == 0, said.stdout
    assert f"{len(CONTRACTS)} kept, 0 broken" in said.stdout


BREACHES = {  # contract -> a line that breaks it, and where
    "imports go one way": ("plant/mechanics/arm.py", "import ctc"),
    # a late one counts too
    "the rooms of plant": ("plant/machine/rig.py", "    import plant.simulation.simulator"),
    "the rooms of identification": (
        "identification/replay/timing.py",
        "import identification.procedure",
    ),
    "the rooms of ctc": ("ctc/laws/observer.py", "from ctc.verdict import evaluation"),
    "no file imports itself": ("plant/mechanics/link.py", "import plant.mechanics.chain"),
    "the genetic algorithm": ("identification/search/genetic.py", "import plant"),
    "the compiler": ("plant/compiler/llvm.py", "import plant.mechanics.arm"),
}


def test_import_linter_sees_every_breach(tmp_path):
    """No contract is an ornament: each is broken once."""
    for package in PACKAGES:
        shutil.copytree(
            ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__")
        )
    for path, line in BREACHES.values():
        with open(tmp_path / path, "a", encoding="utf-8") as file:
            file.write(f"\n\ndef breach():\n{line}\n" if line.startswith(" ") else f"\n{line}\n")
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    said = run(tool("lint-imports"), "--no-cache", path=(tmp_path,), cwd=tmp_path)
    assert said.returncode != 0
    for contract in CONTRACTS:
        assert any(contract["name"].startswith(begin) for begin in BREACHES), contract["name"]
        assert re.search(re.escape(contract["name"]) + r"\s+BROKEN", said.stdout), said.stdout


LATE = {  # slow library -> what it costs beside numba and casadi, and who needs it
    "control": "1.1 s: linear analysis and design",
    "distributed": "an extra: a campaign on a Dask cluster",
    "matplotlib": "0.3 s: figures",
    "pyarrow": "an extra: a fleet as Parquet",
    "scipy.interpolate": "0.3 s: splines as references, scaled and fastest paths",
    "scipy.linalg": "0.1 s: dynamics; logs are read and checked without",
    "scipy.optimize": "0.3 s: the nearest physical arm",
    "scipy.signal": "0.6 s: filters, which the genetic algorithm does without",
    "scipy.special": "0.3 s: quantiles, for which no command has to wait before it says its help",
    "scipy.stats": "0.5 s: Sobol poses, where D depends on several joints",
    "xacro": "an extra, with xacrodoc: expands xacro",
    "xacrodoc": "an extra: finds the packages of xacro",
}

LOGS = ROOT / "plant" / "logs"
CHILD = {LOGS / "child.py", *(LOGS / "formats").glob("*.py")}
"""A child process, which imports a reader of files only after it has limited its own memory and
time.
"""


def late_imports(tree):
    """Imports anywhere but in the body of the module, there also for types alone or for one
    system: (line, module).
    """
    tests = ("TYPE_CHECKING", "sys.platform != 'win32'")
    chosen = [
        each for each in tree.body if isinstance(each, ast.If) and ast.unparse(each.test) in tests
    ]
    early = [*tree.body, *(each for block in chosen for each in block.body)]
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)) and node not in early:
            names = (
                node.names
                if isinstance(node, ast.Import)
                else [ast.alias("." * node.level + (node.module or ""))]
            )
            yield from ((node.lineno, alias.name) for alias in names)
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in (
            "__import__",
            "import_module",
        ):
            yield node.lineno, ast.unparse(node)


def slow(name):
    """The slow library to which a module belongs, or None."""
    return next((library for library in LATE if f"{name}.".startswith(f"{library}.")), None)


def test_only_slow_libraries_are_imported_late():
    late = [(path.relative_to(ROOT).as_posix(), *found) for path in SOURCES if path not in CHILD
            for found in late_imports(ast.parse(path.read_text(encoding="utf-8")))]  # fmt: skip
    assert [each for each in late if slow(each[-1]) is None] == []
    assert {slow(name) for *_, name in late} == set(LATE)


def test_the_scan_finds_late_imports():
    code = (
        "import a\nfrom b import c\ndef f():\n    import scipy, scipy.stats.qmc as q\n    from ."
        " import d\nclass C:\n    from matplotlib import pyplot\nif a:\n    import e\ntry:\n   "
        " async def g():\n        from controls import h\nfinally:\n   "
        " importlib.import_module('i')\n__import__('j')\nif TYPE_CHECKING:\n    import k\n"
    )
    found = sorted(late_imports(ast.parse(code)))
    names = [
        "scipy",
        "scipy.stats.qmc",
        ".",
        "matplotlib",
        "e",
        "controls",
        "importlib.import_module('i')",
    ]
    assert [name for _, name in found] == [*names, "__import__('j')"]
    assert [slow(name) for name in names] == [
        None,
        "scipy.stats",
        None,
        "matplotlib",
        None,
        None,
        None,
    ]


def test_importing_loads_no_slow_library():
    said = python(
        f"import sys, plant, identification, ctc\nprint([name for name in {list(LATE)} if name in"
        " sys.modules])"
    )
    assert said.stdout.strip() == "[]", said.stderr


@pytest.mark.parametrize(
    ("wanted", "foreign"),
    [
        ("plant", "ctc"),
        ("plant", "identification"),
        ("identification", "plant"),
        ("identification", "ctc"),
        ("ctc", "plant"),
        ("ctc", "identification"),
    ],
)
def test_a_foreign_sibling_is_refused_in_one_line(tmp_path, wanted, foreign):
    """Other distributions called `ctc` and `plant` exist; one earlier on the path would be
    imported instead.
    """
    (tmp_path / foreign).mkdir()
    (tmp_path / foreign / "__init__.py").write_text("")
    said = python(f"import {wanted}", path=(tmp_path, ROOT), cwd=tmp_path)
    assert said.returncode != 0
    last = said.stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError: ")
    assert str(tmp_path / foreign) in last
    assert str(ROOT) in last
    assert f"'{foreign}'" in last


def test_siblings_in_place_are_accepted_from_any_folder(tmp_path):
    said = python("import ctc, identification, plant; print(plant.__file__)", cwd=tmp_path)
    assert said.stdout.strip() == str(ROOT / "plant" / "__init__.py"), said.stderr


# -- what no source may contain ------------------------------------------------------------------
def breaches(tree):
    """What a syntax tree has that it should not: (line, what)."""
    banned = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.lineno, "assert"
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ("eval", "exec")
        ):
            yield node.lineno, node.func.id
        elif isinstance(node, ast.Import):
            yield from (
                (node.lineno, alias.name)
                for alias in node.names
                if alias.name.split(".")[0] in banned
            )
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] in banned:
                yield node.lineno, node.module
            yield from ((node.lineno, "import *") for alias in node.names if alias.name == "*")
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle":
            yield node.value.lineno, "allow_pickle"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_assert_pickle_eval_or_star_import(path):
    assert list(breaches(ast.parse(path.read_text(encoding="utf-8")))) == []


def test_the_scan_finds_what_it_looks_for():
    code = (
        "import pickle\nfrom joblib import dump\nassert 1\neval('1')\nexec('1')\n"
        "np.load('x', allow_pickle=True)\nfrom plant import *\n"
    )
    found = [what for _, what in sorted(breaches(ast.parse(code)))]
    assert found == ["pickle", "joblib", "assert", "eval", "exec", "allow_pickle", "import *"]


# -- documentation -------------------------------------------------------------------------------
@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_listed_and_documented(package):
    module = importlib.import_module(package)
    assert module.__doc__
    assert sorted(module.__all__) == sorted(set(module.__all__))
    for name in module.__all__:
        thing = getattr(module, name)
        assert inspect.getdoc(thing), f"{package}.{name} has no docstring"


@pytest.mark.parametrize("name", MODULES)
def test_every_file_and_what_is_public_in_it_is_documented(name):
    module = importlib.import_module(name)
    assert module.__doc__, name
    for public, thing in vars(module).items():
        if (
            (inspect.isclass(thing) or inspect.isfunction(thing))
            and thing.__module__ == name
            and public[0] != "_"
        ):
            # A dataclass without a docstring gets its signature; that does not count.
            assert thing.__doc__, f"{name}.{public}"
            assert not thing.__doc__.startswith(f"{public}("), f"{name}.{public}"


HOME = re.compile(r"Source: paper(?:\s[^\n\"]*?)?\seq\.\s((?:\(\d+\)(?:,\s)?)+)")


def homes():
    """Equation number -> files whose docstrings say that it comes from there."""
    found = {}
    for path in SOURCES:
        for match in HOME.finditer(path.read_text(encoding="utf-8")):
            for number in re.findall(r"\((\d+)\)", match[1]):
                found.setdefault(int(number), set()).add(path.relative_to(ROOT).as_posix())
    return found


def listed():
    """Equation number -> names of what holds it, from docs/reference/equations.md."""
    rows = {}
    for line in (
        (ROOT / "docs" / "reference" / "equations.md").read_text(encoding="utf-8").splitlines()
    ):
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if re.fullmatch(r"\(\d+\)", cells[0]):
            rows[int(cells[0][1:-1])] = re.findall(r"`([\w.]+)`", cells[2])
    return rows


def resolve(name):
    """File and object of a dotted name."""
    module = name
    while not (ROOT / f"{module.replace('.', '/')}.py").is_file():
        module = module.rpartition(".")[0]
        assert module, f"{name} is in no file"
    thing = importlib.import_module(module)
    for attribute in name[len(module) + 1 :].split("."):
        thing = inspect.getattr_static(thing, attribute)
    return f"{module.replace('.', '/')}.py", thing


def test_every_equation_has_one_home_and_the_list_says_which():
    assert set(listed()) == set(homes()) == {1, 2, 3, 4, 5, 6}
    for number, names in listed().items():
        assert names, f"({number}) has no place"
        assert {resolve(name)[0] for name in names} == homes()[number]
        for name in names:
            said = [
                int(k)
                for m in HOME.finditer(resolve(name)[1].__doc__)
                for k in re.findall(r"\((\d+)\)", m[1])
            ]
            assert number in said, f"the docstring of {name} does not say that it is eq. ({number})"


# -- style ---------------------------------------------------------------------------------------
def test_ruff_passes():
    said = run(tool("ruff"), "check", ".", "--no-cache")
    assert said.returncode == 0, said.stdout


def test_the_code_is_formatted():
    folders = [name for name in (*PACKAGES, "tests", "examples") if (ROOT / name).is_dir()]
    said = run(tool("ruff"), "format", "--check", "--no-cache", *folders)
    assert said.returncode == 0, said.stdout


def test_siblings_are_found_through_any_finder(tmp_path):
    """An editable install puts a finder of its own on sys.meta_path, and no folder on sys.path."""
    script = f"""
import importlib.machinery, importlib.util, sys

class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name in ("plant", "identification", "ctc"):
            return importlib.util.spec_from_file_location(name, {str(ROOT)!r} + "/" + name + "/__init__.py")

sys.path = [entry for entry in sys.path if entry not in ("", {str(ROOT)!r})]
sys.meta_path.append(Finder)
import plant, identification, ctc
print(plant.__file__)
"""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    found = subprocess.run(  # noqa: S603 - the script is this test's own
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.strip() == str(ROOT / "plant" / "__init__.py")


# -- names of a state ----------------------------------------------------------------------------
NAMED = (
    "plant/laws",
    "ctc/laws",
    "ctc/payload",
    "ctc/learning",
    "plant/simulation",
    "plant/analysis",
    "plant/realtime",
)


def places_by_number(tree):
    """Lines at which a state vector is read by number: a slice or an index with arithmetic."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Subscript):
            continue
        owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
        if owner.lstrip("_") not in ("state", "vector", "memory"):
            continue
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        bounds = []
        for part in parts:
            bounds += [part.lower, part.upper] if isinstance(part, ast.Slice) else [part]
        numbers = (ast.BinOp, ast.UnaryOp)
        if any(
            isinstance(bound, numbers) or isinstance(getattr(bound, "value", None), int)
            for bound in bounds
        ):
            yield node.lineno


def test_a_state_has_names_not_places():
    by_number = {
        f"{path.relative_to(ROOT)}:{line}"
        for room in NAMED
        for path in (ROOT / room).rglob("*.py")
        for line in places_by_number(ast.parse(path.read_text(encoding="utf-8")))
    }
    assert not by_number, f"read these by name (plant/parts/vector.py): {sorted(by_number)}"


@pytest.mark.parametrize(
    ("code", "lines"),
    [
        ("state[2 * n : 3 * n]", [1]),
        ("self._state[-1]", [1]),
        ("memory[: n + 1]", [1]),
        ("vector[0]", [1]),
        ("state[:, None]", []),
        ("memory[rows]", []),
        ("fields.read(state, n).error", []),
    ],
)
def test_the_scan_sees_a_place(code, lines):
    assert list(places_by_number(ast.parse(code))) == lines


# -- faces ---------------------------------------------------------------------------------------
PROJECT = [
    *SOURCES,
    *(p for name in ("tests", "examples", "docs") for p in (ROOT / name).rglob("*.py")),
]
# Formats of logs run in a process of their own, without the rest of the library.
WITHOUT_FACE = "plant.logs.formats"


def folder_of(module):
    """The folder that a module lies in; a folder's own name stands for its face."""
    while not (ROOT / module.replace(".", "/")).is_dir():
        module = module.rpartition(".")[0]
    return module


def names_from_other_folders(source, module=""):
    """(line, module, name) of what a source imports from the three packages, not its own folder."""
    home = folder_of(module) if module else ""
    for node in ast.walk(ast.parse(source)):
        origin = node.module or "" if isinstance(node, ast.ImportFrom) else ""
        ours = origin.split(".")[0] in PACKAGES
        if ours and folder_of(origin) not in (home, WITHOUT_FACE):
            yield from ((node.lineno, origin, name.name) for name in node.names)


def past_a_face(source, module=""):
    """(line, module, name) of what is imported from a file, although its folder has a face."""
    return [
        (line, origin, name)
        for line, origin, name in names_from_other_folders(source, module)
        if origin.count(".") > 1 and origin != folder_of(origin) and name != "SETTINGS"
    ]


def module_of(path):
    relative = path.relative_to(ROOT).with_suffix("")
    inside = relative.parts[0] in PACKAGES
    return ".".join(relative.parts).removesuffix(".__init__") if inside else ""


def test_folders_and_tests_import_from_faces():
    beside = {
        f"{path.relative_to(ROOT)}:{line}: {origin}.{name}"
        for path in PROJECT
        if path.parent.name not in PACKAGES or path.name != "__init__.py"
        for line, origin, name in past_a_face(path.read_text(encoding="utf-8"), module_of(path))
    }
    assert not beside, f"import these from the folder (its __init__.py): {sorted(beside)}"


def test_a_face_exports_what_is_used_outside():
    used = {
        (origin, name)
        for path in PROJECT
        for _, origin, name in names_from_other_folders(
            path.read_text(encoding="utf-8"), module_of(path)
        )
    }
    unused = {
        f"{folder}.{name}"
        for folder in (".".join(p.parent.relative_to(ROOT).parts) for p in SOURCES)
        if folder.count(".") == 1
        for name in getattr(importlib.import_module(folder), "__all__", ())
        if (folder, name) not in used
    }
    assert not unused, f"no other folder and no test imports these: {sorted(unused)}"


@pytest.mark.parametrize(
    ("code", "module", "names"),
    [
        ("from plant.machine.rig import Rig", "", ["Rig"]),
        ("from plant.machine.rig import Rig", "plant.laws.law", ["Rig"]),
        ("from plant.machine.rig import Rig", "plant.machine.drive", []),
        ("from plant.machine import Rig", "", []),
        ("from plant import Rig", "", []),
        ("def f():\n    from ctc.tuning.tune import tune", "", ["tune"]),
    ],
)
def test_the_scan_sees_what_goes_past_a_face(code, module, names):
    assert [name for _, _, name in past_a_face(code, module)] == names


# -- slow tests ----------------------------------------------------------------------------------
def test_the_table_of_slow_tests_names_tests_that_are_there():
    gone = []
    for row in (ROOT / "tests" / "slow.txt").read_text(encoding="utf-8").splitlines():
        if row.startswith("#"):
            continue
        path, function = row.partition("[")[0].split("::")
        defined = (ROOT / path).read_text(encoding="utf-8") if (ROOT / path).exists() else ""
        if f"def {function}(" not in defined:
            gone.append(row)
    assert not gone, f"write the table anew by tests/benchmarks/slow.py: {gone}"

"""Pages that guide a reader through the code name files and things that are there."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("plant", "identification", "ctc")
FILES = {path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
FACES = sorted(path for path in FILES if path.name == "__init__.py")
QUOTED = re.compile(r"`+([\w./]+)`+")


def defined(path):
    """Names of classes, functions, attributes, arguments and constants of a file."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            names.add(node.name)
        elif isinstance(node, ast.Name):
            names.add(node.id)
        elif isinstance(node, ast.arg | ast.keyword):
            names.add(node.arg)
        elif isinstance(node, ast.alias):
            names.add(node.asname or node.name)
    return names


def missing(text, folder):
    """Quoted names of a text that are no file, no folder and nothing that these files define."""
    inside = [path for path in FILES if folder in path.parents]
    faces = [ROOT / package / "__init__.py" for package in PACKAGES]
    names = set().union(*(defined(path) for path in (*inside, *faces)))
    for quoted in QUOTED.findall(text):
        name = quoted.removesuffix("/")
        path = ROOT / name.replace(".", "/")
        is_file = (ROOT / name).exists() or path.with_suffix(".py").exists() or path.is_dir()
        near = {x.stem for x in inside} | {x.name for x in folder.rglob("*")}
        if not (is_file or name in near or set(name.split(".")) & (names | set(PACKAGES))):
            yield quoted


@pytest.mark.parametrize("face", FACES, ids=lambda path: str(path.parent.relative_to(ROOT)))
def test_a_reading_order_names_what_is_there(face):
    text = ast.get_docstring(ast.parse(face.read_text(encoding="utf-8")))
    assert text, face
    assert list(missing(text, face.parent)) == []


def test_the_architecture_page_names_files_that_are_there():
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    names = {path.name for path in FILES} | {path.relative_to(ROOT).as_posix() for path in FILES}
    quoted = re.findall(r"`([\w/]+\.py)`", text)
    known = names | {"docs/house.py"}
    assert len(quoted) > 50
    assert [name for name in quoted if name not in known] == []


def test_the_scan_finds_a_file_that_went():
    assert list(missing("Read `part`, then `no_such_file`.", ROOT / "plant" / "parts")) == [
        "no_such_file"
    ]

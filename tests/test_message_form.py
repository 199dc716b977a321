"""The form of every refusal: one line that says what was expected, what came, and what to do.

Tests of behaviour assert the cause of a refusal (its field, joint, value); its form is tested here,
once for all: the text of each ``raise ValueError(...)`` in the three packages.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SOURCES = sorted(x for p in ("plant", "identification", "ctc") for x in (ROOT / p).rglob("*.py"))
REFUSALS = ("ValueError", "LoadError", "RecordError", "DivergenceError")


def text_of(node):
    """The text of a message, a hole as {}; None where the message is made elsewhere."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        parts = (x.value if isinstance(x, ast.Constant) else "{}" for x in node.values)
        return "".join(parts)
    return None


def messages(path):
    """Line and text of each refusal of a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        call = node.exc if isinstance(node, ast.Raise) else None
        if isinstance(call, ast.Call) and ast.unparse(call.func) in REFUSALS and call.args:
            text = text_of(call.args[0])
            if text is not None and not text.endswith("{}"):
                yield node.lineno, text


def faults(text):
    """What is wrong with the form of a message."""
    if "\n" in text:
        yield "more than one line"
    if not text.endswith("."):
        yield "no full stop"
    # What was expected and what came, then what to do: two sentences or a semicolon at least.
    if len(re.split(r"[.?]\s|;\s|:\s", text)) < 2 and not text.startswith("{}"):
        yield "one part alone"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_refusal_has_its_parts_in_one_line(path):
    wrong = [(line, fault, text) for line, text in messages(path) for fault in faults(text)]
    assert wrong == []


def test_the_scan_finds_what_it_looks_for():
    assert list(faults("gain must be positive; got 0. Give one above 0.")) == []
    assert list(faults("gain must be\npositive; got 0. Give one.")) == ["more than one line"]
    assert list(faults("gain must be positive")) == ["no full stop", "one part alone"]


def test_hundreds_of_refusals_are_seen():
    assert sum(1 for path in SOURCES for _ in messages(path)) > 300

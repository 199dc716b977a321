"""The script that counts how pages read, on a page whose numbers are known."""

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parent / "benchmarks"


def script(name):
    """A script as a module of a name of its own: docs/house.py is another one."""
    place = importlib.util.spec_from_file_location(f"bench_{name}", BENCHMARKS / f"{name}.py")
    module = importlib.util.module_from_spec(place)
    sys.modules[place.name] = module
    sys.path.insert(0, str(BENCHMARKS))
    try:
        place.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module


reads = script("reads")
house = script("house")

PAGE = '''"""A page."""

_LIMIT = 3  # why
_PAIR = (1, -2)
_NAME = "not a number"


def area(own, width):
    """Product."""
    first, *rest = own
    # Because of the sign.
    return f"{first * width}"
'''


@pytest.fixture
def reading(tmp_path):
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "page.py").write_text(PAGE)
    return reads.read(tmp_path, ["package"])


def test_a_page_is_counted_as_a_reader_would(reading):
    assert reading.code_lines == 6
    assert reading.comments == 2
    assert reading.constants == 2
    assert reading.starred_targets == 1
    assert reading.longest_name == "package/page.py: area"
    assert reading.longest_function == 3
    # _LIMIT = 3 | _PAIR = (1, -2) | _NAME = "..." | def area(own, width): | first, *rest = own |
    # return f"..."; the two docstrings of one line are strings.
    assert reading.tokens == 3 + 8 + 3 + 8 + 6 + 2 + 2
    # _LIMIT, _PAIR, _NAME, own, width, first, rest: own and first say nothing.
    assert reading.filler_percent == pytest.approx(100 * 2 / 7)


@pytest.mark.parametrize(
    ("name", "value", "committed", "refused"),
    [
        ("tokens", 381_000, 380_000, True),
        ("tokens", 360_000, 350_000, False),  # worse, and within the target
        ("tokens", 380_000, 381_000, False),
        ("comments per 100 code lines", 3.0, 3.4, True),
        ("comments per 100 code lines", 13.0, 15.0, False),
        ("comments per 100 code lines", 5.0, 3.4, False),
    ],
)
def test_the_ratchet_turns_one_way(name, value, committed, refused):
    (row,) = [row for row in house.ROWS if row.name == name]
    assert row.worse(value, committed) is refused

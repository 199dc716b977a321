"""Cutting straight-line code: run as Python, the pieces must leave in the work array what the
whole leaves.
"""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.compiler import Line, cut


def executed(pieces, work):
    """The work array after all pieces; every piece starts without variables, like the body of a
    loop.
    """
    work = list(work)
    for piece in pieces:
        variables = {"work": work, "t": 3.0}
        for line in piece:
            # the lines are made below
            exec(re.sub(r"{(\d+)}", r"work[\1]", line), variables)  # noqa: S102
    return work


@st.composite
def programs(draw):
    """Lines over four state rows and a scalar, with pairs, repeated reads and results that are
    inputs or literals.
    """
    known, lines = [f"s{i}" for i in range(4)] + ["t", "2.0"], []
    for i in range(draw(st.integers(1, 60))):
        a, b = draw(st.sampled_from(known)), draw(st.sampled_from(known[-8:]))
        if draw(st.booleans()):
            lines.append(Line((f"v{i}",), "{0} + 0.5 * {1}", (a, b)))
        else:
            lines.append(Line((f"v{i}", f"w{i}"), "({0} - {1}, 0.25 * {0})", (a, b)))
        known += lines[-1].names
    stores = draw(st.dictionaries(st.integers(0, 3), st.sampled_from(known), max_size=4))
    return lines, stores, draw(st.integers(1, 70))


@settings(derandomize=True, max_examples=300, deadline=None)
@given(programs())
def test_pieces_leave_what_the_whole_leaves(program):
    lines, stores, size = program
    rows = {f"s{i}": i for i in range(4)}
    fresh = iter(range(4, 10**6))
    pieces = cut(lines, stores, rows, lambda: next(fresh), size)
    assert len(pieces) == max(1, round(len(lines) / size))
    whole = {f"s{i}": float(i + 1) for i in range(4)} | {"t": 3.0}
    before = [whole[f"s{i}"] for i in range(4)]
    for line in lines:
        exec(str(line), whole)  # noqa: S102 - the lines are made above
    # likewise
    expected = [eval(stores[i], whole) if i in stores else before[i] for i in range(4)]  # noqa: S307
    assert executed(pieces, before + [np.nan] * next(fresh))[:4] == expected


def test_cuts_are_made_where_few_values_cross():
    """Two chains, one after the other: the only place where one value crosses is between them."""
    lines = [Line(("v0",), "{0} + {1}", ("s0", "t"))]
    lines += [
        Line((f"v{i}",), "{0} * {1}", (f"v{i - 1}", f"v{max(0, i - 3)}")) for i in range(1, 12)
    ]
    lines += [Line(("v12",), "{0} + {1}", ("v11", "s1"))]
    lines += [
        Line((f"v{i}",), "{0} * {1}", (f"v{i - 1}", f"v{max(12, i - 3)}")) for i in range(13, 22)
    ]
    fresh = iter(range(2, 100))
    first, second = cut(lines, {0: "v21"}, {"s0": 0, "s1": 1}, lambda: next(fresh), 11)
    assert first[-1] == "{2} = v11"
    assert second[:2] == ["v11_1 = {2}", "s1_1 = {1}"]
    assert second[-1] == "{0} = v21"


def test_a_row_that_another_row_takes_over_is_not_overwritten_before():
    lines = [
        Line((f"v{i}",), "{0} + {1}", (name, "t")) for i, name in enumerate(("s0", "s1", "s1"))
    ]
    fresh = iter(range(2, 10))
    pieces = cut(lines, {0: "v0", 1: "s0"}, {"s0": 0, "s1": 1}, lambda: next(fresh), 1)
    assert executed(pieces, [1.0, 2.0] + [np.nan] * next(fresh))[:2] == [4.0, 1.0]


@pytest.mark.parametrize("size", [1, 1000])
def test_nothing_to_do(size):
    assert cut([], {}, {}, None, size) == [[]]
    assert cut([], {1: "s0"}, {"s0": 0, "s1": 1}, None, size) == [["s0_0 = {0}", "{1} = s0_0"]]

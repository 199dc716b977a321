"""C statements of a casadi Function: declared once, in order, with casadi's values."""

import math
import re

import casadi as ca
import numpy as np
import pytest

from plant.compiler import STATE, TIME, UNIFORM, comment, statements


def test_statements_have_the_values_of_the_function():
    """Read as Python, whose expressions of numbers are those of C."""
    number, time, state = (ca.SX.sym(name) for name in ("number", "time", "state"))
    root = ca.sqrt(number) + 1
    wave = ca.sin(time) / root
    shared = state * wave - root
    function = ca.Function("f", [number, time, state], [shared * shared, wave - shared / state])
    inputs = [[("number", UNIFORM)], [("time", TIME)], [("state", STATE)]]
    lines, results, used = statements(function, inputs)
    assert used == {"number", "time", "state"}
    values = {"number": 2.3, "time": 0.7, "state": -1.9}
    scope = dict(values)
    for kind, letter in ((UNIFORM, "k"), (TIME, "r"), (STATE, "x")):
        assert lines[kind]
        for i, line in enumerate(lines[kind], 1):
            name, text = re.fullmatch(r"const double (\w+) = (.*);", line).groups()
            assert name == f"{letter}{i}"
            scope[name] = eval(text, vars(math), scope)  # noqa: S307  # of this test
    reached = [eval(text, vars(math), scope) for text in results]  # noqa: S307
    expected = [float(value) for value in function(*values.values())]
    np.testing.assert_allclose(reached, expected, rtol=1e-14)


@pytest.mark.parametrize("text", ["ends */ here", "begins /* here", "ümlaut and \\ and \n line"])
def test_a_comment_ends_where_it_should(text):
    made = comment(text)
    assert made.isascii()
    assert made.startswith("/* ")
    assert (made.count("/*"), made.count("*/")) == (1, 1)
    assert made.endswith(" */")

"""Checks of input: what passes unchanged, and what every refusal says."""

import dataclasses
import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.parts import array, choice, known_options, warn


@settings(derandomize=True)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=6))
def test_array_keeps_every_finite_number_and_copies(values):
    given_array = np.array(values)
    result = array("x", given_array, ("n",), advice="")
    np.testing.assert_array_equal(result, given_array)
    assert result.dtype == np.float64
    assert not np.shares_memory(result, given_array)


@pytest.mark.parametrize(
    ("value", "shape", "message"),
    [
        ([1, 2], (3,), r"^x must have shape \(3,\); got shape \(2,\)\. Do so\.$"),
        ([[1, 2]], (2, "n"), r"^x must have shape \(2, n\); got shape \(1, 2\)\. Do so\.$"),
        (
            [[1], [2]],
            (1, 2),
            (
                r"^x must have shape \(1, 2\); .* lies on its side: give its transpose \(\.T\)\. Do"
                r" so\.$"
            ),
        ),
        ([1, 2], (), r"^x must have shape \(\); got shape \(2,\)\. Do so\.$"),
        (
            [[1, 2], [3]],
            (2, 2),
            r"^x must be numbers of shape \(2, 2\); got \[\[1, 2\], \[3\]\]\. Do so\.$",
        ),
        ("one", (1,), r"^x must be numbers of shape \(1,\); got 'one'\. Do so\.$"),
        (None, (1,), r"shape \(1,\); got shape \(\), None\. Do so\.$"),
        (2.5, ("n",), r"shape \(n,\); got shape \(\), 2\.5\. Do so\.$"),
        (np.nan, (), r"must be finite; got nan\. Do so\.$"),
        ([1, np.nan], (2,), r"^x must be finite; got nan at index 1\. Do so\.$"),
        (
            [[1, 2], [-np.inf, 3]],
            (2, 2),
            r"^x must be finite; got -inf at index \(1, 0\)\. Do so\.$",
        ),
        ([1j], (1,), r"must be numbers"),
    ],
)
def test_array_says_what_was_expected_what_came_and_what_to_do(value, shape, message):
    with pytest.raises(ValueError, match=message) as error:
        array("x", value, shape, advice="Do so.")
    assert "\n" not in str(error.value)


def test_array_lets_infinity_pass_when_asked_to():
    np.testing.assert_array_equal(array("x", [np.inf], (1,), advice="", finite=False), [np.inf])


def test_choice_offers_the_nearest():
    assert choice("backend", "numba", ("numba", "casadi")) == "numba"
    with pytest.raises(
        ValueError,
        match=r"^backend must be one of 'numba', 'casadi'; got 'nubma'\. Did you mean 'numba'\?$",
    ):
        choice("backend", "nubma", ("numba", "casadi"))
    with pytest.raises(ValueError, match=r"got 'q'\. Take one of these\.$"):
        choice("backend", "q", ("numba", "casadi"))
    with pytest.raises(ValueError, match=r"got 'q'\. Write 'numba'\.$"):
        choice("backend", "q", ("numba",))
    with pytest.raises(ValueError, match=r"18, 19 and 10 more; got 4\.5"):
        choice("number", 4.5, range(30))


@known_options
def function(a, b=2, *, gain=3):
    """Doc."""
    return a, b, gain


@known_options
@dataclasses.dataclass
class Options:
    gain: float = 1.0


def test_misspelt_keyword_is_a_value_error_with_the_nearest_name():
    assert function(1, gain=5) == (1, 2, 5)
    assert function.__doc__ == "Doc."
    assert Options(gain=2.0).gain == 2.0
    with pytest.raises(
        ValueError,
        match=r"an option of function must be one of .*; got 'gian'\. Did you mean 'gain'\?",
    ):
        function(1, gian=5)
    with pytest.raises(
        ValueError,
        match=r"an option of Options must be one of 'gain'; got 'gains'\. Did you mean 'gain'\?",
    ):
        Options(gains=1)
    with pytest.raises(ValueError, match="takes any keyword"):
        known_options(lambda **anything: None)


def test_singular_matrices_are_refused_in_words():
    @known_options
    def solve(matrix):
        return np.linalg.solve(matrix, np.ones(2))

    with pytest.raises(
        ValueError,
        match=r"solve needs equations with one solution; they have none or many \(Singular",
    ):
        solve(np.zeros((2, 2)))


def test_what_cannot_be_written_to_is_shared_where_that_is_wanted_and_checked_as_ever():
    frozen = np.arange(3.0)
    frozen.setflags(write=False)
    assert array("x", frozen, (3,), advice="", shared=True) is frozen
    assert array("x", frozen, (3,), advice="").flags.writeable
    # its base can be written to
    for open_ in (np.arange(3.0), np.broadcast_to(np.arange(3.0), (3,))):
        assert not np.shares_memory(array("x", open_, (3,), advice="", shared=True), open_)
    bad = np.array([0.0, np.nan])
    bad.setflags(write=False)
    with pytest.raises(ValueError, match="x must be finite; got nan at index 1"):
        array("x", bad, (2,), advice="", shared=True)


def test_a_warning_points_at_the_line_of_the_user_through_our_functions():
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        warn("here")
        # Deep inside, at the call of this file.
        namespace = {"__name__": "plant.deep", "warn": warn}
        exec("def ours(): warn('there')", namespace)  # noqa: S102
        namespace["ours"]()
    assert [each.filename for each in told] == [__file__, __file__]
    assert told[1].lineno == told[0].lineno + 4

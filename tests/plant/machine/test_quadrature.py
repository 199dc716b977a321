"""The quadrature error of an encoder: where its edges are, by hand; its period; that a
controller does not know.
"""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import brentq

from plant import Encoder, QuadratureError, puma560, simulate


def edges(encoder, last):
    """Positions [pulses] of one joint at which its counts pass 1, ..., last, to 1e-9."""

    def counted(position):
        return encoder.true_counts(np.array([position]))[0]

    found = []
    for count in range(1, last + 1):
        low, high = count - 1.0, count + 1.0
        while high - low > 1e-9:
            middle = (low + high) / 2
            low, high = (low, middle) if counted(middle) >= count else (middle, high)
        found.append(high)
    return np.array(found)


@pytest.mark.parametrize("amplitude", [0.05, 0.3, 0.6])
@pytest.mark.parametrize("rounding", ["fix", "floor"])
def test_every_second_edge_is_shifted_back_and_forth(amplitude, rounding):
    """Phase 0: edges 2 and 4 stay; edge 1 comes early by s = amplitude cos(pi s / 2), edge 3
    late by as much.
    """
    encoder = Encoder(
        resolution=(1000,), rounding=rounding, quadrature=QuadratureError(amplitude=(amplitude,))
    )
    shift = brentq(lambda s: s - amplitude * np.cos(np.pi * s / 2), 0, 1)
    np.testing.assert_allclose(
        edges(encoder, 8), [1 - shift, 2, 3 + shift, 4, 5 - shift, 6, 7 + shift, 8], atol=1e-8
    )


def test_the_phase_says_which_edges():
    """A quarter turn on, the edges 1 and 3 stay."""
    encoder = Encoder(
        resolution=(1000,), quadrature=QuadratureError(amplitude=(0.2,), phase=(np.pi / 2,))
    )
    shift = brentq(lambda s: s - 0.2 * np.cos(np.pi * s / 2), 0, 1)
    np.testing.assert_allclose(edges(encoder, 4), [1, 2 + shift, 3, 4 - shift], atol=1e-8)


def test_it_repeats_every_four_counts_and_never_counts_backwards():
    error = QuadratureError(amplitude=(0.63, 0.1), phase=(0.3, 1.0))
    position = np.linspace(-8, 8, 4001)[:, None] * np.ones(2)
    shifted = error.shifted(position)
    np.testing.assert_allclose(error.shifted(position + 4), shifted + 4, atol=1e-12)
    np.testing.assert_allclose(np.abs(shifted - position).max(axis=0), (0.63, 0.1), rtol=1e-5)
    assert (np.diff(shifted, axis=0) > 0).all()


def test_a_controller_does_not_know():
    plain = puma560.rig()
    given = QuadratureError(amplitude=(0.4, 0.4))
    rig = dataclasses.replace(plain, encoder=dataclasses.replace(plain.encoder, quadrature=given))
    q = plain.to_angle(np.array([0.8, -2.9]))
    np.testing.assert_array_equal(rig.counts(q), plain.counts(q))
    np.testing.assert_array_equal(rig.true_counts(q), [1, -2])
    np.testing.assert_array_equal(
        rig.cell_centre(np.array([3.0, -1.0])), plain.cell_centre(np.array([3.0, -1.0]))
    )
    smooth = dataclasses.replace(rig.encoder, smooth=True)
    np.testing.assert_array_equal(smooth.true_counts(np.array([0.8, -2.9])), [0.8, -2.9])


def test_none_changes_no_count_and_casadi_gives_the_same():
    arm, plain, law, path = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()

    def counted(amplitude, backend="numba"):
        given = QuadratureError(amplitude=(amplitude, amplitude), phase=(0.5, 1.0))
        rig = dataclasses.replace(
            plain, encoder=dataclasses.replace(plain.encoder, quadrature=given)
        )
        return simulate(arm, rig, law, path, duration=0.3, backend=backend).error_pulses

    np.testing.assert_array_equal(
        counted(0.0), simulate(arm, plain, law, path, duration=0.3).error_pulses
    )
    np.testing.assert_array_equal(counted(0.3), counted(0.3, "casadi"))
    assert not np.array_equal(counted(0.0), counted(0.3))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: QuadratureError(amplitude=(-0.1,)), "amplitude must be from 0 to below 2/pi"),
        (lambda: QuadratureError(amplitude=(0.64,)), "amplitude must be from 0 to below 2/pi"),
        (
            lambda: QuadratureError(amplitude=(0.1,), phase=(0, 0)),
            "phase of QuadratureError must have shape",
        ),
        (
            lambda: Encoder(resolution=(1,), quadrature=0.2),
            "quadrature of Encoder must be of type QuadratureError",
        ),
        (
            lambda: Encoder(resolution=(1, 1), quadrature=QuadratureError(amplitude=(0.1,))),
            "quadrature.amplitude must have 2 joints; got 1",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)

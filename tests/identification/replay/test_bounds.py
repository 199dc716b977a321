"""Unknowns whose part takes no negative value: the fit stays in their bounds, and says where it
ends.
"""

import dataclasses

import numpy as np

from identification import identify
from identification.replay import ended_on_bounds, slopes
from plant import FrictionCurve, puma560, simulate

BREAKAWAY = ("drive.curve.breakaway[0]", "drive.curve.breakaway[1]")


def rig(breakaway):
    curve = FrictionCurve(offset=(0, 0), breakaway=breakaway, speed=(5.0, 5.0))
    drive = dataclasses.replace(puma560.rig().drive, curve=curve)
    return dataclasses.replace(puma560.rig(), drive=drive)


def record(stated):
    """A log without breakaway torque, under a rig that states some."""
    log = simulate(
        puma560.arm(), rig((0.0, 0.0)), puma560.p_law(), puma560.reference(), duration=3.0
    )
    return dataclasses.replace(log, rig=rig(stated))


def test_a_breakaway_torque_near_zero_is_not_fitted_below_it():
    """Fitted without bounds, that of a joint is -0.012 N m."""
    found = identify(
        puma560.dynamics(),
        record((0.01, 0.01)),
        unknown=("f", *BREAKAWAY),
        method="prediction_error",
        progress=False,
    )
    levels = found.fit.values[-2:]
    assert (levels >= 0).all()
    assert (levels < 0.1 * found.rig.drive.coulomb + 0.005).all(), levels
    on_bound = [name for name, level in zip(BREAKAWAY, levels, strict=True) if level == 0]
    assert on_bound, levels
    assert f"ends on a bound of {', '.join(on_bound)}" in found.message


def test_names_of_unknowns_on_their_bounds():
    bounds = np.array([(0.0, np.inf), (0.0, 1.0), (-np.inf, np.inf), (2.0, 2.0)])
    values = np.array([0.0, 1.0, -5.0, 2.0])
    # the last one is not varied, and is no news
    assert ended_on_bounds(("a", "b", "c", "d"), values, bounds, np.arange(3)) == ["a", "b"]
    assert ended_on_bounds(("a", "b", "c", "d"), values + 0.5, bounds, np.array([0])) == []


class Magnitude:
    """Innovations of a number whose sign means nothing, as of friction below zero."""

    unknown = ("level",)
    weights = np.ones(3)

    def all_innovations(self, vectors):
        return [np.abs(values[0]) * np.array([1.0, 2.0, 3.0]) for values in vectors]


def test_slope_on_a_bound_is_that_inside():
    """A central difference about zero of a magnitude would be none: "does not act"."""
    bounds = np.array([(0.0, np.inf)])
    step = np.array([0.1])
    for value in (0.0, 1.0):
        change = slopes(Magnitude(), np.array([value]), step, np.array([0]), None, bounds)
        np.testing.assert_allclose(change[:, 0], 0.1 * np.array([1.0, 2.0, 3.0]))

"""Directions of the unknowns that the readings of a log determine hardly, or not at all.

The weight of a vertical slide and the integral of its controller before the log act as one number:
a change of one is undone by a change of the other. The slope of a single unknown
is a difference of simulations, and exact to a few digits only. Where such slopes cancel, their
errors remain, and would pass for knowledge. Therefore a weak direction is simulated as a whole:
what cancels in the machine then cancels in the simulation. A remainder below the accuracy of a
slope is no knowledge.
"""

from typing import NamedTuple

import numpy as np

from identification.equation_error import IDENTIFIABLE, NotIdentifiableError
from identification.replay.residual import Residual
from plant.parts import Bools, Floats, Integers, frozen_settings, norm, products


@frozen_settings
class WeakDirectionSettings:
    """Limits of the search for weak directions; chosen by hand.

    The share of a direction is the norm of its slope where the slope of each unknown has norm 1.

    Parameters
    ----------
    measured : float
        Share below which the slope of a direction is simulated: slopes of single unknowns are exact
        to about a thousandth.
    remembered : float
        The same where the state of a law before the log is unknown: the slope of such a state, an
        integral for example, nearly cancels with others. In a log with a period of 5 ms the errors
        of the slopes gave a share of 3 % to a direction that no reading determines (log 13 of
        ``any_rig.py --period 0.005``). From 0.1 on, directions that single slopes show well are
        simulated over ways on which dry friction bends them: a load was then 0.8 kg off
        (``tests/identification/payload/test_logged_load.py``).
    determined : float
        Share below which a direction is not determined by the readings. The slope of a
        direction that is simulated over a short way is exact to some 1e-8. Along a log of a PID
        loop that began earlier, a share of 8e-5 was still known to a thousandth.
    agreement : float
        Change of the slope of a weak direction, as a share of `determined`, below which the search
        for weak directions ends.
    way : float
        Largest RMS change of the readings [pulses] that one unknown makes while a direction is
        simulated.
    rounds : int
        Searches for weak directions, each with the slopes of the previous one.
    together : int
        Directions that are simulated at once.
    """

    measured: float = 3e-3
    remembered: float = 0.04
    determined: float = 1e-6
    agreement: float = 0.1
    way: float = 0.1
    rounds: int = 5
    together: int = 4


SETTINGS = WeakDirectionSettings()


class Slopes(NamedTuple):
    """Slopes (M, v) of the innovations per step, and undetermined directions (u, v) in steps."""

    slopes: Floats
    undetermined: Floats


def with_weak_directions(
    residual: Residual, values: Floats, step: Floats, varied: Integers, slopes: Floats
) -> Slopes:
    """Slopes whose weak directions are simulated.

    Where a law's state has expected values, a direction that no reading determines gets the slope
    zero in the readings. It keeps its slope in the rows of the expected values, which determine it.
    Without expected values the least squares refuse such a direction.

    Parameters
    ----------
    residual : Residual
    values : (k,) numpy.ndarray
        The unknowns at which the slopes were made.
    step : (k,) numpy.ndarray
        Steps of the differences.
    varied : (v,) numpy.ndarray
        Places of the unknowns that are varied.
    slopes : (M, v) numpy.ndarray
        Change of the innovations per step.

    Raises
    ------
    NotIdentifiableError
        No row determines a direction.
    """
    none = np.empty((0, len(varied)))
    readings = residual.weights > 0
    lengths = np.sqrt(np.einsum("mi,mi->i", slopes[readings], slopes[readings]))
    # The least squares deal with an unknown that does not act on the readings.
    if not lengths.all():
        return Slopes(slopes, none)
    # The expected values of a law's state are rows without a reading. A residual with such rows has
    # a low limit of dependence. An error of a slope would outweigh these rows.
    expected = residual.dependent < IDENTIFIABLE.products
    weak = SETTINGS.remembered if expected else SETTINGS.measured
    if np.linalg.eigvalsh(_products(slopes, readings, lengths))[0] >= weak**2:
        return Slopes(slopes, none)

    # 1. Simulate the weak directions. Better slopes turn them, so this is repeated.
    # In columns of one length the eigenvalues are shares, whatever the units are.
    scaled = slopes / lengths
    way = SETTINGS.way * np.sqrt(np.count_nonzero(readings))
    unit = np.ones(len(varied))
    for _ in range(SETTINGS.rounds):
        squares, axes = np.linalg.eigh(_products(scaled, readings, unit))
        directions = axes.T[squares < weak**2]
        settled = True
        for begin in range(0, len(directions), SETTINGS.together):
            block = directions[begin : begin + SETTINGS.together]
            measured = _along(residual, values, step, varied, block / lengths, way)
            for axis, slope in zip(block, measured, strict=True):
                # Where the simulation fails, keep the slopes of the single unknowns.
                if not np.isfinite(slope).all():
                    continue
                # Only the part along this direction changes.
                change = slope - scaled @ axis
                scaled += np.outer(change, axis)
                settled &= norm(change[readings]) < SETTINGS.agreement * SETTINGS.determined
        if settled:
            break
    if not expected:
        return Slopes(scaled * lengths, none)

    # 2. Set a slope in the readings to zero where it is below its accuracy.
    squares, axes = np.linalg.eigh(_products(scaled, readings, unit))
    undetermined = []
    for axis in axes.T[squares < SETTINGS.determined**2]:
        _require_expectation(residual, varied, axis, scaled @ axis, readings)
        scaled[readings] -= np.outer(scaled[readings] @ axis, axis)
        # Back in steps of the unknowns, in which the covariance is made.
        undetermined.append(axis / lengths)
    return Slopes(scaled * lengths, np.reshape(undetermined, (-1, len(varied))))


def _products(slopes, readings, lengths):
    """Products (v, v) of the slopes (M, v) of the readings, over their lengths (v,)."""
    rows = slopes if readings.all() else slopes[readings]
    return products(rows) / np.outer(lengths, lengths)


def _along(residual, values, step, varied, directions, way):
    """Slopes (d, M) of directions (d, v) in steps, by central differences over at most `way`."""
    # The longest way on which no unknown moves further than its own difference, and none changes
    # the readings by more than a small part of a pulse: on a long way their curvature would not
    # cancel where their slopes do.
    lengths = np.minimum(1 / np.abs(directions).max(axis=1), way)
    moves = np.zeros((len(directions), len(values)))
    moves[:, varied] = step[varied] * directions * lengths[:, None]
    rows = residual.all_innovations([*(values + moves), *(values - moves)])
    pairs = zip(rows[: len(moves)], rows[len(moves) :], lengths, strict=True)
    return [(up - down) / (2 * length) for up, down, length in pairs]


def _require_expectation(
    residual: Residual, varied: Integers, axis: Floats, slope: Floats, readings: Bools
) -> None:
    """Raise where no expected value determines a direction."""
    if slope[~readings].any():
        return
    names = [residual.unknown[i] for i in varied[np.abs(axis) > IDENTIFIABLE.share]]
    raise NotIdentifiableError(
        f"unknowns must be separately identifiable; {names[0]} is a combination of"
        f" {', '.join(names[1:])}. Fix one of them, log a motion that excites more"
        " (design_motion), or give identify a prior=.",
        names[0],
    )

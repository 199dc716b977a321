"""Directions of the unknowns that the readings of a log determine hardly, or not at all.

The weight of a vertical slide and the integral of its controller before the log act as one number:
a change of one is undone by a change of the other. The slopes of single unknowns are differences of
simulations, which are exact to a few digits. Where such slopes cancel, their errors remain, and
would pass for knowledge. Therefore a weak direction is simulated as a whole: what cancels in the
machine then cancels in the simulation. What remains below the accuracy of a slope is no knowledge.
"""

from typing import NamedTuple

import numpy as np

from identification.equation_error.least_squares import IDENTIFIABLE, NotIdentifiableError
from identification.replay.residual import Residual
from plant.parts.fields import Bools, Floats, Integers
from plant.parts.settings import frozen_settings
from plant.parts.sums import norm, products


@frozen_settings
class WeakDirectionSettings:
    """Shares of the slopes of the unknowns that remain in a direction; chosen by hand.

    Parameters
    ----------
    measured : float
        Share below which the slope of a direction is simulated: slopes of single unknowns are exact
        to about a thousandth.
    remembered : float
        The same where the state of a law before the log is unknown: its slope, such as that of an
        integral, nearly cancels with others. Slopes of a log of 5 ms left 3 % of a direction that
        no reading determines (log 13 of ``any_rig.py --period 0.005``).
    determined : float
        Share below which a direction is not determined by the readings. A direction that is
        simulated over a short way is exact to some 1e-8; along a log of a PID loop that began
        earlier, directions with a share of 8e-5 were still known to a thousandth.
    agreement : float
        Change of the slope of a weak direction, as a share of `determined`, below which the search
        for weak directions ends.
    way : float
        Largest change of the readings by one unknown of a direction that is simulated, RMS
        [pulses].
    rounds : int
        Searches for weak directions, each with the slopes of the previous one.
    together : int
        Directions that are simulated at once.
    """

    measured: float = 3e-3
    remembered: float = 0.1
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

    Beside expected values of a law's state, directions that no reading determines have no slope in
    the readings. Rows that are no readings stay as they are: an expected value determines what the
    readings do not. Elsewhere the least squares refuse such a direction.

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
    # An unknown that does not act at all is named by the least squares.
    if not lengths.all():
        return Slopes(slopes, none)
    # A residual with expected values of a law's state, which are rows without a reading, has a low
    # limit of dependence. They weigh so little that an error of a slope would outweigh them.
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
                # Where the arm leaves the log the differences of single unknowns stay.
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

    # 2. What is below the accuracy of a slope is no slope.
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

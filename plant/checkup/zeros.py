"""A reference whose zero is not that of the counts: sizes that are tried, and the evidence."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.law_motion import driven_by_law, unexplained
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.undo import shifted_reference


def median_errors(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """The median error [pulses], where it is large against how the error changes in the log.

    The torque of a law with memory shows whether a small one is of the loop.
    """
    if experiment.signals.reference is None:
        return ()
    chosen = columns_of(joints)
    # Counts that follow nothing, as of an arm that falls, have no zero.
    if (_moves(experiment) & (experiment.tracking > SCORE.unlike))[chosen].any():
        return ()
    error = (np.asarray(experiment.signals.reference) - experiment.signals.counts)[:, chosen]
    middle = float(np.median(error))
    changes = 0.0 if experiment.has_memory else float(np.sqrt(np.mean((error - middle) ** 2)))
    return (middle,) if abs(middle) > max(1.0, SCORE.shifted * changes) else ()


def _moves(experiment):
    """Whether the reference of each joint (n,) moves."""
    speeds = [experiment.filtered("reference", i).speed for i in range(experiment.n)]
    return np.square(speeds).mean(axis=1) > experiment.filter.speed_noise


def zero_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of a reference with another zero, by the mean of the law's torque.

    None where the score shows it: if neither has the law memory nor the log a torque. A scale of
    the torque, as of other gains or units, explains a part of the mean, and is no evidence.
    """
    torque, commanded = experiment.signals.torque, experiment.commanded
    if experiment.has_memory:
        return _by_torque_of_law(experiment, joints)
    if torque is None or commanded is None or not experiment.long_enough:
        return None
    chosen = columns_of(joints)
    # Counts that a motor at its limit cannot bring to the reference show no zero.
    if experiment.cut_off[chosen].any():
        return ()
    law, logged = commanded[:, chosen].ravel(), torque[:, chosen].ravel()
    error = (np.asarray(experiment.signals.reference) - experiment.signals.counts)[
        :, chosen
    ].ravel()
    moves, swings = error - error.mean(), law - law.mean()
    # The gain [N m/pulse] of the law, for which a shift of the zero is one of the torque.
    gain = swings @ moves / max(moves @ moves, 1e-300)
    scale = swings @ logged / max(swings @ swings, 1e-300)
    constant = logged.mean() - scale * law.mean()
    # A joint that stands, and one whose torque does not change, show none.
    if not scale * gain:
        return ()
    # What the amplifiers cut off of a torque is no constant, either.
    without = law, experiment.limited(commanded)[:, chosen].ravel()
    least = min(np.mean((logged - x * (x @ logged) / (x @ x)) ** 2) for x in without)
    beside = np.mean((logged - scale * law - constant) ** 2)
    floor = SCORE.another_zero * np.mean(logged**2)
    odds = experiment.filter.equations / 2 * np.log((least + floor) / (beside + floor))
    return ((float(-constant / (scale * gain)), float(odds)),)


def _by_torque_of_law(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of another zero under a law with memory.

    A constant error takes its integral, or its observer, to the limit of the amplifier: such a
    torque cannot be that of the motion, nor the logged one.
    """
    chosen = columns_of(joints)
    for size in median_errors(experiment, joints):
        changed = experiment.changed(shifted_reference(experiment.record, joints, size))
        # A shift that leaves another torque than the law's has another cause.
        explained = changed.command is not None and (changed.command[chosen] < SCORE.like).all()
        odds = changed.score - experiment.score if explained else 0.0
        stated, corrected = (each.once(driven_by_law) for each in (experiment, changed))
        if stated is not None and corrected is not None:
            before, after = (unexplained(each)[chosen].max() for each in (stated, corrected))
            if before > SCORE.unlike and after < SCORE.like:
                odds = max(odds, corrected.score - stated.score)
        # Occam: any other distance of that size would have been as likely.
        yield size, odds - np.log(abs(size))

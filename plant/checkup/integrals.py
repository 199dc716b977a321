"""The integral of a law: its gain, or whether there is one, by the level of the torque.

A step from sample to sample hardly shows an integral. The torque less a constant shows it; the
constant is what the law integrated before the log.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.along_log import comparable_torques
from plant.checkup.filtered import centred
from plant.checkup.gain_units import SETTINGS as UNITS
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.law_parts import gains_of, other_gains, reads_the_log
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment, shares
from plant.checkup.sizes import regressed
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.checkup.undo import with_integral, without_integral
from plant.laws import PD
from plant.parts import Floats


def integral_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of another integral gain: how many times the right one it is."""
    if not reads_the_log(experiment) or not gains_of(experiment.record.law, "integral"):
        return
    without = experiment.changed(without_integral(experiment.record, joints, 1.0))
    factor = _factor(experiment, without, joints)
    # A smaller share is no integral, or one in another unit.
    if factor > 1 / UNITS.least:
        record = other_gains("integral")(experiment.record, joints, 1 / factor)
        yield 1 / factor, _likelier(experiment, experiment.changed(record), joints)


def no_integral_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a log whose law had no integral."""
    if reads_the_log(experiment) and gains_of(experiment.record.law, "integral"):
        changed = experiment.changed(without_integral(experiment.record, joints, 1.0))
        yield 1.0, _likelier(experiment, changed, joints)


def lacking_integral_evidence(
    experiment: Experiment, joints: Joints
) -> Iterator[tuple[float, float]]:
    """Log odds of a log whose law had an integral, of so many 1/s of its gain."""
    if not reads_the_log(experiment) or type(experiment.record.law) is not PD:
        return
    unit = experiment.changed(with_integral(experiment.record, joints, 1.0))
    # The unit's law less the stated one is the part whose factor is sought.
    factor = _factor(unit, experiment, joints)
    if factor > 0:
        changed = experiment.changed(with_integral(experiment.record, joints, factor))
        yield factor, _likelier(experiment, changed, joints)


def _levels(experiment: Experiment) -> tuple[Floats, Floats]:
    """Motor torques (K, n) of the law and of the log, each less its mean."""
    rows, law, logged = comparable_torques(experiment.signals, experiment.torque_along)
    return centred(law[rows]), centred(logged[rows])


def _factor(whole, without, joints):
    """Factor of the part that one law has and another lacks, for the logged torque."""
    law, logged = _levels(whole)
    rest, _ = _levels(without)
    factors = regressed(logged - rest, law - rest)
    return float(np.median(factors[columns_of(joints)]))


def _likelier(experiment: Any, changed: Any, joints: Joints) -> float:
    """How much likelier the level of the torque is under another law: log odds."""
    before, after = (shares(_levels(each)) for each in (experiment, changed))
    if (after[columns_of(joints)] > SCORE.like).any():
        return -np.inf
    windows = experiment.filter.equations / REGRESSION.per_window
    explained = np.log((before + SCORE.steps) / (after + SCORE.steps))
    return float(windows / 2 * explained.sum())

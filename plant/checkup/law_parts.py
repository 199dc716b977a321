"""The torque of a law along a log, and the part that each of its gains makes of it.

A law is linear in each of its gains. It is run along the counts of the log as stated, and once more
with each gain doubled: the differences are the parts that a factor of the gain multiplies.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.along_log import SETTINGS as ALONG_LOG
from plant.checkup.along_log import torque_along
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.score import Experiment
from plant.laws import PD, Cascade, P
from plant.parts import Floats

GAINS = ("gain", "derivative", "integral", "position", "speed")
"""Gains of the laws that are examined."""


def gains_of(law: Any, gain: str) -> tuple[str, ...]:
    """Fields of a law that a gain of this name stands for; none of a law that is not examined.

    The name "gains" stands for all gains that make a torque, of a law that has several: they are
    wrong together where a unit of torque, or of angle, is.
    """
    if not isinstance(law, (P, PD, Cascade)):
        return ()
    names = tuple(name for name in GAINS if hasattr(law, name))
    if gain != "gains":
        return (gain,) if gain in names else ()
    # The position gain of a cascade makes a speed, no torque.
    together = tuple(name for name in names if name != "position")
    return together if len(together) > 1 else ()


def other_gains(gain: str) -> Callable[..., Any]:
    """The function that divides a gain of the law, or all "gains", by a factor."""

    def undo(record, joints, size):
        names = gains_of(record.law, gain)
        if not names:
            raise ValueError(f"the law must have the gain {gain}; it has none. Name another.")
        return replace(record, law=_scaled(record.law, names, joints, 1 / size))

    return undo


def _scaled(law, names, joints, factor):
    """The law with these gains multiplied, of these joints, or of all where there are none."""

    def changed(gains):
        factors = np.ones(len(gains))
        factors[columns_of(joints)] = factor
        return factors * gains

    return replace(law, **{name: changed(getattr(law, name)) for name in names})


class LawTorque(NamedTuple):
    """Motor torque of the stated law along the log (K, n), and the part of each gain in it."""

    torque: Floats
    parts: dict[str, Floats]

    def without(self, gain: str, joints: Joints, size: float) -> Floats:
        """Torque (K, n) of the law without a mistake of this size in a gain, or in all "gains"."""
        part = self.torque if gain == "gains" else self.parts[gain]
        change = np.zeros(part.shape[1])
        change[columns_of(joints)] = 1 / size - 1
        return self.torque + change * part


def law_torque(experiment: Experiment) -> LawTorque | None:
    """The stated law along the log, without limits, which a wrong gain would reach at once.

    None of a law that is not examined, or that cannot be run along the log.
    """
    law, rig = experiment.record.law, experiment.record.rig
    names = [gain for gain in GAINS if gains_of(law, gain)]
    if not names:
        return None
    if hasattr(law, "anti_windup"):
        law = replace(law, anti_windup="none")
    drive = replace(rig.drive, current_limit=np.full(rig.n, np.inf))
    rig = replace(rig, drive=drive)

    def torque(law):
        joint = torque_along(experiment.signals, law, rig)
        return None if joint is None else drive.motor_torque(joint)

    stated = torque(law)
    if stated is None:
        return None
    parts = {name: torque(_scaled(law, (name,), (), 2.0)) - stated for name in names}
    return LawTorque(stated, parts)


def reads_the_log(experiment: Experiment) -> bool:
    """Whether a torque is logged, and the law has the log's period.

    Between the rows of the log a faster law responds to counts that the log does not have.
    """
    law, interval = experiment.record.law, experiment.signals.interval
    if experiment.torques_of_law is None or not law.period:
        return False
    return bool(interval < ALONG_LOG.period * law.period)

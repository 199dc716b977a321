"""Gains of a law in another unit, as the law shows that is run along the log.

With a logged torque, both torques are compared, smoothed. Without one, the stated law's torque has
to drive the motion with an inertia and with friction that a motor can have; the score says how much
likelier it does so with the gain in another unit.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.along_log import (
    comparable_torques,
    driven,
)
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.law_motion import SETTINGS as MOTION
from plant.checkup.law_motion import driven_by_law, driven_without_limit
from plant.checkup.law_parts import (
    LawTorque,
    gains_of,
    law_torque,
    other_gains,
    reads_the_log,
)
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.sizes import regressed, unlimited_steps
from plant.checkup.torque_evidence import by_friction
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class GainUnitSettings:
    """When a gain may be in another unit; chosen by hand.

    ``tests/benchmarks/gain_units.py`` counts the gains that are named, and right logs accused.

    Parameters
    ----------
    least : float
        Factor, or its inverse, from which on a gain is in another unit, and no other gain.
    unexplained : float
        Share of the torque of the stated law that the logged torque leaves unexplained, below which
        the gains are not examined.
    least_inertia, inertia : float
        Inertias at the motor [rotor inertias] between which they are not, either.
    deviations : float
        Standard deviations by which an estimated inertia must lie outside.
    nothing : float
        Log odds by which another unit must be likelier than no such gain at all.
    """

    least: float = 50.0
    unexplained: float = 0.05
    least_inertia: float = 0.5
    inertia: float = 60.0
    deviations: float = 4.0
    nothing: float = 3.0


SETTINGS = GainUnitSettings()


class Unit(NamedTuple):
    """Two units that are taken for each other: their names, and their ratio (n,) on a rig."""

    between: str
    ratio: Callable[[Any], Any]

    def ratios(self, experiment: Experiment, joints: Joints) -> tuple[float, ...]:
        """The ratio of these joints, and its inverse; none where it differs, or is no unit's."""
        ratios = np.broadcast_to(self.ratio(experiment.record.rig), experiment.n)
        ratio = ratios[columns_of(joints)]
        # Joints that have several ratios, as of their gears, have rows of their own.
        if np.ptp(ratio) > 1e-9 * ratio[0] or not ratio[0] > SETTINGS.least:
            return ()
        return float(ratio[0]), 1 / float(ratio[0])


_ANGLES = (
    Unit("radians and degrees", lambda rig: 180 / np.pi),
    Unit(
        "pulses and radians of the motor",
        lambda rig: rig.encoder.resolution / (2 * np.pi),
    ),
    Unit(
        "pulses and radians of the joint",
        lambda rig: np.abs(rig.drive.gear) * rig.encoder.resolution / (2 * np.pi),
    ),
    Unit("motor and joint", lambda rig: np.abs(rig.drive.gear)),
    Unit("1 and per cent", lambda rig: 100.0),
)
_TIMES = (
    Unit("seconds and milliseconds", lambda rig: 1e3),
    Unit("seconds and minutes", lambda rig: 60.0),
    Unit("seconds and microseconds", lambda rig: 1e6),
)
_TORQUES = (Unit("N m and mN m", lambda rig: 1e3),)

UNITS: dict[str, tuple[tuple[Unit, ...], str]] = {
    "gain": (_ANGLES + _TORQUES, "N m/pulse of the motor"),
    "derivative": (_ANGLES + _TIMES, "N m s/pulse of the motor"),
    "integral": (_ANGLES + _TIMES, "N m/(pulse s) of the motor, of a cascade in N m/pulse"),
    "position": (_ANGLES[-1:] + _TIMES, "1/s"),
    "speed": (_ANGLES + _TIMES, "N m s/pulse of the motor"),
    "gains": (_ANGLES + _TORQUES, "N m of the motor and pulses"),
}
"""Gains of laws, the units that are mistaken for theirs, and their own."""


def gain_sizes(gain: str) -> Callable[..., tuple[float, ...]]:
    """Sizes of a mistake in one of several gains, by the part that it makes of the torque."""

    def sizes(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
        law = experiment.record.law
        if not gains_of(law, gain) or not gains_of(law, "gains") or not reads_the_log(experiment):
            return ()
        factors = experiment.once(_factors_of_gains)
        if factors is None or gain not in factors:
            return ()
        factor = float(np.median(factors[gain][columns_of(joints)]))
        return (1 / factor,) if factor > 0 else ()

    return sizes


def _factors_of_gains(experiment):
    """Factors (n,) of each gain that bring the law's torque nearest to the logged one, by steps."""
    along = experiment.once(law_torque)
    if along is None:
        return None
    joint = experiment.record.rig.drive.joint_torque(along.torque)
    steps, measured, parts = unlimited_steps(experiment.signals, joint, tuple(along.parts.values()))
    lacking = measured - steps
    return {
        name: regressed(part + lacking, part) for name, part in zip(along.parts, parts, strict=True)
    }


def unit_evidence(gain: str, unit: Unit) -> Callable[..., Iterator[tuple[float, float]]]:
    """Evidence of a gain in another unit: sizes [times the right gain] with their log odds."""

    def evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
        if not gains_of(experiment.record.law, gain):
            return
        gained = _by_torque if experiment.signals.torque is not None else _by_motion
        sizes = unit.ratios(experiment, joints)
        for size in sizes if _dominates(experiment, gain, joints) else sizes[1:]:
            yield size, gained(experiment, gain, joints, size)

    return evidence


def _dominates(experiment, gain, joints):
    """Whether a gain makes most of the law's torque, as one does that is many times too large."""
    along = experiment.once(law_torque)
    if gain == "gains" or along is None:
        return True
    part = along.parts[gain]
    rest = along.torque - part
    squares = (np.square(torque[:, columns_of(joints)]).sum() for torque in (part, rest))
    return bool(np.greater(*squares))


# -- with a logged torque --------------------------------------------------------------------------
def _by_torque(experiment: Experiment, gain: str, joints: Joints, size: float) -> float:
    """How much likelier the logged torque is without a mistake of this size: log odds."""
    compared = experiment.once(_smoothed_torques)
    if compared is None:
        return -np.inf
    stated, corrected, without = (
        _unexplained(compared.logged, torque)
        for torque in (
            compared.law.torque,
            compared.law.without(gain, joints, size),
            compared.law.without(gain, joints, np.inf),
        )
    )
    # A law that explains the torque has nothing in another unit. A factor that is no unit leaves as
    # much unexplained: the mistake is another one.
    right = (stated < SETTINGS.unexplained).all()
    if right or (corrected[columns_of(joints)] > SETTINGS.unexplained).any():
        return -np.inf
    stated, corrected, without = (
        np.log(share + SCORE.steps) for share in (stated, corrected, without)
    )
    gained = compared.equations / 2 * float((stated - corrected).sum())
    # A gain that may as well be none is in no other unit.
    if gained <= compared.equations / 2 * float((stated - without).sum()) + SETTINGS.nothing:
        return -np.inf
    if gained > 0:
        # The torques of samples tell more than the smoothed ones.
        changed = experiment.changed(other_gains(gain)(experiment.record, joints, size))
        gained = max(gained, changed.score - experiment.score)
    return gained


class _Compared(NamedTuple):
    """Logged torque (M, n) and that of the law, smoothed, without means, and their equations."""

    logged: Floats
    law: LawTorque
    equations: float


def _smoothed_torques(experiment):
    """Logged torque and that of the stated law, smoothed; None where the law cannot be run.

    An integral begins at an unknown value, and fast hardware answers each count between samples.
    """
    along = experiment.once(law_torque)
    if along is None:
        return None
    signals = experiment.signals
    kernel = np.hanning(signals.window + 2)[1:-1]

    def smoothed(table):
        # A filter of the law begins at rest: its first samples are another motion's.
        columns = np.column_stack(
            [np.convolve(column, kernel, mode="valid") for column in table[signals.window :].T]
        )
        return columns - columns.mean(axis=0)

    joint = experiment.record.rig.drive.joint_torque(along.torque)
    _, commanded, logged = comparable_torques(signals, joint)
    # What was injected beside the law's torque is no part of it.
    logged = smoothed(logged - (commanded - along.torque))
    parts = {name: smoothed(part) for name, part in along.parts.items()}
    law = LawTorque(smoothed(along.torque), parts)
    return _Compared(logged, law, len(logged) / signals.window)


def _unexplained(logged, torque):
    """Mean square (n,) of the difference of two torques, as a share of both."""
    size = ((logged**2).mean(axis=0) + (torque**2).mean(axis=0)) / 2
    return ((logged - torque) ** 2).mean(axis=0) / np.where(size > 0, size, 1.0)


# -- without one -----------------------------------------------------------------------------------
def _plausible(stated: Experiment, law: Any, gain: str, joints: Joints) -> bool:
    """Whether the law's torque drives these joints, or any of all, as it drives a motor."""
    motions = stated.motions
    if motions is None or any(motion.unexplained >= MOTION.unmoved for motion in motions):
        return False
    # One of several gains in another unit gives a torque that no inertia explains.
    if gains_of(law, "gains") and gain != "gains":
        return True
    rotors = np.maximum(stated.record.rig.drive.motor_inertia, np.finfo(float).tiny)
    least, largest = SETTINGS.least_inertia * rotors, SETTINGS.inertia * rotors
    margin = SETTINGS.deviations * np.array([motion.inertia_std for motion in motions])
    inertia = np.array([motion.inertia for motion in motions])
    possible = (least < inertia + margin) & (inertia - margin < largest)
    return bool(possible[columns_of(joints)].any())


def _by_motion(experiment: Experiment, gain: str, joints: Joints, size: float) -> float:
    """How much likelier the motion is with the law's torque without a mistake of this size."""
    stated, limited = (experiment.once(each) for each in (driven_without_limit, driven_by_law))
    law = experiment.record.law
    if stated is None or _plausible(stated, law, gain, joints):
        return -np.inf
    # In a limit cycle of large gains the amplifiers make the torque that drives the motion.
    if limited is not None and _plausible(limited, law, gain, joints):
        return -np.inf
    along = experiment.once(law_torque)
    drive = experiment.record.rig.drive
    beyond = np.abs(along.torque) > drive.motor_gain * drive.current_limit
    # A gain that is too small takes no motor to its limit.
    if size < 1 and (beyond.mean(axis=0)[columns_of(joints)] > MOTION.at_limit).any():
        return -np.inf
    torque = along.without(gain, joints, size)
    corrected = stated.changed(driven(stated.record, experiment.signals, torque))
    # A factor that is no unit's gives a motor that cannot be, either.
    if not _plausible(corrected, law, "gains", joints):
        return -np.inf
    if not experiment.has_memory:
        return by_friction(experiment, other_gains(gain)(experiment.record, joints, size))
    # A gain that is wrong by less is in no other unit.
    less = along.without(gain, joints, np.sqrt(size))
    less_wrong = stated.changed(driven(stated.record, experiment.signals, less))
    if corrected.score < less_wrong.score + SETTINGS.nothing:
        return -np.inf
    return corrected.score - stated.score

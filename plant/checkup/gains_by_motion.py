"""Gains of a law, and limits of its amplifiers, in a log without a torque.

The law's torque has to drive the motion. A gain is examined by the part that it makes of the
torque: the motion explains the right sum of the parts, and no other. The scale of the whole torque
follows from the friction that the drive states.
"""

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant.checkup.along_log import driven
from plant.checkup.delays import shares_by_friction
from plant.checkup.filtered import centred
from plant.checkup.gain_units import UNITS, Unit, unit_evidence
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.integrals import integral_evidence
from plant.checkup.law_motion import SETTINGS as MOTION
from plant.checkup.law_motion import (
    driven_by_law,
    driven_without_limit,
    likelier_motion,
    no_limit_alone,
    torque_scales,
    unexplained,
)
from plant.checkup.law_parts import gains_of, law_torque, other_gains
from plant.checkup.motor_equation import RIDGE, Equation
from plant.checkup.score import Experiment
from plant.checkup.sizes import SETTINGS as SIZES
from plant.checkup.undo import other_limit
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True)
class MotionSettings:
    """When a motion shows a gain or a limit; chosen by hand.

    Parameters
    ----------
    one_factor : float
        Largest ratio of the factors of a gain at several joints that are one.
    explained : float
        Part of the unexplained share of a torque below which a corrected gain must bring it.
    surely : float
        The same where a share stays that is above that of a right law.
    passes : int
        Fits of a gain, each without the rows that are far from the one before.
    outlying : float
        Residual of such rows [median residuals].
    beyond : float
        Factor from which on no limit is stated too low: the torque is that of other gains.
    """

    one_factor: float = 1.5
    explained: float = 0.2
    surely: float = 0.05
    passes: int = 3
    outlying: float = 6.0
    beyond: float = 10.0


SETTINGS = MotionSettings()


def single_gain_evidence(gain: str) -> Callable[..., Any]:
    """Evidence of one gain of several: by the motion where no torque is logged."""

    def evidence(experiment: Experiment, joints: Joints) -> Any:
        if experiment.signals.torque is not None:
            return integral_evidence(experiment, joints) if gain == "integral" else None
        # A factor between two units is named with them.
        return (
            (size, odds)
            for size, odds in experiment.once(_sizes_by_motion(gain, joints))
            if not any(_same(size, ratio) for ratio in _ratios(experiment, gain, joints))
        )

    return evidence


def unit_of_gain_evidence(gain: str, unit: Unit) -> Callable[..., Any]:
    """Evidence of a gain in another unit: that of the unit alone, or of a factor that is its."""
    by_unit = unit_evidence(gain, unit)

    def evidence(experiment: Experiment, joints: Joints) -> Any:
        odds_of = dict(by_unit(experiment, joints))
        if experiment.signals.torque is None:
            for size, odds in experiment.once(_sizes_by_motion(gain, joints)):
                for ratio in unit.ratios(experiment, joints):
                    if _same(size, ratio):
                        odds_of[ratio] = max(odds, odds_of.get(ratio, -np.inf))
        return tuple(odds_of.items())

    return evidence


def _ratios(experiment, gain, joints):
    """Ratios of the units that are mistaken for that of a gain, and their inverses."""
    units = UNITS.get(gain, ((), ""))[0]
    return [ratio for unit in units for ratio in unit.ratios(experiment, joints)]


def _same(size, ratio):
    return abs(size / ratio - 1) < SIZES.relevant


@functools.cache
def _sizes_by_motion(gain: str, joints: Joints) -> Callable[..., tuple[tuple[float, float], ...]]:
    """The quantity of an experiment: sizes of a mistake in one gain with their log odds."""
    # What an integral held before the log is unknown, and gravity looks like it.
    if gain in ("integral", "gains"):
        return lambda experiment: ()
    return lambda experiment: tuple(_by_motion(experiment, joints, gain))


def _by_motion(experiment: Experiment, joints: Joints, gain: str) -> Iterator[tuple[float, float]]:
    """Yield the size of a mistake in one gain, and its log odds by the motion."""
    law = experiment.record.law
    if not gains_of(law, gain) or not gains_of(law, "gains"):
        return
    # The speed that the position gain makes is nearly the joint's: friction shows it.
    if gain == "position" and not joints:
        yield from _position_by_friction(experiment)
    chosen = columns_of(joints)
    stated = experiment.once(driven_without_limit)
    # Friction and inertia alone show no single gain.
    if stated is None or not (unexplained(stated)[chosen] > MOTION.unmoved).any():
        return
    factors = experiment.once(_factors)[gain][chosen]
    # Noise of counts makes other factors than the right one, and another at each joint.
    if not (factors > 0).all() or factors.max() > SETTINGS.one_factor * factors.min():
        return
    factor = float(np.median(factors))
    record = other_gains(gain)(experiment.record, joints, 1 / factor)
    corrected = experiment.changed(record).once(driven_without_limit)
    if corrected is None:
        return
    before, after = (unexplained(each)[chosen] for each in (stated, corrected))
    # The torque of a limit cycle is another one between two rows: what then explains more of the
    # motion is not yet right.
    right = after < np.maximum(MOTION.unmoved, SETTINGS.surely * before)
    if right.all() and after.sum() < SETTINGS.explained * before.sum():
        yield 1 / factor, likelier_motion(experiment, record)


def _position_by_friction(experiment: Experiment) -> Iterator[tuple[float, float]]:
    """Yield how many times the right one the position gain of a cascade is, and its log odds."""
    stated, along = experiment.once(driven_without_limit), experiment.once(law_torque)
    if stated is None or along is None:
        return
    by_part = _driven_by_part(experiment, stated, along.parts["position"])
    part = np.asarray(by_part.signals.torque)
    for share, odds in shares_by_friction(experiment, part):
        # A gain that is nearly right is right: friction is stated less precisely.
        if SIZES.relevant < abs(share) and share < 1:
            yield 1 / (1 - share), odds


def _factors(experiment: Experiment) -> dict[str, Floats]:
    """Factors (n,) of each gain for which the motion explains most of the law's torque."""
    along = experiment.once(law_torque)
    stated = experiment.once(driven_without_limit)
    if along is None or stated is None:
        return {}
    equations = stated.equations_of_motion

    def factors(part):
        by_part = _driven_by_part(experiment, stated, part)
        columns = (by_part.filtered("torque", i).value for i in range(experiment.n))
        return np.array([1 + _share(*each) for each in zip(equations, columns, strict=True)])

    return {name: factors(part) for name, part in along.parts.items()}


def _driven_by_part(experiment: Experiment, stated: Experiment, part: Floats) -> Experiment:
    """The stretch of `stated` with a part (K, n) of the law's torque as the logged one."""
    # What was injected is beside the law: it is in the whole torque, and in no part of it.
    record = replace(stated.record, injected=None)
    return stated.changed(driven(record, experiment.signals, part))


def _share(equation: Equation, part: Floats) -> float:
    """How many times a part is to be added to a torque, so that the motion explains most of it."""
    # It is slow to import.
    from scipy.linalg import eigh

    columns = np.column_stack([equation.own, equation.free])
    torques = np.column_stack([centred(equation.torque), centred(part)])
    size = np.linalg.norm(torques, axis=0)
    if not size.all():
        return np.nan
    torques /= size
    rows = np.ones(len(torques), dtype=bool)
    for _ in range(SETTINGS.passes):
        solution = np.linalg.lstsq(columns[rows], torques[rows], rcond=None)[0]
        rest = torques - columns @ solution
        # A sum of both whose rest is small beside the sum itself.
        squares, sizes = (table[rows].T @ table[rows] for table in (rest, torques))
        _, sums = eigh(squares, sizes + RIDGE * np.eye(2))
        # Where an amplifier limited the torque, the law's torque did not act.
        residual = np.abs(rest @ sums[:, 0])
        rows = residual <= SETTINGS.outlying * np.median(residual)
    whole, added = sums[:, 0] / size
    return float(added / whole)


def all_gains_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Yield the factor by which all gains are wrong, as friction shows it, and its log odds."""
    gain = "gains" if gains_of(experiment.record.law, "gains") else "gain"
    if experiment.signals.torque is not None or not gains_of(experiment.record.law, gain):
        return
    for factor in torque_scales(experiment, joints):
        record = other_gains(gain)(experiment.record, joints, factor)
        if no_limit_alone(experiment, record):
            yield factor, likelier_motion(experiment, record)


def all_gains(record: Any, joints: Joints, size: float) -> Any:
    """Divide all gains that make a torque by a factor."""
    gain = "gains" if gains_of(record.law, "gains") else "gain"
    return other_gains(gain)(record, joints, size)


def limit_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Yield how many times its stated limit the motion took of an amplifier, and its log odds."""
    if experiment.signals.torque is not None:
        return
    along = experiment.once(law_torque)
    if along is None:
        return
    drive = experiment.record.rig.drive
    shares = np.abs(along.torque).max(axis=0) / (drive.motor_gain * drive.current_limit)
    used = float(shares[columns_of(joints)].max())
    if not 1 < used < SETTINGS.beyond:
        return
    record = other_limit(experiment.record, joints, used)
    changed = experiment.changed(record)
    corrected = changed.once(driven_by_law)
    if corrected is None or (unexplained(corrected)[columns_of(joints)] > MOTION.unmoved).any():
        return
    yield used, likelier_motion(experiment, record)

"""The motion of a log, driven by the torque of its law: what shows a law where no torque is logged.

The torque of the right law accelerates inertia and overcomes friction that a motor can have. The
law is run along the beginning of the log.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from plant.checkup.along_log import SETTINGS as ALONG_LOG
from plant.checkup.along_log import driven, sample_times
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.law_parts import law_torque
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.sizes import SETTINGS as SIZES
from plant.checkup.undo import other_law_period
from plant.parts import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class LawMotionSettings:
    """What a motion shows of its law; chosen by hand.

    Parameters
    ----------
    unmoved : float
        Share of the torque of a right law that the motion leaves unexplained, at most.
    undriven : float
        Share from which on a torque does not drive the motion.
    falling : float
        Share of the samples that a motor is at one of its limits, from which on its joint runs
        away.
    at_limit : float
        Share of the samples that a law commands more than its amplifier gives, from which on its
        gains are not too small.
    beside_limits : float
        Log odds of other gains beside amplifiers without limits, from which on gains are wrong.
    significant : float
        Standard deviations from which on an estimated friction shows a scale of the torque.
    friction : float
        Factor up to which a stated friction is right: its scale is no scale of the torque, and the
        scales of two frictions may differ by its square.
    """

    unmoved: float = 2e-3
    undriven: float = 0.05
    falling: float = 0.75
    at_limit: float = 0.2
    beside_limits: float = 5.0
    significant: float = 4.0
    friction: float = 2.0


SETTINGS = LawMotionSettings()


def driven_by_law(experiment: Experiment) -> Experiment | None:
    """The log with the torque of its law as the logged one; None where it cannot be run."""
    along = experiment.torque_along
    if along is None:
        return None
    return _driven(experiment, experiment.record.rig.drive.motor_torque(along))


def driven_without_limit(experiment: Experiment) -> Experiment | None:
    """The log with the law's torque beside amplifiers that limit nothing as the logged one.

    None where the law cannot be run, or is none whose gains are examined.
    """
    along = experiment.once(law_torque)
    return None if along is None else _driven(experiment, along.torque)


def _driven(experiment: Experiment, torque: Floats) -> Experiment | None:
    """The beginning of the log with this motor torque (K, n) as the logged one."""
    signals = experiment.signals
    times = sample_times(signals, len(torque))
    # A filter of the law begins at rest: its first samples are another motion's.
    record = experiment.record.cut(times[signals.window], times[-1])
    by_law = Experiment(driven(record, signals, torque))
    return by_law if by_law.long_enough and by_law.motions is not None else None


def unexplained(experiment: Experiment) -> Floats:
    """Share (n,) of the torque that the motion leaves unexplained."""
    return np.array([motion.unexplained for motion in experiment.motions or ()])


def likelier_motion(experiment: Experiment, record: Any) -> float:
    """How much likelier the motion of a log is with a changed law, rig or reference: log odds."""
    changed = experiment.changed(record)
    if not experiment.has_memory:
        return changed.score - experiment.score
    stated, corrected = (each.once(driven_by_law) for each in (experiment, changed))
    if stated is None or corrected is None:
        return -np.inf
    return corrected.score - stated.score


def runs_away(experiment: Experiment) -> Bools:
    """Whether each motor (n,) is at the same limit of its amplifier for most of the log.

    One that is too weak for its load is, and its counts follow nothing. The torque is the logged
    one, or else that of the law.
    """
    drive, torque = experiment.record.rig.drive, experiment.signals.torque
    if torque is None and experiment.has_memory:
        along = experiment.torque_along
        torque = None if along is None else drive.motor_torque(along)
    elif torque is None:
        torque = experiment.commanded
    if torque is None:
        return np.zeros(experiment.n, dtype=bool)
    limit = (1 - SIZES.at_limit) * drive.motor_gain * drive.current_limit
    at_one = np.maximum((torque >= limit).mean(axis=0), (torque <= -limit).mean(axis=0))
    return np.asarray(at_one > SETTINGS.falling)


def contradicted_by_motion(stated: Experiment, changed: Experiment, joints: Joints) -> bool:
    """Whether the motion of a log without a torque contradicts a change of the log.

    The stated law drives the motion, and the changed one not: a loop that lags far behind its
    reference follows it as one of another scale does. Or neither drives a joint that runs away.
    """
    if stated.signals.torque is not None:
        return False
    # The score has the torque of a law without memory.
    before, after = (
        each.once(driven_by_law) if each.has_memory else each for each in (stated, changed)
    )
    if before is None or before.motions is None or after is None or after.motions is None:
        return False
    chosen = columns_of(joints)
    away = runs_away(stated)[chosen]
    stated_share, changed_share = (unexplained(each)[chosen] for each in (before, after))
    undriven = runs_away(changed)[chosen] | (changed_share > SETTINGS.undriven)
    if (away & undriven).any():
        return True
    drives = (stated_share < SETTINGS.unmoved).all()
    return bool(stated.has_memory and drives and (changed_share > SETTINGS.unmoved).any())


def no_limit_alone(experiment: Experiment, record: Any) -> bool:
    """Whether other gains explain a motion better than amplifiers that limit nothing.

    A smaller torque meets a limit that is stated too low less often: that is no sign of gains.
    """
    if not experiment.has_memory:
        return True
    stated = experiment.once(driven_without_limit)
    corrected = experiment.changed(record).once(driven_by_law)
    if stated is None or corrected is None:
        return False
    return bool(corrected.score - stated.score > SETTINGS.beside_limits)


def torque_scales(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Estimated over stated friction, where the law's torque drives the motion: one scale, or none.

    None where the stated friction may be right, where the scales of several frictions differ, where
    no Coulomb friction shows one, or where the motion needs another torque.
    """
    stated = experiment.once(driven_without_limit)
    if stated is None or (unexplained(stated) > SCORE.like).any():
        return ()
    drive = experiment.record.rig.drive

    def significant(name: str) -> list[float]:
        return [
            getattr(motion, name) / getattr(drive, name)[i]
            for i, motion in enumerate(stated.motions or ())
            if not joints or i in joints
            if getattr(drive, name)[i]
            if getattr(motion, name) > SETTINGS.significant * getattr(motion, f"{name}_std")
        ]

    # Late counts change the viscous friction alone, so that it shows no scale by itself.
    coulomb = significant("coulomb")
    scales = coulomb + significant("viscous")
    if not coulomb or max(scales) > SETTINGS.friction**2 * min(scales):
        return ()
    scale = float(np.exp(np.median(np.log(scales))))
    return () if 1 / SETTINGS.friction < scale < SETTINGS.friction else (scale,)


def law_periods(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """The law's stated period [intervals of the log], where it is not one interval."""
    period = getattr(experiment.record.law, "period", None)
    if not period or not experiment.has_memory:
        return ()
    intervals = period / experiment.signals.interval
    alike = 1 / ALONG_LOG.period < intervals < ALONG_LOG.period
    return () if alike else (float(intervals),)


def law_period_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of a law that has the log's period; None if torque is logged."""
    if experiment.signals.torque is not None:
        return None
    return tuple(
        (size, likelier_motion(experiment, other_law_period(experiment.record, joints, size)))
        for size in law_periods(experiment, joints)
    )

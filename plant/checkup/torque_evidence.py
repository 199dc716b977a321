"""Evidence that a torque and the law's torque give, beside the score."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from plant.checkup.delays import delays
from plant.checkup.filtered import centred
from plant.checkup.hypothesis import Joints
from plant.checkup.law_motion import driven_by_law, likelier_motion, no_limit_alone, torque_scales
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.sizes import friction_ratios, regressed
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.checkup.undo import as_commanded, gains_in_ampere, with_gravity
from plant.parts import frozen_settings


@frozen_settings
class ModelSettings:
    """When a torque is that of a model; all chosen by hand.

    Parameters
    ----------
    frictionless : float
        Dry friction of a torque over that of the law's, below which it has none: drives are
        modelled with half their friction.
    certain : float
        Standard deviations from which on the dry friction of the law's torque is significant.
    lacking : float
        Logarithm of the largest ratio of friction's scale to one over the motor gain, up to which
        the law's gains may lack that.
    constant : float
        Share of the law's torque below which a logged torque is constant: gear and gain are no
        factor of a million.
    """

    frictionless: float = 0.2
    certain: float = 3.0
    lacking: float = 0.7
    constant: float = 1e-6


MODEL = ModelSettings()


def gains_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds that gains are in A, by score and viscous friction; None if torque is logged."""
    if experiment.once(delays) is None or not hasattr(experiment.record.law, "gain"):
        return None
    record = gains_in_ampere(experiment.record, joints, 1.0)
    if not _scaled_by_motor_gain(experiment) or not no_limit_alone(experiment, record):
        return ()
    return ((1.0, by_friction(experiment, record)),)


def _scaled_by_motor_gain(experiment):
    """Whether friction shows gains that lack the motor gain."""
    lacking = 1 / np.median(experiment.record.rig.drive.motor_gain)
    scales = torque_scales(experiment, ())
    return any(abs(np.log(scale / lacking)) < MODEL.lacking for scale in scales)


def by_friction(experiment: Experiment, record: Any) -> float:
    """How much likelier a log is with other gains, by its score and by its viscous friction."""
    gain = likelier_motion(experiment, record)
    # Late counts change the viscous friction of a law with memory as other gains do.
    if experiment.has_memory:
        return gain
    before, after = experiment.once(delays), delays(experiment.changed(record))
    # Viscous friction alone is a parameter; gains change inertia and Coulomb friction, too.
    if before is not None and after is not None and gain > 0:
        friction = (each.by_speed / each.speed_std for each in (before, after))
        gain += float(np.subtract(*(np.nansum(ratio**2) / 2 for ratio in friction)))
    return gain


def viscous_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of another viscous friction, which adds torque with the speed but not the jerk."""
    if experiment.signals.torque is not None:
        return None
    delay = experiment.once(delays)
    i = joints[0]
    stated = experiment.record.rig.drive.viscous[i]
    # No friction is negative: the equation of motion lacks a torque that looks like it.
    if delay is None or not stated or not delay.viscous[i] > 0:
        return ()
    size = friction_ratios("viscous")(experiment, joints)
    return ((size[0], (delay.by_speed[i] / delay.speed_std[i]) ** 2 / 2),) if size else ()


def _differences(experiment):
    """Yield two filtered torques of each joint: the commanded one, and the logged one less it.

    Each (M,) [N m], less its mean, behind the joint's index; nothing of a law with memory, or of a
    joint whose command does not change.
    """
    if experiment.commanded is None or experiment.signals.torque is None:
        return
    changes = np.ptp(experiment.commanded, axis=0) > 0
    for i in np.flatnonzero(changes & experiment.long_enough):
        commanded, logged = (
            centred(experiment.filtered(name, i).value) for name in ("commanded", "torque")
        )
        yield i, commanded, logged - commanded


def _likelier(experiment, commanded, difference, columns):
    """Coefficients of columns (M, k) of a difference of torques, and their log likelihood ratio."""
    columns = columns - columns.mean(axis=0)
    size = np.maximum(np.sqrt((columns**2).sum(axis=0)), np.finfo(float).tiny)
    value = np.linalg.lstsq(columns / size, difference, rcond=None)[0] / size
    floor = SCORE.command * (commanded**2).sum()
    shares = [(x**2).sum() + floor for x in (difference, difference - columns @ value)]
    return value, experiment.filter.equations / 2 * float(np.log(shares[0] / shares[1]))


def gravity_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of gravity that a logged torque lacks, by slow steps of a law with memory.

    None of another law: the score compares its torque, not steps. Quick steps of the torque are
    those of the law, as gravity hardly changes meanwhile.
    """
    if experiment.slow_command is None:
        return None
    changed = experiment.changed(with_gravity(experiment.record, joints, 1.0))
    before, after = (np.asarray(each.slow_command) for each in (experiment, changed))
    # Where the state of the law before the log is unknown, so may be its torque.
    if (after > SCORE.like * before).any():
        return ()
    windows = experiment.filter.equations / REGRESSION.per_window
    explained = np.log((before + SCORE.steps) / (after + SCORE.steps))
    return ((1.0, float(windows / 2 * explained.sum())),)


def zeros_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a torque that was not logged: zero in each of the independent equations."""
    torque = experiment.signals.torque
    if torque is not None and not torque.any() and experiment.filter.rows.size:
        yield 1.0, float(experiment.n * experiment.filter.equations)


def rate_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of a logged torque that grows with the rate of the error, as of PD stated as P.

    None under a law with memory: the steps of its torque tell.
    """
    rates, odds = list[float](), 0.0
    if experiment.signals.reference is None:
        return ()
    if experiment.has_memory:
        return None if experiment.command is not None else ()
    for i, commanded, difference in _differences(experiment):
        reference, counts = (experiment.filtered(name, i) for name in ("reference", "counts"))
        gain = regressed(commanded, centred(reference.value - counts.value))
        column = gain * (reference.speed - counts.speed)
        value, likelier = _likelier(experiment, commanded, difference, column[:, None])
        rates.append(float(value[0]))
        odds += likelier
    return ((float(np.median(rates)), odds),) if rates and min(rates) > 0 else ()


def model_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a logged torque that is inverse dynamics: it has no friction, the law's has."""
    logged, by_law = _both_torques(experiment)
    if logged is None or by_law is None or not logged.long_enough:
        return
    equations = logged.equations_of_motion
    if equations is None or logged.motions is None or by_law.motions is None:
        return
    torques = [
        np.column_stack([centred(each.filtered("torque", i).value) for i in range(each.n)])
        for each in (by_law, logged)
    ]
    if not _of_the_same_joints(*torques):
        return
    odds, lacking = 0.0, 0.0
    for i, (motion, measured) in enumerate(zip(logged.motions, by_law.motions, strict=True)):
        commanded, torque = (motors[:, i] for motors in torques)
        # Beside the size of the torque, so that units do not count.
        size = np.std(torque)
        # A torque that hardly changes, as at the amplifier's limit or at rest, is no model's.
        if not np.std(commanded) > 0 or size < MODEL.constant * np.std(commanded):
            return
        unit = np.std(commanded) / size
        friction, std = unit * motion.coulomb, unit * motion.coulomb_std
        if not friction < MODEL.frictionless * measured.coulomb + 2 * std:
            return
        lacking += ((measured.coulomb - friction) / np.hypot(std, measured.coulomb_std)) ** 2
        columns = np.column_stack([equations[i].own, equations[i].free])
        likelier = _likelier(logged, commanded, torque - commanded, columns)[1]
        odds += likelier - columns.shape[1]
    if lacking > MODEL.certain**2:
        yield 1.0, odds


def _of_the_same_joints(commanded, logged):
    """Whether logged torques (M, n) are most like the law's in their order, and of its signs."""
    # It is slow to import.
    from scipy.optimize import linear_sum_assignment

    sizes = np.outer(np.linalg.norm(logged, axis=0), np.linalg.norm(commanded, axis=0))
    alike = logged.T @ commanded / np.maximum(sizes, np.finfo(float).tiny)
    joints, likest = linear_sum_assignment(-np.abs(alike))
    return bool((joints == likest).all() and (np.diag(alike) > 0).all())


def _both_torques(experiment):
    """A stretch of the log with the logged torque, and with that of its law; None without both."""
    if experiment.signals.torque is None:
        return None, None
    if not experiment.has_memory:
        commanded = as_commanded(experiment.record, (), 1.0)
        return experiment, experiment.changed(commanded)
    by_law = experiment.once(driven_by_law)
    if by_law is None:
        return None, None
    record = experiment.record
    t = by_law.record.t
    return Experiment(record.cut(t[0], t[-1])), by_law

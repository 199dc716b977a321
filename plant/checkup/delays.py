"""Counts and torques that are late: delays that are tried, and the evidence for one."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.along_log import at_times, sample_times, steps_of_torque
from plant.checkup.filtered import centred
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.law_motion import driven_without_limit, likelier_motion, unexplained
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.sizes import regressed
from plant.checkup.torque_regression import TorqueRegression, least_squares
from plant.checkup.undo import counts_in_time, reference_in_time
from plant.laws import block_of
from plant.parts import Floats, frozen_settings


@frozen_settings
class DelaySettings:
    """What a delay is told from; all chosen by hand.

    Parameters
    ----------
    unseen : float
        Delay [samples] up to which torque and motion alone do not show it.
    viscous_spread : float
        Standard deviation of the viscous friction that a rig states, relative: it doubles with the
        temperature of the grease.
    least_lag : float
        Lag [samples] that a law leaves by what its model lacks.
    least : float
        Delay [samples] below which other friction, or another law, is the likelier cause of the
        friction that a law with memory finds.
    shortest : float
        Duration [s] of a log from which on friction shows a delay under a law with memory. In a
        shorter one, gravity and what an integral held change as friction does.
    apart : float
        Mean square of the joints' delays beside their common one [standard deviations], below which
        they are one.
    """

    unseen: float = 2.5
    viscous_spread: float = 0.5
    least_lag: float = 0.2
    least: float = 0.5
    shortest: float = 1.0
    apart: float = 2.0


SETTINGS = DelaySettings()


DELAYS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
"""Samples by which counts may be late; the best is refined."""


BETWEEN_ROWS = (0.25, 0.75, 1.25, 1.5, 1.75, 2.25, 2.5)
"""Delays between these, of counts that a law with memory read. In logs of ``spoilers.late`` the
torque of a PID is that of the log within 0.2 samples of the right delay."""


TORQUE_DELAYS = (-1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Samples by which torques may be late. No cause makes them early by much; longer delays follow
from the log."""


ROWS = (-2.0, -1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
"""Samples by which references may be late, where the torque shows the right row from afar."""


def delay_sizes(sizes: tuple[float, ...]) -> Callable[..., tuple[float, ...]]:
    """Delays that are tried: those that torque and motion alone can show, where no law helps."""

    def tried(experiment, joints):
        # Between two rows that are tried a law with memory may give quite another torque. Several
        # joints are late by one delay in most logs, so that the others need no fine grid.
        if experiment.has_memory and experiment.torques_of_law is not None and not joints:
            return tuple(sorted({*sizes, *BETWEEN_ROWS}))
        if experiment.torques_of_law is not None or experiment.signals.torque is None:
            return sizes
        # Torque is held between samples, drives take time, and feedback has noise.
        return tuple(size for size in sizes if size > SETTINGS.unseen)

    return tried


def torque_delays(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Delays of torques that are tried: short ones, and that at which they are most like the law's.

    Where no law tells the torque, all torques are tried with some longer delays.
    """
    sizes = delay_sizes(TORQUE_DELAYS)(experiment, joints)
    longest = SCORE.latest / experiment.signals.interval
    correlations = experiment.once(_correlations)
    if correlations is None:
        if joints:
            return sizes
        doubled = sizes[-1] * 2.0 ** np.arange(1, 5)
        return (*sizes, *doubled[doubled < longest].tolist())
    like = correlations[: int(longest) + 2, columns_of(joints)].sum(axis=1)
    size = float(like.argmax())
    # Its neighbours bound the search for the best size.
    return tuple(sorted({*sizes, size - 1.0, size, size + 1.0})) if size > 1 else sizes


def _correlations(experiment):
    """Correlation (K, n) of the logged torques with those of the law so many samples before."""
    from scipy.signal import correlate

    along = None if experiment.torques_of_law is None else experiment.torque_along
    if along is None or not np.isfinite(along).all():
        return None
    signals = experiment.signals
    drive = experiment.record.rig.drive
    t = sample_times(signals, len(along))
    logged = drive.joint_torque(at_times(t, signals.t, np.asarray(signals.torque)))
    columns = []
    for law, torque in zip(along.T, logged.T, strict=True):
        before, after = (x - x.mean() for x in (law, torque))
        size = np.sqrt(np.mean(before**2) * np.mean(after**2)) or 1.0
        columns.append(correlate(after, before, method="fft")[len(along) - 1 :] / size)
    return np.transpose(columns)


def reference_delays(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Delays of references that are tried: that for which the law gives the logged torque best."""
    delay = experiment.once(_reference_delay)
    if delay is None or np.isnan(delay[columns_of(joints)]).all():
        return ()
    # A sampled law answers the noise of each count, so its torque shows the right row alone.
    tried = () if joints or (np.asarray(experiment.command) < SCORE.like).all() else ROWS
    nearest = float(np.round(np.nanmedian(delay[columns_of(joints)])))
    # Its neighbours bound the search for the best size.
    near = [nearest + row for row in (-2.0, -1.0, 0.0, 1.0, 2.0)] if nearest else []
    return tuple(sorted({*tried, *near} - {0.0}))


def _reference_delay(experiment):
    """Delay (n,) of the references [samples], by the torque that the law adds per sample.

    None where no law tells the torque.
    """
    if experiment.torques_of_law is None:
        return None
    later = experiment.changed(reference_in_time(experiment.record, (), 1.0))
    if experiment.has_memory:
        # Noise of counts hides a delay in the steps from sample to sample.
        (law, logged), (moved, _) = (
            steps_of_torque(experiment.signals, each.torque_along, slow=True)
            for each in (experiment, later)
        )
    else:
        columns = experiment.commanded, experiment.signals.torque, later.commanded
        law, logged, moved = map(centred, columns)
    delay = regressed(logged - law, moved - law)
    # A reference that rests is late by nothing, or by anything.
    return np.where((moved != law).any(axis=0), delay, np.nan)


class Delay(NamedTuple):
    """Estimates of a delay [samples] with their standard deviations, joint by joint (n,).

    `by_jerk`: of the torque that grows with the jerk of late counts. `by_speed`: of the torque that
    grows with their speed, beyond the stated viscous friction, which may be another by a factor.
    `viscous`: all of that torque as friction [N m s/rad], below zero where counts are early, or the
    equation of motion lacks a torque.
    """

    by_jerk: Floats
    jerk_std: Floats
    by_speed: Floats
    speed_std: Floats
    viscous: Floats


def delays(experiment: Experiment) -> Delay | None:
    """Delays that the torque of the stated law shows, where no torque is logged.

    None where the law cannot be run along the log.
    """
    if experiment.signals.torque is not None or not experiment.signals.long_enough:
        return None
    law = experiment.once(_law_and_sample)
    if law is None:
        return None
    signals, torque, per_sample = law
    columns = np.full((5, experiment.n), np.nan)
    stated = experiment.record.rig.drive.viscous
    for i in range(experiment.n):
        fit = TorqueRegression.of(signals, torque, i)
        if fit is not None and per_sample[i]:
            spread = np.hypot(fit.viscous_std, SETTINGS.viscous_spread * stated[i])
            speed = (fit.viscous - stated[i]) / per_sample[i]
            speed_std = spread / per_sample[i]
            columns[:, i] = fit.delay, fit.delay_std, speed, speed_std, fit.viscous
    return Delay(*columns)


def _law_and_sample(experiment):
    """Signals, the torque (M, n) of the law, and the friction (n,) that looks like a delay.

    This is the viscous friction [N m s/rad] for one sample of delay. None of a law that cannot be
    run, or whose torque the motion does not need.
    """
    signals = experiment.signals
    if not experiment.has_memory:
        if experiment.commanded is None:
            return None
        # The gain [N m/pulse] of a law without memory turns a shift of the counts into torque.
        error = np.asarray(signals.reference) - signals.counts
        gain = (error * experiment.commanded).sum(axis=0)
        gain /= np.maximum((error**2).sum(axis=0), 1e-300)
        angle = experiment.record.rig.encoder.to_angle(np.ones(experiment.n))
        return signals, experiment.commanded, np.abs(gain * signals.interval / angle)
    if feeds_forward(experiment) or np.ptp(signals.t) < SETTINGS.shortest:
        return None
    stated = experiment.once(driven_without_limit)
    late = experiment.changed(counts_in_time(experiment.record, (), -1.0))
    late = late.once(driven_without_limit)
    if stated is None or late is None or (unexplained(stated) > SCORE.like).any():
        return None
    signals, torque = stated.signals, np.asarray(stated.signals.torque)
    per_sample = _viscous(signals, np.asarray(late.signals.torque) - torque)
    return signals, torque, np.abs(per_sample)


def _viscous(signals, torque):
    """Viscous friction (n,) [N m s/rad] that a torque (M, n) looks like; 0 where it is none."""
    fits = [TorqueRegression.of(signals, torque, i) for i in range(signals.n)]
    return np.array([0.0 if fit is None else fit.viscous for fit in fits])


def shares_by_friction(experiment: Experiment, part: Floats) -> Iterator[tuple[float, float]]:
    """Yield the share of a part of the law's torque that is too much, with its log odds.

    `part` (M, n): motor torque, at the samples of `driven_without_limit`. Several joints have one
    share that leaves each the stated viscous friction.
    """
    stated, delay = experiment.once(driven_without_limit), experiment.once(delays)
    if stated is None or delay is None:
        return
    _, _, per_sample = experiment.once(_law_and_sample)
    viscous = _viscous(stated.signals, part)
    # A part that looks like no friction at a joint has no share there.
    samples = per_sample / np.where(viscous == 0, np.nan, viscous)
    yield from _of_all(samples * delay.by_speed, np.abs(samples) * delay.speed_std)


def delay_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of late counts; None if torque is logged, because the score then shows them.

    A law with memory that feeds the acceleration forward is an exception: there the lag behind the
    reference is evidence, with a logged torque, too.
    """
    logged = experiment.signals.torque is not None
    if experiment.signals.reference is None:
        return None if logged else ()
    if experiment.has_memory and (logged or feeds_forward(experiment)):
        return _lag_evidence(experiment, joints) or (None if logged else ())
    if logged:
        return None
    delay = experiment.once(delays)
    if delay is None:
        return ()
    chosen = columns_of(joints)
    if experiment.has_memory:
        return () if joints else tuple(_delay_of_all(experiment, delay))
    jerk, jerk_std = delay.by_jerk[chosen], delay.jerk_std[chosen]
    values = np.concatenate([jerk, delay.by_speed[chosen]])
    stds = np.concatenate([jerk_std, delay.speed_std[chosen]])
    for value, gain in _common(values, stds):
        # Nothing makes counts early by a part of a row.
        if -1 < value < 0:
            return ()
        # Torque that grows with the speed but not with the jerk is friction.
        if np.nansum((jerk**2 - (jerk - value) ** 2) / jerk_std**2) > 0:
            return ((value, gain),)
    return ()


def reference_delay_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of late references; None if torque is logged, because the score then shows them.

    Without a torque, a reference that is late looks like counts that are early.
    """
    if experiment.signals.torque is not None:
        return None
    return tuple((-size, odds) for size, odds in delay_evidence(experiment, joints) or ())


def _delay_of_all(experiment, delay):
    """Yield the delay that all joints share under a law with memory, with its log odds."""
    for value, gain in _of_all(delay.by_speed, delay.speed_std):
        # Speeds are smoothed over a window; what looks like a longer delay has another cause.
        if SETTINGS.least <= abs(value) <= experiment.signals.window:
            in_time = counts_in_time(experiment.record, (), value)
            yield value, max(gain, likelier_motion(experiment, in_time))


def _of_all(values, stds):
    """Yield the size that the friction of several joints shows alike, with its log odds.

    A single joint may have another friction than the stated one, so at least two must show the size
    beyond their standard deviations. The size (n,) of a joint at rest is NaN.
    """
    for value, gain in _common(values, stds):
        apart = np.nansum(((values - value) / stds) ** 2)
        shown = np.abs(values) > stds
        if shown.sum() > 1 and apart < SETTINGS.apart * np.isfinite(values).sum():
            yield value, gain


def _common(values, stds):
    """The value that several estimates share, with its log odds against zero."""
    weight = np.nan_to_num(1 / np.maximum(stds, 1e-9) ** 2)
    if not weight.sum():
        return ()
    value = float(np.nansum(weight * values) / weight.sum())
    gain = float(np.nansum(weight * (values**2 - (values - value) ** 2)) / 2)
    return ((value, gain),)


def _lag_evidence(experiment, joints):
    """Log odds of counts that lag, under a law that feeds the reference acceleration forward."""
    # Any other law needs an error to act, and lags by itself.
    if not feeds_forward(experiment):
        return ()
    values, stds = np.array(
        [lag(experiment, i, friction=True) for i in joints or range(experiment.n)]
    ).T
    # What a law leaves of friction looks like a small lag. A lag is linear in the speed within the
    # window over which speeds are smoothed; a longer one has another cause.
    moving = values[np.isfinite(stds)]
    largest = np.abs(moving).max(initial=0.0)
    if (
        not SETTINGS.least_lag <= largest <= experiment.signals.window
        or np.ptp(moving) > SETTINGS.least_lag
    ):
        return ()
    return _common(values, stds)


def feeds_forward(experiment: Experiment) -> bool:
    """Whether the law's torque depends on the acceleration of the reference."""
    law = experiment.record.law
    return law is not None and block_of(law, experiment.record.rig).depends("asked", "qdd")


def lag(experiment: Experiment, i: int, *, friction: bool = False) -> tuple[float, float]:
    """Samples by which the counts of joint i lag behind the reference, and standard deviation.

    NaN and infinity of a reference that rests.
    """
    signals = experiment.signals
    reference, counts = (experiment.filtered(name, i) for name in ("reference", "counts"))
    if not np.mean(reference.speed**2) > experiment.filter.speed_noise:
        return np.nan, np.inf
    columns = [reference.speed, np.ones(len(counts.value))]
    # Friction that the law lacks is an error with the sign of the speed.
    if friction:
        columns.append(reference.direction)
    value, std = least_squares(
        np.column_stack(columns), reference.value - counts.value, signals.window
    )
    return value[0] / signals.interval, std[0] / signals.interval

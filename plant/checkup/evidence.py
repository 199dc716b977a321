"""Sizes of mistakes that a log suggests, and evidence that the score does not have."""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from plant.checkup.along_log import at_times, sample_times
from plant.checkup.filtered import centred
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.quantisation import grid, noted_steps
from plant.checkup.rounding import rounding_log_odds
from plant.checkup.score import SETTINGS, Experiment
from plant.checkup.stamps import chance_of_period, unit_of_time
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.checkup.torque_regression import TorqueRegression, least_squares
from plant.checkup.undo import (
    SLACK,
    as_commanded,
    counted_edges,
    counted_in_steps,
    gains_in_ampere,
    other_resolution,
    scaled_counts,
    scaled_reference,
    with_gravity,
)
from plant.laws import block_of
from plant.parts import Floats

# -- sizes that the log itself suggests ------------------------------------------------------------
# A factor nearer to one is within what rounding and an imperfect undo cause.
_RELEVANT = 0.03

# A scale so near to one is that of a gear; a farther one is that of a unit, which motion tells.
_NEAR = 0.3

# Scales that are tried beside that of the motion, in parts of the share of the speed that lags. The
# torque tells a scale to about half of that share, so the steps are half as wide.
_GRID = np.linspace(-1.5, 1.5, 13)

# Scales nearer to one than this are not tried: a gear of 101 that is stated as 100 is far beyond.
_COUNTED = 0.003

# A loop that lags by a larger share shows no scale.
_LAGS = 0.1


def _ratios(numerator, denominator):
    """Regression (n,) of one table of columns on another; 1 where there is nothing."""
    power = (denominator**2).sum(axis=0)
    ratio = (numerator * denominator).sum(axis=0) / np.where(power > 0, power, 1.0)
    return np.where((power > 0) & (ratio != 0), ratio, 1.0)


def _speeds(experiment, name):
    return np.column_stack([experiment.filtered(name, i).speed for i in range(experiment.n)])


def slopes(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Scales of the counts to try: their speed over that of the reference, or near that."""
    return _slopes(experiment, joints, scaled_counts)


def inverse_slopes(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Scales of the reference to try: its speed over that of the counts, or near that."""
    return tuple(sorted(1 / slope for slope in _slopes(experiment, joints, scaled_reference)))


def _following(experiment, joints):
    """Speed of the counts over that of the reference, and the share of speed it does not explain.

    Medians of several joints; 1 and 0 without a reference.
    """
    if experiment.signals.reference is None:
        return 1.0, 0.0
    reference, counts = _speeds(experiment, "reference"), _speeds(experiment, "counts")
    ratio = _ratios(counts, reference)
    power = (reference**2).mean(axis=0)
    left = ((counts - ratio * reference) ** 2).mean(axis=0)
    # Beside a goal that rests the counts move by noise alone.
    moves = power > experiment.filter.speed_noise
    ratio[~moves] = 1.0
    lag = np.sqrt(np.divide(left, power, out=np.zeros_like(power), where=moves))
    columns = columns_of(joints)
    return float(np.median(ratio[columns])), float(np.median(lag[columns]))


def _slopes(experiment, joints, undo):
    """Speeds of the counts over that of the reference to try: one, or a grid where a law helps.

    A loop that lags, or is soft, follows at another scale than one. The torque of a law shows the
    scale far better, but only near the true one.
    """
    slope, lag = _following(experiment, joints)
    # A scaled column is one of whole counts, without the reference behind them. If the law gives
    # the torque from such a column, the scale is right.
    counted = experiment.changed(undo(experiment.record, joints, 1.0))
    command = counted.command
    unlike = command is not None and (command[columns_of(joints)] > SETTINGS.unlike).any()
    if not unlike or lag > _LAGS or abs(slope - 1) > _NEAR:
        return _positive(slope)
    sizes = slope * (1 + lag * _GRID)
    if len(joints) == 1:
        # Most gears are whole numbers. A tight loop gives its torque at the true scale alone, which
        # no grid meets: try whole numbers, too. For a soft loop, or a gear in rad/m, the range
        # holds too many whole numbers, and the grid suffices.
        gear = abs(float(experiment.record.rig.drive.gear[joints[0]]))
        first, end = np.ceil(gear * sizes[0]), gear * sizes[-1]
        if end - first < len(_GRID):
            sizes = np.union1d(sizes, np.arange(first, end) / gear)
    return tuple(sizes[np.abs(sizes - 1) > _COUNTED].tolist())


def torque_ratios(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Logged over commanded torque: of a joint, or the median of all."""
    if experiment.has_memory:
        # A memory is unknown, but hardly changes the steps from sample to sample.
        steps = experiment.torques_of_law
        if steps is None:
            return ()
        ratio = _ratios(steps[1], steps[0])
        return _positive(np.median(ratio[columns_of(joints)]))
    commanded, logged = experiment.commanded, experiment.signals.torque
    if commanded is None or logged is None:
        return ()
    drive = experiment.record.rig.drive
    limit = drive.motor_gain * drive.current_limit
    # An amplifier at its limit shows its limit, and no gain.
    limited = np.abs(np.abs(logged) / limit - 1) < _AT_LIMIT
    ratio = np.array(
        [
            _ratios(centred(logged[rows, i]), centred(commanded[rows, i]))
            for i, rows in enumerate(~limited.T)
        ]
    )
    return _positive(np.median(ratio[columns_of(joints)]))


def command_ratios(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Commanded over logged torque."""
    return tuple(1 / ratio for ratio in torque_ratios(experiment, joints))


def rated_shares(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Rated torque over the limit, one share for all joints, if the log has per mille of rated.

    Nothing if one factor fits the torques of all joints: then a wrong scale explains them.
    """
    ratios = [torque_ratios(experiment, (i,)) for i in range(experiment.n)]
    if len(ratios) < 2 or not all(ratios):
        return ()
    # Of joints with unequal limits one share of the limits tells per mille from a mere factor.
    ratio = np.ravel(ratios)
    shares = 1e3 / (ratio * experiment.record.rig.drive.torque_limit())
    alike = [np.ptp(np.log(values)) < _RELEVANT for values in (shares, ratio)]
    share = float(np.median(shares))
    # The limit itself has a row.
    return (share,) if alike == [True, False] and share < 1 - _RELEVANT else ()


def common_step(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Step of the counts of all joints, where it is one number of pulses above 1."""
    steps = [grid(column) for column in experiment.signals.counts.T]
    return (steps[0],) if min(steps) > 1 and np.ptp(steps) < SLACK * steps[0] else ()


def used_limits(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Largest logged torque of a joint as a share of the amplifier's limit."""
    drive = experiment.record.rig.drive
    torque = experiment.signals.torque
    i = joints[0]
    if torque is None or not np.isfinite(drive.current_limit[i]):
        return ()
    largest = float(np.abs(torque[:, i]).max())
    commanded = experiment.commanded
    if commanded is not None:
        # An amplifier is at its limit wherever the command is beyond it.
        beyond = np.abs(commanded[:, i]) > (1 + _AT_LIMIT) * largest
        at_limit = np.abs(torque[beyond, i]) > (1 - _AT_LIMIT) * largest
        if not at_limit.size or at_limit.mean() < _MOSTLY:
            return ()
    share = largest / float(drive.motor_gain[i] * drive.current_limit[i])
    return (share,) if share < 1 - _RELEVANT else ()


def friction_ratios(name: str) -> Callable[..., tuple[float, ...]]:
    """Estimated over stated friction of a joint."""

    def sizes(experiment, joints):
        stated = getattr(experiment.record.rig.drive, name)[joints[0]]
        if experiment.motions is None or not stated:
            return ()
        return _positive(getattr(experiment.motions[joints[0]], name) / stated)

    return sizes


def _positive(ratio):
    # A factor of one changes nothing, and signs have rows of their own.
    return (float(ratio),) if ratio > 0 and abs(ratio - 1) > _RELEVANT else ()


# Relative distance from the amplifier's limit within which a torque is limited.
_AT_LIMIT = 0.02

# Share of the commands beyond a limit at which the torque must be at that limit. Counts that are
# late spoil the other commands.
_MOSTLY = 0.5


DELAYS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
"""Samples by which counts may be late; the best is refined."""

BETWEEN_ROWS = (0.25, 0.75, 1.25, 1.5, 1.75, 2.25, 2.5)
"""Delays between these, of counts that a law with memory read. In logs of ``spoilers.late`` the
torque of a PID is that of the log within 0.2 samples of the right delay."""

TORQUE_DELAYS = (-1.0, -0.5, 0.5, 1.0, 2.0, 4.0, 8.0)
"""The same of torques, which no cause makes early by much. Longer delays follow from the log."""


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
        return tuple(size for size in sizes if size > _UNSEEN)

    return tried


# Samples of delay that torque and motion alone do not show.
_UNSEEN = 2.5


# -- evidence of other kinds -----------------------------------------------------------------------
def rounding_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of the convention that is not stated, by the width of the cell at zero."""
    encoder = experiment.record.rig.encoder
    # Positions that were no whole pulses were rounded by the reader, not by a counter.
    if encoder.smooth or noted_steps(experiment.record):
        return
    odds = rounding_log_odds(experiment.signals)
    if odds is not None:
        yield 1.0, -odds if encoder.rounding == "fix" else odds


class Delay(NamedTuple):
    """Estimates of a delay [samples] with their standard deviations, joint by joint (n,).

    `by_jerk`: of the torque that grows with the jerk of late counts. `by_speed`: of the torque that
    grows with their speed, beyond the stated viscous friction, which may be another by a factor.
    """

    by_jerk: Floats
    jerk_std: Floats
    by_speed: Floats
    speed_std: Floats


def torque_delays(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Delays of torques that are tried: short ones, and that at which they are most like the law's.

    Where no law tells the torque, all torques are tried with some longer delays.
    """
    sizes = delay_sizes(TORQUE_DELAYS)(experiment, joints)
    longest = SETTINGS.latest / experiment.signals.interval
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


def delays(experiment: Experiment) -> Delay | None:
    """Delays that the torque of a law without memory shows, where no torque is logged."""
    signals = experiment.signals
    if signals.torque is not None or experiment.commanded is None or not signals.long_enough:
        return None
    # The gain [N m/pulse] of a law without memory turns a shift of the counts into torque.
    error = np.asarray(signals.reference) - signals.counts
    gain = (error * experiment.commanded).sum(axis=0) / np.maximum((error**2).sum(axis=0), 1e-300)
    angle = experiment.record.rig.encoder.to_angle(np.ones(experiment.n))
    # Viscous friction [N m s/rad] that looks like a delay of one sample.
    per_sample = np.abs(gain * signals.interval / angle)
    columns = np.full((4, experiment.n), np.nan)
    stated = experiment.record.rig.drive.viscous
    for i in range(experiment.n):
        fit = TorqueRegression.of(signals, experiment.commanded, i)
        if fit is not None and per_sample[i]:
            spread = np.hypot(fit.viscous_std, _VISCOUS_SPREAD * stated[i])
            speed = (fit.viscous - stated[i]) / per_sample[i]
            columns[:, i] = fit.delay, fit.delay_std, speed, spread / per_sample[i]
    return Delay(*columns)


# Viscous friction as a rig states it, relative: it doubles with the temperature of the grease.
_VISCOUS_SPREAD = 0.5


def delay_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of late counts; None if torque is logged, because the score then shows them.

    A law with memory is an exception: its lag behind the reference counts also with logged torque.
    """
    logged = experiment.signals.torque is not None
    if experiment.signals.reference is None:
        return None if logged else ()
    if experiment.has_memory:
        return _lag_evidence(experiment, joints) or (None if logged else ())
    if logged:
        return None
    delay = experiment.once(delays)
    if delay is None:
        return ()
    chosen = columns_of(joints)
    jerk, jerk_std = delay.by_jerk[chosen], delay.jerk_std[chosen]
    values = np.concatenate([jerk, delay.by_speed[chosen]])
    stds = np.concatenate([jerk_std, delay.speed_std[chosen]])
    for value, gain in _common(values, stds):
        # Torque that grows with the speed but not with the jerk is friction.
        if np.nansum((jerk**2 - (jerk - value) ** 2) / jerk_std**2) > 0:
            return ((value, gain),)
    return ()


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
    largest = np.abs(values).max()
    if not _LEAST_LAG <= largest <= experiment.signals.window or np.ptp(values) > _LEAST_LAG:
        return ()
    return _common(values, stds)


def feeds_forward(experiment: Experiment) -> bool:
    """Whether the law's torque depends on the acceleration of the reference."""
    law = experiment.record.law
    return law is not None and block_of(law, experiment.record.rig).depends("asked", "qdd")


# Samples of lag that a law leaves by what its model lacks.
_LEAST_LAG = 0.2


def lag(experiment: Experiment, i: int, *, friction: bool = False) -> tuple[float, float]:
    """Samples by which the counts of joint i lag behind the reference, and standard deviation."""
    signals = experiment.signals
    reference, counts = (experiment.filtered(name, i) for name in ("reference", "counts"))
    columns = [reference.speed, np.ones(len(counts.value))]
    # Friction that the law lacks is an error with the sign of the speed.
    if friction:
        columns.append(reference.direction)
    value, std = least_squares(
        np.column_stack(columns), reference.value - counts.value, signals.window
    )
    return value[0] / signals.interval, std[0] / signals.interval


def gains_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds that gains are in A, by score and viscous friction; None if torque is logged."""
    if experiment.once(delays) is None or not hasattr(experiment.record.law, "gain"):
        return None
    return ((1.0, by_friction(experiment, gains_in_ampere(experiment.record, joints, 1.0))),)


def by_friction(experiment: Experiment, record: Any) -> float:
    """How much likelier a log is with other gains, by its score and by its viscous friction."""
    changed = experiment.changed(record)
    before, after = experiment.once(delays), delays(changed)
    gain = changed.score - experiment.score
    # Viscous friction alone is a parameter; gains change inertia and Coulomb friction, too.
    if before is not None and after is not None and gain > 0:
        friction = (each.by_speed / each.speed_std for each in (before, after))
        gain += float(np.subtract(*(np.nansum(ratio**2) / 2 for ratio in friction)))
    return gain


def _differences(experiment):
    """Yield two filtered torques of each joint: the commanded one, and the logged one less it.

    Each (M,) [N m], less its mean; nothing of a law with memory.
    """
    if experiment.commanded is None or experiment.signals.torque is None:
        return
    for i in range(experiment.n if experiment.long_enough else 0):
        commanded, logged = (
            centred(experiment.filtered(name, i).value) for name in ("commanded", "torque")
        )
        yield commanded, logged - commanded


def _likelier(experiment, commanded, difference, columns):
    """Coefficients of columns (M, k) of a difference of torques, and their log likelihood ratio."""
    columns = columns - columns.mean(axis=0)
    size = np.maximum(np.sqrt((columns**2).sum(axis=0)), np.finfo(float).tiny)
    value = np.linalg.lstsq(columns / size, difference, rcond=None)[0] / size
    floor = SETTINGS.command * (commanded**2).sum()
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
    if (after > SETTINGS.like * before).any():
        return ()
    windows = experiment.filter.equations / REGRESSION.per_window
    explained = np.log((before + SETTINGS.steps) / (after + SETTINGS.steps))
    return ((1.0, float(windows / 2 * explained.sum())),)


def zero_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of a reference with another zero, by the mean of the law's torque.

    None of a law with memory, or if no torque is logged: the score then shows it. A scale of the
    torque, as of other gains or units, explains a part of the mean, and is no evidence.
    """
    torque, commanded = experiment.signals.torque, experiment.commanded
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
    least = np.mean((logged - law * (law @ logged) / (law @ law)) ** 2)
    beside = np.mean((logged - scale * law - constant) ** 2)
    floor = SETTINGS.another_zero * np.mean(logged**2)
    odds = experiment.filter.equations / 2 * np.log((least + floor) / (beside + floor))
    return ((float(-constant / (scale * gain)), float(odds)),)


def mean_errors(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """The median error [pulses], where it is large against how the error changes in the log."""
    if experiment.signals.reference is None:
        return ()
    chosen = columns_of(joints)
    error = (np.asarray(experiment.signals.reference) - experiment.signals.counts)[:, chosen]
    middle = float(np.median(error))
    changes = float(np.sqrt(np.mean((error - middle) ** 2)))
    return (middle,) if abs(middle) > max(1.0, SETTINGS.shifted * changes) else ()


def rate_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of a logged torque that grows with the rate of the error, as of PD stated as P.

    None under a law with memory: the steps of its torque tell.
    """
    rates, odds = list[float](), 0.0
    if experiment.signals.reference is None:
        return ()
    if experiment.has_memory:
        return None if experiment.command is not None else ()
    for i, (commanded, difference) in enumerate(_differences(experiment)):
        reference, counts = (experiment.filtered(name, i) for name in ("reference", "counts"))
        gain = _ratios(commanded, centred(reference.value - counts.value))
        column = gain * (reference.speed - counts.speed)
        value, likelier = _likelier(experiment, commanded, difference, column[:, None])
        rates.append(float(value[0]))
        odds += likelier
    return ((float(np.median(rates)), odds),) if rates and min(rates) > 0 else ()


def model_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a logged torque that is inverse dynamics: it has no friction, the law's has."""
    differences = list(_differences(experiment))
    equations, motions = experiment.equations_of_motion, experiment.motions
    measured = experiment.changed(as_commanded(experiment.record, joints, 1.0)).motions
    if not differences or equations is None or motions is None or measured is None:
        return
    odds, lacking = 0.0, 0.0
    for i, (commanded, difference) in enumerate(differences):
        motion, logged, equation = measured[i], motions[i], equations[i]
        # Beside the size of the torque, so that units do not count.
        size = np.std(commanded + difference)
        # A torque that hardly changes, as at the amplifier's limit or at rest, is no model's.
        if not np.std(commanded) > 0 or size < _CONSTANT * np.std(commanded):
            return
        unit = np.std(commanded) / size
        friction, std = unit * logged.coulomb, unit * logged.coulomb_std
        if not friction < _FRICTIONLESS * motion.coulomb + 2 * std:
            return
        lacking += ((motion.coulomb - friction) / np.hypot(std, motion.coulomb_std)) ** 2
        columns = np.column_stack([equation.own, equation.free])
        odds += _likelier(experiment, commanded, difference, columns)[1] - columns.shape[1]
    if lacking > _CERTAIN**2:
        yield 1.0, odds


# Dry friction of a torque over that of the law's, below which it has none, since drives are
# modelled with half their friction; and the standard deviations that make the law's significant.
_FRICTIONLESS, _CERTAIN = 0.2, 3.0

# Share of the law's torque below which a logged torque is constant: gear and gain are no factor of
# a million.
_CONSTANT = 1e-6


def viscous_evidence(experiment: Experiment, joints: Joints) -> Any:
    """Log odds of another viscous friction, which adds torque with the speed but not the jerk."""
    if experiment.signals.torque is not None:
        return None
    delay = experiment.once(delays)
    i = joints[0]
    stated = experiment.record.rig.drive.viscous[i]
    if delay is None or not stated or not np.isfinite(delay.speed_std[i]):
        return ()
    size = friction_ratios("viscous")(experiment, joints)
    return ((size[0], (delay.by_speed[i] / delay.speed_std[i]) ** 2 / 2),) if size else ()


def grid_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of counts that are multiples of one step: free counts would use the cells between.

    A broken step is a factor of units; a whole one is a coarser encoder, of which no log knows
    whether the rig or the counts are to change.
    """
    for step in common_step(experiment, joints):
        if step % 1:
            levels = len(np.unique(experiment.signals.counts[:, 0]))
            yield step, levels * float(np.log(step))


def radian_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of a resolution per radian."""
    changed = experiment.changed(other_resolution(experiment.record, joints, 2 * np.pi))
    yield from _stranger(experiment, changed, 2 * np.pi)


def edges_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of lines that are stated in place of counts, or the reverse."""
    follows = experiment.signals.tracks[columns_of(joints)].all()
    # Of some joints alone the motion is no evidence: the others' torques are coupled to them.
    if follows and len(joints) not in (0, experiment.n):
        return
    for size in EDGES:
        changed = experiment.changed(counted_edges(experiment.record, joints, size))
        # Counts that do not follow their reference show the factor by themselves.
        if not follows:
            yield size, changed.score - experiment.score
        else:
            yield from _stranger(experiment, changed, size)


EDGES = (4.0, 2.0, 0.5, 0.25)
"""Counts per pulse that is stated: a line of an encoder has four edges, of which some count two."""


def _stranger(experiment, changed, size):
    """Log odds of another resolution: gravity and inertia that no arm has, then those of one.

    What springs and other arms need of more columns is a small share of their torque.
    """
    if experiment.motions is None or changed.motions is None:
        return
    before, after = (
        max(motion.unexplained for motion in motions)
        for motions in (experiment.motions, changed.motions)
    )
    inertia = float((changed.beside_law["inertia"] - experiment.beside_law["inertia"]).sum())
    strange = before > _STRANGE * SETTINGS.motion or inertia > _BELOW_ROTOR
    if strange and after < SETTINGS.motion:
        stated, restated = (
            _whole_pulses(each.record.rig.encoder) for each in (experiment, changed)
        )
        yield size, changed.score - experiment.score + restated - stated


def _whole_pulses(encoder):
    """Log odds that the resolution is whole pulses per turn, as it is made, not any number."""
    broken = np.abs(encoder.resolution - np.round(encoder.resolution))
    return float(np.maximum(np.log(0.5 / _PRINTED) - broken / _PRINTED, 0.0).sum())


# Distance from a whole number that rounding of a stated resolution leaves [pulses per turn].
_PRINTED = 0.01

# The angles are in doubt if the motion leaves more than this multiple of the share of torque that
# it may leave unexplained in right logs. Drawn machines with springs reach 10.
_STRANGE = 12.0

# The resolution is in doubt if another one raises the log odds of the inertias by more than this:
# as much as two joints whose inertia is surely below that of the rotor.
_BELOW_ROTOR = 40.0


def steps_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """How much likelier the log is where law and rig count in whole steps."""
    for step in common_step(experiment, joints):
        changed = experiment.changed(counted_in_steps(experiment.record, joints, step))
        yield step, changed.score - experiment.score


def _interval_ratio(experiment):
    return experiment.signals.interval / experiment.record.rig.period


def time_unit_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of times in milliseconds or microseconds, by the rig's period."""
    factor = unit_of_time(_interval_ratio(experiment))
    if factor != 1:
        yield factor, abs(float(np.log(factor))) * _PER_E_FOLD


def period_evidence(experiment: Experiment, joints: Joints) -> Iterator[tuple[float, float]]:
    """Log odds of another period of the rig, by the median interval of the stamps."""
    ratio = _interval_ratio(experiment)
    if 1e-3 + chance_of_period(experiment.signals) < abs(np.log(ratio)) < 3:
        yield float(ratio), abs(float(np.log(ratio))) * 1e3 * _PER_E_FOLD


# Log odds per factor e of a time unit, and per thousandth of a period. Stamps and period come from
# one clock: a thousandth is 3 standard deviations of what is usual.
_PER_E_FOLD = 10.0

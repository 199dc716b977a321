"""Sizes of mistakes that a log suggests: scales, units and limits."""

from collections.abc import Callable

import numpy as np

from plant.checkup.along_log import comparable_torques
from plant.checkup.filtered import centred
from plant.checkup.hypothesis import Joints, columns_of
from plant.checkup.quantisation import grid
from plant.checkup.score import SETTINGS as SCORE
from plant.checkup.score import Experiment
from plant.checkup.signals import Signals
from plant.checkup.undo import SLACK, rated_torque, scaled_counts, scaled_reference
from plant.parts import Floats, frozen_settings


@frozen_settings
class SizeSettings:
    """Which sizes are tried.

    Chosen by hand where nothing else is said; ``tests/benchmarks/verdicts.py`` measures the
    verdicts that result.

    Parameters
    ----------
    relevant : float
        Distance of a factor from 1 up to which it is that of rounding and an imperfect undo.
    near : float
        Distance of a scale from 1 up to which it may be that of a gear. A farther one is that of a
        unit, which the motion shows.
    parts : float
        Scales that are tried beside that of the motion lie up to so many times the share of the
        speed that lags from it.
    scales : int
        Number of these scales. The torque shows a scale to about half of that share, and these are
        half as far apart.
    counted : float
        Distance of a scale from 1 below which it is not tried: a gear of 101 that is stated as 100
        is far beyond.
    lags : float
        Share of the speed that lags above which a loop shows no scale.
    at_limit : float
        Relative distance from the amplifier's limit within which a torque is limited.
    mostly : float
        Share of the commands beyond a limit at which the torque must be at that limit. Counts that
        are late spoil the other commands.
    rows : int
        Rows at a limit from which on it is one, and no single peak of the torque.
    """

    relevant: float = 0.03
    near: float = 0.3
    parts: float = 1.5
    scales: int = 13
    counted: float = 0.003
    lags: float = 0.1
    at_limit: float = 0.02
    mostly: float = 0.5
    rows: int = 5


SETTINGS = SizeSettings()


def regressed(numerator: Floats, denominator: Floats) -> Floats:
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
    ratio = regressed(counts, reference)
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
    unlike = command is not None and (command[columns_of(joints)] > SCORE.unlike).any()
    if not unlike or lag > SETTINGS.lags or abs(slope - 1) > SETTINGS.near:
        return _positive(slope)
    sizes = slope * (1 + lag * np.linspace(-SETTINGS.parts, SETTINGS.parts, SETTINGS.scales))
    if len(joints) == 1:
        # Most gears are whole numbers. A tight loop gives its torque at the true scale alone, which
        # no grid meets: try whole numbers, too. For a soft loop, or a gear in rad/m, the range
        # holds too many whole numbers, and the grid suffices.
        gear = abs(float(experiment.record.rig.drive.gear[joints[0]]))
        first, end = np.ceil(gear * sizes[0]), gear * sizes[-1]
        if end - first < SETTINGS.scales:
            sizes = np.union1d(sizes, np.arange(first, end) / gear)
    return tuple(sizes[np.abs(sizes - 1) > SETTINGS.counted].tolist())


def torque_ratios(experiment: Experiment, joints: Joints) -> tuple[float, ...]:
    """Logged over commanded torque: of a joint, or the median of all."""
    if experiment.has_memory:
        if experiment.torques_of_law is None:
            return ()
        # A memory is unknown, but hardly changes the steps from sample to sample.
        steps, measured, _ = unlimited_steps(experiment.signals, experiment.torque_along)
        return _positive(np.median(regressed(measured, steps)[columns_of(joints)]))
    commanded, logged = experiment.commanded, experiment.signals.torque
    if commanded is None or logged is None:
        return ()
    within = _unlimited(experiment.record.rig.drive, commanded, logged)
    ratio = np.array(
        [
            regressed(centred(logged[rows, i]), centred(commanded[rows, i]))
            for i, rows in enumerate(within.T)
        ]
    )
    return _positive(np.median(ratio[columns_of(joints)]))


def unlimited_steps(
    signals: Signals, commanded: Floats, parts: tuple[Floats, ...] = ()
) -> tuple[Floats, Floats, list[Floats]]:
    """Steps (K - 1, n) of the law's motor torque, of the logged one, and of parts of the law's.

    Zero where an amplifier limits either torque. `commanded` (K, n): joint torque, as of
    `torque_along`; `parts` (K, n): motor torques.
    """
    clear, law, logged = comparable_torques(signals, commanded)
    within = clear[:, None] & _unlimited(signals.rig.drive, law, logged)
    both = within[1:] & within[:-1]
    steps, measured = (np.where(both, np.diff(motor, axis=0), 0.0) for motor in (law, logged))
    return steps, measured, [np.where(both, np.diff(part, axis=0), 0.0) for part in parts]


def _unlimited(drive, commanded, logged):
    """Whether no amplifier limits motor torques (K, n): it shows its limit, and no gain.

    A law in a wrong scale meets the limit elsewhere than the log does, so both are tested.
    """
    limit = _motor_limit(drive)
    at_limit = np.abs(np.abs(logged) / limit - 1) < SETTINGS.at_limit
    return (np.abs(commanded) < (1 - SETTINGS.at_limit) * limit) & ~at_limit


def _motor_limit(drive):
    return drive.motor_gain * drive.current_limit


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
    of_limits = experiment.changed(rated_torque(experiment.record, (), 1.0))
    inverses = [torque_ratios(of_limits, (i,)) for i in range(experiment.n)]
    # Without a factor it is per mille of the limit itself, which has a row.
    if not all(inverses):
        return ()
    shares = 1 / np.ravel(inverses)
    alike = [np.ptp(np.log(values)) < SETTINGS.relevant for values in (shares, ratio)]
    share = float(np.median(shares))
    return (share,) if alike == [True, False] and share < 1 - SETTINGS.relevant else ()


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
    commanded = experiment.commanded
    if experiment.has_memory and experiment.torque_along is not None:
        _, commanded, torque = comparable_torques(experiment.signals, experiment.torque_along)
    largest = float(np.abs(torque[:, i]).max())
    if commanded is not None:
        # An amplifier is at its limit wherever the command is beyond it.
        beyond = np.abs(commanded[:, i]) > (1 + SETTINGS.at_limit) * largest
        at_limit = np.abs(torque[beyond, i]) > (1 - SETTINGS.at_limit) * largest
        if at_limit.sum() < SETTINGS.rows or at_limit.mean() < SETTINGS.mostly:
            return ()
    share = largest / float(_motor_limit(drive)[i])
    return (share,) if share < 1 - SETTINGS.relevant else ()


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
    return (float(ratio),) if ratio > 0 and abs(ratio - 1) > SETTINGS.relevant else ()

"""How counters round, as crossings of zero show: `fix` has a cell two pulses wide there.

`floor` and `round` have none. A polynomial in time, the motion that the torque adds to it, and a
step of the counts at zero are fitted about each crossing. The same fit at crossings of other
counts, whose cells are one pulse wide, shows the size of no step in this log; with two neighbouring
cells merged, it shows that of `fix`. So the log is its own yardstick for any motion and noise.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from plant.checkup.along_log import at_times, sample_times, torque_along
from plant.checkup.finding import Check, Finding
from plant.checkup.quantisation import noted_steps
from plant.checkup.signals import Signals
from plant.laws import PD, Cascade


@dataclass(frozen=True, kw_only=True)
class RoundingSettings:
    """Numbers of the search for the convention of rounding.

    They are chosen by hand; ``tests/benchmarks/second_reading.py rounding`` counts the logs whose
    convention is found with them.

    Parameters
    ----------
    halves, degrees : tuple of int
        Rows to each side of a crossing, and degrees of the polynomial in time. The pair with the
        smallest standard deviation counts.
    crossings, least_crossings : int
        Crossings of other counts that are fitted, at most and at least.
    sure : float
        Probability from which on a convention is certain.
    neither : float
        Distance from both conventions [standard deviations] at which the step is neither.
    comparable : float
        Standard deviation [that of the best window] up to which a window is as good as the best.
    alike : float
        Factor between the speeds at zero and at the other counts.
    slow : float
        Speed [counts per row] below which a motor does not cross a count.
    """

    halves: tuple[int, ...] = (10, 20, 40, 80)
    degrees: tuple[int, ...] = (3, 5, 7)
    crossings: int = 300
    least_crossings: int = 20
    sure: float = 0.998
    neither: float = 4.0
    comparable: float = 3.0
    alike: float = 2.0
    slow: float = 0.05


SETTINGS = RoundingSettings()


def rounding_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the finding about the convention of the counters, of all joints together."""
    check = Check("rounding", None, "% fix")
    encoder = signals.rig.encoder
    stated = encoder.rounding
    reason = "no joint passes zero clearly"
    fix = None
    # Positions that were no whole pulses were rounded by the reader, not by a counter.
    if noted_steps(signals.record):
        reason = "the positions are not in whole pulses"
    elif encoder.smooth:
        reason = "the encoder is said not to round"
    else:
        fix = fix_seen(signals)
    if fix is None:
        yield check.unknown(f"{reason}; {stated} is stated")
        return
    share = 100 * fix
    if 1 - SETTINGS.sure < fix < SETTINGS.sure:
        yield check.unknown(f"{stated} is stated, fix has a probability of {share:.0f} %", share)
    elif (fix > 0.5) == (stated == "fix"):
        yield check.fine(share)
    else:
        evidence = (
            'a cell two pulses wide at zero: Encoder(rounding="fix") (probability'
            f" {min(fix, 0.999):.1%})"
        )
        if fix < 0.5:
            evidence = (
                'no wide cell at zero: Encoder(rounding="floor"), or "round" (probability'
                f" {min(1 - fix, 0.999):.1%})"
            )
        yield check.wrong(share, f"The counts show {evidence}, not {stated!r} as stated.")


def rounding_doubts(record) -> list[str]:
    """A line if the counts of a record contradict the stated convention, or none."""
    return [finding.advice for finding in rounding_findings(Signals(record)) if not finding.ok]


def fix_seen(signals: Signals) -> float | None:
    """Probability (0 to 1) that the counts are rounded towards zero; None if the log is silent."""
    log_odds = rounding_log_odds(signals)
    if log_odds is None:
        return None
    # Beyond e^100 the odds make no difference, and the exponential would overflow.
    return float(1 / (1 + np.exp(-np.clip(log_odds, -100.0, 100.0))))


# Asked by the ranking and by the finding of one log.
@functools.lru_cache(maxsize=1)
def rounding_log_odds(signals: Signals) -> float | None:
    """Natural logarithm of the odds of `fix`; None if the log is silent."""
    if not signals.long_enough:
        return None
    torque = signals.motor_torque
    if torque is None:
        torque = _torque_of_law(signals)

    # Windows need all rows: those without weight go on straight lines, rounded.
    valid = np.flatnonzero(signals.record.valid > 0)[: len(torque)]
    rows = np.arange(valid[0], valid[-1] + 1)
    measured = np.isin(rows, valid)
    columns = [np.interp(rows, valid, column) for column in torque.T]
    forces = np.column_stack([_scaled(column) for column in columns])
    # All joints have one convention, so the logarithms of their odds are added.
    log_odds = []
    for column in signals.counts[: len(valid)].T:
        counts = np.interp(rows, valid, column)
        counts = np.where(measured, counts, np.round(counts))
        odds = _log_odds(counts, forces)
        if odds is not None:
            log_odds.append(odds)
    return float(sum(log_odds)) if log_odds else None


def _torque_of_law(signals):
    """Motor torque of the law in the first rows (M, n), or what stands in for it."""
    if signals.reference is None:
        return np.zeros((len(signals.t), 1))
    law, drive = signals.record.law, signals.rig.drive
    # Laws that read angles, not pulses, have a step at zero themselves where cells are wide.
    reads_pulses = isinstance(law, (PD, Cascade))
    along = torque_along(signals, law, signals.rig) if reads_pulses else None
    if along is None:
        # The torque of a P law is proportional to the error.
        return signals.reference - signals.counts
    times = sample_times(signals, len(along))
    t = signals.t[signals.t <= times[-1]]
    return drive.motor_torque(at_times(t, times, along))


def _scaled(force):
    """A force (M,) over its deviation; zero where it is constant, as polynomials are beside it."""
    deviation = np.std(force)
    # Rounding of a constant is no deviation.
    if deviation <= 1e-9 * np.abs(force).max():
        return np.zeros_like(force)
    return force / deviation


class _Step(NamedTuple):
    """Mean step at zero [pulses], its size without and with a wide cell, standard deviation."""

    value: float
    without: float
    with_fix: float
    std: float


def _log_odds(counts, forces):
    """Logarithm of the odds of `fix` from counts (M,) under forces (M, k); None if undecided."""
    # Scaled counts have no cells.
    if (counts != np.round(counts)).any():
        return None
    steps = [step for half in SETTINGS.halves for step in _steps(counts, forces, half)]
    if not steps:
        return None
    value, without, with_fix, std = np.array(steps).T

    # Steps relative to that of a wide cell: 0 is no wide cell, 1 is `fix`. The spread among windows
    # of other lengths belongs to the error of the best one.
    width = np.maximum(with_fix - without, 1e-9)
    share = (value - without) / width
    std = std / width
    best = np.argmin(std)
    comparable = share[std < SETTINGS.comparable * std[best]]
    spread = np.hypot(std[best], np.sqrt(np.mean((comparable - share[best]) ** 2)))
    distance = np.abs(share[best] - np.array([0, 1])) / spread
    # Something else steps at zero.
    if distance.min() > SETTINGS.neither:
        return None
    return float(distance[0] ** 2 - distance[1] ** 2) / 2


def _steps(counts, forces, half):
    """Fit the step at zero in windows of 2 half rows, for each degree; none without crossings."""
    # 1. Crossings of zero, in windows that do not overlap.
    if len(counts) < 4 * half:
        return
    speed = np.pad(np.abs(counts[2 * half :] - counts[: -2 * half]) / (2 * half), half)
    # A joint that starts or stops within a window changes its friction, which no torque shows.
    moved = np.abs(counts[half:] - counts[:-half]) / half > SETTINGS.slow
    moving = np.pad(moved[half:] & moved[:-half], half)
    zeros = np.flatnonzero(np.diff(counts >= 0) & (speed[1:] > SETTINGS.slow) & moving[1:])
    # A joint that rattles about zero counts once.
    zeros = zeros[np.diff(zeros, prepend=-half) >= half]
    if not len(zeros):
        return

    # 2. Crossings of other counts at such speeds, so far from zero that no window holds it.
    alike = (speed >= speed[zeros].min() / SETTINGS.alike) & (speed > SETTINGS.slow)
    alike &= (speed <= speed[zeros].max() * SETTINGS.alike) & moving
    away = np.abs(counts) > 2 * half * np.maximum(speed, 1)
    crossings = np.flatnonzero((alike & away)[:-1] & (np.diff(counts) != 0))
    # Spread over the log, and not more than are needed.
    crossings = crossings[:: max(1, len(crossings) // SETTINGS.crossings)]
    if len(crossings) < SETTINGS.least_crossings:
        return

    # 3. Counts and double sums of the forces in each window, which serve all degrees.
    offsets = np.arange(1 - half, half + 1)
    levels = np.maximum(counts[crossings], counts[crossings + 1])
    windows = counts[crossings[:, None] + offsets] - levels[:, None]
    at_zero = counts[zeros[:, None] + offsets]
    motion = _double_sum(forces[crossings[:, None] + offsets])
    motion_at_zero = _double_sum(forces[zeros[:, None] + offsets])
    for degree in SETTINGS.degrees:
        basis, _ = np.linalg.qr(np.vander(np.linspace(-1, 1, 2 * half), degree + 1))
        yield _step(basis, at_zero, motion_at_zero, windows, motion)


def _step(basis, at_zero, motion_at_zero, windows, motion):
    """The step beside a polynomial (orthonormal `basis`), in windows at zero and at other counts.

    `motion`: that the forces would cause in each window, per unit of their gains.
    """
    # 1. Motion that the torque adds to the polynomial, from the other crossings.
    beside = motion.swapaxes(1, 2)
    beside = (beside - beside @ basis @ basis.T).swapaxes(1, 2).reshape(-1, motion.shape[2])
    # The polynomial is projected out of both sides.
    target = (windows - windows @ basis @ basis.T).ravel()
    gain = np.linalg.lstsq(beside, target, rcond=None)[0]

    # 2. The step at zero, and at other crossings: as they are, and with the cell at the level
    # merged with the one below.
    sizes, weights = _fitted_steps(at_zero - motion_at_zero @ gain, basis, at_zero)
    means = []
    scale = 0.0
    for window in (windows, windows + (windows < 0)):
        other_sizes, other_weights = _fitted_steps(window - motion @ gain, basis, window)
        mean = float(np.average(other_sizes, weights=other_weights))
        # 1.4826 times the median deviation is the standard deviation of a normal distribution.
        deviation = np.abs(other_sizes - mean) * np.sqrt(other_weights)
        scale = max(scale, 1.4826 * float(np.median(deviation)))
        means.append(mean)
    value = float(np.average(sizes, weights=weights))
    return _Step(value, means[0], means[1], scale / np.sqrt(weights.sum()))


def _double_sum(forces):
    """Motion per unit of gain that forces (K, 2 half, k) cause."""
    return np.cumsum(np.cumsum(forces, axis=1), axis=1)


def _fitted_steps(windows, basis, counts):
    """Steps (K,) where counts pass zero in windows (K, 2 half), beside a polynomial; their weights.

    A step of 1 is that of `fix`.
    """
    step = -0.5 * np.sign(counts)
    beside = step - (step @ basis) @ basis.T
    # A step near the end of a window is nearly a polynomial, and has little weight.
    weights = np.maximum((beside**2).sum(axis=1), 1e-9)
    return (beside * windows).sum(axis=1) / weights, weights

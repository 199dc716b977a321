"""The commanded path of a loop: a reference with its counts, or the commanded counts of a log.

The control card rounds the commanded counts as the encoder does, also between samples, and so does
this module. A record without a reference is replayed from its logged counts: straight lines join
the samples, and are rounded likewise, unless the log has fractions of counts. If the law needs the
motion itself, with its acceleration, smoothing splines through the counts give this motion.
"""

import dataclasses
import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.checkup import off_reference
from plant.laws import Law
from plant.logs import Record
from plant.machine import Rig, smooth_rig
from plant.motion import Motion, Reference, Spline, smooth_splines
from plant.parts import Floats, frozen_settings
from plant.simulation.clock import Clock

# Largest number of samples of a path to evaluate at once: the motion takes much memory.
_AT_ONCE = 1 << 16

_ROUNDING = 1 / np.sqrt(12)  # standard deviation of the rounding error of a count [pulses]


class Stretch(NamedTuple):
    """Polynomial that may give the initial speed of a joint.

    `degree`. `samples`: number of first samples to which it is fitted. `clear`: smallest speed that
    is accepted, in standard deviations of its error by rounding.
    """

    degree: int
    samples: int
    clear: float = 0.0


@frozen_settings
class PathSettings:
    """Numbers to rebuild a motion, and to estimate the initial speed, from counts; set by hand.

    Parameters
    ----------
    shortest : int
        A log is rebuilt only if it has more than twice this number of samples.
    longest : int
        Samples of the longest log that is rebuilt.
    missed : float
        Largest share of counts that may differ from those of the log: rounding explains so many.
    stretches : tuple of Stretch
        Polynomials to fit to the first counts, the least noisy first. Each joint takes the speed of
        the first polynomial that fits its counts and shows a clear speed. If only a short one fits,
        either the joint is fast, or its controller was just switched on. `clear` tells these cases
        apart: a first count that is off by 5 must not look like a speed (test_simulator.py).
    deviation : float
        Largest distance [pulses] of a count from its polynomial that rounding explains.
    speed : float
        Difference [pulses per sample] above which the counted initial speed is clearly not that of
        the reference. Rounding gives the counted speed a standard deviation of 0.12.
    """

    shortest: int = 50
    longest: int = 100_000
    missed: float = 0.05
    stretches: tuple[Stretch, ...] = (
        Stretch(degree=2, samples=10),
        Stretch(degree=4, samples=20),
        Stretch(degree=4, samples=10, clear=12.0),
        Stretch(degree=4, samples=8, clear=12.0),
        Stretch(degree=2, samples=3, clear=12.0),
    )
    deviation: float = 1.5
    speed: float = 0.5


SETTINGS = PathSettings()


class Path:
    """A reference with its counts on a rig."""

    def __init__(self, reference: Reference, rig: Rig) -> None:
        if reference.n != rig.n:
            raise ValueError(
                f"reference must have {rig.n} joints like the rig; got {reference.n}. Use a"
                " matching one."
            )
        self.reference = reference
        self.rig = rig

    def __call__(self, t: Floats) -> tuple[Motion, Floats]:
        motion = self.reference(t)
        return motion, self.rig.counts(motion.q)

    def setpoint(self, t: Floats) -> Motion:
        """The motion that a law follows, at times t (N,)."""
        return self.reference(t)

    def require_fit(self, law: Law) -> None:
        """Refuse a law that is made for another motion; most laws serve any."""
        getattr(law, "require_reference", lambda _: None)(self.reference)

    def start(self) -> tuple[Floats, Floats]:
        """Position and velocity (n,) of the reference at t = 0."""
        motion = self.reference(np.zeros(1))
        return motion.q[0], motion.qd[0]


class Logged:
    """Commanded counts of a log (N, n), at the samples of a clock, as a path."""

    def __init__(self, reference_pulses: Floats, rig: Rig, clock: Clock) -> None:
        self.pulses = reference_pulses
        self.rig = rig
        self.clock = clock
        # Fractions of counts were not rounded in the experiment, and are not rounded here.
        self.whole = bool((reference_pulses == np.trunc(reference_pulses)).all())
        self._splines: dict[float, list[Any]] = {}

    def __call__(self, t: Floats) -> tuple[Motion, Floats]:
        place = self.clock.place(t)
        # Before the log and after it the counts stay as they are at its ends.
        row = np.clip(np.floor(place).astype(int), 0, len(self.pulses) - 1)
        following = np.minimum(row + 1, len(self.pulses) - 1)
        step = self.pulses[following] - self.pulses[row]
        pulses = self.pulses[row] + step * np.maximum(place - row, 0)[:, None]
        speed = self.rig.to_angle(step / self.clock.apart(row))
        motion = Motion(self.rig.to_angle(pulses), speed, np.zeros_like(pulses))
        # Between two samples the card rounds what it interpolates.
        return motion, self.rig.encoder.quantised(pulses) if self.whole else pulses

    def smoothed(self, t: Floats, finer: float = 1.0) -> Motion:
        """The smoothest motion that rounding allows; fractional counts are interpolated.

        `finer` multiplies the number of knots of the splines. Where two values of `finer` give
        different motions, the rounded counts cannot tell which motion is true.
        """
        sampled = self.clock.t[self.clock.rows]
        # Fitted once: a law reads this motion at many times.
        if finer not in self._splines:
            encoder = self.rig.encoder
            centres = self.pulses
            if self.whole:
                centres = encoder.position_in_pulses(encoder.cell_centre(self.pulses))
            self._splines[finer] = smooth_splines(sampled, centres, self.whole, finer)
        # The splines are defined only within the log. A time before 0 is replaced by 0, and a time
        # after the last sample by that of the last sample.
        within = np.clip(t, 0, sampled[-1])
        splines = self._splines[finer]
        pulses = (np.column_stack([spline(within, k) for spline in splines]) for k in range(3))
        return Motion(*map(self.rig.to_angle, pulses))

    def setpoint(self, t: Floats) -> Motion:
        """The motion that a law follows, at times t (N,)."""
        return self.smoothed(t)

    def start(self) -> tuple[Floats, Floats]:
        """Position at t = 0, at rest: two counts give no velocity."""
        return self.rig.to_angle(self.pulses[0]), np.zeros(self.rig.n)


def path_of(record: Record, clock: Clock | None = None, *, smooth: bool = False) -> Path | Logged:
    """Commanded path of a record: its reference, which must agree with its counts, or the counts.

    With `smooth` the path is not rounded to pulses, and each logged count stands for the middle of
    its quantisation cell. If a record has a reference and its logged counts have fractions, the
    path is not rounded either.
    """
    clock = clock or Clock.of(record)
    if record.reference is None:
        rig = record.rig
        counts = record.reference_pulses
        centres = rig.encoder.position_in_pulses(rig.encoder.cell_centre(counts))
        return Logged(centres, smooth_rig(rig), clock) if smooth else Logged(counts, rig, clock)
    path = Path(record.reference, record.rig)
    counts = counts_along(path, clock.t[clock.rows])
    off = np.abs(counts - record.reference_pulses).max(axis=1)
    # Samples that bridge a gap were not measured.
    off[record.valid == 0] = 0
    # Rounding explains a difference of one pulse. Larger ones are accepted in rows that belong to
    # another time, as they do after lost messages.
    wrong = np.flatnonzero((off > 1) & ~off_reference(record))
    if len(wrong):
        reason = _scaled(record, counts) or (
            f"; sample {wrong[0]} is {off[wrong[0]]:.0f} pulses off. Correct the reference, or"
            " leave it out to replay the logged counts."
        )
        raise ValueError(f"reference_pulses must be the reference's own, from t = 0{reason}")
    # Logged fractions show that nothing was rounded in the experiment.
    whole = (record.reference_pulses == np.trunc(record.reference_pulses)).all()
    return Path(record.reference, smooth_rig(record.rig)) if smooth or not whole else path


def _scaled(record: Record, counts: Floats) -> str:
    """The cause if logged counts are those of the reference (N, n) times a number, otherwise ""."""
    moved = counts - counts.mean(axis=0)
    logged = record.reference_pulses - record.reference_pulses.mean(axis=0)
    power = (moved * moved).sum(axis=0)
    # A joint that hardly moves has no ratio: rounding alone changes it by 0.4 / sqrt(power).
    clear = power > 1e4
    ratio = np.where(clear, (moved * logged).sum(axis=0) / np.where(clear, power, 1.0), 1.0)
    joint = int(np.argmax(np.abs(ratio - 1)))
    # Both counts have rounding errors, and so have their means.
    proportional = (np.abs(logged - ratio * moved) <= 1.5 + np.abs(ratio)).all()
    if not proportional or abs(ratio[joint] - 1) < 1e-3:
        return ""
    # No advice to replay the logged counts: that would hide the wrong gear, turn, sign or unit.
    return (
        "; gears (or counts per turn) are not the rig's. At"
        f" {record.rig.joint_labels[joint]} they are {ratio[joint]:.4g} times the reference's:"
        " check gear, pulses per turn and sign, and that the reference is in radians."
    )


def counts_along(path: Path | Logged, t: Floats) -> Floats:
    """Counts (N, n) of a path at times t (N,), evaluated block by block."""
    return np.concatenate([path(part)[1] for part in np.array_split(t, -(-len(t) // _AT_ONCE))])


def is_rounded(record: Record) -> bool:
    """Whether the path is known only as whole counts, while the law may have known it exactly."""
    counts = record.reference_pulses
    law = record.law
    if record.reference is not None or law is None or law.replays or record.rig.encoder.smooth:
        return False
    moves = np.ptp(counts, axis=0) > 0
    return bool(moves.any() and (counts == np.trunc(counts)).all())


def with_path(record: Record) -> Record:
    """Return the record with a smooth motion through its commanded counts as its reference.

    Straight lines through counts lag by half a pulse between samples, which looks like late
    torques. The record is returned unchanged unless `is_rounded` is true of it, if its law has a
    period or a state, if it is too short or too long, or if it does not begin at t = 0. It is also
    returned unchanged if its counts are not those of a smooth motion: at most one count in twenty
    may differ from the count of the motion, and only by one pulse.
    """
    # A law with a period reads its reference only at the samples. A law with a state needs the
    # reference that it really followed.
    law: Any = record.law
    if not is_rounded(record) or law.period is not None or law.initial_state(record.n).size:
        return record
    if not 2 * SETTINGS.shortest < len(record) <= SETTINGS.longest:
        return record
    clock = Clock.of(record)
    times = clock.t[clock.rows]
    # The splines must give the log's own counts again.
    q = Logged(record.reference_pulses, record.rig, clock).smoothed(times).q
    off = np.abs(record.rig.counts(q) - record.reference_pulses)
    if off.max() > 1 or (off > 0).mean() > SETTINGS.missed or times[0] != 0:
        return record
    return dataclasses.replace(record, reference=Spline(times=times, points=q, at_rest=False))


def start_of(record: Record, path: Path | Logged) -> Any:
    """Position and velocity (n,) from which a record is replayed.

    If the record has an `initial`, that is returned. Otherwise the path gives position and speed at
    t = 0, with these exceptions. A joint whose first error is a pulse or more (as when gravity
    pulls an arm off its goal before the motion) begins in the middle of the quantisation cell that
    its encoder reads. Such a joint takes the speed of its first counts if this speed is not zero
    and clearly differs from that of the reference. Without a reference, or with a reference that
    only holds its goals, every joint takes the speed of its first counts.
    """
    if record.initial is not None:
        return record.initial
    q, qd = path.start()
    counted = record.rig.cell_centre(record.reference_pulses[0] - record.error_pulses[0])
    # The encoders of coupled joints count shafts, so the choice is made for each shaft.
    coupling = record.rig.drive.coupling
    apart = np.abs(record.error_pulses[0]) >= 1
    q = coupling.joint(np.where(apart, coupling.shaft(counted), coupling.shaft(q)))
    counted_speed = _initial_speed(record)
    # No reference, or one that only holds its goals, tells the speed: take that of the counts.
    if record.reference is None or record.reference.held:
        return q, counted_speed
    # The counts of the first samples give the speed only roughly.
    difference = np.abs(record.rig.position_in_pulses(counted_speed - qd)) * record.rig.period
    clear = apart & (difference > SETTINGS.speed)
    # A joint that stands still before the motion keeps the speed of its reference.
    moving = np.abs(coupling.shaft(counted_speed)) > 0
    speeds = np.where(clear & moving, coupling.shaft(counted_speed), coupling.shaft(qd))
    return q, coupling.joint(speeds)


def in_motion(record: Record) -> bool:
    """Whether a controller had been moving the arm before the first sample."""
    return bool((_speed_unknown(record) & (np.abs(record.error_pulses[0]) >= 1)).any())


def is_start_open(record: Record) -> bool:
    """Whether position and speed at the first sample are known to the accuracy of counts alone.

    With a reference that does not only hold its goals, this is so if the arm is `in_motion`.
    Otherwise it is so if any joint moves at an unknown speed at the start.
    """
    reference = record.reference
    told = reference is not None and not reference.held
    return in_motion(record) if told else bool(_speed_unknown(record).any())


def _speed_unknown(record: Record) -> NDArray[np.bool_]:
    """Whether the first counts of each joint (n,) show a speed that the record does not state.

    All are False if the record has no law, if it has an `initial`, or if its law replays the log.
    """
    if record.law is None or record.law.replays or record.initial is not None:
        return np.zeros(record.n, bool)
    return np.abs(record.rig.position_in_pulses(_initial_speed(record))) > 0


def _initial_speed(record: Record) -> Floats:
    """Initial speed (n,) [rad/s] of a polynomial fitted to the first counts.

    Each joint takes its speed from the first of the `stretches` that fits its counts and shows a
    clear speed. If there is none, as after a controller was just switched on, the speed of the
    joint is zero; but if the law replays the log, the stretch with most samples gives the speed.
    All speeds are zero if no joint moves by more than one pulse within the first of the
    `stretches`, or if the log has fewer samples than that.
    """
    polynomial = np.polynomial.polynomial
    speed = np.zeros(record.n)
    decided = np.zeros(record.n, bool)
    least_noisy = SETTINGS.stretches[0]
    longest = max(SETTINGS.stretches, key=lambda stretch: stretch.samples)
    first = record.counts[: least_noisy.samples]
    if len(first) < least_noisy.samples or (np.ptp(first, axis=0) <= 1).all():
        return speed
    for stretch in SETTINGS.stretches:
        counts = record.counts[: stretch.samples]
        # In units of the stretch, so that the fit is well conditioned.
        t = record.t[: len(counts)] - record.t[0]
        scale = t[-1]
        coefficients = polynomial.polyfit(t / scale, counts, stretch.degree)
        off = np.abs(polynomial.polyval(t / scale, coefficients).T - counts).max(axis=0)
        # The coefficient of the speed is the sum of the counts, weighted by `solved[1]`. So the
        # norm of these weights turns the rounding error of a count into that of the coefficient.
        solved = np.linalg.pinv(polynomial.polyvander(t / scale, stretch.degree))
        noise = _ROUNDING * np.linalg.norm(solved[1])
        near = off <= SETTINGS.deviation
        near &= np.abs(coefficients[1]) >= stretch.clear * noise
        shown = coefficients[1] / scale
        speed = np.where(near & ~decided, shown, speed)
        decided |= near
        if stretch is longest:
            roughly = shown
    # A record that replays its log had no controller switched on: its counts show real motion.
    if record.law is not None and record.law.replays:
        speed = np.where(decided, speed, roughly)
    return record.rig.to_angle(speed)


def write_replay(record: Record, path: str | os.PathLike[str]) -> None:
    """Write the inputs of a controller in an experiment as a CSV file, for ``main.c`` to replay.

    Parameters
    ----------
    record : Record
        With one sample per step of the law.
    path : str or Path
        CSV file of encoder counts and q_r, qd_r, qdd_r of all joints, one row per sample.

    Raises
    ------
    ValueError
        Counts that are not whole.

    See Also
    --------
    plant.Law, plant.Record

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import puma560, simulate, write_replay
    >>> arm, rig, law = puma560.arm(), puma560.rig(), puma560.p_law()
    >>> record = simulate(arm, rig, law, puma560.reference(), duration=0.2)
    >>> write_replay(record, "record.csv")
    >>> Path("record.csv").read_text()[:17]
    'pulses_1,pulses_2'
    """
    followed = path_of(record)
    law = record.law
    motion = followed(record.t)[0] if law is None else followed.setpoint(record.t)
    # The error is reference minus count.
    pulses = record.reference_pulses - record.error_pulses
    if (pulses != np.trunc(pulses)).any():
        raise ValueError(
            "pulses of the record must be whole; got fractions. Simulate with an encoder that"
            " counts."
        )
    columns = (("pulses", ""), ("q_r", " [rad]"), ("qd_r", " [rad/s]"), ("qdd_r", " [rad/s^2]"))
    names = [f"{name}_{i + 1}{unit}" for name, unit in columns for i in range(record.n)]
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for counts, row in zip(pulses, np.hstack(motion), strict=True):
            file.write(
                ",".join([*(f"{count:.0f}" for count in counts), *(f"{x:.17g}" for x in row)])
                + "\n"
            )

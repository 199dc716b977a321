"""The commanded path of a loop: a reference with its counts, or the commanded counts of a log.

The reference counts are rounded as the encoder rounds, also between samples, as the control card
does. A record without a reference is replayed from its logged counts: straight lines between two
samples, rounded likewise, unless the log has fractions of counts. Where the law needs the motion
itself, with its acceleration, it is that of smoothing splines.
"""

import dataclasses
import os
from typing import Any

import numpy as np

from plant.checkup.lost_rows import off_reference
from plant.laws.law import Law
from plant.logs.record import Record
from plant.machine.rig import Rig, smooth_rig
from plant.motion.reference import Motion, Reference
from plant.motion.smooth import Spline
from plant.motion.smooth_splines import smooth_splines
from plant.parts.fields import Floats
from plant.simulation.clock import Clock

# Samples of a path that is found from its counts, and the share of them that may have another
# count.
_FEW = 50
_MOST = 100_000
_MISSED = 0.05

_AT_ONCE = 1 << 16  # samples of a path that are found at once

# Samples from which the initial speed is estimated; and how far off a parabola rounding leaves them
# [pulses].
_FIRST = 10
_ON_A_PARABOLA = 1.5


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
        """What a law is given at times t (N,)."""
        return self.reference(t)

    def require_fit(self, law: Law) -> None:
        """Refuse a law that serves another motion alone; most serve any, and have no such rule."""
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
        self.whole = bool((reference_pulses == np.trunc(reference_pulses)).all())
        self._splines: dict[float, list[Any]] = {}

    def __call__(self, t: Floats) -> tuple[Motion, Floats]:
        place = self.clock.place(t)
        row = np.clip(np.floor(place).astype(int), 0, len(self.pulses) - 1)
        following = np.minimum(row + 1, len(self.pulses) - 1)
        step = self.pulses[following] - self.pulses[row]
        pulses = self.pulses[row] + step * np.maximum(place - row, 0)[:, None]
        speed = self.rig.to_angle(step / self.clock.apart(row))
        motion = Motion(self.rig.to_angle(pulses), speed, np.zeros_like(pulses))
        return motion, self.rig.encoder.quantised(pulses) if self.whole else pulses

    def smoothed(self, t: Floats, finer: float = 1.0) -> Motion:
        """The smoothest motion that the rounding of the counts allows; through all of them where
        they have fractions.

        A `finer` one has so many times as many knots: where the two differ, rounding hides the
        motion.
        """
        sampled = self.clock.t[self.clock.rows]
        if finer not in self._splines:
            encoder = self.rig.encoder
            centres = (
                encoder.position_in_pulses(encoder.cell_centre(self.pulses))
                if self.whole
                else self.pulses
            )
            self._splines[finer] = smooth_splines(sampled, centres, self.whole, finer)
        within = np.clip(t, 0, sampled[-1])
        splines = self._splines[finer]
        return Motion(
            *(
                self.rig.to_angle(np.column_stack([each(within, nu) for each in splines]))
                for nu in range(3)
            )
        )

    def setpoint(self, t: Floats) -> Motion:
        """What a law is given at times t (N,)."""
        return self.smoothed(t)

    def start(self) -> tuple[Floats, Floats]:
        """Position at t = 0, at rest: two counts give no velocity."""
        return self.rig.to_angle(self.pulses[0]), np.zeros(self.rig.n)


def path_of(record: Record, clock: Clock | None = None, *, smooth: bool = False) -> Path | Logged:
    """Commanded path of a record: its reference where it has one, its logged counts otherwise; both
    must agree.

    Smooth: not rounded to pulses; counts then stand for the middle of their quantisation cell. A
    reference whose logged counts have fractions is not rounded either.
    """
    clock = clock or Clock.of(record)
    if record.reference is None:
        rig = record.rig
        counts = record.reference_pulses
        centres = rig.encoder.position_in_pulses(rig.encoder.cell_centre(counts))
        return Logged(centres, smooth_rig(rig), clock) if smooth else Logged(counts, rig, clock)
    path = Path(record.reference, record.rig)
    own = counts_along(path, clock.t[clock.rows])
    off = np.abs(own - record.reference_pulses).max(axis=1)
    off[record.valid == 0] = 0
    wrong = np.flatnonzero(off > 1)
    if len(wrong) and not off_reference(record)[wrong].all():
        raise ValueError(
            f"reference_pulses must be the reference's own, from t = 0; sample {wrong[0]} is"
            f" {off[wrong[0]]:.0f} pulses off. {_scaled(record, own)}Correct the reference, or"
            " leave it out to replay the logged counts."
        )
    whole = (record.reference_pulses == np.trunc(record.reference_pulses)).all()
    return Path(record.reference, smooth_rig(record.rig)) if smooth or not whole else path


def _scaled(record: Record, own: Floats) -> str:
    """What to look at where logged counts are a joint's own (N, n) times a number: "" where they
    are not.
    """
    moved, logged = (each - each.mean(axis=0) for each in (own, record.reference_pulses))
    power = (moved * moved).sum(axis=0)
    ratio = np.where(power > 0, (moved * logged).sum(axis=0) / np.maximum(power, 1.0), 1.0)
    joint = int(np.argmax(np.abs(ratio - 1)))
    # both are rounded, and their means
    told = (np.abs(logged - ratio * moved) <= 1.5 + np.abs(ratio)).all()
    if not told or abs(ratio[joint] - 1) < 1e-3:
        return ""
    where = record.rig.joint_labels[joint]
    return (
        f"At {where} they are {ratio[joint]:.4g} times the reference's: check gear, pulses per turn"
        " and sign. "
    )


def counts_along(path: Path | Logged, t: Floats) -> Floats:
    """Counts (N, n) of a path at times t (N,), block by block: the motion of a long log takes
    much memory.
    """
    return np.concatenate([path(part)[1] for part in np.array_split(t, -(-len(t) // _AT_ONCE))])


def is_rounded(record: Record) -> bool:
    """Whether the path of a record is known as whole counts at its samples, of which its law may
    have known more.
    """
    asked = record.reference_pulses
    if (
        record.reference is not None
        or record.law is None
        or record.law.replays
        or record.rig.encoder.smooth
    ):
        return False
    return bool(np.ptp(asked) > 0 and (asked == np.trunc(asked)).all())


def with_path(record: Record) -> Record:
    """A record whose law acts between samples, too, with the smooth motion through its commanded
    counts as reference.

    Straight lines through counts lag by half a pulse between samples, which looks like late
    torques. The record itself, where its path is known, or is not smooth: its counts are to be
    those of the motion but for one sample in twenty.
    """
    law: Any = record.law
    if not is_rounded(record) or law.period is not None or law.initial_state(record.n).size:
        return record
    if not 2 * _FEW < len(record) <= _MOST:
        return record
    clock = Clock.of(record)
    times = clock.t[clock.rows]
    q = Logged(record.reference_pulses, record.rig, clock).smoothed(times).q
    off = np.abs(record.rig.counts(q) - record.reference_pulses)
    if off.max() > 1 or (off > 0).mean() > _MISSED or times[0] != 0:
        return record
    return dataclasses.replace(record, reference=Spline(times=times, points=q, at_rest=False))


def start_of(record: Record, path: Path | Logged) -> Any:
    """Position and velocity (n,) from which a record is replayed.

    The record's `initial`; otherwise the reference's, but a joint whose first error is a pulse or
    more (an arm that hangs in its P loop before it starts) is where its encoder reads, in the
    middle of that quantisation cell. Without a reference the arm starts at the speed of its first
    counts.
    """
    if record.initial is not None:
        return record.initial
    q, qd = path.start()
    counted = record.rig.cell_centre(record.reference_pulses[0] - record.error_pulses[0])
    coupling = record.rig.drive.coupling
    q = coupling.joint(
        np.where(np.abs(record.error_pulses[0]) >= 1, *map(coupling.shaft, (counted, q)))
    )
    return q, qd if record.reference is not None else _first_speed(record)


def _first_speed(record: Record) -> Floats:
    """Initial speed (n,) [rad/s] of a parabola through the first counts.

    Zero where they hardly move, or where a controller was switched on: there they are on no
    parabola.
    """
    t = record.t[:_FIRST] - record.t[0]
    counts = record.counts[:_FIRST]
    if len(t) < _FIRST or (np.ptp(counts, axis=0) <= 1).all():
        return np.zeros(record.n)
    scale = t[-1]
    fitted = np.polynomial.polynomial.polyfit(t / scale, counts, 2)
    off = np.abs(np.polynomial.polynomial.polyval(t / scale, fitted).T - counts).max(axis=0)
    switched_on = (off > _ON_A_PARABOLA) & (record.law is None or not record.law.replays)
    return record.rig.to_angle(np.where(switched_on, 0.0, fitted[1]) / scale)


def write_replay(record: Record, path: str | os.PathLike[str]) -> None:
    """Write the inputs of a controller in an experiment, as ``main.c`` replays them.

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
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.2)
    >>> write_replay(record, "record.csv")
    >>> Path("record.csv").read_text()[:17]
    'pulses_1,pulses_2'
    """
    followed = path_of(record)
    law = record.law
    motion = followed(record.t)[0] if law is None else followed.setpoint(record.t)
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

"""Are the counts those of an encoder? Motion, glitches, jumps, standstill, clipping."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.checkup.finding import Check, Finding
from plant.checkup.innovation import LEAST_MOTION, innovation, stopped
from plant.checkup.innovation import SETTINGS as MOTION
from plant.checkup.signals import Signals
from plant.parts import Bools, Floats, products


@dataclass(frozen=True, kw_only=True)
class CountSettings:
    """Limits of the checks of counts, chosen by hand.

    ``tests/plant/checkup/test_examine.py`` holds them against twenty right logs and spoiled ones.

    Parameters
    ----------
    equal_jumps : int
        Jumps above which those of one size are steps of a coarse grid.
    hunting_range : float
        Motion [LEAST_MOTION] below which a motor may only hunt about its reference.
    hunting_error : float
        Motion [range of its error] below which such a motor excites nothing.
    in_step : float
        Correlation of two speeds from which on joints move in step.
    standstill : float
        Standstill [s] from which on a check asks for its reason.
    stuck_error : float
        Motion of the reference [usual errors] during a standstill that means a stuck encoder.
    stiction : float
        Range of torque [twice the Coulomb friction] that no joint at rest can hold.
    long_standstill : float
        Standstill [s] under such torques that is more than the turning point of a motion.
    plateau : int
        Samples at an extreme that make a clipped peak.
    clipped_speed : float
        Speed [full speeds of the joint] on both sides of a clipped peak: of a sine that is cut off
        at 99 % of its height it is 0.14.
    """

    equal_jumps: int = 20
    hunting_range: float = 10
    hunting_error: float = 3.0
    in_step: float = 0.9999
    standstill: float = 0.02
    stuck_error: float = 3.0
    stiction: float = 2.5
    long_standstill: float = 0.1
    plateau: int = 5
    clipped_speed: float = 0.1


@dataclass(frozen=True, kw_only=True)
class LeftOutSettings:
    """Limits of the search for rows that are left out behind even stamps, chosen by hand.

    Parameters
    ----------
    even : float
        Deviation of the stamps from even times [intervals] up to which they hide a gap, and motion
        beyond that of one interval [intervals] from which on a row is missing.
    usual : float
        Quantile of the innovations that is no fault: many rows may lack.
    across : float
        Share of a jump's square that may lie across the direction of motion.
    """

    even: float = 0.5
    usual: float = 0.9
    across: float = 0.1


SETTINGS = CountSettings()
LEFT_OUT = LeftOutSettings()

_MORE_MOTION = "log a motion of all joints (design_motion), or identify with prior=, such as 0.3."


def hardly_moving(record) -> Bools:
    """Motors (n,) that move by less than `LEAST_MOTION`, or only hunt about their reference.

    Hunting counts only while the reference moves other joints.
    """
    # Ranges of each motor [pulses].
    moved, error, reference = (
        np.ptp(pulses, axis=0)
        for pulses in (record.counts, record.error_pulses, record.reference_pulses)
    )
    limit = np.minimum(SETTINGS.hunting_range * LEAST_MOTION, SETTINGS.hunting_error * error)
    hunting = (moved < limit) & (reference.max() >= LEAST_MOTION)
    # An injected torque excites a joint however little it moves.
    return (moved < LEAST_MOTION) | (hunting & (record.injected is None))


def hardly_asked(record) -> Bools:
    """Motors (n,) whose counts and reference both hardly move.

    Friction may hold them beside the reference, which is no mistake.
    """
    counts, reference = (
        np.ptp(pulses, axis=0) for pulses in (record.counts, record.reference_pulses)
    )
    return np.maximum(counts, reference) < SETTINGS.hunting_range * LEAST_MOTION


def in_step(speeds: Floats, least: float = SETTINGS.in_step) -> list[tuple[int, int]]:
    """Pairs of columns of speeds (N, n) with at least this correlation about zero."""
    # About zero and not about the mean: in step means proportional.
    lengths = np.sqrt((speeds**2).sum(axis=0))
    correlation = products(speeds / np.where(lengths > 0, lengths, np.inf))
    return [(int(i), int(j)) for i, j in np.argwhere(np.triu(np.abs(correlation) > least, 1))]


class Events(NamedTuple):
    """Outliers among the counts (M,) of a joint.

    Rows of glitches, which return at once, and of jumps, which stay; innovation (M - 1,) of each
    step; step of a grid that is coarse in places, or 0 [pulses].
    """

    glitches: NDArray[np.int_]
    jumps: NDArray[np.int_]
    sizes: Floats
    step: float


def counts_findings(signals: Signals, bridged: Signals) -> Iterator[Finding]:
    """Yield the findings about counts; `bridged`: without lost packets and stuck samples."""
    # 1. Rows that several joints lack together, before each joint is judged alone.
    odd_rows = [events(bridged, i) for i in range(signals.n)]
    left_out = renumbered(bridged)
    yield _left_out(bridged, left_out)

    # 2. Motion, then outliers: their findings come check by check, as the table shows them.
    pairs = in_step(signals.motion.speed[signals.clear]) if signals.long_enough else []
    for i in range(signals.n):
        yield _motion(signals, i, [signals.joint_labels[k] for k, j in pairs if j == i])
    for i, joint in enumerate(odd_rows):
        largest = np.abs(joint.sizes[joint.glitches - 1]).max(initial=0.0)
        advice = (
            f"Single counts are off by up to {largest:.0f} pulses; fits bridge them without weight;"
            " check the cable."
        )
        # A glitch in more than every hundredth row is a broken cable, not an accident.
        limit = 0.01 * len(signals.t)
        yield Check("glitches", i).graded(len(joint.glitches), advice, look=0, wrong=limit)
    for i, joint in enumerate(odd_rows):
        yield _jumps(bridged, i, joint, left_out)
    yield from signals.per_joint(_stuck, _clipped)


def _left_out(bridged, rows):
    times = ", ".join(f"{bridged.t[row]:.6g}" for row in rows[:3]) + ", ..." * (len(rows) > 3)
    advice = (
        f"Rows are lost, or repeated, at t = {times} s ({len(rows)} in all): joints jump along"
        " their motion together where stamps go on evenly; log the controller's stamps, or cut the"
        " log there."
    )
    return Check("rows left out").graded(len(rows), advice, look=0, wrong=0)


def _motion(signals, i, in_step_with):
    """Range of the counts [pulses], and the joints that move in step."""
    check = Check("motion", i, "pulses")
    pulses = np.ptp(signals.counts[:, i])
    moved = pulses / signals.least_count[i]
    # Motion of all other joints, in least counts.
    elsewhere = np.delete(np.ptp(signals.counts, axis=0) / signals.least_count, i)
    # Back to pulses from the quotient, which may differ from `pulses` in its last bit.
    value = moved * signals.least_count[i]
    if moved < LEAST_MOTION:
        fault = "hardly moves"
        if len(elsewhere) and elsewhere.max() > 10 * LEAST_MOTION:
            reasons = (
                "it sticks, its brake is on, its encoder is dead or in other units, or it was"
                " asked to"
            )
            fault = f"stands still while others move ({reasons})"
        return check.wrong(value, f"The motor {fault}: {_MORE_MOTION}")
    if hardly_moving(signals.record)[i]:
        return check.look(value, f"The motor moves by little more than its error: {_MORE_MOTION}")
    if in_step_with:
        advice = (
            f"It moves in step with {', '.join(in_step_with)}: that hardly tells their parameters"
            " apart; log a motion that excites more (design_motion)."
        )
        return check.look(value, advice)
    return check.fine(value)


def _jumps(bridged, i, joint, left_out):
    rows = joint.jumps
    if len(left_out):
        # Where rows are left out, jumps along the motion are theirs.
        along = joint.sizes[rows - 1] * bridged.local_speed[rows - 1, i] > 0
        rows = rows[~along & ~np.isin(rows, left_out)]
    largest = np.abs(joint.sizes[rows - 1]).max(initial=0.0)
    advice = (
        f"The counts jump by up to {largest:.0f} pulses and stay there, faster than any arm; cut"
        " the log there. Fits take whole turns back by themselves."
    )
    if joint.step:
        advice = (
            f"In places the counts go in steps of {joint.step:.3g} pulses; log them with more"
            " digits."
        )
    # A coarse grid loses digits and nothing else: look, but not wrong.
    wrong = np.inf if joint.step else 0
    return Check("jumps", i).graded(len(rows), advice, look=0, wrong=wrong)


def events(signals: Signals, i: int) -> Events:
    """Find the outliers among the counts of joint i."""
    # 1. Innovations that neither noise, timing nor the arm explain.
    innovation = signals.innovation.size[:, i]
    outliers = np.flatnonzero(signals.innovation.outlier[:, i])

    # 2. Many jumps of one size are no accident: a grid that is coarse in places.
    sizes = np.abs(innovation[outliers])
    common = np.median(sizes) if len(sizes) > SETTINGS.equal_jumps else 0.0
    if common and np.mean(np.abs(sizes - common) < 0.05 * common) > 0.8:
        return Events(outliers[:0] + 1, outliers + 1, innovation, common)

    # 3. A glitch returns with the next step, by the same size within a half; a jump stays.
    glitches = list[int]()
    jumps = list[int]()
    # Teeth that meet stop a motor within samples: no step is faster than the motion is elsewhere.
    slow = np.abs(np.diff(signals.counts[:, i])) <= signals.full_speed[i] * np.diff(signals.t)
    for k in outliers.tolist():
        if glitches and k == glitches[-1] + 1:
            continue  # the step back from a glitch
        # The next step goes the other way ...
        back = k + 1 < len(innovation) and innovation[k + 1] * innovation[k] < 0
        # ... and cancels at least half of this one.
        if back and abs(innovation[k + 1] + innovation[k]) < 0.5 * abs(innovation[k]):
            glitches.append(k)
            continue
        # Beside a jump the counts have the speed of the motion; a motor that is stopped lacks
        # at least half of this step in the step before or behind, too.
        steps = slice(max(k - 1, 0), k + 2)
        alike = innovation[steps] * np.sign(innovation[k]) > 0.5 * abs(innovation[k])
        if (alike & slow[steps]).sum() < 2 or not slow[k]:
            jumps.append(k)
    return Events(np.array(glitches, int) + 1, np.array(jumps, int) + 1, innovation, 0.0)


def renumbered(signals: Signals) -> NDArray[np.int_]:
    """Rows that follow left out, or repeated, rows which the stamps do not show.

    There several joints jump along their motion, or stop for a row that a logger repeated.
    """
    reach = MOTION.neighbours
    if signals.n < 2 or len(signals.t) < 10 * reach:
        return np.array([], int)
    # 1. Excess of each step over the motion, with the speed of the rows around it.
    spans = np.diff(signals.t)
    # Beside a gap the local speed is wrong, so it is taken some rows away on both sides.
    padded = np.pad(signals.local_speed, ((reach, reach), (0, 0)), mode="edge")
    speed = (padded[: -2 * reach] + padded[2 * reach :]) / 2
    excess, noise, arm, _ = innovation(signals, speed, LEFT_OUT.usual)

    # 2. The gap [s] that fits the excess of all joints, which must lie along the motion.
    power = np.maximum((speed**2).sum(axis=1), 1e-300)
    gap = (excess * speed).sum(axis=1) / power
    across = ((excess - gap[:, None] * speed) ** 2).sum(axis=1)
    along = across < LEFT_OUT.across * (excess**2).sum(axis=1)
    # One joint alone may have jumped by itself; several may have started together.
    several = (np.abs(excess) > noise).sum(axis=1) > 1
    several &= (np.abs(excess) > noise + arm).any(axis=1)

    # 3. Stamps that hide it are even. What was only late comes back in the next rows, so the sum of
    # the gaps over these rows must lack the time, too.
    neighbours = np.ones(reach + 1)
    late = np.convolve(spans / signals.interval - 1, neighbours, mode="same")
    even = np.abs(late) < LEFT_OUT.even
    even &= np.abs(spans / signals.interval - 1) < LEFT_OUT.even
    remaining = np.minimum(np.abs(gap), np.abs(np.convolve(gap, neighbours, mode="same")))
    missing = remaining > LEFT_OUT.even * signals.interval
    # Near an end of the log no motion on both sides tells what a row should have been.
    known = np.ones(len(spans), bool)
    known[: 2 * reach] = known[-2 * reach :] = False
    return np.flatnonzero(even & along & several & missing & known) + 1


def _runs(counts):
    """Stretches of equal counts, as slices of rows."""
    # Each change of the count begins a stretch.
    edges = np.flatnonzero(np.diff(counts) != 0) + 1
    stops = np.append(edges, len(counts))
    for start, stop in zip(np.append(0, edges), stops, strict=True):
        yield slice(start, stop)


def _stuck(signals, i):
    """The longest unexplained standstill [s]."""
    check = Check("stuck encoder", i, "s")

    def seconds(run):
        return float(signals.t[run.stop - 1] - signals.t[run.start])

    # In slow logs at least five intervals, since a slow motion repeats counts, too.
    least = max(SETTINGS.standstill, 5 * signals.interval)
    runs = [run for run in _runs(signals.counts[:, i]) if seconds(run) >= least]
    unexplained, evidence = _against_torque, "under torques that its friction cannot hold"
    if signals.reference is not None:
        unexplained, evidence = _against_reference, "while the reference moves on"
    stuck = max(map(seconds, unexplained(signals, i, runs)), default=0.0)
    if stuck or signals.reference is not None:
        advice = (
            f"The counts stand still {evidence}; leave these rows out (valid = 0), check the"
            " encoder."
        )
        return check.graded(stuck, advice, look=0, wrong=0)

    # Rest alone is no fault.
    longest = max(map(seconds, runs), default=0.0)
    if longest > SETTINGS.long_standstill:
        return check.unknown("neither reference nor torque tells why it rests", longest)
    return check.fine(0.0)


def _against_reference(signals, i, runs):
    """Standstills in which the reference moves on by more than friction explains elsewhere."""
    reference = signals.reference[:, i]
    # The usual error is that of the rows in which the joint moves.
    running = np.ones(len(signals.t), bool)
    for run in runs:
        running[run] = False
    error = np.abs(reference - signals.counts[:, i])[running]
    largest = np.quantile(error, 0.99) if len(error) else 0.0
    # Ten counts more, for loops with hardly any error.
    usual = 10 * signals.least_count[i] + SETTINGS.stuck_error * largest
    return [run for run in runs if np.ptp(reference[run]) > usual]


def _against_torque(signals, i, runs):
    """Standstills under torques beyond the stated friction; none where none is stated."""
    friction = signals.rig.drive.coulomb[i]
    if signals.torque is None or not friction:
        return []
    least = SETTINGS.long_standstill / signals.interval
    # Friction holds a joint between plus and minus its Coulomb torque.
    largest = 2 * SETTINGS.stiction * friction
    return [
        run
        for run in runs
        if run.stop - run.start > least and np.ptp(signals.torque[run, i]) > largest
    ]


def _clipped(signals, i):
    """Time at an extreme that was reached at full speed [s]."""
    counts = signals.counts[:, i]
    t = signals.t
    # An ordinary motion slows down before it turns; its rounding is half a count at each end.
    fast = max(
        SETTINGS.clipped_speed * signals.full_speed[i] * signals.interval,
        2 * signals.least_count[i] + stopped(signals.rig, signals.interval)[i],
    )
    clipped = 0.0
    extremes = counts.min(), counts.max()
    for run in _runs(counts):
        # Only a stretch at the extreme of the log is cut off.
        if run.stop - run.start < SETTINGS.plateau or counts[run.start] not in extremes:
            continue
        # A motion that turns by itself is slow beside its extreme.
        end = run.stop - 1
        approach = np.abs(np.diff(counts[max(run.start - 3, 0) : run.start + 1]))
        departure = np.abs(np.diff(counts[end : end + 4]))
        if all(len(s) and s.min() > 0 and s.mean() > fast for s in (approach, departure)):
            clipped += t[end] - t[run.start]
    advice = (
        "Peaks are cut off at one value: the converter's range, or a mechanical stop; leave these"
        " rows out."
    )
    # Beyond a twentieth of the log the motion itself is lost.
    limit = 0.05 * (t[-1] - t[0])
    return Check("clipped counts", i, "s").graded(clipped, advice, look=0, wrong=limit)

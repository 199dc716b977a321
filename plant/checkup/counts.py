"""Are the counts an encoder's: motion, glitches, jumps, standstill, clipping."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.checkup.finding import Finding
from plant.checkup.signals import LEAST_MOTION, Signals
from plant.parts.fields import Floats
from plant.parts.sums import products

_SPIKE = 4.0  # outlier limit of an innovation: so many pulses, and so many times the 98 % quantile

_MANY = 20  # number of equal jumps from which on they are steps of a coarse grid

# jitter of a count's sampling [samples]; the difference of the intervals about it adds to that
_MISTIMED = 0.2

_RUN = 0.02  # standstill [s] from which on its reason is checked

# an encoder is stuck if the reference moves on by so many times the error usual in this log
_BEYOND = 3.0

# A joint at rest holds torques over a range of twice its Coulomb friction; above so many times it
# should move.
_STICTION = 2.5

_LONG = 0.1  # standstill [s] under too much torque that is more than the turning point of a motion

_HELD = 0.2  # share of the log that a joint may rest without a reason while others move

# samples at an extreme, and counts per sample on the way there, that make a clipped peak
_PLATEAU = 5


# A motion of fewer counts, in units of `LEAST_MOTION`, and of less than so many times its error,
# excites nothing.
_FEW = 10
_OF_ERROR = 3.0

# Rows to each side whose speeds tell that across a gap; share by which its stamps may be off,
# intervals that are lacking, and share of the jumps' squares that are not along the motion.
_ASIDE = 4
_EVEN = 0.5
_LACKS = 0.6
_ALONG = 0.1

_IN_STEP = 0.9999  # correlation of two speeds from which on joints move in step


def hardly_moving(record: Any) -> NDArray[np.bool_]:
    """Motors (n,) that move by less than `LEAST_MOTION`, or do little but hunt about a reference
    that moves others.
    """
    moved, error, asked = (
        np.ptp(x, axis=0) for x in (record.counts, record.error_pulses, record.reference_pulses)
    )
    hunting = (moved < np.minimum(_FEW * LEAST_MOTION, _OF_ERROR * error)) & (
        asked.max() >= LEAST_MOTION
    )
    return np.asarray((moved < LEAST_MOTION) | (hunting & (record.injected is None)))


def hardly_asked(record: Any) -> NDArray[np.bool_]:
    """Those of them (n,) whose reference asks for no more: friction may hold them beside it,
    which is no mistake.
    """
    return hardly_moving(record) & (np.ptp(record.reference_pulses, axis=0) < _FEW * LEAST_MOTION)


def in_step(speeds: Floats, least: float = _IN_STEP) -> list[tuple[int, int]]:
    """Pairs of columns of speeds (N, n) that are proportional all along, from this correlation
    on.
    """
    lengths = np.sqrt((speeds**2).sum(axis=0))
    together = products(speeds / np.where(lengths > 0, lengths, np.inf))
    return [(int(i), int(j)) for i, j in np.argwhere(np.triu(np.abs(together) > least, 1))]


def counts_findings(signals: Signals, whole: Signals) -> Iterator[Finding]:
    """Yield the findings about counts, check by check; `whole`: with lost packets and stuck
    samples bridged.
    """
    found = [events(whole, i) for i in range(signals.n)]
    left_out = renumbered(whole, [jumps for _, jumps, *_ in found])
    places = ", ".join(f"{whole.t[row]:.6g}" for row in left_out[:3]) + ", ..." * (
        len(left_out) > 3
    )
    advice = (
        f"Rows are lost at t = {places} s ({len(left_out)} in all): joints jump along their motion"
        " together where stamps go on evenly; log the controller's stamps, or cut the log there."
    )
    yield Finding.graded("rows left out", None, len(left_out), "", look=0, wrong=0, advice=advice)
    pairs = in_step(signals.motion[1][signals.clear]) if signals.long_enough else []
    yield from (
        _motion(signals, i, [signals.joint_labels[k] for k, j in pairs if j == i])
        for i in range(signals.n)
    )
    for i, (glitches, _, size, _) in enumerate(found):
        largest = np.abs(size[glitches - 1]).max(initial=0.0)
        advice = (
            f"Single counts are off by up to {largest:.0f} pulses; fits bridge them without weight;"
            " check the cable."
        )
        yield Finding.graded(
            "glitches", i, len(glitches), "", look=0, wrong=0.01 * len(signals.t), advice=advice
        )
    for i, (_, rows, size, step) in enumerate(found):
        jumps = (
            rows[size[rows - 1] * whole.local_speed[rows - 1, i] <= 0] if len(left_out) else rows
        )
        jump = (
            f"jump by up to {np.abs(size[jumps - 1]).max(initial=0.0):.0f} pulses and stay there,"
            " faster than any arm"
        )
        advice = f"The counts {jump}; cut the log there. Fits take whole turns back by themselves."
        if step:
            advice = (
                f"In places the counts go in steps of {step:.3g} pulses; log them with more digits."
            )
        yield Finding.graded(
            "jumps", i, len(jumps), "", look=0, wrong=np.inf if step else 0, advice=advice
        )
    yield from signals.each(_stuck, _clipped)


_MORE = "log a motion of all joints (design_motion), or identify with prior=, such as 0.3."


def _motion(signals, i, alike):
    moved = np.ptp(signals.counts[:, i]) / signals.least_count[i]
    others = np.delete(np.ptp(signals.counts, axis=0) / signals.least_count, i)
    verdict = "fine"
    advice = ""
    if moved < LEAST_MOTION:
        why = "hardly moves"
        if len(others) and others.max() > 10 * LEAST_MOTION:
            reasons = (
                "it sticks, its brake is on, its encoder is dead or in other units, or it was"
                " asked to"
            )
            why = f"stands still while others move ({reasons})"
        verdict = "wrong"
        advice = f"The motor {why}: {_MORE}"
    elif hardly_moving(signals.record)[i]:
        verdict = "look"
        advice = f"The motor moves by little more than its error: {_MORE}"
    elif alike:
        why = f"It moves in step with {', '.join(alike)}: that hardly tells their parameters apart"
        verdict = "look"
        advice = f"{why}; log a motion that excites more (design_motion)."
    return Finding.of("motion", i, moved * signals.least_count[i], "pulses", verdict, advice)


def events(signals: Signals, i: int) -> tuple[Any, Any, Any, float]:
    """Rows of glitches and of jumps; how far each row is off (M - 1,); and the step of a coarse
    grid, or 0 [pulses].
    """
    around = signals.local_speed[:, i]
    spans = np.diff(signals.t)
    innovation = np.diff(signals.counts[:, i]) - around * spans
    usual = np.quantile(np.abs(innovation), 0.98)
    odd = np.abs(np.pad(spans, 1, mode="edge") - signals.interval)
    mistimed = _MISTIMED * signals.interval + np.maximum(np.maximum(odd[:-2], odd[1:-1]), odd[2:])
    limit = _SPIKE * max(signals.least_count[i], usual) + np.abs(around) * mistimed
    strange = np.flatnonzero(np.abs(innovation) > limit)
    steps = np.abs(innovation[strange])
    common = np.median(steps) if len(steps) > _MANY else 0.0
    # no accident: a grid, coarse in places
    if common and np.mean(np.abs(steps - common) < 0.05 * common) > 0.8:
        return strange[:0] + 1, strange + 1, innovation, common
    glitches = list[int]()
    jumps = list[int]()
    last = -2
    for k in strange.tolist():
        if k == last:  # the way back from a glitch
            continue
        back = k + 1 < len(innovation) and innovation[k + 1] * innovation[k] < 0
        if back and abs(innovation[k + 1] + innovation[k]) < 0.5 * abs(innovation[k]):
            glitches.append(k)
            last = k + 1
        else:
            jumps.append(k)
    rows = np.array(glitches, dtype=int), np.array(jumps, dtype=int)
    return rows[0] + 1, rows[1] + 1, innovation, 0.0


def renumbered(signals: Signals, jumps: Sequence[Any]) -> Any:
    """Rows after rows that a log lacks, unseen in its stamps: several joints, or all, jump along
    their motion.

    `jumps`: rows of the jumps of each joint.
    """
    if signals.n < 2 or len(signals.t) < 10 * _ASIDE:
        return np.array([], int)
    spans = np.diff(signals.t)
    speed = signals.local_speed
    wide = np.pad(speed, ((_ASIDE, _ASIDE), (0, 0)), mode="edge")
    speed = (wide[: -2 * _ASIDE] + wide[2 * _ASIDE :]) / 2
    size = np.diff(signals.counts, axis=0) - speed * spans[:, None]
    nearby = np.ones(_ASIDE + 1)
    late = np.convolve(spans / signals.interval - 1, nearby, mode="same")
    power = np.maximum((speed**2).sum(axis=1), 1e-300)
    gap = (size * speed).sum(axis=1) / power
    off = ((size - gap[:, None] * speed) ** 2).sum(axis=1) < _ALONG * (size**2).sum(axis=1)
    # much where a loop oscillates
    usual = np.maximum(signals.least_count, np.quantile(np.abs(size), 0.9, axis=0))
    several = (np.abs(size) > _SPIKE * usual).sum(axis=1) > 1
    even = (np.abs(late) < _EVEN) & (np.abs(spans / signals.interval - 1) < _EVEN)
    # What was late comes back.
    lacks = np.minimum(gap, np.convolve(gap, nearby, mode="same")) > _LACKS * signals.interval
    alike = even & off & several & lacks
    together = [k for k in set.intersection(*(set(rows.tolist()) for rows in jumps)) if even[k - 1]]
    return np.union1d(np.flatnonzero(alike) + 1, np.array(together, int))


def _runs(counts):
    """First and last row of every stretch of equal counts."""
    edges = np.flatnonzero(np.diff(counts) != 0)
    return np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(counts) - 1]])


def _stuck(signals, i):
    """The longest unexplained standstill [s]."""
    first, last = _runs(signals.counts[:, i])
    length = signals.t[last] - signals.t[first]
    long = length >= max(_RUN, 5 * signals.interval)
    rows = [slice(a, b + 1) for a, b in zip(first[long], last[long], strict=True)]
    if signals.reference is not None:
        strange = _against_reference(signals, i, rows)
        advice = "while the reference moves on"
    else:
        strange = _against_torque(signals, i, rows)
        advice = "under torques that its friction cannot hold"
    stuck = max((signals.t[run.stop - 1] - signals.t[run.start] for run in strange), default=0.0)
    if stuck or signals.reference is not None:
        advice = (
            f"The counts stand still {advice}; leave these rows out (valid = 0), check the encoder."
        )
        return Finding.graded("stuck encoder", i, stuck, "s", look=0, wrong=0, advice=advice)
    others = np.delete(signals.counts, i, axis=1)
    whole = signals.t[-1] - signals.t[0]
    for run in rows:
        seconds = signals.t[run.stop - 1] - signals.t[run.start]
        if (
            others.size
            and seconds > _HELD * whole
            and np.ptp(others[run], axis=0).max() > 10 * LEAST_MOTION
        ):
            stuck = max(stuck, seconds)
    advice = (
        "The joint rests for a large part of the log while others move; does it stick, or its"
        " encoder?"
    )
    return Finding.graded("stuck encoder", i, stuck, "s", look=0, advice=advice)


def _against_reference(signals, i, rows):
    """Standstills in which the reference moves on by more than the error that friction causes
    elsewhere.
    """
    reference = signals.reference[:, i]
    running = np.ones(len(signals.t), bool)
    for run in rows:
        running[run] = False
    error = np.abs(reference - signals.counts[:, i])[running]
    usual = 10 * signals.least_count[i] + _BEYOND * (
        np.quantile(error, 0.99) if len(error) else 0.0
    )
    return [run for run in rows if np.ptp(reference[run]) > usual]


def _against_torque(signals, i, rows):
    """Standstills under torques that the stated friction cannot hold; none where no friction is
    stated.
    """
    friction = signals.rig.drive.coulomb[i]
    if signals.torque is None or not friction:
        return []
    least = _LONG / signals.interval
    long = [run for run in rows if run.stop - run.start > least]
    return [run for run in long if np.ptp(signals.torque[run, i]) > 2 * _STICTION * friction]


def _clipped(signals, i):
    """Time at an extreme that was reached at full speed [s]."""
    counts = signals.counts[:, i]
    t = signals.t
    first, last = _runs(counts)
    spent = 0.0
    for extreme in (counts.min(), counts.max()):
        for a, b in zip(first, last, strict=True):
            if counts[a] != extreme or b - a + 1 < _PLATEAU:
                continue
            before = np.abs(np.diff(counts[max(a - 3, 0) : a + 1]))
            after = np.abs(np.diff(counts[b : b + 4]))
            fast = _PLATEAU / 2 * signals.least_count[i]
            if all(len(side) and side.min() > 0 and side.mean() > fast for side in (before, after)):
                spent += t[b] - t[a]
    advice = (
        "Peaks are cut off at one value: the converter's range, or a mechanical stop; leave these"
        " rows out."
    )
    return Finding.graded(
        "clipped counts", i, spent, "s", look=0, wrong=0.05 * (t[-1] - t[0]), advice=advice
    )

"""Are the counts an encoder's: glitches, jumps, standstill, clipping, units, quantisation, noise."""

from __future__ import annotations

import numpy as np

from plant.finding import Finding

__all__ = ["counts_findings"]

_LEAST_MOTION = 20
"""Counts that a motor has to move, at least."""

_SPIKE = 4.0
"""Departure of one count from its neighbours: so many pulses, and so many times what 98 % of the samples show."""

_MANY = 20
"""Jumps, all alike, from which on they are steps of a coarse grid."""

_MISTIMED = 0.2
"""Share of a sample by which a count may be taken early or late; by as much as the intervals about it differ, too."""

_RUN = 0.02
"""Standstill [s] that is worth a look at what should have moved the arm."""

_BEYOND = 3.0
"""Standstill is strange when the reference goes on by so many times the error usual in this log."""

_STICTION = 2.5
"""A joint at rest holds torques over a range of twice its dry friction; above so many times it should have moved."""

_LONG = 0.1
"""Standstill [s] under too much torque that no stated friction, however rough, explains."""

_HELD = 0.2
"""Share of the log that a joint may rest, nothing said of why, while others move."""

_PLATEAU = 5
"""Samples at an extreme, and so many counts per sample on the way there, that make a clipped peak."""

_COMB = 0.8
"""Regularity (0 to 1) of the counts from which on they lie on a coarser grid."""

_FINEST = 1.43
"""Smallest step [pulses] that still leaves a comb after rounding; below, it looks like another, coarser one."""

_COMB_WHOLE = 1.7
"""What the regularity comes to when only every second count is there, and a little; more has another cause."""

_CHANCE = 5.0
"""Times what random counts would show, in standard deviations."""

_DISTINCT = 50
"""Different counts from which a step can be told."""

_NOISY = 0.6
"""Scatter [pulses] that rounding (0.29) does not explain."""


def counts_findings(signals):
    """Yield the findings about counts, check by check.

    Parameters
    ----------
    signals : Signals
    """
    if len(signals.t) < 10:
        yield Finding.unknown("motion", None, "fewer than ten samples")
        return
    events = [_events(signals, i) for i in range(signals.n)]
    for check in (_motion, _units, _step, _noise):
        for i in range(signals.n):
            yield check(signals, i)
    for i, (glitches, _, size) in enumerate(events):
        yield Finding.graded(
            "glitches", i, glitches, "", look=0, wrong=0.01 * len(signals.t),
            advice=f"Single counts are off by up to {size[0]:.0f} pulses; leave them out (valid = 0), check the cable.",
        )  # fmt: skip
    for i, (_, jumps, size) in enumerate(events):
        if size[2]:
            advice = f"In places the counts go in steps of {size[2]:.3g} pulses; log them with more digits."
            yield Finding(check="jumps", joint=i, value=float(jumps), unit="", verdict="look", advice=advice)
            continue
        yield Finding.graded(
            "jumps", i, jumps, "", look=0, wrong=0,
            advice=f"The counts jump by up to {size[1]:.0f} pulses and stay there, faster than any arm; unwrap the "
            "counter, or cut the log there.",
        )  # fmt: skip
    for check in (_stuck, _clipped):
        for i in range(signals.n):
            yield check(signals, i)


def _motion(signals, i):
    moved = np.ptp(signals.counts[:, i]) / signals.grain[i]
    others = np.delete(np.ptp(signals.counts, axis=0) / signals.grain, i)
    verdict, advice = "fine", ""
    if moved < _LEAST_MOTION:
        verdict = "wrong"
        advice = "The motor hardly moves: log a motion of all joints."
        if len(others) and others.max() > 10 * _LEAST_MOTION:
            advice = (
                "The motor stands still while others move: it sticks, its brake is on, or its encoder is dead or in "
                "other units."
            )
    return Finding(check="motion", joint=i, value=float(moved * signals.grain[i]), unit="pulses", verdict=verdict,
                   advice=advice)  # fmt: skip


def _units(signals, i):
    """Counts are whole; angles are not."""
    counts = signals.counts[:, i]
    if signals.rig.encoder.smooth:
        return Finding.unknown("units of counts", i, "the encoder is said not to round")
    broken = 100 * np.mean(counts != np.round(counts))
    if not broken:
        return Finding(check="units of counts", joint=i, value=0.0, unit="% not whole", verdict="fine")
    verdict, advice = "look", "Counts are whole; these were shifted or scaled after counting."
    if signals.angular[i]:
        unit = "radians" if np.ptp(counts) < 4 * np.pi else "degrees"
        verdict, advice = "wrong", f"These look like {unit}, not counts; turn angles of the joints into rig.pulses(q)."
    return Finding(check="units of counts", joint=i, value=broken, unit="% not whole", verdict=verdict, advice=advice)


def _step(signals, i):
    """The grid that the counts lie on, in pulses; 1 is what was stated."""
    if signals.rig.encoder.smooth:
        return Finding.unknown("quantisation step", i, "the encoder is said not to round")
    levels = np.unique(np.round(signals.counts[:, i]))
    if len(levels) < _DISTINCT:
        return Finding.unknown("quantisation step", i, f"only {len(levels)} different counts")
    step, clear = comb(signals.counts[:, i])
    if not clear:
        return Finding.unknown("quantisation step", i, f"always faster than {step:.0f} pulses per sample")
    return Finding.graded(
        "quantisation step", i, step, "pulses", look=1.02,
        advice=f"Counts come in steps of {step:.4g}: the encoder has {signals.rig.encoder.resolution[i] / step:.6g} "
        f"pulses per turn, not {signals.rig.encoder.resolution[i]:g}, or was rounded to another step before.",
    )  # fmt: skip


def comb(counts):
    """Step of the grid that whole counts (N,) lie on, and whether the motion is ever slow enough to tell.

    Counts of a coarser encoder, whole or rounded again, leave a comb in the histogram. Its period is the frequency at
    which the visited counts are most alike in phase; it cannot exceed the smallest steps of the motion by more than
    the rounding.
    """
    counts = np.round(counts)
    steps = np.abs(np.diff(counts))
    smallest = np.quantile(steps[steps > 0], 0.02)
    levels = np.unique(counts)
    levels = levels[: 1 << 16] - levels[0]
    if smallest > 50 or levels[-1] > 5e7:
        return smallest, False
    length = 1 << int(np.ceil(np.log2(4 * levels[-1] + 8)))
    visited = np.zeros(length)
    visited[levels.astype(int)] = 1
    power = np.abs(np.fft.rfft(visited)) / len(levels)
    frequency = np.arange(len(power)) / length
    best, regular = 1.0, _COMB
    for folded in (frequency, 1 - frequency):  # a step between 1 and 2 shows beyond half a cycle per count, folded
        step = 1 / np.maximum(folded, 1e-9)
        allowed = (step >= _FINEST) & (step <= smallest + 1) & (power > _CHANCE / np.sqrt(len(levels)))
        share = power / np.sinc(np.minimum(1 / step, 1 / _FINEST))  # rounding again leaves that much of a comb
        share = np.where(allowed & (share < _COMB_WHOLE), share, 0)
        k = int(np.argmax(share))
        if share[k] > regular:
            best, regular = float(step[k]), share[k]
    return best, True


def _noise(signals, i):
    noise = signals.noise[i]
    if not np.isfinite(noise):
        return Finding.unknown("noise", i, "too few samples")
    if signals.rig.encoder.smooth:
        return Finding(check="noise", joint=i, value=float(noise), unit="pulses", verdict="fine")
    grid = _step(signals, i).value or 1.0
    return Finding.graded(
        "noise", i, noise, "pulses", look=_NOISY * grid, wrong=10 * grid,
        advice="The counts scatter more than rounding does, even where the arm is slowest; look for interference.",
    )  # fmt: skip


def _events(signals, i):
    """Glitches, jumps, and the largest of each [pulses]; last, the step of a grid that only looks like jumps, or 0."""
    around, spans = signals.local_speed[:, i], np.diff(signals.t)
    surprise = np.diff(signals.counts[:, i]) - around * spans
    usual = np.quantile(np.abs(surprise), 0.98)
    odd = np.abs(np.pad(spans, 1, mode="edge") - signals.interval)
    mistimed = _MISTIMED * signals.interval + np.maximum(np.maximum(odd[:-2], odd[1:-1]), odd[2:])
    limit = _SPIKE * max(signals.grain[i], usual) + np.abs(around) * mistimed
    strange = np.flatnonzero(np.abs(surprise) > limit)
    glitches, jumps, sizes, last = 0, 0, [0.0, 0.0, 0.0], -2
    steps = np.abs(surprise[strange])
    common = np.median(steps) if len(steps) > _MANY else 0.0
    if common and np.mean(np.abs(steps - common) < 0.05 * common) > 0.8:  # no accident: a grid, coarse in places
        return 0, len(steps), [0.0, common, common]
    for k in strange:
        if k == last:  # the way back from a glitch
            continue
        back = k + 1 < len(surprise) and surprise[k + 1] * surprise[k] < 0
        if back and abs(surprise[k + 1] + surprise[k]) < 0.5 * abs(surprise[k]):
            glitches, sizes[0], last = glitches + 1, max(sizes[0], abs(surprise[k])), k + 1
        else:
            jumps, sizes[1] = jumps + 1, max(sizes[1], abs(surprise[k]))
    return glitches, jumps, sizes


def _runs(counts):
    """First and last row of every stretch of equal counts."""
    edges = np.flatnonzero(np.diff(counts) != 0)
    return np.concatenate([[0], edges + 1]), np.concatenate([edges, [len(counts) - 1]])


def _stuck(signals, i):
    """The longest standstill that nothing explains [s]."""
    first, last = _runs(signals.counts[:, i])
    length = signals.t[last] - signals.t[first]
    long = length >= max(_RUN, 5 * signals.interval)
    rows = [slice(a, b + 1) for a, b in zip(first[long], last[long], strict=True)]
    if signals.reference is not None:
        strange, advice = _against_reference(signals, i, rows), "while the reference moves on"
    else:
        strange, advice = _against_torque(signals, i, rows), "under torques that its friction cannot hold"
    stuck = max((signals.t[run.stop - 1] - signals.t[run.start] for run in strange), default=0.0)
    if stuck or signals.reference is not None:
        advice = f"The counts stand still {advice}; leave these rows out (valid = 0), check the encoder."
        wrong = 0 if signals.reference is not None else _LONG
        return Finding.graded("stuck encoder", i, stuck, "s", look=0, wrong=wrong, advice=advice)
    others = np.delete(signals.counts, i, axis=1)
    whole = signals.t[-1] - signals.t[0]
    for run in rows:
        seconds = signals.t[run.stop - 1] - signals.t[run.start]
        if others.size and seconds > _HELD * whole and np.ptp(others[run], axis=0).max() > 10 * _LEAST_MOTION:
            stuck = max(stuck, seconds)
    return Finding.graded(
        "stuck encoder", i, stuck, "s", look=0,
        advice="The joint rests for a large part of the log while others move; does it stick, or its encoder?",
    )  # fmt: skip


def _against_reference(signals, i, rows):
    """Standstills in which the reference goes further than friction lets it elsewhere."""
    reference, running = signals.reference[:, i], np.ones(len(signals.t), bool)
    for run in rows:
        running[run] = False
    error = np.abs(reference - signals.counts[:, i])[running]
    usual = 10 * signals.grain[i] + _BEYOND * (np.quantile(error, 0.99) if len(error) else 0.0)
    return [run for run in rows if np.ptp(reference[run]) > usual]


def _against_torque(signals, i, rows):
    """Standstills over a range of torques that stated friction cannot hold; none where no friction is stated."""
    friction = signals.rig.drive.coulomb[i]
    if signals.torque is None or not friction:
        return []
    return [run for run in rows if np.ptp(signals.torque[run, i]) > 2 * _STICTION * friction]


def _clipped(signals, i):
    """Time at an extreme that was reached at full speed [s]."""
    counts, t = signals.counts[:, i], signals.t
    first, last = _runs(counts)
    spent = 0.0
    for extreme in (counts.min(), counts.max()):
        for a, b in zip(first, last, strict=True):
            if counts[a] != extreme or b - a + 1 < _PLATEAU:
                continue
            before, after = np.abs(np.diff(counts[max(a - 3, 0) : a + 1])), np.abs(np.diff(counts[b : b + 4]))
            fast = _PLATEAU / 2 * signals.grain[i]
            if all(len(side) and side.min() > 0 and side.mean() > fast for side in (before, after)):
                spent += t[b] - t[a]
    return Finding.graded(
        "clipped counts", i, spent, "s", look=0, wrong=0.05 * (t[-1] - t[0]),
        advice="Peaks are cut off at one value: the converter's range, or a mechanical stop; leave these rows out.",
    )  # fmt: skip

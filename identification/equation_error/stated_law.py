"""Test of a stated law: its torque along a log, from the best state, against the logged torque."""

from dataclasses import replace
from typing import Any

import numpy as np

from identification.equation_error.law_memory import (
    FADED,
    Memory,
    at_work,
    reading,
    state_directions,
)
from identification.equation_error.torque_logs import (
    is_faster,
    law_torque,
    logged_torque,
    measured_torque,
    torque_of,
)
from identification.equation_error.torque_noise import (
    independent_noise,
    is_white,
    white_noise,
)
from plant import Record, Resumed
from plant.parts import Floats, dot, frozen_settings, least
from plant.simulation import path_of, run_law, start_of


@frozen_settings
class StatedLawSettings:
    """When a law began with its log; chosen by hand.

    Parameters
    ----------
    ratio : float
        Largest ratio of the distances from the logged torque of a law that began with the log, and
        of one in the best state.
    equal : float
        Distance from the logged torque that does not count, relative to the largest torque.
    rounds : int
        Fits of the state: a law that saturates is not linear in it.
    differs : float
        Relative distance from the logged torque from which on variants of the law are tried.
    nearer : float
        Share of this distance that a variant may leave, to be named.
    other : float
        Relative distance from the logged torque of a law that did not make the log; that of a gain
        which is wrong by 10 % is 10 % (``silent_mistakes.py``).
    """

    ratio: float = 1.1
    equal: float = 1e-3
    rounds: int = 2
    differs: float = 5e-4
    nearer: float = 0.25
    other: float = 0.05


SETTINGS = StatedLawSettings()


def torque_apart(record: Record) -> Floats | None:
    """Relative RMS distance (n,) of the logged torque from that of the stated law, less noise.

    None where nothing can be compared: nothing logged, counts that were moved, no law or one that
    repeats the log, one with a memory that is faster than its log, or a reference whose rounding
    hides the torque.
    """
    compared = _compared(record)
    if compared is None:
        return None
    logged, torque = compared
    difference = torque - logged
    squares = np.mean(difference**2, axis=0)
    # The noise of a current sensor is no other law. What a white difference has beyond the estimate
    # of its noise is an error of that estimate.
    noise = independent_noise(logged, torque, held=_is_held(record))
    excess = np.where(is_white(difference) & (noise > 0), 0.0, squares - noise**2)
    distance = np.sqrt(np.maximum(excess, 0))
    size = np.sqrt(np.mean(logged**2, axis=0))
    # A joint without torque has no share of it.
    return distance / np.maximum(size, 1e-9 * max(size.max(), 1e-300))


def law_differs(apart: Floats | None) -> bool:
    """Whether a law is `torque_apart` so far from the logged torque that another made the log."""
    return apart is not None and bool(apart.max() > SETTINGS.other)


def noise_of_torque(record: Record) -> Floats:
    """Noise (n,) of the logged torque or current [N m]; beside a stated law, without its chatter.

    Where no torque of a law can be compared, chatter counts as noise.
    """
    compared = _compared(record)
    if compared is None:
        return white_noise(measured_torque(record)[record.valid > 0])
    held = _is_held(record)
    # A mean of two samples has half of their variance.
    return independent_noise(*compared, held=held) * (np.sqrt(2) if held else 1.0)


def _is_held(record):
    """Whether the stated law holds its torque for a sample."""
    return record.law is not None and not is_faster(record)


def _compared(record):
    """Logged torque and that of the stated law (M, n), where both are known; None where neither is.

    The law begins in the best state.
    """
    law = record.law
    if law is None or not _comparable(record):
        return None
    logged = logged_torque(record)
    if not law.has_memory(record.n) or (isinstance(law, Resumed) and not is_faster(record)):
        torque = torque_of(record)
    else:
        # A faster law reads counts between the rows, where the log has nothing.
        nearest = None if is_faster(record) else _nearest(record, logged)
        if nearest is None:
            return None
        torque = law_torque(nearest[0])
    rows = _settled(record)
    return (logged[rows], torque[rows]) if rows.size else None


def _settled(record):
    """Rows before which the filters of the law have read no bridged count for a while."""
    # A filter of a law has forgotten a bridged count after so many samples.
    lost = np.cumsum(record.valid == 0)
    return FADED + np.flatnonzero(lost[FADED:] == lost[:-FADED])


def told_by_torque(record: Record) -> tuple[Record, Memory] | None:
    """The record with its law in the state that a noisy torque tells, and what it leaves open.

    The law gives its torque as exactly as the counts are known; the column has the noise of its
    sensor beside it, which no arm felt. None where the difference is none, or is more than noise.
    """
    law = record.law
    if law is None or isinstance(law, Resumed) or not _comparable(record):
        return None
    # Only what a law remembers is open; without a memory the counts give its torque.
    if is_faster(record) or not law.has_memory(record.n):
        return None
    logged = logged_torque(record)
    nearest = _nearest(record, logged)
    rows = _settled(record)
    # From fewer rows the size of the noise would be a guess.
    if nearest is None or len(rows) < len(record) / 2:
        return None
    followed, usual = nearest
    run = run_law(followed)
    torque = law_torque(followed, run)
    difference = (logged - torque)[rows]
    size = np.sqrt(np.mean(difference**2, axis=0))
    differs = (size > SETTINGS.differs * np.sqrt(np.mean(logged[rows] ** 2, axis=0))).any()
    # A smaller difference is rounding of the column, and one that lasts is another law.
    if not differs or not is_white(difference).all():
        return None
    unit = np.where(size > 0, size, size.max())
    # Gains that are nearly those of the log leave a difference that noise hides at first sight.
    by_gains = _by_gains(followed, torque)[:, rows] / unit
    if any(_evidence(column[None], difference / unit) > 0 for column in by_gains):
        return None
    noise = np.sqrt(2) * white_noise(difference, held=True)
    memory, columns = state_directions(followed, run, usual)
    # A law that began with the log keeps that state, unless the torque refutes it.
    beginning = _beginning(record)
    fresh = (logged - law_torque(beginning))[rows]
    if _evidence(columns[:, rows] / unit, fresh / unit) < 0:
        return beginning, replace(Memory.known(beginning.law.state), noise=noise)
    # The state by least squares of the noise, in its own standard deviations.
    weighted = columns[:, rows] / unit
    squares, axes = np.linalg.eigh(np.einsum("amn,bmn->ab", weighted, weighted))
    directions = memory.directions @ (axes * np.sqrt(2 / squares))
    return followed, replace(
        memory, directions=directions, usual=np.ones(len(squares)), noise=noise
    )


def _by_gains(record, torque):
    """Change (k, N, n) of a law's torque (N, n) along a log by its numbers, kind by kind."""
    law = record.law.law
    numbers = dict(zip(law.number_names(), law.number_values(), strict=True))
    # Kinds, not joints: a wrong unit or a misread data sheet concerns all joints alike.
    columns = []
    for kind in dict.fromkeys(name.partition("[")[0] for name in numbers):
        # All joints at once: the gain of a joint acts on its own torque.
        changed = {
            name: (1 + SETTINGS.equal) * value
            for name, value in numbers.items()
            if name.partition("[")[0] == kind
        }
        other = replace(record.law, law=law.filled(changed))
        columns.append(law_torque(replace(record, law=other)) - torque)
    return np.array(columns)


def _evidence(columns, difference):
    """Evidence of columns (k, M, n) in a difference (M, n), beside white noise of size 1.

    Positive if they are in it. The difference and its noise are means of two samples each, so that
    neighbours share half of the noise.

    Source: G. Schwarz, Estimating the dimension of a model, Annals of Statistics 6, 1978.
    """
    # Joints are independent readings of one hypothesis.
    explained = 0.0
    for i in range(difference.shape[1]):
        of_joint = columns[:, :, i]
        # Columns of one length, so that dependent ones are told by their angle.
        of_joint = of_joint / np.maximum(np.linalg.norm(of_joint, axis=1), 1e-300)[:, None]
        left = difference[:, i] - of_joint.T @ least(of_joint.T, difference[:, i])
        explained += dot(difference[:, i], difference[:, i]) - dot(left, left)
    return explained / 2 - columns.shape[0] * difference.shape[1] * np.log(difference.size)


def likelier_variant(record: Record, apart: Floats) -> tuple[str, Floats] | None:
    """The variant of the stated law that gives the logged torque, and how far apart (n,) that is.

    `apart` (n,): the same of the stated law. None where no variant is clearly nearer.
    """
    law = record.law
    if law is None or not apart.max() > SETTINGS.differs:
        return None
    nearest = None
    for text, variant in variants_of(law, record.n).items():
        distance = torque_apart(replace(record, law=variant))
        limit = SETTINGS.nearer * apart.max() if nearest is None else nearest[1].max()
        if distance is not None and distance.max() < limit:
            nearest = text, distance
    return nearest


def variants_of(law: Any, n: int) -> dict[str, Any]:
    """Variants of the controller of a log of n joints, by their texts; in a state that is known."""
    if not isinstance(law, Resumed):
        return dict(law.variants())
    return {text: law.around(variant, n) for text, variant in law.law.variants().items()}


def begun(record: Record) -> Record:
    """The record with its law and arm in the state of the first sample, by its logged torque.

    It stays as it is where that cannot be found: nothing logged, no memory, or a law that began
    with the log.
    """
    law = record.law
    if law is None or isinstance(law, Resumed) or not _comparable(record):
        return record
    if not law.has_memory(record.n):
        return record
    logged = logged_torque(record)
    nearest = _nearest(record, logged)
    if nearest is None:
        return record

    nearest, _ = nearest
    # A law that begins with the log explains the torque about as well: then nothing came before.
    distances = [_distance(candidate, logged) for candidate in (_beginning(record), nearest)]
    negligible = SETTINGS.equal * np.abs(logged).max()
    # The best state is fitted, and so is always a little nearer: only a clear advantage counts.
    if distances[0] <= SETTINGS.ratio * distances[1] + negligible:
        return record
    state = nearest.law.state
    start = np.array(start_of(record, path_of(record)))
    return replace(record, law=Resumed(law=law, state=state), initial=start)


def _comparable(record):
    """Whether a torque was logged that a law may have given from the counts of the record.

    Counts that were moved (`without_delay`) are not those that the law read.
    """
    if record.law is None or record.law.replays:
        return False
    if record.torque is None and record.current is None:
        return False
    # Moved counts are no whole numbers, except where the encoder does not round at all.
    # Beside a reference with fractions the error has them, too, and the sum has its last digit.
    counts = record.counts
    return record.rig.encoder.smooth or bool(np.allclose(counts, np.rint(counts), rtol=0))


def _nearest(record, logged):
    """The record with its law reading the log, from the state nearest to the logged torque (N, n).

    And usual magnitudes (s,) of that state. None where its reference does not determine its
    torque, and of fast hardware.
    """
    # Fast hardware reads the arm between samples, where the log has nothing.
    if record.law.period is None:
        return None
    beginning = _beginning(record)
    try:
        followed, usual = at_work(record, beginning.law)
    except ValueError:
        # The rounding of its reference hides the torque.
        return None
    # A law that began with its log, and is not linear in its state, is found from no other state.
    candidates = [beginning, followed]
    # The state by linear least squares, again from the new state where the law is not linear in it.
    for _ in range(SETTINGS.rounds):
        run = run_law(followed)
        # Along its log a law does not depend on the start of the arm: the first samples count, and
        # show what its filters remember.
        memory, columns = state_directions(followed, run, usual, faded=0)
        if not len(columns):
            break
        missing = (logged - law_torque(followed, run)).ravel()
        rows = columns.reshape(len(columns), -1).T
        state = memory.at(least(rows, missing))
        reader = followed.law
        followed = replace(followed, law=replace(reader, state=state))
        candidates.append(followed)
    return min(candidates, key=lambda candidate: _distance(candidate, logged)), usual


def _beginning(record):
    """The record with its law reading the log, from the state in which the law begins."""
    law = record.law
    return reading(record, Resumed(law=law, state=law.initial_state(record.n)))


def _distance(record, logged):
    """RMS distance [N m] of the logged torque (N, n) from that of a law that reads the log."""
    valid = np.flatnonzero(record.valid > 0)
    rows = valid[valid >= FADED]
    return np.sqrt(np.mean((law_torque(record) - logged)[rows] ** 2))

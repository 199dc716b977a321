"""`learn`: the torque that was missing along a path, from repetitions of it under any law."""

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np

from ctc.learning.learning import _SETTLED, Learning, mended, share
from ctc.learning.learnt_torque import LearntTorque
from ctc.learning.path_plant import PathPlant, missing_torque, path_plant
from identification import Identification
from plant import Arm, Law, Record, Reference, Rig
from plant.parts.arguments import instance, known_options
from plant.parts.fields import Floats
from plant.simulation.executors import mapped

# Share of the missing torque that is added; to which share of the last it must fall; and by which
# share of the samples more may be beyond ±1 pulse than before.
_GAIN = 0.7
_FALLS = 0.8
_WORSE = 0.005

_ORDER = "The order is law, rig, reference, records."

_SURPRISES = 1.25
_MORE = 1.3
# highest frequency of the learnt torque [Hz], and its terms per joint at most
_FINEST = 40.0
_MOST = 400

_MOVES = 3.0  # speed of the reference [pulses/s] from which on a joint moves

# Of a joint that stands and should move: bandwidth [rad/s], lead [s] and smoothing [s] of the
# torque that it gets.
_STIFF = 14.0
_AHEAD = 0.015
_BLURRED = 0.008


@known_options
def learn(
    law: Law | Learning,
    rig: Rig,
    reference: Reference,
    records: Record | Sequence[Record],
    *,
    found: Identification | Arm | None = None,
    executor: Any = None,
) -> Learning:
    """Learn the torque that was missing along a path from logs of it, of any law.

    A fixed-interval smoother over each log finds the torque that the model lacks; the law for the
    next repetition adds 0.7 of it. A regression says what of it is f and friction.

    Parameters
    ----------
    law : Law or Learning
        The law that made the logs; or what was learnt before, whose `law` made them.
    rig : Rig
        With the friction, and the gears, that the model has.
    reference : Reference
        The path, from t = 0.
    records : Record or sequence of Record
        Repetitions under that law, at the rig's period, with their torque or current: each the
        whole path.
    found : Identification or Arm, optional
        The model; by default the arm that the law holds. An identification gives its covariance to
        the regression, in place of 5 % of f and 20 % of friction.
    executor : optional
        Where the smoothers run, one call per log, as of `certify`: the same bits.

    Returns
    -------
    Learning
        ``.law`` for the next repetition; ``.arm``, ``.rig``, ``.uncertainty`` for other paths.

    Raises
    ------
    ValueError
        No arm; logs of another path, rig or law, without torque, too short, or beyond the
        amplifiers' limit.

    Notes
    -----
    A repetition is left out if its mean normalised innovation exceeds 1.25, or 1.3 times the least
    so far and 1. A correction after which not less than 0.8 of the torque is missing, and more than
    a thousandth of the amplifiers' limit, or more samples are beyond ±1 pulse, is taken back, and
    half of it made.

    See Also
    --------
    ctc.LearntTorque, ctc.certify

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from ctc import ComputedTorque, learn
    >>> arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    >>> law = ComputedTorque(arm.dynamics.arm(1.03 * arm.f), rig)
    >>> learnt = learn(law, rig, path, simulate(arm, rig, law, path))
    >>> print(len(learnt.missing), learnt.left_out)
    1 ()
    """
    before = law if isinstance(law, Learning) else None
    ran: Any = (
        before.law
        if before is not None
        else instance("law", law, Law, "Give the law that made the logs.")
    )
    instance("rig", rig, Rig, _ORDER)
    instance("reference", reference, Reference, _ORDER)
    arm = _model(ran, found)
    base = ran.law if isinstance(ran, LearntTorque) else ran
    logs, count = _logs(records, ran, rig, reference)
    plant = path_plant(arm, rig, reference, count)
    t = rig.period * np.arange(count)
    motion = reference(t)
    speed = rig.drive.coupling.shaft(motion.qd)
    moves = np.abs(rig.encoder.position_in_pulses(np.abs(rig.drive.gear) * speed)) > _MOVES
    terms = min(int(2 * _FINEST * reference.duration), _MOST, count - 1) + 1
    old = (
        np.resize(ran.terms, (terms, rig.n))
        if isinstance(ran, LearntTorque)
        else np.zeros((terms, rig.n))
    )
    known = _torque(old, count)

    innovations = list(before.innovations) if before else []
    left_out = list(before.left_out) if before else []
    corrections = []
    errors = []
    smoothed = functools.partial(_correction, arm, rig, plant, motion, moves, known)
    found_in = (
        [smoothed(each) for each in logs] if executor is None else mapped(smoothed, logs, executor)
    )
    for record, (correction, innovation) in zip(logs, found_in, strict=True):
        innovations.append(innovation)
        if innovation > _SURPRISES or innovation > max(_MORE * min(innovations), 1.0):
            name = record.name or f"repetition {len(innovations)}"
            fast = ", or torque that fast hardware changed between samples" * (ran.period is None)
            why = f"disturbed, or gears unlike the model's{fast}"
            left_out.append(f"{name}: its innovation is {innovation:.3g}; {why}")
        else:
            corrections.append(correction)
            errors.append(np.abs(record.error_pulses[:count]).max(axis=1))
    mean = np.mean(corrections, axis=0) if corrections else np.zeros((count, rig.n))
    rms = np.sqrt((mean**2 * moves).sum(axis=0) / np.maximum(moves.sum(axis=0), 1))
    missing, beyond, peak = (before.missing, before.beyond, before.peak) if before else ((), (), ())
    gain = before.gain if before else _GAIN
    diverged = False
    start = old.ravel()
    wanted = _terms(mean, terms).ravel()
    if corrections:
        outside = float((np.array(errors) > 1).mean())
        largest = float(np.max(errors))
        diverged = bool(missing) and (
            share(rms, rig) > max(_FALLS * share(missing[-1], rig), _SETTLED)
            or outside > beyond[-1] + _WORSE
        )
        if diverged and before is not None:
            start = before.before
            wanted = before.wanted
            gain = gain / 2
        else:
            missing = (*missing, rms)
            beyond = (*beyond, outside)
            peak = (*peak, largest)
    new = start + gain * wanted
    learnt = _torque(
        start.reshape(terms, -1) + (0 if diverged else 1) * wanted.reshape(terms, -1), count
    )
    after, new_rig, covariance, rest = mended(
        arm, rig, plant, learnt, moves, speed, _prior(found, arm, rig)
    )
    p = len(arm.f)
    std = np.sqrt(np.diag(covariance))
    return Learning(
        law=LearntTorque(law=base, rig=rig, reference=reference, terms=new),
        arm=after,
        rig=new_rig,
        covariance=covariance[:p, :p],
        friction_std=std[p:].reshape(2, -1),
        missing=missing,
        beyond=beyond,
        peak=peak,
        innovations=tuple(innovations),
        left_out=tuple(left_out),
        rest=rest,
        gain=gain,
        diverged=diverged,
        before=start,
        wanted=wanted,
    )


def _logs(records: Any, ran: Any, rig: Rig, reference: Reference) -> tuple[list[Record], int]:
    """The repetitions, and the samples of the path; anything else is refused."""
    logs = [records] if isinstance(records, Record) else list(records)
    if isinstance(ran, LearntTorque):
        ran.require_reference(reference)
        ran.block(rig)
    count = int(np.ceil(round(reference.duration / rig.period, 6)))
    for i, record in enumerate(logs):
        _require(record, i, ran, rig, reference, count)
    if not logs:
        raise ValueError("records must hold a repetition; got none. Give the log of one.")
    return logs, count


def _model(law: Any, found: Any) -> Arm:
    """The arm of an identification, or the given one, or that of the law."""
    arm: Any = getattr(found, "arm", found) if found is not None else getattr(law, "arm", None)
    given: Arm = instance("found", arm, Arm, f"{type(law).__name__} holds no arm; give found=.")
    return given


def _require(record: Any, i: int, law: Law, rig: Rig, reference: Reference, count: int) -> None:
    """Refuse a log that is none of this path, rig or law."""
    name = (
        instance(f"records[{i}]", record, Record, "Give logs of the repetitions.").name
        or f"records[{i}]"
    )
    if record.reference is not None and record.reference != reference:
        raise ValueError(
            f"reference of {name} must be the path; got another. Give repetitions of one path."
        )
    if record.law is not None and record.law != law:
        raise ValueError(
            f"{name} must be made by {type(law).__name__} as given; got another. Learn in order."
        )
    if len(record) < count:
        raise ValueError(
            f"{name} must have the {count} samples of the reference; got {len(record)}. Log all"
            " of it."
        )
    if np.abs(np.diff(record.t[:count]) - rig.period).max() > 0.5 * rig.period:
        raise ValueError(
            f"{name} must be sampled every {rig.period:g} s; got other steps. Use record.resampled."
        )
    if record.torque is None and record.current is None:
        raise ValueError(
            f"{name} must have torque or current; got neither. Log the torque that was applied."
        )
    off = np.abs(rig.counts(reference(record.t[:count]).q) - record.reference_pulses[:count]).max()
    if off > 1:
        raise ValueError(
            f"reference_pulses of {name} must be the path's; got {off:.0f} off. Give its own log."
        )
    limit = np.abs(rig.drive.torque_limit())
    given = np.abs(rig.drive.coupling.shaft_torque(_applied(record, count)))
    if (given > 1.001 * limit).any():
        most = given.max(axis=0)
        raise ValueError(
            f"torque of {name} must be within the amplifier's {limit} N m; got {most}. Check units."
        )


def _applied(record: Record, count: int) -> Floats:
    """Torque (count, n) that the motors gave."""
    if record.torque is not None:
        return record.torque[:count]
    drive = record.rig.drive
    return np.asarray(drive.joint_torque(drive.motor_gain, record.current[:count]))  # type: ignore[index]  # checked


def _correction(
    arm: Arm, rig: Rig, plant: PathPlant, motion: Any, moves: Any, known: Floats, record: Record
) -> tuple[Floats, float]:
    """Torque (N, n) that is missing beside the known one, and the mean normalised innovation."""
    count = len(known)
    dt = rig.period
    counts = record.counts[: len(known)]
    centre = np.asarray(rig.cell_centre(counts))
    D = np.array([np.diag(np.asarray(arm.D(q))) for q in motion.q[:: max(count // 20, 1)]]).mean(
        axis=0
    )
    beyond = _applied(record, count) - plant.torque - known
    found = missing_torque(plant, rig, D, beyond, centre - motion.q, counts, moves)
    width = int(np.ceil(3 * _BLURRED / dt))
    kernel = np.exp(-((dt * np.arange(-width, width + 1) / _BLURRED) ** 2) / 2)
    stuck = found.stands * moves * D * _STIFF**2 * (motion.q - centre)
    ahead = np.vstack([stuck[round(_AHEAD / dt) :], np.zeros((round(_AHEAD / dt), rig.n))])[:count]
    blurred = np.column_stack(
        [np.convolve(column, kernel / kernel.sum(), "same")[:count] for column in ahead.T]
    )
    return (found.torque + blurred) * moves, found.innovation


def _terms(values: Floats, terms: int) -> Floats:
    """Cosine terms (terms, n) of values (N, n) at equal times, of both ends too."""
    N = len(values) - 1
    found = np.fft.rfft(np.vstack([values, values[-2:0:-1]]), axis=0).real / N
    found[[0, N]] /= 2
    return found[:terms]


def _torque(terms: Floats, count: int) -> Floats:
    """Torque (count, n) of cosine terms (K, n)."""
    return np.cos(np.pi / (count - 1) * np.outer(np.arange(count), np.arange(len(terms)))) @ terms


def _prior(found: Any, arm: Arm, rig: Rig) -> Floats | None:
    """Covariance of f, viscous and Coulomb friction, joint side, where an identification has
    one.
    """
    if getattr(found, "covariance", None) is None:
        return None
    n = rig.n
    gear = np.abs(rig.drive.gear)
    names = [
        *arm.dynamics.names,
        *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(n)),
    ]
    scale = np.concatenate([np.ones(len(arm.f)), gear**2, gear])
    levels = np.concatenate([np.zeros(len(arm.f)), rig.drive.viscous, rig.drive.coulomb])
    P = np.diag((0.2 * levels) ** 2)
    seen = [i for i, name in enumerate(names) if name in found.fit.unknown]
    P[np.ix_(seen, seen)] = found.fit.covariance_of([names[i] for i in seen])
    return np.asarray(P * np.outer(scale, scale))

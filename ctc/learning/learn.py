"""`learn`: the torque that was missing along a path, from repetitions of it under any law."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ctc.learning.learning import Learning, mended, share
from ctc.learning.learnt_torque import LearntTorque
from ctc.learning.path_plant import PathPlant, missing_torque, path_plant
from ctc.learning.settings import SETTINGS, LearnSettings
from identification import Identification
from plant import Arm, Law, Record, Reference, Rig
from plant.parts import Floats, instance, known_options
from plant.simulation import mapped

_ORDER = "The order is law, rig, reference, records."


@known_options
def learn(
    law: Law | Learning,
    rig: Rig,
    reference: Reference,
    records: Record | Sequence[Record],
    *,
    found: Identification | Arm | None = None,
    settings: LearnSettings | None = None,
    executor: Any = None,
) -> Learning:
    """Learn the torque that was missing along a path, from logs of the path under any law.

    A fixed-interval smoother estimates from each log the torque that the model lacks, and the law
    for the next repetition adds 0.7 of this torque. A regression finds the part that the arm's
    parameters f and the friction explain.

    Parameters
    ----------
    law : Law or Learning
        The law that made the logs; or the previous result, whose `law` made them.
    rig : Rig
        The rig of the model, with its friction and gears.
    reference : Reference
        The path, from t = 0.
    records : Record or sequence of Record
        Repetitions of the whole path under that law, at the rig's period, with torque or current.
    found : Identification or Arm, optional
        The model; by default the arm that the law holds. The covariance of an identification is the
        prior of the regression, in place of 5 % of f and 20 % of friction.
    settings : LearnSettings, optional
        Gain, thresholds and bandwidths; by default those of the previous result, and for a law the
        numbers of the notes. `gain` counts for a law only: a result has its own.
    executor : optional
        Runs the smoothers, one call per log, as in `certify`; the result has the same bits.

    Returns
    -------
    Learning
        ``.law`` for the next repetition; ``.arm``, ``.rig``, ``.uncertainty`` for other paths.

    Raises
    ------
    ValueError
        No arm; a path on which no joint moves; logs of another path, rig or law, without torque,
        too short, or beyond the amplifiers' limit.

    Notes
    -----
    A repetition is left out if its mean normalised innovation exceeds 1.25, or exceeds both 1 and
    1.3 times the smallest so far. A correction is taken back, and half of it is made, if afterwards
    more than 0.8 of the torque is still missing (and more than a thousandth of the amplifiers'
    limit), or if the share of samples beyond ±1 pulse grows by more than `may_worsen`.

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
    previous = law if isinstance(law, Learning) else None
    run_law: Any = getattr(previous, "law", law)
    instance("law", run_law, Law, "Give the law that made the logs.")
    instance("rig", rig, Rig, _ORDER)
    instance("reference", reference, Reference, _ORDER)
    if settings is None:
        settings = SETTINGS if previous is None else previous.settings
    instance("settings", settings, LearnSettings, "Give LearnSettings.")
    arm = _model(run_law, found)
    logs, count = _logs(records, run_law, rig, reference)

    # The motion and the speeds are needed at the start of each period only; the friction of a rig
    # acts at its shafts, so speeds are those of the shafts.
    # 1. The model along the path, and the torque that the logs were made with.
    motion = reference(rig.period * np.arange(count))
    speed = rig.drive.coupling.shaft(motion.qd)
    moves = _moving(rig, speed, settings.moving_speed)
    plant = path_plant(arm, rig, reference, count, settings)
    # Up to `highest_frequency` there are two cosines per hertz and second of the path. More terms
    # than samples would not be determined.
    needed = int(2 * settings.highest_frequency * reference.duration)
    terms = min(needed, settings.largest_terms, count - 1) + 1
    inner_law = run_law
    applied_terms = np.zeros(rig.n)
    # A law with a learnt torque goes on from its terms; any other law starts from zero.
    if isinstance(run_law, LearntTorque):
        inner_law = run_law.law
        applied_terms = run_law.terms

    # 2. The torque that model and learnt torque lack in each log; logs that disagree with the model
    # are left out. The logs hold all terms that were applied, also those above the present limits.
    learnt = _torque(applied_terms.reshape(-1, rig.n), count)
    smoothed = functools.partial(_correction, arm, rig, plant, motion, moves, learnt, settings)
    results = mapped(smoothed, logs, executor) if executor is not None else map(smoothed, logs)
    innovations = list(previous.innovations) if previous else []
    left_out = list(previous.left_out) if previous else []
    corrections = []
    errors = []
    for record, (correction, innovation) in zip(logs, results, strict=True):
        innovations.append(innovation)
        if _is_disturbed(innovations, settings):
            left_out.append(_left_out(record, innovations, run_law))
        else:
            corrections.append(correction)
            errors.append(np.abs(record.error_pulses[:count]).max(axis=1))
    # The mean over the repetitions reduces noise and disturbances that do not repeat.
    mean = np.mean(corrections, axis=0) if corrections else np.zeros((count, rig.n))
    rms = np.sqrt((mean**2 * moves).sum(axis=0) / np.maximum(moves.sum(axis=0), 1))

    # 3. The next torque: corrected, or with half of the last correction, if that did not help.
    wanted = _terms(mean, terms).ravel()
    following = _next(previous, applied_terms, wanted, rms, errors, rig, settings)
    start, wanted = (_sized(flat, terms * rig.n) for flat in (following.start, following.wanted))

    # 4. The part of the missing torque that f and friction explain, for other paths. All of a
    # correction counts, not only the part `gain` that is added; a correction taken back does not.
    whole_torque = start if following.diverged else start + wanted
    explained = _torque(whole_torque.reshape(terms, -1), count)
    prior = _prior(found, arm, rig, settings.friction_deviation)
    mending = mended(arm, rig, plant, explained, moves, speed, prior, settings)
    added = start + following.gain * wanted
    return Learning(
        law=LearntTorque(
            law=inner_law,
            rig=rig,
            reference=reference,
            terms=added,
            start_distance=settings.start_distance,
        ),
        arm=mending.arm,
        rig=mending.rig,
        covariance=mending.covariance,
        friction_std=mending.friction_std,
        missing=following.missing,
        beyond=following.beyond,
        peak=following.peak,
        innovations=tuple(innovations),
        left_out=tuple(left_out),
        rest=mending.rest,
        gain=following.gain,
        diverged=following.diverged,
        before=start,
        wanted=wanted,
        settings=settings,
    )


class _Next(NamedTuple):
    """Terms that the next repetition starts from and adds, and the history of the repetitions."""

    start: Floats
    wanted: Floats
    gain: float
    missing: tuple[Floats, ...]
    beyond: tuple[float, ...]
    peak: tuple[float, ...]
    diverged: bool


def _next(
    previous: Learning | None,
    start: Floats,
    wanted: Floats,
    rms: Floats,
    errors: Sequence[Floats],
    rig: Rig,
    settings: LearnSettings,
) -> _Next:
    """The next torque of a path, from the terms so far (`start`) and their correction (`wanted`).

    `rms` (n,) is the missing torque of the repetitions, `errors` holds the largest error of the
    joints at each sample [pulses], one array for each repetition that was learnt from.
    """
    if previous is None:
        history = _Next(start, wanted, settings.gain, (), (), (), False)
    else:
        history = _Next(
            start, wanted, previous.gain, previous.missing, previous.beyond, previous.peak, False
        )
    if not errors and previous is not None:
        # The last correction is not judged yet: the next repetition may still take it back.
        return history._replace(
            start=previous.before, wanted=previous.wanted, diverged=previous.diverged
        )
    if not errors:
        return history
    # A correction without benefit shows in the missing torque, or in samples beyond one pulse when
    # a fast error grows while the rms falls. Below `settled` the missing torque is noise, and its
    # growth proves nothing.
    outside = float((np.array(errors) > 1).mean())
    if previous is not None and history.missing:
        limit = settings.must_fall * share(history.missing[-1], rig)
        grew = share(rms, rig) > max(limit, settings.settled)
        if grew or outside > history.beyond[-1] + settings.may_worsen:
            # The learning gain was too large for this path: the next repetition starts again from
            # the torque before the last correction, and adds half of that correction. The history
            # omits these logs, since they belong to a torque that is taken back.
            return history._replace(
                start=previous.before,
                wanted=previous.wanted,
                gain=history.gain / 2,
                diverged=True,
            )
    return history._replace(
        missing=(*history.missing, rms),
        beyond=(*history.beyond, outside),
        peak=(*history.peak, float(np.max(errors))),
    )


def _is_disturbed(innovations: Sequence[float], settings: LearnSettings) -> bool:
    """Whether the last of these innovations is so large that its log is left out."""
    # The smallest innovation so far belongs to an undisturbed repetition of this arm: a model with
    # wrong gears raises all innovations, a disturbance raises one.
    usual = max(settings.innovation_ratio * min(innovations), 1.0)
    return innovations[-1] > min(settings.largest_innovation, usual)


def _left_out(record: Record, innovations: list[float], law: Law) -> str:
    """Say which repetition is left out, and for which reason."""
    name = record.name or f"repetition {len(innovations)}"
    reason = "disturbed, or gears unlike the model's"
    # A law without a period runs in hardware that is faster than the log, so that the logged torque
    # is only a sample of the applied one.
    if law.period is None:
        reason += ", or torque that fast hardware changed between samples"
    return f"{name}: its innovation is {innovations[-1]:.3g}; {reason}"


def _logs(records: Any, law: Any, rig: Rig, reference: Reference) -> tuple[list[Record], int]:
    """Check the repetitions; return them and the number of samples of the path."""
    logs = [records] if isinstance(records, Record) else list(records)
    if isinstance(law, LearntTorque):
        law.require_reference(reference)
        law.block(rig)  # refuses another rig
    # Rounding keeps a duration of a whole number of periods from gaining a sample by rounding
    # error.
    count = int(np.ceil(round(reference.duration / rig.period, 6)))
    if count < 2:
        raise ValueError(
            f"reference must last longer than the period {rig.period:g} s; got"
            f" {reference.duration:g} s. Give the whole path."
        )
    for i, record in enumerate(logs):
        _require(record, i, law, rig, reference, count)
    if not logs:
        raise ValueError("records must hold a repetition; got none. Give the log of one.")
    return logs, count


def _moving(rig: Rig, speed: Floats, least: float) -> Any:
    """Where (N, n) the shafts move at these speeds [rad/s]; a path without motion is refused."""
    pulses = np.abs(rig.encoder.position_in_pulses(np.abs(rig.drive.gear) * speed))
    moves = pulses > least
    if not moves.any():
        raise ValueError(
            f"reference must move a joint faster than moving_speed {least:g} pulses/s; got at most"
            f" {pulses.max():.2g}. Give a path that moves."
        )
    return moves


def _model(law: Any, model: Any) -> Arm:
    """Return the arm of an identification, or the given arm, or by default that of the law."""
    arm: Any = getattr(law, "arm", None) if model is None else getattr(model, "arm", model)
    advice = "Give an Identification or its arm."
    if model is None:
        advice = f"{type(law).__name__} holds no arm; give found=."
    checked: Arm = instance("found", arm, Arm, advice)
    return checked


def _require(record: Any, i: int, law: Law, rig: Rig, reference: Reference, count: int) -> None:
    """Refuse a log of another path or law, one that contradicts the rig, or an incomplete one."""
    place = f"records[{i}]"
    name = instance(place, record, Record, "Give logs of the repetitions.").name or place
    # A record without reference or law, such as one of a foreign log, is taken as it is.
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
    # Half a period allows for jitter of time stamps, and detects a lost or doubled sample. Over the
    # whole path it also detects another period.
    steps = np.diff(record.t[:count]) - rig.period
    if max(np.abs(steps).max(), np.abs(steps.cumsum()).max()) > 0.5 * rig.period:
        raise ValueError(
            f"{name} must be sampled every {rig.period:g} s; got other steps. Use record.resampled."
        )
    if record.torque is None and record.current is None:
        raise ValueError(
            f"{name} must have torque or current; got neither. Log the torque that was applied."
        )
    # One pulse allows for a logger that rounds the reference differently.
    off = np.abs(rig.counts(reference(record.t[:count]).q) - record.reference_pulses[:count]).max()
    if off > 1:
        raise ValueError(
            f"reference_pulses of {name} must be the path's; got {off:.0f} off. Give its own log."
        )
    limit = np.abs(rig.drive.torque_limit())
    torque = np.abs(rig.drive.coupling.shaft_torque(_applied(record, count)))
    # A logged torque is rounded, so that one at the limit may be a little above it.
    if (torque > 1.001 * limit).any():
        largest = torque.max(axis=0)
        raise ValueError(
            f"torque of {name} must be within the amplifier's {limit} N m; got {largest}. Check"
            " units."
        )


def _applied(record: Record, count: int) -> Floats:
    """Joint torque (count, n) that the motors applied [N m], from torque or current."""
    if record.torque is not None:
        return record.torque[:count]
    drive = record.rig.drive
    return np.asarray(drive.joint_torque(drive.motor_gain, record.current[:count]))  # type: ignore[index]  # checked


def _correction(
    arm: Arm,
    rig: Rig,
    plant: PathPlant,
    motion: Any,
    moves: Any,
    learnt: Floats,
    settings: LearnSettings,
    record: Record,
) -> tuple[Floats, float]:
    """Torque (N, n) that model and learnt torque lack, and the mean normalised innovation."""
    count = len(learnt)
    dt = rig.period
    counts = record.counts[:count]
    centre = np.asarray(rig.cell_centre(counts))
    # The inertia that a joint feels sets the smoother's noise: its mean along the path is enough.
    poses = motion.q[:: max(count // 20, 1)]
    inertia = np.mean([np.diag(arm.D(q)) for q in poses], axis=0)
    # The plant is linear in deviations, so that the smoother needs only the torque beyond the
    # model.
    beyond = _applied(record, count) - plant.torque - learnt
    estimate = missing_torque(
        plant, rig, inertia, beyond, centre - motion.q, counts, moves, settings
    )

    # While a joint sticks, its count shows no torque that would move it. A stiffness on its
    # tracking error gives that torque, advanced by a lead since the joint should already have
    # moved, and smoothed since steps of counts would excite the gears.
    stuck = estimate.stands * moves * inertia * settings.stuck_bandwidth**2 * (motion.q - centre)
    lead = round(settings.stuck_lead / dt)
    ahead = np.vstack([stuck[lead:], np.zeros((lead, rig.n))])[:count]
    # Three standard deviations on each side hold all but 0.3 % of the Gaussian.
    width = int(np.ceil(3 * settings.stuck_smoothing / dt))
    kernel = np.exp(-((dt * np.arange(-width, width + 1) / settings.stuck_smoothing) ** 2) / 2)
    kernel /= kernel.sum()
    # "same" would cut the middle of the longer one, which may be the kernel.
    middle = slice(width, width + count)
    smooth = np.column_stack([np.convolve(column, kernel)[middle] for column in ahead.T])
    return (estimate.torque + smooth) * moves, estimate.innovation


def _terms(values: Floats, terms: int) -> Floats:
    """Cosine terms (terms, n) of values (N, n) at equally spaced times, both ends included."""
    N = len(values) - 1
    # The values and their mirror image are even, so that their Fourier series has cosines alone.
    even = np.vstack([values, values[-2:0:-1]])
    # A cosine series at N + 1 samples takes its first and its last amplitude half.
    amplitudes = np.fft.rfft(even, axis=0).real / N
    amplitudes[[0, N]] /= 2
    return amplitudes[:terms]


def _sized(terms: Floats, size: int) -> Floats:
    """So many of the flat terms, which begin with the lowest frequency; zeros follow the last."""
    return np.pad(terms[:size], (0, max(size - len(terms), 0)))


def _torque(terms: Floats, count: int) -> Floats:
    """Torque (count, n) of cosine terms (K, n)."""
    return np.cos(np.pi / (count - 1) * np.outer(np.arange(count), np.arange(len(terms)))) @ terms


def _prior(model: Any, arm: Arm, rig: Rig, friction_deviation: float) -> Floats | None:
    """Joint-side covariance of f, viscous and Coulomb friction, if an identification has one."""
    if getattr(model, "covariance", None) is None:
        return None
    n = rig.n
    p = len(arm.f)
    gear = np.abs(rig.drive.gear)
    names = [*arm.dynamics.names]
    for kind in ("viscous", "coulomb"):
        names += [f"drive.{kind}[{i}]" for i in range(n)]
    # The named parameters are of the motor side. The torque of a shaft is that of its motor times
    # `gear`, and its speed is that of the motor over `gear`.
    scale = np.concatenate([np.ones(p), gear**2, gear])
    # Friction that was not identified keeps the relative deviation of the settings.
    levels = np.concatenate([np.zeros(p), rig.drive.viscous, rig.drive.coulomb])
    P = np.diag((friction_deviation * levels) ** 2)
    identified = [i for i, name in enumerate(names) if name in model.fit.unknown]
    P[np.ix_(identified, identified)] = model.fit.covariance_of([names[i] for i in identified])
    return P * np.outer(scale, scale)

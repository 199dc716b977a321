"""Warnings: what a user should know before trusting what an identification found, one line each."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from identification.equation_error.naming import misread
from identification.replay.timing import is_late
from identification.results.restated import of_rotors, restated
from identification.results.seen import APART, contradicted, motion_of
from identification.search.predictive import FALSE_ALARM, ROUNDINGS, doubtful
from plant import Chain, Record, Rig
from plant.checkup.law_delay import law_delays
from plant.checkup.lost_rows import BRIDGED, short_gaps
from plant.checkup.oscillation import own_oscillations
from plant.checkup.rounding import rounding_doubts
from plant.checkup.signals import Signals
from plant.machine.unlikely import unlikely_statements
from plant.parts.fields import Floats

_AT_END = 0.002  # share of a range within which a value lies at its end
_STRANGE = 0.4  # RMS innovation [pulses] that rounding does not explain

_FEW_LOST = 1e-3  # share of rows that no fit is biased by
_WORSE = 1.5  # how much worse a record held out is repeated that asks for an explanation
_BIASED = 0.08  # relative bias of least squares in a band that is tolerated
# Correlation, and relative deviation, from which on a pair is not separately identifiable; and up
# to how many are told without a warning.
_INSEPARABLE = 0.995
_VAGUE = 0.05
MANY = 3

_ANOTHER = 0.05  # share of the logged torque by which that of the stated law may differ
_ZERO = 0.49  # zero of a counter [rad] beyond which it is at the end of its range


def warnings_of(found: Any, always: bool = True) -> list[str]:
    """Lines about an `Identification`; `always`: with those that hold for any log with these
    unknowns.
    """
    fits = found.diagnostics.closest > 0  # by prediction_error: the rig is not at fault
    replayed = any(record.law is not None and record.law.replays for record in found.records)
    late = _late(found)
    lines = [
        *of_statements(found.rig, found.records, found.arm.dynamics.chain),
        *_of_law(found, late),
        *contradicted(found),  # a prior that is wrong looks like a rig that is
        *_of_lost(found),
        # causes before what they do
        *([] if fits else _of_detection(found, replayed, ("lag",) * bool(late))),
        *([f"{found.fit.fallback_reason}."] if found.fit.fallback_reason and not fits else []),
        *_ends(found),
        *([] if fits else of_rotors(found)),
        *(_of_torques(found) if replayed else []),
        *_of_fit(found, replayed),
        *(_of_timing(found) if not replayed else []),
        *(_of_unknowns(found) if not replayed and always else []),
        *_of_loops(found),
        *_of_repeats(found, replayed),
        *_of_pairs(found),
    ]
    causes = [wrong[1:] for record in found.records if lines and (wrong := misread(record))]
    return [*dict.fromkeys(causes), *restated(found.arm.dynamics, found.records[0]), *lines]


def of_statements(rig: Rig, records: Iterable[Record], chain: Chain) -> Iterator[str]:
    """What a rig states that no arm has, along the counts of records; each once."""
    prismatic = [link.prismatic for link in chain.links]
    lines = list[str]()
    for record in records:
        if len(record) > APART:
            q, qd = motion_of(record)
            said = [*unlikely_statements(rig, q, qd, prismatic), *rounding_doubts(record)]
            lines += [line for line in said if line not in lines]
    yield from lines


def _ends(found: Any) -> Iterator[str]:
    if found.search.ranges is None:
        return
    for name, value, (low, high) in zip(
        found.short_names, found.fit.values, found.search.ranges, strict=True
    ):
        if low < high and min(value - low, high - value) < _AT_END * (high - low):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} end of its range; widen it."


def _of_torques(found: Any) -> Iterator[str]:
    """Least squares in its bands, against what repeats the motion; zeros."""
    bands = found.diagnostics.bands
    zeros = found.fit.zeros
    right = [band for band, ratio in bands.items() if abs(ratio - 1) < _BIASED]
    if bands and not right:
        yield (
            "least squares on these torques agrees in no band with what reproduces the motion; ask"
            " record.check() for order, signs and units of torques and positions."
        )
    elif any(band > max(right) for band in bands):
        small = ", ".join(
            f"{ratio:.2f} at {band:.3g}" for band, ratio in bands.items() if band > max(right)
        )
        yield (
            f"least squares on these torques is biased in bands above {max(right):.3g} Hz: it finds"
            f" {small} Hz of what reproduces the motion."
        )
    if zeros is not None and np.abs(zeros).max() > _ZERO:
        joint = found.arm.dynamics.chain.joint_labels[int(np.abs(zeros).max(axis=0).argmax())]
        yield (
            f"the encoder offset of {joint} ends half a radian away; was it set to zero at the"
            " start of the run?"
        )


def _of_lost(found: Any) -> Iterator[str]:
    """Rows that are bridged where the model cannot follow the log."""
    rms = found.fit.rms_innovation
    strange = rms is not None and rms > _STRANGE and found.search.method != "output_error"
    for i, record in enumerate(found.records if strange else ()):
        if (lost := int(short_gaps(record.valid == 0, BRIDGED).sum())) > _FEW_LOST * len(record):
            yield (
                f"{lost} rows of {_log(found, i)} are lost, or without weight: straight lines"
                " bridge them, and torques that change from row to row are on none, so f is"
                " biased. Log every row once."
            )


def _log(found: Any, i: int) -> str:
    return f"the log of records[{i}]" if len(found.records) > 1 else "the log"


def _late(found: Any) -> dict[int, Floats]:
    """Place of each record whose law gives the logged torque from later counts, and how late
    (n,) they are, or NaN.
    """
    apart = [
        k
        for k, each in enumerate(found.diagnostics.law_apart)
        if each is not None and each.max() > _ANOTHER
    ]
    late = {k: law_delays(Signals(found.records[k])) for k in apart}
    return {k: each for k, each in late.items() if np.nan_to_num(each).any()}


def _of_law(found: Any, late: dict[int, Floats]) -> Iterator[str]:
    """Laws that cannot have made the logged torque, or not with these counts."""
    joints = found.arm.dynamics.chain.joint_labels
    for i, (record, apart) in enumerate(
        zip(found.records, found.diagnostics.law_apart, strict=True)
    ):
        law = type(record.law).__name__
        which = _log(found, i)
        if i in late:
            those = ", ".join(
                f"{late[i][k]:+.0f} of {joints[k]}" for k in np.flatnonzero(np.nan_to_num(late[i]))
            )
            yield (
                f"the counts of {which} are late by samples: {those}; in time the stated {law}"
                " gives the logged torque from them, and late they bias f. Identify"
                " record.check().record, which has them in time."
            )
        elif apart is not None and apart.max() > _ANOTHER:
            shares = ", ".join(
                f"{share:.0%} at {joint}" for joint, share in zip(joints, apart, strict=True)
            )
            yield (
                f"the stated {law} cannot have made {which}: along it, it gives another torque than"
                f" was logged, by {shares} (rms). Check the law, its gains and period, gears, the"
                " reference, and the torque's units and side."
            )


def _of_fit(found: Any, replayed: bool) -> Iterator[str]:
    rms = found.fit.rms_innovation
    # `_of_repeats` tells of these
    simulated = found.search.method == "output_error" and not replayed
    if rms is not None and rms > _STRANGE and not simulated:
        reason = "Was it made with this rig, law and reference?"
        if replayed:
            reason = (
                "The rest is what it lacks (backlash, elasticity, changing friction), or a wrong"
                " rig."
            )
        yield (
            f"the model follows the log no closer than {rms:.2f} pulses (rounding alone: 0.29)."
            f" {reason}"
        )


def _of_timing(found: Any) -> Iterator[str]:
    delay = found.diagnostics.delay
    std = found.diagnostics.delay_std
    detection = found.diagnostics.detection
    explained = detection.names and "delay" not in detection.names  # by what looks like a delay
    if is_late(delay, std) and not explained:
        advice = f"Identify without_delay(record, {delay:.3g}) and compare"
        if abs(delay) > 1:
            advice = "Ask record.check(); friction or gains other than stated look so, too"
        yield (
            f"the counts are {abs(delay):.2f} samples {'late' if delay > 0 else 'early'}, which"
            f" biases f. {advice}."
        )


def _of_unknowns(found: Any) -> Iterator[str]:
    """Unknowns that take over a delay, whatever the log."""
    absorbing = [
        name for name in found.fit.unknown if name.startswith(("drive.viscous", "law.gain"))
    ]
    if absorbing:
        yield (
            f"a delay of the log is not separately identifiable from {', '.join(absorbing)}; be"
            " sure of the timing."
        )


def _of_loops(found: Any) -> Iterator[str]:
    """Loops that oscillate by themselves, each record once, at the frequency of its first joint
    that does.
    """
    for i, record in enumerate(found.records):
        if i not in found.diagnostics.hunts and (own := own_oscillations(record)):
            which = f"records[{i}]" if len(found.records) > 1 else "the log"
            yield (
                f"the loop of {which} oscillates at {own[0]:.3g} Hz, where the model's may not: it"
                " is unstable, or nearly. Lower the gains and log again, or state its cause"
                " (current_lag=, elasticity=)."
            )


def _of_detection(found: Any, replayed: bool, but: Sequence[str]) -> Iterator[str]:
    """What contradicts the model; late counts under a law that the model repeats are
    `_of_timing`'s.
    """
    detection = found.diagnostics.detection
    for sign, text in zip(detection.named, detection.warnings(), strict=True):
        if sign.name in but:
            continue
        if sign.name != "delay" or replayed or not np.isfinite(found.diagnostics.delay):
            yield text


def _of_repeats(found: Any, replayed: bool) -> Iterator[str]:
    told = found.diagnostics
    difference = found.diagnostics.difference
    held_out = None if told.closest > 0 else told.held_out_difference
    if not np.isfinite(difference):
        yield (
            "D(q) is not positive definite at every q, or the simulation diverges: the arm cannot"
            " be compared with the record, and no computed torque can be built on it. Log longer,"
            " or another motion."
        )
    elif told.closest > 0:
        yield (
            f"these values repeat the log to {difference:.2f} pulses (rms), those of"
            f" prediction_error to {told.closest:.2f}, as the model repeats itself. The log fits"
            " its model: identify with that method."
        )
    elif doubtful(told, found.records) and not replayed:
        chance = f", above {told.limit:.2f} with a probability of {FALSE_ALARM:g}" * bool(
            told.limit > 0
        )
        yield (
            f"simulated and measured errors differ by {difference:.2f} pulses (rms); two runs of"
            f" the model by {np.fmax(told.expected, ROUNDINGS):.2f}{chance}. Ask record.check(),"
            " and look at the law and its gains, signs (error = reference minus counted),"
            " friction, gears, springs, the direction of gravity, axes and lengths of the chain,"
            " the order of joints, and counts per turn: as the rig counts, the joints move over"
            f" {_ranges(found)}."
        )
    if held_out is not None and held_out > np.fmax(
        _WORSE * max(difference, ROUNDINGS), told.held_out_limit
    ):
        yield (
            f"a validation record differs by {held_out:.2f} pulses, those searched by "
            f"{difference:.2f}: the values do not hold for both."
        )


def _ranges(found: Any) -> str:
    """Ranges of motion in the first record, as its rig counts."""
    record = found.records[0]
    links = found.arm.dynamics.chain.links
    spans = np.ptp(record.rig.to_angle(record.counts), axis=0)
    pairs = zip(spans, links, strict=True)
    return " and ".join(
        f"{s:.3g} m" if link.prismatic else f"{np.rad2deg(s):.0f} degrees" for s, link in pairs
    )


def pairs_of(found: Any) -> list[tuple[str, str]]:
    """Names of those pairs of values that the log hardly tells apart; each alone is vague then."""
    if found.covariance is None:
        return []
    names = found.short_names
    vague = found.fit.std > _VAGUE * np.abs(found.fit.values)
    alike = (np.abs(found.fit.correlation) > _INSEPARABLE) & (vague[:, None] | vague)
    if (noise := found.fit.noise_covariance) is not None:  # what the rig may lack moves many alike
        alike &= np.abs(dataclasses.replace(found.fit, covariance=noise).correlation) > _INSEPARABLE
    return [(names[i], names[j]) for i, j in np.argwhere(np.triu(alike, 1))]


def _of_pairs(found: Any) -> Iterator[str]:
    if len(pairs := pairs_of(found)) > MANY:
        those = ", ".join(
            sorted({name for pair in pairs for name in pair}, key=found.short_names.index)
        )
        why = "the log excites them too little, or the model is not its robot's"
        yield f"{those} are not separately identifiable ({len(pairs)} pairs): {why}."

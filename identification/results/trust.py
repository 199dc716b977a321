"""Warnings of an identification, one line each, causes before their effects."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from identification.equation_error import (
    FittedArm,
    checkup_of,
    is_faster,
    law_differs,
    likelier_variant,
    misread,
    restated,
    wrong_statements,
)
from identification.replay import is_late
from identification.results.seen import APART, contradicted, motion_of
from identification.results.with_arm import BY_NAME
from identification.search import FALSE_ALARM, ROUGH, ROUNDINGS, doubtful
from plant import Chain, Record, Rig
from plant.checkup import BRIDGED, own_oscillations, rounding_doubts, short_gaps
from plant.machine import InnerLoop, unlikely_statements
from plant.parts import Floats, one_thread

_Lines: TypeAlias = Iterator[str]


@dataclass(frozen=True, kw_only=True)
class WarningSettings:
    """Limits from which on a result is doubted.

    The values were chosen by hand. They are held by ``tests/benchmarks/silent_mistakes.py`` (nine
    wrong statements, each reported in 10 of 10 logs; 0 of 50 right logs accused) and ``healthy.py``
    (0 of 200 right logs of 27 robots accused).

    Parameters
    ----------
    at_end : float
        Share of a range within which a value lies at its end.
    innovation : float
        RMS innovation [pulses] that rounding, 0.29 alone, does not explain; right logs of 27 robots
        have 0.35 at most (``healthy.py``).
    noise : float
        Innovations up to this multiple of those that the noise of a repeated torque causes, or the
        rounding of counts that a loop feels, are explained by it. Both are known to a few per cent.
    between : float
        The same factor where the loop is faster than the log, so that the log has only some samples
        of the torque. Right logs of two arms reach 1.6 (fast starts, creeping joints and fine
        encoders of ``corpus.py``).
    lost_rows : float
        Share of lost rows that biases no fit.
    held_out : float
        A held-out record whose difference exceeds that of the searched records by this factor needs
        an explanation. The limit of the posterior predictive check then decides, if there is one.
    band_bias : float
        Relative bias of least squares in a band that is tolerated.
    correlation, vague : float
        Two values are not separately identifiable if their correlation exceeds `correlation` and
        the relative standard deviation of at least one of them exceeds `vague`.
    pairs : int
        Such pairs that the summary mentions without a warning, at most.
    zero : float
        Encoder offset [rad] that lies at the end of its range of half a radian.
    """

    at_end: float = 0.002
    innovation: float = 0.4
    noise: float = 1.1
    between: float = 2.0
    lost_rows: float = 1e-3
    held_out: float = 1.5
    band_bias: float = 0.08
    correlation: float = 0.995
    vague: float = 0.05
    pairs: int = 3
    zero: float = 0.49


SETTINGS = WarningSettings()


@dataclass(frozen=True, kw_only=True)
class _Case:
    """An `Identification` with the facts that several checks read.

    `fits`: the values of prediction_error explain the log, so the rig is not at fault. `replayed`:
    a log's torque was replayed. `late`: delays (n,) [samples] of the counts under the stated law,
    by the place of their record.
    """

    identification: Any
    fits: bool
    replayed: bool
    late: dict[int, Floats]

    @classmethod
    def of(cls, identification):
        records = identification.records
        return cls(
            identification=identification,
            fits=identification.diagnostics.closest > 0,
            replayed=any(record.law is not None and record.law.replays for record in records),
            late=late_by_law(identification),
        )

    @property
    def joints(self):
        return tuple(self.identification.arm.dynamics.chain.joint_labels)

    def log(self, i):
        """Name of the log of a record."""
        several = len(self.identification.records) > 1
        return f"the log of records[{i}]" if several else "the log"


@one_thread
def warnings_of(identification: Any) -> dict[str, bool]:
    """Lines about an `Identification`, causes first, and whether each doubts the values.

    A line that holds for any log with these unknowns doubts none.
    """
    case = _Case.of(identification)
    # The names of the causes document the order; lines have no names.
    lines = {line: check not in _ALWAYS for _, check in _CHECKS for line in check(case)}
    # Rows that could not be tried are listed, and doubt no value.
    lines |= dict.fromkeys(identification.failed, False)
    # Counts that nobody logged may be behind all of these lines; alone they doubt none.
    lines = dict.fromkeys(_between_rows(case), any(lines.values())) | lines
    record = identification.records[0]
    dynamics = identification.arm.dynamics
    if identification.own_causes:
        statements = [cause.line for cause in identification.own_causes]
    # Wrong signs are reported even where no line doubts the log.
    elif not any(lines.values()):
        statements = [cause.line for cause in restated(dynamics, record)]
    else:
        # Columns that were misread explain any doubt, but accuse no log that has none.
        statements = [*wrong_statements(dynamics, record)]
        for other in identification.records[1:]:
            statements += misread(other, dynamics)
    if statements and any(lines.values()):
        lines = {_EFFECTS: False} | lines
    # A second mistake shows in the corrected log.
    beside = [f"with the mistakes corrected: {line}" for line in identification.left]
    return dict.fromkeys([*statements, *beside], True) | lines


_EFFECTS = (
    "warnings of the fit were found with the mistakes still in the log, and may be their effects."
    " Correct the mistakes first, and identify again."
)


def of_statements(rig: Rig, records: Iterable[Record], chain: Chain) -> _Lines:
    """Statements of a rig that no arm has, along the counts of records, each once."""
    # Speeds and ranges of slides are in metres.
    prismatic = [link.prismatic for link in chain.links]
    lines = []
    for record in records:
        if len(record) > APART:  # speeds need so many samples
            q, qd = motion_of(record)
            doubts = [*unlikely_statements(rig, q, qd, prismatic), *rounding_doubts(record)]
            lines += [line for line in doubts if line not in lines]
    yield from lines


def _between_rows(case):
    """Sampled laws that read counts between the rows of a log without torques."""
    for i, record in enumerate(case.identification.records):
        law = record.law
        logged = record.torque is not None or record.current is not None
        # Fast hardware, and the inner loop of a servo, read the counts of the model in between.
        in_loop = law is None or law.period is None or isinstance(law.innermost, InnerLoop)
        if not (logged or in_loop) and is_faster(record):
            yield (
                f"the law of {case.log(i)} acts every {1e3 * law.period:.3g} ms, a row is written"
                f" every {1e3 * record.rig.period:.3g} ms: the counts that the law read in between"
                " are in no row, and any doubt about this log may come from that. Log torque or"
                " current as well, or every sample of the loop."
            )


def _statements(case):
    result = case.identification
    return of_statements(result.rig, result.records, result.arm.dynamics.chain)


def _prior(case):
    return contradicted(case.identification)


def _undetermined(case):
    result = case.identification
    names = dict(zip(result.fit.unknown, result.short_names, strict=True))
    for group in result.fit.undetermined:
        yield (
            f"{' and '.join(names[name] for name in group)} and the state of the controller before"
            " the log are not separately identifiable: what one adds to the torque the other takes"
            " away. Log the torque, log from the start of the controller, or state the law as"
            " Resumed with its state."
        )


def _range_ends(case):
    result = case.identification
    if result.search.ranges is None:
        return
    # The search stops at the end of a range, wherever the optimum is.
    for name, value, (low, high) in zip(
        result.short_names, result.fit.values, result.search.ranges, strict=True
    ):
        # A range without extent states a value: it has no end.
        if low < high and min(value - low, high - value) < SETTINGS.at_end * (high - low):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} end of its range; widen it."


def _rotors(case):
    result = case.identification
    if case.fits:
        return
    record = result.records[0]
    yield from FittedArm(
        dynamics=result.arm.dynamics,
        rig=result.rig,
        f=result.f,
        covariance=result.fit.covariance_of(result.arm.dynamics.names),
        q=record.rig.to_angle(record.counts),
        fitted=result.fit.unknown,
        # Deviations of rough methods do not cover their own errors.
        rough=result.covariance is None or result.search.method in ROUGH,
    ).of_rotors()


def _torque_bands(case):
    """Least squares on the logged torques, in bands, against the values that repeat the motion."""
    bands = case.identification.diagnostics.bands
    if not case.replayed or not bands:
        return
    # Filters and delays of torques act on fast motion first: slow bands can be right alone.
    unbiased = [band for band, ratio in bands.items() if abs(ratio - 1) < SETTINGS.band_bias]
    if not unbiased:
        yield (
            "least squares on these torques agrees in no band with what reproduces the motion; ask"
            " record.check() for order, signs and units of torques and positions."
        )
        return
    highest = max(unbiased)
    biased = [f"{ratio:.2f} at {band:.3g}" for band, ratio in bands.items() if band > highest]
    if biased:
        yield (
            f"least squares on these torques is biased in bands above {highest:.3g} Hz: it finds"
            f" {', '.join(biased)} Hz of what reproduces the motion."
        )


def _zeros(case):
    zeros = case.identification.fit.zeros
    # Zeros are unknowns of replays only.
    if case.replayed and zeros is not None and np.abs(zeros).max() > SETTINGS.zero:
        joint = case.joints[int(np.abs(zeros).max(axis=0).argmax())]
        yield (
            f"the encoder offset of {joint} ends half a radian away; was it set to zero at the"
            " start of the run?"
        )


def _lost_rows(case):
    """Bridged rows, where the model does not follow the log."""
    result = case.identification
    rms = result.fit.rms_innovation
    if rms is None or not rms > SETTINGS.innovation or result.search.method == "output_error":
        return
    for i, record in enumerate(result.records):
        # Only gaps that are short enough to be bridged.
        lost = int(short_gaps(record.valid == 0, BRIDGED).sum())
        if lost > SETTINGS.lost_rows * len(record):
            yield (
                f"{lost} rows of {case.log(i)} are lost, or without weight: straight lines"
                " bridge them, and torques that change from row to row are on none, so f is"
                " biased. Log every row once."
            )


def late_by_law(identification):
    """Delays (n,) of the counts with which the stated law gives the logged torque, by record.

    The delay is 0 for a joint that is not late. Records without a late joint are left out.
    """
    delays = dict[int, Floats]()
    for i, apart in enumerate(identification.diagnostics.law_apart):
        record = identification.records[i]
        if not law_differs(apart):
            continue
        for cause in checkup_of(record, identification.arm.dynamics).causes:
            if cause.name == "late counts":
                delay = delays.setdefault(i, np.zeros(record.n))
                # A cause is the size beyond the causes before it; one without joints is of all.
                delay[list(cause.joints) or slice(None)] += cause.size
    return {i: delay for i, delay in delays.items() if delay.any()}


def _law(case):
    """Laws that cannot have given the logged torque, or not from these counts."""
    result = case.identification
    for i, (record, apart) in enumerate(
        zip(result.records, result.diagnostics.law_apart, strict=True)
    ):
        law = type(record.law).__name__
        variant = None if apart is None or i in case.late else likelier_variant(record, apart)
        if variant is not None:
            text, remaining = variant
            yield (
                f"the stated {law} gives another torque than {case.log(i)} has, by"
                f" {apart.max():.2g} of it (rms); with {text} it is {remaining.max():.2g}. State"
                f" {law}(..., {text})."
            )
            continue
        # A delay explains the difference, so it is not the fault of the law.
        if i in case.late:
            delays = ", ".join(
                f"{case.late[i][k]:+.0f} of {case.joints[k]}" for k in np.flatnonzero(case.late[i])
            )
            yield (
                f"the counts of {case.log(i)} are late by samples: {delays}; in time the stated"
                f" {law} gives the logged torque from them, and late they bias f. Identify"
                " record.check().corrected, which has them in time."
            )
        elif law_differs(apart):
            shares = ", ".join(
                f"{share:.0%} at {joint}" for joint, share in zip(case.joints, apart, strict=True)
            )
            yield (
                f"the stated {law} cannot have made {case.log(i)}: along it, it gives another"
                f" torque than was logged, by {shares} (rms). Check the law, its gains and period,"
                " gears, the reference, and the torque's units and side."
            )


def _innovations(case):
    result = case.identification
    rms = result.fit.rms_innovation  # None where a method has no innovations
    # Those of output error are differences of a simulation, of which `_repeats` warns under a law.
    simulated = result.search.method == "output_error"
    # The noise of a repeated torque is no defect of the model; it adds to the rounding.
    sampled = any(
        record.law is not None and (record.law.interpolates or is_faster(record))
        for record in result.records
    )
    factor = SETTINGS.between if sampled else SETTINGS.noise
    rounding = max(SETTINGS.innovation, SETTINGS.noise * result.fit.rounding_innovation)
    expected = np.hypot(rounding, factor * result.fit.noise_innovation)
    if rms is not None and rms > SETTINGS.innovation and simulated and case.replayed:
        yield (
            f"simulated over the whole log, the model departs from it by {rms:.3g} pulses (rms):"
            " small errors of the torque accumulate. Judge the values by found.error_on(record)."
        )
    elif rms is not None and rms > expected and not simulated:
        reason = "Was it made with this rig, law and reference?"
        if case.replayed:
            reason = (
                "The rest is what it lacks (backlash, elasticity, changing friction), or a wrong"
                " rig."
            )
        yield (
            f"the model follows the log no closer than {rms:.2f} pulses (rounding alone: 0.29)."
            f" {reason}"
        )


def _timing(case):
    diagnostics = case.identification.diagnostics
    delay = diagnostics.delay
    names = diagnostics.detection.names
    # Another fitted cause can look like a delay. It has a line of its own, so the delay that it
    # imitates is not reported beside it.
    explained = names and "delay" not in names
    if not case.replayed and is_late(delay, diagnostics.delay_std) and not explained:
        absorbing = _absorbing_delay(case)
        advice = f"Identify without_delay(record, {delay:.3g}) and compare"
        if absorbing:
            advice = (
                f"This log hardly distinguishes that from another {', '.join(absorbing)}:"
                f" {BY_NAME['delay'].telling}"
            )
        # More than a sample is rather an effect of wrong friction or gains.
        elif abs(delay) > 1:
            advice = "Ask record.check(); friction or gains other than stated look so, too"
        biased = "" if absorbing else ", which biases f"
        yield (
            f"the counts are {abs(delay):.2f} samples {'late' if delay > 0 else 'early'}{biased}."
            f" {advice}."
        )


def _absorbing_delay(case):
    """Unknowns that shift the phase of the loop as a delay does."""
    return [
        name
        for name in case.identification.fit.unknown
        if name.startswith(("drive.viscous", "law.gain"))
    ]


def _absorbed_delay(case):
    """Unknowns that take a delay over, in any log."""
    absorbing = _absorbing_delay(case)
    if absorbing and not case.replayed:
        yield (
            f"a delay of the log is not separately identifiable from {', '.join(absorbing)}; be"
            " sure of the timing."
        )


def _oscillations(case):
    """Loops that oscillate by themselves, each record at the frequency of its first such joint."""
    result = case.identification
    for i, record in enumerate(result.records):
        # The model's loop hunts as well: counts and friction explain the oscillation.
        if i in result.diagnostics.hunts:
            continue
        if frequencies := own_oscillations(record):
            name = f"records[{i}]" if len(result.records) > 1 else "the log"
            yield (
                f"the loop of {name} oscillates at {frequencies[0]:.3g} Hz, where the model's may"
                " not: it is unstable, or nearly. Lower the gains and log again, or state its cause"
                " (current_lag=, elasticity=)."
            )


def _detected(case):
    """Effects that the rig does not model."""
    diagnostics = case.identification.diagnostics
    if case.fits:
        return
    detection = diagnostics.detection
    for cause in detection.causes:
        # Late counts look like a lag of the currents, and `_law` has reported them.
        if cause.name == "lag" and case.late:
            continue
        # Where the loop can be simulated, `_timing` reports the delay against the simulation.
        if cause.name != "delay" or case.replayed or not np.isfinite(diagnostics.delay):
            yield cause.line


def _fallback(case):
    reason = case.identification.fit.fallback_reason
    if reason and not case.fits:
        yield f"{reason}."


def _repeats(case):
    """How well a simulation with the values repeats the records, searched and held out."""
    result = case.identification
    diagnostics = result.diagnostics
    difference = diagnostics.difference
    # 1. The records that were searched.
    if not np.isfinite(difference):
        yield (
            "D(q) is not positive definite at every q, or the simulation diverges: the arm cannot"
            " be compared with the record, and no computed torque can be built on it. Log longer,"
            " or another motion."
        )
    elif case.fits:
        yield (
            f"these values repeat the log to {difference:.2f} pulses (rms), those of"
            f" prediction_error to {diagnostics.closest:.2f}, as the model repeats itself. The log"
            " fits its model: identify with that method."
        )
    elif doubtful(diagnostics, result.records) and not case.replayed:
        chance = ""
        if diagnostics.limit > 0:
            chance = f", above {diagnostics.limit:.2f} with a probability of {FALSE_ALARM:g}"
        yield (
            f"simulated and measured errors differ by {difference:.2f} pulses (rms); two runs of"
            f" the model by {np.fmax(diagnostics.expected, ROUNDINGS):.2f}{chance}. Ask"
            " record.check(), and look at the law and its gains, signs (error = reference minus"
            " counted), friction, gears, springs, the direction of gravity, axes and lengths of the"
            " chain, the order of joints, and counts per turn: as the rig counts, the joints move"
            f" over {_ranges(result)}."
        )
    # 2. The records held out. A difference that all records share is due to the model, not to the
    # values.
    held_out = diagnostics.held_out_difference
    if case.fits or held_out is None:
        return
    # Two roundings alone differ so much, which no ratio may doubt.
    limit = SETTINGS.held_out * max(difference, ROUNDINGS)
    if held_out > np.fmax(limit, diagnostics.held_out_limit):
        yield (
            f"a validation record differs by {held_out:.2f} pulses, those searched by "
            f"{difference:.2f}: the values do not hold for both."
        )


def _ranges(identification):
    """Ranges of motion in the first record, as its rig counts."""
    # A user compares these ranges with those of the experiment: wrong counts per turn show here.
    record = identification.records[0]
    # From the counts alone, without a model that may be wrong.
    spans = np.ptp(record.rig.to_angle(record.counts), axis=0)
    return " and ".join(
        f"{span:.3g} m" if link.prismatic else f"{np.rad2deg(span):.0f} degrees"
        for span, link in zip(spans, identification.arm.dynamics.chain.links, strict=True)
    )


def pairs_of(identification: Any) -> list[tuple[str, str]]:
    """Names of the pairs of strongly correlated values of which at least one is uncertain."""
    if identification.covariance is None:
        return []
    fit = identification.fit
    names = identification.short_names
    # Of a pair, at least one value must be uncertain: two precise ones may be correlated.
    # Relative to the value, which is what a user compares the deviation with.
    vague = fit.std > SETTINGS.vague * np.abs(fit.values)
    alike = (np.abs(fit.correlation) > SETTINGS.correlation) & (vague[:, None] | vague)
    # Effects that the rig may lack move many values alike, so noise alone must correlate them too.
    if fit.noise_covariance is not None:
        of_noise = replace(fit, covariance=fit.noise_covariance)
        alike &= np.abs(of_noise.correlation) > SETTINGS.correlation
    # Each pair once.
    return [(names[i], names[j]) for i, j in np.argwhere(np.triu(alike, 1))]


def inseparable(case):
    """Pairs of values that the logs hardly tell apart, where they are more than usual."""
    result = case.identification
    pairs = pairs_of(result)
    # A few correlated pairs are usual in any motion of a real arm.
    if len(pairs) > SETTINGS.pairs:
        names = {name for pair in pairs for name in pair}
        listed = ", ".join(sorted(names, key=result.short_names.index))
        reason = "the log excites them too little, or the model is not its robot's"
        yield f"{listed} are not separately identifiable ({len(pairs)} pairs): {reason}."


# Causes in the order of their lines. A user reads the first line first, so a cause stands above its
# effects.
_CHECKS: tuple[tuple[str, Callable[[_Case], _Lines]], ...] = (
    # 1. Statements and rows: with a wrong one, every line below may be its effect.
    ("statement that no arm has", _statements),
    # It needs no arm: law, reference, counts and torque show it.
    ("wrong law, or counts late for it", _law),
    # A wrong prior pulls f, and the innovations then look like those of a wrong rig.
    ("wrong prior", _prior),
    # Bridged rows bias f.
    ("lost rows", _lost_rows),
    # 2. Effects that the rig does not model bias the values, which the lines below doubt.
    ("effect that the rig does not model", _detected),
    ("method that fell back", _fallback),
    # 3. The values themselves.
    ("unknowns that act like the state of the controller", _undetermined),
    ("range too narrow", _range_ends),
    ("wrong rotor", _rotors),
    ("torques biased in high bands", _torque_bands),
    ("encoder offset out of range", _zeros),
    # 4. Symptoms: all causes above can bring them about.
    ("innovations beyond rounding", _innovations),
    ("late counts", _timing),
    ("delay that unknowns take over", _absorbed_delay),
    ("unstable loop", _oscillations),
    ("simulation that does not repeat the log", _repeats),
    # 5. Last, the lines that question the use of single values and not the log.
    ("values that are not separately identifiable", inseparable),
)

# Checks whose lines hold for any log with these unknowns.
_ALWAYS = (_absorbed_delay,)

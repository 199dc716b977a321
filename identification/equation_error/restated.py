"""Contradictions between a log's torques and the equation of motion, for any parameters f.

Each hypothesis restates the log, or what is stated of the arm, as it would be without one mistake.
The mistakes are: the wrong sign of a joint or a torque; gravity that is turned, tilted, or taken
out of the torque; a zero that is off by one or two right angles; two exchanged columns; another
unit of positions or torques; late torques or positions; friction that the torques lack or the rig
overstates. `restatements` undoes each mistake; `stated_equation` says how likely the result is.
"""

import functools
import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

from identification.equation_error import restatements as undo
from identification.equation_error.checked_up import checkup_of, misread
from identification.equation_error.stated_equation import SETTINGS, TorqueEquation
from identification.equation_error.stated_law import law_differs, torque_apart
from identification.equation_error.torque_logs import TorqueLog, torque_logs
from plant import Dynamics, Hypothesis, Record
from plant.checkup import (
    Candidate,
    Cause,
    SelectionSettings,
    counts_in_time,
    each_joint,
    pairs,
    ranking,
    turned_joint,
    turned_torque,
    whole,
)

# `against`, the log odds against a mistake, are those of a residual that no right log reaches, with
# a margin. 40 right logs of the corpus (``tests/benchmarks/verdicts.py``; fast starts, creeping
# joints, a UR10, a Panda) were restated: another sign of a joint left 0.76 of the original residual
# or more, any other restatement 0.98 or more. Where the first axis is level, a zero of its joint
# that is off by 180 degrees is the same mistake as gravity upwards.
HYPOTHESES = (
    Hypothesis(
        name="gravity direction",
        sentence="gravity acts the other way",
        remedy="Turn the chain's gravity",
        undo=undo.gravity_times,
        sizes=(-1.0,),
        against=13.0,
    ),
    Hypothesis(
        name="joint sign",
        sentence="{joint} turns the other way: its axis, or the signs of all its columns, are"
        " wrong",
        remedy="Turn them",
        undo=undo.turned,
        scope=each_joint,
        against=13.0,
        of_record=turned_joint,
    ),
    # An f of the other sign explains turned torques as well, except for friction.
    Hypothesis(
        name="sign of the torques",
        sentence="the torques have the other sign: they are what the joints feel, not what the"
        " drives give",
        remedy="Change the sign of all torques",
        undo=undo.torques_turned,
        against=10.0,
        of_record=turned_torque,
    ),
    Hypothesis(
        name="torque sign",
        sentence="the torque of {joint} has the other sign: that of what the joint feels, or of a"
        " motor that turns the other way",
        remedy="Change the sign of its torque",
        undo=undo.torque_turned,
        scope=each_joint,
        against=10.0,
        of_record=turned_torque,
    ),
    Hypothesis(
        name="gravity removed",
        sentence="gravity is taken out of the torques already",
        remedy="Log the torque with gravity, or state a chain without it (gravity=(0, 0, 0))",
        undo=undo.weighed,
        suggested=undo.removals,
        against=6.0,
    ),
    Hypothesis(
        name="tilted base",
        sentence="the base is tilted by about {value:.0f} degrees against the stated gravity",
        remedy="Correct the gravity of the chain: gravity=({gravity})",
        undo=undo.levelled,
        suggested=undo.tilts,
        against=14.0,
        unit="degrees",
    ),
    # Friction is within a factor of four of the stated one in most drives.
    Hypothesis(
        name="torques without friction",
        sentence="the torque is that of a model, or of a sensor behind the gears: friction is"
        " {value:.3g} % of it, which the rig states differently",
        remedy="Log the torque, or the current, of the motors",
        undo=undo.without_friction,
        evidence=undo.frictionless,
        against=10.0,
        unit="%",
    ),
    # The torque that a law commands includes friction, so that the stated friction must be wrong.
    Hypothesis(
        name="overstated friction",
        sentence="friction is not the rig's: it is {value:.3g} % of the torque that the law"
        " commands, far less than stated",
        remedy="Correct the friction of the drive, or leave it open (None)",
        undo=undo.without_friction,
        evidence=undo.overstated,
        against=10.0,
        unit="%",
    ),
    Hypothesis(
        name="joint zero",
        sentence="the zero of {joint} is {value:+.0f} degrees off",
        remedy="Correct the zero of the column, or the joint's offset in the chain",
        undo=undo.zero_moved,
        scope=each_joint,
        sizes=(90.0, -90.0, 180.0),
        against=14.0,
        unit="degrees",
        of_record=undo.with_zero,
    ),
    Hypothesis(
        name="exchanged torques",
        sentence="the torques of {joint} and {other} are exchanged",
        remedy="Exchange the columns",
        undo=undo.torques_exchanged,
        scope=pairs,
        against=10.0,
        of_record=undo.with_torques_exchanged,
    ),
    Hypothesis(
        name="exchanged positions",
        sentence="the positions of {joint} and {other} are exchanged",
        remedy="Exchange the columns",
        undo=undo.positions_exchanged,
        scope=pairs,
        against=10.0,
    ),
    Hypothesis(
        name="late torques",
        sentence="the torques are late against the positions by about {value:.0f} ms",
        remedy="Shift the column, or ask record.check() for the timing",
        undo=undo.in_time,
        evidence=undo.torques_lateness,
        against=8.0,
        unit="ms",
    ),
    # Where no torque was logged, its place is taken by that of the stated law.
    Hypothesis(
        name="law without rate",
        sentence="the torques that moved the arm lead those of the stated law by about"
        " {value:.0f} ms: the law lacks the rate of its error",
        remedy="State the law that made the log; a PD has such a lead, its derivative per gain",
        undo=undo.in_time,
        evidence=undo.lead_over_law,
        against=8.0,
        unit="ms",
    ),
    # Its torque follows from the counts, so that late ones make it another torque.
    Hypothesis(
        name="late counts of a law",
        sentence="the counts are {value:.2g} samples late against the reference",
        remedy="Shift their columns",
        undo=undo.counts_in_time,
        evidence=undo.counts_lateness,
        against=10.0,
        unit="samples",
        of_record=counts_in_time,
    ),
    Hypothesis(
        name="law gain",
        sentence="gains of the law that made the log are not the stated ones: {gain}"
        " {value:+.2g} %",
        remedy="Check them",
        undo=undo.with_larger_gain,
        evidence=undo.other_gain,
        against=14.0,
        unit="%",
        of_record=undo.record_with_gain,
    ),
    # A computed torque without its friction, an integral by another rule.
    Hypothesis(
        name="law variant",
        sentence="the law that made the log is another variant of the stated one: that with"
        " {variant}",
        remedy="State the law with {variant}",
        undo=undo.with_variant,
        evidence=undo.other_variants,
        against=14.0,
        of_record=undo.record_with_variant,
    ),
    Hypothesis(
        name="limit",
        sentence="the torques are cut off at a limit that the rig does not state, where the law"
        " commands more: {value:.0f} % of the largest",
        remedy="State the drive's current_limit, or slow the motion down",
        undo=undo.cut_off,
        suggested=undo.limits,
        against=14.0,
        unit="%",
    ),
    Hypothesis(
        name="late counts",
        sentence="the positions are late against the torques by about {value:.0f} ms",
        remedy="Shift their columns, or ask record.check() for the timing",
        undo=undo.late_positions,
        evidence=undo.positions_lateness,
        against=8.0,
        unit="ms",
    ),
    Hypothesis(
        name="unit of positions",
        sentence="the positions are {value:.3g} times too large",
        remedy="Correct their unit (degrees, turns, rad)",
        undo=undo.in_unit,
        suggested=undo.units,
        against=10.0,
        unit="times",
    ),
    # The scale is relative to the torque that the stated bodies need, at the joints where they need
    # any: a free f would absorb a factor of the torque.
    Hypothesis(
        name="torque scale",
        sentence="the torques are {value:.4g} times those that the bodies of the chain need",
        remedy="Correct the unit, gear or gain of the torques, or the bodies of the chain",
        undo=undo.scaled,
        evidence=undo.scales,
        against=6.0,
        unit="times",
    ),
)

BY_NAME = {hypothesis.name: hypothesis for hypothesis in HYPOTHESES}

# Hypotheses that are always tried; the others are tried only where the equation leaves much of the
# torques. A free f absorbs a small tilt, and on some arms a wrong zero, so that little is left; the
# stated bodies do not absorb them.
_ALWAYS = (
    "gravity direction",
    "joint sign",
    "sign of the torques",
    "torques without friction",
    "overstated friction",
    "tilted base",
    "joint zero",
    "law gain",
    "law variant",
)


def contradictions(
    equation: TorqueEquation | None,
    hypotheses: tuple[Hypothesis[TorqueEquation], ...] = HYPOTHESES,
) -> tuple[Cause, ...]:
    """The causes, the likeliest first, with the shares of the torques that are left."""
    if equation is None:
        return ()
    result = ranking(
        equation,
        functools.partial(candidates_of, hypotheses=hypotheses),
        tuple(equation.dynamics.chain.joint_labels),
        # Of two mistakes at once the second is found beside the first.
        SelectionSettings(causes=2),
    )
    left = [experiment.left for experiment in result.experiments]
    causes = []
    for k, (before, after) in enumerate(itertools.pairwise(left)):
        cause = result.causes[k]
        sentence = cause.sentence
        if after < before:
            compared_with = "as it is" if k == 0 else "with the first correction alone"
            sentence += (
                f". So stated, the equation of motion leaves {after:.1%} of the torques (rms);"
                f" {compared_with}, {before:.1%}"
            )
        remedy = f"{cause.remedy}, and identify again"
        causes.append(replace(cause, sentence=sentence, remedy=remedy))
    return tuple(causes)


def candidates_of(
    equation: TorqueEquation, hypotheses: tuple[Hypothesis[TorqueEquation], ...] = HYPOTHESES
) -> Iterator[Candidate]:
    """The restatements of an equation that are worth a trial, each with its log odds."""
    n = equation.dynamics.n
    for hypothesis in hypotheses:
        if hypothesis.name not in _ALWAYS and not equation.left > SETTINGS.suspected:
            continue
        # On a single joint a free f absorbs a turn: only hypotheses of scope `whole` are tried.
        scopes = hypothesis.scope(n) if n > 1 or hypothesis.scope is whole else ()
        for joints in scopes:
            for size, odds in _scored(hypothesis, equation, joints):
                corrected = functools.partial(hypothesis.undo, equation, joints, size)
                odds -= hypothesis.against + equation.against_any
                words = undo.words_of(equation, size)
                yield Candidate(hypothesis, joints, size, odds, corrected, words)


def _scored(hypothesis, equation, joints):
    """Sizes of a restatement, and how much likelier it makes the log."""
    if hypothesis.evidence is not None:
        yield from hypothesis.evidence(equation, joints)
        return
    sizes = hypothesis.suggested or (lambda equation, joints: hypothesis.sizes)
    for size in sizes(equation, joints):
        changed = hypothesis.undo(equation, joints, size)
        yield size, changed.evidence_at_best - equation.evidence


@functools.lru_cache(maxsize=4)
def restated(dynamics: Dynamics, record: Record) -> tuple[Cause, ...]:
    """What a record states wrongly, or nothing."""
    return contradictions(TorqueEquation.of(dynamics, record))


def wrong_statements(dynamics: Dynamics, record: Record) -> tuple[str, ...]:
    """A line for each mistake in a record: first those that its checkup calls wrong.

    The equation of motion then examines the record with these corrected, so that none is reported
    twice.
    """
    misreadings = misread(record, dynamics)
    corrected = checkup_of(record, dynamics).corrected if misreadings else record
    return (*misreadings, *(cause.line for cause in restated(dynamics, corrected)))


class Mistakes(NamedTuple):
    """What the checkup and the torque equation of a record find wrong, and can correct.

    `lines`: a line for each cause. `corrected`: the record without these causes, or the record
    itself where there is none.
    """

    lines: tuple[str, ...]
    corrected: Record


def mistakes_of(dynamics: Dynamics, record: Record) -> Mistakes:
    """The mistakes of a record, one after the other, until one cannot be corrected.

    The gravity of a chain is no statement of a record.
    """
    checkup = checkup_of(record, dynamics)
    lines = [cause.line for cause in checkup.causes if cause.certain]
    corrected = checkup.corrected
    for cause in restated(dynamics, corrected):
        row = BY_NAME[cause.name]
        if not cause.certain or row.of_record is None:
            break
        lines.append(cause.line)
        corrected = row.of_record(corrected, cause.joints, cause.size)
    return Mistakes(tuple(lines), corrected if lines else record)


def of_log(
    dynamics: Dynamics, log: TorqueLog, band: float, doubted: bool = False
) -> tuple[Cause, ...]:
    """What a log of positions and torques states wrongly, in a band [Hz].

    Where the log is `doubted`, or contradicts the equation of motion or its law, what the checkup
    of its record calls wrong comes first, and the equation examines the log with that corrected;
    but not where the equation's own causes explain more.
    """
    equation = TorqueEquation.of_band(dynamics, log, band)
    causes = contradictions(equation)
    record = log.record
    if record is None or not (doubted or causes or law_differs(torque_apart(record))):
        return causes
    lines = misread(record, dynamics)
    checkup = checkup_of(record, dynamics)
    misreadings = tuple(cause for cause in checkup.causes if cause.line in lines)
    if not misreadings:
        return causes
    (corrected,) = torque_logs(dynamics, checkup.corrected, None, None)
    without = TorqueEquation.of_band(dynamics, corrected, band)
    explained = sum(cause.log_odds for cause in causes)
    if equation and without and causes and explained > without.evidence - equation.evidence:
        return causes
    return (*misreadings, *contradictions(without))

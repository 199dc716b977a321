"""Contradictions between the torques of a log and the equation of motion, whatever f is.

Each hypothesis restates the log, or gravity, as it would be without one mistake: the sign of a
joint or of its torque, gravity turned, tilted, or taken out of the torque, a zero by a right angle,
two columns exchanged, another unit of positions or torques, a torque that is late, or without
friction. `restatements` undoes each of them; `stated_equation` says how likely the result is.
"""

import functools
from collections.abc import Iterator
from dataclasses import replace

from identification.equation_error import restatements as undo
from identification.equation_error.naming import misread
from identification.equation_error.stated_equation import SETTINGS, TorqueEquation
from identification.equation_error.torque_logs import TorqueLog
from plant import Dynamics, Record
from plant.checkup.hypothesis import (
    Candidate,
    Cause,
    Hypothesis,
    SelectionSettings,
    each_joint,
    pairs,
    ranking,
    whole,
)

# Log odds against a mistake are those of a residual that no right log reaches, with a margin. Of
# the residual as stated, 40 right logs of the corpus (``tests/benchmarks/verdicts.py``; fast
# starts, creeping joints, a UR10, a Panda) left 0.76 with another sign of a joint, and else 0.98 or
# more. Where the first axis is level, a zero by 180 degrees and gravity upwards are the same.
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
    ),
    # f of the other sign takes the turn over, except for friction.
    Hypothesis(
        name="sign of the torques",
        sentence="the torques have the other sign: they are what the joints feel, not what the"
        " drives give",
        remedy="Change the sign of all torques",
        undo=undo.torques_turned,
        against=10.0,
    ),
    Hypothesis(
        name="torque sign",
        sentence="the torque of {joint} has the other sign: that of what the joint feels, or of a"
        " motor that turns the other way",
        remedy="Change the sign of its torque",
        undo=undo.torque_turned,
        scope=each_joint,
        against=10.0,
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
        remedy="Correct the gravity of the chain",
        undo=undo.levelled,
        suggested=undo.tilts,
        against=14.0,
        unit="degrees",
    ),
    # Friction is within a factor of four of the stated one in most drives.
    Hypothesis(
        name="torques without friction",
        sentence="the torque is that of a model, or of a sensor behind the gears: friction is"
        " {value:.1g} % of it, which the rig states differently",
        remedy="Log the torque, or the current, of the motors",
        undo=undo.without_friction,
        evidence=undo.frictionless,
        against=10.0,
        unit="%",
    ),
    # The torque of a law drives the motor, friction and all.
    Hypothesis(
        name="overstated friction",
        sentence="friction is not the rig's: it is {value:.1g} % of the torque that the law"
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
    ),
    Hypothesis(
        name="exchanged torques",
        sentence="the torques of {joint} and {other} are exchanged",
        remedy="Exchange the columns",
        undo=undo.torques_exchanged,
        scope=pairs,
        against=10.0,
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
    # Of joints that the stated bodies move; f of any value takes a factor of the torque over.
    Hypothesis(
        name="torque scale",
        sentence="the torques are {value:.2g} times those that the bodies of the chain need",
        remedy="Correct the unit, gear or gain of the torques, or the bodies of the chain",
        undo=undo.scaled,
        evidence=undo.scales,
        against=6.0,
        unit="times",
    ),
)

# Statements that are always tried; the others where much is left. f of any value takes over a small
# tilt, and a zero of some arms, but the stated bodies do not.
_ALWAYS = (
    "gravity direction",
    "joint sign",
    "sign of the torques",
    "torques without friction",
    "overstated friction",
    "tilted base",
    "joint zero",
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
    return tuple(
        replace(
            cause,
            sentence=f"{cause.sentence}. So stated, the equation of motion leaves {after:.1%} of"
            f" the torques (rms); as it is, {before:.1%}"
            if after < before
            else cause.sentence,
            remedy=f"{cause.remedy}, and identify again",
        )
        for cause, before, after in zip(result.causes, left[:-1], left[1:], strict=True)
    )


def candidates_of(
    equation: TorqueEquation, hypotheses: tuple[Hypothesis[TorqueEquation], ...] = HYPOTHESES
) -> Iterator[Candidate]:
    """Every restatement of an equation, with its log odds."""
    n = equation.dynamics.n
    for hypothesis in hypotheses:
        if hypothesis.name not in _ALWAYS and not equation.left > SETTINGS.suspected:
            continue
        # Of a single joint, f of any value takes a turn over.
        scopes = hypothesis.scope(n) if n > 1 or hypothesis.scope is whole else ()
        for joints in scopes:
            for size, odds in _scored(hypothesis, equation, joints):
                corrected = functools.partial(hypothesis.undo, equation, joints, size)
                yield Candidate(hypothesis, joints, size, odds - hypothesis.against, corrected)


def _scored(hypothesis, equation, joints):
    """Sizes of a restatement, and how much likelier it makes the log."""
    if hypothesis.evidence is not None:
        yield from hypothesis.evidence(equation, joints)
        return
    sizes = hypothesis.suggested or (lambda equation, joints: hypothesis.sizes)
    for size in sizes(equation, joints):
        yield size, hypothesis.undo(equation, joints, size).evidence - equation.evidence


@functools.lru_cache(maxsize=4)
def restated(dynamics: Dynamics, record: Record) -> tuple[Cause, ...]:
    """What a record states wrongly, or nothing."""
    return contradictions(TorqueEquation.of(dynamics, record))


def wrong_statements(dynamics: Dynamics, record: Record) -> tuple[str, ...]:
    """A line for each mistake in a record: first those that its checkup calls wrong.

    With an arm the record is examined without them, so that none is reported twice.
    """
    misreadings = misread(record)
    corrected = record.check().corrected if misreadings else record
    return (*misreadings, *(cause.line for cause in restated(dynamics, corrected)))


def of_log(dynamics: Dynamics, log: TorqueLog, band: float) -> tuple[Cause, ...]:
    """The same of positions and torques in a band [Hz]; none where a torque is missing."""
    return contradictions(TorqueEquation.of_band(dynamics, log, band))

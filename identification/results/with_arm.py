"""What can be wrong with an arm, its rig or its log: one row per cause.

A row has the words of its cause, the numbers of the model in which it shows, its test and its fit.
`stepwise` selects among the rows, `Detection` shows what was selected, and `model_error` counts
the tolerances of their numbers. A new cause is a new row here.
"""

import numpy as np

from identification.replay import Number
from identification.results.along_log import (
    CYCLES,
    breakaway,
    cogging,
    drift,
)
from identification.results.alternatives import (
    ArmHypothesis,
    disagreement,
    effect_of_delay,
    elastic,
    lengths,
    likeliest,
    linear,
    playing,
    reversals,
    untested,
    variant,
)
from identification.results.law_torques import cut_off, lead, other_gains, other_variants
from identification.results.refits import in_time, lengthened, moved, played, pushed, sprung
from plant.mechanics import LOAD

STIFF = 300.0  # resonance [Hz] above which a gear is not mentioned; chosen by hand


def _percent(value):
    return 100 * value


def _milliseconds(value):
    return 1e3 * value


def _millimetres(value):
    return 1e3 * value


def _hertz(compliance):
    return compliance**-0.5


def _stiff_left_out(sign):
    """Compliances of gears that are soft: stiff ones are part of the fit, but not of the text."""
    return {name: value for name, value in sign.values.items() if value > STIFF**-2}


def _widths(sign):
    """Widths of backlash: its trial has the compliance of the gear as well."""
    return {name: value for name, value in sign.values.items() if name.startswith("backlash")}


def _amplitudes(sign):
    """Amplitudes of cogging, from the pairs ``cogging.6cos[i]`` and ``cogging.6sin[i]``."""
    sizes, visible = {}, {}
    # A log may tell one of a pair alone.
    for name, value in sign.values.items():
        pair = name.replace("sin", "cos")
        sizes[pair] = float(np.hypot(value, sizes.get(pair, 0.0)))
        visible.setdefault(pair, sign.visible[name])
    # A motor below the detectable amplitude is noise, unless all are.
    return {name: size for name, size in sizes.items() if size > visible[name]} or sizes


def _masses(sign):
    """Mass of a load, without its moments."""
    return {name: value for name, value in sign.values.items() if name.endswith("mass")}


def _load(hypothesis, point):
    """A load at the end of the arm in one record beside the others: its standard parameters.

    Whatever it weighs is a change of f in that record alone, and is linear.
    """
    at = point.at
    dynamics = at.model.dynamics
    records = at.model.runs()
    varied = [at.model.unknown[i] for i in np.flatnonzero(at.step)]
    if len(records) < 2 or not set(dynamics.names) <= set(varied):
        return
    rows = [varied.index(name) for name in dynamics.names]
    steps = at.step[np.flatnonzero(at.step)[rows]]
    # Per kg, and per kg at a lever of a tenth of a metre: mass, first moments, inertias.
    units = {"mass": 1.0} | dict.fromkeys("xyz", 0.1) | dict.fromkeys(LOAD[4:], 0.01)
    of_load = dynamics.load_matrix() * [*units.values()]
    signs = []
    for k, record in enumerate(records):
        effects = np.zeros((len(units), len(at.innovations)))
        effects[:, record] = (of_load / steps[:, None]).T @ at.rates[rows, record]
        named = {
            f"load.{k}{name}": effect
            for name, effect in zip(units, effects, strict=True)
            if effect.any()
        }
        signs += linear(hypothesis, point, named, len(records))
    # Less of it in one record is more of it in the others.
    heavier = [sign for sign in signs if min(_masses(sign).values(), default=0.0) > 0]
    yield from sorted(heavier, key=lambda sign: -sign.chi_square)[:1]


def _torque(torque, speed):
    return torque


def _torque_per_speed(torque, speed):
    return torque / speed


# The sizes at which effects are taken were chosen by hand: the effects are linear there, and well
# above rounding. So were the spreads: the errors of which users of drives report.
HYPOTHESES = (
    # A rigid model takes the deflection of a gear for inertia. In 1 / Hz^2, zero of a rigid gear;
    # a resonance of 200 Hz stands for all of them.
    ArmHypothesis(
        name="compliance",
        sentence="the joints are elastic: locked-rotor resonance near {each}",
        # As an unknown the stiffness gets an interval, which a score test does not give.
        remedy="Give the drive an Elasticity, and identify its stiffness too",
        telling="a motion with faster reversals shows the springs, a slow one the rest",
        biased=True,
        title="compliance",
        each="{size:.0f} {unit} at {joint}",
        unit="Hz",
        convert=_hertz,
        falling=True,
        shown=_stiff_left_out,
        numbers=(
            Number(
                name="compliance", place="drive.elasticity.stiffness", gives=True, step=200.0**-2
            ),
        ),
        test=elastic,
        refit=sprung,
        spread=60.0**-2,
    ),
    # In rad, and without a slope: widths are tried.
    ArmHypothesis(
        name="backlash",
        sentence="the gear of {joint} has backlash, about {size:.1g} {unit}: where its"
        " load changes sign, that is the model's accuracy floor",
        title="backlash",
        unit="degrees",
        convert=np.rad2deg,
        of_slides=("mm", _millimetres),
        # No step: within its teeth a gear does not feel how wide they are apart.
        numbers=(Number(name="backlash", place="drive.elasticity.backlash", gives=True),),
        gears=True,
        shown=_widths,
        test=playing,
        refit=played,
    ),
    # All friction is one cause; the text lists its numbers. Motor side [N m s/rad, N m].
    ArmHypothesis(
        name="friction",
        sentence="friction is not the rig's: {each}",
        remedy="Add these numbers to unknown (drive.viscous[0] and so on)",
        telling="log slower and faster motion as well",
        title="other friction",
        each="{kind} of {joint} {total:.3g} {per}, stated {stated:.3g}",
        between="; ",
        unit="%",
        convert=_percent,
        numbers=(
            Number(
                name="viscous",
                place="drive.viscous",
                removable=True,
                step=0.01,
                scale=_torque_per_speed,
                tolerance="friction",
                unit="N m s/rad",
            ),
            Number(
                name="coulomb",
                place="drive.coulomb",
                removable=True,
                step=0.01,
                scale=_torque,
                tolerance="friction",
                unit="N m",
            ),
        ),
        signed=True,
        shares=True,
        refit=moved,
        spread=0.3,
    ),
    ArmHypothesis(
        name="offset",
        sentence="torques have an offset that the rig lacks, {each}, motor side",
        remedy="Give the drive a FrictionCurve(offset=0 of each joint), and add"
        " drive.curve.offset[0] and so on to unknown",
        telling="log the same motion in both directions",
        biased=True,
        title="an offset of the torque",
        each="{size:.3g} {unit} at {joint}",
        unit="N m",
        numbers=(
            Number(
                name="offset",
                place="drive.curve.offset",
                least=-np.inf,
                step=0.01,
                scale=_torque,
                tolerance="offset",
            ),
        ),
        signed=True,
        refit=moved,
        spread=0.1,
    ),
    # Wrong lengths and counts per turn scale a motion as a wrong gear does.
    ArmHypothesis(
        name="gear",
        sentence="gears (or lengths, or counts per turn) are not the rig's: {each}",
        remedy="Check them, or add drive.gear[0] and so on to unknown",
        # A log hardly tells a gear from a length, so the measurement is one of the machine.
        telling="turn the motor by whole turns, and measure the joint",
        biased=True,
        title="another gear",
        unit="%",
        convert=_percent,
        # A share, since gears of one arm differ by an order of magnitude, their errors do not.
        numbers=(Number.share("gear", "drive.gear", tolerance="gear"),),
        signed=True,
        refit=moved,
        spread=0.05,
    ),
    # Under a law it acts where the amplifier limits the torque alone, and f takes over what it does
    # to logged currents: a test would find either.
    ArmHypothesis(
        name="motor gain",
        numbers=(Number.share("motor_gain", "drive.motor_gain"),),
        test=untested,
    ),
    # Torques that are all too large by one share show as other friction. A gain acts on both kinds
    # of friction of its joint, so it explains them with half as many numbers.
    ArmHypothesis(
        name="gain",
        sentence="friction is not the rig's, or gains of law or motor are not: gains {each} and the"
        " stated friction explain the log",
        remedy="Check the gains first; where they are right, add drive.viscous[0],"
        " drive.coulomb[0] and so on to unknown",
        telling="block a motor at a known error: its torque is the gain times the error",
        biased=True,
        title="other gains",
        unit="%",
        convert=_percent,
        # Of a law without memory.
        numbers=(Number.share("law", "law", of_joints=False),),
        signed=True,
        minor="friction",
        refit=moved,
        spread=0.3,
    ),
    # Of a law with memory, whose torque follows from the log alone.
    ArmHypothesis(
        name="law gain",
        sentence="gains of the law that made the log are not the stated ones: {each}",
        remedy="Check them",
        telling="log the torque as well, which shows the law without a model of the arm",
        biased=True,
        title="other gains",
        each="{variant} {size:+.2g} {unit}{where}",
        unit="%",
        convert=_percent,
        torques=other_gains,
        prefix="controller",
        signed=True,
        test=likeliest,
        refit=pushed,
        spread=0.3,
        # Backlash looks like a smaller derivative: a gain of 20 in a log of ``causes.py``, where
        # gains that are 15 to 40 % off have 60 and more.
        against=20.0,
    ),
    # The time constant of the currents [s].
    ArmHypothesis(
        name="lag",
        sentence="torques lag behind commands by {each}",
        # Not as an unknown: a lag of the currents and late counts are nearly one effect.
        remedy="Give the drive current_lag, and compare",
        telling="log the current beside the command",
        title="lag",
        each="{size:.2g} {unit}",
        unit="ms",
        convert=_milliseconds,
        numbers=(
            Number(
                name="lag",
                place="drive.current_lag.time",
                of_joints=False,
                step=1e-5,
                tolerance="lag",
            ),
        ),
        timing=True,
        refit=moved,
        spread=1e-3,
    ),
    ArmHypothesis(
        name="delay",
        sentence="the counts are {each}",
        # The log is shifted, not the model, whose samples are whole.
        remedy="Identify without_delay(record, {value:.2g}) and compare",
        telling="log the torque as well, whose timing shows without it",
        biased=True,
        title="delay",
        each="{distance:.2g} {unit} {late}",
        unit="samples",
        numbers=(Number(name="delay", place="", of_joints=False, tolerance="delay"),),
        effect=effect_of_delay,
        signed=True,
        timing=True,
        refit=in_time,
        spread=0.5,
    ),
    # Its torque is known along the log but for the size, so it is stated, not identified.
    ArmHypothesis(
        name="cogging",
        sentence="motors cog: {each}, motor side",
        remedy="Give the drive a TorqueRipple of that",
        title="cogging",
        each="{size:.2g} {unit}, {cycles} times per turn, at {joint}",
        unit="N m",
        torques=cogging,
        shown=_amplitudes,
        signed=True,
        # The cycles are the best of so many in this log, which makes a hit by chance likelier.
        choices=CYCLES,
        # A tenth of a constant torque's tolerance: at 0.1 % of the motor's torque no value of the
        # PUMA moved by a deviation, and right logs of MuJoCo have had up to 0.04 %.
        minor="offset",
        minor_share=0.1,
        refit=pushed,
        spread=0.05,
        scale=_torque,
    ),
    # A derivative in the law advances its torque by the ratio of the gains.
    ArmHypothesis(
        name="lead",
        sentence="the stated law lacks the rate of its error: torques lead by {each}",
        remedy="Check the law; a PD has such a lead, its derivative per gain",
        telling="log the torque as well, which shows the law without a model of the arm",
        biased=True,
        title="a derivative in the law",
        each="{size:.2g} {unit} at {joint}",
        unit="ms",
        convert=_milliseconds,
        torques=lead,
        # A shorter lead is the difference between two ways to hold a torque.
        least_samples=0.5,
        refit=pushed,
        spread=5e-3,
    ),
    ArmHypothesis(
        name="limit",
        sentence="torques are cut off at {each}",
        remedy="State the drive's current_limit, or leave these samples out",
        telling="log the current, which shows its limit",
        biased=True,
        title="a limit of the torque",
        each="{variant} of the largest that the law commands, at {joint}",
        unit="% of its effect",
        convert=_percent,
        torques=cut_off,
        test=likeliest,
        refit=pushed,
        spread=1.0,
    ),
    # Of the laws that read their log, so that the counts alone tell which one made it.
    ArmHypothesis(
        name="variant",
        sentence="the stated law is another variant: with {each} its torques explain the motion",
        remedy="State the law with {each}",
        telling="log the torque as well, which shows the law without a model of the arm",
        biased=True,
        title="another variant of the law",
        each="{variant}",
        unit="%",
        convert=_percent,
        torques=other_variants,
        signed=True,
        test=variant,
        refit=pushed,
        spread=1.0,
    ),
    # Of warming gears. Of one size for each joint, since viscous and dry friction change together.
    ArmHypothesis(
        name="drift",
        sentence="friction is changing along the log: from its beginning to its end by {each} of"
        " the stated one",
        # A FrictionDrift is stated: no log shows how friction goes on after it.
        remedy="Log a warm robot, cut the log, or give the drive a FrictionDrift",
        telling="log the same motion twice",
        title="changing friction",
        unit="%",
        convert=_percent,
        torques=drift,
        signed=True,
        refit=pushed,
        spread=0.3,
        # What coarse steps of a hunting loop leave looks like it: a gain of 13 where the rig is
        # right, and of 110 and more where friction drifts (``intervals.py``, ``causes.py``).
        against=20.0,
    ),
    # Of a size for each joint, beside the stated Coulomb friction.
    ArmHypothesis(
        name="breakaway",
        sentence="friction is not the rig's: towards standstill it rises, by {each} of its"
        " Coulomb friction",
        remedy="Give the drive a FrictionCurve with this breakaway and speed, and add"
        " drive.curve.breakaway[0], drive.curve.speed[0] and so on to unknown",
        telling="log a motion with slow reversals",
        title="a Stribeck effect",
        each="{size:.0f} {unit} below about {variant} rad/s of the motor at {joint}",
        unit="%",
        convert=_percent,
        torques=breakaway,
        minor="friction",
        refit=pushed,
        spread=0.3,
        # As of a drift: coarse steps leave something like it where joints turn back.
        against=20.0,
    ),
    # Not fitted: of wide backlash only the instants are known at which it acts.
    ArmHypothesis(
        name="reversals",
        sentence="the model fails where the load of {each} changes sign: squared innovations are"
        " {value:.2g} times those elsewhere",
        remedy="Its gear has backlash, wider than the model of it tells",
        each="{joint}",
        test=reversals,
    ),
    # Not fitted, as the next one: no single model has the difference of the records.
    ArmHypothesis(
        name="load",
        sentence="the records contradict each other: {each}, beside the others",
        remedy="Identify those of one load, and weigh it with find_load. {mean}",
        each="records[{cycles}] has a load at its end",
        telling="weigh the load",
        # Its mass is that of a linear estimate, far from the load that find_load weighs.
        shown=_masses,
        signed=True,
        test=_load,
        spread=2.0,
    ),
    ArmHypothesis(
        name="disagreement",
        sentence="the records contradict each other: each alone has other values (chi-square"
        " {chi_square:.0f} of {freedom} degrees of freedom). The"
        " model lacks something, or the robot has changed (friction; a load, which find_load"
        " weighs)",
        remedy="{mean}",
        test=disagreement,
    ),
    ArmHypothesis(
        name="length",
        sentence="the arm's lengths are not the chain's: {each}",
        remedy="Measure them, and correct the chain",
        telling="measure them",
        biased=True,
        title="another length",
        each="{size:+.2g} {unit} before {joint}",
        unit="%",
        convert=_percent,
        prefix="links",
        signed=True,
        # f takes a length over almost completely, and each length needs a model of its own.
        suspected=True,
        test=lengths,
        refit=lengthened,
        spread=0.2,
    ),
)

OF_RECORDS = {"load", "disagreement"}
"""Causes of which each record is fitted alone."""

BY_NAME = {hypothesis.name: hypothesis for hypothesis in HYPOTHESES}

NUMBERS = tuple(number for hypothesis in HYPOTHESES for number in hypothesis.numbers)

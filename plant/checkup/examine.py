"""The checkup of a record: what its rig and law state against what its columns show.

It needs no model of the arm.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from plant.checkup.corrections import tried
from plant.checkup.counts import counts_findings
from plant.checkup.finding import Check, Checkup, Finding, unless
from plant.checkup.lost_rows import MOST, all_bridged, lost_rows, repeats_bridged
from plant.checkup.oscillation import oscillation_findings
from plant.checkup.quantisation import comb, count_unit_findings, quantisation_findings
from plant.checkup.rounding import rounding_findings
from plant.checkup.signals import Signals
from plant.checkup.stamps import lost_findings, time_findings
from plant.checkup.tracking import correlation, law_fit, reference_findings
from plant.checkup.wiring import wiring_findings


# -- torque: saturation, clipping, backlash -------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class TorqueSettings:
    """Limits of the checks of saturation, clipped torque and backlash, chosen by hand.

    ``tests/plant/checkup/test_examine.py`` holds them against twenty right logs and spoiled ones.

    Parameters
    ----------
    at_limit : float
        Share of the amplifier's limit from which on it is saturated.
    saturated, lost : float
        Samples [%] to look at, and above which the log shows the limit alone; of clipped torque,
        too.
    beyond : float
        Commanded torque [largest logged torque] that was cut off.
    alike : float
        Difference of logged and commanded torque [range] up to which they agree.
    piled : float
        Frequency of an extreme [mean frequency of the next three levels] that is clipped.
    clipped : float
        Clipped samples [%] to look at.
    certain : float
        Standard deviations from which on an inertia is significant.
    reversals : int
        Reversals of the load that an estimate of the backlash needs.
    backlash : float
        Significant backlash [least counts].
    backlash_certain : float
        The same in standard deviations.
    """

    at_limit: float = 0.999
    saturated: float = 1.0
    lost: float = 50.0
    beyond: float = 1.05
    alike: float = 0.01
    piled: float = 4.0
    clipped: float = 0.5
    certain: float = 5.0
    reversals: int = 6
    backlash: float = 0.5
    backlash_certain: float = 3.5


SETTINGS = TorqueSettings()

# Fewer samples with weight have no statistics: only their times are checked. Chosen by hand.
_LEAST_SAMPLES = 50


def _of_torque(name, check):
    """A check of torque or current, joint by joint."""
    return lambda signals: unless(signals.no_torque, (name,), signals.per_joint(check))


def _saturated(signals, i):
    """Share of samples at the amplifier's limit [%]."""
    check = Check("saturation", i, "%")
    limit = signals.rig.drive.current_limit[i]
    # An infinite limit means that the rig states none.
    if not np.isfinite(limit):
        return check.unknown("no current limit stated")
    current = signals.motor_torque[:, i] / signals.rig.drive.motor_gain[i]
    return check.graded(
        100 * np.mean(np.abs(current) >= SETTINGS.at_limit * limit),
        f"The amplifier is at its limit of {limit:g} A: slow the motion down, or lower the gains.",
        look=SETTINGS.saturated,
        wrong=SETTINGS.lost,
    )


def _clipped(signals, i):
    """Share of samples that pile up at an extreme which is not the amplifier's limit [%]."""
    torque = signals.motor_torque[:, i]
    # A clipped torque repeats its largest, or smallest, value.
    levels, frequency = np.unique(torque, return_counts=True)
    clipped = 0
    for extreme, neighbours in ((0, slice(1, 4)), (-1, slice(-4, -1))):
        # Few levels are a coarse sensor; piles at the limit are saturation, a check of its own.
        if len(levels) < 10 or _at_limit(signals, i, levels[extreme]):
            continue
        # The commanded torque shows each clipped sample; without it only the pile does.
        if signals.torque is not None and signals.commanded is not None:
            clipped += _commanded_beyond(signals, i, levels[extreme])
        elif frequency[extreme] > SETTINGS.piled * frequency[neighbours].mean():
            clipped += frequency[extreme]
    # Against the commanded torque a clipped one is plain to see.
    look = SETTINGS.clipped if signals.commanded is None else SETTINGS.clipped / 5
    return Check("clipped torque", i, "%").graded(
        100 * clipped / len(torque),
        f"The torque is cut off at {np.abs(torque).max():.4g} N m (motor), not at the stated"
        " limit of the amplifier: it gives less, or the log's range is too small; leave these"
        " rows out.",
        look=look,
        wrong=SETTINGS.lost,
    )


def _at_limit(signals, i, torque):
    drive = signals.rig.drive
    return bool(np.abs(torque) / drive.motor_gain[i] >= SETTINGS.at_limit * drive.current_limit[i])


def _commanded_beyond(signals, i, extreme):
    """Samples at an extreme of the logged torque that were commanded to be beyond it.

    None where the logged torque differs from the commanded one elsewhere, too.
    """
    torque = signals.torque[:, i]
    commanded = signals.commanded[:, i]
    # Compare where the torque is surely not clipped.
    inside = (torque > torque.min()) & (torque < torque.max())
    difference = np.quantile(np.abs(commanded - torque)[inside], 0.9)
    if difference >= SETTINGS.alike * np.ptp(torque):
        return 0
    beyond = np.abs(commanded) > SETTINGS.beyond * np.abs(extreme)
    return int(np.sum((torque == extreme) & beyond))


def _backlash(signals, i):
    """Motion of the motor alone where the load changes sign [pulses]: at most the backlash."""
    check = Check("backlash", i, "pulses")
    regression = signals.regressions[i]
    if regression is None or regression.inertia[i] < SETTINGS.certain * regression.inertia_std[i]:
        return check.unknown("no acceleration that torque explains")
    # Backlash shows only while the load changes sides.
    if regression.reversals < SETTINGS.reversals:
        return check.unknown(f"the load changes sign {regression.reversals} times")
    backlash = regression.backlash
    std = regression.backlash_std
    least = SETTINGS.backlash * signals.least_count[i]
    certain = SETTINGS.backlash_certain * std
    if backlash > max(least, certain):
        advice = (
            "The motor runs ahead where the load changes sign: the gear has at least this backlash;"
            " expect no better than that from the model there."
        )
        return check.look(backlash, advice)
    # A significant motion backwards is no backlash, but an error of the regression.
    if std > least or (abs(backlash) > certain and backlash < 0):
        return check.unknown(f"known to +-{std:.2g} pulses only", backlash)
    if signals.reference is not None:
        # A stiff loop holds the motor in place while the gear is loose.
        return check.unknown("none seen, but a position loop hides it", backlash)
    return check.fine(backlash)


# -- unit and side of the torque: against law, limit, rotor inertia and stated friction -----------
@dataclass(frozen=True, kw_only=True)
class UnitSettings:
    """Limits of the checks of the torque's unit, chosen by hand.

    ``tests/benchmarks/silent_mistakes.py`` counts the wrong gains and units that are found.

    Parameters
    ----------
    explained : float
        Share of a torque's variance that its law explains.
    other_unit : float
        Factor between torques that means another unit, not noise.
    gain_error : float
        Relative error of a gain to look at; a tenth of it is the noise that may hide it.
    beyond : float
        Share of the amplifier's limit above which the unit is wrong.
    used : float
        Share of the amplifier's limit that a log usually reaches.
    light : float
        Least possible torque per acceleration [rotor inertias].
    usual : float
        That of a usual arm [rotor inertias].
    heavy, absurd : float
        That to look at, and above which it is wrong: no arm is geared so badly [rotor inertias].
    alike : float
        Relative difference of two factors that are one.
    friction_error : float
        Standard deviations by which Coulomb friction must differ by `other_unit`, too.
    """

    explained: float = 0.9
    other_unit: float = 3.0
    gain_error: float = 0.1
    beyond: float = 1.05
    used: float = 0.3
    light: float = 0.5
    usual: float = 3.0
    heavy: float = 300.0
    absurd: float = 3000.0
    alike: float = 0.1
    friction_error: float = 2.0


UNITS = UnitSettings()

_UNITS = "units of torque"


def unit_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about the unit of torque."""
    yield from unless(signals.no_torque, (_UNITS,), signals.per_joint(_units))


def _units(signals, i):
    """Compare the torque with the first of these yardsticks that the record has."""
    check = Check(_UNITS, i, "rotor inertias")
    drive = signals.rig.drive

    # 1. A logged torque cannot exceed the amplifier's limit.
    share = np.abs(signals.motor_torque[:, i]).max() / drive.motor_gain[i] / drive.current_limit[i]
    if share > UNITS.beyond and signals.torque is not None:
        guess = _likely_units(signals, share / UNITS.used, i)
        return Check(_UNITS, i, "of the limit").wrong(
            share, f"The torque is beyond the amplifier: {guess}."
        )

    # 2. The commanded torque is exact where the law explains the logged one.
    fit = law_fit(signals, i)
    if fit is not None and fit.explained > UNITS.explained:
        return _against_law(signals, i, abs(fit.slope))

    # 3. Torque per acceleration lies between the rotor inertia and that of a badly geared arm.
    stated = drive.motor_inertia[i]
    regression = signals.regression(i)
    if regression is None:
        return check.unknown("too little motion, and no law that tells the torque")
    if abs(regression.inertia[i]) < SETTINGS.certain * regression.inertia_std[i]:
        return check.unknown(
            "no acceleration that torque explains, and no law that tells the torque"
        )
    inertia = abs(regression.inertia[i]) / stated if stated else np.nan
    friction = None
    # Noise makes the sign of the speed change at random, which hides the friction.
    if signals.noise[i] <= signals.least_count[i]:
        friction = _friction_ratio(regression, drive.coulomb[i])
    if inertia < UNITS.light or inertia > UNITS.heavy:
        return _against_rotor(signals, i, inertia, friction)

    # 4. Coulomb friction as stated; a look, since the statement is often a guess.
    if friction is not None and not _same_unit(friction):
        guess = _likely_units(signals, friction, i)
        advice = (
            f"Coulomb friction is {friction:.2g} of what the rig states: correct that if it was a"
            f" guess; of the torque, {guess}."
        )
        return Check(_UNITS, i, "of the Coulomb friction").look(friction, advice)
    if not stated:
        return check.unknown("no rotor inertia stated, and no law that tells the torque")
    return check.fine(inertia)


def _same_unit(factor):
    """Whether a factor between two torques is not that of another unit."""
    return 1 / UNITS.other_unit < factor < UNITS.other_unit


def _against_law(signals, i, slope):
    """Judge the logged per commanded torque."""
    check = Check(_UNITS, i, "of the law's")
    advice = f"The torque is {slope:.3g} times the commanded one: "
    if not _same_unit(slope):
        advice += f"{_likely_units(signals, slope, i)}."
        return check.wrong(slope, advice)
    # A small error of the gain counts only where noise cannot cause it.
    noise = UNITS.gain_error / 10
    if abs(slope - 1) > UNITS.gain_error and correlation(signals, i, i) > 1 - noise:
        advice += "check gain, motor gain and gear."
        return check.look(slope, advice)
    return check.fine(slope)


def _against_rotor(signals, i, inertia, friction):
    """An impossible torque per acceleration [rotor inertias]: torque or counts are wrong.

    Friction as stated shows that the torque is right.
    """
    # No motor has less inertia than its rotor.
    light = inertia < UNITS.light
    verdict = "look" if UNITS.heavy < inertia < UNITS.absurd else "wrong"
    size = f"{inertia:.2g} of" if light else f"{inertia:.3g} times"
    # Without a significant friction, torque and counts are both open.
    if friction is None:
        angles = "motor" if light else "joint"
        guess = (
            f"{_likely_units(signals, inertia / UNITS.usual, i)}, or the counts are of angles of"
            f" the {angles}"
        )
    elif _same_unit(friction):
        guess = (
            "friction is as stated, so look at the counts: resolution, and angles of motor or joint"
        )
    else:
        guess = _likely_units(signals, friction, i)
    return Check(_UNITS, i, "rotor inertias").finding(
        inertia, verdict, f"Torque per acceleration is {size} the rotor inertia: {guess}."
    )


def _friction_ratio(regression, stated):
    """Estimated per stated Coulomb friction; None where it is not significant."""
    if not stated:
        return None
    ratio = abs(regression.coulomb) / stated
    error = UNITS.friction_error * regression.coulomb_std / stated
    # Certain enough, or beyond another unit in any case.
    above = ratio - error > UNITS.other_unit
    below = ratio + error < 1 / UNITS.other_unit
    # A ratio of zero has no logarithm in `_likely_units`.
    return max(ratio, 1e-9) if error < ratio / 2 or below or above else None


def _likely_units(signals, ratio, i):
    """The likeliest reasons for a torque of joint i that is so many times too large."""
    gain = np.log(signals.rig.drive.motor_gain[i])
    # The ratio of a torque that is the law's is that of the law, which is the larger one.
    factor = np.log(ratio) if signals.torque is not None else -np.log(ratio)
    # A coarse resolution scales the counts, and so the torque per count.
    step, clear = comb(signals.counts[:, i])
    coarse = clear and step > 1 + UNITS.alike and not signals.rig.encoder.smooth
    if coarse and abs(factor + np.log(step)) < UNITS.alike:
        return f"the counts come in steps of {step:.4g}, so correct the resolution"
    # Gains in A in place of N m differ by the motor gain.
    geared = abs(gain) > UNITS.alike and abs(factor - gain) < UNITS.alike
    if geared and signals.commanded is not None:
        return "the gains of the law may be in A per pulse: multiply them by motor_gain"

    # All reasons whose factor is as near to the ratio as the nearest, to a factor of another unit.
    gear = abs(signals.rig.drive.gear[i])
    reasons = {1e3: "it may be in mN m", 1e-3: "it may be in kN m"}
    if signals.record.torque is None:
        reasons = {1e3: "the current may be in mA", 1e-3: "the current may be in A, not in mA"}
    # A gear of 1000 replaces the unit of the same factor.
    reasons[gear] = "it may have crossed the gear twice"
    reasons[1 / gear] = "it may be the motor's torque, not the joint's"
    # Distances in logarithms: half as much is as far as twice as much.
    distance = {reason: abs(np.log(ratio / factor)) for factor, reason in reasons.items()}
    limit = min(distance.values()) + np.log(UNITS.other_unit)
    likely = [reason for reason in distance if distance[reason] < limit]
    return ", or ".join(sorted(likely, key=distance.__getitem__))


# -- the checkup ----------------------------------------------------------------------------------
# Checks of a log whose lost rows are bridged. What others take for noise, saturation or a delay
# comes first, since the first finding is the first to be corrected.
_CHECKS = (
    _of_torque("clipped torque", _clipped),
    oscillation_findings,
    quantisation_findings,
    rounding_findings,
    reference_findings,
    wiring_findings,
    unit_findings,
    _of_torque("saturation", _saturated),
    _of_torque("backlash", _backlash),
)


def examine(record) -> Checkup:
    """Check a record for errors; ``record.check()`` does."""
    labels = tuple(Signals(record).joint_labels)
    # Too short for corrections, which compare statistics.
    if (record.valid > 0).sum() < _LEAST_SAMPLES:
        return Checkup(findings=tuple(_findings(record)), joint_labels=labels, record=record)

    # A law that was made for another rig gives no torque: the other checks do without it.
    misfit = tuple[Finding, ...]()
    checked = record
    try:
        if record.law is not None:
            record.law.block(record.rig)
    except ValueError as error:
        advice = f"The record's law does not fit its rig: {error}"
        misfit = (Check("law").wrong(None, advice),)
        checked = replace(record, law=None)
    findings, corrected = tried(checked, _findings)
    corrected = record if corrected is checked else replace(corrected, law=record.law)
    return Checkup(findings=(*misfit, *findings), joint_labels=labels, record=corrected)


def _findings(record):
    """All findings about a record as it is."""
    signals = Signals(record)
    findings = list(time_findings(signals))
    if len(signals.t) < _LEAST_SAMPLES:
        return [
            *findings,
            Check("counts, torque").unknown(f"only {len(signals.t)} samples have weight"),
        ]
    # With most rows lost all other checks would judge invented rows.
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        return [*findings, *lost_findings(signals, lost)]
    findings += count_unit_findings(signals)
    findings += lost_findings(signals, lost)
    # Glitches and jumps are findings of their own, so they are bridged for the later checks only.
    findings += counts_findings(signals, Signals(repeats_bridged(record, lost)))
    bridged = Signals(all_bridged(record, lost))
    for check in _CHECKS:
        findings += check(bridged)
    return findings

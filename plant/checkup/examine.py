"""The checkup of a record: what its rig and law state against what its columns show.

It needs no model of the arm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from plant.checkup.counts import counts_findings
from plant.checkup.finding import Check, Checkup, Finding, unless
from plant.checkup.hypothesis import (
    Hypothesis,
    Ranking,
    SelectionSettings,
    ranking,
    require_rows,
)
from plant.checkup.law_motion import runs_away
from plant.checkup.lost_rows import MOST, all_bridged, lost_rows, repeats_bridged
from plant.checkup.oscillation import oscillation_findings
from plant.checkup.quantisation import count_unit_findings, noisy, quantisation_findings
from plant.checkup.rounding import rounding_findings
from plant.checkup.score import Experiment
from plant.checkup.signals import Signals
from plant.checkup.stamps import lost_findings, time_findings
from plant.checkup.trials import Trials
from plant.checkup.views import AT_LIMIT, cause_findings, copied_columns, measured_findings
from plant.checkup.without_arm import SWITCHES, TABLE
from plant.parts import one_thread


# -- torque: saturation, clipping, backlash -------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class TorqueSettings:
    """Limits of the checks of saturation, clipped torque and backlash, chosen by hand.

    ``tests/plant/checkup/test_examine.py`` holds them against twenty right logs and spoiled ones.

    Parameters
    ----------
    lost : float
        Clipped samples [%] above which the log shows the limit alone.
    beyond : float
        Commanded torque [extreme of the logged torque] above which a sample counts as cut off.
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
    backlash_angle : float
        The same [rad, or m of a joint that slides]: gears "without backlash" state half an arc
        minute, 1.5e-4 rad; right logs of fine encoders reach 6e-5.
    backlash_certain : float
        The same in standard deviations.
    """

    lost: float = 50.0
    beyond: float = 1.05
    alike: float = 0.01
    piled: float = 4.0
    clipped: float = 0.5
    certain: float = 5.0
    reversals: int = 6
    backlash: float = 0.5
    backlash_angle: float = 1e-4
    backlash_certain: float = 3.5


SETTINGS = TorqueSettings()

# Fewer samples with weight have no statistics: only their times are checked. Chosen by hand.
_LEAST_SAMPLES = 50


def _of_torque(name, check):
    """A check of torque or current, joint by joint."""
    return lambda signals: unless(signals.no_torque, (name,), signals.per_joint(check))


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
    return bool(np.abs(torque) / drive.motor_gain[i] >= AT_LIMIT * drive.current_limit[i])


def _commanded_beyond(signals, i, extreme):
    """Samples at an extreme of the logged torque that were commanded to be beyond it.

    The number is 0 if the logged and commanded torques differ at the other samples, too.
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
    """Check the motor's motion without the load where the load changes sign [pulses].

    This motion is a lower bound of the backlash.
    """
    check = Check("backlash", i, "pulses")
    regression = signals.regressions[i]
    if regression is None or regression.inertia[i] < SETTINGS.certain * regression.inertia_std[i]:
        return check.unknown("no acceleration that torque explains")
    # Backlash shows only while the load changes sides.
    if regression.reversals < SETTINGS.reversals:
        return check.unknown(f"the load changes sign {regression.reversals} times")
    backlash = regression.backlash
    std = regression.backlash_std
    # Counts of a fine encoder show more than gears have.
    angle = abs(float(signals.rig.to_angle(np.eye(signals.n))[i, i]))
    least = max(SETTINGS.backlash * signals.least_count[i], SETTINGS.backlash_angle / angle)
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
        return check.unknown("no clear sign, but a position loop hides it", backlash)
    return check.fine(backlash)


# -- the checkup ----------------------------------------------------------------------------------
# A correction that rounds the counts again leaves a few per cent of the cause's evidence behind.
# Correct logs of two pendulums reach odds of 3 to 1; a threshold of 20 to 1 accuses none of them.
SELECTION = SelectionSettings(traces=0.06, accepted=3.0)

# Spoiled counts give evidence for any change, but less than an actual exchange of columns gives.
SPOILED = SelectionSettings(traces=0.06, accepted=100.0)

# Checks of a log with bridged lost rows. The user corrects the first finding first, so a fault that
# later checks mistake for noise, saturation or a delay comes first. A cause comes before its
# effects: backlash makes loops swing.
_BEFORE = (
    _of_torque("clipped torque", _clipped),
    _of_torque("backlash", _backlash),
    oscillation_findings,
    quantisation_findings,
)


@one_thread
def examine(record, hypotheses: Sequence[Hypothesis[Any]] = ()) -> Checkup:
    """Check a record for errors; ``record.check()`` calls this function.

    `hypotheses`: the user's own rows, tried in addition to those of `without_arm`.
    """
    hypotheses = require_rows(hypotheses)
    labels = tuple(Signals(record).joint_labels)
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
    findings, result = _examined(checked, hypotheses, labels)
    records = tuple(experiment.record for experiment in result.experiments)
    if checked is not record:
        records = record, *(replace(corrected, law=record.law) for corrected in records[1:])
    return Checkup(
        findings=(*misfit, *findings),
        joint_labels=labels,
        causes=result.causes,
        records=records,
        failed=result.failed,
    )


def _examined(record, hypotheses, labels):
    """All findings about a record, and its ranked causes."""
    signals = Signals(record)
    as_it_is = Ranking((), (Experiment(record),))
    findings = list(time_findings(signals))
    if len(signals.t) < _LEAST_SAMPLES:
        few = Check("counts, torque").unknown(f"only {len(signals.t)} samples have weight")
        return [*findings, few], as_it_is
    # With most rows lost all other checks would judge invented rows.
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        return [*findings, *lost_findings(signals, lost)], as_it_is
    # Causes are ranked for counts only, not for angles, and not if a column is a copy of another
    # motor's: no correction mends that.
    copied = list(signals.per_joint(copied_columns))
    result, spoiled, counts = as_it_is, False, list[Finding]()
    bridged = Experiment(all_bridged(record, lost))
    ranked = signals.long_enough and not signals.angular.any()
    # Counts of a motor that is too weak for its load show no mistake of the log.
    if signals.torque is not None:
        ranked &= not runs_away(bridged).any()
    if ranked and all(finding.ok for finding in copied):
        # Counts that jump, stick or are cut off feign delays and scale errors.
        counts = [*counts_findings(signals, Signals(repeats_bridged(record, lost)))]
        # Without a reference, torques in another unit make counts that seem to stick.
        spoils = _SPOILED if signals.reference is not None else _SPOILED[:-1]
        spoiled = noisy(signals) or any(
            finding.check in spoils and not finding.ok for finding in counts
        )
        table = (*(SWITCHES if spoiled else TABLE), *hypotheses)
        result = ranked_causes(record, bridged, table, labels, SPOILED if spoiled else SELECTION)
    causes = list(cause_findings(result))
    if causes:
        causes = _worded(
            causes,
            [
                *time_findings(signals),
                *count_unit_findings(signals),
                *rounding_findings(bridged.signals),
            ],
        )
    caused = {(cause.check, cause.joint) for cause in causes}

    # A fault that a correction removes is already a finding; the corrected log shows all others.
    corrected = result.corrected.record
    # Where nothing is corrected, all that is known of the log stays.
    if corrected is not record:
        signals, lost = Signals(corrected), lost_rows(corrected)
        bridged = Experiment(all_bridged(corrected, lost))
    data = [*time_findings(signals), *count_unit_findings(signals), *lost_findings(signals, lost)]
    # Glitches and jumps are findings of their own, so they are bridged for the later checks only.
    if not counts or (corrected is not record and not spoiled):
        counts = [*counts_findings(signals, Signals(repeats_bridged(corrected, lost)))]
    data += counts
    for check in _BEFORE:
        data += check(bridged.signals)
    if ("rounding", None) not in caused:
        data += rounding_findings(bridged.signals)
    data = [finding for finding in [*data, *copied] if (finding.check, finding.joint) not in caused]
    measured = measured_findings(bridged, caused)
    after = [finding for finding in measured if (finding.check, finding.joint) not in caused]
    # An oscillating loop feigns delays and wrong units, so its finding comes first.
    swings = [finding for finding in data if finding.check == "oscillation" and not finding.ok]
    later = _LATER if not swings else (*_LATER, "delay")
    mended = [cause for cause in causes if cause.check not in later]
    rest = [cause for cause in causes if cause.check in later]
    return [*mended, *data, *rest, *after], result


def _worded(causes, findings):
    """Findings of causes in the words of the check that measures the same, where there is one."""
    measured = {(finding.check, finding.joint): finding for finding in findings if not finding.ok}
    return [measured.get((cause.check, cause.joint), cause) for cause in causes]


# Causes that concern the size of a torque come late: a coarse encoder or a clipped torque looks
# like one of them.
_LATER = "units of torque", "viscous friction"


_SPOILED = "jumps", "clipped counts", "glitches", "stuck encoder"


def ranked_causes(record, bridged, table, labels, settings=SELECTION) -> Ranking[Experiment]:
    """Rank the causes that explain a record better than its own statements, and correct the record.

    `bridged`: the record with its lost rows bridged, as an experiment. The causes are ranked on it.
    """
    trials = Trials(table)
    result = ranking(bridged, trials, labels, settings)
    # Rows are bridged for the evidence only: the record keeps what was logged.
    records = [record]
    for cause, hypothesis in zip(result.causes, result.accepted, strict=False):
        # A parameter of the model is no fault of the record.
        if cause.certain and not hypothesis.parameter:
            records.append(hypothesis.undo(records[-1], cause.joints, cause.size))
        else:
            records.append(records[-1])
    failed = tuple(f"{name}: {reason}" for name, reason in trials.failed.items())
    return Ranking(result.causes, tuple(map(Experiment, records)), failed)

"""The checkup of a record: what its rig and law state against what its columns show, without a
model of the arm.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from plant.checkup.corrections import tried
from plant.checkup.counts import counts_findings
from plant.checkup.finding import Checkup, Finding, unless
from plant.checkup.lost_rows import MOST, all_bridged, lost_rows, repeats_bridged
from plant.checkup.oscillation import oscillation_findings
from plant.checkup.quantisation import count_unit_findings, quantisation_findings
from plant.checkup.rounding import rounding_findings
from plant.checkup.signals import Signals
from plant.checkup.stamps import lost_findings, time_findings
from plant.checkup.tracking import reference_findings
from plant.checkup.units import unit_findings
from plant.checkup.wiring import wiring_findings

# Share of the amplifier's limit from which on it is saturated; and above which the limit is wrong.
_AT_LIMIT = 0.999
_BEYOND = 1.05

# Share of saturated samples [%] to look at, and above which the log shows the limit alone.
_SATURATED = 1.0
_LOST = 50.0

# share of its range by which a torque that is not clipped may differ from the commanded one
_ALIKE = 0.01

# An extreme value is clipped if it is so many times as frequent as the next ones, in so many % of
# the samples.
_PILED = 4.0
_LEAST_PILE = 0.5

_SURE = 5.0  # standard deviations from which on a sign is significant

# Reversals of the load that a log must hold; backlash [pulses], and in standard deviations, that is
# significant.
_REVERSALS = 6
_PLAY = 0.5
_PLAY_SURE = 3.5


def _of_torque(
    name: str, check: Callable[[Any, int], Finding]
) -> Callable[[Signals], Iterator[Finding]]:
    """A check of torque or current, joint by joint."""
    return lambda signals: unless(signals.no_torque, (name,), signals.each(check))


def _saturated(signals, i):
    limit = signals.rig.drive.current_limit[i]
    if not np.isfinite(limit):
        return Finding.unknown("saturation", i, "no current limit stated")
    current = signals.motor_torque[:, i] / signals.rig.drive.motor_gain[i]
    share = 100 * np.mean(np.abs(current) >= _AT_LIMIT * limit)
    advice = (
        f"The amplifier is at its limit of {limit:g} A: slow the motion down, or lower the gains."
    )
    return Finding.graded("saturation", i, share, "%", look=_SATURATED, wrong=_LOST, advice=advice)


def _clipped(signals, i):
    """Share of samples that pile up at an extreme which is not the amplifier's limit [%]."""
    torque = signals.motor_torque[:, i]
    limit = signals.rig.drive.current_limit[i]
    levels, often = np.unique(torque, return_counts=True)
    piled = 0
    for k, inner in ((0, slice(1, 4)), (-1, slice(-4, -1))):
        if (
            len(levels) < 10
            or np.abs(levels[k]) / signals.rig.drive.motor_gain[i] >= _AT_LIMIT * limit
        ):
            continue
        if signals.torque is not None and signals.commanded is not None:
            cut = torque == levels[k]
            commanded = signals.commanded[:, i]
            inside = (torque > levels[0]) & (torque < levels[-1])
            alike = np.quantile(np.abs(commanded - torque)[inside], 0.9) < _ALIKE * np.ptp(torque)
            piled += alike * np.sum(cut & (np.abs(commanded) > _BEYOND * np.abs(levels[k])))
        elif often[k] > _PILED * often[inner].mean():
            piled += often[k]
    # Against the commanded torque a cut one is plain to see.
    least = _LEAST_PILE if signals.commanded is None else _LEAST_PILE / 5
    cut_off = (
        f"cut off at {np.abs(torque).max():.4g} N m (motor), not at the stated limit of the"
        " amplifier"
    )
    advice = (
        f"The torque is {cut_off}: it gives less, or the log's range is too small; leave these rows"
        " out."
    )
    return Finding.graded(
        "clipped torque", i, 100 * piled / len(torque), "%", look=least, wrong=_LOST, advice=advice
    )


def _backlash(signals, i):
    """Motion of the motor alone where the load torque changes sign [pulses]: a lower bound of
    the backlash.
    """
    name = "backlash"
    unit = "pulses"
    regression = signals.regressions[i]
    if regression is None or regression.inertia[i] < _SURE * regression.inertia_std[i]:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    if regression.reversals < _REVERSALS:
        return Finding.unknown(name, i, f"the load changes sign {regression.reversals} times")
    play = regression.backlash
    std = regression.backlash_std
    if play > max(_PLAY * signals.least_count[i], _PLAY_SURE * std):
        why = (
            "The motor runs ahead where the load changes sign: the gear has at least this backlash"
        )
        return Finding.of(
            name, i, play, unit, "look", f"{why}; expect no better than that from the model there."
        )
    if std > _PLAY * signals.least_count[i] or (abs(play) > _PLAY_SURE * std and play < 0):
        return Finding.unknown(name, i, f"known to +-{std:.2g} pulses only", value=play, unit=unit)
    if signals.reference is not None:
        return Finding.unknown(
            name, i, "none seen, but a position loop hides it", value=play, unit=unit
        )
    return Finding.of(name, i, play, unit)


_LEAST = 50  # samples with weight, below which only their times are checked


# Checks of a log whose lost rows are bridged; first what shows as noise, saturation and delay, too.
_PARTS = (
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


def examine(record: Any) -> Checkup:
    """Check a record for errors; ``record.check()`` does."""
    labels = tuple(Signals(record).joint_labels)
    if (record.valid > 0).sum() < _LEAST:
        return Checkup(findings=tuple(_findings(record)), joint_labels=labels, record=record)
    misfit = tuple[Finding, ...]()
    known = record
    try:
        if record.law is not None:
            record.law.block(record.rig)
    except ValueError as error:  # made for another rig: all else is told without it
        misfit = (
            Finding.of(
                "law", None, None, "", "wrong", f"The record's law does not fit its rig: {error}"
            ),
        )
        known = dataclasses.replace(record, law=None)
    findings, corrected = tried(known, _findings)
    corrected = record if corrected is known else dataclasses.replace(corrected, law=record.law)
    return Checkup(findings=(*misfit, *findings), joint_labels=labels, record=corrected)


def _findings(record: Any) -> list[Finding]:
    signals = Signals(record)
    if len(signals.t) < _LEAST:
        few = Finding.unknown("counts, torque", None, f"only {len(signals.t)} samples have weight")
        return [*time_findings(signals), few]
    lost = lost_rows(record)
    if lost.any.mean() > MOST:
        return [*time_findings(signals), *lost_findings(signals, lost)]
    whole = Signals(repeats_bridged(record, lost))
    bridged = Signals(all_bridged(record, lost))
    found = [
        *time_findings(signals),
        *count_unit_findings(signals),
        *lost_findings(signals, lost),
        *counts_findings(signals, whole),
    ]
    return [*found, *(finding for part in _PARTS for finding in part(bridged))]

"""Are the torques a motor's: saturation, clipping, and the play of the gear."""

from __future__ import annotations

import numpy as np

from plant.checkup.finding import Finding

__all__ = ["torque_findings"]

_AT_LIMIT, _BEYOND = 0.999, 1.05
"""Share of the amplifier's limit that counts as being at it; and that no amplifier gives."""

_SATURATED, _LOST = 1.0, 50.0
"""Share of the samples [%] at the limit to look at, and from which on nothing but the limit is measured."""

_ALIKE = 0.01
"""Share of its range by which a torque that is not clipped may differ from its law's."""

_PILED, _LEAST_PILE = 4.0, 0.5
"""An extreme value is clipped if it comes so many times as often as the next ones, in so many % of the samples."""

_SURE = 5.0
"""Standard deviations from which on a sign is believed."""

_REVERSALS, _PLAY, _PLAY_SURE = 6, 0.5, 3.5
"""Changes of the load's side that a log must hold; play [pulses], and in deviations, that can be told from rounding."""


def torque_findings(signals):
    """Yield the findings about torque and current, check by check.

    Parameters
    ----------
    signals : Signals
    """
    if signals.drives is None:
        for name in ("saturation", "clipped torque", "backlash"):
            yield Finding.unknown(name, None, "neither torque nor current, and no law that tells it")
        return
    for check in (_saturated, _clipped, _backlash):
        for i in range(signals.n):
            yield check(signals, i)


def _current(signals, i):
    return signals.drives[:, i] / signals.rig.drive.motor_gain[i]


def _saturated(signals, i):
    limit = signals.rig.drive.current_limit[i]
    if not np.isfinite(limit):
        return Finding.unknown("saturation", i, "no current limit stated")
    share = 100 * np.mean(np.abs(_current(signals, i)) >= _AT_LIMIT * limit)
    return Finding.graded(
        "saturation", i, share, "%", look=_SATURATED, wrong=_LOST,
        advice=f"The amplifier is at its limit of {limit:g} A: slow the motion down, or lower the gains.",
    )  # fmt: skip


def _clipped(signals, i):
    """Share of samples that pile up at an extreme which is not the amplifier's limit [%]."""
    torque, limit = signals.drives[:, i], signals.rig.drive.current_limit[i]
    levels, often = np.unique(torque, return_counts=True)
    piled = 0
    for k, inner in ((0, slice(1, 4)), (-1, slice(-4, -1))):
        if len(levels) < 10 or np.abs(levels[k]) / signals.rig.drive.motor_gain[i] >= _AT_LIMIT * limit:
            continue
        if signals.torque is not None and signals.asked is not None:
            cut, asked = torque == levels[k], signals.asked[:, i]
            alike = np.quantile(np.abs(asked - torque)[~cut], 0.9) < _ALIKE * np.ptp(torque)
            piled += alike * np.sum(cut & (np.abs(asked) > _BEYOND * np.abs(levels[k])))
        elif often[k] > _PILED * often[inner].mean():
            piled += often[k]
    least = _LEAST_PILE if signals.asked is None else _LEAST_PILE / 5  # beside its law's, a cut torque is plain to see
    return Finding.graded(
        "clipped torque", i, 100 * piled / len(torque), "%", look=least, wrong=_LOST,
        advice=f"The torque is cut off at {np.abs(torque).max():.4g} N m (motor), not by the amplifier: "
        "the log's range is too small; leave these rows out.",
    )  # fmt: skip


def _backlash(signals, i):
    """How far the motor runs ahead where the torque on its load changes sign [pulses]; less than the play itself."""
    name, unit = "backlash", "pulses"
    balance = None if signals.balances is None else signals.balances[i]
    if balance is None or balance.inertia[i] < _SURE * balance.inertia_std[i]:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    if balance.reversals < _REVERSALS:
        return Finding.unknown(name, i, f"the load changes sides {balance.reversals} times")
    play, std = balance.play, balance.play_std
    if play > max(_PLAY * signals.grain[i], _PLAY_SURE * std):
        return Finding(
            check=name, joint=i, value=float(play), unit=unit, verdict="look",
            advice="The motor runs ahead where the load changes sides: the gear has play of this and more; expect no "
            "better than that from the model there.",
        )  # fmt: skip
    if std > _PLAY * signals.grain[i] or (abs(play) > _PLAY_SURE * std and play < 0):
        return Finding.unknown(name, i, f"known to +-{std:.2g} pulses only", value=play, unit=unit)
    if signals.reference is not None:
        return Finding.unknown(name, i, "none seen, but a position loop hides it", value=play, unit=unit)
    return Finding(check=name, joint=i, value=float(play), unit=unit, verdict="fine")

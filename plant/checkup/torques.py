"""Are the torques a motor's: saturation, clipping, sign, units, swapped joints, backlash."""

from __future__ import annotations

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.tracking import against_law

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

_WEAK = 0.25
"""Share of the largest torque among the motors below which one may just be carried along."""

_EXPLAINED, _CLOSER = 0.9, 0.2
"""Share of a torque that its law explains; and what another joint's leaves of the rest at most, if they are swapped."""

_MINOR = 1.5
"""Products of the inertia matrix across joints may not exceed those of its diagonal; with this margin."""

_REVERSALS, _PLAY, _PLAY_SURE = 6, 0.5, 3.5
"""Changes of the load's side that a log must hold; play [pulses], and in deviations, that can be told from rounding."""

_FACTOR, _GAIN_OFF = 3.0, 0.1
"""Factor between torques that is no matter of noise, but of units; departure of a gain that is worth a look."""

_USED = 0.3
"""Share of the amplifier's limit that a log uses."""

_LIGHT, _USUAL = 0.5, 3.0
"""Share of the motor's stated inertia that torque per acceleration must reach; and what an arm makes of it."""


def torque_findings(signals):
    """Yield the findings about torque and current, check by check.

    Parameters
    ----------
    signals : Signals
    """
    names = ("saturation", "clipped torque", "drive sign", "swapped torques", "units of torque", "backlash")
    if signals.drives is None:
        for name in names:
            yield Finding.unknown(name, None, "neither torque nor current, and no law that tells it")
        return
    for check in (_saturated, _clipped, _sign, _swapped, _units, _backlash):
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


def _law(signals, i):
    """Slope and explained share of the logged torque against its law; None where the record does not allow it."""
    if signals.asked is None or signals.torque is None or not signals.long_enough:
        return None
    slope, _, _, explained = against_law(signals, i, i)
    return slope, explained


def _likeness(signals, i, j):
    """Squared correlation of the logged torque of motor i with what the law asked of motor j."""
    logged, asked = signals.torque[:, i], signals.asked[:, j]
    if not (np.ptp(logged) and np.ptp(asked)):
        return 0.0
    return float(np.corrcoef(logged, asked)[0, 1] ** 2)


def _sign(signals, i):
    name, unit = "drive sign", "kg m^2"
    law, balance = _law(signals, i), None if signals.balances is None else signals.balances[i]
    if law is not None and law[0] < -1 / _FACTOR and law[1] > _EXPLAINED:
        return Finding(
            check=name, joint=i, value=float(law[0]), unit="of the law's", verdict="wrong",
            advice="The torque is the opposite of what the law asks: change the sign of the torque, or of the error "
            "(reference minus counted).",
        )  # fmt: skip
    if balance is None:
        return Finding.unknown(name, i, "too little motion")
    against = signals.run[i] < 0  # the counts are known to be upside down, which says nothing of the torque
    if against and signals.torque is None:
        return Finding.unknown(name, i, "the counts run against the reference")
    side = -1 if against else 1
    inertia, std = side * balance.inertia[i], balance.inertia_std[i]
    size, stated = np.std(signals.drives, axis=0), signals.rig.drive.motor_inertia[i]
    if abs(inertia) + _SURE * std < _LIGHT * stated:
        return Finding.unknown(name, i, "the torque is in other units", value=inertia, unit=unit)
    if inertia < -_SURE * std and law is None and size[i] < _WEAK * size.max():
        verdict, advice = "look", "Torque brakes what other joints move: its sign is wrong, or the motor is not driven."
    elif inertia < -_SURE * std:
        verdict, advice = "wrong", "Torque accelerates the counts backwards: change the sign of torque, counts or gear."
    elif _drives(balance, signals.rig.drive.coulomb[i]) and not against:
        verdict, advice = "wrong", "Friction drives the arm: change the sign of the error (reference minus counted)."
    elif inertia < _SURE * std:
        return Finding.unknown(name, i, "no acceleration that torque explains", value=inertia, unit=unit)
    else:
        verdict, advice = "fine", ""
    return Finding(check=name, joint=i, value=float(inertia), unit=unit, verdict=verdict, advice=advice)


def _drives(balance, stated):
    """Whether friction drives the arm: surely, or as much as stated friction should brake it."""
    sure = balance.dry < -_SURE * balance.dry_std
    return sure or (balance.dry < -2 * balance.dry_std and 0.5 * stated < -balance.dry < 1.5 * stated)


def _swapped(signals, i):
    """The joint whose motion the torque belongs to."""
    name, others = "swapped torques", [j for j in range(signals.n) if j != i]
    if not others:
        return Finding.unknown(name, i, "one joint")
    if signals.asked is not None and signals.torque is not None:
        own, found = _likeness(signals, i, i), max(others, key=lambda j: _likeness(signals, i, j))
        if 1 - _likeness(signals, i, found) < _CLOSER * (1 - own) and own < _EXPLAINED:
            return _exchange(name, i, found, 100 * own, "% like its law's")
        return Finding(check=name, joint=i, value=100 * own, unit="% like its law's", verdict="fine")
    if signals.balances is None or any(balance is None for balance in signals.balances):
        return Finding.unknown(name, i, "too little motion")
    M = np.array([balance.inertia for balance in signals.balances])
    sure = np.abs(M) > _SURE * np.array([balance.inertia_std for balance in signals.balances])
    worst = max(others, key=lambda j: M[i, j] * M[j, i] / max(abs(M[i, i] * M[j, j]), 1e-300))
    ratio = M[i, worst] * M[worst, i] / max(abs(M[i, i] * M[worst, worst]), 1e-300)
    if ratio > _MINOR and sure[i, worst] and sure[worst, i]:
        return _exchange(name, i, worst, ratio, "of the diagonal")
    if not sure[i, i]:
        return Finding.unknown(name, i, "no acceleration that torque explains")
    return Finding(check=name, joint=i, value=float(ratio), unit="of the diagonal", verdict="fine")


def _exchange(name, i, j, value, unit):
    advice = f"Torque {i} belongs to the motion of joint {j}: exchange the columns of torque, or of counts."
    return Finding(check=name, joint=i, value=float(value), unit=unit, verdict="wrong", advice=advice)


def _units(signals, i):
    name, drive = "units of torque", signals.rig.drive
    share = np.abs(_current(signals, i)).max() / drive.current_limit[i]
    if share > _BEYOND and signals.torque is not None:
        return Finding(
            check=name, joint=i, value=float(share), unit="of the limit", verdict="wrong",
            advice=f"The torque is beyond the amplifier: {_guess(share / _USED, drive.gear[i])}.",
        )  # fmt: skip
    law = _law(signals, i)
    if law is not None and law[1] > _EXPLAINED:
        slope = abs(law[0])
        verdict = "fine" if 1 / _FACTOR < slope < _FACTOR else "wrong"
        advice = f"The torque is {slope:.3g} times what the law asks: {_guess(slope, drive.gear[i])}."
        if verdict == "fine" and abs(slope - 1) > _GAIN_OFF and _likeness(signals, i, i) > 1 - _GAIN_OFF / 10:
            verdict, advice = "look", f"The torque is {slope:.3g} times what the law asks: check gain and motor gain."
        return Finding(check=name, joint=i, value=float(slope), unit="of the law's", verdict=verdict,
                       advice=advice * (verdict != "fine"))  # fmt: skip
    stated = drive.motor_inertia[i]
    balance = None if signals.balances is None else signals.balances[i]
    if not stated or balance is None or abs(balance.inertia[i]) < _SURE * balance.inertia_std[i]:
        return Finding.unknown(name, i, "no law, and no motor inertia to compare with")
    found = abs(balance.inertia[i]) / stated
    verdict = "wrong" if found < _LIGHT else "fine"
    advice = (
        f"Torque per acceleration is {found:.2g} of the motor's own inertia: {_guess(found / _USUAL, drive.gear[i])}."
    )
    return Finding(check=name, joint=i, value=float(found), unit="motor inertias", verdict=verdict,
                   advice=advice * (verdict != "fine"))  # fmt: skip


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


def _guess(ratio, gear):
    """The likeliest reasons for a wrong factor."""
    reasons = {
        1e3: "it may be in mN m", 1e-3: "it may be in kN m", abs(gear): "it may have crossed the gear twice",
        1 / abs(gear): "it may be the motor's torque, not the joint's",
    }  # fmt: skip
    off = {reason: abs(np.log(ratio / factor)) for factor, reason in reasons.items()}
    near = sorted((reason for reason in off if off[reason] < min(off.values()) + np.log(_FACTOR)), key=off.get)
    return ", or ".join(near)

"""Do torque and motion belong together: copied columns, sign, swapped joints."""

from __future__ import annotations

import numpy as np

from plant.checkup.finding import Finding
from plant.checkup.tracking import law_slope, likeness

__all__ = ["wiring_findings"]

_BACKWARDS = -1 / 3
"""Torque per torque of its law from which on it is the opposite."""

_SURE = 5.0
"""Standard deviations from which on a sign is believed."""

_WEAK = 0.25
"""Share of the largest torque among the motors below which one may just be carried along."""

_EXPLAINED, _CLOSER = 0.9, 0.2
"""Share of a torque that its law explains; and what another joint's leaves of the rest at most, if they are swapped."""

_MINOR = 1.5
"""Products of the inertia matrix across joints may not exceed those of its diagonal; with this margin."""

_LIGHT = 0.5
"""Share of the motor's stated inertia that torque per acceleration must reach."""

_UNEVEN, _EVEN = 4.0, 3.0
"""Deviations from which on two numbers are not the same; and up to which they may be."""


def wiring_findings(signals):
    """Yield the findings about columns, signs and order of counts and torques.

    Parameters
    ----------
    signals : Signals
    """
    for i in range(signals.n):
        yield _copied(signals, i)
    for name, check in (("drive sign", _sign), ("swapped torques", _swapped)):
        if signals.drives is None:
            yield Finding.unknown(name, None, "neither torque nor current, and no law that tells it")
            continue
        for i in range(signals.n):
            yield check(signals, i)


def _copied(signals, i):
    """Whether an earlier joint has the same columns, as they are or as angles."""
    name, others = "copied columns", range(i)
    for j in others:
        for column, same in (("counts", _same_counts), ("torque", _same_torque)):
            if same(signals, j, i):
                return Finding(
                    check=name, joint=i, value=None, unit="", verdict="wrong" if column == "counts" else "look",
                    advice=f"Joints {j} and {i} have the same {column}: one column was mapped to both.",
                )  # fmt: skip
    return Finding(check=name, joint=i, value=None, unit="", verdict="fine")


def _same_counts(signals, i, j):
    turned, reference = signals.counts - signals.counts[0], signals.reference
    angle, pulse = np.abs(signals.rig.to_angle(turned)), np.abs(np.diag(signals.rig.to_angle(np.eye(signals.n))))
    if not turned[:, i].any():
        return False
    if reference is not None:
        asked = np.abs(signals.rig.to_angle(reference - reference[0]))
        if np.abs(asked[:, i] - asked[:, j]).max() <= pulse[i] + pulse[j]:
            return False  # told to do the same, they may
    return bool((turned[:, i] == turned[:, j]).all() or np.abs(angle[:, i] - angle[:, j]).max() <= pulse[i] + pulse[j])


def _same_torque(signals, i, j):
    for table in (signals.record.torque, signals.record.current):
        if table is not None and np.ptp(table[:, i]) and (table[:, i] == table[:, j]).all():
            return True
    return False


def _sign(signals, i):
    name, unit = "drive sign", "kg m^2"
    law, shown = law_slope(signals, i), signals.shown(i)
    if law is not None and law[0] < _BACKWARDS and law[1] > _EXPLAINED:
        return Finding(
            check=name, joint=i, value=float(law[0]), unit="of the law's", verdict="wrong",
            advice="The torque is the opposite of what the law asks: change the sign of the torque, or of the error "
            "(reference minus counted).",
        )  # fmt: skip
    if shown is None:
        return Finding.unknown(name, i, "too little motion")
    against = signals.run[i] < 0  # the counts are known to be upside down, which says nothing of the torque
    if against and signals.torque is None:
        return Finding.unknown(name, i, "the counts run against the reference")
    side = -1 if against else 1
    inertia, std = side * shown.inertia[i], shown.inertia_std[i]
    size, stated = np.std(signals.drives, axis=0), signals.rig.drive.motor_inertia[i]
    if abs(inertia) + _SURE * std < _LIGHT * stated:
        return Finding.unknown(name, i, "the torque is in other units", value=inertia, unit=unit)
    if inertia < -_SURE * std and law is None and size[i] < _WEAK * size.max():
        verdict, advice = "look", "Torque brakes what other joints move: its sign is wrong, or the motor is not driven."
    elif inertia < -_SURE * std:
        order = ", or the order of the columns" if signals.reference is None and signals.n > 1 else ""
        verdict = "wrong"
        advice = f"Torque accelerates the counts backwards: change the sign of torque, counts or gear{order}."
    elif signals.reference is None and shown.dry < -_SURE * shown.dry_std:
        verdict, advice = "look", "Friction drives the motor: its torque has the wrong sign, or is another motor's."
    elif signals.reference is not None and _drives(shown, signals.rig.drive.coulomb[i]) and not against:
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
        own, found = likeness(signals, i, i), max(others, key=lambda j: likeness(signals, i, j))
        if 1 - likeness(signals, i, found) < _CLOSER * (1 - own) and own < _EXPLAINED:
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
    if signals.swings is not None:
        for j in others:
            if _crossed(signals.swings, i, j):
                return _exchange(name, i, j, signals.swings[i].drag[j], "N m of another's friction")
            exchanged = _uneven(signals.swings, i, j)
            if exchanged:
                return _exchange(name, i, j, exchanged, "of the diagonal")
    if not sure[i, i]:
        shown = signals.shown(i)
        if abs(shown.inertia[i]) < _SURE * shown.inertia_std[i]:
            return Finding.unknown(name, i, "no acceleration that torque explains")
        M = np.array([swing.inertia for swing in signals.swings])
        ratio = max(M[i, j] * M[j, i] / abs(M[i, i] * M[j, j]) for j in others)
    return Finding(check=name, joint=i, value=float(ratio), unit="of the diagonal", verdict="fine")


def _crossed(swings, i, j):
    """Whether each of two torques overcomes dry friction when the other motor turns, and not when its own does."""
    return all(
        abs(swings[a].drag[b]) > _SURE * swings[a].drag_std[b]
        and abs(swings[a].drag[a]) + _EVEN * swings[a].drag_std[a] < abs(swings[a].drag[b]) / 2
        for a, b in ((i, j), (j, i))
    )


def _uneven(swings, i, j):
    """Product across over product of the diagonal, if motors i and j make sense exchanged only; otherwise 0.

    An inertia matrix is symmetric and positive definite; with two of its rows or columns exchanged it is neither.
    """
    M = np.array([[swings[a].inertia[b] for b in (i, j)] for a in (i, j)])
    std = np.array([[swings[a].inertia_std[b] for b in (i, j)] for a in (i, j)])
    if (np.abs(M) < _UNEVEN * std).any() or np.linalg.det(M) > 0:
        return 0.0
    as_it_is, exchanged = (
        abs(a[0] - a[1]) / np.hypot(*s)
        for a, s in ((M[[0, 1], [1, 0]], std[[0, 1], [1, 0]]), (np.diag(M), np.diag(std)))
    )
    uneven = as_it_is > _UNEVEN and exchanged < _EVEN
    return M[0, 1] * M[1, 0] / (M[0, 0] * M[1, 1]) if uneven else 0.0


def _exchange(name, i, j, value, unit):
    advice = f"Torque {i} belongs to the motion of joint {j}: exchange the columns of torque, or of counts."
    return Finding(check=name, joint=i, value=float(value), unit=unit, verdict="wrong", advice=advice)

"""Wiring of counts and torques: copied columns, sign of the torque, swapped joints."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from plant.checkup.finding import Finding, unless
from plant.checkup.signals import Signals
from plant.checkup.torque_regression import AveragedRegression
from plant.checkup.tracking import correlation, law_slope

_BACKWARDS = -1 / 3  # logged per commanded torque below which the sign is wrong

_SURE = 5.0  # standard deviations from which on a sign is significant

# Standard deviations from which on one of two columns is named, where one of them is known to be
# reversed.
_LIKELY = 3.0

# share of the largest motor torque below which a motor may just be moved by the others
_WEAK = 0.25

# Share of a torque's variance that its law explains; and of the unexplained share, what another
# joint's law leaves at most if the two are swapped.
_EXPLAINED = 0.9
_CLOSER = 0.2

_MINOR = 1.5  # an inertia matrix has D_ij D_ji < D_ii D_jj; with this margin

_LIGHT = 0.5  # share of the stated rotor inertia that torque per acceleration must reach

# standard deviations from which on two numbers differ; and up to which they may be equal
_UNEVEN = 4.0
_EVEN = 3.0


def wiring_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about columns, signs and order of counts and torques."""
    yield from signals.each(_copied)
    yield from unless(
        signals.no_torque, ("drive sign", "swapped torques"), signals.each(_sign, _swapped)
    )


def _copied(signals, i):
    """Whether an earlier joint has the same columns, as they are or as angles."""
    for j in range(i):
        for column, same in (("counts", _same_counts), ("torque", _same_torque)):
            if same(signals, j, i):
                advice = (
                    f"The same {column} as {signals.joint_labels[j]}: one column was mapped to"
                    " both."
                )
                return Finding.of(
                    "copied columns", i, None, "", "wrong" if column == "counts" else "look", advice
                )
    return Finding.of("copied columns", i, None, "")


def _same_counts(signals, i, j):
    moved = signals.counts - signals.counts[0]
    reference = signals.reference
    angle = np.abs(signals.rig.to_angle(moved))
    pulse = np.abs(np.diag(signals.rig.to_angle(np.eye(signals.n))))
    if not moved[:, i].any():
        return False
    if reference is not None:
        commanded = np.abs(signals.rig.to_angle(reference - reference[0]))
        if np.abs(commanded[:, i] - commanded[:, j]).max() <= pulse[i] + pulse[j]:
            return False  # commanded alike
    return bool(
        (moved[:, i] == moved[:, j]).all()
        or np.abs(angle[:, i] - angle[:, j]).max() <= pulse[i] + pulse[j]
    )


def _same_torque(signals, i, j):
    logged = [
        table for table in (signals.record.torque, signals.record.current) if table is not None
    ]
    return any(np.ptp(table[:, i]) and (table[:, i] == table[:, j]).all() for table in logged)


def _sign(signals, i):
    name = "drive sign"
    unit = "kg m^2"
    law = law_slope(signals, i)
    shown = signals.regression(i)
    if law is not None and law[0] < _BACKWARDS and law[1] > _EXPLAINED:
        advice = (
            f"The torque has the opposite sign of the commanded one{_turned(signals, i, shown)}."
        )
        return Finding.of(name, i, law[0], "of the law's", "wrong", advice)
    if shown is None:
        return Finding.unknown(name, i, "too little motion")
    against = signals.tracking_slope[i] < 0  # a wrong sign of the counts says nothing of the torque
    if against and signals.torque is None:
        return Finding.unknown(name, i, "the counts run against the reference")
    sign = -1 if against else 1
    inertia = sign * shown.inertia[i]
    std = shown.inertia_std[i]
    size = np.std(signals.motor_torque, axis=0)
    stated = signals.rig.drive.motor_inertia[i]
    if abs(inertia) + _SURE * std < _LIGHT * stated:
        return Finding.unknown(name, i, "the torque is in other units", value=inertia, unit=unit)
    if inertia < -_SURE * std and law is None and size[i] < _WEAK * size.max():
        verdict = "look"
        advice = (
            "Torque brakes the motion caused by other joints: its sign is wrong, or the motor is"
            " not driven."
        )
    elif inertia < -_SURE * std:
        torque = signals.column("torque", i)
        counts = signals.column("counts", i)
        order = ", or the order of the columns" if signals.n > 1 else ""
        which = f": change the sign of {torque}, {counts} or gear{order}"
        which = which if signals.reference is None else _turned(signals, i, shown)
        verdict = "wrong"
        advice = f"Torque accelerates the counts backwards{which}."
    elif signals.reference is None and shown.coulomb < -_SURE * shown.coulomb_std:
        torque = signals.column("torque", i)
        verdict = "look"
        advice = f"Friction drives the motor: {torque} has the wrong sign, or is another motor's."
    elif (
        signals.reference is not None
        and _friction_drives(shown, signals.rig.drive.coulomb[i])
        and not against
    ):
        column = _wrong_error(signals, i) if signals.torque is None else torque_column(signals, i)
        verdict = "wrong"
        advice = f"Friction drives the arm: change the sign of {column}."
    elif inertia < _SURE * std:
        return Finding.unknown(
            name, i, "no acceleration that torque explains", value=inertia, unit=unit
        )
    else:
        verdict = "fine"
        advice = ""
    return Finding.of(name, i, inertia, unit, verdict, advice)


def _turned(signals: Signals, i: int, shown: Any) -> str:
    """Which column has the wrong sign where torque and law disagree: friction says whether the
    torque is right.

    The slow motion of the counts is that of the reference, whatever the sign of the error; its
    acceleration is not.
    """
    error = _wrong_error(signals, i)
    if signals.torque is None:
        return f": change the sign of {error}"
    if shown is not None and shown.coulomb < -_LIKELY * shown.coulomb_std:
        return (
            f", and drives against friction's sign: change the sign of {torque_column(signals, i)}"
        )
    if shown is not None and shown.coulomb > _LIKELY * shown.coulomb_std:
        return f", but friction's sign is right: change the sign of {error}"
    return f": change the sign of {signals.column('torque', i)}, or of {error}"


def torque_column(signals: Signals, i: int) -> str:
    """What messages call a torque of joint i with the wrong sign: which side a current is of,
    the gear says.
    """
    return signals.column("torque", i) + ", or of the gear" * (signals.record.torque is None)


def _wrong_error(signals, i):
    return error_column(signals, i) or "the law's gain"


def error_column(signals: Signals, i: int) -> str:
    """What messages call the error of joint i, which may have the wrong sign; "" where it was
    made of counts.
    """
    made = {"counts", "position", "motor_position"} & set(signals.record.columns or ())
    return (
        ""
        if made or signals.reference is None
        else f"{signals.column('error', i)} (reference minus counted)"
    )


def _friction_drives(regression: Any, stated: float) -> bool:
    """Whether friction has the wrong sign: significantly, or with the size of the stated
    friction.
    """
    found = -regression.coulomb
    std = regression.coulomb_std
    return found > _SURE * std or (found > 2 * std and 0.5 * stated < found < 1.5 * stated)


def _swapped(signals, i):
    """Whether the torque belongs to the motion of another joint."""
    name = "swapped torques"
    others = [j for j in range(signals.n) if j != i]
    if not others:
        return Finding.unknown(name, i, "one joint")
    if signals.commanded is not None and signals.torque is not None:
        own = correlation(signals, i, i)
        found = max(others, key=lambda j: correlation(signals, i, j))
        if 1 - correlation(signals, i, found) < _CLOSER * (1 - own) and own < _EXPLAINED:
            return _exchange(signals, i, found, 100 * own, "% like its law's")
        return Finding.of(name, i, 100 * own, "% like its law's")
    if None in signals.regressions:
        return Finding.unknown(name, i, "too little motion")
    M = np.array([regression.inertia for regression in signals.regressions])
    sure = np.abs(M) > _SURE * np.array(
        [regression.inertia_std for regression in signals.regressions]
    )
    worst = max(others, key=lambda j: M[i, j] * M[j, i] / max(abs(M[i, i] * M[j, j]), 1e-300))
    ratio = M[i, worst] * M[worst, i] / max(abs(M[i, i] * M[worst, worst]), 1e-300)
    if ratio > _MINOR and sure[i, worst] and sure[worst, i]:
        return _exchange(signals, i, worst, ratio, "of the diagonal")
    if signals.averaged is not None:
        for j in others:
            if _crossed(signals.averaged, i, j):
                return _exchange(
                    signals, i, j, signals.averaged[i].cross_coulomb[j], "N m of another's friction"
                )
            if exchanged := _uneven(signals.averaged, i, j):
                return _exchange(signals, i, j, exchanged, "of the diagonal")
    if not sure[i, i]:
        shown = signals.regression(i)
        if abs(shown.inertia[i]) < _SURE * shown.inertia_std[i]:
            return Finding.unknown(name, i, "no acceleration that torque explains")
        M = np.array([fit.inertia for fit in signals.averaged])
        ratio = max(M[i, j] * M[j, i] / abs(M[i, i] * M[j, j]) for j in others)
    return Finding.of(name, i, ratio, "of the diagonal")


def _crossed(averaged: Sequence[AveragedRegression], i: int, j: int) -> bool:
    """Whether each of two torques shows the Coulomb friction of the other motor, and not its
    own.
    """
    for a, b in ((i, j), (j, i)):
        size = np.abs(averaged[a].cross_coulomb)
        std = averaged[a].cross_coulomb_std
        if not (size[b] > _SURE * std[b] and size[a] + _EVEN * std[a] < size[b] / 2):
            return False
    return True


def _uneven(averaged: Sequence[AveragedRegression], i: int, j: int) -> float:
    """D_ij D_ji / (D_ii D_jj), if the inertia matrix is one with motors i and j exchanged only;
    otherwise 0.

    An inertia matrix is symmetric and positive definite; with two of its rows or columns exchanged
    it is neither.
    """
    M = np.array([[averaged[a].inertia[b] for b in (i, j)] for a in (i, j)])
    std = np.array([[averaged[a].inertia_std[b] for b in (i, j)] for a in (i, j)])
    if (np.abs(M) < _UNEVEN * std).any() or np.linalg.det(M) > 0:
        return 0.0
    as_it_is = abs(M[0, 1] - M[1, 0]) / np.hypot(std[0, 1], std[1, 0])
    exchanged = abs(M[0, 0] - M[1, 1]) / np.hypot(std[0, 0], std[1, 1])
    uneven = as_it_is > _UNEVEN and exchanged < _EVEN
    return M[0, 1] * M[1, 0] / (M[0, 0] * M[1, 1]) if uneven else 0.0


def _exchange(signals: Signals, i: int, j: int, value: float, unit: str) -> Finding:
    torque = signals.joint_labels[i]
    motion = signals.joint_labels[j]
    advice = (
        f"The torque of {torque} belongs to the motion of {motion}: exchange the columns of torque,"
        " or of counts."
    )
    return Finding.of("swapped torques", i, value, unit, "wrong", advice)

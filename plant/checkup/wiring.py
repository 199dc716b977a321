"""Wiring of counts and torques: copied columns, sign of the torque, swapped joints."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from plant.checkup.finding import Check, Finding, unless
from plant.checkup.signals import LEAST_MOTION, Signals
from plant.checkup.tracking import correlation, law_fit


@dataclass(frozen=True, kw_only=True)
class WiringSettings:
    """Limits of the checks of signs and order of columns, chosen by hand.

    ``tests/plant/checkup/test_examine.py`` holds them against twenty right logs and spoiled ones.

    Parameters
    ----------
    backwards : float
        Slope of logged over commanded torque below which the sign is wrong.
    explained : float
        Share of a torque's variance that its law must explain for the slope to count.
    certain : float
        Standard deviations from which on an inertia, a friction or a product is significant.
    likely : float
        Standard deviations that decide between two columns when one is known to be wrong.
    weak : float
        Share of the largest motor torque below which other joints may just move a motor.
    light : float
        Share of the stated rotor inertia that torque per acceleration must reach.
    closer : float
        A swapped torque's unexplained share under another joint's law, over that under its own.
    minor : float
        D_ij D_ji over D_ii D_jj above which two rows are swapped. In an inertia matrix this ratio
        is below 1; the limit has a margin for errors of the regression.
    uneven, even : float
        Standard deviations from which on two numbers differ, and up to which they may be equal.
    """

    backwards: float = -1 / 3
    explained: float = 0.9
    certain: float = 5.0
    likely: float = 3.0
    weak: float = 0.25
    light: float = 0.5
    closer: float = 0.2
    minor: float = 1.5
    uneven: float = 4.0
    even: float = 3.0


SETTINGS = WiringSettings()


def wiring_findings(signals: Signals) -> Iterator[Finding]:
    """Yield the findings about columns, signs and order of counts and torques."""
    yield from signals.per_joint(_copied)
    names = "drive sign", "swapped torques"
    yield from unless(signals.no_torque, names, signals.per_joint(_drive_sign, _swapped))


def _copied(signals, i):
    """Whether an earlier joint has the same columns, as they are or as angles."""
    check = Check("copied columns", i)
    # Earlier joints only, so that one of the two keeps its column.
    for j in range(i):
        remedy = f"as {signals.joint_labels[j]}: one column was mapped to both."
        if _same_counts(signals, j, i):
            return check.wrong(None, f"The same counts {remedy}")
        if _same_torque(signals, j, i):
            return check.look(None, f"The same torque {remedy}")
    return check.fine()


def _same_counts(signals, i, j):
    """Whether two joints move alike, to a pulse, although their references differ."""
    moved = signals.counts - signals.counts[0]
    # Two joints at rest are alike for another reason.
    if np.ptp(moved[:, i]) < LEAST_MOTION * signals.least_count[i]:
        return False
    pulse = np.abs(np.diag(signals.rig.to_angle(np.eye(signals.n))))

    def alike(pulses):
        # Magnitudes, since the gears of the two joints may have different signs.
        angle = np.abs(signals.rig.to_angle(pulses))
        return bool(np.abs(angle[:, i] - angle[:, j]).max() <= pulse[i] + pulse[j])

    if signals.reference is not None:
        commanded = signals.reference - signals.reference[0]
        if alike(commanded):
            return False
    return bool((moved[:, i] == moved[:, j]).all()) or alike(moved)


def _same_torque(signals, i, j):
    for table in (signals.record.torque, signals.record.current):
        if table is not None and np.ptp(table[:, i]) and (table[:, i] == table[:, j]).all():
            return True
    return False


def _drive_sign(signals, i):
    """Torque per acceleration [kg m^2], which is positive where all signs are right."""
    check = Check("drive sign", i, "kg m^2")
    regression = signals.regression(i)

    # 1. The law gives the sign of the torque, if it explains the torque at all.
    fit = law_fit(signals, i)
    # Its sign is certain, since it needs no acceleration.
    if fit is not None and fit.slope < SETTINGS.backwards and fit.explained > SETTINGS.explained:
        hint, column = _turned_column(signals, i, regression)
        cause = f"The torque has the opposite sign of the commanded one{hint}"
        return Check("drive sign", i, "of the law's").wrong_sign(fit.slope, cause, column)

    # 2. Records that show no sign.
    if regression is None:
        return check.unknown("too little motion")
    # Counts of the wrong sign make the commanded torque wrong, too.
    against = signals.tracking_slope[i] < 0
    if against and signals.torque is None:
        return check.unknown("the counts run against the reference")
    # Counts of the wrong sign show in "gear sign"; they say nothing about the torque.
    inertia = -regression.inertia[i] if against else regression.inertia[i]
    std = regression.inertia_std[i]
    stated = signals.rig.drive.motor_inertia[i]
    if abs(inertia) + SETTINGS.certain * std < SETTINGS.light * stated:
        return check.unknown("the torque is in other units", inertia)

    # 3. A negative inertia.
    if inertia < -SETTINGS.certain * std:
        size = np.std(signals.motor_torque, axis=0)
        # Other joints may move a motor that has hardly any torque of its own.
        if fit is None and size[i] < SETTINGS.weak * size.max():
            advice = (
                "Torque brakes the motion caused by other joints: its sign is wrong, or the motor"
                " is not driven."
            )
            return check.look(inertia, advice)
        hint, column = _turned_column(signals, i, regression)
        if signals.reference is None:
            # Without a reference nothing says which of the columns is wrong.
            order = ", or the order of the columns" if signals.n > 1 else ""
            torque = signals.column("torque", i)
            hint = ""
            column = f"{torque}, {signals.column('counts', i)} or gear{order}"
        cause = f"Torque accelerates the counts backwards{hint}"
        return check.wrong_sign(inertia, cause, column)

    # 4. Negative friction.
    if signals.reference is None:
        if regression.coulomb < -SETTINGS.certain * regression.coulomb_std:
            torque = signals.column("torque", i)
            advice = (
                f"Friction drives the motor: {torque} has the wrong sign, or is another motor's."
            )
            return check.look(inertia, advice)
    elif not against and _friction_drives(regression, signals.rig.drive.coulomb[i]):
        column = torque_column(signals, i)
        if signals.torque is None:
            column = _turned_error(signals, i)
        return check.wrong_sign(inertia, "Friction drives the arm", column)

    if inertia < SETTINGS.certain * std:
        return check.unknown("no acceleration that torque explains", inertia)
    return check.fine(inertia)


def _turned_column(signals, i, regression):
    """A clause about friction for the message, and the column that has the wrong sign.

    Torque and law disagree, so either the torque or the error column has the wrong sign. Friction
    decides: counts computed with a wrong error still follow the reference, so their speed keeps its
    sign and friction its own. Their acceleration, which is mostly error, does not.
    """
    error = _turned_error(signals, i)
    if signals.torque is None:
        return "", error
    torque = torque_column(signals, i)
    if regression is not None:
        least = SETTINGS.likely * regression.coulomb_std
        if regression.coulomb < -least:
            return ", and drives against friction's sign", torque
        if regression.coulomb > least:
            return ", but friction's sign is right", error
    return "", f"{signals.column('torque', i)}, or of {error}"


def torque_column(signals: Signals, i: int) -> str:
    """Name in messages of a torque of joint i with the wrong sign.

    The sign of the gear decides which direction of the joint a current drives.
    """
    name = signals.column("torque", i)
    return name if signals.record.torque is not None else f"{name}, or of the gear"


def _turned_error(signals, i):
    return error_column(signals, i) or "the law's gain"


def error_column(signals: Signals, i: int) -> str:
    """Name in messages of the error of joint i, which may have the wrong sign.

    It is empty where the error was computed from the counts.
    """
    columns = set(signals.record.columns or ())
    computed = {"counts", "position", "motor_position"} & columns
    if computed or signals.reference is None:
        return ""
    return f"{signals.column('error', i)} (reference minus counted)"


def _friction_drives(regression, stated):
    """Whether friction has the wrong sign: significantly, or with the size of the stated one."""
    size = -regression.coulomb
    std = regression.coulomb_std
    # Significant by itself.
    if size > SETTINGS.certain * std:
        return True
    # Less significant, but of the size of the stated friction.
    return bool(size > 2 * std and 0.5 * stated < size < 1.5 * stated)


def _swapped(signals, i):
    """Whether the torque belongs to the motion of another joint."""
    check = Check("swapped torques", i, "of the diagonal")
    partners = [j for j in range(signals.n) if j != i]
    if not partners:
        return check.unknown("one joint")
    # A law that gives the torque is the better evidence.
    if signals.commanded is not None and signals.torque is not None:
        return _swapped_by_law(signals, i, partners)
    if None in signals.regressions:
        return check.unknown("too little motion")

    # 1. An inertia matrix has D_ij D_ji < D_ii D_jj.
    fits = signals.regressions
    # Rows: torques of the motors; columns: accelerations.
    D = np.array([fit.inertia for fit in fits])
    certain = np.abs(D) > SETTINGS.certain * np.array([fit.inertia_std for fit in fits])
    ratio = [D[i, j] * D[j, i] / max(abs(D[i, i] * D[j, j]), 1e-300) for j in range(signals.n)]
    worst = max(partners, key=lambda j: ratio[j])
    if ratio[worst] > SETTINGS.minor and certain[i, worst] and certain[worst, i]:
        return _exchange(signals, i, worst, ratio[worst], "of the diagonal")

    # 2. Friction of another motor; an inertia matrix that is even only with two motors exchanged.
    averaged = signals.averaged
    if averaged is not None:
        for j in partners:
            if _crossed(averaged, i, j):
                friction = averaged[i].cross_coulomb[j]
                return _exchange(signals, i, j, friction, "N m of another's friction")
            exchanged = _uneven(averaged, i, j)
            if exchanged:
                return _exchange(signals, i, j, exchanged, "of the diagonal")
    if certain[i, i]:
        return check.fine(ratio[worst])

    # 3. The averaged inertia of an arm that swings freely.
    regression = signals.regression(i)
    if abs(regression.inertia[i]) < SETTINGS.certain * regression.inertia_std[i]:
        return check.unknown("no acceleration that torque explains")
    D = np.array([fit.inertia for fit in averaged])
    largest = max(D[i, j] * D[j, i] / abs(D[i, i] * D[j, j]) for j in partners)
    return check.fine(largest)


def _swapped_by_law(signals, i, partners):
    """The same by the correlation [%] of logged and commanded torques."""
    alike = correlation(signals, i, i)
    nearest = max(partners, key=lambda j: correlation(signals, i, j))
    # Another joint's law explains clearly more, and the joint's own does not explain the torque.
    closer = 1 - correlation(signals, i, nearest) < SETTINGS.closer * (1 - alike)
    if closer and alike < SETTINGS.explained:
        return _exchange(signals, i, nearest, 100 * alike, "% like its law's")
    return Check("swapped torques", i, "% like its law's").fine(100 * alike)


def _crossed(averaged, i, j):
    """Whether each of two torques has the Coulomb friction of the other motor, not its own."""
    # Both directions: one torque alone may lack its friction.
    for a, b in ((i, j), (j, i)):
        size = np.abs(averaged[a].cross_coulomb)
        std = averaged[a].cross_coulomb_std
        others_friction = size[b] > SETTINGS.certain * std[b]
        if not (others_friction and size[a] + SETTINGS.even * std[a] < size[b] / 2):
            return False
    return True


def _uneven(averaged, i, j):
    """D_ij D_ji / (D_ii D_jj), if D is an inertia matrix only with motors i and j exchanged; or 0.

    An inertia matrix is symmetric and positive definite; with two of its rows or columns exchanged
    it is neither.
    """
    D = np.array([[averaged[a].inertia[b] for b in (i, j)] for a in (i, j)])
    std = np.array([[averaged[a].inertia_std[b] for b in (i, j)] for a in (i, j)])
    # Every entry must be known, and a positive determinant needs no exchange.
    if (np.abs(D) < SETTINGS.uneven * std).any() or np.linalg.det(D) > 0:
        return 0.0
    # Asymmetry in standard deviations, as it is and with the two rows exchanged.
    asymmetry = abs(D[0, 1] - D[1, 0]) / np.hypot(std[0, 1], std[1, 0])
    exchanged_asymmetry = abs(D[0, 0] - D[1, 1]) / np.hypot(std[0, 0], std[1, 1])
    if not (asymmetry > SETTINGS.uneven and exchanged_asymmetry < SETTINGS.even):
        return 0.0
    return float(D[0, 1] * D[1, 0] / (D[0, 0] * D[1, 1]))


def _exchange(signals, i, j, value, unit):
    torque = signals.joint_labels[i]
    motion = signals.joint_labels[j]
    advice = (
        f"The torque of {torque} belongs to the motion of {motion}: exchange the columns of torque,"
        " or of counts."
    )
    return Check("swapped torques", i, unit).wrong(value, advice)

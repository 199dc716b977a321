"""Units of logged columns: checks of the stated units against the rig, and conversion to counts.

A record holds positions in counts, torques on the joints' side of the gear, and currents in ampere.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from plant.machine import SLOWEST, Rig
from plant.motion import Reference, Spline
from plant.parts import Floats, frozen_settings, warn

# Of a field: one unit, or one per joint where some joints turn and others slide.
Unit: TypeAlias = str | tuple[str, ...]

# Number of each unit in a second. Dividing a whole number by it rounds only once.
TIME = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
# radians of each
ANGLE = {
    "rad": 1.0,
    "deg": np.pi / 180,
    "turns": 2 * np.pi,
    "gon": np.pi / 200,
    "mrad": 1e-3,
}
LENGTH = {"m": 1.0, "mm": 1e-3}  # metres of each
CURRENT = {"A": 1.0, "mA": 1e3}
TORQUE = ("N m", "N", "motor N m")
UNITS = {
    "t": tuple(TIME),
    "position": (*ANGLE, *LENGTH, "pulses"),
    "motor_position": (*ANGLE, "pulses"),
    "reference_position": (*ANGLE, *LENGTH, "pulses"),
    "reference_motor_position": tuple(ANGLE),
    "link_position": (*ANGLE, *LENGTH),
    "torque": TORQUE,
    "injected": TORQUE,
    "current": tuple(CURRENT),
    "counts": ("pulses",),
    "error_pulses": ("pulses",),
    "reference_pulses": ("pulses",),
    "temperature": ("degC", "K"),
    "time": tuple(TIME),
}
# Fields of which a record keeps one number, in the first of their units, which is the default.
NOTES = ("temperature", "time")

_PER_JOINT = {*ANGLE, *LENGTH, "N m", "N"}


@frozen_settings
class UnitCheckSettings:
    """Limits beyond which a logged column is in another unit than stated; all chosen by hand.

    Parameters
    ----------
    max_turns : float
        Largest span of a revolute joint [turns]; a larger one suggests an angle in degrees.
    max_metres : float
        Largest span of a prismatic joint [m]; a larger one suggests millimetres.
    period_factor : float
        Largest ratio between the step of t and the rig's period, in either direction.
    limit_factor : float
        Largest torque or current, as a multiple of the amplifier's limit: measured currents
        overshoot it.
    min_motion : float
        Motion [pulses] from which positions on whole pulses are no accident.
    step_tolerance : float
        Distance of the smallest step from one pulse [pulses] within which the stated resolution is
        merely inexact.
    max_normalised : float
        Largest position that may be a percentage of a joint's range; 100, and rounding.
    """

    max_turns: float = 10
    max_metres: float = 50.0
    period_factor: float = 10
    limit_factor: float = 2.0
    min_motion: float = 10
    step_tolerance: float = 0.02
    max_normalised: float = 100.5


@frozen_settings
class PathSettings:
    """Commanded positions that become the path of a record; all chosen by hand.

    Parameters
    ----------
    min_samples, max_samples : int
        Number of samples of such a path.
    max_bend : float
        Largest distance of the spline from the chord, half-way between two samples [pulses]; at a
        step of k nominal intervals k**2 times as much.
    """

    min_samples: int = 12
    max_samples: int = 100_000
    max_bend: float = 0.5


CHECKS = UnitCheckSettings()
PATH = PathSettings()


def factors(unit: Unit) -> float | Floats:
    """Radians or metres of a unit of position, or (n,) of one unit per joint."""
    scale = ANGLE | LENGTH
    return (
        scale[unit]
        if isinstance(unit, str)
        else np.array([scale[joint_unit] for joint_unit in unit])
    )


def require_unit(field: str, units: tuple[str, ...]) -> None:
    """Refuse one unit per joint if any of these units is not a unit of the joints themselves."""
    # Only units of the joints themselves may differ: pulses and motor units are the same for
    # revolute and prismatic joints.
    if not _PER_JOINT.issuperset(units):
        among = ", ".join(repr(unit) for unit in UNITS[field] if unit in _PER_JOINT) or "none"
        raise ValueError(
            f"units of {field!r} may differ between joints among {among}; got {units!r:.60}. State"
            " one."
        )


def require_period(t: Floats, unit: str, period: float) -> None:
    """Refuse times [s] whose step is far from the rig's period."""
    factor = CHECKS.period_factor
    # The median ignores gaps and jitter of the stamps. `Record` refuses times that do not increase,
    # and names the row.
    step = float(np.median(np.diff(t))) if len(t) > 1 else period
    if step <= 0 or period / factor <= step <= period * factor:
        return
    # A period above the slowest plausible one is itself in the wrong unit, so the message blames
    # the rig and not the log.
    if period > SLOWEST:
        got = f"it is {period:g} s, and t steps by {step:g} s"
        raise ValueError(f"rig.period must be in seconds, such as 0.001; {got}.")
    # Offer a unit in which the same stamps would step by about the rig's period.
    fits = [
        name
        for name, per in TIME.items()
        if period / factor <= step * TIME[unit] / per <= period * factor
    ]
    advice = f"{fits[0]!r} would fit." if fits else "Give the rig the log's."
    raise ValueError(
        f"t in {unit!r} has a step of {step:g} s; rig.period is {period:g} s. {advice}"
    )


def require_span(
    name: str,
    q: Floats,
    unit: Unit,
    labels: Sequence[str],
    on_pulses: Callable[[], list[tuple[str, Unit]]],
) -> None:
    """Refuse joint angles [rad] and positions [m] that span more than a joint can.

    `on_pulses` gives the columns and units as which the positions are whole pulses.
    """
    joint_units = [unit] * len(labels) if isinstance(unit, str) else list(unit)
    for joint, (span, joint_unit) in enumerate(zip(np.ptp(q, axis=0), joint_units, strict=True)):
        limit, size, per = (
            (CHECKS.max_metres, "m", 1.0)
            if joint_unit in LENGTH
            else (CHECKS.max_turns, "turns", 2 * np.pi)
        )
        if span / per <= limit:
            continue
        # Offer other units only if the span becomes plausible in them; of several, those in which
        # the positions are whole pulses.
        scale = LENGTH if joint_unit in LENGTH else ANGLE
        fits = [u for u in scale if span / per * scale[u] / scale[joint_unit] <= limit]
        gridded = [u for field, u in on_pulses() if field == name and u in fits]
        fits = gridded or fits
        counts = "Are they counts ('pulses')? A joint that does turn so far is logged in counts."
        advice = f"{' or '.join(map(repr, fits))} would fit." if fits else counts
        if not gridded and np.abs(q[:, joint]).max() <= CHECKS.max_normalised * scale[joint_unit]:
            advice += " Normalised positions need their ranges: {'-100 to 100 of deg': ranges}."
        got = f"spans {span / per:.3g} {size} of {labels[joint]}; at most {limit:g}"
        raise ValueError(f"{name} in {joint_unit!r} {got}. {advice}")


def on_grid(position: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Shift (n,) of positions (N, n) from whole pulses, and whether all samples share it.

    Samples may be 0.1 pulses off. Zero is always on the grid: it is the middle of its quantisation
    cell, which is two pulses wide.
    """
    away = np.abs(position) > 0.1
    # The circular mean is the common shift modulo one pulse. Zeros are left out: they lie on the
    # grid whatever the shift is.
    shift = np.angle((np.exp(2j * np.pi * position) * away).sum(axis=0)) / (2 * np.pi)
    off = (position - shift) * away
    return shift, np.abs(off - np.round(off)).max(axis=0) < 0.1


def require_limit(
    name: str,
    value: Floats,
    limit: Floats,
    unit: Unit,
    alternatives: Mapping[str, Floats | float],
    labels: Sequence[str],
) -> None:
    """Refuse torques or currents (N, n) far above the amplifier's limit (n,), on the same side.

    `alternatives` maps other units to factors. A factor, one number or (n,), times the value is
    what the value would be if the log were in that unit.
    """
    peak = np.abs(value).max(axis=0)
    if (peak <= CHECKS.limit_factor * limit).all():
        return
    # Report the joint that exceeds its limit by the largest factor.
    joint = int(np.argmax(peak / limit))
    # Offer only a unit in which no joint exceeds its limit.
    fits = [
        other
        for other, factor in alternatives.items()
        if (peak * np.abs(factor) <= CHECKS.limit_factor * limit).all()
    ]
    advice = " or ".join(map(repr, fits)) + " would fit."
    if not fits:
        advice = "Correct the log, or the rig's limit."
    got = f"reaches {peak[joint]:g} at {labels[joint]}; the amplifier drives {limit[joint]:g}"
    raise ValueError(f"{name} in {unit!r} {got}. {advice}")


REFERENCE = ("reference_pulses", "reference_position", "reference_motor_position")
# Below this a float64 holds every count; the next count rounds to it, and loses its last pulse.
_EXACT = 2.0**53


def converted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> dict[str, Floats]:
    """One logged field under the record's name, in the record's unit and side of the gear."""
    if field in ("torque", "injected"):
        limit = rig.drive.torque_limit()
        gear = rig.drive.gear
        # The limit is one of joint torque; it is compared on the side where the value was logged.
        if unit == "motor N m":
            others = {"N m": 1 / gear, "A of current": rig.drive.motor_gain}
            require_limit(field, value, limit / np.abs(gear), unit, others, rig.joint_labels)
            return {field: rig.drive.joint_torque(value)}
        # Each motor has its limit, so coupled joint torques are taken to the shafts first.
        require_limit(
            field, rig.drive.coupling.shaft_torque(value), limit, unit, {}, rig.joint_labels
        )
        return {field: value}
    if field == "current":
        value = value / CURRENT[str(unit)]
        unit = str(unit)
        # Factors from the value in ampere to what it would be if the log were in the other unit.
        alternatives = {
            alternative: CURRENT[unit] / per
            for alternative, per in CURRENT.items()
            if alternative != unit
        }
        require_limit(field, value, rig.drive.current_limit, unit, alternatives, rig.joint_labels)
        return {"current": value}
    if field == "link_position":  # another sensor, of a resolution of its own
        absent = np.isnan(value)  # a motor that turns several joints is known by all of them
        angle = np.where(absent, 0.0, value * factors(unit))
        require_span(field, angle, unit, rig.joint_labels, list)
        pulses = rig.position_in_pulses(angle)
        # A coupled motor has no link reading if one of the joints that it turns has none: the
        # conversion of the mask spreads the absence to its column.
        return {
            "link_counts": np.where(
                rig.position_in_pulses(absent.astype(float)) != 0, np.nan, pulses
            )
        }
    name = (
        "reference_pulses"
        if field in REFERENCE
        else "error_pulses"
        if field == "error_pulses"
        else "counts"
    )
    if unit == "pulses":
        # A commanded position may lie between two pulses; what is counted is whole, unless the
        # encoder is smooth.
        return {
            name: rig.encoder.quantised(value.astype(float))
            if field == "reference_position"
            else _whole(field, value, rig)
        }
    return {name: _counted(field, value, unit, rig)}


def converted_angle(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Joint position [rad] that was asked for, without rounding."""
    if unit == "pulses":
        return rig.to_angle(value.astype(float))
    angle = value * factors(unit)
    return rig.drive.joint_angle(angle) if "motor" in field else angle


def path_through(t: Floats, q: Floats, counts: Floats, rig: Rig) -> Reference | None:
    """Spline through positions (N, n) [rad] at times (N,), or None if no path is to be built.

    The result is None if the positions are whole pulses already, if the motion is not smooth from
    sample to sample, or if there are too few or too many samples. Until the first time, which may
    be later than 0, the spline stays at its first point.
    """
    if (
        not PATH.min_samples <= len(t) <= PATH.max_samples
        or on_grid(rig.position_in_pulses(q))[1].all()
    ):
        return None
    # The spline must reproduce the counts at the samples and stay near the chord between them;
    # otherwise it would add a motion that nobody commanded.
    path: Reference = Spline(times=t - t[0], points=q, at_rest=False)
    # A spline begins at 0, as its log does; commands may begin later.
    if t[0]:
        path = path.later(-t[0])
    between = (t[1:] + t[:-1]) / 2
    bent = np.abs(
        rig.position_in_pulses(path(between).q) - rig.position_in_pulses((q[1:] + q[:-1]) / 2)
    )
    same_counts = np.abs(rig.counts(path(t).q) - counts).max() == 0
    intervals = np.diff(t) / np.median(np.diff(t))  # a gap in the log bends with its square
    return path if same_counts and (bent < PATH.max_bend * intervals[:, None] ** 2).all() else None


def _whole(field: str, value: NDArray[Any], rig: Rig) -> Floats:
    value = value.astype(float)
    if rig.encoder.smooth:
        return value
    # Above 2**53 a float64 cannot hold every count, so such counts are refused as well.
    broken = np.argwhere((value != np.trunc(value)) | (np.abs(value) >= _EXACT))
    if len(broken):
        got = (
            f"got {value[tuple(broken[0])]:g} in row {broken[0][0]},"
            f" {rig.joint_labels[broken[0][1]]}"
        )
        advice = f"Map angles as {field!r} in 'rad' or 'deg', not in 'pulses'."
        if "position" not in field:
            advice = "Map angles as 'position', with their unit."
        if field == "error_pulses":
            advice = "Map the positions and the reference in its place."
        if field == "reference_pulses":
            advice = "Map it as 'reference_position', with its unit, 'pulses' or that of an angle."
        raise ValueError(f"{field!r} must be whole pulses; {got}. {advice}")
    return value


def _counted(field: str, value: NDArray[Any], unit: Unit, rig: Rig) -> Floats:
    """Counts of positions: whole pulses as they are, others as the rig's encoder counts them."""
    motor = "motor" in field
    angle = value * factors(unit)
    to_pulses = {False: rig.position_in_pulses, True: rig.encoder.position_in_pulses}
    position = to_pulses[motor](angle)

    def on_pulses() -> list[tuple[str, Unit]]:
        return [key for key, pulses in _readings(field, value, unit, rig) if _is_motion(pulses)]

    # The span is checked before the grid, so that the message speaks of the user's unit.
    q = rig.drive.joint_angle(angle) if motor else angle
    require_span(field, q, unit, rig.joint_labels, on_pulses)
    # A smooth encoder does not quantise, so there is no grid to compare with.
    if rig.encoder.smooth:
        return position
    shift, grid = on_grid(position)
    # A reference may lie between pulses; only measured positions must lie on the grid.
    # A log without motion agrees with every grid, and tells nothing about the unit.
    if field not in REFERENCE and np.ptp(position, axis=0).any() and not grid.all():
        if fits := on_pulses():
            column, column_unit = fits[0]
            raise ValueError(
                f"{field} in {unit!r} must be whole pulses of the rig; they are not, as"
                f" {column!r} in {column_unit!r} they would be. State that."
            )
        # The smallest step of an offending joint shows how its resolution differs from the rig's.
        offending = position[:, np.argmin(grid)]
        step = _smallest_step(offending)
        hint = (
            ": state the resolution more exactly" if abs(step - 1) < CHECKS.step_tolerance else ""
        )
        reason = f"smallest step {step:.{6 if hint else 3}g} pulses{hint}"
        wide = _wide_cell(offending) if rig.encoder.rounding == "fix" else None
        if wide is not None:
            reason = (
                f"its cell of two pulses, which 'fix' has at zero, is at {wide:.1f} pulses: correct"
                " the zero of the column"
            )
        text = (
            f"{field} of {rig.joint_labels[np.argmin(grid)]} is not in whole pulses of"
            " rig.encoder.resolution "
        )
        warn(f"{text}({reason}); counted as that encoder would")
    # A shift within the tolerance of the grid is rounding, and no offset of the encoder.
    shift = np.where(np.abs(shift) < 0.1, 0.0, shift)
    return rig.encoder.quantised(np.where(grid, np.round(position - shift) + shift, position))


def _readings(
    field: str, value: NDArray[Any], unit: Unit, rig: Rig
) -> Iterator[tuple[tuple[str, Unit], Floats]]:
    """Yield each field and unit in which `value` may be logged, with its positions in pulses.

    References, smooth encoders and fields with one unit per joint yield nothing.
    """
    if field in REFERENCE or rig.encoder.smooth or not isinstance(unit, str):
        return
    motor = "motor" in field
    to_pulses = {False: rig.position_in_pulses, True: rig.encoder.position_in_pulses}
    if unit in LENGTH:
        for word in LENGTH:
            yield (field, word), to_pulses[motor](value * LENGTH[word])
        return
    # The position of a motor's shaft may have been mapped as that of the joint, or the reverse:
    # both are tried in all units, the mapped one before the other. The finest unit comes first:
    # whole pulses in gradians are whole in turns, too.
    names = {motor: field, not motor: "position" if motor else "motor_position"}
    for side, name in names.items():
        for word in sorted(ANGLE, key=lambda word: ANGLE[word]):
            yield (name, word), to_pulses[side](value * ANGLE[word])


def _is_motion(position: Floats) -> bool:
    """Whether positions in pulses (N, n) move, and each moving joint is on the grid of `on_grid`.

    Each moving joint must move by at least `CHECKS.min_motion`.
    """
    moved = np.ptp(position, axis=0)
    moving = moved > 0
    enough = moving.any() and (moved[moving] >= CHECKS.min_motion).all()
    return bool(enough and on_grid(position)[1].all())


def _wide_cell(position: Floats) -> float | None:
    """Middle [pulses] of the only cell of positions (N,) that is two pulses wide; None without one.

    It is half a pulse off the grid that all other positions share. A wrong resolution moves many
    positions off a grid, by different distances.
    """
    shift = np.angle(np.exp(4j * np.pi * position).sum()) / (4 * np.pi)
    halves = 2 * (position - shift)
    levels = np.unique(np.round(halves))
    if np.abs(halves - np.round(halves)).max() > 0.2 or len(levels) < 4:
        return None
    alone = [group[0] for k in (0, 1) if len(group := levels[levels % 2 == k]) == 1]
    return float(alone[0] / 2 + shift) if alone else None


def _smallest_step(position):
    steps = np.diff(np.unique(position))
    # Smaller differences are floating-point noise of one and the same level.
    return float(steps[steps > 1e-6].min(initial=np.inf))

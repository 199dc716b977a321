"""A robot file to complete: numbers that nobody has stated are marked, not guessed."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plant.laws import P
from plant.machine import Drive, Encoder, Rig
from plant.mechanics import Chain, read_urdf
from plant.models.arm_table import model_beside
from plant.models.tables import check_keys, meaning_of, toml_lines
from plant.parts import Part

MISSING = "?"
"""In place of a value: it is still to be filled in."""

# In place of a value: the URDF file states it, on the joint side.
_STATED = "urdf"

_OF_URDF = ("viscous", "coulomb", "current_limit")
_PARTS: dict[str, type] = {"rig": Rig, "drive": Drive, "encoder": Encoder, "law": P}


def new_robot_file(path: str, target: Path, base: str | None, tip: str | None) -> str:
    """Text of a robot file, to stand at `target`, for the arm of `Chain.from_urdf`."""
    # The joints between base and tip, in their order.
    chosen = read_urdf(path).chain_joints(None, base, tip)
    names = [joint.name for joint in chosen]
    Chain.from_urdf(path, names)  # raises a ValueError for a tree that is no arm
    # Rows of `_OF_URDF`: damping, friction and effort of the joints.
    stated = np.array([(*joint.friction, joint.limits[3]) for joint in chosen]).T
    comments = {}
    drive: dict[str, Any] = dict.fromkeys(("gear", "motor_inertia", "motor_gain"), MISSING)
    for key, unit, values in zip(_OF_URDF, ("N m s/rad", "N m", "N m"), stated, strict=True):
        # Zeros in all joints count as not stated.
        drive[key] = MISSING
        if np.isfinite(values).all() and values.any():
            drive[key] = _STATED
            numbers = ", ".join(f"{value:g}" for value in values)
            comments[key] = f"the file's {numbers} {unit}, on the joints"
    # The path of the model is relative to the new file, so that both can move together.
    tables: dict[str, Any] = {
        "name": Path(path).stem,
        "rig": {"period": MISSING},
        "drive": drive | {"joints": names},
        "encoder": {"resolution": MISSING},
        "arm": {"urdf": os.path.relpath(path, target.parent), "joints": names, "rotors": "drive"},
        "law": {"kind": "plant.P", "gain": MISSING},
    }

    def comment(path: tuple[str, ...], key: str) -> str:
        # A missing number is explained; a number of the file shows its value.
        if path and tables[path[0]][key] == MISSING:
            return meaning_of(_PARTS[path[0]], key)
        return comments.get(key, "")

    head = (
        f'# Replace each "{MISSING}", which {Path(path).name} does not say, by one number for all'
        " joints, or a list."
    )
    return "\n".join([head, *toml_lines(tables, comment=comment), ""])


_SLIDE = "; of a slide, of the motor in rad per m of the joint, 2 pi over the lead of a screw"
_DH = {
    ("rig", "period"): "Time from sample to sample of the log [s].",
    ("drive", "joints"): "Names of the joints in messages, from the base to the tip.",
    ("drive", "gear"): f"Turns of the motor per turn of the joint{_SLIDE}. A sign turns the axis.",
    ("drive", "motor_inertia"): "Inertia of the rotor with all that its shaft carries [kg m^2].",
    ("drive", "viscous"): "Friction per speed of the motor [N m s/rad]. A guess will do, since"
    " identify --unknown friction finds it.",
    ("drive", "coulomb"): "Dry friction of the motor [N m]. A guess will do.",
    ("drive", "motor_gain"): "Torque of the motor per current [N m/A].",
    ("drive", "current_limit"): "Largest current of the amplifier [A].",
    ("encoder", "resolution"): "Counts per turn of the motor.",
    ("law", "kind"): "The cascade of most drives. plant.P and plant.PID are others.",
    ("law", "position"): "Kp of the drive [1/s]. 1 mm/min/um is 16.67 1/s.",
    ("law", "speed"): "Torque of the motor per pulse per second [N m s]: Kv of the drive"
    " [N m s/rad of the motor] times 2 pi / resolution.",
    ("law", "integral"): "Torque of the motor per pulse [N m]: `speed`, as it stands above, over"
    " the reset time Tn [s].",
    ("law", "difference"): "Samples over which the drive takes its speed. If it has a low-pass,"
    " write filter = the pole [rad/s].",
    ("law", "period"): "Time from sample to sample of the drive [s].",
    ("arm", "table"): 'Denavit-Hartenberg rows after Craig. "standard" is the older convention.',
    ("arm", "gravity"): "Acceleration in the frame of the base [m/s^2].",
    ("log", "torque_delay"): "Rows by which torques or currents are exported late, often 1.",
    ("links", "prismatic"): "Write true for a slide.",
    ("links", "alpha"): "Angle from the axis before to this one [rad].",
    ("links", "a"): "Distance from the axis before to this one [m].",
    ("links", "d"): "Offset along this axis [m]; of a slide, at zero.",
    ("links", "theta"): "Angle about this axis at zero [rad].",
}
"""What a user without a model file fills in: a sentence for each key of the template."""


def new_dh_file(n: int) -> str:
    """Text of a robot file to complete, of n joints that no model file describes."""
    names = [f"joint {i + 1}" for i in range(n)]
    drive = ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
    tables = {
        "name": "my arm",
        "rig": {"period": MISSING},
        "drive": {"joints": names} | dict.fromkeys(drive, MISSING),
        "encoder": {"resolution": MISSING},
        "law": {
            "kind": "plant.Cascade",
            **dict.fromkeys(("position", "speed", "integral"), MISSING),
            "difference": 1,
            "period": MISSING,
        },
        "log": {"torque_delay": 0},
        "arm": {
            "table": "modified",
            "gravity": [0.0, 0.0, -9.81],
            "links": [
                {"name": name, "prismatic": False}
                | dict.fromkeys(("alpha", "a", "d", "theta"), MISSING)
                for name in names
            ],
        },
    }

    def comment(path: tuple[str, ...], key: str) -> str:
        return _DH.get((path[-1], key), "") if path else ""

    head = (
        f'# Replace each "{MISSING}". In [rig], [drive], [encoder] and [law] write one number for'
        " all joints, or a list."
    )
    return "\n".join([head, *toml_lines(tables, comment=comment), ""])


def require_complete(data: Mapping[str, Any]) -> None:
    """Refuse a file in which something is still marked as missing."""
    missing = list(_missing(data))
    if missing:
        raise ValueError(
            f"the file must be complete; still missing: {', '.join(missing)}. Replace each"
            f" {MISSING!r}."
        )


def _missing(table, path=""):
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _missing(value, f"{path}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for i, row in enumerate(value):
                yield from _missing(row, f"{path}{key}[{i}].")
        # In a list a single number may be missing.
        elif value == MISSING or (isinstance(value, list) and MISSING in value):
            yield f"{path}{key}"


def per_joint_table(table, cls: type[Part], n: int) -> Any:
    """A table with one number for all joints written out."""
    # `check_keys` refuses what is no table, with its heading.
    if not isinstance(table, Mapping):
        return table
    complete = dict(table)
    for name, field in cls.__dataclass_fields__.items():
        # Only fields with one number per joint: ("n",) is their shape.
        if name not in table or field.metadata.get("number") != ("n",):
            continue
        value = table[name]
        if isinstance(value, list) and len(value) != n:
            raise ValueError(
                f"{name} must have {n} numbers; got {len(value)}. Give one per joint, or one for"
                " all."
            )
        if isinstance(value, (int, float)):
            complete[name] = [value] * n
    return complete


def drive_table(table: dict[str, Any], arm: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table [drive] with the numbers of the URDF file of [arm], on the motor side."""
    of_urdf = [key for key in _OF_URDF if table.get(key) == _STATED]
    if not of_urdf:
        return table
    # Misspelt keys first: the conversion would not find the numbers.
    check_keys(table, Drive, "drive")
    if "urdf" not in arm:
        raise ValueError(
            f'[drive] must have numbers where [arm] has no urdf; got {of_urdf[0]} = "urdf". Write'
            " them."
        )
    path = model_beside(arm, folder)
    numbers = {key: table[key] for key in ("gear", "motor_inertia", "motor_gain")}
    # The drive is made for the file's numbers alone: the others may be anything.
    numbers |= {key: 1.0 for key in _OF_URDF if key not in of_urdf}
    drive = Drive.from_urdf(path or "", arm.get("joints"), **numbers)
    return table | {key: getattr(drive, key).tolist() for key in of_urdf}

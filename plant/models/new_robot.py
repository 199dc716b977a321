"""A robot file to complete, of a URDF file: what that does not say is marked, not guessed; and
its completion.
"""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plant.laws.pid import P
from plant.machine.drive import Drive
from plant.machine.encoder import Encoder
from plant.machine.rig import Rig
from plant.mechanics.chain import Chain
from plant.mechanics.urdf_file import read_urdf
from plant.models.arm_table import model_beside
from plant.models.tables import check_keys, meaning_of, toml_lines
from plant.parts.part import Part

# what stands for a value: nobody has said it yet; the URDF file states it, on the joint
MISSING = "?"
_STATED = "urdf"

_OF_URDF = ("viscous", "coulomb", "current_limit")
_PARTS: dict[str, type] = {"rig": Rig, "drive": Drive, "encoder": Encoder, "law": P}


def new_robot_file(path: str, target: Path, base: str | None, tip: str | None) -> str:
    """Text of a robot file, to stand at `target`, for the arm of `Chain.from_urdf`."""
    chosen = read_urdf(path).chain_joints(None, base, tip)
    names = [joint.name for joint in chosen]
    Chain.from_urdf(path, names)  # refuses what is no arm
    stated = np.array([(*joint.friction, joint.limits[3]) for joint in chosen]).T
    comments = dict[str, str]()
    drive: dict[str, Any] = dict.fromkeys(("gear", "motor_inertia", "motor_gain"), MISSING)
    for key, unit, values in zip(_OF_URDF, ("N m s/rad", "N m", "N m"), stated, strict=True):
        drive[key] = _STATED if np.isfinite(values).all() and values.any() else MISSING
        if drive[key] == _STATED:
            comments[key] = (
                f"the file's {', '.join(f'{value:g}' for value in values)} {unit}, on the joints"
            )
    tables: dict[str, Any] = {
        "name": Path(path).stem,
        "rig": {"period": MISSING},
        "drive": drive | {"joints": names},
        "encoder": {"resolution": MISSING},
        "arm": {"urdf": os.path.relpath(path, target.parent), "joints": names, "rotors": "drive"},
        "law": {"kind": "plant.P", "gain": MISSING},
    }

    def comment(where: tuple[str, ...], key: str) -> str:
        missing = tables[where[0]][key] == MISSING if where else False
        return meaning_of(_PARTS[where[0]], key) if missing else comments.get(key, "")

    head = (
        f'# Replace each "{MISSING}", which {Path(path).name} does not say, by one number for all'
        " joints, or a list."
    )
    return "\n".join([head, *toml_lines(tables, comment=comment), ""])


def require_complete(data: Mapping[str, Any]) -> None:
    """Refuse a file in which something is still marked as missing."""
    if missing := list(_missing(data)):
        raise ValueError(
            f"the file must be complete; still missing: {', '.join(missing)}. Replace each"
            f" {MISSING!r}."
        )


def _missing(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _missing(value, f"{path}{key}.")
        elif value == MISSING or (isinstance(value, list) and MISSING in value):
            yield f"{path}{key}"


def per_joint_table(table: Any, cls: type[Part], n: int) -> Any:
    """A table with one number for all joints written out."""
    if not isinstance(table, Mapping):
        return table
    many = {
        name
        for name, field in cls.__dataclass_fields__.items()
        if field.metadata.get("number") == ("n",)
    }
    for key in many & set(table):
        if isinstance(table[key], list) and len(table[key]) != n:
            raise ValueError(
                f"{key} must have {n} numbers; got {len(table[key])}. Give one per joint, or one"
                " for all."
            )
    alike = {key for key in many & set(table) if isinstance(table[key], (int, float))}
    return {key: [value] * n if key in alike else value for key, value in table.items()}


def drive_table(table: dict[str, Any], arm: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table [drive] with what it leaves to the URDF file of [arm], motor side."""
    words = [key for key in _OF_URDF if table.get(key) == _STATED]
    if not words:
        return table
    check_keys(table, Drive, "drive")
    if "urdf" not in arm:
        raise ValueError(
            f'[drive] must have numbers where [arm] has no urdf; got {words[0]} = "urdf". Write'
            " them."
        )
    path = model_beside(arm, folder)
    kept = {key: table[key] for key in ("gear", "motor_inertia", "motor_gain")} | dict.fromkeys(
        _OF_URDF, 1.0
    )
    given = {key: value for key, value in kept.items() if key not in words}
    drive = Drive.from_urdf(path or "", arm.get("joints"), **given)
    return table | {key: getattr(drive, key).tolist() for key in words}

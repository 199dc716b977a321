"""Robot files: one TOML file describes arm, drive, encoder, law and log columns; `read_robot`,
`write_robot`.
"""

import dataclasses
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from plant.laws.law import Law
from plant.logs.mapping import mapped_names
from plant.machine.drive import Drive
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.dynamics import Dynamics
from plant.models.arm_table import arm_table, chain_of, dynamics_of, model_beside
from plant.models.new_robot import drive_table, per_joint_table, require_complete
from plant.models.tables import class_of, part_of, table_of, toml_lines, unit_of
from plant.parts.arguments import choice, instance, known_options
from plant.parts.files import require_new, write_whole
from plant.parts.frozen import Frozen
from plant.parts.part import Part

_LARGEST = 5_000_000  # bytes of a robot file

_KEYS = ("name", "arm", "rig", "drive", "encoder", "law", "uncertainty", "columns", "units")
_UNCERTAINTY = "ctc.Uncertainty"  # what [uncertainty] holds; a package above this one defines it

FOLDER = Path(__file__).parent / "robots"  # robot files of the package


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Robot(Frozen):
    """What a robot file describes.

    Parameters
    ----------
    rig : Rig
        Drive, encoder, sampling period.
    arm : Arm, optional
        None where no inertial parameters are known.
    dynamics : Dynamics, optional
        Of the arm, by default; else what is to be identified.
    law : Law, optional
    uncertainty : Part, optional
        What is not known of arm and rig, a `ctc.Uncertainty`.
    columns, units : dict, optional
        Which columns of a log are what, as for `Record.from_csv`.
    name : str
    model : Path, optional
        The URDF or MJCF file that the arm was read from, for `write_model`; it does not count in a
        comparison, and is not written.

    See Also
    --------
    plant.read_robot, plant.write_robot

    Examples
    --------
    >>> from plant import read_robot
    >>> robot = read_robot("paper_puma560")
    >>> robot.rig.n, robot.arm.f.shape
    (2, (9,))
    """

    rig: Rig
    arm: Arm | None = None
    dynamics: Dynamics | None = None
    law: Law | None = None
    uncertainty: Part | None = None
    columns: dict[str, Any] | None = None
    units: dict[str, Any] | None = None
    name: str = ""
    model: Path | None = dataclasses.field(default=None, compare=False)

    def __post_init__(self) -> None:
        instance("rig", self.rig, Rig, "Give Rig(drive=..., encoder=..., period=...).")
        for key, kind in (
            ("arm", Arm),
            ("dynamics", Dynamics),
            ("law", Law),
            ("uncertainty", Part),
        ):
            if getattr(self, key) is not None:
                instance(
                    key, getattr(self, key), kind, f"Give one {kind.__name__}, or leave it out."
                )
        if self.dynamics is None:
            if self.arm is None:
                raise ValueError(
                    "arm or dynamics must be given; got neither. Pass arm=dynamics.arm(f)."
                )
            object.__setattr__(self, "dynamics", self.arm.dynamics)
        if self.arm is not None and self.arm.dynamics != self.dynamics:
            raise ValueError("dynamics must be those of the arm; got others. Leave them out.")
        self.rig.require_fit(self.dynamics.chain)  # type: ignore[union-attr]  # set above
        if self.columns is not None:
            mapped_names(self.columns, self.units)
        for key in ("columns", "units"):
            if (given := getattr(self, key)) is not None:
                kept = {k: list(v) if isinstance(v, tuple) else v for k, v in given.items()}
                object.__setattr__(self, key, kept)


def read_robot(path: str | Path) -> Robot:
    """A robot from its TOML file; the guide on model files has all keys.

    Parameters
    ----------
    path : str or Path
        A file; or the name of one of the package: "paper_puma560", "puma560", "tx40", "ur5e".

    Returns
    -------
    Robot
        ``.arm``, ``.rig``, ``.law``, ``.columns``, ``.dynamics``.

    Raises
    ------
    ValueError
        Not TOML; keys that are unknown (the nearest one is offered, with its unit), missing, or
        wrong; a law of a package that is not imported. In one line that names file and table.

    See Also
    --------
    plant.Robot, plant.write_robot

    Examples
    --------
    >>> from plant import read_robot
    >>> read_robot("ur5e").dynamics.n
    6
    """
    own = FOLDER / f"{path}.toml"
    place = own if not Path(path).suffix and own.is_file() else Path(path)
    if not place.is_file():
        packaged = ", ".join(sorted(each.stem for each in FOLDER.glob("*.toml")))
        raise ValueError(
            f"{path} must be a robot file; there is none. Give its path, or one of {packaged}."
        )
    if place.stat().st_size > _LARGEST:
        raise ValueError(
            f"{path} must be a robot file of at most {_LARGEST} bytes; it has more. Give a smaller"
            " one."
        )
    try:
        data = tomllib.loads(place.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(
            f"{path} must be TOML; {str(error).splitlines()[0]}. Correct it there."
        ) from None
    try:
        return _robot(data, place.parent)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _robot(data: dict[str, Any], folder: Path) -> Robot:
    require_complete(data)
    for key in data:
        choice("a table of the file", key, _KEYS)
    for key in ("arm", "drive", "encoder", "rig"):
        if not isinstance(data.get(key), dict):
            raise ValueError(
                f"the file must have [{key}]; it has {', '.join(data) or 'nothing'}. Add it."
            )
    parts = {key: data[key] for key in ("drive", "encoder")}
    twice = [key for key in parts if key in data["rig"]]
    if twice:
        raise ValueError(
            f"[rig] must not have {twice[0]!r}: it has a table of its own. Move it to [{twice[0]}]."
        )
    chain = chain_of(data["arm"], folder)
    parts["drive"] = drive_table(
        per_joint_table(parts["drive"], Drive, chain.n), data["arm"], folder
    )
    made = {key: part_of(table, f"plant.{key.capitalize()}", key) for key, table in parts.items()}
    places = {f"[{key}]": part for key, part in made.items()}
    rig = part_of(data["rig"] | {key: f"[{key}]" for key in made}, "plant.Rig", "rig", places)
    dynamics, f = dynamics_of(data["arm"], chain, rig)
    arm = None if f is None else dynamics.arm(f)
    known = {"[rig]": rig} | ({} if arm is None else {"[arm]": arm})
    law = None
    if "law" in data:
        kind = (
            class_of(data["law"].get("kind", ""), "law") if isinstance(data["law"], dict) else Law
        )
        law = part_of(per_joint_table(data["law"], kind, chain.n), "", "law", known)
    uncertainty = (
        part_of(data["uncertainty"], _UNCERTAINTY, "uncertainty") if "uncertainty" in data else None
    )
    name = data.get("name", "")
    return Robot(
        name=instance("name", name, str, "Write it in quotes."),
        rig=rig,
        arm=arm,
        dynamics=dynamics,
        law=law,
        uncertainty=uncertainty,
        columns=data.get("columns"),
        units=data.get("units"),
        model=model_beside(data["arm"], folder),
    )


@known_options
def write_robot(robot: Robot, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a robot as a TOML file that `read_robot` reads back to the same bits.

    Parameters
    ----------
    robot : Robot
    path : str or Path
    overwrite : bool
        Replace a file that is there.

    Raises
    ------
    ValueError
        A file that is there; a part that is not the library's own.

    See Also
    --------
    plant.read_robot, plant.Robot

    Examples
    --------
    >>> from plant import read_robot, write_robot
    >>> write_robot(read_robot("paper_puma560"), "arm.toml")
    >>> read_robot("arm.toml").rig.n
    2
    """
    instance("robot", robot, Robot, "Give Robot(arm=..., rig=..., ...), or what read_robot gave.")
    target = require_new(path, overwrite)
    write_whole(target, (f"{line}\n" for line in _lines(robot)))


def _lines(robot: Robot) -> Iterator[str]:
    # which Robot sets
    rig = table_of(robot.rig, "plant.Rig")
    dynamics = cast(Dynamics, robot.dynamics)
    tables: dict[str, Any] = {"name": robot.name} if robot.name else {}
    tables |= {"rig": {key: value for key, value in rig.items() if key not in ("drive", "encoder")}}
    tables |= {
        "drive": rig["drive"],
        "encoder": rig["encoder"],
        "arm": arm_table(dynamics, robot.arm),
    }
    if robot.law is not None:
        known = {"[rig]": robot.rig} | ({} if robot.arm is None else {"[arm]": robot.arm})
        tables["law"] = table_of(robot.law, "", known)
        class_of(tables["law"]["kind"], "law")  # a law of the user's own has no name in a file
    if robot.uncertainty is not None:
        tables["uncertainty"] = table_of(robot.uncertainty, _UNCERTAINTY)
    tables |= {
        key: value for key in ("columns", "units") if (value := getattr(robot, key)) is not None
    }
    classes: dict[str, type] = {
        "rig": Rig,
        "drive": type(robot.rig.drive),
        "encoder": type(robot.rig.encoder),
    }

    if robot.law is not None:
        classes["law"] = type(robot.law)

    def comment(where: tuple[str, ...], key: str) -> str:
        return unit_of(classes[where[0]], key) if len(where) == 1 and where[0] in classes else ""

    yield from toml_lines(tables, comment=comment)

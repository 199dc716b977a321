"""Robot files: one TOML file describes arm, drive, encoder, law and log columns."""

import tomllib
from collections.abc import Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Any, cast

from plant.laws import Law
from plant.logs import mapped_names
from plant.machine import Drive, Rig
from plant.mechanics import Arm, Dynamics
from plant.models.arm_table import arm_table, chain_of, dynamics_of, model_beside
from plant.models.new_robot import drive_table, per_joint_table, require_complete
from plant.models.tables import class_of, part_of, table_of, toml_lines, unit_of
from plant.parts import (
    Frozen,
    Part,
    choice,
    frozen,
    instance,
    known_options,
    path_of,
    require_new,
    whole,
    write_whole,
)

# Bytes of a robot file: a larger file is none, and is refused before it is read.
_LARGEST = 5_000_000

_KEYS = ("name", "arm", "rig", "drive", "encoder", "law", "uncertainty", "columns", "units", "log")
# The part in [uncertainty]: a package above this one defines it, so a file has its name only.
_UNCERTAINTY = "ctc.Uncertainty"

FOLDER = Path(__file__).parent / "robots"  # robot files of the package


@known_options
@frozen
class Robot(Frozen):
    """A robot as its file describes it: arm, rig, law, and the columns of its logs.

    Parameters
    ----------
    rig : Rig
        Drive, encoder, sampling period.
    arm : Arm, optional
        None where the inertial parameters are unknown.
    dynamics : Dynamics, optional
        Of the arm, by default; otherwise the dynamics to identify.
    law : Law, optional
    uncertainty : Part, optional
        Uncertainty of arm and rig, a `ctc.Uncertainty`.
    columns, units : dict, optional
        The columns of a log and their units, as for `Record.from_csv`.
    torque_delay : int
        Rows by which the columns of torque and current are late, as for `Record.from_csv`; in the
        file, ``torque_delay`` of the table ``[log]``.
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
    torque_delay: int = 0
    name: str = ""
    model: Path | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        instance("rig", self.rig, Rig, "Give Rig(drive=..., encoder=..., period=...).")
        kinds = {"arm": Arm, "dynamics": Dynamics, "law": Law, "uncertainty": Part}
        for key, kind in kinds.items():
            if getattr(self, key) is not None:
                advice = f"Give one {kind.__name__}, or leave it out."
                instance(key, getattr(self, key), kind, advice)
        # An arm has its dynamics: stated twice they may contradict each other.
        if self.dynamics is None:
            if self.arm is None:
                raise ValueError(
                    "arm or dynamics must be given; got neither. Pass arm=dynamics.arm(f)."
                )
            object.__setattr__(self, "dynamics", self.arm.dynamics)
        if self.arm is not None and self.arm.dynamics != self.dynamics:
            raise ValueError("dynamics must be those of the arm; got others. Leave them out.")
        # The number of joints, and the kind of each.
        self.rig.require_fit(self.dynamics.chain)  # type: ignore[union-attr]  # set above
        if self.columns is not None:
            mapped_names(self.columns, self.units)
        for key in ("columns", "units"):
            table = getattr(self, key)
            if table is not None:
                # TOML reads lists, so a robot with tuples would differ from its own file.
                lists = {k: list(v) if isinstance(v, tuple) else v for k, v in table.items()}
                object.__setattr__(self, key, lists)

    @property
    def named_rig(self) -> Rig:
        """The rig, with joints that have names: of its drive, otherwise of the links."""
        # Checks of a log know the rig alone, and their messages name joints as the arm does.
        if self.rig.drive.joints or self.dynamics is None:
            return self.rig
        names = tuple(link.name for link in self.dynamics.chain.links)
        return replace(self.rig, drive=replace(self.rig.drive, joints=names))


def read_robot(path: str | Path) -> Robot:
    """A robot from its TOML file; the guide on model files has all keys.

    Parameters
    ----------
    path : str or Path
        A file; or the name of one of the package: "koch", "openarm", "panda", "paper_puma560",
        "puma560", "so100", "so101", "tx40", "ur10", "ur5e", "yam".

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
    packaged_file = FOLDER / f"{path}.toml"
    file = path_of("path", path)
    # A path with a suffix is never the name of a packaged robot.
    if not file.suffix and packaged_file.is_file():
        file = packaged_file
    if not file.is_file():
        packaged = ", ".join(sorted(robot.stem for robot in FOLDER.glob("*.toml")))
        raise ValueError(
            f"{path} must be a robot file; there is none. Give its path, or one of {packaged}."
        )
    if file.stat().st_size > _LARGEST:
        raise ValueError(
            f"{path} must be a robot file of at most {_LARGEST} bytes; it has more. Give a smaller"
            " one."
        )
    if file.suffix.lower() in (".urdf", ".xacro", ".xml"):
        raise ValueError(
            f"{path} must be a robot file, which is TOML; it is a model file. Run `onepulse robots"
            f" new {file.name} -o arm.toml`, or read it by Chain.from_urdf or from_mjcf."
        )
    try:
        data = tomllib.loads(file.read_text(encoding="utf-8"))
    # Bytes that are no text and nesting without end are mistakes of the file, too.
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise ValueError(
            f"{path} must be TOML; {str(error).splitlines()[0]}. Correct it there."
        ) from None
    try:
        # Every refusal names the file; relative paths start in its folder.
        return _robot(data, file.parent)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _robot(data: dict[str, Any], folder: Path) -> Robot:
    # 1. The tables that the file has and must have.
    require_complete(data)
    for key in data:
        choice("a table of the file", key, _KEYS)
    for key in ("arm", "drive", "encoder", "rig"):
        if not isinstance(data.get(key), dict):
            raise ValueError(
                f"the file must have [{key}]; it has {', '.join(data) or 'nothing'}. Add it."
            )
    for key in ("drive", "encoder"):
        if key in data["rig"]:
            raise ValueError(
                f"[rig] must not have {key!r}: it has a table of its own. Move it to [{key}]."
            )

    # 2. The rig. The number of joints comes from the chain, for numbers stated once for all.
    chain = chain_of(data["arm"], folder)
    drive_numbers = per_joint_table(data["drive"], Drive, chain.n)
    drive = part_of(drive_table(drive_numbers, data["arm"], folder), "plant.Drive", "drive")
    encoder = part_of(data["encoder"], "plant.Encoder", "encoder")
    parts = {"[drive]": drive, "[encoder]": encoder}
    rig_table = data["rig"] | {"drive": "[drive]", "encoder": "[encoder]"}
    rig = part_of(rig_table, "plant.Rig", "rig", parts)

    # 3. The arm, and what may refer to both.
    dynamics, f = dynamics_of(data["arm"], chain, rig)
    arm = None
    parts = {"[rig]": rig}
    if f is not None:
        arm = dynamics.arm(f)
        parts["[arm]"] = arm
    law = None
    if "law" in data:
        table = data["law"]
        # A law may have numbers per joint, which only its own class knows.
        kind = class_of(table.get("kind", ""), "law") if isinstance(table, dict) else Law
        law = part_of(per_joint_table(table, kind, chain.n), "", "law", parts)
    uncertainty = None
    if "uncertainty" in data:
        uncertainty = part_of(data["uncertainty"], _UNCERTAINTY, "uncertainty")
    return Robot(
        name=instance("name", data.get("name", ""), str, "Write it in quotes."),
        rig=rig,
        arm=arm,
        dynamics=dynamics,
        law=law,
        uncertainty=uncertainty,
        columns=data.get("columns"),
        units=data.get("units"),
        torque_delay=_of_log(data.get("log", {})),
        model=model_beside(data["arm"], folder),
    )


def _of_log(table: Any) -> int:
    """The delay of the torque columns that the table [log] states."""
    instance("log", table, dict, "Write [log] above torque_delay = 1.")
    for key in table:
        choice("key of [log]", key, ("torque_delay",))
    delay = table.get("torque_delay", 0)
    return whole("torque_delay", delay, "Give the samples by which it is late.", least=0)


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
    # 1. The tables, in the order in which a reader wants them.
    rig = table_of(robot.rig, "plant.Rig")
    drive = rig.pop("drive")
    encoder = rig.pop("encoder")
    dynamics = cast(Dynamics, robot.dynamics)  # `Robot` sets it
    tables: dict[str, Any] = {"name": robot.name} if robot.name else {}
    tables["rig"] = rig
    tables["drive"] = drive
    tables["encoder"] = encoder
    tables["arm"] = arm_table(dynamics, robot.arm)
    classes: dict[str, type] = {
        "rig": Rig,
        "drive": type(robot.rig.drive),
        "encoder": type(robot.rig.encoder),
    }
    if robot.law is not None:
        parts: dict[str, Part] = {"[rig]": robot.rig}
        if robot.arm is not None:
            parts["[arm]"] = robot.arm
        tables["law"] = table_of(robot.law, "", parts)
        class_of(tables["law"]["kind"], "law")  # a law of the user's own has no name in a file
        classes["law"] = type(robot.law)
    if robot.uncertainty is not None:
        tables["uncertainty"] = table_of(robot.uncertainty, _UNCERTAINTY)
    if robot.columns is not None:
        tables["columns"] = robot.columns
    if robot.units is not None:
        tables["units"] = robot.units
    if robot.torque_delay:
        tables["log"] = {"torque_delay": robot.torque_delay}

    # 2. Their text, with the unit behind each number of a part.
    def comment(path: tuple[str, ...], key: str) -> str:
        return unit_of(classes[path[0]], key) if len(path) == 1 and path[0] in classes else ""

    yield from toml_lines(tables, comment=comment)

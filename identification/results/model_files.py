"""Identified inertials written back into the model file that an arm came from: `write_model`."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from identification.results.identification import Identification
from identification.results.physical import Physical, table_of
from identification.results.realised import Realised, bodies_of, matching_joints
from plant import Arm, Body, Drive
from plant.mechanics.lumping import STANDARD
from plant.mechanics.mjcf_file import read_mjcf
from plant.mechanics.model_tree import ModelFile
from plant.mechanics.urdf_file import is_xacro, read_urdf
from plant.mechanics.xml_file import Element, parsed, spliced
from plant.models.edits import (
    mjcf_inertial,
    mjcf_joint,
    mjcf_motors,
    mjcf_text,
    urdf_friction,
    urdf_inertial,
)
from plant.parts.arguments import known_options
from plant.parts.fields import Floats
from plant.parts.files import require_new, write_whole
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict

_READERS = {"robot": read_urdf, "mujoco": read_mjcf}  # root of a model file -> its reader

_MJCF = (".xml", ".mjcf")  # suffixes of a target that is MJCF, whatever its source is

_SAME = 1e-13  # relative change of a body below which its bytes stay


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WrittenModel(Shown, Frozen):
    """What was written.

    Attributes
    ----------
    path : Path
    bodies : dict of str to Body
        By link, in the links' frames.
    rotors : (n,) numpy.ndarray
        Reflected rotor inertias that f holds [kg m^2]; they are in no body.
    arm : Arm
        The arm with the f that bodies and rotors have.
    difference : (p,) numpy.ndarray
        That f minus the one that was asked for; zero unless ``nearest=True`` was needed.
    """

    path: Path
    bodies: dict[str, Body]
    rotors: Floats
    arm: Arm
    difference: Floats

    def _short(self) -> str:
        return (
            f"{self.path.name}, {len(self.bodies)} inertials, f within"
            f" {np.abs(self.difference).max():.3g}"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()} of what was asked for")
        yield table_of("link", self.bodies.items())


@known_options
def write_model(
    found_or_arm: Identification | Physical | Arm,
    source: str | Path,
    target: str | Path,
    *,
    prior: str | Path | Mapping[str, Body] | None = None,
    nearest: bool = False,
    friction: bool = True,
    motors: bool = True,
    overwrite: bool = False,
) -> WrittenModel:
    """Write a URDF or MJCF file with the inertials of an arm; every byte that is not one of these
    numbers stays.

    The bodies have f, and are otherwise nearest to the prior in the log-det divergence of their
    pseudo-inertias: what f does not determine is the prior's. Bodies on fixed joints change with
    the link that carries them, each in proportion to what it is. Rotor inertias are MJCF's
    ``armature``. URDF has no place for them: its torque is the arm's without ``rotors * qdd``.

    Parameters
    ----------
    found_or_arm : Identification, Physical or Arm
        Whose chain is of this file (`Chain.from_urdf`, `Chain.from_mjcf`).
    source, target : str or Path
        The file to start from, and the one to write. From a URDF file, a target with the suffix
        .xml or .mjcf becomes MJCF: bodies, joints, limits and inertials without shapes, joints that
        the arm does not have fixed at zero.
    prior : str, Path or mapping of str to Body, optional
        Another model file with the same links, or bodies of links in their frames; by default the
        source's own.
    nearest : bool
        Write the nearest f that bodies can have where they cannot have this one, with a warning
        that says by how much it differs; in standard deviations where they are known, otherwise
        relative.
    friction : bool
        Of an Identification, write its viscous and Coulomb friction, joint side: <dynamics> of
        URDF, ``damping`` and ``frictionloss`` of MJCF.
    motors : bool
        Of an Identification, give MJCF that has none an <actuator> for each joint: a ``motor`` with
        the drive's gear, whose control is the torque of the motor [N m] within its limit. A
        ``dcmotor`` needs a resistance, which a drive, whose amplifiers control currents, does not
        have.
    overwrite : bool
        Replace a target that is there.

    Returns
    -------
    WrittenModel

    Raises
    ------
    ValueError
        A source that does not describe the arm, f that no bodies have, a target that is there; an
        inertial in a file that is included; coupled motors, for which MJCF has no armature.

    See Also
    --------
    identification.nearest_physical, plant.check_model

    Examples
    --------
    >>> from plant import Chain, Dynamics, read_robot
    >>> from identification import write_model
    >>> source = read_robot("ur5e").model
    >>> dynamics = Dynamics.from_chain(Chain.from_urdf(source, joints=["shoulder_lift", "elbow"]))
    >>> arm = dynamics.arm(dynamics.f())
    >>> written = write_model(arm, source, "new.urdf")
    >>> list(written.bodies)
    ['upper_arm', 'forearm', 'wrist_1', 'wrist_2', 'wrist_3']
    """
    path = require_new(target, overwrite)
    model, root = _read(source)
    if is_xacro(root):
        raise ValueError(f"source must be a URDF file; {source} is xacro. Expand it first.")
    arm, drive = _given(found_or_arm)
    joints = matching_joints(arm, model)
    got = bodies_of(
        found_or_arm,
        arm,
        model,
        _prior_bodies(prior),
        nearest,
        np.array([j.armature for j in joints]),
    )
    drive = None if drive is None or drive.coupling.matrix else drive
    levels = (
        None if drive is None or not friction else (drive.joint_viscous(), drive.joint_coulomb())
    )
    if root.tag == "robot" and path.suffix not in _MJCF:
        bodies = _changed(model, got)
        edits = [
            edit
            for link, body in bodies
            for edit in urdf_inertial(model.data, model.links[link], body)
        ]
        for i, joint in enumerate(joints):
            if joint.element is not None and levels is not None:
                edits += urdf_friction(
                    model.data, joint.element, float(levels[0][i]), float(levels[1][i])
                )
        return _write(path, spliced(model.data, edits), arm, got)
    if arm.dynamics.chain.coupling.matrix and got.rotors.any():
        raise ValueError(
            "rotors must turn with joints of their own; the arm's are coupled, and MJCF has no"
            " such. Use URDF."
        )
    values: dict[str, dict[str, float]] = {joint.name: {} for joint in joints}
    for i, (joint, rotor) in enumerate(zip(joints, got.rotors, strict=True)):
        if abs(rotor - joint.armature) > _SAME * abs(rotor):
            values[joint.name]["armature"] = float(rotor)
        if levels is not None:
            values[joint.name] |= {
                "damping": float(levels[0][i]),
                "frictionloss": float(levels[1][i]),
            }
    section = (
        mjcf_motors([joint.name for joint in joints], drive) if drive is not None and motors else ""
    )
    if root.tag == "robot":
        return _write(
            path,
            mjcf_text(model, got.bodies, values, arm.dynamics.chain.gravity, section),
            arm,
            got,
        )
    edits = [
        edit
        for link, body in _changed(model, got)
        for edit in mjcf_inertial(model.data, _own(model, link), body)
    ]
    for joint in joints:
        if values[joint.name] and joint.element is not None:
            _own(model, joint.child)
            edits += mjcf_joint(model.data, joint.element, values[joint.name])
    named = all(
        joint.element is not None and "name" in joint.element.attributes for joint in joints
    )
    if section and named and not root.all("actuator") and not root.all("include"):
        edits.append(root.child_edit(model.data, section))
    return _write(path, spliced(model.data, edits), arm, got)


def _read(path: str | Path) -> tuple[ModelFile, Element]:
    """A model file and its root."""
    root, _ = parsed(path, None, "URDF or MJCF")
    if root.tag not in _READERS:
        raise ValueError(
            f"{path} must hold a <robot> or a <mujoco>; got <{root.tag}>. Give a URDF or MJCF file."
        )
    return _READERS[root.tag](path), root


def _prior_bodies(prior: str | Path | Mapping[str, Body] | None) -> Mapping[str, Body]:
    """Bodies by link."""
    if prior is None or isinstance(prior, Mapping):
        return prior or {}
    return {name: body for name, body in _read(prior)[0].bodies.items() if body is not None}


def _given(found_or_arm: Identification | Physical | Arm) -> tuple[Arm, Drive | None]:
    """The arm, and the drive if it is known."""
    if isinstance(found_or_arm, Identification):
        return found_or_arm.arm, found_or_arm.rig.drive
    arm = found_or_arm.arm if isinstance(found_or_arm, Physical) else found_or_arm
    if not isinstance(arm, Arm):
        got = type(found_or_arm).__name__
        raise ValueError(
            f"found_or_arm must be what identify gave, or an Arm; got a {got}. Pass found, or"
            " found.arm."
        )
    return arm, None


def _changed(model: ModelFile, got: Realised) -> list[tuple[str, Body]]:
    """The bodies that are not the file's own."""
    changed = []
    for link, body in got.bodies.items():
        own = model.bodies[link]
        before, after = (
            np.zeros(len(STANDARD) - 1) if b is None else b.standard_parameters for b in (own, body)
        )
        if np.abs(after - before).max() > _SAME * np.abs(before).max():
            changed.append((link, body))
    return changed


def _own(model: ModelFile, link: str) -> Element:
    """The element of a link that stands in the file itself."""
    element = model.links[link]
    if element.path != model.path:
        raise ValueError(
            f"inertials must stand in {model.path}; that of {link} is in {element.path}. Write that"
            " file."
        )
    return element


def _write(path: Path, data: bytes, arm: Arm, got: Realised) -> WrittenModel:
    write_whole(path, [data])
    f = arm.f if got.exact else got.f
    return WrittenModel(
        path=path,
        bodies=got.bodies,
        rotors=got.rotors,
        arm=arm.dynamics.arm(f),
        difference=f - arm.f,
    )

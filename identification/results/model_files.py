"""Identified inertials written back into the model file that an arm came from: `write_urdf`, `write_mjcf`."""

import dataclasses
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.results.identification import Identification
from identification.results.physical import Physical
from identification.results.realised import Realised, matching_joints
from identification.results.to_write import bodies_of, given, prior_bodies
from plant import Arm, Body, Drive
from plant.mechanics.lumping import STANDARD
from plant.mechanics.mjcf_file import read_mjcf
from plant.mechanics.model_tree import ModelFile
from plant.mechanics.urdf_file import is_xacro, read_urdf
from plant.mechanics.xml_file import Edit, Element, parsed, spliced
from plant.models.edits import mjcf_inertial, mjcf_joint, urdf_friction, urdf_inertial
from plant.parts.arguments import known_options
from plant.parts.files import require_new, write_whole
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_SAME = 1e-13
"""Relative change of a body below which its bytes stay."""


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
    rotors: NDArray[np.float64]
    arm: Arm
    difference: NDArray[np.float64]

    def _short(self) -> str:
        return f"{self.path.name}, {len(self.bodies)} inertials, f within {np.abs(self.difference).max():.3g}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()} of what was asked for")
        rows = [(link, f"{body.mass:.4g}", *(f"{x:.3g}" for x in body.com)) for link, body in self.bodies.items()]
        yield Table(("link", "mass [kg]", "x [m]", "y [m]", "z [m]"), rows)


@known_options
def write_urdf(
    found_or_arm: Identification | Physical | Arm,
    source: str | Path,
    target: str | Path,
    *,
    prior: str | Path | Mapping[str, Body] | None = None,
    nearest: bool = False,
    friction: bool = True,
    overwrite: bool = False,
) -> WrittenModel:
    """Write a URDF file with the inertials of an arm; every byte that is not one of these numbers stays.

    The bodies have f, and are otherwise nearest to the prior in the log-det divergence of their pseudo-inertias: what f
    does not determine is the prior's. Bodies on fixed joints change with the link that carries them, each in proportion
    to what it is. Rotor inertias are in no body, since URDF has no place for them: the file's torque is the arm's
    without ``rotors * qdd``.

    Parameters
    ----------
    found_or_arm : Identification, Physical or Arm
        Whose chain is of this file (`Chain.from_urdf`).
    source, target : str or Path
        The file to start from, and the one to write.
    prior : str, Path or mapping of str to Body, optional
        Another URDF file with the same links, or bodies of links in their frames; by default the source's own.
    nearest : bool
        Write the nearest f that bodies can have where they cannot have this one, with a warning that says by how much
        it differs; in standard deviations where they are known, otherwise relative.
    friction : bool
        Of an Identification, write its viscous and Coulomb friction into <dynamics>, joint side.
    overwrite : bool
        Replace a target that is there.

    Returns
    -------
    WrittenModel

    Raises
    ------
    ValueError
        A source that does not describe the arm, f that no bodies have, a target that is there.

    See Also
    --------
    identification.write_mjcf, identification.nearest_physical, plant.Chain, plant.check_model

    Examples
    --------
    >>> from plant import Chain, Dynamics, read_robot
    >>> from identification import write_urdf
    >>> source = read_robot("ur5e").model
    >>> dynamics = Dynamics.from_chain(Chain.from_urdf(source, joints=["shoulder_lift", "elbow"]))
    >>> arm = dynamics.arm(dynamics.f())
    >>> written = write_urdf(arm, source, "new.urdf")
    >>> list(written.bodies)
    ['upper_arm', 'forearm', 'wrist_1', 'wrist_2', 'wrist_3']
    """
    path = require_new(target, overwrite)
    model, before = read_urdf(source), prior_bodies(prior, read_urdf)
    if is_xacro(parsed(source, "robot", "URDF")[0]):
        raise ValueError(f"source must be a URDF file; {source} is xacro. Expand it first.")
    arm, drive = given(found_or_arm, friction)
    got = bodies_of(found_or_arm, arm, model, before, nearest, np.zeros(arm.n))
    edits: list[Edit] = []
    for link, body in _changed(model, got):
        edits += urdf_inertial(model.data, model.links[link], body)
    if drive is not None:
        for i, joint in enumerate(matching_joints(arm, model)):
            levels = _friction(drive, i)
            if joint.element is not None and levels is not None:
                edits += urdf_friction(model.data, joint.element, *levels)
    return _write(path, model, edits, arm, got)


@known_options
def write_mjcf(
    found_or_arm: Identification | Physical | Arm,
    source: str | Path,
    target: str | Path,
    *,
    prior: str | Path | Mapping[str, Body] | None = None,
    nearest: bool = False,
    friction: bool = True,
    overwrite: bool = False,
) -> WrittenModel:
    """Write an MJCF file with the inertials of an arm; as `write_urdf`, with rotors in ``armature``.

    Parameters
    ----------
    found_or_arm : Identification, Physical or Arm
        Whose chain is of this file (`Chain.from_mjcf`).
    source, target : str or Path
    prior : str, Path or mapping of str to Body, optional
    nearest, friction, overwrite : bool
        Friction goes into ``damping`` and ``frictionloss``.

    Returns
    -------
    WrittenModel

    Raises
    ------
    ValueError
        As for `write_urdf`; an inertial in a file that is included; coupled motors, for which MJCF has no armature.

    See Also
    --------
    identification.write_urdf, plant.Chain

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import Chain, Dynamics
    >>> from identification import write_mjcf
    >>> inertial = '<inertial pos="0.2 0 0" mass="3" diaginertia="0.1 0.1 0.2"/>'
    >>> body = f'<body name="arm"><joint name="pivot" axis="0 1 0"/>{inertial}</body>'
    >>> _ = Path("arm.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    >>> dynamics = Dynamics.from_chain(Chain.from_mjcf("arm.xml"))
    >>> written = write_mjcf(dynamics.arm(dynamics.f()), "arm.xml", "new.xml")
    >>> list(written.bodies)
    ['arm']
    """
    path = require_new(target, overwrite)
    model, before = read_mjcf(source), prior_bodies(prior, read_mjcf)
    arm, drive = given(found_or_arm, friction)
    joints = matching_joints(arm, model)
    got = bodies_of(found_or_arm, arm, model, before, nearest, np.array([joint.armature for joint in joints]))
    if arm.dynamics.chain.coupling.matrix and got.rotors.any():
        raise ValueError(
            "rotors must turn with joints of their own; the arm's are coupled, and MJCF has no such. Use URDF."
        )
    edits: list[Edit] = []
    for link, body in _changed(model, got):
        edits += mjcf_inertial(model.data, _own(model, link), body)
    for i, (joint, rotor) in enumerate(zip(joints, got.rotors, strict=True)):
        values = {"armature": float(rotor)} if abs(rotor - joint.armature) > _SAME * abs(rotor) else {}
        if drive is not None and (levels := _friction(drive, i)) is not None:
            values |= dict(zip(("damping", "frictionloss"), levels, strict=True))
        if values and joint.element is not None:
            _own(model, joint.child)
            edits += mjcf_joint(model.data, joint.element, values)
    return _write(path, model, edits, arm, got)


def _friction(drive: Drive, joint: int) -> tuple[float, float] | None:
    """Viscous and Coulomb friction of a joint, joint side; None where motors are coupled."""
    if drive.coupling.matrix:
        return None
    return float(drive.joint_viscous()[joint]), float(drive.joint_coulomb()[joint])


def _changed(model: ModelFile, got: Realised) -> list[tuple[str, Body]]:
    """The bodies that are not the file's own."""
    changed = []
    for link, body in got.bodies.items():
        own = model.bodies[link]
        before, after = (np.zeros(len(STANDARD) - 1) if b is None else b.standard_parameters for b in (own, body))
        if np.abs(after - before).max() > _SAME * np.abs(before).max():
            changed.append((link, body))
    return changed


def _own(model: ModelFile, link: str) -> Element:
    """The element of a link that stands in the file itself."""
    element = model.links[link]
    if element.path != model.path:
        raise ValueError(f"inertials must stand in {model.path}; that of {link} is in {element.path}. Write that file.")
    return element


def _write(path: Path, model: ModelFile, edits: list[Edit], arm: Arm, got: Realised) -> WrittenModel:
    write_whole(path, [spliced(model.data, edits)])
    f = arm.f if got.exact else got.f
    return WrittenModel(path=path, bodies=got.bodies, rotors=got.rotors, arm=arm.dynamics.arm(f), difference=f - arm.f)

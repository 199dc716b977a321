"""Identified inertials written back into the model file that an arm came from: `write_model`."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from identification.equation_error import Estimate
from identification.results.nearest_bodies import Block, nearest_realisation
from identification.results.physical import Physical, table_of, whitening
from plant import Arm, Body, Drive, Link, Placement
from plant.mechanics import (
    STANDARD,
    Element,
    ModelFile,
    ModelJoint,
    fixed_to,
    from_pseudo_inertia,
    is_xacro,
    links_of_chain,
    parsed,
    prior_changes,
    prior_factor,
    read_mjcf,
    read_urdf,
    spliced,
)
from plant.models import (
    mjcf_inertial,
    mjcf_joint,
    mjcf_motors,
    mjcf_text,
    urdf_friction,
    urdf_inertial,
)
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Verdict,
    choice,
    frozen,
    instance,
    known_options,
    require_new,
    warn,
    write_whole,
)

# Largest relative difference at which the bodies of the prior count as having f already: some
# thousand roundings of a sum.
_EQUAL = 1e-12

_WIDTH = len(STANDARD)


@dataclass(frozen=True, kw_only=True)
class Realised:
    """Bodies by link, in the links' frames, rotors (n,) [kg m^2], and their f (p,).

    `exact`: whether that is the requested f.
    """

    bodies: dict[str, Body]
    rotors: Floats
    f: Floats
    exact: bool


@dataclass(frozen=True)
class _Inertial:
    """One body: its link, the index of the arm's joint that moves it, its pose, and its prior.

    The pose is in the frame of the arm's link at that joint.
    """

    link: str
    joint: int
    pose: Placement
    body: Body

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix T of the pose: it takes a pseudo-inertia P to T P T'."""
        # Rotation and translation of points in homogeneous coordinates.
        result = np.eye(4)
        result[:3, :3] = self.pose.rotation
        result[:3, 3] = self.pose.position
        return result


def bodies_of(
    found_or_arm: Estimate | Physical | Arm,
    arm: Arm,
    model: ModelFile,
    prior: Mapping[str, Body],
    nearest: bool,
    armature: Floats,
) -> Realised:
    """Bodies with the f of an arm; an error, or with `nearest` a warning, if there are none.

    `armature` (n,): rotor inertias of the file [kg m^2], where neither rig nor chain states any.
    """
    # The prior of the rotors: those of the rig or the chain, before those of the file.
    rotors = armature
    scale = None
    if isinstance(found_or_arm, Estimate):
        stated = found_or_arm.rig.drive.reflected_inertia()
        rotors = np.where(stated > 0, stated, rotors)
        # The nearest f in standard deviations, where they are known.
        scale = None if found_or_arm.covariance is None else whitening(found_or_arm)
    elif arm.dynamics.chain.bodies:
        stated = np.array([body.rotor for body in arm.dynamics.chain.bodies])
        rotors = np.where(stated > 0, stated, rotors)
    # A physical arm has rotors of its own.
    if isinstance(found_or_arm, Physical):
        rotors = np.array([body.rotor for body in found_or_arm.bodies])
    result = realised(arm, model, rotors, prior, scale)
    if result.exact:
        return result
    difference = result.f - arm.f
    names = arm.dynamics.names
    # Four numbers are enough to judge.
    largest = np.argsort(-np.abs(difference))[:4]
    text = ", ".join(f"{names[i]} {difference[i]:+.3g}" for i in largest)
    unmet = "no bodies with positive density, and no rotors, were found to have these f"
    if not nearest:
        raise ValueError(
            f"f must be what bodies can have; {unmet}: the nearest differ by {text}. Pass"
            " nearest=True."
        )
    warn(f"{unmet}; written are the nearest, which differ by {text}.")
    return result


def realised(
    arm: Arm, model: ModelFile, rotors: Floats, prior: Mapping[str, Body], scale: Floats | None
) -> Realised:
    """Bodies with the f of an arm, nearest to a prior; if there are none, those of the nearest f.

    `rotors` (n,): prior of the reflected rotor inertias [kg m^2]. `prior`: bodies of links, in
    their frames, instead of the file's. `scale` (p, p): whitening matrix of f, for the nearest f;
    by default relative to the contributions of the prior's bodies.
    """
    # Joints in the order of the arm's.
    joints = matching_joints(arm, model)
    # A misspelt link would be ignored silently.
    for name in prior:
        choice(
            "link of the prior",
            name,
            tuple(name for name, body in model.bodies.items() if body is not None),
        )
    inertials = _inertials(model, joints, prior)

    # 1. The f of the prior. Rotors that no number of f depends on cannot change it.
    B = np.array(arm.dynamics.lumping.matrix)
    shafts = B[:, STANDARD.index("J") :: _WIDTH]
    acts = np.abs(shafts).max(axis=0, initial=0.0) > 0
    rotors = np.where(acts, rotors, 0.0)
    pi = np.zeros(len(joints) * _WIDTH)
    for inertial in inertials:
        # Bodies of one link add up; the last standard parameter of a link is its rotor.
        body = inertial.body.seen_from(inertial.pose)
        pi[_WIDTH * inertial.joint :][: _WIDTH - 1] += body.standard_parameters
    pi[STANDARD.index("J") :: _WIDTH] = rotors
    if np.abs(B @ pi - arm.f).max() <= _EQUAL * np.abs(arm.f).max():
        bodies = {inertial.link: inertial.body for inertial in inertials}
        # Nothing is solved: bodies that have no other prior keep their bytes in the file.
        return Realised(bodies=bodies, rotors=rotors, f=arm.f, exact=True)

    # 2. Bodies with this f. A rotor without a prior stays zero. If no such bodies are found, half
    # of the inertia of its joint becomes its prior.
    blocks_of_bodies = [
        _block(inertial, B[:, _WIDTH * inertial.joint :][:, : _WIDTH - 1]) for inertial in inertials
    ]
    half = 0.5 * np.diag(arm.D(np.zeros(arm.n))).clip(min=0.0)
    for inertia in (rotors, np.where(rotors > 0, rotors, half)):
        turning = np.flatnonzero((inertia > 0) & acts)
        # A rotor is a pseudo-inertia of one number.
        blocks = blocks_of_bodies + [
            Block(np.sqrt(inertia[[[i]]]), shafts[:, [i]] * inertia[i]) for i in turning
        ]
        solution = nearest_realisation(blocks, arm.f)
        if solution is not None:
            return _result(inertials, turning, arm, *solution, exact=True)

    # 3. There are none: bodies with the nearest f.
    if scale is None:
        # Numbers of f count in units of the contributions to them.
        sizes = np.linalg.norm(np.column_stack([block.columns for block in blocks]), axis=1)
        scale = np.diag(1 / np.maximum(sizes, 1e-300))
    solution = nearest_realisation(blocks, arm.f, scale)
    if solution is None:
        raise ValueError("f must be finite; it is not. Identify again.")
    return _result(inertials, turning, arm, *solution, exact=False)


def matching_joints(arm: Arm, model: ModelFile) -> list[ModelJoint]:
    """Joints of the file that are those of the arm; an error if their geometry differs."""
    chain = arm.dynamics.chain
    names = [link.name for link in chain.links]
    # A joint that the file lacks is an error before any geometry is compared.
    for name in names:
        choice("joint of the arm in the file", name, tuple(model.joints))
    links = links_of_chain(model, names)[0]
    for link, of_file in zip(chain.links, links, strict=True):
        # A file has decimals: places agree within a nanometre.
        if link.prismatic != of_file.prismatic or not np.allclose(
            _poses(link), _poses(of_file), rtol=0, atol=1e-9
        ):
            raise ValueError(
                f"source must describe the arm; its joint {link.name} has another place or axis."
                " Make the arm's chain of this file: Chain.from_urdf, or from_mjcf."
            )
    return model.chain_joints(names)


def _poses(link: Link) -> Floats:
    """Rotation and position (2, 12) of a link at q = 0 and q = 1; together they fix its axis."""
    return np.array(
        [
            np.concatenate([ca.DM(part).full().ravel() for part in link.rotation(ca.SX(q))])
            for q in (0, 1)
        ]
    )


def _inertials(
    model: ModelFile, joints: list[ModelJoint], prior: Mapping[str, Body]
) -> list[_Inertial]:
    """Bodies that the joints move, on fixed joints as well, with their priors."""
    moving = [joint.name for joint in joints]
    links = links_of_chain(model, moving)[0]
    inertials = []
    for i, (joint, link) in enumerate(zip(joints, links, strict=True)):
        # Bodies on fixed joints move with the link: they share its f.
        for name, placement in fixed_to(model.joints, joint.child, moving).items():
            body = model.bodies[name]
            if body is not None:
                body = instance(
                    f"prior of {name}", prior.get(name, body), Body, "Give mass, com and inertia."
                )
                inertials.append(_Inertial(name, i, link.frame @ placement, body))
    return inertials


def _block(inertial: _Inertial, columns: Floats) -> Block:
    """Factor of a prior, and columns of f; a prior without extent is made a little thick."""
    L = prior_factor(inertial.body.standard_parameters)
    return Block(L, columns @ prior_changes(inertial.matrix @ L))


def _result(
    inertials: list[_Inertial],
    turning: NDArray[np.int64],
    arm: Arm,
    matrices: list[Floats],
    f: Floats,
    *,
    exact: bool,
) -> Realised:
    """Pseudo-inertias of bodies, then of the turning rotors, as bodies and inertias."""
    bodies = {
        inertial.link: Body.from_standard_parameters(from_pseudo_inertia(P))
        for inertial, P in zip(inertials, matrices, strict=False)
    }
    rotors = np.zeros(arm.n)
    # Rotors without a prior are not in the blocks: they stay zero.
    rotors[turning] = [float(matrix[0, 0]) for matrix in matrices[len(inertials) :]]
    return Realised(bodies=bodies, rotors=rotors, f=f, exact=exact)


_READERS = {"robot": read_urdf, "mujoco": read_mjcf}  # root of a model file -> its reader

_MJCF = (".xml", ".mjcf")  # suffixes of a target that is MJCF, whatever its source is

# Relative change of a body below which its bytes in the file stay: rounding of the solution, not a
# change.
_SAME = 1e-13


@frozen
class WrittenModel(Shown, Frozen):
    """A model file that was written, and the arm that it describes.

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
        That f minus the requested one; zero unless ``nearest=True`` was needed.
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
    found_or_arm: Estimate | Physical | Arm,
    source: str | Path,
    target: str | Path,
    *,
    prior: str | Path | Mapping[str, Body] | None = None,
    nearest: bool = False,
    friction: bool = True,
    motors: bool = True,
    overwrite: bool = False,
) -> WrittenModel:
    """Write a URDF or MJCF file with the inertials of an arm; all other bytes stay.

    The bodies have f, and are otherwise nearest to the prior in the log-det divergence of their
    pseudo-inertias: the prior determines what f does not. Bodies on fixed joints change with the
    link that carries them, in proportion to their own inertials. Rotor inertias are MJCF's
    ``armature``. URDF has no place for them: its torque is the arm's without ``rotors * qdd``.

    Parameters
    ----------
    found_or_arm : Identification, TorqueFit, Physical or Arm
        Whose chain is of this file (`Chain.from_urdf`, `Chain.from_mjcf`).
    source, target : str or Path
        The file to start from, and the one to write. From a URDF file, a target with the suffix
        .xml or .mjcf becomes MJCF: it has the bodies, joints, limits and inertials, but no shapes;
        joints that the arm lacks are fixed at zero.
    prior : str, Path or mapping of str to Body, optional
        Another model file with the same links, or bodies of links in their frames; by default the
        source's own.
    nearest : bool
        If no bodies have this f, write the nearest f that bodies can have, and warn of the
        difference. Distance is in standard deviations where they are known, otherwise relative to
        the contributions of the prior's bodies.
    friction : bool
        Of an identification or a torque fit, write its viscous and Coulomb friction, joint side:
        <dynamics> of URDF, ``damping`` and ``frictionloss`` of MJCF. These files have no friction
        that saturates, differs by direction or depends on the load.
    motors : bool
        Of an identification or a torque fit, give each joint a ``motor`` in MJCF that names its
        joints and has neither <actuator> nor <include>. It has the drive's gear, and its control is
        the torque of the motor [N m] within its limit. A ``dcmotor`` needs a resistance, which a
        drive, whose amplifiers control currents, does not have.
    overwrite : bool
        Replace an existing target.

    Returns
    -------
    WrittenModel

    Raises
    ------
    ValueError
        A source that does not describe the arm, f that no bodies have, an existing target; an
        inertial in an included file; coupled motors, for which MJCF has no armature.

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
    # The target is checked first, as the solution can take long.
    path = require_new(target, overwrite)
    model, root = _read(source)
    # A macro has no place for numbers.
    if is_xacro(root):
        raise ValueError(f"source must be a URDF file; {source} is xacro. Expand it first.")
    in_place = _keeps_urdf(root, path)
    arm, drive = _arm_of(found_or_arm)
    joints = matching_joints(arm, model)
    result = bodies_of(
        found_or_arm,
        arm,
        model,
        _prior_bodies(prior, model, joints),
        nearest,
        np.array([joint.armature for joint in joints]),
    )
    drive = _of_single_joints(drive, path, friction, motors and not in_place)
    levels = None
    if drive is not None and friction:
        levels = drive.joint_viscous(), drive.joint_coulomb()
        if without := drive.further_friction():
            warn(
                f"write_model: {path.name} holds viscous and Coulomb friction alone; it leaves out"
                f" {', '.join(without)}. Keep the rig beside it (write_robot)."
            )
    # 1. URDF in place: bytes of inertials and friction alone.
    if in_place:
        edits = []
        for link, body in _changed(model, result):
            edits += urdf_inertial(model.data, model.links[link], body)
        for i, joint in enumerate(joints):
            if joint.element is not None and levels is not None:
                viscous, coulomb = levels
                edits += urdf_friction(
                    model.data, joint.element, float(viscous[i]), float(coulomb[i])
                )
        return _write(path, spliced(model.data, edits), arm, result)
    if arm.dynamics.chain.coupling.matrix and result.rotors.any():
        raise ValueError(
            "rotors must turn with joints of their own; the arm's are coupled, and MJCF has no"
            " such. Use URDF."
        )
    # 2. MJCF: armature, damping and friction are attributes of joints.
    values = _joint_values(joints, result.rotors, levels)
    # Without a section, MJCF has joints and no motors.
    section = ""
    if drive is not None and motors:
        section = mjcf_motors([joint.name for joint in joints], drive)
    if root.tag == "robot":
        # A new file: shapes and meshes of the URDF do not come along.
        text = mjcf_text(model, result.bodies, values, arm.dynamics.chain.gravity, section)
        return _write(path, text, arm, result)
    edits = []
    for link, body in _changed(model, result):
        edits += mjcf_inertial(model.data, _in_file(model, link), body)
    for joint in joints:
        if values[joint.name] and joint.element is not None:
            # The joint must stand in this file as well.
            _in_file(model, joint.child)
            edits += mjcf_joint(model.data, joint.element, values[joint.name])
    # Motors refer to joints by name, and a section that the file has, or includes, stays.
    named = all(
        joint.element is not None and "name" in joint.element.attributes for joint in joints
    )
    if section and named and not root.all("actuator") and not root.all("include"):
        edits.append(root.child_edit(model.data, section))
    return _write(path, spliced(model.data, edits), arm, result)


def _joint_values(
    joints: Sequence[ModelJoint], rotors: Floats, levels: tuple[Floats, Floats] | None
) -> dict[str, dict[str, float]]:
    """Attributes of MJCF joints that change: armature and, of viscous and dry levels, friction."""
    values: dict[str, dict[str, float]] = {joint.name: {} for joint in joints}
    for i, (joint, rotor) in enumerate(zip(joints, rotors, strict=True)):
        # Equal armature keeps its text, as the decimals of a user.
        if abs(rotor - joint.armature) > _SAME * abs(rotor):
            values[joint.name]["armature"] = float(rotor)
        if levels is not None:
            viscous, coulomb = levels
            values[joint.name]["damping"] = float(viscous[i])
            values[joint.name]["frictionloss"] = float(coulomb[i])
    return values


def _read(path: str | Path) -> tuple[ModelFile, Element]:
    """A model file and its root."""
    # The suffix may be anything: the root element tells the format.
    root, _ = parsed(path, None, "URDF or MJCF")
    if root.tag not in _READERS:
        raise ValueError(
            f"{path} must hold a <robot> or a <mujoco>; got <{root.tag}>. Give a URDF or MJCF file."
        )
    # The root tells which reader the file needs.
    return _READERS[root.tag](path), root


def _of_single_joints(
    drive: Drive | None, path: Path, friction: bool, motors: bool
) -> Drive | None:
    """The drive, or None where its motors are coupled, which leaves out friction and motors."""
    # With coupled motors no joint has a motor or friction of its own: neither is written.
    if drive is None or not drive.coupling.matrix:
        return drive
    if omitted := ["friction"] * friction + ["motors"] * motors:
        warn(
            f"write_model: {path.name} holds drives of single joints alone; it leaves out the"
            f" {' and '.join(omitted)} of the coupled drive. Keep the rig beside it (write_robot)."
        )
    return None


def _keeps_urdf(root: Element, path: Path) -> bool:
    """Whether the target is URDF, as its source; MJCF is written into no URDF file."""
    suffix = path.suffix.lower()
    if root.tag == "robot":
        return suffix not in _MJCF
    if suffix == ".urdf":
        raise ValueError(
            f"target must be MJCF, as its source is; got {path.name}. Give it the suffix .xml."
        )
    return False


def _prior_bodies(
    prior: str | Path | Mapping[str, Body] | None, model: ModelFile, joints: list[ModelJoint]
) -> Mapping[str, Body]:
    """Bodies by link; a user's are of links that the joints move."""
    if prior is None:
        return {}
    if isinstance(prior, Mapping):
        moved = {inertial.link for inertial in _inertials(model, joints, {})}
        # Bodies of other links would be ignored silently; a whole file may well have them.
        for name in prior:
            if name in model.bodies and name not in moved:
                raise ValueError(
                    f"prior must be bodies of links that the arm moves; it does not move {name}."
                    " Leave it out."
                )
        return prior
    # Links without an inertial have no prior.
    return {name: body for name, body in _read(prior)[0].bodies.items() if body is not None}


def _arm_of(found_or_arm: Estimate | Physical | Arm) -> tuple[Arm, Drive | None]:
    """The arm, and the drive if it is known."""
    if isinstance(found_or_arm, Estimate):
        return found_or_arm.arm, found_or_arm.rig.drive
    arm = found_or_arm.arm if isinstance(found_or_arm, Physical) else found_or_arm
    if not isinstance(arm, Arm):
        raise ValueError(
            "found_or_arm must be what identify gave, or an Arm; got a"
            f" {type(found_or_arm).__name__}. Pass found, or found.arm."
        )
    return arm, None


def _changed(model: ModelFile, result: Realised) -> list[tuple[str, Body]]:
    """Bodies that differ from those of the file; the bytes of the others stay."""
    changed = []
    for link, body in result.bodies.items():
        present = model.bodies[link]
        # A link without an inertial has the numbers of a body of no mass.
        values = np.zeros(len(STANDARD) - 1) if present is None else present.standard_parameters
        difference = np.abs(body.standard_parameters - values).max()
        if difference > _SAME * np.abs(values).max():
            changed.append((link, body))
    return changed


def _in_file(model: ModelFile, link: str) -> Element:
    """The element of a link, which must stand in the file itself, not in one that it includes."""
    element = model.links[link]
    if element.path != model.path:
        raise ValueError(
            f"inertials must stand in {model.path}; that of {link} is in {element.path}. Write that"
            " file."
        )
    return element


def _write(path: Path, data: bytes, arm: Arm, result: Realised) -> WrittenModel:
    """Write the file, and describe it."""
    write_whole(path, [data])
    f = arm.f if result.exact else result.f  # without the rounding of the solution
    return WrittenModel(
        path=path,
        bodies=result.bodies,
        rotors=result.rotors,
        arm=arm.dynamics.arm(f),
        difference=f - arm.f,
    )

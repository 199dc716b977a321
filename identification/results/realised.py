"""Bodies of a model file that have an identified f: variables, equations and result."""

import dataclasses
from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from identification.results.identification import Identification
from identification.results.nearest_bodies import Block, nearest_realisation
from identification.results.physical import Physical, whitening
from plant import Arm, Body
from plant.mechanics.body import from_pseudo_inertia, prior_changes, prior_factor
from plant.mechanics.link import Link
from plant.mechanics.lumping import STANDARD
from plant.mechanics.model_tree import ModelFile, ModelJoint, fixed_to, links_of_chain
from plant.mechanics.placement import Placement
from plant.parts.arguments import choice, instance
from plant.parts.fields import Floats
from plant.parts.messages import warn

# Relative difference of f below which the bodies of the prior have it already: some thousand
# roundings of a sum.
_SAME = 1e-12

_WIDTH = len(STANDARD)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Realised:
    """Bodies by link, in the links' frames, rotors (n,) [kg m^2], and their f (p,).

    `exact`: whether that is the requested f.
    """

    bodies: dict[str, Body]
    rotors: Floats
    f: Floats
    exact: bool


@dataclasses.dataclass(frozen=True)
class _Inertial:
    """One body of the file: its link, the joint that moves it, its pose there, and its prior."""

    link: str
    joint: int
    pose: Placement
    body: Body

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix of the pose, under which a pseudo-inertia is congruent."""
        # Rotation and translation of points in homogeneous coordinates.
        result = np.eye(4)
        result[:3, :3] = self.pose.rotation
        result[:3, 3] = self.pose.position
        return result


def bodies_of(
    found_or_arm: Identification | Physical | Arm,
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
    if isinstance(found_or_arm, Identification):
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
    if np.abs(B @ pi - arm.f).max() <= _SAME * np.abs(arm.f).max():
        bodies = {inertial.link: inertial.body for inertial in inertials}
        # Nothing to solve: so the bytes of the file stay.
        return Realised(bodies=bodies, rotors=rotors, f=arm.f, exact=True)

    # 2. Bodies with this f. A rotor without a prior stays zero; if that fails, half of the inertia
    # of its joint is the prior.
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
    """Rotation and position of a link at two positions, (2, 12), which determine its axis."""
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

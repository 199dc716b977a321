"""The bodies of a model file that have what was identified: variables, equations, and what they
come to.
"""

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

_SAME = 1e-12  # relative difference of f below which bodies have it already

_WIDTH = len(STANDARD)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Realised:
    """Bodies by link, in the links' frames; rotors (n,) [kg m^2]; the f (p,) that they have;
    whether it was met.
    """

    bodies: dict[str, Body]
    rotors: Floats
    f: Floats
    exact: bool


@dataclasses.dataclass(frozen=True)
class _Inertial:
    """One body of the file: its link, the joint that moves it, its pose in that joint's frame,
    the prior.
    """

    link: str
    joint: int
    pose: Placement
    body: Body

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix of the pose, under which a pseudo-inertia is congruent."""
        result = np.eye(4)
        result[:3, :3], result[:3, 3] = self.pose.rotation, self.pose.position
        return result


def bodies_of(
    found_or_arm: Identification | Physical | Arm,
    arm: Arm,
    model: ModelFile,
    prior: Mapping[str, Body],
    nearest: bool,
    armature: Floats,
) -> Realised:
    """What is to be written, or a refusal."""
    rotors = armature
    scale = None
    if isinstance(found_or_arm, Identification):
        stated = found_or_arm.rig.drive.reflected_inertia()
        rotors = np.where(stated > 0, stated, rotors)
        scale = None if found_or_arm.covariance is None else whitening(found_or_arm)
    elif arm.dynamics.chain.bodies:
        stated = np.array([body.rotor for body in arm.dynamics.chain.bodies])
        rotors = np.where(stated > 0, stated, rotors)
    if isinstance(found_or_arm, Physical):
        rotors = np.array([body.rotor for body in found_or_arm.bodies])
    got = realised(arm, model, rotors, prior, scale)
    if got.exact:
        return got
    difference = got.f - arm.f
    names = arm.dynamics.names
    text = ", ".join(
        f"{names[i]} {difference[i]:+.3g}" for i in np.argsort(-np.abs(difference))[:4]
    )
    unmet = "no bodies with positive density, and no rotors, were found to have these f"
    if not nearest:
        raise ValueError(
            f"f must be what bodies can have; {unmet}: the nearest differ by {text}. Pass"
            " nearest=True."
        )
    warn(f"{unmet}; written are the nearest, which differ by {text}.")
    return got


def realised(
    arm: Arm, model: ModelFile, rotors: Floats, prior: Mapping[str, Body], scale: Floats | None
) -> Realised:
    """The bodies that have f of an arm, nearest to a prior; where none have it, those of the
    nearest f.

    `rotors` (n,): prior of the reflected rotor inertias [kg m^2]. `prior`: bodies of links, in
    their frames, instead of the file's. `scale` (p, p): whitening matrix of f, for the nearest one;
    by default relative to what the prior's bodies give.
    """
    joints = matching_joints(arm, model)
    for name in prior:
        choice(
            "link of the prior",
            name,
            tuple(name for name, body in model.bodies.items() if body is not None),
        )
    inertials = _inertials(model, joints, prior)
    B = np.array(arm.dynamics.lumping.matrix)
    shafts = B[:, STANDARD.index("J") :: _WIDTH]
    rotors = np.where(np.abs(shafts).max(axis=0, initial=0.0) > 0, rotors, 0.0)
    pi = np.zeros(len(joints) * _WIDTH)
    for each in inertials:
        pi[_WIDTH * each.joint :][: _WIDTH - 1] += each.body.seen_from(
            each.pose
        ).standard_parameters
    pi[STANDARD.index("J") :: _WIDTH] = rotors
    at_prior = B @ pi
    if np.abs(at_prior - arm.f).max() <= _SAME * np.abs(arm.f).max():
        return Realised(
            bodies={each.link: each.body for each in inertials}, rotors=rotors, f=arm.f, exact=True
        )
    bodies = [_block(each, B[:, _WIDTH * each.joint :][:, : _WIDTH - 1]) for each in inertials]
    guessed = np.where(rotors > 0, rotors, 0.5 * np.diag(arm.D(np.zeros(arm.n))).clip(min=0.0))
    for inertia in (rotors, guessed):
        turning = np.flatnonzero((inertia > 0) & (np.abs(shafts).max(axis=0, initial=0.0) > 0))
        blocks = bodies + [
            Block(np.sqrt(inertia[[[i]]]), shafts[:, [i]] * inertia[i]) for i in turning
        ]
        if found := nearest_realisation(blocks, arm.f):
            return _result(inertials, turning, arm, *found, exact=True)
    if scale is None:
        scale = np.diag(
            1
            / np.maximum(
                np.linalg.norm(np.column_stack([b.columns for b in blocks]), axis=1), 1e-300
            )
        )
    if (near := nearest_realisation(blocks, arm.f, scale)) is None:
        raise ValueError("f must be finite; it is not. Identify again.")
    return _result(inertials, turning, arm, *near, exact=False)


def matching_joints(arm: Arm, model: ModelFile) -> list[ModelJoint]:
    """The file's joints of this arm; refused where the geometry is another one."""
    chain = arm.dynamics.chain
    names = [link.name for link in chain.links]
    for name in names:
        choice("joint of the arm in the file", name, tuple(model.joints))
    links, *_ = links_of_chain(model, names)
    for mine, other in zip(chain.links, links, strict=True):
        if mine.prismatic != other.prismatic or not np.allclose(
            _poses(mine), _poses(other), rtol=0, atol=1e-9
        ):
            raise ValueError(
                f"source must describe the arm; its joint {mine.name} has another place or axis."
                " Make the arm's chain of this file: Chain.from_urdf, or from_mjcf."
            )
    return model.chain_joints(names)


def _poses(link: Link) -> Floats:
    """Rotation and position of a link at two positions, (2, 12)."""
    return np.array(
        [
            np.concatenate([ca.DM(part).full().ravel() for part in link.rotation(ca.SX(q))])
            for q in (0, 1)
        ]
    )


def _inertials(
    model: ModelFile, joints: list[ModelJoint], prior: Mapping[str, Body]
) -> list[_Inertial]:
    """The bodies behind the joints, with their priors."""
    moving = [joint.name for joint in joints]
    links, *_ = links_of_chain(model, moving)
    found = []
    for i, (joint, link) in enumerate(zip(joints, links, strict=True)):
        for name, placement in fixed_to(model.joints, joint.child, moving).items():
            body = model.bodies[name]
            if body is not None:
                body = instance(
                    f"prior of {name}", prior.get(name, body), Body, "Give mass, com and inertia."
                )
                found.append(_Inertial(name, i, link.frame @ placement, body))
    return found


def _block(each: _Inertial, columns: Floats) -> Block:
    """The prior's factor, and the columns of f; a prior without extent is made a little thick."""
    L = prior_factor(each.body.standard_parameters)
    return Block(L, columns @ prior_changes(each.matrix @ L))


def _result(
    inertials: list[_Inertial],
    turning: NDArray[np.int64],
    arm: Arm,
    matrices: list[Floats],
    f: Floats,
    *,
    exact: bool,
) -> Realised:
    pairs = zip(inertials, matrices, strict=False)  # behind the bodies come the rotors
    bodies = {each.link: Body.from_standard_parameters(from_pseudo_inertia(P)) for each, P in pairs}
    rotors = np.zeros(arm.n)
    rotors[turning] = [float(matrix[0, 0]) for matrix in matrices[len(inertials) :]]
    return Realised(bodies=bodies, rotors=rotors, f=f, exact=exact)

"""A model file as a tree of links and joints, and the chain that lies in it; fixed joints lumped."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.limits import Limits
from plant.mechanics.link import Link
from plant.mechanics.placement import Placement
from plant.mechanics.xml_file import Element
from plant.parts.arguments import choice
from plant.parts.labels import joint_labels

__all__ = ["MOVING", "ModelFile", "ModelJoint", "fixed_to", "links_of_chain"]

MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # -> whether it slides


@dataclasses.dataclass(kw_only=True)
class ModelJoint:
    """A joint as a model file has it.

    `origin` is the pose of the child link's frame at zero, in the parent link's frame; `axis` and `anchor`, a point of
    it, are in the child link's frame; `zero` is the joint's coordinate there.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Placement
    axis: NDArray[np.float64]
    mimics: bool = False
    anchor: tuple[float, float, float] = (0.0, 0.0, 0.0)
    zero: float = 0.0
    limits: tuple[float, float, float, float] = (-np.inf, np.inf, np.inf, np.inf)
    """Lower and upper position, velocity, effort."""
    armature: float = 0.0
    element: Element | None = None


@dataclasses.dataclass(kw_only=True)
class ModelFile:
    """What a model file says: links by name with their bodies (None without mass), joints, gravity.

    `inertials` holds the element of each body, the frame of its inertia in the link's frame, and the element of each
    link; `data` the bytes of the file.
    """

    path: Path
    data: bytes
    bodies: dict[str, Body | None]
    joints: dict[str, ModelJoint]
    links: dict[str, Element]
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)

    def chain_joints(self, names: Sequence[str] | None = None) -> list[ModelJoint]:
        """The joints of the chain, base first; by default all that move."""
        _require_tree(self.bodies, self.joints)
        return _chosen(self.joints, names)


def links_of_chain(model: ModelFile, names: Sequence[str] | None) -> tuple[tuple[Link, ...], tuple[Body, ...], Limits]:
    """Links, bodies and limits of the chain of these joints; see `Chain.from_urdf`."""
    chosen, every = model.chain_joints(names), model.joints
    links, made = [], []
    at = Placement()  # pose of the last chosen joint's frame in the link being walked
    for i, joint in enumerate(chosen):
        before, start = Placement(), chosen[i - 1].child if i else None
        for step in _way(every, start, joint):
            before = before @ step.origin
        on_axis = Placement(rotation=_axis_frame(joint.axis), position=joint.anchor)
        slides, frame = MOVING[joint.kind], on_axis.inverse()
        zero = {"d" if slides else "theta": -joint.zero}
        links.append(Link(name=joint.name, prismatic=slides, before=at @ before @ on_axis, frame=frame, **zero))
        at = frame
        made.append(_lumped(model.bodies, every, joint.child, {other.name for other in chosen}))
    for label, body in zip(joint_labels([joint.name for joint in chosen], len(chosen)), made, strict=True):
        body.require_physical(f"behind {label}")
    made = [dataclasses.replace(body, rotor=joint.armature) for body, joint in zip(made, chosen, strict=True)]
    lower, upper, velocity, effort = np.array([joint.limits for joint in chosen]).T
    return tuple(links), tuple(made), Limits(lower=lower, upper=upper, velocity=velocity, effort=effort)


# -- the tree -------------------------------------------------------------------------------------------------------
def _require_tree(bodies: dict[str, Body | None], joints: dict[str, ModelJoint]) -> None:
    """Refuse missing links, links with two parents, and loops."""
    parents: dict[str, ModelJoint] = {}
    for joint in joints.values():
        for link in (joint.parent, joint.child):
            if link not in bodies:
                choice(f"link of joint {joint.name}", link, tuple(bodies))
        if joint.child in parents:
            raise ValueError(
                f"link {joint.child} must hang on one joint; it hangs on {parents[joint.child].name} and {joint.name}. "
                "Only trees can be read."
            )
        parents[joint.child] = joint
    for name in bodies:
        seen, link = set(), name
        while link in parents:
            if link in seen:
                raise ValueError(f"links must form a tree; {name} hangs on itself. Remove a joint of the loop.")
            seen.add(link)
            link = parents[link].parent


def _chosen(every: dict[str, ModelJoint], names: Sequence[str] | None) -> list[ModelJoint]:
    """The joints of the chain, from the base outwards."""
    moving = [joint for joint in every.values() if joint.kind in MOVING]
    if names is None:
        chosen = _ordered(every, moving)
        if chosen is None:
            raise ValueError(
                f"joints must be named where the file has a tree; it has {', '.join(j.name for j in moving)}. "
                "Pass joints=[...], base first."
            )
    else:
        if isinstance(names, str) or not names:
            raise ValueError(f"joints must be a list of at least one name; got {names!r}. Write ['name', ...].")
        names = list(names)
        for name in names:
            if name in every and every[name].kind == "fixed":
                raise ValueError(f"joints must move; {name} is fixed. Leave it out, its link is lumped.")
            choice("joints", name, tuple(joint.name for joint in moving))
        twice = [name for i, name in enumerate(names) if name in names[:i]]
        if twice:
            raise ValueError(f"joints must be named once each; {twice[0]} comes twice. Leave one out.")
        chosen = _ordered(every, [every[name] for name in names])
        if chosen is None or [joint.name for joint in chosen] != names:
            raise ValueError(f"joints must lie behind each other, base first; got {', '.join(names)}. Reorder.")
    if not chosen:
        raise ValueError("the file must have at least one joint that moves; it has none. Give another one.")
    for joint in chosen:
        if joint.mimics:
            raise ValueError(f"joints must move on their own; {joint.name} mimics another one. Leave it out.")
    return chosen


def _depth(every: dict[str, ModelJoint], joint: ModelJoint) -> list[ModelJoint]:
    """Joints between the base and this one, from the base outwards, with this one."""
    parents, way = {other.child: other for other in every.values()}, [joint]
    while way[0].parent in parents:
        way.insert(0, parents[way[0].parent])
    return way


def _ordered(every: dict[str, ModelJoint], joints: list[ModelJoint]) -> list[ModelJoint] | None:
    """These joints from the base outwards; None if they are not all on one way."""
    ways = sorted((_depth(every, joint) for joint in joints), key=len)
    if any(shorter != longer[: len(shorter)] for shorter, longer in pairwise(ways)):
        return None
    return [way[-1] for way in ways]


def _way(every: dict[str, ModelJoint], start: str | None, joint: ModelJoint) -> list[ModelJoint]:
    """Joints from behind a link (None: the base) to this joint; those between are fixed, or held at zero."""
    way = _depth(every, joint)
    if start is not None:
        way = way[next(i for i, other in enumerate(way) if other.child == start) + 1 :]
    return way


def fixed_to(every: dict[str, ModelJoint], link: str, moving: Collection[str]) -> dict[str, Placement]:
    """Everything that moves with a link: name -> pose in its frame; joints that are none of `moving` are at zero."""
    found, waiting = {}, [(link, Placement())]
    while waiting:
        name, placement = waiting.pop()
        found[name] = placement
        waiting += [
            (joint.child, placement @ joint.origin)
            for joint in every.values()
            if joint.parent == name and joint.name not in moving
        ]
    return found


def _lumped(bodies: dict[str, Body | None], every: dict[str, ModelJoint], link: str, moving: Collection[str]) -> Body:
    """Everything that moves with a link, as one Body in its frame."""
    found = None
    for name, placement in fixed_to(every, link, moving).items():
        if (body := bodies[name]) is not None:
            body = body.seen_from(placement)
            found = body if found is None else found.joined(body)
    if found is None:
        raise ValueError(f"link {link} must have a mass, or something with a mass fixed to it; it has none. Add one.")
    return found


def _axis_frame(axis: NDArray[np.float64]) -> NDArray[np.float64]:
    """A rotation whose z axis is this axis; the smallest turn that takes z there."""
    z = axis / np.linalg.norm(axis)
    if abs(z[0]) < 1e-12 and abs(z[1]) < 1e-12:
        return np.eye(3) if z[2] > 0 else np.diag([1.0, -1.0, -1.0])
    x = np.cross((0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])

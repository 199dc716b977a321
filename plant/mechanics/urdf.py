"""URDF reader: links and bodies of a chain, fixed joints lumped, numbers checked, nothing executed or fetched."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.link import Link
from plant.mechanics.placement import Placement
from plant.mechanics.urdf_file import MOVING, UrdfJoint, joints_of, links_of, parsed
from plant.parts.arguments import choice
from plant.parts.labels import joint_labels

__all__ = ["links_from_urdf"]


def links_from_urdf(path: str | Path, joints: Sequence[str] | None) -> tuple[tuple[Link, ...], tuple[Body, ...]]:
    """Links and bodies (tuples) of the chain; see `Chain.from_urdf`."""
    robot = parsed(path)
    bodies, every = links_of(robot), joints_of(robot)
    _require_tree(bodies, every)
    chosen = _chosen(every, joints)
    links, made = [], []
    at = Placement()  # pose of the last chosen joint's frame in the link being walked
    for i, joint in enumerate(chosen):
        before, start = Placement(), chosen[i - 1].child if i else None
        for step in _way(every, start, joint):
            before = before @ step.origin
        on_axis = Placement(rotation=_axis_frame(joint.axis))
        links.append(
            Link(name=joint.name, prismatic=MOVING[joint.kind], before=at @ before @ on_axis, frame=on_axis.inverse())
        )
        at = on_axis.inverse()
        made.append(_lumped(bodies, every, joint.child, {other.name for other in chosen}))
    for label, body in zip(joint_labels([joint.name for joint in chosen], len(chosen)), made, strict=True):
        body.require_physical(f"behind {label}")
    return tuple(links), tuple(made)


# -- reading --------------------------------------------------------------------------------------------------------


# -- the tree -------------------------------------------------------------------------------------------------------
def _require_tree(bodies: dict[str, Body | None], joints: dict[str, UrdfJoint]) -> None:
    """Refuse missing links, links with two parents, and loops."""
    parents: dict[str, UrdfJoint] = {}
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


def _chosen(every: dict[str, UrdfJoint], names: Sequence[str] | None) -> list[UrdfJoint]:
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


def _depth(every: dict[str, UrdfJoint], joint: UrdfJoint) -> list[UrdfJoint]:
    """Joints between the base and this one, from the base outwards, with this one."""
    parents, way = {other.child: other for other in every.values()}, [joint]
    while way[0].parent in parents:
        way.insert(0, parents[way[0].parent])
    return way


def _ordered(every: dict[str, UrdfJoint], joints: list[UrdfJoint]) -> list[UrdfJoint] | None:
    """These joints from the base outwards; None if they are not all on one way."""
    ways = sorted((_depth(every, joint) for joint in joints), key=len)
    if any(shorter != longer[: len(shorter)] for shorter, longer in pairwise(ways)):
        return None
    return [way[-1] for way in ways]


def _way(every: dict[str, UrdfJoint], start: str | None, joint: UrdfJoint) -> list[UrdfJoint]:
    """Joints from behind a link (None: the base) to this joint; those between are fixed, or held at zero."""
    way = _depth(every, joint)
    if start is not None:
        way = way[next(i for i, other in enumerate(way) if other.child == start) + 1 :]
    return way


def _lumped(bodies: dict[str, Body | None], every: dict[str, UrdfJoint], link: str, moving: Collection[str]) -> Body:
    """Everything that moves with a link, as one Body in its frame."""
    found, waiting = None, [(link, Placement())]
    while waiting:
        name, placement = waiting.pop()
        if (body := bodies[name]) is not None:
            body = body.seen_from(placement)
            found = body if found is None else found.joined(body)
        waiting += [
            (joint.child, placement @ joint.origin)
            for joint in every.values()
            if joint.parent == name and joint.name not in moving
        ]
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

"""URDF reader: links and bodies of a chain, fixed joints lumped, numbers checked, nothing executed or fetched."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.link import Link
from plant.mechanics.placement import Placement
from plant.mechanics.urdf_file import HERE, MOVING, UrdfJoint, joints_of, links_of, parsed
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
    parents, hanging = {joint.child: joint for joint in every.values()}, dict[str, list[UrdfJoint]]()
    for joint in every.values():
        hanging.setdefault(joint.parent, []).append(joint)
    moving = {joint.name for joint in chosen}
    at = Placement()  # pose of the last chosen joint's frame in the link being walked
    for i, joint in enumerate(chosen):
        before, start = Placement(), chosen[i - 1].child if i else None
        for step in _way(parents, start, joint):
            before = before if step.origin is HERE else before @ step.origin
        on_axis = Placement(rotation=_axis_frame(joint.axis))
        links.append(
            Link(name=joint.name, prismatic=MOVING[joint.kind], before=at @ before @ on_axis, frame=on_axis.inverse())
        )
        at = on_axis.inverse()
        made.append(_lumped(bodies, hanging, joint.child, moving))
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
    sound: set[str] = set()
    for name in bodies:
        seen, link = dict[str, None](), name
        while link in parents and link not in sound:
            if link in seen:
                raise ValueError(f"links must form a tree; {name} hangs on itself. Remove a joint of the loop.")
            seen[link] = None
            link = parents[link].parent
        sound.update(seen)


def _chosen(every: dict[str, UrdfJoint], names: Sequence[str] | None) -> list[UrdfJoint]:
    """The joints of the chain, from the base outwards."""
    moving = [joint for joint in every.values() if joint.kind in MOVING]
    if names is None:
        chosen = _ordered(every, moving)
        if chosen is None:
            raise ValueError(
                f"joints must be named where the file has a tree; it has {', '.join(j.name for j in moving):.300}. "
                "Pass joints=[...], base first."
            )
    else:
        if isinstance(names, str) or not names:
            raise ValueError(f"joints must be a list of at least one name; got {names!r}. Write ['name', ...].")
        names = list(names)
        for name in names:
            if name in every and every[name].kind == "fixed":
                raise ValueError(f"joints must move; {name} is fixed. Leave it out, its link is lumped.")
            if name not in every or every[name].kind not in MOVING:
                choice("joints", name, tuple(joint.name for joint in moving))
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            raise ValueError(f"joints must be named once each; {twice} comes twice. Leave one out.")
        chosen = _ordered(every, [every[name] for name in names])
        if chosen is None or [joint.name for joint in chosen] != names:
            raise ValueError(f"joints must lie behind each other, base first; got {', '.join(names):.300}. Reorder.")
    if not chosen:
        raise ValueError("the file must have at least one joint that moves; it has none. Give another one.")
    for joint in chosen:
        if joint.mimics:
            raise ValueError(f"joints must move on their own; {joint.name} mimics another one. Leave it out.")
    return chosen


def _ordered(every: dict[str, UrdfJoint], joints: list[UrdfJoint]) -> list[UrdfJoint] | None:
    """These joints from the base outwards; None if they are not all on one way."""
    parents, depths = {joint.child: joint for joint in every.values()}, dict[str, int]()
    for joint in joints:
        way = [joint]
        while way[-1].parent in parents and way[-1].name not in depths:
            way.append(parents[way[-1].parent])
        depth = depths.get(way[-1].name, 0)
        for steps, other in enumerate(reversed(way)):
            depths[other.name] = depth + steps
    ordered = sorted(joints, key=lambda joint: depths[joint.name])
    for before, joint in pairwise(ordered):
        steps, other = depths[joint.name] - depths[before.name], joint
        for _ in range(steps):
            other = parents[other.parent]
        if not steps or other is not before:
            return None
    return ordered


def _way(parents: dict[str, UrdfJoint], start: str | None, joint: UrdfJoint) -> list[UrdfJoint]:
    """Joints from behind a link (None: the base) to this joint; those between are fixed, or held at zero."""
    way = [joint]
    while way[-1].parent != start and way[-1].parent in parents:
        way.append(parents[way[-1].parent])
    return way[::-1]


def _lumped(
    bodies: dict[str, Body | None], hanging: dict[str, list[UrdfJoint]], link: str, moving: Collection[str]
) -> Body:
    """Everything that moves with a link, as one Body in its frame."""
    found, waiting = None, [(link, Placement())]
    while waiting:
        name, placement = waiting.pop()
        if (body := bodies[name]) is not None:
            body = body.seen_from(placement)
            found = body if found is None else found.joined(body)
        for joint in hanging.get(name, ()):
            if joint.name not in moving:
                waiting.append((joint.child, placement if joint.origin is HERE else placement @ joint.origin))
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

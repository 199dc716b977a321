"""URDF reader: links and bodies of a chain, fixed joints lumped, numbers checked, nothing executed or fetched."""

from __future__ import annotations

import dataclasses
import re
import xml.parsers.expat
from collections.abc import Collection, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.link import Link
from plant.mechanics.placement import Placement
from plant.parts.arguments import choice
from plant.parts.labels import joint_labels

__all__ = ["links_from_urdf"]

_LARGEST = 5_000_000
"""Bytes; the largest real files have a few hundred thousand."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")

_MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # -> whether it slides


@dataclasses.dataclass
class _Element:
    tag: str
    attributes: dict[str, str]
    children: list[_Element]

    def find(self, tag: str) -> _Element | None:
        return next((child for child in self.children if child.tag == tag), None)

    def all(self, tag: str) -> list[_Element]:
        return [child for child in self.children if child.tag == tag]


@dataclasses.dataclass
class _Joint:
    name: str
    kind: str
    parent: str
    child: str
    origin: Placement
    axis: NDArray[np.float64]
    mimics: bool


def links_from_urdf(path: str | Path, joints: Sequence[str] | None) -> tuple[tuple[Link, ...], tuple[Body, ...]]:
    """Links and bodies (tuples) of the chain; see `Chain.from_urdf`."""
    robot = _parsed(path)
    bodies, every = _links(robot), _joints(robot)
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
            Link(name=joint.name, prismatic=_MOVING[joint.kind], before=at @ before @ on_axis, frame=on_axis.inverse())
        )
        at = on_axis.inverse()
        made.append(_lumped(bodies, every, joint.child, {other.name for other in chosen}))
    for label, body in zip(joint_labels([joint.name for joint in chosen], len(chosen)), made, strict=True):
        body.require_physical(f"behind {label}")
    return tuple(links), tuple(made)


# -- reading --------------------------------------------------------------------------------------------------------
def _parsed(path: str | Path) -> _Element:
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise ValueError("path must be the name of a URDF file; got its text. Write it to a file first.")
    path = Path(path)
    data = path.read_bytes()
    if len(data) > _LARGEST:
        raise ValueError(f"{path} must be a URDF file of at most {_LARGEST} bytes; it has {len(data)}. Give the file.")
    root: list[_Element] = []
    open_elements: list[_Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = _Element(tag, attributes, [])
        (open_elements[-1].children if open_elements else root).append(element)
        open_elements.append(element)

    def refuse(*_: object) -> None:
        raise ValueError(f"{path} must not declare a document type or entities; it does. Remove them.")

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, lambda tag: open_elements.pop()
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except xml.parsers.expat.ExpatError as error:
        raise ValueError(f"{path} must be well-formed XML; {error}. Correct the file.") from None
    if root[0].tag != "robot":
        raise ValueError(f"{path} must hold a <robot>; got <{root[0].tag}>. Give a URDF file, xacro expanded.")
    return root[0]


def _numbers(
    element: _Element | None, attribute: str, count: int, default: str | None, where: str
) -> NDArray[np.float64]:
    """So many finite numbers of an attribute."""
    text = default if element is None else element.attributes.get(attribute, default)
    if text is None:
        raise ValueError(f"{where} must have {attribute}; it has none. Add it.")
    words = text.split()
    values = np.array([float(word) for word in words if _NUMBER.fullmatch(word)])
    if len(words) != count or values.shape != (count,) or not np.isfinite(values).all():
        what = "one finite number" if count == 1 else f"{count} finite numbers"
        raise ValueError(f"{where} must have {what} in {attribute}; got {text!r:.60}. Write them like 17.4 or 1e-3.")
    return values


def _origin(element: _Element, where: str) -> Placement:
    origin = element.find("origin")
    position = _numbers(origin, "xyz", 3, "0 0 0", f"{where}, origin")
    roll, pitch, yaw = _numbers(origin, "rpy", 3, "0 0 0", f"{where}, origin")
    return Placement.of_angles(roll, pitch, yaw, position)


def _links(robot: _Element) -> dict[str, Body | None]:
    """Name of a link -> its Body in its own frame, or None where it has no mass."""
    bodies: dict[str, Body | None] = {}
    if not robot.all("link"):
        raise ValueError("the file must have links; it has none. Give a URDF file, xacro expanded.")
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        where = f"link {name}"
        if not name or name in bodies:
            raise ValueError(f"links must have names of their own; got {name!r} {'twice' if name else ''}. Name it.")
        inertial, bodies[name] = element.find("inertial"), None
        if len(element.all("inertial")) > 1:
            raise ValueError(f"{where} must have one <inertial>; it has {len(element.all('inertial'))}. Join them.")
        if inertial is not None:
            mass = _numbers(inertial.find("mass"), "value", 1, None, f"{where}, mass")[0]
            matrix = inertial.find("inertia")
            inertia = [
                _numbers(matrix, key, 1, None, f"{where}, inertia")[0]
                for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            ]
            if mass < 0:
                raise ValueError(f"{where} must have a positive mass; got {mass}. Correct it.")
            if mass or any(inertia):
                body = Body(mass=mass, com=np.zeros(3), inertia=inertia)
                body.require_physical(name)
                bodies[name] = body.seen_from(_origin(inertial, where))
    return bodies


def _joints(robot: _Element) -> dict[str, _Joint]:
    """Name of a joint -> _Joint."""
    joints: dict[str, _Joint] = {}
    for element in robot.all("joint"):
        name, kind = element.attributes.get("name", ""), element.attributes.get("type", "")
        where = f"joint {name}"
        if not name or name in joints:
            raise ValueError(f"joints must have names of their own; got {name!r} {'twice' if name else ''}. Name it.")
        if kind in ("floating", "planar"):
            raise ValueError(f"{where} must move about or along one axis; it is {kind}. Replace it by single joints.")
        choice(f"type of {where}", kind, (*_MOVING, "fixed"))
        ends = [element.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.attributes.get("link", "") for end in ends)
        if not parent or not child:
            raise ValueError(f"{where} must have a parent and a child link; one is missing. Add it.")
        axis = _numbers(element.find("axis"), "xyz", 3, "1 0 0", f"{where}, axis")
        if kind in _MOVING and np.linalg.norm(axis) < 1e-6:
            raise ValueError(f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it.")
        mimics = element.find("mimic") is not None
        joints[name] = _Joint(name, kind, parent, child, _origin(element, where), axis, mimics)
    return joints


# -- the tree -------------------------------------------------------------------------------------------------------
def _require_tree(bodies: dict[str, Body | None], joints: dict[str, _Joint]) -> None:
    """Refuse missing links, links with two parents, and loops."""
    parents: dict[str, _Joint] = {}
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


def _chosen(every: dict[str, _Joint], names: Sequence[str] | None) -> list[_Joint]:
    """The joints of the chain, from the base outwards."""
    moving = [joint for joint in every.values() if joint.kind in _MOVING]
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


def _depth(every: dict[str, _Joint], joint: _Joint) -> list[_Joint]:
    """Joints between the base and this one, from the base outwards, with this one."""
    parents, way = {other.child: other for other in every.values()}, [joint]
    while way[0].parent in parents:
        way.insert(0, parents[way[0].parent])
    return way


def _ordered(every: dict[str, _Joint], joints: list[_Joint]) -> list[_Joint] | None:
    """These joints from the base outwards; None if they are not all on one way."""
    ways = sorted((_depth(every, joint) for joint in joints), key=len)
    if any(shorter != longer[: len(shorter)] for shorter, longer in pairwise(ways)):
        return None
    return [way[-1] for way in ways]


def _way(every: dict[str, _Joint], start: str | None, joint: _Joint) -> list[_Joint]:
    """Joints from behind a link (None: the base) to this joint; those between are fixed, or held at zero."""
    way = _depth(every, joint)
    if start is not None:
        way = way[next(i for i, other in enumerate(way) if other.child == start) + 1 :]
    return way


def _lumped(bodies: dict[str, Body | None], every: dict[str, _Joint], link: str, moving: Collection[str]) -> Body:
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

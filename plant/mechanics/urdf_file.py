"""What a URDF file says of its links and joints: every number and body checked, nothing executed or fetched."""

from __future__ import annotations

import dataclasses
import re
import xml.parsers.expat
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.body import Body
from plant.mechanics.placement import Placement
from plant.parts.arguments import choice
from plant.parts.files import read_bounded

__all__ = ["HERE", "MOVING", "UrdfJoint", "joints_of", "links_of", "parsed"]


_LARGEST = 5 << 20
"""Bytes; the largest real files have a few hundred thousand."""


_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


HERE = Placement()
"""Of all that state no origin."""

MOVING = {"revolute": False, "continuous": False, "prismatic": True}  # -> whether it slides


@dataclasses.dataclass
class Element:
    """An XML element."""

    tag: str
    attributes: dict[str, str]
    children: list[Element]

    def find(self, tag: str) -> Element | None:
        return next((child for child in self.children if child.tag == tag), None)

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]


@dataclasses.dataclass
class UrdfJoint:
    """A joint as the file has it, its axis in the frame of its origin."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Placement
    axis: NDArray[np.float64]
    mimics: bool


def parsed(path: str | Path) -> Element:
    """The <robot> of a file, or a refusal."""
    if isinstance(path, str) and path.lstrip().startswith("<"):
        raise ValueError("path must be the name of a URDF file; got its text. Write it to a file first.")
    try:
        data = read_bounded(path, _LARGEST)
    except ValueError as error:
        raise ValueError(f"{path} {error}") from None
    root: list[Element] = []
    open_elements: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, [])
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


def numbers_of(
    element: Element | None, attribute: str, count: int, default: str | None, where: str
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


def origin_of(element: Element, where: str) -> Placement:
    origin = element.find("origin")
    if origin is None:
        return HERE
    position = numbers_of(origin, "xyz", 3, "0 0 0", f"{where}, origin")
    roll, pitch, yaw = numbers_of(origin, "rpy", 3, "0 0 0", f"{where}, origin")
    return Placement.of_angles(roll, pitch, yaw, position)


def links_of(robot: Element) -> dict[str, Body | None]:
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
            mass = numbers_of(inertial.find("mass"), "value", 1, None, f"{where}, mass")[0]
            matrix = inertial.find("inertia")
            inertia = [
                numbers_of(matrix, key, 1, None, f"{where}, inertia")[0]
                for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
            ]
            if mass < 0:
                raise ValueError(f"{where} must have a positive mass; got {mass}. Correct it.")
            if mass or any(inertia):
                body = Body(mass=mass, com=np.zeros(3), inertia=inertia)
                body.require_physical(name)
                bodies[name] = body.seen_from(origin_of(inertial, where))
    return bodies


def joints_of(robot: Element) -> dict[str, UrdfJoint]:
    """Name of a joint -> UrdfJoint."""
    joints: dict[str, UrdfJoint] = {}
    for element in robot.all("joint"):
        name, kind = element.attributes.get("name", ""), element.attributes.get("type", "")
        where = f"joint {name}"
        if not name or name in joints:
            raise ValueError(f"joints must have names of their own; got {name!r} {'twice' if name else ''}. Name it.")
        if kind in ("floating", "planar"):
            raise ValueError(f"{where} must move about or along one axis; it is {kind}. Replace it by single joints.")
        choice(f"type of {where}", kind, (*MOVING, "fixed"))
        ends = [element.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.attributes.get("link", "") for end in ends)
        if not parent or not child:
            raise ValueError(f"{where} must have a parent and a child link; one is missing. Add it.")
        axis = numbers_of(element.find("axis"), "xyz", 3, "1 0 0", f"{where}, axis")
        if kind in MOVING and np.linalg.norm(axis) < 1e-6:
            raise ValueError(f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it.")
        mimics = element.find("mimic") is not None
        joints[name] = UrdfJoint(name, kind, parent, child, origin_of(element, where), axis, mimics)
    return joints

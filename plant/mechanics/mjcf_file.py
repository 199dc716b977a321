"""What an MJCF file says of its bodies and joints: a stated subset, everything else refused by
its element's name.
"""

import dataclasses
import itertools
import math
from pathlib import Path

import numpy as np

from plant.mechanics.body import Body, body_in
from plant.mechanics.model_tree import ModelFile, ModelJoint
from plant.mechanics.placement import Placement
from plant.mechanics.xml_file import Element, numbers_of, parsed, rotation_of
from plant.parts.arguments import choice

# places in `Body.inertia` of the entries of ``fullinertia``: Ixx Iyy Izz Ixy Ixz Iyz
FULL = (0, 3, 5, 1, 2, 4)

_TOP = (
    "actuator",
    "asset",
    "compiler",
    "contact",
    "custom",
    "default",
    "include",
    "keyframe",
    "option",
    "sensor",
    "size",
    "statistic",
    "visual",
    "worldbody",
)
_IN_BODY = ("body", "camera", "geom", "inertial", "joint", "light", "site")
_ZERO = {  # attribute that must be zero -> what it would be
    "joint": {"stiffness": "a spring", "springdamper": "a spring"},
    "body": {"gravcomp": "gravity compensation", "mocap": "a body that is moved by hand"},
    "compiler": {
        "boundmass": "other masses",
        "boundinertia": "other inertias",
        "settotalmass": "other masses",
    },
    "option": {"density": "a fluid", "viscosity": "a fluid"},
}


def read_mjcf(path: str | Path) -> ModelFile:
    """An MJCF file: bodies as links, joints (bodies without one are fixed), and the places of
    their elements.
    """
    root, data = parsed(path, "mujoco", "MJCF")
    _include(root, Path(path), {Path(path).resolve()})
    for element in root.children:
        if element.tag not in _TOP and element.children:
            raise ValueError(
                f"<{element.tag}> must not be in the file: no chain has what it describes."
                " Remove it."
            )
        _require_zero(element)
    model = ModelFile(path=Path(path), data=data, bodies={"world": None}, joints={}, links={})
    reader = _Reader(root, model)
    for option in root.all("option"):
        gravity = numbers_of(option, "gravity", 3, "0 0 -9.81", "option")
        model.gravity = (float(gravity[0]), float(gravity[1]), float(gravity[2]))
    for world in root.all("worldbody"):
        reader.children(world, "world", "main", moves=False)
    if len(model.bodies) == 1:
        raise ValueError("the file must have bodies; it has none. Give an MJCF file.")
    return model


def _include(element: Element, path: Path, seen: set[Path]) -> None:
    """Put what files hold in the place of the elements that include them."""
    children: list[Element] = []
    for child in element.children:
        _include(child, path, seen)
        if child.tag != "include":
            children.append(child)
            continue
        name = child.attributes.get("file", "")
        other = path.parent / name
        if not name or not other.is_file():
            raise ValueError(
                f"<include> must name a file that is there; {other} is not. Put it beside"
                f" {path.name}."
            )
        if other.resolve() in seen:
            raise ValueError(f"<include> must name each file once; {name} comes twice. Remove one.")
        seen.add(other.resolve())
        root, _ = parsed(other, None, "MJCF")
        _include(root, path, seen)
        children += root.children
    element.children = children


def _require_zero(element: Element) -> None:
    for name, what in _ZERO.get(element.tag, {}).items():
        text = element.attributes.get(name, "0")
        if any(word not in ("0", "0.0", "-1", "false") for word in text.split()):
            raise ValueError(
                f"{name} of <{element.tag}> must be zero: {what} is not read; got {text!r}."
                " Remove it."
            )


class _Reader:
    """Walks through the bodies, with the compiler's settings and the default classes of joints."""

    def __init__(self, root: Element, model: ModelFile) -> None:
        self.model, self.unnamed = model, itertools.count(1)
        self.degrees = True
        self.sequence = "xyz"
        self.autolimits = True
        self.defaults: dict[str, dict[str, str]] = {"main": {}}
        for element in root.all("compiler"):
            get = element.attributes.get
            self.degrees = (
                choice("angle of <compiler>", get("angle", "degree"), ("degree", "radian"))
                == "degree"
            )
            self.sequence, self.autolimits = (
                get("eulerseq", "xyz"),
                get("autolimits", "true") == "true",
            )
            if len(self.sequence) != 3 or set(self.sequence.lower()) - set("xyz"):
                raise ValueError(
                    f"eulerseq must be three of xyz or XYZ; got {self.sequence!r}. Correct it."
                )
            if get("inertiafromgeom", "auto") == "true":
                raise ValueError(
                    "inertiafromgeom must not be true: geoms are not read. Give each body its"
                    " <inertial>."
                )
            if get("balanceinertia", "false") == "true" or get("coordinate", "local") != "local":
                raise ValueError(
                    "balanceinertia and global coordinates are not read; the file has one."
                    " Remove it."
                )
        for element in root.all("default"):
            self._class(element, {}, "main")

    def _class(self, element: Element, inherited: dict[str, str], name: str) -> None:
        """Attributes of joints of a class and of those within it."""
        joint = element.find("joint")
        attributes = inherited | ({} if joint is None else joint.attributes)
        self.defaults[name] = self.defaults.get(name, {}) | attributes
        for child in element.all("default"):
            self._class(child, self.defaults[name], child.attributes.get("class", ""))

    def _pose(self, element: Element, where: str) -> Placement:
        rotation = rotation_of(element, where, degrees=self.degrees, sequence=self.sequence)
        return Placement(rotation=rotation, position=numbers_of(element, "pos", 3, "0 0 0", where))

    def children(self, element: Element, parent: str, inherited: str, *, moves: bool) -> None:
        """The bodies within a body, or in the world."""
        for body in element.all("body"):
            self.body(body, parent, body.attributes.get("childclass", inherited), moves=moves)
        for child in element.children:
            if child.tag not in _IN_BODY:
                where = element.attributes.get("name", element.tag)
                raise ValueError(
                    f"<{child.tag}> must not be in {where}; only {', '.join(_IN_BODY)} may."
                    " Remove it."
                )

    def body(self, element: Element, parent: str, inherited: str, *, moves: bool) -> None:
        """A body, its joint, and the bodies within it."""
        name = element.attributes.get("name") or f"body {next(self.unnamed)}"
        where = f"body {name}"
        if name in self.model.bodies:
            raise ValueError(
                f"bodies must have names of their own; got {name!r} twice. Rename one."
            )
        _require_zero(element)
        origin = self._pose(element, where)
        joints = element.all("joint")
        self.model.links[name] = element
        self.model.bodies[name] = self._inertial(element, name, moves=moves or bool(joints))
        if len(joints) > 1:
            raise ValueError(
                f"{where} must have one joint; it has {len(joints)}. Put a body between them."
            )
        if joints:
            joint = self._joint(joints[0], name, parent, origin, inherited)
        else:
            weld = f"weld of {name}"
            up = np.eye(3)[2]
            joint = ModelJoint(
                name=weld, kind="fixed", parent=parent, child=name, origin=origin, axis=up
            )
        if joint.name in self.model.joints:
            raise ValueError(
                f"joints must have names of their own; got {joint.name!r} twice. Rename one."
            )
        self.model.joints[joint.name] = joint
        self.children(element, name, inherited, moves=moves or bool(joints))

    def _joint(
        self, element: Element, body: str, parent: str, origin: Placement, inherited: str
    ) -> ModelJoint:
        name = element.attributes.get("name") or f"joint of {body}"
        where = f"joint {name}"
        own_class = choice(
            f"class of {where}", element.attributes.get("class", inherited), tuple(self.defaults)
        )
        element = dataclasses.replace(
            element, attributes=self.defaults[own_class] | element.attributes
        )
        _require_zero(element)
        kind = element.attributes.get("type", "hinge")
        if kind not in ("hinge", "slide"):
            raise ValueError(
                f"{where} must be a hinge or a slide; it is <joint type={kind!r}>. Replace it by"
                " hinges."
            )
        unit = np.pi / 180 if kind == "hinge" and self.degrees else 1.0
        axis = numbers_of(element, "axis", 3, "0 0 1", where)
        if np.linalg.norm(axis) < 1e-6:
            raise ValueError(
                f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it."
            )
        x, y, z = numbers_of(element, "pos", 3, "0 0 0", where)
        lower, upper = numbers_of(element, "range", 2, "0 0", where) * unit
        limited = element.attributes.get("limited", "auto")
        known = self.autolimits and "range" in element.attributes
        if limited == "false" or (limited == "auto" and not known):
            lower = -math.inf
            upper = math.inf
        force = max(np.abs(numbers_of(element, "actuatorfrcrange", 2, "0 0", where)))
        return ModelJoint(
            name=name,
            kind="revolute" if kind == "hinge" else "prismatic",
            parent=parent,
            child=body,
            origin=origin,
            axis=axis,
            anchor=(x, y, z),
            zero=numbers_of(element, "ref", 1, "0", where)[0] * unit,
            limits=(lower, upper, math.inf, float(force) or math.inf),
            armature=numbers_of(element, "armature", 1, "0", where)[0],
            element=element,
        )

    def _inertial(self, element: Element, name: str, *, moves: bool) -> Body | None:
        """The body of an <inertial>; None where there is none and no geom, or nothing that
        moves.
        """
        found = element.all("inertial")
        where = f"body {name}"
        if not found and (element.find("geom") is None or not moves):
            return None
        if len(found) != 1:
            raise ValueError(
                f"{where} must have one <inertial>: geoms are not read; it has {len(found)}."
                " Add it."
            )
        inertial = found[0]
        mass = numbers_of(inertial, "mass", 1, None, where)[0]
        pose = self._pose(inertial, where)
        if "fullinertia" in inertial.attributes:
            full = numbers_of(inertial, "fullinertia", 6, None, where)
            inertia = np.zeros(6)
            inertia[list(FULL)] = full
        else:
            x, y, z = numbers_of(inertial, "diaginertia", 3, None, where)
            inertia = np.array([x, 0, 0, y, 0, z])
        return body_in(mass, inertia, name, pose)

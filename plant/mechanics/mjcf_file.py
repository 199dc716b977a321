"""Bodies and joints of an MJCF file: a subset of the format; other elements are refused by name."""

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

# Indices in `Body.inertia` of the entries of ``fullinertia``: Ixx Iyy Izz Ixy Ixz Iyz.
FULL = (0, 3, 5, 1, 2, 4)

# Elements that may stand in <mujoco>. Those that only draw or control are ignored, all that add
# forces or constraints are refused.
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
# Attributes that must be zero, and the effect that they would have.
_ZERO = {
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
    """Read an MJCF file: bodies as links, joints, and the elements that state them.

    A body without a joint is fixed to its parent.
    """
    root, data = parsed(path, "mujoco", "MJCF")
    # Includes come first: an included file may hold bodies, defaults or the compiler's settings.
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
        # The world does not move: its own geoms need no mass.
        reader.children(world, "world", "main", moves=False)
    if len(model.bodies) == 1:
        raise ValueError("the file must have bodies; it has none. Give an MJCF file.")
    return model


def _include(element: Element, path: Path, seen: set[Path]) -> None:
    """Replace each <include> by the elements of the file that it names."""
    children: list[Element] = []
    for child in element.children:
        # An <include> may stand anywhere, also within a body.
        _include(child, path, seen)
        if child.tag != "include":
            children.append(child)
            continue
        name = child.attributes.get("file", "")
        included = path.parent / name
        if not name or not included.is_file():
            raise ValueError(
                f"<include> must name a file that is there; {included} is not. Put it beside"
                f" {path.name}."
            )
        # Also prevents a file that includes itself.
        if included.resolve() in seen:
            raise ValueError(f"<include> must name each file once; {name} comes twice. Remove one.")
        seen.add(included.resolve())
        root, _ = parsed(included, None, "MJCF")
        _include(root, path, seen)
        children += root.children
    element.children = children


def _require_zero(element: Element) -> None:
    for name, effect in _ZERO.get(element.tag, {}).items():
        text = element.attributes.get(name, "0")
        # -1 and false are the defaults that switch an effect off.
        if any(word not in ("0", "0.0", "-1", "false") for word in text.split()):
            raise ValueError(
                f"{name} of <{element.tag}> must be zero: {effect} is not read; got {text!r}."
                " Remove it."
            )


class _Reader:
    """Walks through the bodies, with the compiler's settings and the default classes of joints."""

    def __init__(self, root: Element, model: ModelFile) -> None:
        self.model = model
        self.unnamed = itertools.count(1)
        # Defaults of MuJoCo: degrees, intrinsic xyz angles, limits wherever a range is stated.
        self.degrees = True
        self.sequence = "xyz"
        self.autolimits = True
        self.defaults: dict[str, dict[str, str]] = {"main": {}}
        for element in root.all("compiler"):
            get = element.attributes.get
            unit = choice("angle of <compiler>", get("angle", "degree"), ("degree", "radian"))
            self.degrees = unit == "degree"
            self.sequence = get("eulerseq", "xyz")
            self.autolimits = get("autolimits", "true") == "true"
            if len(self.sequence) != 3 or set(self.sequence.lower()) - set("xyz"):
                raise ValueError(
                    f"eulerseq must be three of xyz or XYZ; got {self.sequence!r}. Correct it."
                )
            # Bodies without <inertial> are refused later; here the file demands masses from its
            # geoms.
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
        """Store the joint attributes of a default class and of the classes within it."""
        joint = element.find("joint")
        # A class inherits from the class around it; its own attributes win.
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
        # Checked before anything is read, so that the refusal names the cause.
        _require_zero(element)
        origin = self._pose(element, where)
        joints = element.all("joint")
        # A body moves once any joint lies between it and the world.
        self.model.links[name] = element
        self.model.bodies[name] = self._inertial(element, name, moves=moves or bool(joints))
        if len(joints) > 1:
            raise ValueError(
                f"{where} must have one joint; it has {len(joints)}. Put a body between them."
            )
        if joints:
            joint = self._joint(joints[0], name, parent, origin, inherited)
        # A body without a joint is welded to its parent. The axis of a weld is never used.
        else:
            joint = ModelJoint(
                name=f"weld of {name}",
                kind="fixed",
                parent=parent,
                child=name,
                origin=origin,
                axis=np.eye(3)[2],
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
        class_name = choice(
            f"class of {where}", element.attributes.get("class", inherited), tuple(self.defaults)
        )
        # Attributes of the joint win over those of its class.
        element = dataclasses.replace(
            element, attributes=self.defaults[class_name] | element.attributes
        )
        _require_zero(element)
        kind = element.attributes.get("type", "hinge")
        if kind not in ("hinge", "slide"):
            raise ValueError(
                f"{where} must be a hinge or a slide; it is <joint type={kind!r}>. Replace it by"
                " hinges."
            )
        # Angles of slides are lengths: never in degrees.
        unit = np.pi / 180 if kind == "hinge" and self.degrees else 1.0
        axis = numbers_of(element, "axis", 3, "0 0 1", where)
        if np.linalg.norm(axis) < 1e-6:
            raise ValueError(
                f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it."
            )
        x, y, z = numbers_of(element, "pos", 3, "0 0 0", where)
        lower, upper = numbers_of(element, "range", 2, "0 0", where) * unit
        # With autolimits a range alone limits the joint; otherwise it needs limited="true".
        limited = element.attributes.get("limited", "auto")
        automatic = self.autolimits and "range" in element.attributes
        if limited == "false" or (limited == "auto" and not automatic):
            lower = -math.inf
            upper = math.inf
        # The two forces may have signs of their own; a `Limits` holds magnitudes. Zero means no
        # limit.
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
        """The body of an <inertial>; None if the body needs none (no geom, or it never moves)."""
        elements = element.all("inertial")
        where = f"body {name}"
        # A body without geoms, or fixed to the world, needs no mass.
        if not elements and (element.find("geom") is None or not moves):
            return None
        if len(elements) != 1:
            raise ValueError(
                f"{where} must have one <inertial>: geoms are not read; it has {len(elements)}."
                " Add it."
            )
        inertial = elements[0]
        mass = numbers_of(inertial, "mass", 1, None, where)[0]
        pose = self._pose(inertial, where)
        if "fullinertia" in inertial.attributes:
            # The order of MuJoCo differs from that of `Body.inertia`.
            inertia = np.zeros(6)
            inertia[list(FULL)] = numbers_of(inertial, "fullinertia", 6, None, where)
        else:
            # Principal moments, in the pose that the element states.
            x, y, z = numbers_of(inertial, "diaginertia", 3, None, where)
            inertia = np.array([x, 0, 0, y, 0, z])
        return body_in(mass, inertia, name, pose)

"""Read the bodies and joints of an MJCF file. The reader supports a subset of the format."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from plant.mechanics.body import Body, body_in, inertia_matrix
from plant.mechanics.model_tree import HERE, Constraint, ModelFile, ModelJoint, deferred
from plant.mechanics.placement import Placement
from plant.mechanics.xml_file import Element, numbers_of, parsed, rotation_of
from plant.parts import Floats, choice

# Indices in `Body.inertia` of the entries of ``fullinertia``: Ixx Iyy Izz Ixy Ixz Iyz.
FULL = (0, 3, 5, 1, 2, 4)

# Sections that <mujoco> may have. This module or others read some of them. The remaining sections
# only draw, control or watch, and do not act on a chain.
_TOP = (
    "actuator",
    "asset",
    "compiler",
    "contact",
    "custom",
    "default",
    "deformable",
    "equality",
    "extension",
    "include",
    "keyframe",
    "option",
    "sensor",
    "size",
    "statistic",
    "tendon",
    "visual",
    "worldbody",
)
_IN_BODY = ("body", "camera", "frame", "freejoint", "geom", "inertial", "joint", "light", "site")
# The world does not move.
_IN_WORLD = tuple(tag for tag in _IN_BODY if tag not in ("freejoint", "inertial", "joint"))
# Elements in which a missing file may hold settings, classes, or what acts on any chain.
_WHOLE_MODEL = (
    "actuator",
    "default",
    "deformable",
    "equality",
    "mujoco",
    "mujocoinclude",
    "option",
    "tendon",
)
# Attributes that must be zero, and the effect that they would have.
_ZERO = {
    "joint": {"stiffness": "a spring", "springdamper": "a spring"},
    "body": {"mocap": "a body that is moved by hand"},
    "compiler": {"settotalmass": "other masses"},
    "option": {"density": "a fluid", "viscosity": "a fluid"},
}
# Kinds of actuators that MuJoCo makes of a general one, and the attributes that decide whether the
# force is a gain times the control, as that of a motor. The others have gains of their own.
_ACTUATORS: dict[str, dict[str, str]] = {
    "general": {},
    "motor": {"dyntype": "none", "gaintype": "fixed", "gainprm": "1", "biastype": "none"},
} | {
    kind: {"gaintype": kind}
    for kind in (
        "position",
        "velocity",
        "intvelocity",
        "damper",
        "cylinder",
        "muscle",
        "adhesion",
        "dcmotor",
        "pid",
        "plugin",
    )
}
# Attributes that name the ends of a constraint, a tendon or a flexible body.
_JOINT_ENDS = ("joint", "joint1", "joint2")
_BODY_ENDS = ("body", "body1", "body2")
_SITE_ENDS = ("site", "site1", "site2", "sidesite")
_GEOM_ENDS = ("geom",)
_TENDON_ENDS = ("tendon", "tendon1", "tendon2")


def read_mjcf(path: str | Path) -> ModelFile:
    """Read an MJCF file: bodies as links, joints, and the elements that state them.

    A body without a joint is fixed to its parent.
    """
    root, data = parsed(path, "mujoco", "MJCF")
    # Includes come first: an included file may hold bodies, defaults or the compiler's settings.
    _include(root, Path(path), Path(path).parent, {Path(path).resolve()})
    for element in root.children:
        if element.tag not in _TOP and element.children:
            raise ValueError(
                f"<{element.tag}> must not be in the file: no chain has what it describes."
                " Remove it."
            )
    compiler = _together(root, "compiler")
    option = _together(root, "option")
    _require_zero(compiler)
    _require_zero(option)
    model = ModelFile(path=Path(path), data=data, bodies={"world": None}, joints={}, links={})
    # Compiler and defaults hold for the whole file, wherever they stand in it.
    reader = _Reader(root, compiler, model)
    model.gravity = _gravity(option)
    for world in root.all("worldbody"):
        # The world does not move: its own geoms need no mass.
        reader.children(world, _Inside("world"))
    if len(model.bodies) == 1:
        # The bodies may be in what was not read.
        if model.unread_branches:
            raise ValueError(model.unread_branches[0])
        raise ValueError("the file must have bodies; it has none. Give an MJCF file.")
    # Behind the bodies: constraints and actuators refer to them by name.
    reader.constraints(root)
    reader.actuators(root)
    return model


def _together(element: Element, tag: str) -> Element:
    """Return all children of this tag as one element.

    As in MuJoCo, a later one changes only the attributes that it states.
    """
    union = Element(tag, {}, [], element.path)
    for child in element.all(tag):
        union.attributes |= child.attributes
        union.children += child.children
    return union


def _gravity(option: Element) -> tuple[float, float, float]:
    flag = _together(option, "flag").attributes.get("gravity", "enable")
    if choice("gravity of <flag>", flag, ("enable", "disable")) == "disable":
        return 0.0, 0.0, 0.0
    x, y, z = numbers_of(option, "gravity", 3, "0 0 -9.81", "option")
    return float(x), float(y), float(z)


def _include(element: Element, path: Path, folder: Path, seen: set[Path]) -> None:
    """Replace each <include> by the elements of the file that it names.

    As in MuJoCo, a name is relative to the folder of `path`, or else to `folder`, which holds the
    file with the <include>. The function refuses a missing file at the top level of a file and in
    the elements of `_WHOLE_MODEL`. Elsewhere the <include> of a missing file stays in the tree.
    """
    children: list[Element] = []
    for child in element.children:
        # An <include> may stand anywhere, also within a body.
        _include(child, path, folder, seen)
        if child.tag != "include":
            children.append(child)
            continue
        name = child.attributes.get("file", "")
        places = [place / name for place in (path.parent, folder) if name]
        included = next((place for place in places if place.is_file()), None)
        if included is None:
            if element.tag in _WHOLE_MODEL:
                raise ValueError(
                    f"<include> must name a file that is there; {path.parent / name} is not. Put it"
                    f" beside {path.name}."
                )
            children.append(child)
            continue
        # Also prevents a file that includes itself.
        if included.resolve() in seen:
            raise ValueError(f"<include> must name each file once; {name} comes twice. Remove one.")
        seen.add(included.resolve())
        # Without a required root: an included file may have <mujoco> or <mujocoinclude>.
        root, _ = parsed(included, None, "MJCF")
        _include(root, path, included.parent, seen)
        children += root.children
    element.children = children


def _require_zero(element: Element) -> None:
    for name, effect in _ZERO.get(element.tag, {}).items():
        text = element.attributes.get(name, "0")
        if _acts(element, name, text):
            raise ValueError(
                f"{name} of <{element.tag}> must be zero: {effect} is not read; got {text!r}."
                " Remove it."
            )


def _acts(element: Element, name: str, text: str) -> bool:
    """Whether an attribute of `_ZERO` has its effect."""
    # The only one that is no number.
    if name == "mocap":
        return text not in ("0", "false")
    values = numbers_of(element, name, len(text.split()) or 1, "0", f"<{element.tag}>")
    # MuJoCo scales the masses to a positive total only; its default is -1.
    return bool((values > 0).any() if name == "settotalmass" else values.any())


@dataclasses.dataclass(frozen=True)
class _Inside:
    """Where an element stands: in which body, the pose of frames between, the class.

    `moves` is whether the body moves, and `misplaced` why the pose cannot be read, if it cannot.
    """

    # The world is a parent as any other body.
    parent: str
    pose: Placement = HERE
    inherited: str = "main"
    moves: bool = False
    misplaced: str = ""


class _Reader:
    """Walks through the bodies, with the compiler's settings and the default classes."""

    def __init__(self, root: Element, compiler: Element, model: ModelFile) -> None:
        self.model = model
        # Bodies may lack names, yet chains begin and end at names.
        self.unnamed = itertools.count(1)
        # Defaults of MuJoCo: degrees, intrinsic xyz angles, limits wherever a range is stated.
        get = compiler.attributes.get
        unit = choice("angle of <compiler>", get("angle", "degree"), ("degree", "radian"))
        self.degrees = unit == "degree"
        self.sequence = get("eulerseq", "xyz")
        if len(self.sequence) != 3 or set(self.sequence.lower()) - set("xyz"):
            raise ValueError(
                f"eulerseq must be three of xyz or XYZ; got {self.sequence!r}. Correct it."
            )
        self.autolimits = get("autolimits", "true") == "true"
        self.from_geoms = get("inertiafromgeom", "auto") == "true"
        self.balance = get("balanceinertia", "false") == "true"
        self.least_mass = numbers_of(compiler, "boundmass", 1, "0", "compiler")[0]
        self.least_inertia = numbers_of(compiler, "boundinertia", 1, "0", "compiler")[0]
        if get("coordinate", "local") != "local":
            raise ValueError(
                "coordinates must be local; the file has global ones. Load and save it with"
                " MuJoCo 2.3."
            )
        # For each default class: the attributes of its joints, and those of its actuators.
        self.defaults: dict[str, dict[str, str]] = {"main": {}}
        self.actuator_defaults: dict[str, dict[str, str]] = {"main": {}}
        # The bodies of sites and geoms, at which tendons and constraints act. A site and a geom may
        # have the same name.
        self.bodies_of: dict[tuple[str, str], str] = {}
        for element in root.all("default"):
            self._class(element, {}, {}, "main")

    def _class(
        self, element: Element, joints: dict[str, str], actuators: dict[str, str], name: str
    ) -> None:
        """Store the attributes of a default class, and of the classes within it."""
        # A class inherits from the class around it; its own attributes win. All kinds of actuators
        # share theirs.
        self.defaults[name] = self.defaults.get(name, {}) | joints
        self.actuator_defaults[name] = self.actuator_defaults.get(name, {}) | actuators
        for child in element.children:
            if child.tag == "joint":
                self.defaults[name] |= child.attributes
            elif child.tag in _ACTUATORS:
                self.actuator_defaults[name] |= _ACTUATORS[child.tag] | child.attributes
        for child in element.all("default"):
            nested = child.attributes.get("class", "")
            self._class(child, self.defaults[name], self.actuator_defaults[name], nested)

    def _pose(self, element: Element, where: str) -> Placement:
        rotation = rotation_of(element, where, degrees=self.degrees, sequence=self.sequence)
        return Placement(rotation=rotation, position=numbers_of(element, "pos", 3, "0 0 0", where))

    def _placed(self, element: Element, inside: _Inside) -> Iterator[tuple[Element, _Inside]]:
        """Yield the children of a body or the world, also those in its frames, with their places.

        A frame is a pose that its children share, and no body.
        """
        for child in element.children:
            if child.tag != "frame":
                yield child, inside
                continue
            pose, reason = deferred(HERE, self._pose, child, f"frame in {inside.parent}")
            within = dataclasses.replace(
                inside,
                pose=inside.pose @ pose,
                inherited=child.attributes.get("childclass", inside.inherited),
                misplaced=inside.misplaced or reason,
            )
            yield from self._placed(child, within)

    def children(self, element: Element, inside: _Inside) -> None:
        """The elements within a body or the world."""
        allowed = _IN_WORLD if inside.parent == "world" else _IN_BODY
        for child, place in self._placed(element, inside):
            name = child.attributes.get("name", "")
            if child.tag == "body":
                self.body(child, place)
            elif child.tag in ("site", "geom") and name:
                self.bodies_of[child.tag, name] = inside.parent
            elif child.tag not in allowed:
                reason = (
                    f"<{child.tag}> must not be in {inside.parent}; only {', '.join(allowed)} may."
                    " Remove it."
                )
                if child.tag == "include":
                    reason = (
                        "<include> must name a file that is there;"
                        f" {child.attributes.get('file', '')} is not. Put it beside the model."
                    )
                self.model.unread.setdefault(inside.parent, reason)
                if _may_move(child):
                    self.model.unread_branches.append(reason)

    def body(self, element: Element, inside: _Inside) -> None:
        """A body, its joints, and the bodies within it."""
        name = element.attributes.get("name") or f"body {next(self.unnamed)}"
        where = f"body {name}"
        if name in self.model.bodies:
            raise ValueError(
                f"bodies must have names of their own; got {name!r} twice. Rename one, or"
                " remove what is there twice."
            )
        # A class of children holds for the whole subtree, until another one replaces it.
        inherited = element.attributes.get("childclass", inside.inherited)
        pose, reason = deferred(HERE, self._pose, element, where)
        misplaced = inside.misplaced or reason
        origin = inside.pose @ pose
        # A body moves once any joint lies between it and the world.
        moves = inside.moves or holds(element, "joint", "freejoint")
        here = _Inside(name, inherited=inherited, moves=moves)
        joints = [
            (child, place)
            for child, place in self._placed(element, here)
            if child.tag in ("joint", "freejoint")
        ]
        parent = inside.parent
        # Several joints of one body form a series. Bodies without mass lie between them, at the
        # place of the body.
        unnamed = itertools.count(1)
        for count, (joint_element, place) in enumerate(joints, 1):
            joint_name = joint_element.attributes.get("name") or _name_of(next(unnamed), name)
            joint = self._joint(joint_element, joint_name, place, parent, origin)
            self._add(dataclasses.replace(joint, misplaced=misplaced))
            if count == len(joints):
                break
            parent = f"{name} behind {joint.name}"
            joint.child = self.model.joints[joint.name].child = parent
            self.model.bodies[parent] = None
            origin = HERE
        # A body without a joint is welded to its parent. The axis of a weld is never used.
        if not joints:
            weld = ModelJoint(
                name=f"weld of {name}",
                kind="fixed",
                parent=parent,
                child=name,
                origin=origin,
                axis=np.eye(3)[2],
                misplaced=misplaced,
            )
            self._add(weld)
        # The element itself is stored, since geoms and names of it are read elsewhere.
        self.model.links[name] = element
        body, reason = deferred(None, self._inertial, element, here)
        self.model.bodies[name] = body
        if reason:
            self.model.unread[name] = reason
        self.children(element, here)

    def _add(self, joint: ModelJoint) -> None:
        if joint.name in self.model.joints:
            raise ValueError(
                f"joints must have names of their own; got {joint.name!r} twice. Rename one,"
                " or remove what is there twice."
            )
        self.model.joints[joint.name] = joint

    def _joint(
        self, element: Element, name: str, place: _Inside, parent: str, origin: Placement
    ) -> ModelJoint:
        where = f"joint {name}"
        joint = ModelJoint(
            name=name,
            kind=element.attributes.get("type", "hinge") if element.tag == "joint" else "free",
            parent=parent,
            child=place.parent,
            origin=origin,
            axis=np.eye(3)[2],
            element=element,
        )
        # A chain that holds the joint at zero needs only its pose. An error in the motion is
        # therefore stored, not raised.
        unmoved = dict[str, Any]()
        motion, reason = deferred(unmoved, self._motion, element, where, place)
        return dataclasses.replace(joint, immovable=reason, **motion)

    def _motion(self, element: Element, where: str, place: _Inside) -> dict[str, Any]:
        """The fields of a `ModelJoint` that only a joint which moves needs."""
        if place.misplaced:
            raise ValueError(place.misplaced)
        class_name = choice(
            f"class of {where}",
            element.attributes.get("class", place.inherited),
            tuple(self.defaults),
        )
        # Attributes of the joint win over those of its class.
        element = dataclasses.replace(
            element, attributes=self.defaults[class_name] | element.attributes
        )
        kind = element.attributes.get("type", "hinge")
        if kind not in ("hinge", "slide") or element.tag == "freejoint":
            got = "<freejoint>" if element.tag == "freejoint" else f"<joint type={kind!r}>"
            raise ValueError(
                f"{where} must be a hinge or a slide; it is {got}. Begin the chain behind it"
                " (base=), or replace it by hinges."
            )
        _require_zero(element)
        # The positions of a slide are lengths, which are never in degrees.
        unit = np.pi / 180 if kind == "hinge" and self.degrees else 1.0
        axis = numbers_of(element, "axis", 3, "0 0 1", where)
        if np.linalg.norm(axis) < 1e-6:
            raise ValueError(
                f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it."
            )
        anchor = Placement(position=numbers_of(element, "pos", 3, "0 0 0", where))
        lower, upper = self._range(element, "range", "limited", where) * unit
        # The two forces may have signs of their own; a `Limits` holds magnitudes.
        forces = self._range(element, "actuatorfrcrange", "actuatorfrclimited", where)
        return {
            "kind": "revolute" if kind == "hinge" else "prismatic",
            "axis": np.array(place.pose.rotation) @ axis,
            "anchor": (place.pose @ anchor).position,
            "zero": numbers_of(element, "ref", 1, "0", where)[0] * unit,
            "limits": (lower, upper, math.inf, float(np.abs(forces).max())),
            "armature": numbers_of(element, "armature", 1, "0", where)[0],
            "element": element,
        }

    def _range(self, element: Element, name: str, switch: str, where: str) -> Floats:
        """The ends (2,) of a range; infinite if the range does not limit.

        A `switch` of "true" or "false" decides. If it is "auto" or missing, the range limits if the
        compiler has autolimits and the ends differ, as in MuJoCo.
        """
        limited = choice(
            f"{switch} of {where}",
            element.attributes.get(switch, "auto"),
            ("auto", "false", "true"),
        )
        default = None if limited == "true" else "0 0"
        lower, upper = numbers_of(element, name, 2, default, where)
        if limited == "false" or (limited == "auto" and (not self.autolimits or lower == upper)):
            return np.array([-math.inf, math.inf])
        # MuJoCo ignores a range with exchanged ends, unless the switch is "true". A limit that is
        # meant would then be missing.
        if lower >= upper:
            raise ValueError(
                f"{name} of {where} must be two numbers that rise; got {lower:g} and {upper:g}."
                f" Correct it, or set {switch} to false."
            )
        return np.array([lower, upper])

    def actuators(self, root: Element) -> None:
        """Lower the effort limit of each joint to the sum of its actuators' efforts."""
        efforts: dict[str, float] = {}
        for actuator in (child for element in root.all("actuator") for child in element.children):
            get = actuator.attributes.get
            joint = get("joint", get("jointinparent", ""))
            if joint not in self.model.joints:
                continue
            # An actuator that cannot be read spoils its joint alone; a chain may leave it out.
            effort, reason = deferred(math.inf, self._effort, actuator)
            # Several actuators on one joint add up.
            efforts[joint] = efforts.get(joint, 0.0) + effort
            if reason:
                self.model.joints[joint].immovable = reason
        for name, effort in efforts.items():
            joint_limits = self.model.joints[name].limits
            self.model.joints[name].limits = (*joint_limits[:3], min(joint_limits[3], effort))

    def _effort(self, element: Element) -> float:
        """The largest effort of an actuator on its joint; infinite if it states none."""
        where = f"<{element.tag}> {element.attributes.get('name', '')}".strip()
        class_name = choice(
            f"class of {where}",
            element.attributes.get("class", "main"),
            tuple(self.actuator_defaults),
        )
        # The kind and the attributes of the actuator win over those of its class.
        own = _ACTUATORS.get(element.tag, {}) | element.attributes
        element = dataclasses.replace(element, attributes=self.actuator_defaults[class_name] | own)
        # Of up to six numbers the first acts on a hinge or a slide.
        words = element.attributes.get("gear", "1").split()
        gear = numbers_of(element, "gear", len(words) or 1, "1", where)[0]
        forces = self._range(element, "forcerange", "forcelimited", where)
        effort = np.abs(forces).max()
        get = element.attributes.get
        kinds = get("dyntype", "none"), get("gaintype", "fixed"), get("biastype", "none")
        if kinds == ("none", "fixed", "none"):
            words = get("gainprm", "1").split()
            gain = numbers_of(element, "gainprm", len(words) or 1, "1", where)[0]
            controls = self._range(element, "ctrlrange", "ctrllimited", where)
            # A gain of zero makes no force of any control.
            effort = min(effort, abs(gain) * np.abs(controls).max() if gain else 0.0)
        # A gear of zero passes nothing on, also of an actuator without a limit.
        return float(abs(gear) * effort) if gear else 0.0

    def constraints(self, root: Element) -> None:
        """What tendons, equalities and flexible bodies act on; skins are drawn only."""
        tendons: dict[str, tuple[list[str], list[str]]] = {}
        for section in ("tendon", "deformable", "equality"):
            for element in (child for top in root.all(section) for child in top.children):
                # A constraint that is switched off acts as little as a skin does.
                if element.tag == "skin" or element.attributes.get("active") == "false":
                    continue
                joints, links = [], []
                for one in (element, *element.children):
                    joints += self._named(one, _JOINT_ENDS)
                    links += self._named(one, _BODY_ENDS)
                    for tag, ends in (("site", _SITE_ENDS), ("geom", _GEOM_ENDS)):
                        links += [
                            self.bodies_of.get((tag, name), name) for name in self._named(one, ends)
                        ]
                    for name in self._named(one, _TENDON_ENDS):
                        joints += tendons.get(name, ([], []))[0]
                        links += tendons.get(name, ([], []))[1]
                # A weld or a point has the world as its other end by default.
                if section == "equality" and links and not self._named(element, ("body2", "site2")):
                    links.append("world")
                name = element.attributes.get("name", "")
                if section == "tendon":
                    tendons[name] = joints, links
                # Messages name the element as the file does, with its section.
                label = f"<{section}> {name}".strip()
                self.model.constraints.append(Constraint(label=label, joints=joints, links=links))

    @staticmethod
    def _named(element: Element, attributes: tuple[str, ...]) -> list[str]:
        return [
            word
            for attribute in attributes
            for word in element.attributes.get(attribute, "").split()
        ]

    def _inertial(self, element: Element, here: _Inside) -> Body | None:
        """Return the body that <inertial> describes.

        A body without <inertial> starts from zero mass if it has no geom or never moves. Any other
        body must have one <inertial>.
        """
        _require_zero(element)
        name = here.parent
        where = f"body {name}"
        if numbers_of(element, "gravcomp", 1, "0", where)[0]:
            self.model.gravity_compensated.append(name)
        inertials = [
            (child, place)
            for child, place in self._placed(element, here)
            if child.tag == "inertial"
        ]
        geoms = holds(element, "geom")
        if self.from_geoms and geoms and here.moves:
            raise ValueError(
                f"{where} must have its mass from <inertial>, since geoms are not read; the file"
                " has inertiafromgeom. Give each body its <inertial>."
            )
        # A body without geoms, or fixed to the world, needs no mass. MuJoCo puts the least mass at
        # the body's own pos, in the frame of the body.
        if not inertials and (not geoms or not here.moves):
            pos = numbers_of(element, "pos", 3, "0 0 0", where)
            return self._bounded(0.0, np.zeros(6), name, Placement(position=pos))
        if len(inertials) != 1:
            advice = "Remove all but one." if inertials else "Add it."
            raise ValueError(
                f"{where} must have one <inertial>: geoms are not read; it has {len(inertials)}."
                f" {advice}"
            )
        # The mass and its place come from the same element; moments have two notations.
        inertial, place = inertials[0]
        if place.misplaced:
            raise ValueError(place.misplaced)
        mass = numbers_of(inertial, "mass", 1, None, where)[0]
        pose = place.pose @ self._pose(inertial, where)
        if "fullinertia" in inertial.attributes:
            # The order of MuJoCo differs from that of `Body.inertia`.
            inertia = np.zeros(6)
            inertia[list(FULL)] = numbers_of(inertial, "fullinertia", 6, None, where)
        else:
            # Principal moments, in the pose that the element states.
            x, y, z = numbers_of(inertial, "diaginertia", 3, None, where)
            inertia = np.array([x, 0, 0, y, 0, z])
        return self._bounded(mass, inertia, name, pose)

    def _bounded(self, mass: float, inertia: Floats, name: str, pose: Placement) -> Body | None:
        """The body with the compiler's least mass and moments, and balanced moments."""
        moments, axes = np.linalg.eigh(inertia_matrix(inertia))
        bounded = np.maximum(moments, self.least_inertia)
        # With balanceinertia, MuJoCo replaces moments that no real body can have by their mean.
        if self.balance and bounded[2] > bounded[0] + bounded[1]:
            bounded = np.full(3, bounded.mean())
        # Moments that stay keep the digits of the file.
        if (bounded != moments).any():
            inertia = (axes @ np.diag(bounded) @ axes.T)[np.triu_indices(3)]
        return body_in(max(mass, self.least_mass), inertia, name, pose)


def _name_of(number: int, body: str) -> str:
    """The name that one of the unnamed joints of a body gets; they are counted from 1."""
    return f"joint of {body}" if number == 1 else f"joint {number} of {body}"


def _may_move(element: Element) -> bool:
    """Whether an element has joints, or stands for a file or a model that may have them."""
    return element.tag in ("attach", "include", "joint") or any(map(_may_move, element.children))


def holds(element: Element, *tags: str) -> bool:
    """Whether a body has elements of these tags of its own, in frames too."""
    return any(
        child.tag in tags or (child.tag == "frame" and holds(child, *tags))
        for child in element.children
    )

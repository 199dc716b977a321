"""Links and joints of a URDF file: all numbers are checked, nothing is executed or fetched."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from plant.mechanics.body import Body, body_in
from plant.mechanics.model_tree import HERE, MOVING, ModelFile, ModelJoint, deferred
from plant.mechanics.placement import Placement
from plant.mechanics.xml_file import Element, numbers_of, parsed
from plant.parts import Floats, choice, near, read_bounded, several

# attributes of <inertia>, in the order of `Body.inertia`
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(path: str | Path) -> ModelFile:
    """Read a URDF file: links, joints, and the elements that state them; xacro is expanded."""
    robot, data = parsed(path, "robot", "URDF")
    # Macros cannot be read; their expansion can. The bytes then are those of the expansion.
    if is_xacro(robot):
        robot, data = parsed(path, "robot", "URDF", expanded(Path(path)))
    # Links first: an unnamed one is refused there.
    links = _links(robot)
    # The bytes stay with the model, since repairs edit them in place.
    model = ModelFile(path=Path(path), data=data, bodies={}, joints=_joints(robot), links=links)
    for name, link in links.items():
        # A link that cannot be read is refused only by a chain that needs it.
        model.bodies[name], reason = deferred(None, _body, link)
        if reason:
            model.unread[name] = reason
    _declare_ends(model)
    return model


def _declare_ends(model: ModelFile) -> None:
    """Give joints whose links are missing in the file frames to hang on.

    The world is a frame that many files take for granted; any other one is a reason to refuse the
    chains that need it.
    """
    for joint in model.joints.values():
        for link in (joint.parent, joint.child):
            if link in model.links:
                continue
            model.bodies[link] = None
            # As a child the world would move.
            if link == "world" and link == joint.parent:
                continue
            element = f'<link name="{link}"/>'
            advice = near(link, model.links, f"Add {element}, or correct the name?")
            joint.misplaced = (
                f"joint {joint.name} must have links that the file declares; got {link!r}."
                f" {advice[:-1]}{f', or is {element} missing?' if 'mean' in advice else '.'}"
            )


def origin_of(element: Element, where: str) -> Placement:
    """The pose in the <origin> of an element; the identity without one."""
    origin = element.find("origin")
    if origin is None:
        return HERE
    # Roll, pitch and yaw about fixed axes, in radians.
    position = numbers_of(origin, "xyz", 3, "0 0 0", f"{where}, origin")
    roll, pitch, yaw = numbers_of(origin, "rpy", 3, "0 0 0", f"{where}, origin")
    return Placement.of_angles(roll, pitch, yaw, position)


def _links(robot: Element) -> dict[str, Element]:
    """The links of the file, by name."""
    links: dict[str, Element] = {}
    if not robot.all("link"):
        raise ValueError(
            "the file must have links; it has none. Give a URDF file, or the xacro file that calls"
            " the macros."
        )
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        if not name or name in links:
            raise ValueError(
                f"links must have names of their own; got {name!r}."
                f" {'Rename one, or remove what is there twice.' if name else 'Name it.'}"
            )
        links[name] = element
    return links


def _body(link: Element) -> Body | None:
    """The Body of a link in its own frame; None without mass."""
    name = link.attributes["name"]
    where = f"link {name}"
    inertials = link.all("inertial")
    # A link without <inertial> is a frame alone.
    if not inertials:
        return None
    if len(inertials) > 1:
        raise ValueError(f"{where} must have one <inertial>; it has {len(inertials)}. Join them.")
    inertial = inertials[0]
    for tag in ("origin", "mass", "inertia"):
        count = len(inertial.all(tag))
        if count > 1:
            raise ValueError(f"{where} must have one <{tag}>; it has {count}. Leave one.")
    # No default: a mass of zero by omission would be taken for a frame.
    mass = numbers_of(inertial.find("mass"), "value", 1, None, f"{where}, mass")[0]
    # About the centre of mass, along the axes of the <origin>; `body_in` turns it into the axes of
    # the link.
    matrix = inertial.find("inertia")
    inertia = [numbers_of(matrix, key, 1, None, f"{where}, inertia")[0] for key in INERTIA]
    return body_in(mass, np.array(inertia), name, origin_of(inertial, where))


def _joints(robot: Element) -> dict[str, ModelJoint]:
    """The joints of the file, by name."""
    joints: dict[str, ModelJoint] = {}
    for element in robot.all("joint"):
        name = element.attributes.get("name", "")
        kind = element.attributes.get("type", "")
        where = f"joint {name}"
        if not name or name in joints:
            raise ValueError(
                f"joints must have names of their own; got {name!r}."
                f" {'Rename one, or remove what is there twice.' if name else 'Name it.'}"
            )
        # Both ends are read before either is refused, so that one message serves both.
        ends = [element.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.attributes.get("link", "") for end in ends)
        if not parent or not child:
            raise ValueError(
                f"{where} must have a parent and a child link; one is missing. Add it."
            )
        mimic = element.find("mimic")
        # A mimic without a name still moves with another joint, so it is marked as one.
        mimics = "" if mimic is None else mimic.attributes.get("joint", "") or "another one"
        # Chains that do not move the joint need its pose alone.
        origin, misplaced = deferred(HERE, origin_of, element, where)
        motion, immovable = deferred(_Motion(), _motion, element, kind, where)
        joints[name] = ModelJoint(
            name=name,
            kind=kind,
            parent=parent,
            child=child,
            origin=origin,
            mimics=mimics,
            element=element,
            misplaced=misplaced,
            immovable=immovable,
            **motion._asdict(),
        )
    return joints


class _Motion(NamedTuple):
    """The fields of a `ModelJoint` that only a joint which moves needs."""

    axis: Floats = np.array([1.0, 0.0, 0.0])
    limits: tuple[float, float, float, float] = (-math.inf, math.inf, math.inf, math.inf)
    friction: tuple[float, float] = (math.nan, math.nan)


def _motion(element: Element, kind: str, where: str) -> _Motion:
    """Axis, limits and friction of a joint; a fixed one needs none."""
    if kind == "fixed":
        return _Motion()
    # A chain has one coordinate per joint.
    if kind in ("floating", "planar"):
        raise ValueError(
            f"{where} must move about or along one axis; it is {kind}. Begin the chain behind it"
            " (base=), or replace it by single joints."
        )
    choice(f"type of {where}", kind, (*MOVING, "fixed"))
    # The axis is in the frame of the joint, which is that of the child link.
    axis = numbers_of(element.find("axis"), "xyz", 3, "1 0 0", f"{where}, axis")
    if np.linalg.norm(axis) < 1e-6:
        raise ValueError(
            f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it."
        )
    return _Motion(
        axis=axis,
        limits=_limits(element.find("limit"), kind, where),
        friction=_friction(element.find("dynamics"), where),
    )


def _limits(limit: Element | None, kind: str, where: str) -> tuple[float, float, float, float]:
    """Lower and upper position, velocity, effort; infinite without a limit.

    Files write 0 for a velocity or an effort that they do not know: no limit.
    """
    if limit is None:
        return (-math.inf, math.inf, math.inf, math.inf)
    keys = "lower", "upper", "velocity", "effort"
    # Files write inf for no limit, as programs print it.
    lower, upper, velocity, effort = (
        numbers_of(limit, key, 1, "0", f"{where}, limit", finite=False)[0] for key in keys
    )
    # Two zeros, the defaults of URDF, state no limits.
    if kind == "continuous" or lower == upper == 0.0:
        lower = -math.inf
        upper = math.inf
    if lower > upper or lower == math.inf or upper == -math.inf or velocity < 0 or effort < 0:
        raise ValueError(
            f"{where} of {limit.path} must have limits with lower below upper, and magnitudes; got"
            f" lower {lower:g}, upper {upper:g}, velocity {velocity:g}, effort {effort:g}. Correct"
            " them."
        )
    return (lower, upper, velocity or math.inf, effort or math.inf)


def _friction(dynamics: Element | None, where: str) -> tuple[float, float]:
    """Viscous and Coulomb friction of a joint; NaN where the file does not state it."""
    # NaN is "not stated": a friction of 0 is a statement.
    stated = {} if dynamics is None else dynamics.attributes
    viscous, coulomb = (
        numbers_of(dynamics, key, 1, None, f"{where}, dynamics")[0] if key in stated else math.nan
        for key in ("damping", "friction")
    )
    if viscous < 0 or coulomb < 0:
        raise ValueError(
            f"{where} must not have negative friction; got {viscous:g} and {coulomb:g}. Correct it."
        )
    return viscous, coulomb


def is_xacro(element: Element) -> bool:
    """Whether an element, or one within it, is a macro or has an expression as a value."""
    # Meshes are never read, so an expression in the name of their file does not matter.
    values = [value for key, value in element.attributes.items() if key != "filename"]
    return (
        element.tag.startswith("xacro:")
        or any("${" in value or "$(" in value for value in values)
        or any(is_xacro(child) for child in element.children)
    )


def expanded(path: Path) -> bytes:
    """The URDF that a xacro file produces.

    Its macros may read other files and evaluate expressions. Paths are relative to the file in
    which they stand. A missing package matters only if a file is included from it; meshes are never
    read.
    """
    try:
        # Imported here: only xacro files need them. xacrodoc finds packages without ROS.
        import xacro
        from xacro import substitution_args
        from xacrodoc import packages
    except ImportError:
        raise ValueError(
            f"{path} must be a URDF file; it is xacro. Expand it (xacro {path.name} > robot.urdf),"
            " or pip install xacrodoc."
        ) from None
    absent = set[str]()

    def find(package: str) -> str:
        folder = _package_around(path.resolve(), package)
        if folder is not None:
            return str(folder)
        try:
            return str(packages.get_path(package))
        except packages.PackageNotFoundError:
            absent.add(package)
            return f"package://{package}"

    # xacro has no other place for a way to find packages.
    names = {
        "attribute": substitution_args._eval_find,
        "eval": substitution_args._eval_dict["find"],
    }
    substitution_args._eval_find = substitution_args._eval_dict["find"] = find
    try:
        text: str = xacro.process_file(str(path.resolve())).toxml()
    # Any exception may come out of the expressions of a macro.
    except Exception as error:
        advice = "Expand it by hand."
        if absent:
            advice = (
                f"Put the folder of {several(sorted(absent))} beside it or above, or install it."
            )
        cause = " ".join(str(error).split())
        raise ValueError(f"{path} must be xacro that can be expanded; {cause}. {advice}") from error
    finally:
        substitution_args._eval_find = names["attribute"]
        substitution_args._eval_dict["find"] = names["eval"]
    return text.encode()


def _package_around(path: Path, package: str) -> Path | None:
    """The folder of a package around or beside this file, as in a repository; None without one."""
    for folder in path.parents:
        manifest = folder / "package.xml"
        if folder.name == package or (
            manifest.is_file()
            and f"<name>{package}</name>"
            in read_bounded(manifest, 1 << 20).decode(errors="replace")
        ):
            return folder
        if (folder / package / "package.xml").is_file():
            return folder / package
    return None

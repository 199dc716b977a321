"""Links and joints of a URDF file: all numbers are checked, nothing is executed or fetched."""

import math
from pathlib import Path

import numpy as np

from plant.mechanics.body import Body, body_in
from plant.mechanics.model_tree import HERE, MOVING, ModelFile, ModelJoint
from plant.mechanics.placement import Placement
from plant.mechanics.xml_file import Element, numbers_of, parsed
from plant.parts.arguments import choice

# attributes of <inertia>, in the order of `Body.inertia`
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def read_urdf(path: str | Path) -> ModelFile:
    """Read a URDF file: links, joints, and the elements that state them; xacro is expanded."""
    robot, data = parsed(path, "robot", "URDF")
    # Macros cannot be read; their expansion can. The bytes then are those of the expansion.
    if is_xacro(robot):
        robot, data = parsed(path, "robot", "URDF", expanded(Path(path)))
    # Links first: an unnamed one is refused there.
    bodies = _bodies(robot)
    joints = _joints(robot)
    links = {link.attributes["name"]: link for link in robot.all("link")}
    return ModelFile(path=Path(path), data=data, bodies=bodies, joints=joints, links=links)


def origin_of(element: Element, where: str) -> Placement:
    """The pose in the <origin> of an element; the identity without one."""
    origin = element.find("origin")
    if origin is None:
        return HERE
    # Roll, pitch and yaw about fixed axes, in radians.
    position = numbers_of(origin, "xyz", 3, "0 0 0", f"{where}, origin")
    roll, pitch, yaw = numbers_of(origin, "rpy", 3, "0 0 0", f"{where}, origin")
    return Placement.of_angles(roll, pitch, yaw, position)


def _bodies(robot: Element) -> dict[str, Body | None]:
    """The Body of each link in its own frame, by name; None without mass."""
    bodies: dict[str, Body | None] = {}
    if not robot.all("link"):
        raise ValueError("the file must have links; it has none. Give a URDF file, xacro expanded.")
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        where = f"link {name}"
        if not name or name in bodies:
            raise ValueError(
                f"links must have names of their own; got {name!r} {'twice' if name else ''}."
                " Name it."
            )
        inertials = element.all("inertial")
        if len(inertials) > 1:
            raise ValueError(
                f"{where} must have one <inertial>; it has {len(inertials)}. Join them."
            )
        # A link without <inertial> is a frame alone.
        bodies[name] = None
        for inertial in inertials:
            mass = numbers_of(inertial.find("mass"), "value", 1, None, f"{where}, mass")[0]
            # About the centre of mass, along the axes of the <origin>; `body_in` turns it into the
            # axes of the link.
            matrix = inertial.find("inertia")
            inertia = [numbers_of(matrix, key, 1, None, f"{where}, inertia")[0] for key in INERTIA]
            bodies[name] = body_in(mass, np.array(inertia), name, origin_of(inertial, where))
    return bodies


def _joints(robot: Element) -> dict[str, ModelJoint]:
    """The joints of the file, by name."""
    joints: dict[str, ModelJoint] = {}
    for element in robot.all("joint"):
        name = element.attributes.get("name", "")
        kind = element.attributes.get("type", "")
        where = f"joint {name}"
        if not name or name in joints:
            raise ValueError(
                f"joints must have names of their own; got {name!r} {'twice' if name else ''}."
                " Name it."
            )
        # A chain has one coordinate per joint.
        if kind in ("floating", "planar"):
            raise ValueError(
                f"{where} must move about or along one axis; it is {kind}. Replace it by single"
                " joints."
            )
        choice(f"type of {where}", kind, (*MOVING, "fixed"))
        ends = [element.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.attributes.get("link", "") for end in ends)
        if not parent or not child:
            raise ValueError(
                f"{where} must have a parent and a child link; one is missing. Add it."
            )
        # The axis is in the frame of the joint, which is that of the child link.
        axis = numbers_of(element.find("axis"), "xyz", 3, "1 0 0", f"{where}, axis")
        # A fixed joint needs no axis; any other one needs a direction to turn about.
        if kind in MOVING and np.linalg.norm(axis) < 1e-6:
            raise ValueError(
                f"{where} must have an axis that is not zero; got {axis.tolist()}. Correct it."
            )
        mimic = element.find("mimic")
        # A mimic without a name still moves with another joint, so it is marked as one.
        mimics = "" if mimic is None else mimic.attributes.get("joint", "") or "another one"
        joints[name] = ModelJoint(
            name=name,
            kind=kind,
            parent=parent,
            child=child,
            origin=origin_of(element, where),
            axis=axis,
            mimics=mimics,
            limits=_limits(element.find("limit"), kind, where),
            element=element,
            friction=_friction(element.find("dynamics"), where),
        )
    return joints


def _limits(limit: Element | None, kind: str, where: str) -> tuple[float, float, float, float]:
    """Lower and upper position, velocity, effort; infinite without a limit.

    Files write 0 for a velocity or an effort that they do not know: no limit.
    """
    if limit is None or kind not in MOVING:
        return (-math.inf, math.inf, math.inf, math.inf)
    keys = "lower", "upper", "velocity", "effort"
    lower, upper, velocity, effort = (
        numbers_of(limit, key, 1, "0", f"{where}, limit")[0] for key in keys
    )
    # Two zeros, the defaults of URDF, state no limits.
    if kind == "continuous" or lower == upper == 0.0:
        lower = -math.inf
        upper = math.inf
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
    """Whether an element, or one within it, is a macro."""
    return element.tag.startswith("xacro:") or any(is_xacro(child) for child in element.children)


def expanded(path: Path) -> bytes:
    """The URDF that a xacro file produces.

    Its macros may read other files and evaluate expressions.
    """
    try:
        # Imported here: only xacro files need it.
        import xacrodoc
    except ImportError:
        raise ValueError(
            f"{path} must be a URDF file; it is xacro. Expand it (xacro {path.name} > robot.urdf),"
            " or pip install xacrodoc."
        ) from None
    try:
        text: str = xacrodoc.XacroDoc.from_file(str(path)).to_urdf_string()
    # Any exception may come out of the expressions of a macro.
    except Exception as error:
        raise ValueError(
            f"{path} must be xacro that can be expanded; {error}. Expand it by hand."
        ) from error
    return text.encode()

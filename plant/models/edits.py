"""Edits of a URDF or MJCF file: inertials, friction, rotors; MJCF text of a URDF's tree."""

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from plant.machine import Drive
from plant.mechanics import (
    FULL,
    INERTIA,
    MOVING,
    ORIENTATIONS,
    Body,
    Edit,
    Element,
    ModelFile,
    ModelJoint,
    Placement,
    holds,
    origin_of,
)


def urdf_inertial(data: bytes, link: Element, body: Body) -> list[Edit]:
    """Edits that give a URDF link this body, stated in the link's frame.

    The orientation of the inertial's origin stays, so the body is turned into its axes.
    """
    inertial = link.find("inertial")
    if inertial is None or not inertial.children:
        # A new inertial has the axes of the link.
        parts = (
            f'<origin xyz="{_text(body.com)}"/><mass value="{_text(body.mass)}"/>{_matrix(body)}'
        )
        if inertial is None:
            return [link.child_edit(data, f"<inertial>{parts}</inertial>", first=True)]
        # One edit: each of several would close the empty element.
        return [inertial.child_edit(data, parts)]
    # 1. Centre of mass and mass.
    edits = []
    for tag, name, value in (("origin", "xyz", body.com), ("mass", "value", body.mass)):
        element = inertial.find(tag)
        if element is None:
            text = f'<{tag} {name}="{_text(value)}"/>'
            edits.append(inertial.child_edit(data, text, first=tag == "origin"))
        else:
            edits += _changed(data, element, name, value)
    # 2. The inertia, in the axes that the file states.
    placement = Placement(rotation=origin_of(inertial, "inertial").rotation)
    turned = body.seen_from(placement.inverse())
    matrix = inertial.find("inertia")
    if matrix is None:
        edits.append(inertial.child_edit(data, _matrix(turned)))
    else:
        pairs = zip(INERTIA, turned.inertia, strict=True)
        # Rounding of the turn is no change of a small product.
        size = 1e-13 * float(np.abs(turned.inertia).max())
        for key, value in pairs:
            edits += _changed(data, matrix, key, value, size)
    return edits


def _changed(data, element, name, value, slack=0.0):
    """The edit of an attribute whose numbers in the file are others; the right ones stay."""
    words = element.attributes.get(name, "").split()
    try:
        stated = np.array([float(word) for word in words])
    except ValueError:
        stated = np.empty(0)
    value = np.atleast_1d(value)
    if stated.shape == value.shape and np.allclose(stated, value, rtol=1e-12, atol=slack):
        return []
    return [element.attribute_edit(data, name, _text(value))]


def _matrix(body):
    values = " ".join(
        f'{key}="{_text(value)}"' for key, value in zip(INERTIA, body.inertia, strict=True)
    )
    return f"<inertia {values}/>"


def urdf_friction(data: bytes, joint: Element, viscous: float, coulomb: float) -> list[Edit]:
    """Edits that give a URDF joint this damping and friction."""
    dynamics = joint.find("dynamics")
    # Joints without friction often have no such element.
    if dynamics is None:
        text = f'<dynamics damping="{_text(viscous)}" friction="{_text(coulomb)}"/>'
        return [joint.child_edit(data, text)]
    pairs = (("damping", viscous), ("friction", coulomb))
    return [dynamics.attribute_edit(data, name, _text(value)) for name, value in pairs]


def mjcf_inertial(data: bytes, body_element: Element, body: Body) -> list[Edit]:
    """Edits that give an MJCF body this body, with a full inertia in the body's own axes."""
    inertial = body_element.find("inertial")
    if inertial is None:
        # A second one would stand beside it, and MuJoCo takes the last.
        if holds(body_element, "inertial"):
            raise ValueError(
                "<inertial> must stand in its body to be written; that of"
                f" {body_element.attributes.get('name', 'a body')} is in a <frame>. Move it out."
            )
        return [body_element.child_edit(data, _mjcf_inertial_text(body), first=True)]
    # None removes an attribute: a full inertia allows no axes and no diagonal beside it.
    values: dict[str, str | None] = dict.fromkeys((*ORIENTATIONS, "diaginertia"))
    values |= {
        "pos": _text(body.com),
        "mass": _text(body.mass),
        "fullinertia": _text(body.inertia[list(FULL)]),
    }
    return [
        inertial.attribute_edit(data, key, value)
        for key, value in values.items()
        # What is not there needs no removal.
        if value or key in inertial.attributes
    ]


def _mjcf_inertial_text(body):
    full = _text(body.inertia[list(FULL)])
    # MJCF has the diagonal first, then the products of inertia.
    return f'<inertial pos="{_text(body.com)}" mass="{_text(body.mass)}" fullinertia="{full}"/>'


def mjcf_joint(data: bytes, joint: Element, values: dict[str, float]) -> list[Edit]:
    """Edits that give an MJCF joint these numbers: armature, damping, frictionloss."""
    return [joint.attribute_edit(data, name, _text(value)) for name, value in values.items()]


def mjcf_text(
    model: ModelFile,
    bodies: Mapping[str, Body],
    values: Mapping[str, Mapping[str, float]],
    gravity: Sequence[float],
    motors: str = "",
) -> bytes:
    """A tree of links as MJCF, without shapes; joints without values are fixed at zero.

    `bodies` by link replace those of the file; `values` by joint are armature, damping and
    frictionloss; `motors` is the section of the actuators.
    """
    lines = [
        f"<mujoco model={quoteattr(model.path.stem)}>",
        # Angles of URDF are radians, and limits hold where they are stated.
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option gravity="{_text(gravity)}"/>',
        "  <worldbody>",
    ]

    def add(link: str, pose: str, joint: ModelJoint | None, depth: int) -> None:
        indent = "  " * depth
        # The world of MJCF is there already, and has no inertial.
        in_world = link != "world"
        if in_world:
            lines.append(f"{indent}<body name={quoteattr(link)}{pose}>")
            body = bodies.get(link, model.bodies[link])
            if body is not None:
                lines.append(f"{indent}  {_mjcf_inertial_text(body)}")
        if joint is not None and joint.name in values:
            lines.append(f"{indent}  {_mjcf_joint_text(joint, values[joint.name])}")
        for carried in model.joints.values():
            if carried.parent == link:
                # MJCF takes the first two axes of the frame.
                axes = np.array(carried.origin.rotation).T[:2].ravel()
                position = _text(carried.origin.position)
                add(carried.child, f' pos="{position}" xyaxes="{_text(axes)}"', carried, depth + 1)
        if in_world:
            lines.append(f"{indent}</body>")

    # Roots are links that no joint carries.
    children = {joint.child for joint in model.joints.values()}
    for root in (link for link in model.bodies if link not in children):
        add(root, "", None, 2)
    lines.append("  </worldbody>")
    if motors:
        lines.append(f"  {motors}")
    return "\n".join([*lines, "</mujoco>", ""]).encode()


def mjcf_motors(joints: Sequence[str], drive: Drive) -> str:
    """The section of actuators: each motor is commanded by its torque on the motor side [N m]."""
    motors = []
    # Limits of the amplifiers as motor torque [N m].
    limits = drive.motor_gain * drive.current_limit
    for joint, gear, limit in zip(joints, drive.gear, limits, strict=True):
        control = ""
        if np.isfinite(limit):
            control = f' ctrllimited="true" ctrlrange="{_text((-limit, limit))}"'
        name = quoteattr(joint)
        motors.append(f'<motor name={name} joint={name} gear="{_text(gear)}"{control}/>')
    return "\n    ".join(["<actuator>", *motors]) + "\n  </actuator>"


def _mjcf_joint_text(joint, values):
    """A joint with its limits of position and effort."""
    # MOVING says of each kind of URDF joint whether it slides.
    kind = "slide" if MOVING[joint.kind] else "hinge"
    parts = [f'<joint name={quoteattr(joint.name)} type="{kind}" axis="{_text(joint.axis)}"']
    lower, upper, _, effort = joint.limits
    # Continuous joints have no limits.
    if np.isfinite([lower, upper]).all():
        parts.append(f'range="{_text((lower, upper))}"')
    # A joint may have a range and no effort, or the other way round.
    if np.isfinite(effort):
        parts.append(f'actuatorfrcrange="{_text((-effort, effort))}"')
    parts += [f'{name}="{_text(value)}"' for name, value in values.items()]
    return " ".join(parts) + "/>"


def _text(values):
    """Text of numbers that is read back as the same bits; zero has no sign."""
    return " ".join(repr(float(value) + 0.0) for value in np.atleast_1d(np.asarray(values, float)))

"""New inertials, friction and rotors for a URDF or MJCF file: edits of those bytes; MJCF made of
a URDF's tree.
"""

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

import numpy as np

from plant.machine.drive import Drive
from plant.mechanics.body import Body
from plant.mechanics.mjcf_file import FULL
from plant.mechanics.model_tree import MOVING, ModelFile, ModelJoint
from plant.mechanics.placement import Placement
from plant.mechanics.urdf_file import INERTIA, origin_of
from plant.mechanics.xml_file import ORIENTATIONS, Edit, Element
from plant.models.agreement import CheckedLink, mirrored, uniform
from plant.models.hypotheses import Stated

_LIKELY = 3.0  # of two repairs of what no body can have, the likelier by e^3 is taken


def only(trials: list[tuple[float, str, Stated]], best: Stated) -> bool:
    """Whether all other bodies that one mistake leaves agree with the file much less."""
    costs = [
        cost
        for cost, _, other in trials
        if not np.allclose(other.spread, best.spread, rtol=1e-3, atol=0)
    ]
    least = min(cost for cost, _, _ in trials)
    return bool(np.isfinite(least) and min(costs, default=np.inf) - least > _LIKELY)


def guess(link: CheckedLink, links: dict[str, CheckedLink]) -> Body | None:
    """The partner's body mirrored; or the link's shape filled, where all others are filled
    alike.
    """
    for partner, plane in link.partners:
        if partner.physical():
            return body_of(mirrored(partner, plane))
    others = [
        other
        for other in links.values()
        if other is not link and other.stated is not None and other.shape
    ]
    densities = [
        other.stated.mass / other.shape.volume
        for other in others
        if other.stated is not None
        and other.shape is not None
        and uniform(other.stated, other.shape)
    ]
    alike = (
        len(densities) > 1
        and len(densities) == len(others)
        and np.ptp(densities) < 0.01 * min(densities)
    )
    if link.shape is None or not alike:
        return None
    mass = float(np.median(densities)) * link.shape.volume
    spread = mass * link.shape.spread
    return body_of(
        Stated(mass, link.shape.centre, np.eye(3), np.trace(spread) * np.eye(3) - spread)
    )


def body_of(given: Stated) -> Body:
    """As a body in the link's frame."""
    turned = given.rotation @ given.inertia @ given.rotation.T
    return Body(mass=given.mass, com=given.com, inertia=turned[np.triu_indices(3)])


def urdf_inertial(data: bytes, link: Element, body: Body) -> list[Edit]:
    """Edits that give a URDF link this body (in the link's frame); the orientation of its origin
    stays.
    """
    inertial = link.find("inertial")
    if inertial is None:
        parts = f'<origin xyz="{_text(body.com)}"/><mass value="{_text(body.mass)}"/>'
        return [link.child_edit(data, f"<inertial>{parts}{_matrix(body)}</inertial>", first=True)]
    edits: list[Edit] = []
    for tag, name, value in (("origin", "xyz", body.com), ("mass", "value", body.mass)):
        if (element := inertial.find(tag)) is None:
            edits.append(
                inertial.child_edit(
                    data, f'<{tag} {name}="{_text(value)}"/>', first=tag == "origin"
                )
            )
        else:
            edits.append(element.attribute_edit(data, name, _text(value)))
    turned = body.seen_from(Placement(rotation=origin_of(inertial, "inertial").rotation).inverse())
    if (matrix := inertial.find("inertia")) is None:
        edits.append(inertial.child_edit(data, _matrix(turned)))
    else:
        pairs = zip(INERTIA, turned.inertia, strict=True)
        edits += [matrix.attribute_edit(data, key, _text(value)) for key, value in pairs]
    return edits


def _matrix(body: Body) -> str:
    values = " ".join(
        f'{key}="{_text(value)}"' for key, value in zip(INERTIA, body.inertia, strict=True)
    )
    return f"<inertia {values}/>"


def urdf_friction(data: bytes, joint: Element, viscous: float, coulomb: float) -> list[Edit]:
    """Edits that give a URDF joint this damping and friction."""
    dynamics = joint.find("dynamics")
    if dynamics is None:
        return [
            joint.child_edit(
                data, f'<dynamics damping="{_text(viscous)}" friction="{_text(coulomb)}"/>'
            )
        ]
    pairs = (("damping", viscous), ("friction", coulomb))
    return [dynamics.attribute_edit(data, name, _text(value)) for name, value in pairs]


def mjcf_inertial(data: bytes, body_element: Element, body: Body) -> list[Edit]:
    """Edits that give an MJCF body this body, with a full inertia in the body's own axes."""
    inertial = body_element.find("inertial")
    if inertial is None:
        return [body_element.child_edit(data, _mjcf_inertial_text(body), first=True)]
    values: dict[str, str | None] = dict.fromkeys((*ORIENTATIONS, "diaginertia"))
    values |= {
        "pos": _text(body.com),
        "mass": _text(body.mass),
        "fullinertia": _text(body.inertia[list(FULL)]),
    }
    there = inertial.attributes
    return [
        inertial.attribute_edit(data, key, value)
        for key, value in values.items()
        if value or key in there
    ]


def _mjcf_inertial_text(body: Body) -> str:
    full = _text(body.inertia[list(FULL)])
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
    """A tree of links as MJCF, without shapes: those joints move that have values, all others are
    fixed at zero.

    `bodies`, by link, are in place of the file's own; `values` by the name of each joint that moves
    are armature, damping, frictionloss; `motors` is their section.
    """
    lines = [
        f"<mujoco model={quoteattr(model.path.stem)}>",
        '  <compiler angle="radian" autolimits="true"/>',
        f'  <option gravity="{_text(gravity)}"/>',
        "  <worldbody>",
    ]

    def add(link: str, placed: str, joint: ModelJoint | None, depth: int) -> None:
        indent = "  " * depth
        own = link != "world"  # MJCF has one of its own, without a body
        lines.extend([f"{indent}<body name={quoteattr(link)}{placed}>"] * own)
        body = bodies.get(link, model.bodies[link]) if own else None
        if body is not None:
            lines.append(f"{indent}  {_mjcf_inertial_text(body)}")
        if joint is not None and joint.name in values:
            lines.append(f"{indent}  {_mjcf_joint_text(joint, values[joint.name])}")
        for other in model.joints.values():
            if other.parent == link:
                axes = np.array(other.origin.rotation).T[:2].ravel()
                pose = f' pos="{_text(other.origin.position)}" xyaxes="{_text(axes)}"'
                add(other.child, pose, other, depth + 1)
        lines.extend([f"{indent}</body>"] * own)

    children = {joint.child for joint in model.joints.values()}
    for root in (link for link in model.bodies if link not in children):
        add(root, "", None, 2)
    return "\n".join(
        [*lines, "  </worldbody>", *([f"  {motors}"] if motors else []), "</mujoco>", ""]
    ).encode()


def mjcf_motors(joints: Sequence[str], drive: Drive) -> str:
    """A section with the motor of each joint, which is commanded by the torque on its own side
    [N m].
    """
    motors = []
    for joint, gear, limit in zip(
        joints, drive.gear, drive.motor_gain * drive.current_limit, strict=True
    ):
        within = (
            f' ctrllimited="true" ctrlrange="{_text((-limit, limit))}"'
            if np.isfinite(limit)
            else ""
        )
        motors.append(
            f"<motor name={quoteattr(joint)} joint={quoteattr(joint)}"
            f' gear="{_text(gear)}"{within}/>'
        )
    return "\n    ".join(["<actuator>", *motors]) + "\n  </actuator>"


def _mjcf_joint_text(joint: ModelJoint, values: Mapping[str, float]) -> str:
    """A joint with its limits of position and effort."""
    kind = "slide" if MOVING[joint.kind] else "hinge"
    parts = [f'<joint name={quoteattr(joint.name)} type="{kind}" axis="{_text(joint.axis)}"']
    lower, upper, _, effort = joint.limits
    if np.isfinite([lower, upper]).all():
        parts.append(f'range="{_text((lower, upper))}"')
    if np.isfinite(effort):
        parts.append(f'actuatorfrcrange="{_text((-effort, effort))}"')
    return (
        " ".join([*parts, *(f'{name}="{_text(value)}"' for name, value in values.items())]) + "/>"
    )


def _text(values: object) -> str:
    """Numbers that are read back as the same bits; zero has no sign."""
    return " ".join(repr(float(value) + 0.0) for value in np.atleast_1d(np.asarray(values, float)))

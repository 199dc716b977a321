"""Payload and friction as script commands of a Universal Robots controller.

Source: Universal Robots, Script Manual, PolyScope X 10.6: set_target_payload, direct_torque.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from plant import Body, Rig
from plant.parts import Floats, instance, known_options, real


@known_options
def to_urscript(
    body: Body | None = None, friction: Sequence[tuple[float, Rig]] | None = None
) -> str:
    """Lines of URScript: the payload, and scales that compensate all of the friction.

    Parameters
    ----------
    body : Body, optional
        The payload in the tool flange's frame, such as ``Body(mass=load.mass, com=load.com)`` of
        `find_load`.
    friction : two pairs of (float, Rig), optional
        A scale, `viscous_scale` and `coulomb_scale` alike, and the rig that `identify` found under
        it: the remaining friction falls linearly with the scale.

    Raises
    ------
    ValueError
        Neither, a body that is not physical, equal scales, friction that does not fall.

    See Also
    --------
    identification.find_load, identification.identify

    Examples
    --------
    >>> from identification import to_urscript
    >>> from plant import Body
    >>> print(to_urscript(Body(mass=1.5, com=(0, 0, 0.05), inertia=(2e-3, 0, 0, 1e-3, 0, 3e-3))))
    set_target_payload(1.5, [0, 0, 0.05], [0.002, 0.001, 0.003, 0, 0, 0])
    """
    if body is None and friction is None:
        raise ValueError(
            "to_urscript needs a body or friction; got neither. Give Body(mass=..., com=...)."
        )
    lines = []
    if body is not None:
        body = instance("body", body, Body, "Give Body(mass=..., com=...).")
        # URScript takes Ixx, Iyy, Izz, Ixy, Ixz, Iyz; a body has the rows of the upper triangle.
        inertia = body.inertia[[0, 3, 5, 1, 2, 4]]
        # No body has such moments.
        if not body.mass > 0 or (inertia[:3] < 0).any():
            raise ValueError(
                f"body must have mass and moments that are not negative; got {body}. Correct it."
            )
        lines.append(
            f"set_target_payload({body.mass:.6g}, {_listed(body.com)}, {_listed(inertia)})"
        )
    if friction is not None:
        lines += [
            f"{name}_scale = {_listed(_scales(friction, name))}" for name in ("viscous", "coulomb")
        ]
    return "\n".join(lines)


def _scales(friction: Sequence[tuple[float, Rig]], name: str) -> Floats:
    """The scale of each joint, within 0 and 1, at which none of this friction remains."""
    if len(friction) != 2:
        raise ValueError(
            f"friction must be two pairs of a scale and a rig; got {len(friction)}. Identify under"
            " two."
        )
    # Two points of a line: friction that remains under each scale.
    scales = np.array([real("scale", scale, "Give 0 to 1.") for scale, _ in friction])
    low, high = (
        getattr(instance("rig", rig, Rig, "Give found.rig.").drive, name) for _, rig in friction
    )
    # Equal scales give no slope, which is refused below.
    slope = (high - low) / np.diff(scales) if np.ptp(scales) else np.zeros(low.shape)
    # Friction that does not fall was not compensated by this scale.
    if not (slope < 0).all():
        raise ValueError(
            f"{name} friction must fall as the scale grows; got {low} and {high}. Move scales"
            " apart."
        )
    return np.clip(scales[0] - low / slope, 0.0, 1.0)  # where the line through both is zero


def _listed(values: Any) -> str:
    """Numbers as a list of URScript, with six digits."""
    return f"[{', '.join(f'{value:.6g}' for value in values)}]"

"""Placement: the pose of a frame in another one, as rotation matrix and position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.parts.arguments import array
from plant.parts.fields import Floats, Nested
from plant.parts.part import Part, part, structure


def turn(axis: ArrayLike, angle: float) -> Floats:
    """Rotation matrix (3, 3) by an angle [rad] about an axis (3,) of any length."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + exact(np.sin(angle)) * cross + (1 - exact(np.cos(angle))) * (cross @ cross)


def exact(x: Any) -> Floats:
    """Sines and cosines with those of right angles made whole, which keeps the equations short."""
    return np.where(np.abs(x - np.round(x)) < 1e-15, np.round(x), x)


@part
class Placement(Part):
    """Pose of a frame in a reference frame.

    Parameters
    ----------
    rotation : (3, 3) array_like
        Rotation matrix: the frame's axes as columns, in the reference frame.
    position : (3,) array_like
        Its origin in the reference frame [m].

    Raises
    ------
    ValueError
        A matrix that is not a right-handed rotation.

    See Also
    --------
    plant.Link, plant.Body

    Examples
    --------
    >>> import numpy as np
    >>> from plant import Placement
    >>> tool = Placement.of_angles(0, 0, 0.5, position=(0.1, 0, 0))
    >>> print(np.round(tool.inverse().position, 3))
    [-0.088  0.048  0.   ]
    """

    rotation: Nested = structure(default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    position: Nested = structure(default=(0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        rotation = array(
            "rotation", self.rotation, (3, 3), advice="Give the axes of the frame as columns."
        )
        position = array("position", self.position, (3,), advice="Give x, y and z [m].")
        if (
            not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
            or np.linalg.det(rotation) < 0
        ):
            raise ValueError(
                f"rotation must be a right-handed rotation; got {rotation.tolist()}. Check its"
                " signs."
            )
        object.__setattr__(self, "rotation", tuple(tuple(row) for row in rotation.tolist()))
        object.__setattr__(self, "position", tuple(position.tolist()))

    def __matmul__(self, other: Placement) -> Placement:
        """Composition: `other`, a pose in this frame, as a pose in this frame's reference frame."""
        rotation = np.array(self.rotation)
        position = np.array(self.position)
        return Placement(
            rotation=rotation @ other.rotation, position=position + rotation @ other.position
        )

    def inverse(self) -> Placement:
        """Pose of the reference frame in this frame."""
        rotation = np.array(self.rotation).T
        return Placement(rotation=rotation, position=-rotation @ self.position)

    @classmethod
    def of_row(
        cls, *, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0
    ) -> Placement:
        """RotX(alpha) TransX(a) RotZ(theta) TransZ(d): a row of the modified Denavit-Hartenberg
        table.
        """
        twist = cls(rotation=turn((1, 0, 0), alpha), position=(a, 0.0, 0.0))
        return twist @ cls(rotation=turn((0, 0, 1), theta), position=(0.0, 0.0, d))

    @classmethod
    def of_angles(
        cls, roll: float, pitch: float, yaw: float, position: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Placement:
        """RotZ(yaw) RotY(pitch) RotX(roll), as URDF has them [rad]."""
        rotation = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
        return cls(rotation=rotation, position=position)


# angle [rad] up to which a model file's angle is taken for the right one that it rounds
RIGHT = 1e-3


def righted(pose: Placement) -> tuple[Placement, float]:
    """A pose of an axis z in the frame of another, angles within `RIGHT` of right ones put right;
    by how much.

    The angles are those of RotZ RotX RotZ: between the axes, and about each of them.
    """
    R = np.array(pose.rotation)
    between = np.arctan2(np.hypot(R[0, 2], R[1, 2]), R[2, 2])
    if np.sin(between) > RIGHT:
        angles = np.array([np.arctan2(R[0, 2], -R[1, 2]), between, np.arctan2(R[2, 0], R[2, 1])])
    else:  # parallel axes: one angle about both
        angles = np.array([0.0, between, np.arctan2(np.sign(R[2, 2]) * R[1, 0], R[0, 0])])
    quarters = np.round(angles / (np.pi / 2)) * (np.pi / 2)
    right = np.where(np.abs(angles - quarters) < RIGHT, quarters, angles)
    off = float(np.abs(right - angles).max())
    if off < 1e-9:
        return pose, 0.0
    rotation = turn((0, 0, 1), right[0]) @ turn((1, 0, 0), right[1]) @ turn((0, 0, 1), right[2])
    return Placement(rotation=rotation, position=pose.position), off


def axis_frame(axis: Floats) -> Floats:
    """A rotation whose z axis is this axis; the smallest turn that takes z there."""
    z = axis / np.linalg.norm(axis)
    if abs(z[0]) < 1e-12 and abs(z[1]) < 1e-12:
        return np.eye(3) if z[2] > 0 else np.diag([1.0, -1.0, -1.0])
    x = np.cross((0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])

"""Placement: the pose of a frame in another one, as rotation matrix and position."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.parts import Floats, Nested, Part, array, part, structure


def turn(axis: ArrayLike, angle: float) -> Floats:
    """Rotation matrix (3, 3) by an angle [rad] about an axis (3,) of any length."""
    # Rodrigues' formula: 1 + sin K + (1 - cos) K^2, K the cross-product matrix of the unit axis.
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + exact(np.sin(angle)) * cross + (1 - exact(np.cos(angle))) * (cross @ cross)


def exact(x: Any) -> Floats:
    """Sines and cosines, exact for right angles, whose zeros keep the equations short."""
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
        # R R^T = 1 within what files round, and no reflection (determinant +1).
        orthogonal = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        if not orthogonal or np.linalg.det(rotation) < 0:
            raise ValueError(
                f"rotation must be a right-handed rotation; got {rotation.tolist()}. Check its"
                " signs."
            )
        object.__setattr__(self, "rotation", tuple(tuple(row) for row in rotation.tolist()))
        object.__setattr__(self, "position", tuple(position.tolist()))

    def __matmul__(self, pose: Placement) -> Placement:
        """Composition: a pose given in this frame, in the reference frame of this frame."""
        rotation = np.array(self.rotation)
        position = np.array(self.position) + rotation @ pose.position
        return Placement(rotation=rotation @ pose.rotation, position=position)

    def inverse(self) -> Placement:
        """Pose of the reference frame in this frame."""
        # The inverse of a rotation is its transpose.
        rotation = np.array(self.rotation).T
        return Placement(rotation=rotation, position=-rotation @ self.position)

    @classmethod
    def of_row(
        cls, *, alpha: float = 0.0, a: float = 0.0, d: float = 0.0, theta: float = 0.0
    ) -> Placement:
        """RotX(alpha) TransX(a) RotZ(theta) TransZ(d): a row of the modified table."""
        # The twist of the previous link first, then the joint's own angle and offset.
        twist = cls(rotation=turn((1, 0, 0), alpha), position=(a, 0.0, 0.0))
        return twist @ cls(rotation=turn((0, 0, 1), theta), position=(0.0, 0.0, d))

    @classmethod
    def of_angles(
        cls, roll: float, pitch: float, yaw: float, position: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Placement:
        """RotZ(yaw) RotY(pitch) RotX(roll), as URDF has them [rad]."""
        rotation = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
        return cls(rotation=rotation, position=position)


# Angles [rad] of a model file that are closer than this to a right one are rounded right ones.
RIGHT = 1e-3


def righted(pose: Placement) -> tuple[Placement, float]:
    """A pose with the angles within `RIGHT` of right ones put right, and the largest change [rad].

    The angles are those of RotZ RotX RotZ: between the axes, and about each of them.
    """
    # R = RotZ(first) RotX(between) RotZ(second); between is the angle of the two z axes.
    R = np.array(pose.rotation)
    between = np.arctan2(np.hypot(R[0, 2], R[1, 2]), R[2, 2])
    if np.sin(between) > RIGHT:
        angles = np.array([np.arctan2(R[0, 2], -R[1, 2]), between, np.arctan2(R[2, 0], R[2, 1])])
    else:  # parallel axes: one angle about both
        angles = np.array([0.0, between, np.arctan2(np.sign(R[2, 2]) * R[1, 0], R[0, 0])])
    # Each angle snaps to its nearest quarter turn, if that is within the tolerance.
    quarters = np.round(angles / (np.pi / 2)) * (np.pi / 2)
    right = np.where(np.abs(angles - quarters) < RIGHT, quarters, angles)
    change = float(np.abs(right - angles).max())
    # A pose that is right but for rounding stays as the file has it: no warning.
    if change < 1e-9:
        return pose, 0.0
    rotation = turn((0, 0, 1), right[0]) @ turn((1, 0, 0), right[1]) @ turn((0, 0, 1), right[2])
    return Placement(rotation=rotation, position=pose.position), change


def axis_frame(axis: Floats) -> Floats:
    """A rotation whose z axis is this axis (3,), and whose x axis is perpendicular to the old z."""
    z = axis / np.linalg.norm(axis)
    # Parallel to z the cross product is zero and gives no direction.
    if abs(z[0]) < 1e-12 and abs(z[1]) < 1e-12:
        return np.eye(3) if z[2] > 0 else np.diag([1.0, -1.0, -1.0])
    # x is perpendicular to the old and the new z axis, and y completes a right-handed frame.
    x = np.cross((0.0, 0.0, 1.0), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])

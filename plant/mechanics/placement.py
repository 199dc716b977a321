"""Placement: one frame as seen from another."""

from __future__ import annotations

import numpy as np

from plant.parts.arguments import array
from plant.parts.part import Part, part, structure

__all__ = ["Placement", "turn"]


def turn(axis, angle):
    """Rotation matrix (3, 3) by an angle [rad] about the axis (3,), of any length."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + exact(np.sin(angle)) * cross + (1 - exact(np.cos(angle))) * (cross @ cross)


def exact(x):
    """Sines and cosines of right angles are whole numbers; rounding them back keeps the equations short."""
    return np.where(np.abs(x - np.round(x)) < 1e-15, np.round(x), x)


@part
class Placement(Part):
    """A frame: how it is turned and where it is.

    Parameters
    ----------
    rotation : (3, 3) array_like
        Its axes as columns, in the frame from which it is seen.
    position : (3,) array_like
        Its origin there [m].

    Raises
    ------
    ValueError
        A matrix that is no rotation.
    """

    rotation: tuple = structure(default=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    position: tuple = structure(default=(0.0, 0.0, 0.0))

    def __post_init__(self):
        rotation = array("rotation", self.rotation, (3, 3), advice="Give the axes of the frame as columns.")
        position = array("position", self.position, (3,), advice="Give x, y and z [m].")
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-9) or np.linalg.det(rotation) < 0:
            raise ValueError(f"rotation must be a right-handed rotation; got {rotation.tolist()}. Check its signs.")
        object.__setattr__(self, "rotation", tuple(tuple(row) for row in rotation.tolist()))
        object.__setattr__(self, "position", tuple(position.tolist()))

    def __matmul__(self, other):
        """The other frame, given in this one, as seen from where this one is seen from."""
        rotation, position = np.array(self.rotation), np.array(self.position)
        return Placement(rotation=rotation @ other.rotation, position=position + rotation @ other.position)

    def inverse(self):
        """The frame from which this one is seen, as seen from this one."""
        rotation = np.array(self.rotation).T
        return Placement(rotation=rotation, position=-rotation @ self.position)

    @classmethod
    def of_row(cls, *, alpha=0.0, a=0.0, d=0.0, theta=0.0):
        """RotX(alpha) TransX(a) RotZ(theta) TransZ(d): a row of the modified Denavit-Hartenberg table."""
        twist = cls(rotation=turn((1, 0, 0), alpha), position=(a, 0.0, 0.0))
        return twist @ cls(rotation=turn((0, 0, 1), theta), position=(0.0, 0.0, d))

    @classmethod
    def of_angles(cls, roll, pitch, yaw, position=(0.0, 0.0, 0.0)):
        """RotZ(yaw) RotY(pitch) RotX(roll), as URDF has them [rad]."""
        rotation = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
        return cls(rotation=rotation, position=position)

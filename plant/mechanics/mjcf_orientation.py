"""Orientations of MJCF: quat, axisangle, euler, xyaxes or zaxis, in the units that the compiler element sets."""

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.placement import turn
from plant.mechanics.xml_file import Element, numbers_of

ORIENTATIONS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")


def rotation_of(element: Element, where: str, *, degrees: bool, sequence: str) -> NDArray[np.float64]:
    """Rotation matrix (3, 3) of an element: its axes as columns, in the parent's frame.

    Parameters
    ----------
    element : Element
    where : str
        For messages.
    degrees : bool
        Unit of its angles.
    sequence : str
        ``eulerseq``: three of xyz, axes that turn along, or of XYZ, fixed axes.

    Raises
    ------
    ValueError
        Two orientations at once, numbers that are none.
    """
    given = [name for name in ORIENTATIONS if name in element.attributes]
    if len(given) > 1:
        raise ValueError(f"{where} must have one orientation; it has {' and '.join(given)}. Leave one out.")
    if not given:
        return np.eye(3)
    name = given[0]
    count = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}[name]
    values, unit = numbers_of(element, name, count, None, where), np.pi / 180 if degrees else 1.0
    if name == "euler":
        rotation = np.eye(3)
        for letter, angle in zip(sequence, values * unit, strict=True):
            step = turn(np.eye(3)["xyz".index(letter.lower())], angle)
            rotation = rotation @ step if letter.islower() else step @ rotation
        return rotation
    parts = {"quat": [values], "axisangle": [values[:3]], "xyaxes": [values[:3], values[3:]], "zaxis": [values]}[name]
    if min(np.linalg.norm(part) for part in parts) < 1e-9:
        raise ValueError(f"{where} must have a direction in {name}; got {values.tolist()}. Correct it.")
    if name == "axisangle":
        return turn(values[:3], values[3] * unit)
    if name == "quat":
        w, vector = values[0], values[1:]
        length = np.linalg.norm(vector)
        return turn(vector, 2 * np.arctan2(length, w)) if length else np.eye(3)
    if name == "zaxis":
        z = values / np.linalg.norm(values)
        axis, angle = np.cross((0, 0, 1), z), np.arccos(np.clip(z[2], -1, 1))
        return turn(axis if np.linalg.norm(axis) > 1e-10 else (1, 0, 0), angle)
    x = values[:3] / np.linalg.norm(values[:3])
    y = values[3:] - x * (x @ values[3:])
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])

"""Degrees and millimetres in the joints of a URDF file."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from plant.mechanics import Element, numbers_of, origin_of


@dataclass(frozen=True, kw_only=True)
class JointSettings:
    """What numbers of a joint cannot be in SI units.

    ``tests/benchmarks/strangers_models.py`` counts the mistakes that are found with them, and the
    alarms on public files.

    Parameters
    ----------
    turns : float
        Turns [-] that a limited joint makes at most to one side: cables of wrists allow two.
    degrees : float
        Largest limit [deg] that is one in degrees; what is larger stands for none.
    length : float
        Distance [m] of two joints above which a much shorter one is usual.
    longer : float
        Factor over the median of the file's distances.
    """

    turns: float = 2.0
    degrees: float = 720.0
    length: float = 3.0
    longer: float = 50.0


SETTINGS = JointSettings()


def mistakes_of_joints(robot: Element) -> Iterator[tuple[str, str, str]]:
    """Child link, joint and mistake of each joint whose numbers are in degrees or millimetres."""
    joints = [
        (joint.attributes.get("name", ""), child.attributes.get("link", ""), joint)
        for joint in robot.all("joint")
        for child in joint.all("child")
    ]
    distances = {name: _distance(joint, name) for name, _, joint in joints}
    # Joints at the same place say nothing of the robot's size.
    lengths = [length for length in distances.values() if length > 0]
    median = float(np.median(lengths)) if lengths else 0.0
    for name, link, joint in joints:
        if _turned_in_degrees(joint):
            yield link, name, "degrees for radians (rpy of the origin)"
        if _limited_in_degrees(joint, name):
            yield link, name, "degrees for radians (limits)"
        if distances[name] > max(SETTINGS.length, SETTINGS.longer * median):
            yield link, name, "millimetres for metres (xyz of the origin)"
    for element in robot.all("link"):
        name = element.attributes.get("name", "")
        if any(_turned_in_degrees(inertial) for inertial in element.all("inertial")):
            yield name, "", "degrees for radians (rpy of the inertial)"


def _distance(joint: Element, name: str) -> float:
    """Distance of a joint from that before it [m]; zero if it cannot be read."""
    try:
        return float(np.linalg.norm(origin_of(joint, name).position))
    except ValueError:
        return 0.0


def _turned_in_degrees(element: Element) -> bool:
    """Whether an angle of an origin is more than a turn."""
    try:
        angles = numbers_of(element.find("origin"), "rpy", 3, "0 0 0", "origin")
    except ValueError:
        return False
    # Programs round 2 pi up.
    return bool(np.abs(angles).max() > 2 * np.pi + 0.01)


def _limited_in_degrees(joint: Element, name: str) -> bool:
    """Whether a joint that turns has limits of more turns than cables allow, and fewer degrees."""
    limit = joint.find("limit")
    if joint.attributes.get("type") != "revolute" or limit is None:
        return False
    try:
        ends = [numbers_of(limit, key, 1, "0", name, finite=False)[0] for key in ("lower", "upper")]
    except ValueError:
        return False
    largest = float(np.abs(ends).max())
    # 100 and 1000 stand for no limit.
    power = largest > 0 and np.log10(largest) == np.round(np.log10(largest))
    return 2 * np.pi * SETTINGS.turns + 0.1 < largest <= SETTINGS.degrees and not power

"""What a URDF file says of a link beside its inertial: shapes, the joints on it, the link on the other side."""

import dataclasses
import re

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.urdf_file import origin_of
from plant.mechanics.xml_file import Element, numbers_of

_SIDES = (("left", "right"), ("l", "r"), ("fl", "fr"), ("hl", "hr"), ("rl", "rr"), ("lf", "rf"), ("lh", "rh"))
_PLANES = tuple(np.diag(signs) for signs in ((1, -1, 1), (-1, 1, 1), (1, 1, -1), (1, 1, 1)))
"""Reflections of a link on the other side; the last is none, for frames that are mirrored themselves."""


@dataclasses.dataclass(frozen=True)
class Shape:
    """Volume [m^3], centroid (3,) [m], second moments about it per unit mass (3, 3) [m^2], if uniformly filled; corners
    (2, 3) of the box around it, along the axes of the link's frame [m].
    """

    volume: float
    centre: NDArray[np.float64]
    spread: NDArray[np.float64]
    corners: NDArray[np.float64]

    def holds(self, com: NDArray[np.float64], spread: NDArray[np.float64], slack: float) -> bool:
        """Whether mass within the box can have this centre and these second moments per unit mass about it.

        Of anything between a and b the variance is at most (b - mean)(mean - a) (R. Bhatia, C. Davis, 2000). The box is
        taken larger by a share `slack` of its edges, since shapes in files are approximate.
        """
        wider = slack * (self.corners[1] - self.corners[0])
        below, above = com - self.corners[0] + wider, self.corners[1] - com + wider
        return bool((below > 0).all() and (above > 0).all() and (np.diag(spread) < below * above).all())


def shape_of(link: Element) -> Shape | None:
    """The primitives of a link's collision geometry, else of its visual one, as one uniform body; None without."""
    for tag in ("collision", "visual"):
        found = [shape for element in link.all(tag) if (shape := _primitive(element)) is not None]
        if found and len(found) == len(link.all(tag)):
            volume = sum(shape.volume for shape in found)
            centre = sum((shape.volume * shape.centre for shape in found), np.zeros(3)) / volume
            spread = sum(
                (s.volume * (s.spread + np.outer(s.centre - centre, s.centre - centre)) for s in found),
                np.zeros((3, 3)),
            )
            corners = np.array([each.corners for each in found])
            return Shape(
                volume, centre, spread / volume, np.array([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])
            )
    return None


def _primitive(element: Element) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not geometry.children:
        return None
    form, where = geometry.children[0], element.tag
    pose = origin_of(element, where)
    if form.tag == "box":
        edges = numbers_of(form, "size", 3, None, where)
        volume, spread, half = float(np.prod(edges)), np.diag(edges**2 / 12), edges / 2
    elif form.tag == "sphere":
        radius = numbers_of(form, "radius", 1, None, where)[0]
        volume, spread, half = 4 / 3 * np.pi * radius**3, np.eye(3) * radius**2 / 5, np.full(3, radius)
    elif form.tag == "cylinder":
        radius, length = (numbers_of(form, key, 1, None, where)[0] for key in ("radius", "length"))
        volume, spread = np.pi * radius**2 * length, np.diag([radius**2 / 4, radius**2 / 4, length**2 / 12])
        half = np.array([radius, radius, length / 2])
    else:
        return None
    if not volume > 0:
        return None
    rotation = np.array(pose.rotation)
    centre, reach = np.array(pose.position), np.abs(rotation) @ half
    return Shape(volume, centre, rotation @ spread @ rotation.T, np.array([centre - reach, centre + reach]))


def joint_places(robot: Element, name: str) -> NDArray[np.float64]:
    """Where the joints sit that a link carries, (k, 3) in its frame [m]."""
    found = []
    for joint in robot.all("joint"):
        parent = joint.find("parent")
        if parent is not None and parent.attributes.get("link") == name:
            found.append(origin_of(joint, f"joint {joint.attributes.get('name', '')}").position)
    return np.array(found).reshape(-1, 3)


def partner_of(name: str, names: list[str]) -> str | None:
    """The link on the other side, by its name: left and right, l and r."""
    for one, other in _SIDES:
        for mine, theirs in ((one, other), (other, one)):
            edges = (r"(?<![a-zA-Z])", r"(?![a-zA-Z])") if len(mine) < 3 else ("", "")
            for form in (str.lower, str.upper, str.capitalize):
                pattern = f"{edges[0]}{form(mine)}{edges[1]}"
                found = re.sub(pattern, form(theirs), name, count=1)
                if found != name and found in names:
                    return found
    return None


def mirrors(
    shapes: tuple[Shape | None, Shape | None], places: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """Reflections (3, 3) that take the partner's shape and joints to the link's own; several where nothing tells."""
    kept = []
    for plane in _PLANES:
        same = places[0].shape == places[1].shape and np.allclose(places[0], places[1] @ plane, atol=1e-4)
        if shapes[0] is not None and shapes[1] is not None:
            same = same and np.allclose(shapes[0].centre, plane @ shapes[1].centre, atol=1e-4)
            same = same and np.allclose(shapes[0].spread, plane @ shapes[1].spread @ plane, rtol=1e-3, atol=1e-9)
        if same:
            kept.append(plane)
    return kept

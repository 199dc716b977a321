"""What a URDF file says of a link: its inertial without each mistake that files have, shapes,
joints, other sides.
"""

import dataclasses
import itertools
import re
from collections.abc import Iterator

import numpy as np

from plant.mechanics.urdf_file import origin_of
from plant.mechanics.xml_file import Element, numbers_of
from plant.parts.fields import Floats


@dataclasses.dataclass(frozen=True)
class Stated:
    """An inertial as the file states it: mass, centre of mass and rotation in the link's frame,
    inertia in its own.
    """

    mass: float
    com: Floats
    rotation: Floats
    inertia: Floats

    @property
    def spread(self) -> Floats:
        """Second moments about the centre of mass (3, 3), in the link's axes [kg m^2]."""
        turned = self.rotation @ self.inertia @ self.rotation.T
        return np.asarray(np.trace(turned) / 2 * np.eye(3) - turned)

    def density(self) -> float:
        """Least density [kg/m^3] of the densest part: that of the ball with this mass and these
        second moments.

        Of all that is nowhere denser than rho, the ball has the least second moments.
        """
        radius = np.sqrt(5 / 3 * np.trace(self.spread) / self.mass)
        return float(self.mass / (4 / 3 * np.pi * radius**3))

    def physical(self) -> bool:
        """Whether a body can have it."""
        widths = np.linalg.eigvalsh(self.spread)
        return bool(
            self.mass > 0
            and widths[0] >= -1e-6 * max(np.abs(widths).max(), 1e-300)
            and widths[2] > 0
        )


_UNITS = (  # what was written in another unit -> mass, length, inertia of the file in SI
    ("grams for kilograms (mass)", 1e-3, 1.0, 1.0),
    ("grams for kilograms (mass and inertia)", 1e-3, 1.0, 1e-3),
    ("grams for kilograms (inertia)", 1.0, 1.0, 1e-3),
    ("millimetres for metres (centre of mass)", 1.0, 1e-3, 1.0),
    ("millimetres for metres (centre of mass and inertia)", 1.0, 1e-3, 1e-6),
    ("kg mm^2 for kg m^2 (inertia)", 1.0, 1.0, 1e-6),
    ("g mm^2 for kg m^2 (inertia)", 1.0, 1.0, 1e-9),
    ("grams and millimetres for kilograms and metres", 1e-3, 1e-3, 1e-9),
    ("centimetres for metres (centre of mass)", 1.0, 1e-2, 1.0),
    ("kg cm^2 for kg m^2 (inertia)", 1.0, 1.0, 1e-4),
)
SLIP = "a decimal point of a moment of inertia in the wrong place"  # one of several

_PRODUCTS = ((0, 1), (0, 2), (1, 2))


def without_mistakes(given: Stated) -> Iterator[tuple[str, Stated]]:
    """Each mistake in words, and the inertial without it."""
    m, c, I = given.mass, given.com, given.inertia  # noqa: E741 - the field's letter
    moments = np.diag(np.diag(I))
    orders = [list(order) for order in itertools.permutations(range(3))][1:]
    if m < 0 or (np.diag(I) < 0).any():
        turned = I * (1 - 2 * (np.trace(I) < 0))
        yield "a negative mass or inertia", dataclasses.replace(given, mass=abs(m), inertia=turned)
        whole = I - moments + np.abs(moments)
        yield "a negative moment of inertia", dataclasses.replace(given, mass=abs(m), inertia=whole)
    for words, mass, length, inertia in _UNITS:
        yield words, dataclasses.replace(given, mass=m * mass, com=c * length, inertia=I * inertia)
    apart = given.rotation.T @ c
    about = m * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    if np.abs(about).max() > 1e-9 * np.abs(I).max():
        yield (
            "inertia about the link's frame, not the centre of mass",
            dataclasses.replace(given, inertia=I - about),
        )
    products = np.array([I[place] for place in _PRODUCTS])
    if products.any():
        for signs in [*itertools.product((1, -1), repeat=3)][1:]:
            yield "products of inertia of the wrong sign", _with(given, products * np.array(signs))
        for order in orders:
            yield "products of inertia in another order", _with(given, products[order])
    for order in orders:
        exchanged = I - moments + np.diag(np.diag(I)[order])
        yield "moments of inertia in another order", dataclasses.replace(given, inertia=exchanged)
    for k, factor in itertools.product(range(3), (0.1, 0.01, 10.0, 100.0)):
        slipped = I.copy()
        slipped[k, k] *= factor
        yield SLIP, dataclasses.replace(given, inertia=slipped)
    for axis in range(3):
        plane = np.eye(3)
        plane[axis, axis] = -1.0
        turned = plane @ given.rotation @ plane
        yield (f"a link mirrored in {'xyz'[axis]}", Stated(m, plane @ c, turned, plane @ I @ plane))
        yield (
            f"a centre of mass mirrored in {'xyz'[axis]}",
            dataclasses.replace(given, com=plane @ c),
        )


def _with(given: Stated, products: Floats) -> Stated:
    inertia = given.inertia.copy()
    for (i, j), value in zip(_PRODUCTS, products, strict=True):
        inertia[i, j] = inertia[j, i] = value
    return dataclasses.replace(given, inertia=inertia)


_SIDES = (
    ("left", "right"),
    ("l", "r"),
    ("fl", "fr"),
    ("hl", "hr"),
    ("rl", "rr"),
    ("lf", "rf"),
    ("lh", "rh"),
)
# Reflections of a link on the other side; the last is none, for frames that are mirrored
# themselves.
_PLANES = tuple(np.diag(signs) for signs in ((1, -1, 1), (-1, 1, 1), (1, 1, -1), (1, 1, 1)))


@dataclasses.dataclass(frozen=True)
class Shape:
    """Volume [m^3], centroid (3,) [m], second moments about it per unit mass (3, 3) [m^2], if
    uniformly filled; corners (2, 3) of the box around it, along the axes of the link's frame [m].
    """

    volume: float
    centre: Floats
    spread: Floats
    corners: Floats

    def holds(self, com: Floats, spread: Floats, slack: float) -> bool:
        """Whether mass within the box can have this centre and these second moments per unit mass
        about it.

        Of anything between a and b the variance is at most (b - mean)(mean - a) (R. Bhatia, C.
        Davis, 2000). The box is taken larger by a share `slack` of its edges, since shapes in files
        are approximate.
        """
        wider = slack * (self.corners[1] - self.corners[0])
        below = com - self.corners[0] + wider
        above = self.corners[1] - com + wider
        return bool(
            (below > 0).all() and (above > 0).all() and (np.diag(spread) < below * above).all()
        )


def shape_of(link: Element) -> Shape | None:
    """The primitives of a link's collision geometry, else of its visual one, as one uniform
    body; None without.
    """
    for tag in ("collision", "visual"):
        found = [shape for element in link.all(tag) if (shape := _primitive(element)) is not None]
        if found and len(found) == len(link.all(tag)):
            volume = sum(shape.volume for shape in found)
            centre = sum((shape.volume * shape.centre for shape in found), np.zeros(3)) / volume
            apart = [np.outer(shape.centre - centre, shape.centre - centre) for shape in found]
            spread = sum(
                (s.volume * (s.spread + r) for s, r in zip(found, apart, strict=True)),
                np.zeros((3, 3)),
            )
            low, high = np.array([each.corners for each in found]).swapaxes(0, 1)
            return Shape(
                volume, centre, spread / volume, np.array([low.min(axis=0), high.max(axis=0)])
            )
    return None


def _primitive(element: Element) -> Shape | None:
    geometry = element.find("geometry")
    if geometry is None or not geometry.children:
        return None
    form = geometry.children[0]
    where = element.tag
    pose = origin_of(element, where)
    if form.tag == "box":
        edges = numbers_of(form, "size", 3, None, where)
        volume = float(np.prod(edges))
        spread = np.diag(edges**2 / 12)
        half = edges / 2
    elif form.tag == "sphere":
        radius = numbers_of(form, "radius", 1, None, where)[0]
        volume = 4 / 3 * np.pi * radius**3
        spread = np.eye(3) * radius**2 / 5
        half = np.full(3, radius)
    elif form.tag == "cylinder":
        radius, length = (numbers_of(form, key, 1, None, where)[0] for key in ("radius", "length"))
        volume = np.pi * radius**2 * length
        spread = np.diag([radius**2 / 4, radius**2 / 4, length**2 / 12])
        half = np.array([radius, radius, length / 2])
    else:
        return None
    if not volume > 0:
        return None
    rotation = np.array(pose.rotation)
    centre = np.array(pose.position)
    reach = np.abs(rotation) @ half
    return Shape(
        volume, centre, rotation @ spread @ rotation.T, np.array([centre - reach, centre + reach])
    )


def joint_places(robot: Element, name: str) -> Floats:
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
    shapes: tuple[Shape | None, Shape | None], places: tuple[Floats, Floats]
) -> list[Floats]:
    """Reflections (3, 3) that take the partner's shape and joints to the link's own; several
    where nothing tells.
    """
    kept = []
    for plane in _PLANES:
        same = places[0].shape == places[1].shape and np.allclose(
            places[0], places[1] @ plane, atol=1e-4
        )
        if shapes[0] is not None and shapes[1] is not None:
            same = same and np.allclose(shapes[0].centre, plane @ shapes[1].centre, atol=1e-4)
            same = same and np.allclose(
                shapes[0].spread, plane @ shapes[1].spread @ plane, rtol=1e-3, atol=1e-9
            )
        if same:
            kept.append(plane)
    return kept

"""Links of a URDF file: inertials without common mistakes, shapes, links on the other side."""

import itertools
import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace

import numpy as np

from plant.mechanics import HERE, Element, deferred, numbers_of, origin_of
from plant.parts import Floats


@dataclass(frozen=True)
class Inertial:
    """An inertial as the file states it.

    Mass, centre of mass and rotation are in the link's frame, the inertia in the inertial's own.
    """

    mass: float
    com: Floats
    rotation: Floats
    inertia: Floats

    @property
    def spread(self) -> Floats:
        """Second moments about the centre of mass (3, 3), in the link's axes [kg m^2]."""
        in_link = self.rotation @ self.inertia @ self.rotation.T
        return np.trace(in_link) / 2 * np.eye(3) - in_link

    def density(self) -> float:
        """Least density [kg/m^3] that the body's densest part can have: that of a uniform ball.

        Of all bodies that are nowhere denser than rho, the ball has the least second moments.
        """
        # The second moments of a ball have the trace 3/5 m r^2.
        radius = np.sqrt(5 / 3 * np.trace(self.spread) / self.mass)
        return float(self.mass / (4 / 3 * np.pi * radius**3))

    def about_joint(self) -> float:
        """Size of the inertia about the link's frame [kg m^2]."""
        steiner = abs(self.mass) * float(self.com @ self.com)
        return float(abs(np.trace(self.inertia))) + steiner

    def excess(self) -> float:
        """Share of the largest moment beyond the others' sum; infinite if one is negative."""
        moments = np.linalg.eigvalsh(self.inertia)
        # A thin rod has a moment of zero, which the eigenvalues miss by their rounding.
        if not (moments[2] > 0 and moments[0] >= -1e-9 * moments[2]):
            return np.inf
        return max(0.0, float((moments[2] - moments[0] - moments[1]) / moments[2]))

    def placeholder(self) -> bool:
        """Whether the inertia is one power of ten about every axis, as no computation gives it."""
        moments = np.diag(self.inertia)
        products = self.inertia - np.diag(moments)
        if products.any() or not moments[0] > 0 or np.ptp(moments) > 1e-9 * moments[0]:
            return False
        power = np.log10(moments[0])
        return bool(abs(power - np.round(power)) < 1e-9)

    def physical(self) -> bool:
        """Whether a body can have this inertial: mass > 0, second moments >= 0 and not all 0."""
        # Files round their numbers, so flat bodies have slightly negative moments.
        widths = np.linalg.eigvalsh(self.spread)
        return bool(
            self.mass > 0
            and widths[0] >= -1e-6 * max(np.abs(widths).max(), 1e-300)
            and widths[2] > 0
        )


# The mistake -> SI units per unit of mass, length and inertia in the file.
_UNITS = (
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

DECIMAL_POINT = "a decimal point of a moment of inertia in the wrong place"

# The term was taken off an inertia that was about the centre of mass already, which made that
# inertia too small, or negative.
PARALLEL_AXIS = "the parallel-axis term taken off twice"

_PRODUCTS = ((0, 1), (0, 2), (1, 2))  # places of the products of inertia in the matrix


def without_mistakes(stated: Inertial) -> Iterator[tuple[str, Inertial]]:
    """Each mistake in words, and the inertial without it."""
    m = stated.mass
    c = stated.com
    I = stated.inertia  # noqa: E741 - the field's letter
    moments = np.diag(np.diag(I))
    orders = [list(order) for order in itertools.permutations(range(3))][1:]

    # 1. Signs of mass and moments.
    if m < 0 or (np.diag(I) < 0).any():
        # The whole matrix has the wrong sign if its trace has.
        inertia = I * (1 - 2 * (np.trace(I) < 0))
        yield ("a negative mass or inertia", replace(stated, mass=abs(m), inertia=inertia))
        inertia = I - moments + np.abs(moments)
        yield ("a negative moment of inertia", replace(stated, mass=abs(m), inertia=inertia))

    # 2. Units.
    for words, mass, length, per_unit in _UNITS:
        yield (words, replace(stated, mass=m * mass, com=c * length, inertia=I * per_unit))

    # 3. The point about which the inertia is stated (Steiner).
    # The offset of the centre of mass in the axes of the inertia.
    shift = stated.rotation.T @ c
    steiner = m * (shift @ shift * np.eye(3) - np.outer(shift, shift))
    # At the origin of the frame both points are the same.
    if np.abs(steiner).max() > 1e-9 * np.abs(I).max():
        yield (
            "inertia about the link's frame, not the centre of mass",
            replace(stated, inertia=I - steiner),
        )
        yield PARALLEL_AXIS, replace(stated, inertia=I + steiner)

    # 4. Signs, order and size of single entries.
    products = np.array([I[entry] for entry in _PRODUCTS])
    if products.any():
        # All combinations of signs but the stated one.
        for signs in [*itertools.product((1, -1), repeat=3)][1:]:
            yield (
                "products of inertia of the wrong sign",
                _with_products(stated, products * np.array(signs)),
            )
        for order in orders:
            yield "products of inertia in another order", _with_products(stated, products[order])
    for order in orders:
        inertia = I - moments + np.diag(np.diag(I)[order])
        yield "moments of inertia in another order", replace(stated, inertia=inertia)
    # One or two places to the left or right.
    for k, factor in itertools.product(range(3), (0.1, 0.01, 10.0, 100.0)):
        inertia = I.copy()
        inertia[k, k] *= factor
        yield DECIMAL_POINT, replace(stated, inertia=inertia)

    # 5. Mirrored links: all of the inertial, or the centre of mass alone.
    for axis in range(3):
        plane = np.eye(3)
        plane[axis, axis] = -1.0
        # Mirrored twice, a rotation stays a rotation.
        rotation = plane @ stated.rotation @ plane
        yield (
            f"a link mirrored in {'xyz'[axis]}",
            Inertial(m, plane @ c, rotation, plane @ I @ plane),
        )
        yield (f"a centre of mass mirrored in {'xyz'[axis]}", replace(stated, com=plane @ c))


def symmetric(inertial: Inertial) -> bool:
    """Whether two moments are the same number: so no digit of the two is wrong."""
    moments = np.sort(np.diag(inertial.inertia))
    return bool((np.diff(moments) < 1e-6 * moments[2]).any())


def _with_products(stated, products):
    inertia = stated.inertia.copy()
    for (i, j), value in zip(_PRODUCTS, products, strict=True):
        inertia[i, j] = value
        inertia[j, i] = value
    return replace(stated, inertia=inertia)


# Words and abbreviations of the two sides: left and right, front, hind and rear.
_SIDES = (
    ("left", "right"),
    ("l", "r"),
    ("fl", "fr"),
    ("hl", "hr"),
    ("rl", "rr"),
    ("lf", "rf"),
    ("lh", "rh"),
)
# Motions that take a link to that on the other side, in the frames of the two: the frames may be
# mirrored themselves (the identity), turned by half a turn, as those of two fingers, or have their
# axes in another order. Of those that fit equally well the earlier ones are more frequent.
_SIGNS = [np.diag(signs) for signs in itertools.product((1.0, -1.0), repeat=3)]
_MOTIONS = [
    signs @ np.eye(3)[list(order)]
    for order in itertools.permutations(range(3))
    for signs in sorted(_SIGNS, key=lambda signs: -np.trace(signs))
]


@dataclass(frozen=True)
class Shape:
    """A uniformly filled shape of a link, in the link's frame.

    Volume [m^3], centroid (3,) [m], second moments about it per unit mass (3, 3) [m^2]; corners
    (2, 3) of the box around it, along the axes of the link's frame [m].
    """

    volume: float
    centre: Floats
    spread: Floats
    corners: Floats

    def holds(self, com: Floats, spread: Floats, slack: float) -> bool:
        """Whether mass within the box can have this centre and these second moments about it.

        The moments are per unit mass. The variance of any mass between a and b is at most
        (b - mean)(mean - a) (R. Bhatia, C. Davis, 2000). Each side is moved outwards by the share
        `slack` of the box's edge, since shapes in files are approximate.
        """
        # Distances of the centre from the sides of the larger box.
        wider = slack * (self.corners[1] - self.corners[0])
        below = com - self.corners[0] + wider
        above = self.corners[1] - com + wider
        return bool(
            (below > 0).all() and (above > 0).all() and (np.diag(spread) < below * above).all()
        )


def shape_of(link: Element) -> Shape | None:
    """The primitives of a link's collision geometry, else of its visual one, as one uniform body.

    None unless all parts of one of the two are primitives with a volume.
    """
    for tag in ("collision", "visual"):
        elements = link.all(tag)
        shapes = [shape for element in elements if (shape := _primitive(element)) is not None]
        # A part of the geometry would give too small a shape.
        if shapes and len(shapes) == len(elements):
            return _united(shapes)
    return None


def primitive(element: Element) -> bool:
    """Whether a geometry is a box, a cylinder or a sphere, or there is none."""
    geometry = element.find("geometry")
    return geometry is None or not geometry.children or geometry.children[0].tag in _PRIMITIVES


# Shapes that need no other file.
_PRIMITIVES = ("box", "cylinder", "sphere")


def _united(shapes):
    """One body of several shapes; where they overlap their mass counts twice."""
    # Parallel axes: moments of each shape about the common centre.
    volume = sum(shape.volume for shape in shapes)
    centre = sum((shape.volume * shape.centre for shape in shapes), np.zeros(3)) / volume
    spread = np.zeros((3, 3))
    for shape in shapes:
        shift = shape.centre - centre
        spread = spread + shape.volume * (shape.spread + np.outer(shift, shift))
    low, high = np.array([shape.corners for shape in shapes]).swapaxes(0, 1)
    corners = np.array([low.min(axis=0), high.max(axis=0)])
    return Shape(volume, centre, spread / volume, corners)


def _primitive(element):
    geometry = element.find("geometry")
    # Some files have empty geometries.
    if geometry is None or not geometry.children:
        return None
    form = geometry.children[0]
    label = element.tag
    pose = origin_of(element, label)
    if form.tag == "box":
        edges = numbers_of(form, "size", 3, None, label)
        volume = float(np.prod(edges))
        spread = np.diag(edges**2 / 12)
        half = edges / 2
    elif form.tag == "sphere":
        radius = numbers_of(form, "radius", 1, None, label)[0]
        volume = 4 / 3 * np.pi * radius**3
        spread = np.eye(3) * radius**2 / 5
        half = np.full(3, radius)
    elif form.tag == "cylinder":
        radius = numbers_of(form, "radius", 1, None, label)[0]
        length = numbers_of(form, "length", 1, None, label)[0]
        volume = np.pi * radius**2 * length
        spread = np.diag([radius**2 / 4, radius**2 / 4, length**2 / 12])
        half = np.array([radius, radius, length / 2])
    else:
        return None
    # A plane, NaN, or a negative size is no body.
    if not (volume > 0 and (half > 0).all()):
        return None
    rotation = np.array(pose.rotation)
    centre = np.array(pose.position)
    # Half edges of the box around the turned shape: exact for a box, but larger than need be for a
    # turned cylinder or sphere.
    reach = np.abs(rotation) @ half
    corners = np.array([centre - reach, centre + reach])
    return Shape(volume, centre, rotation @ spread @ rotation.T, corners)


def joint_positions(robot: Element) -> dict[str, Floats]:
    """Positions (k, 3) of the joints that each link carries, in its frame [m].

    On the two sides of a robot they have the same order, whichever the file has.
    """
    children = {_child_of(joint) for joint in robot.all("joint")}

    def pair(joint: Element) -> str:
        child = _child_of(joint)
        partner = partner_of(child, children)
        return min(child, partner) if partner else ""

    positions: dict[str, list[Floats]] = {}
    for joint in sorted(robot.all("joint"), key=pair):
        parent = joint.find("parent")
        position, _ = deferred(HERE, origin_of, joint, "joint")
        # A URDF joint has the origin of its child in the frame of its parent.
        if parent is not None:
            name = parent.attributes.get("link", "")
            positions.setdefault(name, []).append(np.array(position.position))
    return {name: np.array(places) for name, places in positions.items()}


def _child_of(joint):
    child = joint.find("child")
    return "" if child is None else child.attributes.get("link", "")


def ways(robot: Element) -> dict[str, float]:
    """Sum of the joints' offsets on the way from the base to each link [m], by the link's name."""
    parents: dict[str, tuple[str, float]] = {}
    for joint in robot.all("joint"):
        ends = [joint.find(tag) for tag in ("parent", "child")]
        parent, child = ("" if end is None else end.attributes.get("link", "") for end in ends)
        pose, _ = deferred(HERE, origin_of, joint, "joint")
        parents[child] = parent, float(np.linalg.norm(pose.position))
    result = {}
    for link in {*parents, *(parent for parent, _ in parents.values())}:
        total = 0.0
        name = link
        passed = set()
        # A loop of links ends where it began.
        while name in parents and name not in passed:
            passed.add(name)
            name, length = parents[name]
            total += length
        result[link] = total
    return result


def partner_of(name: str, names: Collection[str]) -> str | None:
    """The link on the other side, by its name: left and right, l and r."""
    for sides in _SIDES:
        for mine, theirs in (sides, sides[::-1]):
            # A short abbreviation must be a word of its own: "l" is in many words.
            border, end = (r"(?<![a-zA-Z])", r"(?![a-zA-Z])") if len(mine) < 3 else ("", "")
            # Names are written in one of these cases: left, LEFT, Left.
            for case in (str.lower, str.upper, str.capitalize):
                pattern = f"{border}{case(mine)}{end}"
                # Other words may hold that of a side, as "upright" does.
                for match in re.finditer(pattern, name):
                    partner = f"{name[: match.start()]}{case(theirs)}{name[match.end() :]}"
                    if partner in names:
                        return partner
    return None


def mirrors(
    shapes: tuple[Shape | None, Shape | None], joints: tuple[Floats, Floats]
) -> list[Floats]:
    """Rotations and reflections (3, 3) that take the partner's shape and joints to the link's own.

    There are several where neither shape nor joints decide. Axes are exchanged only where nothing
    else fits.
    """
    shape, partner = shapes
    motions: list[Floats] = []
    for motion in _MOTIONS:
        # Positions agree within 0.1 mm, second moments within a thousandth.
        same = joints[0].shape == joints[1].shape
        same = same and np.allclose(joints[0], joints[1] @ motion.T, atol=1e-4)
        if shape is not None and partner is not None:
            spread = motion @ partner.spread @ motion.T
            same = same and np.allclose(shape.centre, motion @ partner.centre, atol=1e-4)
            same = same and np.allclose(shape.spread, spread, rtol=1e-3, atol=1e-9)
        if same:
            motions.append(motion)
    along = [motion for motion in motions if np.array_equal(np.abs(motion), np.eye(3))]
    return along or motions

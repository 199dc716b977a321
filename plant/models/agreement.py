"""How well an inertial agrees with all else that a model file says, and what is impossible or
exact in it.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from plant.models.hypotheses import Shape, Stated
from plant.parts.fields import Floats

# Usual density [kg/m^3] of a link over the volume of its primitives, and the deviation of its
# logarithm.
_DENSITY = 1500.0
_TIMES = 1.2

# Share by which a link may be larger than its shape in the file, and what a body says that needs
# more.
_SLACK = 0.05
_OUTSIDE = 15.0

_FAR = 1.0  # the same share, for a proof: shapes for collisions leave parts out

_FAITHFUL = 3  # links that have to fit their shapes before shapes are taken for what links are

# density [kg/m^3] of nothing that links are made of: above that of osmium
_LIGHTEST = 1.0
HEAVIEST = 23000.0

# Relative differences at which a link is its partner mirrored, or its shape uniformly filled, and
# what that says.
_SAME = 1e-4
_UNIFORM = 2e-3
_COINCIDENCE = 15.0

_APART = 20.0  # what a whole difference from the link on the other side says

_CAP = 40.0  # most that one piece of evidence may say


@dataclasses.dataclass
class CheckedLink:
    """A link: what it states (None: no inertial), and what the file says beside it."""

    name: str
    stated: Stated | None
    shape: Shape | None
    places: Floats
    partners: Sequence[tuple[Stated, Floats]] = ()


def mirrored(given: Stated, plane: Floats) -> Stated:
    """The inertial on the other side of a plane."""
    turned = given.rotation @ given.inertia @ given.rotation.T
    return Stated(given.mass, plane @ given.com, np.eye(3), plane @ turned @ plane)


def coincides(given: Stated, link: CheckedLink) -> bool:
    """Whether an inertial is exactly that of the other side, or that of the shape uniformly
    filled.
    """
    alike = (
        agrees(given, mirrored(partner, plane))
        for partner, plane in link.partners
        if partner.physical()
    )
    return any(alike) or uniform(given, link.shape)


def agrees(one: Stated, other: Stated) -> bool:
    """Whether two inertials are the same."""
    return apart(one, other) < _SAME


def uniform(given: Stated, shape: Shape | None) -> bool:
    """Whether an inertial is that of the shape uniformly filled."""
    if shape is None:
        return False
    size = float(np.trace(shape.spread))
    spread = np.abs(given.spread / given.mass - shape.spread).max() < _UNIFORM * size
    return bool(spread and np.linalg.norm(given.com - shape.centre) < _UNIFORM * np.sqrt(size))


def impossible(given: Stated, link: CheckedLink, links: dict[str, CheckedLink]) -> bool:
    """Whether no body within the robot, or within the link's shape, can have this inertial, or is
    as dense.

    The shape may be a third of the link, as shapes for collisions are; but as large as it is where
    the other links of the file (at least `_FAITHFUL`) are all as large as theirs.
    """
    spread = given.spread / given.mass
    if given.density() > HEAVIEST:
        return True
    if link.shape is not None:
        dense = not _LIGHTEST < given.mass / link.shape.volume < HEAVIEST
        others = [
            each.shape.holds(each.stated.com, each.stated.spread / each.stated.mass, _SLACK)
            for each in links.values()
            if each is not link
            and each.shape is not None
            and each.stated is not None
            and each.stated.physical()
        ]
        faithful = len(others) >= _FAITHFUL and all(others)
        return dense or not link.shape.holds(given.com, spread, 2 * _SLACK if faithful else _FAR)
    whole = sum(
        float(np.linalg.norm(each.places, axis=1).max())
        for each in links.values()
        if len(each.places)
    )
    return bool(whole) and bool(
        max(np.linalg.norm(given.com), np.sqrt(np.trace(spread))) > 2.0 * whole
    )


def cost_of(given: Stated, link: CheckedLink, links: dict[str, CheckedLink]) -> float:
    """How little an inertial agrees with all else that the file says."""
    if not given.physical():
        return np.inf
    spread = given.spread / given.mass
    if link.shape is not None:
        scale = link.shape.spread
        where = given.com - link.shape.centre
        cost = 0.5 * min(_CAP, float(where @ np.linalg.solve(scale, where)))
        cost += 2.0 * min(_CAP, _divergence(spread, scale))
        cost += 0.5 * min(_CAP, (np.log(given.mass / link.shape.volume / _DENSITY) / _TIMES) ** 2)
        cost += 0.0 if link.shape.holds(given.com, spread, _SLACK) else _OUTSIDE
        cost -= _COINCIDENCE if uniform(given, link.shape) else 0.0
    else:
        masses = [
            other.stated.mass
            for other in links.values()
            if other is not link and other.stated is not None
        ]
        median = float(np.median([abs(mass) for mass in masses])) if masses else given.mass
        cost = 0.5 * min(_CAP, (np.log(given.mass / max(median, 1e-9)) / 1.5) ** 2)
        ends = np.linalg.norm(link.places, axis=1)
        size = max([*ends, 0.1 * _reach(links), 1e-3])
        middle = given.com - (link.places.mean(axis=0) / 2 if len(link.places) else 0.0)
        cost += 0.5 * min(_CAP, float(middle @ middle) / size**2)
        cost += 0.5 * min(_CAP, (np.log(np.trace(spread) / (0.3 * size) ** 2) / 2.0) ** 2)
    if link.partners:
        other = [
            apart(given, mirrored(partner, plane))
            for partner, plane in link.partners
            if partner.mass > 0
        ]
        cost += min([_CAP / 2, *(_APART * each for each in other)])
        cost -= _COINCIDENCE if other and min(other) < _SAME else 0.0
    return cost


def _reach(links: dict[str, CheckedLink]) -> float:
    """The longest distance of two joints on a link [m]."""
    return max(
        (
            float(np.linalg.norm(link.places, axis=1).max())
            for link in links.values()
            if len(link.places)
        ),
        default=0.1,
    )


def _divergence(spread: Floats, scale: Floats) -> float:
    """Log-det divergence of second moments from those of a shape; a flat body is as thick as a
    hundredth of it.
    """
    ratio = np.linalg.solve(scale, spread)
    sign, logarithm = np.linalg.slogdet(ratio + 1e-4 * np.eye(3))
    return float(np.trace(ratio) - logarithm - 3) if sign > 0 else _CAP


def apart(one: Stated, other: Stated) -> float:
    """How far two bodies are from each other, relative to their own size."""
    size = max(
        np.trace(one.spread) / one.mass, np.trace(np.abs(other.spread)) / abs(other.mass), 1e-12
    )
    mass = np.log(one.mass / abs(other.mass)) ** 2
    where = float((one.com - other.com) @ (one.com - other.com)) / size
    spread = float(np.abs(one.spread / one.mass - other.spread / other.mass).max()) / size
    return float(np.sqrt(mass + where + spread**2))

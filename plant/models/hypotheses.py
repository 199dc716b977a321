"""Mistakes that model files have, each undone: what an inertial would have been without it."""

import dataclasses
import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray


@dataclasses.dataclass(frozen=True)
class Stated:
    """An inertial as the file states it: mass, centre of mass and rotation in the link's frame, inertia in its own."""

    mass: float
    com: NDArray[np.float64]
    rotation: NDArray[np.float64]
    inertia: NDArray[np.float64]

    @property
    def spread(self) -> NDArray[np.float64]:
        """Second moments about the centre of mass (3, 3), in the link's axes [kg m^2]."""
        turned = self.rotation @ self.inertia @ self.rotation.T
        return np.asarray(np.trace(turned) / 2 * np.eye(3) - turned)

    def density(self) -> float:
        """Least density [kg/m^3] of the densest part: that of the ball with this mass and these second moments.

        Of all that is nowhere denser than rho, the ball has the least second moments.
        """
        radius = np.sqrt(5 / 3 * np.trace(self.spread) / self.mass)
        return float(self.mass / (4 / 3 * np.pi * radius**3))

    def physical(self) -> bool:
        """Whether a body can have it."""
        widths = np.linalg.eigvalsh(self.spread)
        return bool(self.mass > 0 and widths[0] >= -1e-6 * max(np.abs(widths).max(), 1e-300) and widths[2] > 0)


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
SLIP = "a decimal point of a moment of inertia in the wrong place"
"""One of several."""

_PRODUCTS = ((0, 1), (0, 2), (1, 2))


def without_mistakes(given: Stated) -> Iterator[tuple[str, Stated]]:
    """Each mistake in words, and the inertial without it."""
    m, c, I = given.mass, given.com, given.inertia  # noqa: E741 - the field's letter
    if m < 0 or (np.diag(I) < 0).any():
        signs = (abs(m), I * (1 - 2 * (np.trace(I) < 0)))
        yield "a negative mass or inertia", dataclasses.replace(given, mass=signs[0], inertia=signs[1])
        whole = I - np.diag(np.diag(I)) + np.diag(np.abs(np.diag(I)))
        yield "a negative moment of inertia", dataclasses.replace(given, mass=abs(m), inertia=whole)
    for words, mass, length, inertia in _UNITS:
        yield words, dataclasses.replace(given, mass=m * mass, com=c * length, inertia=I * inertia)
    apart = given.rotation.T @ c
    about = m * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    if np.abs(about).max() > 1e-9 * np.abs(I).max():
        yield "inertia about the link's frame, not the centre of mass", dataclasses.replace(given, inertia=I - about)
    products = np.array([I[place] for place in _PRODUCTS])
    if not products.any():
        products = np.zeros(0)
    for signs3 in itertools.product((1, -1), repeat=3) if len(products) else ():
        if min(signs3) < 0:
            yield "products of inertia of the wrong sign", _with(given, products * np.array(signs3))
    for order in itertools.permutations(range(3)) if len(products) else ():
        if order != (0, 1, 2):
            yield "products of inertia in another order", _with(given, products[list(order)])
    for order in itertools.permutations(range(3)):
        if order != (0, 1, 2):
            diagonal = np.diag(np.diag(I)[list(order)])
            yield (
                "moments of inertia in another order",
                dataclasses.replace(given, inertia=I - np.diag(np.diag(I)) + diagonal),
            )
    for k, factor in itertools.product(range(3), (0.1, 0.01, 10.0, 100.0)):
        slipped = I.copy()
        slipped[k, k] *= factor
        yield SLIP, dataclasses.replace(given, inertia=slipped)
    for axis in range(3):
        plane = np.eye(3)
        plane[axis, axis] = -1.0
        turned = plane @ given.rotation @ plane
        yield (
            f"a link mirrored in {'xyz'[axis]}",
            Stated(m, plane @ c, turned, plane @ I @ plane),
        )
        yield f"a centre of mass mirrored in {'xyz'[axis]}", dataclasses.replace(given, com=plane @ c)


def _with(given: Stated, products: NDArray[np.float64]) -> Stated:
    inertia = given.inertia.copy()
    for (i, j), value in zip(_PRODUCTS, products, strict=True):
        inertia[i, j] = inertia[j, i] = value
    return dataclasses.replace(given, inertia=inertia)

"""Ranges of the search: f from the size and the mass of the robot, by interval arithmetic.
Source: paper 3.6.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import Drive, puma560
from plant.parts.arguments import array, known_options, whole
from plant.parts.fields import Floats


@dataclasses.dataclass(frozen=True)
class Interval:
    """All numbers from `low` to `high`; sums, products and powers of intervals hold all results
    that are possible.

    The result is the exact range where every quantity occurs once, or always with the same sign of
    its influence, as in equation (3).
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low <= self.high):
            raise ValueError(
                f"an interval must be finite with low <= high; got [{self.low}, {self.high}]. Swap"
                " them."
            )

    @staticmethod
    def of(value: "Interval | ArrayLike") -> "Interval":
        """Interval of a number, a pair or an interval."""
        if isinstance(value, Interval):
            return value
        ends: Any = [value, value] if np.ndim(value) == 0 else value
        low, high = array("interval", ends, (2,), advice="Give a number, or low and high.")
        return Interval(float(low), float(high))

    def __add__(self, other: "Interval | ArrayLike") -> "Interval":
        other = Interval.of(other)
        return Interval(self.low + other.low, self.high + other.high)

    def __mul__(self, other: "Interval | ArrayLike") -> "Interval":
        other = Interval.of(other)
        products = [a * b for a in (self.low, self.high) for b in (other.low, other.high)]
        return Interval(min(products), max(products))

    def __pow__(self, exponent: int) -> "Interval":
        whole("exponent", exponent, "Multiply otherwise.")
        ends = [self.low**exponent, self.high**exponent]
        inside = [0.0] if exponent % 2 == 0 and self.low < 0 < self.high else []
        return Interval(min(ends + inside), max(ends))

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, other: "Interval | ArrayLike") -> "Interval":
        return self + -Interval.of(other)

    def __rsub__(self, other: "Interval | ArrayLike") -> "Interval":
        return -self + other

    __radd__ = __add__
    __rmul__ = __mul__


def centre_range(extent: ArrayLike) -> Interval:
    """Range of a coordinate of the centre of mass from the link's extent (l_min, l_max) [m]: its
    middle half.

    Source: paper eq. (5).
    """
    low, high = array(
        "extent", extent, (2,), advice="Give l_min and l_max of the link in its frame [m]."
    )
    return Interval(low / 2, high / 2)


def greatest_inertia(mass: float, radius: float) -> float:
    """Largest Izz [kg m^2] of a link: all of its greatest mass at its greatest radius [kg, m].
    Source: paper 3.6.
    """
    return mass * radius**2


@known_options
@dataclasses.dataclass(frozen=True, kw_only=True)
class LinkSize:
    """Size, mass and motor inertia of one link, each as a pair of bounds.

    Parameters
    ----------
    mass : pair
        Least and greatest mass [kg].
    x, y : pair
        Extent of the link in its frame, l_min and l_max [m].
    radius : float, optional
        Greatest distance of the centre of mass from the axis [m]; by default from x and y.
    motor_inertia : pair
        Least and greatest Jm, motor side [kg m^2].

    See Also
    --------
    identification.ranges

    Examples
    --------
    >>> from identification import LinkSize
    >>> LinkSize(mass=(10, 20), x=(-0.1, 0.5), y=(-0.1, 0.1), motor_inertia=(1e-4, 3e-4)).mass
    (10, 20)
    """

    mass: tuple[float, float]
    x: tuple[float, float]
    y: tuple[float, float]
    motor_inertia: tuple[float, float]
    radius: float | None = None

    def intervals(self, reflect: Callable[[float], float]) -> SimpleNamespace:
        """Intervals of m, x, y, Izz (about the centre of mass) and J; `reflect` takes Jm to the
        joint.
        """
        mass = Interval.of(self.mass)
        x = centre_range(self.x)
        y = centre_range(self.y)
        radius = self.radius
        if radius is None:
            radius = float(np.hypot(max(-x.low, x.high), max(-y.low, y.high)))
        inertia = Interval(0.0, greatest_inertia(mass.high, radius))
        low, high = self.motor_inertia
        return SimpleNamespace(
            m=mass, x=x, y=y, Izz=inertia, J=Interval(reflect(low), reflect(high))
        )


_MOTOR = (1e-4, 1e-3)  # Jm of a motor of the PUMA 560, at least and at most [kg m^2]

# What 3.6 says of the links of the paper's robot.
PUMA560 = (
    LinkSize(mass=(5, 25), x=(-0.24, 0.50), y=(-0.14, 0.14), motor_inertia=_MOTOR),
    LinkSize(mass=(1, 10), x=(-0.08, 0.08), y=(-0.50, 0.0), motor_inertia=_MOTOR, radius=0.25),
)


def ranges(
    equation: Callable[..., dict[str, Any]] = puma560.equation_3,
    sizes: Sequence[LinkSize] = PUMA560,
    drive: Drive | None = None,
    **lengths: ArrayLike,
) -> Floats:
    """Ranges (p, 2) of f from sizes and masses; without arguments, those of f1..f9 from what 3.6
    says of its robot.

    Parameters
    ----------
    equation : callable
        f in physical parameters, such as `plant.robots.puma560.equation_3`.
    sizes : sequence of LinkSize
    drive : Drive, optional
        Its gears reflect the motor inertias; by default that of the paper.
    **lengths : pair
        Further arguments of the equation, such as a3=(0.3, 0.5), the default with the paper's sizes
        [m].

    Returns
    -------
    (p, 2) numpy.ndarray
        Every f that the intervals allow: each end is the least or greatest value that a combination
        of terms can give.

    Raises
    ------
    ValueError
        Not one size per joint, or an interval whose ends are not low <= high.

    See Also
    --------
    identification.LinkSize

    Examples
    --------
    >>> from plant import puma560
    >>> from identification import LinkSize, ranges
    >>> sizes = [LinkSize(mass=(10, 20), x=(-0.1, 0.5), y=(-0.1, 0.1), motor_inertia=(1e-4, 3e-4))] * 2
    >>> ranges(puma560.equation_3, sizes, puma560.rig().drive, a3=(0.4, 0.45)).shape, ranges().shape
    ((9, 2), (9, 2))

    Source: paper 3.6.
    """
    motors = puma560.rig().drive if drive is None else drive

    def reflect(joint: int, motor_inertia: float) -> float:
        return float(motors.reflected_inertia(np.full(motors.n, motor_inertia))[joint])

    lengths = {"a3": (0.3, 0.5)} if sizes is PUMA560 and not lengths else lengths
    if len(sizes) != motors.n:
        raise ValueError(
            f"sizes must be {motors.n}, one per joint of the drive; got {len(sizes)}. Give each"
            " link's."
        )
    links = [size.intervals(functools.partial(reflect, joint)) for joint, size in enumerate(sizes)]
    f = equation(*links, **{name: Interval.of(length) for name, length in lengths.items()})
    return np.array([(value.low, value.high) for value in f.values()])

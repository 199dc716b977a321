"""`ranges`: ranges of f from the size and the mass of the robot, by interval arithmetic.

Source: paper 3.6.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant import Drive, puma560
from plant.parts import Floats, array, known_options, whole


@dataclass(frozen=True)
class Interval:
    """Numbers from `low` to `high`; sums, products and powers contain all possible results.

    The result is the exact range if every quantity occurs once, or always with the same sign of its
    influence, as in equation (3).
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
        """Interval from a number, a pair or an interval."""
        # Equations mix intervals with numbers, such as the pair of a length.
        if isinstance(value, Interval):
            return value
        ends: Any = [value, value] if np.ndim(value) == 0 else value
        low, high = array("interval", ends, (2,), advice="Give a number, or low and high.")
        return Interval(float(low), float(high))

    def __add__(self, value: "Interval | ArrayLike") -> "Interval":
        term = Interval.of(value)
        return Interval(self.low + term.low, self.high + term.high)

    def __mul__(self, value: "Interval | ArrayLike") -> "Interval":
        # Any pair of ends can give the extremes, by their signs.
        factor = Interval.of(value)
        products = [a * b for a in (self.low, self.high) for b in (factor.low, factor.high)]
        return Interval(min(products), max(products))

    def __pow__(self, exponent: int) -> "Interval":
        whole("exponent", exponent, "Multiply otherwise.")
        # An even power has its least value, zero, inside an interval around zero.
        ends = [self.low**exponent, self.high**exponent]
        inside = [0.0] if exponent % 2 == 0 and self.low < 0 < self.high else []
        return Interval(min(ends + inside), max(ends))

    def __neg__(self) -> "Interval":
        return Interval(-self.high, -self.low)

    def __sub__(self, value: "Interval | ArrayLike") -> "Interval":
        return self + -Interval.of(value)

    def __rsub__(self, value: "Interval | ArrayLike") -> "Interval":
        return -self + value

    __radd__ = __add__
    __rmul__ = __mul__


def centre_range(extent: ArrayLike) -> Interval:
    """Range of a coordinate of the centre of mass from the link's extent (l_min, l_max) [m].

    It is the middle half, from l_min / 2 to l_max / 2. Source: paper eq. (5).
    """
    low, high = array(
        "extent", extent, (2,), advice="Give l_min and l_max of the link in its frame [m]."
    )
    return Interval(low / 2, high / 2)


def greatest_inertia(mass: float, radius: float) -> float:
    """Largest Izz of a link: its greatest mass at its greatest radius [kg m^2].

    `mass` [kg], `radius` [m]. Source: paper 3.6.
    """
    return mass * radius**2


@known_options
@dataclass(frozen=True, kw_only=True)
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

    # Bounds, as a data sheet or a ruler gives them.
    mass: tuple[float, float]
    x: tuple[float, float]
    y: tuple[float, float]
    motor_inertia: tuple[float, float]
    radius: float | None = None

    def intervals(self, reflect: Callable[[float], float]) -> SimpleNamespace:
        """Intervals of m, x, y, Izz (about the centre of mass) and J = reflect(Jm)."""
        mass = Interval.of(self.mass)
        # Equation (5) reduces the extent to the range of the centre.
        x = centre_range(self.x)
        y = centre_range(self.y)
        radius = self.radius
        if radius is None:
            # The corner of the centre's rectangle that is furthest from the axis.
            radius = float(np.hypot(max(-x.low, x.high), max(-y.low, y.high)))
        inertia = Interval(0.0, greatest_inertia(mass.high, radius))
        # Reflection by the gear keeps the order of the bounds.
        low, high = self.motor_inertia
        return SimpleNamespace(
            m=mass, x=x, y=y, Izz=inertia, J=Interval(reflect(low), reflect(high))
        )


# Least and greatest Jm of a motor of the PUMA 560 [kg m^2]. Source: paper 3.6.
_MOTOR = (1e-4, 1e-3)

# Links of the paper's robot. Source: paper 3.6.
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
    """Ranges (p, 2) of f from sizes and masses; by default those of f1..f9 of the paper's robot.

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
        Every f that the intervals allow: each end is the least or greatest value of any combination
        of terms.

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
    >>> motor = (1e-4, 3e-4)
    >>> size = LinkSize(mass=(10, 20), x=(-0.1, 0.5), y=(-0.1, 0.1), motor_inertia=motor)
    >>> drive = puma560.rig().drive
    >>> ranges(puma560.equation_3, [size, size], drive, a3=(0.4, 0.45)).shape, ranges().shape
    ((9, 2), (9, 2))

    Source: paper 3.6.
    """
    # The paper's drive, so that the defaults give its printed ranges.
    motors = puma560.rig().drive if drive is None else drive

    # The gear of each joint reflects its motor's inertia to the joint side.
    def reflect(joint: int, motor_inertia: float) -> float:
        return float(motors.reflected_inertia(np.full(motors.n, motor_inertia))[joint])

    if sizes is PUMA560 and not lengths:
        lengths = {"a3": (0.3, 0.5)}
    if len(sizes) != motors.n:
        raise ValueError(
            f"sizes must be {motors.n}, one per joint of the drive; got {len(sizes)}. Give each"
            " link's."
        )
    links = [size.intervals(functools.partial(reflect, joint)) for joint, size in enumerate(sizes)]
    # The equation computes with intervals as it does with numbers.
    f = equation(*links, **{name: Interval.of(length) for name, length in lengths.items()})
    return np.array([(value.low, value.high) for value in f.values()])

"""Smooth references: sums of harmonics, moves from point to point, quintic splines."""

import abc
import functools
from collections.abc import Callable, Sequence

import numpy as np

from plant.motion.reference import Reference, Timed
from plant.parts import Floats, Nested, part, real, structure


class _Smooth(Reference):
    """Base of references whose derivatives of any order have one formula.

    Where a derivative jumps at an end of the motion, the formula gives its value inside the motion.
    """

    @abc.abstractmethod
    def _derivatives(self, t: Floats, orders: Sequence[int]) -> list[Floats]:
        """Derivatives of q of these orders, 0 for q itself, each (N, n), at times t (N,)."""

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        q, qd, qdd = self._derivatives(t, range(3))
        return q, qd, qdd

    def higher(self, t: Floats) -> tuple[Floats, Floats]:
        jerk, snap = self._derivatives(t, (3, 4))
        return jerk, snap


@part
class Harmonics(_Smooth):
    """Sum of harmonics of a period.

    q = offset + sum over j = 1..H of (cosine_j cos(j w t) + sine_j sin(j w t)), w = 2 pi / period;
    cosine_j and sine_j are column j of the amplitudes, the first column being j = 1.

    The trajectory of eq. (6) is ``puma560.reference()``. Source: paper 3.5.

    Parameters
    ----------
    period : float
        [s]
    offset : (n,) array_like
        [rad]
    cosine, sine : (n, H) array_like
        Amplitudes of the harmonics 1..H [rad].

    See Also
    --------
    plant.PointToPoint, plant.Spline, identification.design_motion

    Examples
    --------
    >>> from plant import Harmonics
    >>> path = Harmonics(period=4.0, offset=(0, 0), cosine=((0.3,), (0.2,)), sine=((0,), (0.1,)))
    >>> motion = path([0.0, 1.0])
    >>> motion.q.round(3)
    array([[0.3, 0.2],
           [0. , 0.1]])
    """

    period: float = structure(float)
    offset: Nested = structure()
    cosine: Nested = structure()
    sine: Nested = structure()

    def __post_init__(self) -> None:
        real("period", self.period, "Give it in seconds.", positive=True)
        # The offset gives the number of joints, to which the amplitudes must fit.
        n = len(self._keep("offset", ("n",), "One angle per joint."))
        shape = self._keep("cosine", (n, "H"), "One row per joint, one column per harmonic.").shape
        self._keep("sine", shape, "The same shape as cosine.")

    @property
    def n(self) -> int:  # type: ignore[override]  # the base declares a writable attribute
        return len(self.offset)

    @property
    def duration(self) -> float:  # type: ignore[override]  # the base's attribute is writable
        """One period [s]."""
        return self.period

    def _derivatives(self, t: Floats, orders: Sequence[int]) -> list[Floats]:
        """Derivatives of q; none of them jumps."""
        # Harmonic j is the real part of (cosine_j - i sine_j) exp(i j w t). Its derivative of order
        # k multiplies it by (i j w)**k before the real part is taken.
        rate = 2j * np.pi / self.period * np.arange(1, np.shape(self.cosine)[1] + 1)
        amplitude = np.asarray(self.cosine) - 1j * np.asarray(self.sine)
        waves = np.exp(t[:, None] * rate)
        sums = [np.einsum("ij,tj->ti", amplitude * rate**k, waves).real for k in orders]
        offset = np.asarray(self.offset)
        return [value + offset if k == 0 else value for k, value in zip(orders, sums, strict=True)]


@part
class PointToPoint(_Smooth):
    """Move from rest to rest by a polynomial of degree 5, then stay.

    The acceleration is zero at both ends.

    Parameters
    ----------
    start, goal : (n,) array_like
        [rad]
    duration : float
        [s]

    See Also
    --------
    plant.Spline, plant.Harmonics

    Examples
    --------
    >>> from plant import PointToPoint
    >>> path = PointToPoint(start=(0, 0), goal=(1, -0.5), duration=2.0)
    >>> path([1.0]).q
    array([[ 0.5 , -0.25]])
    """

    start: Nested = structure()
    goal: Nested = structure()
    duration: float = structure(float)

    def __post_init__(self) -> None:
        real("duration", self.duration, "Give it in seconds.", positive=True)
        n = len(self._keep("start", ("n",), "One angle per joint."))
        self._keep("goal", (n,), "One angle per joint, like start.")

    @property
    def n(self) -> int:  # type: ignore[override]  # the base declares a writable attribute
        return len(self.start)

    def _derivatives(self, t: Floats, orders: Sequence[int]) -> list[Floats]:
        """Derivatives of q; the third and higher ones jump at the ends."""
        # The only polynomial of degree 5 from 0 to 1 with zero slope and curvature at both ends.
        path = np.polynomial.Polynomial([0, 0, 0, 10, -15, 6])
        s = np.clip(t / self.duration, 0.0, 1.0)[:, None]
        # Before the start and after the goal all derivatives are zero.
        move = np.subtract(self.goal, self.start)
        start = np.asarray(self.start)
        inside = ((t >= 0) & (t <= self.duration))[:, None]
        return [
            inside * path.deriv(k)(s) * move / self.duration**k if k else start + path(s) * move
            for k in orders
        ]


@part
class Spline(Timed, _Smooth):
    """Quintic spline through points, by default from rest to rest; it stays at its last point.

    Parameters
    ----------
    times : (N,) array_like
        Times of the points [s]; they start at 0 and increase strictly.
    points : (N, n) array_like
        [rad]
    at_rest : bool
        True: speed and acceleration are zero at both ends. False: the ends are free, and six or
        more points are required; this suits a stretch of a longer motion, such as one from a log.

    See Also
    --------
    plant.PointToPoint, plant.Table

    Examples
    --------
    >>> from plant import Spline
    >>> path = Spline(times=(0, 1, 2), points=((0, 0), (0.5, 0.2), (1, 0)))
    >>> path([1.0]).q
    array([[0.5, 0.2]])
    """

    times: Nested = structure()
    points: Nested = structure()
    at_rest: bool = structure(bool, default=True)

    def __post_init__(self) -> None:
        self._keep(
            "points",
            (self._keep_times(from_zero=True), "n"),
            "One row per time, one column per joint.",
        )
        # A polynomial of degree 5 has six coefficients, and free ends give no conditions.
        if not self.at_rest and len(self.times) < 6:
            raise ValueError(
                f"points must be 6 or more if at_rest is False; got {len(self.times)}. Give more."
            )

    @functools.cached_property
    def _spline(self) -> Callable[..., Floats]:
        """Function of times within the motion and, optionally, the order of a derivative."""
        from scipy.interpolate import make_interp_spline  # costs 0.2 s, so only splines import it

        # Speed and acceleration are zero at rest.
        rest = [(1, np.zeros(self.n)), (2, np.zeros(self.n))]
        ends = (rest, rest) if self.at_rest else None
        # Without conditions at the ends scipy leaves out knots there (not-a-knot).
        return make_interp_spline(self.times, self.points, k=5, bc_type=ends)

    def _derivatives(self, t: Floats, orders: Sequence[int]) -> list[Floats]:
        """Derivatives of q; all of them are zero before the first time and after the last one.

        With `at_rest` those from the third on jump at the ends, without it those from the first on.
        Between the ends only the fifth jumps.
        """
        inside = ((t >= 0) & (t <= self.duration))[:, None]
        s = np.clip(t, 0, self.duration)
        return [inside * self._spline(s, k) if k else self._spline(s) for k in orders]

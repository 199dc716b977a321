"""Reference trajectories: position, velocity and acceleration of every joint as functions of time.

A reference called with times (N,) gives `Motion(q, qd, qdd)`, each (N, n), joint side, SI.
Source: paper 3.5.
"""

from __future__ import annotations

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant.machine import Rig
from plant.mechanics import Arm
from plant.motion.demand import sampled_demand
from plant.parts import (
    Floats,
    Nested,
    Part,
    Vector,
    array,
    declared,
    known_options,
    number,
    part,
    real,
    structure,
)


class Motion(NamedTuple):
    """Position [rad], velocity [rad/s] and acceleration [rad/s^2], each (N, n), joint side."""

    q: Floats
    qd: Floats
    qdd: Floats


class Reference(Part, abc.ABC):
    """Base of all references: a `@part` class that gives ``n``, ``duration`` and ``motion``.

    The duration is simulated by default; after it periodic references go on, and the others rest at
    their last point.

    See Also
    --------
    plant.Harmonics, plant.Spline, plant.PointToPoint, plant.Table

    Examples
    --------
    >>> from plant import puma560
    >>> path = puma560.reference()
    >>> path.n, path.duration
    (2, 3.65)
    >>> path([0.1]).qdd.shape
    (1, 2)
    >>> path.slowed(2.0).duration
    7.3
    >>> path.torque_share(puma560.arm(), puma560.rig()).round(2)
    array([0.52, 0.32])
    """

    n: int = declared("Number of joints.")
    duration: float = declared("How long the motion takes, or one period of it [s].")
    # Whether it stays at each point until the next one, as the goals of a servo do.
    held = False
    # Whether its speed jumps within it, as that along a table does.
    corners = False

    @abc.abstractmethod
    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Position, velocity and acceleration at times t (N,) [s].

        In rad, rad/s and rad/s^2, each (N, n), joint side.
        """

    def higher(self, t: Floats) -> tuple[Floats, Floats]:
        """Jerk [rad/s^3] and snap [rad/s^4] at times t (N,) [s], each (N, n).

        They are the third and fourth derivative of q.
        """
        name = type(self).__name__
        raise ValueError(
            f"a motion must have its third and fourth derivative here; {name} gives none. Put a"
            f" Spline through its points, or define {name}.higher(t)."
        )

    @property
    def links(self) -> Reference:
        """Motion that the links are to make; of motors before elastic gears it is another one."""
        return self

    @known_options
    def slowed(self, factor: float) -> Scaled:
        """The same motion, uniformly scaled to `factor` times its duration; below one it is faster.

        Speeds are divided by it, accelerations by its square; it ends, repeats or stays as this
        motion does.
        """
        factor = real(
            "factor", factor, "Give how many times as long the motion is to take.", positive=True
        )
        # Two points of a time law with one speed: the place is linear in time.
        end = self.duration
        speed = 1.0 / factor
        law = {"times": (0.0, end * factor), "places": (0.0, end), "speeds": (speed, speed)}
        return Scaled(path=self, stays=False, accelerations=(0.0, 0.0), **law)

    def later(self, time: float) -> Later:
        """The same motion from `time` [s] on, q(t + time), as in a log that begins within it."""
        return Later(reference=self, time=time)

    def moved(self, signs: ArrayLike, offset: ArrayLike) -> Moved:
        """The same motion in other coordinates, signs q + offset: (n,) signs, (n,) [rad]."""
        return Moved(reference=self, signs=signs, offset=offset)

    @known_options
    def torque_share(self, arm: Arm, rig: Rig) -> Floats:
        """Peak torque (n,) over the amplifiers' limits, to follow this motion with its friction.

        During one duration, of coupled motors per shaft. Above 1 no controller can follow; feedback
        torque comes on top. Arm and rig are those identified, ``found.arm`` and ``found.rig``.
        """
        return sampled_demand(arm, rig, self)[-1].share(1.0)

    def __call__(self, t: ArrayLike) -> Motion:
        """Motion at times t (N,) [s] from the start."""
        times = array("t", t, ("N",), advice="Give times in seconds from the start.")
        return Motion(*(np.ascontiguousarray(x, dtype=float) for x in self.motion(times)))

    def _keep(self, name: str, shape: tuple[int | str | None, ...], advice: str) -> Floats:
        """Check a field and hold it as nested tuples, which can be compared and written."""
        value = array(name, getattr(self, name), shape, advice=advice)
        object.__setattr__(self, name, _nested(value))
        return value


def _nested(value: Any) -> Any:
    return tuple(_nested(v) for v in value) if np.ndim(value) else float(value)


class Timed(Reference):
    """Base of references by a table of times: they last until the last one."""

    times: Nested
    points: Nested

    def _keep_times(self, *, from_zero: bool = False) -> int:
        """Check the times, and count them."""
        times = self._keep("times", ("N",), "Give the time of each point [s].")
        # Equal times would be a jump, of infinite speed.
        stuck = np.flatnonzero(np.diff(times) <= 0)
        if len(stuck):
            i = int(stuck[0]) + 1
            raise ValueError(
                f"times must increase; got {times[i]} after {times[i - 1]} at index {i}. Sort them."
            )
        if len(times) < 2 or (from_zero and times[0] != 0):
            rule = "two or more, from 0" if from_zero else "two or more"
            raise ValueError(
                f"times must be {rule}; got {len(times)}: {times[:3]}. Give the whole path."
            )
        return len(times)

    @property
    def n(self) -> int:  # type: ignore[override]  # declared, and read only
        return len(self.points[0])

    @property
    def duration(self) -> float:  # type: ignore[override]  # declared, and read only
        """The last time [s]."""
        return float(self.times[-1])


@part
class Scaled(Timed):
    """The path of a reference under a time law: q(t) = path.q(s(t)), s the path's own time.

    Between two points of the time law s is the polynomial of degree 5 with their places, speeds and
    accelerations, so the joints' acceleration is continuous where that of the path is. `fastest`
    and `Reference.slowed` make such laws.

    Parameters
    ----------
    path : Reference
    times, places : (N,) array_like
        Strictly increasing, from 0 [s], and s, the path's own time, then [s].
    speeds, accelerations : (N,) array_like
        First and second derivative of s by time [1], [1/s].
    stays : bool
        Outside its times the motion rests at its first or last point. With False it goes on along
        the path, at the first or last speed; a periodic path repeats.
    """

    path: Reference = structure(Reference)
    times: Nested = structure()
    places: Nested = structure()
    speeds: Nested = structure()
    accelerations: Nested = structure()
    stays: bool = structure(bool, default=True)

    def __post_init__(self) -> None:
        count = self._keep_times(from_zero=True)
        # A time law changes the deflection of gears: motors must be derived after it.
        if self.path.links is not self.path:
            kind = type(self.path).__name__
            raise ValueError(
                f"path must be the motion of the links; got {kind}, of motors. Scale its .links."
            )
        for name in ("places", "speeds", "accelerations"):
            self._keep(name, (count,), "One number per time.")

    @property
    def n(self) -> int:  # type: ignore[override]  # declared, and read only
        return self.path.n

    @property
    def corners(self) -> bool:  # type: ignore[override]  # as the path
        return self.path.corners

    @known_options
    def slowed(self, factor: float) -> Scaled:
        """The same path under this time law, uniformly scaled; as `Reference.slowed`."""
        factor = real(
            "factor", factor, "Give how many times as long the motion is to take.", positive=True
        )
        times = np.multiply(self.times, factor)
        speeds = np.divide(self.speeds, factor)
        a = np.divide(self.accelerations, factor**2)
        return dataclasses.replace(self, times=times, speeds=speeds, accelerations=a)

    @functools.cached_property
    def _law(self) -> tuple[Callable[[Floats], Floats], ...]:
        """Functions of time: s and its four derivatives."""
        from scipy.interpolate import BPoly  # 0.2 s, for those who use it

        # Degree 5 through place, speed and acceleration of both neighbours.
        law = BPoly.from_derivatives(
            self.times, np.column_stack([self.places, self.speeds, self.accelerations])
        )
        return law, *(law.derivative(k) for k in range(1, 5))

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        place, derivatives = self._places(t)
        speed, acceleration = derivatives[:2]
        # The chain rule: derivatives of q by s, times those of s by time.
        q, along, bend = self.path.motion(place)
        return q, along * speed, bend * speed**2 + along * acceleration

    def higher(self, t: Floats) -> tuple[Floats, Floats]:
        """Jerk and snap at times (N,), by the chain rule; they jump at points of the time law."""
        # Derivatives of s by time, and of q by s.
        place, (v, a, j, s) = self._places(t)
        _, q1, q2 = self.path.motion(place)
        q3, q4 = self.path.higher(place)
        jerk = q3 * v**3 + 3 * q2 * v * a + q1 * j
        snap = q4 * v**4 + 6 * q3 * v**2 * a + q2 * (3 * a**2 + 4 * v * j) + q1 * s
        return jerk, snap

    def _places(self, t: Floats) -> tuple[Floats, list[Floats]]:
        """The path's own time at times (N,), and its four derivatives, each (N, 1)."""
        inside = np.clip(t, 0.0, self.duration)
        # The polynomials hold between the first and the last time alone.
        values = [derivative(inside) for derivative in self._law]
        # Outside its times the law has no acceleration; it stops, or goes on at the speed there.
        beyond = t - inside
        speed = np.where((beyond != 0) & self.stays, 0.0, values[1])
        higher = [np.where(beyond != 0, 0.0, value) for value in values[2:]]
        return values[0] + speed * beyond, [value[:, None] for value in (speed, *higher)]


class Derived(Reference):
    """Base of references derived from another one, with its joints and its duration."""

    reference: Reference

    @property
    def n(self) -> int:  # type: ignore[override]  # declared, and read only
        return self.reference.n

    @property
    def corners(self) -> bool:  # type: ignore[override]  # as the other one
        return self.reference.corners

    @property
    def duration(self) -> float:  # type: ignore[override]  # declared, and read only
        """Duration of the other motion [s]."""
        return self.reference.duration

    @property
    def held(self) -> bool:  # type: ignore[override]  # declared, and read only
        return self.reference.held


@part
class Later(Derived):
    """The motion of a reference that began `time` [s] earlier: q(t) = reference.q(t + time)."""

    reference: Reference = structure(Reference)
    time: float = number(())

    @property
    def links(self) -> Reference:
        """The links' motion, from the same instant on."""
        links = self.reference.links
        return self if links is self.reference else links.later(self.time)

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        return self.reference.motion(t + self.time)

    def higher(self, t: Floats) -> tuple[Floats, Floats]:
        return self.reference.higher(t + self.time)


@part
class Moved(Derived):
    """The motion of a reference in other coordinates: q(t) = signs reference.q(t) + offset."""

    reference: Reference = structure(Reference)
    signs: Vector = number(("n",))
    offset: Vector = number(("n",))

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require_joints(self.reference.n)

    @property
    def links(self) -> Reference:
        """The links' motion, in the same coordinates."""
        links = self.reference.links
        return self if links is self.reference else links.moved(self.signs, self.offset)

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        q, qd, qdd = self.reference.motion(t)
        return self.signs * q + self.offset, self.signs * qd, self.signs * qdd

    def higher(self, t: Floats) -> tuple[Floats, Floats]:
        jerk, snap = self.reference.higher(t)
        return self.signs * jerk, self.signs * snap

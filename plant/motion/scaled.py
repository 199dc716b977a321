"""The same path in another time: a reference whose path is another's, run through by a time law of its own."""

from __future__ import annotations

import functools

import numpy as np

from plant.motion.reference import Reference, require_increasing
from plant.parts.arguments import instance, known_options, real
from plant.parts.part import part, structure

__all__ = ["Scaled", "slowed"]


@part
class Scaled(Reference):
    """The path of a reference, passed at other times: q(t) = path.q(s(t)), where s is the time of the path.

    Between two points of the time law s is the polynomial of degree 5 that has place, speed and acceleration of both,
    so the acceleration of the joints is continuous where that of the path is. `fastest` and `slowed` make such laws.

    Parameters
    ----------
    path : Reference
    times : (N,) array_like
        Strictly increasing, from 0 [s].
    places : (N,) array_like
        s, the path's own time, at these times [s].
    speeds, accelerations : (N,) array_like
        First and second derivative of s by time [1], [1/s].
    stays : bool
        Outside its times the motion stays at its first or last point. With False it goes on along the path, at the
        first or last speed, and a periodic path repeats.
    """

    path: Reference = structure(Reference)
    times: tuple = structure()
    places: tuple = structure()
    speeds: tuple = structure()
    accelerations: tuple = structure()
    stays: bool = structure(bool, default=True)

    def __post_init__(self):
        times = self._keep("times", ("N",), "Give the times of the law [s].")
        if len(times) < 2 or times[0] != 0:
            raise ValueError(f"times must be two or more, from 0; got {times[:3]}. Start the law at t = 0.")
        require_increasing("times", times)
        for name in ("places", "speeds", "accelerations"):
            self._keep(name, (len(times),), "One number per time.")

    @property
    def n(self):
        """Number of joints."""
        return self.path.n

    @property
    def duration(self):
        """The last time [s]."""
        return self.times[-1]

    @functools.cached_property
    def _law(self):
        """Functions of time: s and its two derivatives."""
        from scipy.interpolate import BPoly  # 0.2 s, for those who use it

        law = BPoly.from_derivatives(self.times, np.column_stack([self.places, self.speeds, self.accelerations]))
        return law, law.derivative(1), law.derivative(2)

    def motion(self, t):
        """Motion at times (N,), by the chain rule."""
        inside = np.clip(t, 0.0, self.duration)
        s, speed, acceleration = (derivative(inside) for derivative in self._law)
        beyond = t - inside
        speed = np.where((beyond != 0) & self.stays, 0.0, speed)
        acceleration = np.where(beyond != 0, 0.0, acceleration)
        q, along, bend = self.path.motion(s + speed * beyond)
        return q, along * speed[:, None], bend * speed[:, None] ** 2 + along * acceleration[:, None]


@known_options
def slowed(reference, factor):
    """The same motion, `factor` times as long; below one it is faster.

    Parameters
    ----------
    reference : Reference
    factor : float
        Speeds become 1 / factor, accelerations 1 / factor^2 of what they were.

    Returns
    -------
    Scaled
        It ends, repeats or stays as the reference does.
    """
    instance("reference", reference, Reference, "The order is reference, factor.")
    factor = real("factor", factor, "Give how many times as long the motion is to take.", positive=True)
    if not isinstance(reference, Scaled):
        end = reference.duration
        law = {"path": reference, "places": (0.0, end), "speeds": (1.0, 1.0), "accelerations": (0.0, 0.0)}
        reference = Scaled(times=(0.0, end), stays=False, **law)
    return Scaled(
        path=reference.path,
        times=np.multiply(reference.times, factor),
        places=reference.places,
        speeds=np.divide(reference.speeds, factor),
        accelerations=np.divide(reference.accelerations, factor**2),
        stays=reference.stays,
    )

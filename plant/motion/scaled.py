"""Time scaling: the path of a reference under another time law."""

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from plant.motion.reference import Reference, Timed
from plant.parts.arguments import instance, known_options, real
from plant.parts.fields import Nested
from plant.parts.part import part, structure


@part
class Scaled(Timed):
    """The path of a reference under a time law: q(t) = path.q(s(t)), where s is the path's own time.

    Between two points of the time law s is the polynomial of degree 5 with their places, speeds and accelerations, so
    the joints' acceleration is continuous where that of the path is. `fastest` and `slowed` make such laws.

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
        Outside its times the motion rests at its first or last point. With False it goes on along the path, at the
        first or last speed; a periodic path repeats.
    """

    path: Reference = structure(Reference)
    times: Nested = structure()
    places: Nested = structure()
    speeds: Nested = structure()
    accelerations: Nested = structure()
    stays: bool = structure(bool, default=True)

    def __post_init__(self) -> None:
        count = self._keep_times(from_zero=True)
        if self.path.links is not self.path:
            given = type(self.path).__name__
            raise ValueError(f"path must be the motion of the links; got {given}, of motors. Scale its .links.")
        for name in ("places", "speeds", "accelerations"):
            self._keep(name, (count,), "One number per time.")

    @property
    def n(self) -> int:  # type: ignore[override]  # declared, and read only
        """Number of joints."""
        return self.path.n

    @functools.cached_property
    def _law(self) -> tuple[Callable[[NDArray[np.float64]], NDArray[np.float64]], ...]:
        """Functions of time: s and its four derivatives."""
        from scipy.interpolate import BPoly  # 0.2 s, for those who use it

        law = BPoly.from_derivatives(self.times, np.column_stack([self.places, self.speeds, self.accelerations]))
        return law, *(law.derivative(k) for k in range(1, 5))

    def motion(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Motion at times (N,), by the chain rule."""
        place, (speed, acceleration, *_) = self._places(t)
        q, along, bend = self.path.motion(place)
        return q, along * speed, bend * speed**2 + along * acceleration

    def higher(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Jerk and snap at times (N,), by the chain rule; both jump at the points of the time law."""
        place, (v, a, j, s) = self._places(t)
        _, first, second = self.path.motion(place)
        third, fourth = self.path.higher(place)
        return (
            third * v**3 + 3 * second * v * a + first * j,
            fourth * v**4 + 6 * third * v**2 * a + second * (3 * a**2 + 4 * v * j) + first * s,
        )

    def _places(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[NDArray[np.float64]]]:
        """The path's own time at times (N,), and its four derivatives, each (N, 1)."""
        inside = np.clip(t, 0.0, self.duration)
        s, speed, *higher = (derivative(inside) for derivative in self._law)
        beyond = t - inside
        speed = np.where((beyond != 0) & self.stays, 0.0, speed)
        higher = [np.where(beyond != 0, 0.0, each) for each in higher]
        return s + speed * beyond, [each[:, None] for each in (speed, *higher)]


@known_options
def slowed(reference: Reference, factor: float) -> Scaled:
    """The same motion, uniformly scaled to `factor` times its duration; below one it is faster.

    Parameters
    ----------
    reference : Reference
    factor : float
        Speeds are divided by it, accelerations by its square.

    Returns
    -------
    Scaled
        It ends, repeats or stays as the reference does.

    See Also
    --------
    plant.fastest

    Examples
    --------
    >>> from plant import puma560, slowed
    >>> path = puma560.reference()
    >>> slowed(path, 2.0).duration / path.duration
    2.0
    """
    instance("reference", reference, Reference, "The order is reference, factor.")
    factor = real("factor", factor, "Give how many times as long the motion is to take.", positive=True)
    if not isinstance(reference, Scaled):
        end = reference.duration
        law = {"times": (0.0, end), "places": (0.0, end), "speeds": (1.0, 1.0), "accelerations": (0.0, 0.0)}
        reference = Scaled(path=reference, stays=False, **law)
    return Scaled(
        path=reference.path,
        times=np.multiply(reference.times, factor),
        places=reference.places,
        speeds=np.divide(reference.speeds, factor),
        accelerations=np.divide(reference.accelerations, factor**2),
        stays=reference.stays,
    )

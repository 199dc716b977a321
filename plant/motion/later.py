"""A reference from a later instant on, as in a log that begins in the middle of a motion."""

import numpy as np
from numpy.typing import NDArray

from plant.motion.reference import Reference
from plant.parts.part import number, part, structure


@part
class Later(Reference):
    """The motion of a reference that began before: q(t) = reference.q(t + time).

    Parameters
    ----------
    reference : Reference
    time : float
        How long it has been under way [s].

    See Also
    --------
    plant.Reference, plant.slowed

    Examples
    --------
    >>> from plant import Later, puma560
    >>> path = puma560.reference()
    >>> print((Later(reference=path, time=0.5)([0.0]).q == path([0.5]).q).all())
    True
    """

    reference: Reference = structure(Reference)
    time: float = number(())

    @property
    def n(self) -> int:  # type: ignore[override]  # declared, and read only
        """Number of joints."""
        return self.reference.n

    @property
    def duration(self) -> float:  # type: ignore[override]  # declared, and read only
        """That of the reference, which goes on or rests after it."""
        return self.reference.duration

    @property
    def links(self) -> Reference:
        """The links' motion, from the same instant on."""
        links = self.reference.links
        return self if links is self.reference else Later(reference=links, time=self.time)

    def motion(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Motion at times (N,)."""
        return self.reference.motion(t + self.time)

    def higher(self, t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Jerk and snap at times (N,)."""
        return self.reference.higher(t + self.time)

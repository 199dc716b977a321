"""Transport between a sampled controller and its arm: delayed torque and lost samples.

The commanded torque of a sample acts `delay` later; until then the one before does. In a sub-step both act for their
part of it, so that a delay is not rounded to sub-steps: the impulse is exact, its place in the sub-step is not. At a
sample whose counts are lost the law reads those of the sample before.

Whether sample k is lost is one bit of a whole number, so that loops that are simulated side by side on one time table
have losses of their own, drawn beforehand.
"""

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.parts.part import Part, number, part, structure


@part
class Transport(Part):
    """Delayed torque and lost samples of a rig, under a law with a period; linear analysis leaves them out.

    Parameters
    ----------
    delay : float
        From a sample to its torque [s], at most one period of the law.
    lost : sequence of int
        Steps of the law, counted from 0, whose counts do not arrive; those of step 0 always do.
    bit : float
        1 / 2^j for the loop whose losses are the bits of value 2^j; 1 for a loop on its own.

    See Also
    --------
    plant.Rig, plant.Jitter

    Examples
    --------
    >>> from plant import Transport
    >>> Transport(delay=0.0005, lost=(100, 101))
    Transport(delay=0.0005, lost=(100, 101), bit=1.0)
    """

    delay: float = number((), default=0.0)
    lost: tuple[int, ...] = structure(default=())
    bit: float = number((), default=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.delay < 0:
            raise ValueError(f"delay must not be negative; got {self.delay}. Give seconds after the sample.")
        lost = self.lost
        if isinstance(lost, str) or not np.iterable(lost):
            raise ValueError(f"lost must be a sequence of steps; got {lost!r:.60}. Write ({lost!r:.60},).")
        if not all(isinstance(k, (int, np.integer)) and k >= 1 for k in lost):
            raise ValueError(f"lost must be whole numbers of at least 1; got {lost!r:.60}. The first counts arrive.")
        object.__setattr__(self, "lost", tuple(int(k) for k in lost))

    def words(self, steps: int) -> NDArray[np.float64]:
        """Words (steps,) of one loop: 1 at the steps of the law whose counts are lost, 0 at the others."""
        words = np.zeros(steps)
        words[[k for k in self.lost if k < steps]] = 1.0
        return words

    def arrived(self, pulses: ca.SX, seen: ca.SX, word: ca.SX) -> ca.SX:
        """Counts that the law reads: these, or those that it read last."""
        shifted = ca.floor(word * self.bit)
        lost = shifted - 2 * ca.floor(shifted / 2)
        return lost * seen + (1 - lost) * pulses

    def acting(self, torque: ca.SX, before: ca.SX, place: ca.SX, h: ca.SX) -> ca.SX:
        """Mean torque in sub-step `place` (from 0) after a step of the law; h is its length [s]."""
        share = ca.fmin(ca.fmax(place + 1 - self.delay / h, 0), 1)
        return share * torque + (1 - share) * before

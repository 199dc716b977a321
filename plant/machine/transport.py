"""What comes between a sampled controller and its arm: torque that acts late, and counts that do not arrive.

The torque that the law asks for at a sample acts `delay` later; until then the one before does. Within a sub-step both
act for their share of it, so that a delay is not rounded to sub-steps: the impulse is right, not its place inside.
A sample whose counts are lost is one at which the law reads those of the sample before.

Whether sample k is lost stands in one bit of a whole number that many loops share, so that each of those that run side
by side has losses of its own, drawn beforehand.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.parts.part import Part, number, part, structure

__all__ = ["Transport"]


@part
class Transport(Part):
    """Late torque and lost counts of a rig, under a law with a period; linear analysis leaves it out.

    Parameters
    ----------
    delay : float
        By which the torque acts later than its sample [s], at most one period of the law.
    lost : sequence of int
        Steps of the law, counted from 0, whose counts do not arrive; the first one's always do.
    bit : float
        1 / 2^j, of the loop that has the bits of value 2^j; 1 for a loop on its own.
    """

    delay: float = number((), default=0.0)
    lost: tuple = structure(default=())
    bit: float = number((), default=1.0)

    def __post_init__(self):
        super().__post_init__()
        if self.delay < 0:
            raise ValueError(f"delay must not be negative; got {self.delay}. Give seconds after the sample.")
        lost = self.lost
        if isinstance(lost, str) or not np.iterable(lost):
            raise ValueError(f"lost must be a sequence of steps; got {lost!r:.60}. Write ({lost!r:.60},).")
        if not all(isinstance(k, (int, np.integer)) and k >= 1 for k in lost):
            raise ValueError(f"lost must be whole numbers of at least 1; got {lost!r:.60}. The first counts arrive.")
        object.__setattr__(self, "lost", tuple(int(k) for k in lost))

    def words(self, steps):
        """Of so many steps of the law, 1 where the counts are lost and 0 elsewhere, (steps,)."""
        words = np.zeros(steps)
        words[[k for k in self.lost if k < steps]] = 1.0
        return words

    def arrived(self, pulses, seen, word):
        """Counts that the law reads: these, or those that it saw last."""
        shifted = ca.floor(word * self.bit)
        lost = shifted - 2 * ca.floor(shifted / 2)
        return lost * seen + (1 - lost) * pulses

    def acting(self, torque, before, place, h):
        """Torque, on average, in the sub-step at this place (from 0) after a step of the law; h is its length [s]."""
        share = ca.fmin(ca.fmax(place + 1 - self.delay / h, 0), 1)
        return share * torque + (1 - share) * before

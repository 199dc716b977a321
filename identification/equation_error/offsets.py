"""Which joints have friction that differs by direction: by evidence, one number after another.

An offset of the torque (unequal levels of Coulomb friction, a current or torque sensor that is not
zeroed) and viscous friction of two slopes are columns that every arm may have and few need. All
joints are fitted with them; then the one with the least evidence is taken away, given the others,
until each has enough. On the EMPS benchmark the slope remains and the offset goes: the error of the
force on the other file falls from 4.2 to 3.1 %. The evidence is
a log Bayes factor: chi squared against the width of the prior.

Source: R. E. Kass, A. E. Raftery, Bayes factors, Journal of the American Statistical Association 90
(1995).
"""

from collections.abc import Sequence

import numpy as np

from plant.parts import Floats, Integers, frozen_settings, product


@frozen_settings
class OffsetSettings:
    """When a joint has a friction offset, or viscous friction by direction.

    Parameters
    ----------
    evidence : float
        Log Bayes factor from which on an offset is fitted: odds of 20 to 1, "strong" (Kass and
        Raftery).
    share : float
        Prior standard deviation of an offset in the joint's Coulomb level, and of a viscous one in
        its viscous friction: two directions of motion that differ by as much. Chosen by hand.
    """

    evidence: float = 3.0
    share: float = 1.0


SETTINGS = OffsetSettings()


def evident(values: Floats, covariance: Floats, offsets: Sequence[int], levels: Floats) -> Integers:
    """Which of these offsets have evidence (m',), given each other.

    `values` (k,), `covariance` (k, k): of a fit with all of them. `offsets` (m,): their places.
    `levels` (m,): Coulomb level, or viscous friction, of each joint, in the offset's unit.
    """
    remaining = list(offsets)
    prior = dict(zip(offsets, (SETTINGS.share * levels) ** 2, strict=True))
    while remaining:
        # Of a normal distribution, the rest does not matter: only the offsets' own block counts.
        value, variance = values[remaining], np.diag(covariance)[remaining]
        wide = np.array([prior[i] for i in remaining]) / variance
        score = value**2 / variance * wide / (1 + wide) / 2 - np.log(1 + wide) / 2
        least = int(score.argmin())
        if score[least] >= SETTINGS.evidence:
            break
        # Without it: what the others are where this one is zero.
        place = remaining.pop(least)
        gain = covariance[:, place] / covariance[place, place]
        values = values - gain * values[place]
        covariance = covariance - product(gain[:, None], covariance[place][None])
    return np.array(remaining, int)

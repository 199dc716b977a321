"""Motions and laws of docs/guides/laws.md: what its tables are made of, and what else is asked
of these laws.
"""

import numpy as np

from ctc import Adaptive
from plant import PD, PointToPoint, Spline, puma560

GAIN = np.array([0.20, 0.15])
"""Of the experiment's P law; the settings of the laws multiply it."""

INERTIA = np.diag(puma560.arm().D((0.0, 0.0)))
PRIOR = (0.05 * np.diff(puma560.PRINTED_RANGES, axis=1).ravel()) ** 2
"""Relative speed of adaptation: the squares of a twentieth of the printed ranges."""

POINTS = np.vstack([np.zeros(2), np.random.default_rng(0).uniform(-1, 1, (6, 2))])
MOTIONS = {
    "(6), 3.65 s": puma560.reference(3.65),
    "(6), 2.5 s": puma560.reference(2.5),
    "(6), 2.0 s": puma560.reference(2.0),
    "point to point": PointToPoint(start=(0.0, 0.0), goal=(-np.pi / 2, np.pi / 2), duration=1.0),
    "random spline": Spline(times=0.5 * np.arange(7), points=POINTS),
}


def pd(scale, lead, pole, period=None):
    """PD at so many times the experiment's gain; `lead` is derivative over gain [s]."""
    return PD(gain=scale * GAIN, derivative=lead * scale * GAIN, filter=pole, period=period)


def adaptive(arm, rig, bandwidth, rate, speed, pole):
    """Slotine and Li with K = rate times the inertias, Gamma = speed times `PRIOR`."""
    options = {"gain": rate * INERTIA, "adaptation": speed * PRIOR, "filter": pole}
    return Adaptive(arm, rig, bandwidth=bandwidth, **options)

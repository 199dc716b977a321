"""What a search over a range of resonances would gain if the gears were identified.

A controller for all gears of a wide range is slow, or loud. For samples of nearly one resonance
stands computed torque that has these gears in its model, as after ``identify(...,
elasticity=True)``.
"""

import contextlib
from typing import Any, NamedTuple

import numpy as np

from ctc.certification.plants import Plants
from ctc.laws.computed_torque import ComputedTorque
from ctc.verdict.on_gears import with_gears
from plant import Elasticity, Reference
from plant.parts import frozen_settings
from plant.simulation.population import Runs


class KnownGears(NamedTuple):
    """Computed torque with gears of this resonance [Hz] in its model, on samples near it.

    Of the bandwidths that were tried it has the one with the fewest failures, then the least
    chatter.

    `left`, `of`: samples that exceed the limit, and samples. `chatter`: of each joint, mean
    of the samples [N m, or N].
    """

    hz: float
    left: int
    of: int
    chatter: tuple[float, ...]


@frozen_settings
class KnownGearsSettings:
    """Where known gears are tried; all numbers were chosen by hand.

    Parameters
    ----------
    wide : float
        Ratio of the ends of a range from which on it is tried.
    precise : float
        Ratio of the ends of a range that an identification leaves.
    places : int
        Resonances that are tried, from end to end.
    samples : int
        Samples of each, at most.
    fewest : int
        Samples of each, at least.
    bandwidths : tuple of float
        Bandwidths of the controllers [rad/s], from quiet to precise.
    gain : float
        Share of the chatter of the controller for the whole range, below which it is reported.
    """

    wide: float = 1.5
    precise: float = 1.1
    places: int = 3
    samples: int = 100
    fewest: int = 10
    bandwidths: tuple[float, ...] = (30.0, 60.0, 100.0, 150.0)
    gain: float = 0.5


SETTINGS = KnownGearsSettings()


def with_known_gears(
    plants: Plants,
    motions: tuple[tuple[Reference, float], ...],
    options: dict[str, Any],
    threads: int,
) -> tuple[KnownGears, ...]:
    """Computed torque with the gears of the samples in its model, at places of their range.

    Empty where the resonance is no wide range that all joints share: of joints with ranges of their
    own few samples have nearly the same gears. `options`: of `Population`.
    """
    ranges: tuple[tuple[float, float], ...] = plants.uncertainty.resonance or ()
    if len(ranges) != 1 or ranges[0][1] < SETTINGS.wide * ranges[0][0]:
        return ()
    resonance = plants.values[:, plants.names.index("resonance")]
    low, high = ranges[0]
    # Each place has samples on both sides.
    half = np.sqrt(SETTINGS.precise)
    tried = []
    for hz in np.geomspace(low * half, high / half, SETTINGS.places):
        # By the ratio: an interval of an identification is a factor, not a difference.
        rows = np.flatnonzero(np.abs(np.log(resonance / hz)) < np.log(half))[: SETTINGS.samples]
        # Gears that no computed torque can have in its model are left out.
        with contextlib.suppress(ValueError):
            if len(rows) >= SETTINGS.fewest:
                tried.append(_tried(plants, rows, hz, motions, options, threads))
    return tuple(tried)


def _tried(plants, rows, hz, motions, options, threads):
    """The best controller for one resonance [Hz], on the samples (r,) near it."""
    # f is fitted on gears, too: the samples have that of their resonance.
    arm = plants.arm.dynamics.arm(plants.f[rows].mean(axis=0))
    damping = float(np.mean(plants.uncertainty.damping_ratio))
    # The resonance is stated at the pose in which the first motion begins.
    start = motions[0][0](np.zeros(1)).q[0]
    gears = Elasticity.from_resonance(arm, hz, damping, drive=plants.own.drive, q=start)
    names, values = plants.numbers()
    results = []
    for bandwidth in SETTINGS.bandwidths:
        # The model has the gears of the place, the samples those beside it.
        law = ComputedTorque(arm, with_gears(plants.own, gears), bandwidth=bandwidth)
        runs = Runs.joined(
            [
                plants.under(law, path, (names, values[rows]), duration=duration, **options).run(
                    threads
                )
                for path, duration in motions
            ]
        )
        # Failures come before chatter: a quiet controller that fails is no gain.
        left = int((runs.outside > 0).sum())
        chatter = tuple(runs.chatter.mean(axis=0).tolist())
        results.append(KnownGears(float(hz), left, len(rows), chatter))
    return min(results, key=lambda result: (result.left, max(result.chatter)))

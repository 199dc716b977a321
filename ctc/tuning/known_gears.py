"""What a search over a range of resonances would gain if the gears were identified.

One controller for a wide range of gear resonances is slow, or it chatters. This module tries
computed torque that has the gears in its model, as after ``identify(..., elasticity=True)``, on
samples of nearly the same resonance.
"""

from typing import Any, NamedTuple

import numpy as np

from ctc.certification import Plants
from ctc.laws import ComputedTorque
from ctc.verdict import with_gears
from plant import Elasticity, Reference
from plant.parts import Floats, frozen_settings
from plant.simulation import Runs


class KnownGears(NamedTuple):
    """Result of computed torque with gears of resonance `hz` [Hz] in its model, on samples near it.

    The bandwidth is the one with the fewest failures; among equals, the one with the least mean
    chatter in shares of each joint's torque.

    `left` of the `of` samples exceed the limit. `chatter` is the mean chatter of each joint over
    the samples [N m, or N].
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
        Least ratio of the ends of a range (upper to lower) for which known gears are tried.
    precise : float
        Ratio of the ends of the range in which an identification leaves the resonance.
    places : int
        Number of resonances that are tried, from end to end of the range.
    samples : int
        Most samples that are used at one resonance.
    fewest : int
        Fewest samples near a resonance; a resonance with fewer is skipped.
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
    scale: Floats,
    threads: int,
) -> tuple[KnownGears, ...]:
    """Try computed torque with known gears at several resonances of the range.

    The result is empty unless all joints share one wide range of resonances. If each joint had a
    range of its own, few samples would have nearly the same gears in all joints. A resonance with
    too few samples near it is left out. `options` are those of `Population`;
    `scale` (n,) is the torque to which a joint's chatter is compared.
    """
    ranges: tuple[tuple[float, float], ...] = plants.uncertainty.resonance or ()
    if len(ranges) != 1 or ranges[0][1] < SETTINGS.wide * ranges[0][0]:
        return ()
    resonance = plants.values[:, plants.names.index("resonance")]
    low, high = ranges[0]
    # The outer places lie inside the range, so that each place can have samples on both sides.
    half = np.sqrt(SETTINGS.precise)
    tried = []
    for hz in np.geomspace(low * half, high / half, SETTINGS.places):
        # By the ratio: an interval of an identification is a factor, not a difference.
        rows = np.flatnonzero(np.abs(np.log(resonance / hz)) < np.log(half))[: SETTINGS.samples]
        if len(rows) < SETTINGS.fewest:
            continue
        try:
            laws = _with_gears(plants, rows, hz, motions[0][0])
        except ValueError:
            continue  # no computed torque can have these gears in its model
        tried.append(best_law(plants, laws, rows, hz, motions, options, scale, threads))
    return tuple(tried)


def _with_gears(plants, rows, hz, reference):
    """Computed torque of each bandwidth, with gears of a resonance [Hz] in its model."""
    # The fitted f depends on the gears, so the model takes the mean f of the samples near `hz`.
    arm = plants.arm.dynamics.arm(plants.f[rows].mean(axis=0))
    damping = float(np.mean(plants.uncertainty.damping_ratio))
    # The resonance is stated at the pose in which the motion begins.
    start = reference(np.zeros(1)).q[0]
    gears = Elasticity.from_resonance(arm, hz, damping, drive=plants.own.drive, q=start)
    rig = with_gears(plants.own, gears)
    return [ComputedTorque(arm, rig, bandwidth=bandwidth) for bandwidth in SETTINGS.bandwidths]


def best_law(plants, laws, rows, hz, motions, options, scale, threads):
    """The best of these laws on the samples (r,) near their resonance [Hz]."""
    names, values = plants.numbers()
    results = []
    for law in laws:
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
    # Joints of any size, and of other units, count alike.
    return min(results, key=lambda result: (result.left, np.mean(result.chatter / scale)))

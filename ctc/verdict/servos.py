"""What a verdict says of servos and drives with an inner loop: play, and their own profiles."""

import numpy as np
from numpy.typing import ArrayLike

from plant import PositionServo, Rig
from plant.parts import Floats

# Of the play, what a joint moves in it at most: it leaves the play with some speed.
_OVERSHOOT = 1.5


def in_play(rig: Rig, labels: list[str], peak: ArrayLike, within: float = 1) -> list[str]:
    """Joints with an inner loop that move within the play before their encoder, one line each.

    `peak` (n,): largest encoder errors [pulses]; those up to `within` keep the limit.
    """
    gears = rig.drive.elasticity
    if rig.inner is None or gears is None or gears.backlash is None:
        return []
    play = np.abs(rig.position_in_pulses(rig.drive.coupling.joint(gears.backlash)))
    counted = np.broadcast_to(np.array(rig.encoder.side) == "link", rig.n)
    peak = np.asarray(peak)
    # It is seen a count later.
    moves = counted & (peak > within) & (peak <= _OVERSHOOT * play + 1)
    return [
        f"{label} moves within the play, {play[i]:.1f} pulses: no goal holds a joint there;"
        " preload it by a spring, a weight or a second servo"
        for i, label in enumerate(labels)
        if moves[i]
    ]


def slow_profiles(rig: Rig, labels: list[str], speed: Floats) -> list[str]:
    """Joints whose servo moves its own goal slower than the path does, one line each.

    `speed` (N, n): of the path, joint side [rad/s, or m/s].
    """
    if not isinstance(rig.inner, PositionServo):
        return []
    needed = np.abs(rig.position_in_pulses(np.asarray(speed))).max(axis=0)
    own = np.broadcast_to(rig.inner.speed, rig.n)
    return [
        f"{label}: the servo's own profile, {own[i]:.4g} pulses/s, is slower than the path,"
        f" {needed[i]:.4g}: it stays behind. Raise its speed register, or slow the path down"
        for i, label in enumerate(labels)
        if needed[i] > own[i]
    ]

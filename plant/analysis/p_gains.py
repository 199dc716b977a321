"""P gains for any arm: as soft as a stated tracking error allows, and stable by the linearised loop."""

from __future__ import annotations

import numpy as np

from plant.analysis.linearise import linearise, modes
from plant.laws.pid import P
from plant.parts.arguments import array
from plant.simulation.simulator import simulate

__all__ = ["p_gains"]

_ROUNDS = 12
_FASTEST = 0.5
"""Largest mode times sub-step [rad] at which the simulator still follows it, and a control card would too."""


def p_gains(arm, rig, reference, peak, *, poses=8):
    """Gains of a P law that keeps an arm within so many pulses of its reference.

    The first guess is static: the torque that the motion needs, friction included, over the error that is allowed.
    The loop swings about it, so the guess is corrected by simulating the motion until the peak is met to 10 %.

    Parameters
    ----------
    arm : Arm
        Known roughly, as from a data sheet.
    rig : Rig
    reference : Reference
    peak : float or (n,) array_like
        Largest error of each joint [pulses].
    poses : int
        Along the motion, at which the linearised loop must be stable.

    Returns
    -------
    P

    Raises
    ------
    ValueError
        An error that no stable gain, or not this amplifier, can keep; with the joint.
    """
    n = arm.n
    peak = array("peak", np.broadcast_to(peak, n) if np.ndim(peak) == 0 else peak, (n,), advice="Give pulses.")
    if (peak < 1).any():
        raise ValueError(f"peak must be at least 1 pulse; got {peak.min()}. P control needs an error to act on.")
    motion = reference(np.linspace(0, reference.duration, 400))
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    torque = np.abs(rig.drive.motor_torque(torque + rig.drive.friction(motion.qd))).max(axis=0)
    limit = rig.drive.motor_gain * rig.drive.current_limit
    if (torque > limit).any():
        joint = int(np.argmax(torque / limit))
        raise ValueError(
            f"the amplifier must be able to drive the motion; motor {joint} needs {torque[joint]:.3g} N m and has "
            f"{limit[joint]:.3g}. Slow the reference down."
        )
    gain = np.maximum(torque, 1e-3 * torque.max()) / peak
    for _ in range(_ROUNDS):
        law = P(gain=gain)
        reached = np.abs(simulate(arm, rig, law, reference).error_pulses).max(axis=0)
        if ((reached <= peak) & (reached >= 0.8 * peak - 1)).all():
            break
        gain = gain * np.clip(np.maximum(reached, 0.5) / (0.9 * peak), 0.5, 2.0)
    else:
        raise ValueError(
            f"gains must meet a peak of {peak} pulses; {_ROUNDS} attempts came to {reached}. Allow more, or slow down."
        )
    for q in motion.q[:: max(1, len(motion.q) // poses)]:
        found = modes(linearise(arm, rig, law, q))
        if (found[:, 1] <= 0).any():
            raise ValueError(f"the P loop must be stable; at q = {q} it is not. Check viscous friction and gears.")
        if found[-1, 0] * 2 * np.pi * rig.period / 4 > _FASTEST:
            raise ValueError(
                f"the P loop must be slower than the sub-steps; at q = {q} it swings at {found[-1, 0]:.0f} Hz. "
                "Allow a larger peak."
            )
    return law

"""P gains for any arm: as low as a given tracking error allows, and stable by the linearised loop."""

import warnings

import numpy as np
from numpy.typing import ArrayLike

from plant.analysis.linearise import linearise, modes
from plant.laws.pid import P
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.motion.reference import Reference
from plant.parts.arguments import array
from plant.simulation.cautions import warn_of_missing_rotors
from plant.simulation.simulator import simulate

_ROUNDS, _MET = 12, 1.1
_FASTEST = 0.5
"""Largest angular frequency of a mode times sub-step [rad] that the simulator and a control card resolve."""


def p_gains(arm: Arm, rig: Rig, reference: Reference, peak: ArrayLike, *, poses: int = 8) -> P:
    """Gains of a P law that tracks a reference with a given peak error.

    The first guess is static: the torque of the motion, friction included, over the allowed error. The loop oscillates
    about it, so the guess is corrected by simulating the motion until the peak is met; by loops that hunt, to 10 %.

    Parameters
    ----------
    arm : Arm
        Known roughly, as from a data sheet.
    rig : Rig
    reference : Reference
    peak : float or (n,) array_like
        Largest tracking error of each joint [pulses].
    poses : int
        Along the motion, at which the linearised loop must be stable.

    Returns
    -------
    P

    Raises
    ------
    ValueError
        An error that no stable gain, or not this amplifier, can keep; with the joint. P control has no damping but that
        of friction: where it oscillates, `PD` or `Cascade` can keep what it cannot.

    See Also
    --------
    plant.P, ctc.motor_gain

    Examples
    --------
    >>> from plant import p_gains, puma560
    >>> law = p_gains(puma560.arm(), puma560.rig(), puma560.reference(), peak=(10, 8))
    >>> law.gain.round(3)
    array([0.207, 0.188])
    """
    n = arm.n
    peaks = array("peak", np.broadcast_to(peak, n) if np.ndim(peak) == 0 else peak, (n,), advice="Give pulses.")
    if (peaks < 1).any():
        raise ValueError(f"peak must be at least 1 pulse; got {peaks.min()}. P control needs an error to act on.")
    motion = reference(np.linspace(0, reference.duration, 400))
    warn_of_missing_rotors(arm, rig, motion.q[0])
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    torque = torque - rig.spring_torque(motion.q) + rig.drive.friction(motion.qd)
    torque = np.abs(rig.drive.motor_torque(torque)).max(axis=0)
    limit = rig.drive.motor_gain * rig.drive.current_limit
    if (torque > limit).any():
        joint = int(np.argmax(torque / limit))
        raise ValueError(
            f"the amplifier must be able to drive the motion; the motor of {arm.dynamics.chain.joint_labels[joint]} "
            f"needs {torque[joint]:.3g} N m and has {limit[joint]:.3g}. Slow the reference down."
        )
    gain, tried = np.maximum(torque, 1e-3 * torque.max()) / peaks, []
    for _ in range(_ROUNDS):
        law = P(gain=gain)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="the bodies of the arm have no rotors")  # said above, once
            reached = np.abs(simulate(arm, rig, law, reference).error_pulses).max(axis=0)
        tried.append((float((reached / peaks).max()), law, reached))
        if ((reached <= peaks) & (reached >= 0.8 * peaks - 1)).all():
            break
        gain = gain * np.clip(np.maximum(reached, 0.5) / (0.9 * peaks), 0.5, 2.0)
    else:  # the peaks of a loop that hunts jump with its gains
        share, law, reached = min(tried, key=lambda each: each[0])
        if share > _MET:
            joint = int(np.argmax(reached / peaks))
            raise ValueError(
                f"gains must meet a peak of {peaks} pulses; {_ROUNDS} attempts came to {reached} at best, the furthest "
                f"off at {arm.dynamics.chain.joint_labels[joint]}. Allow more, slow down, or use PD or Cascade."
            )
    for q in motion.q[:: max(1, len(motion.q) // poses)]:
        found = modes(linearise(arm, rig, law, q))
        if (found[:, 1] <= 0).any():
            raise ValueError(f"the P loop must be stable; at q = {q} it is not. Check viscous friction and gears.")
        if found[-1, 0] * 2 * np.pi * rig.period / 4 > _FASTEST:
            raise ValueError(
                f"the P loop must be slower than the sub-steps; at q = {q} it has a mode of {found[-1, 0]:.0f} Hz. "
                "Allow a larger peak."
            )
    return law

"""Gains for any arm: as low as a given tracking error allows, and stable by the linearised loop;
P, PD or cascade.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.analysis.linearise import linearise, modes
from plant.analysis.sampled_loops import SampledLoops
from plant.laws.law import Law
from plant.laws.pid import PD, Cascade, P
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.motion.reference import Motion, Reference
from plant.parts.arguments import array, instance
from plant.parts.fields import Floats
from plant.simulation.cautions import warn_of_missing_rotors
from plant.simulation.simulator import simulate

_ROUNDS = 12
_MET = 1.1
# largest angular frequency of a mode times sub-step [rad] that the simulator and a control card
# resolve
_FASTEST = 0.5

_UNDAMPED = 1e-4  # ratio of a mode that only the finite step of the derivative damps

_DAMPING = 0.7  # ratio that the derivative gives a joint on its own

# Speed loop over position loop; speed loop over its integral; the filter's pole over the loop that
# it is for.
_INNER = 4.0
_RESET = 4.0
_FILTER = 4.0


def p_gains(
    arm: Arm,
    rig: Rig,
    reference: Reference,
    peak: ArrayLike,
    *,
    poses: int = 8,
    derivative: bool = False,
) -> P | PD:
    """Gains of a P law, or a PD law, that tracks a reference with a given peak error.

    The first guess is static: the torque of the motion, friction included, over the allowed error.
    The loop oscillates about it, so the guess is corrected by simulating the motion until the peak
    is met; by loops that hunt, to 10 %.

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
    derivative : bool
        Give PD gains: P control has no damping but that of friction, which heavy arms lack.

    Returns
    -------
    P or PD

    Raises
    ------
    ValueError
        An error that no stable gain, or not this amplifier, can keep; with the joint, and whether
        it is damped.

    See Also
    --------
    plant.P, plant.PD, plant.cascade_gains, ctc.motor_gain

    Examples
    --------
    >>> from plant import p_gains, puma560
    >>> law = p_gains(puma560.arm(), puma560.rig(), puma560.reference(), peak=(10, 8))
    >>> law.gain.round(3)
    array([0.207, 0.188])
    """
    peaks, motion, torque = _asked(arm, rig, reference, peak)
    # [N m/rad] of the joint
    per_gain = rig.drive.joint_torque(np.ones(arm.n), rig.position_in_pulses(np.ones(arm.n)))
    inertia, viscous = _inertia(arm, motion, poses), rig.drive.joint_viscous()

    def pd(gain: Floats) -> PD:
        critical = 2 * np.sqrt(np.abs(per_gain) * gain * inertia)
        rate = np.maximum(_DAMPING * critical - viscous, 0) / np.abs(per_gain)
        fastest = float(np.sqrt(np.abs(per_gain) * gain / inertia).max())
        return PD(gain=gain, derivative=rate, filter=_FILTER * fastest)

    def why(gain: Floats) -> str:
        ratio = viscous / (2 * np.sqrt(np.abs(per_gain) * gain * inertia))
        joint = arm.dynamics.chain.joint_labels[int(ratio.argmin())]
        return (
            f"{joint} has the least damping, a ratio of {ratio.min():.2g} by its viscous friction."
            " Allow more, slow down, pass derivative=True, or use cascade_gains."
        )

    first = np.maximum(torque, 1e-3 * torque.max()) / peaks

    if derivative:
        return _met(arm, rig, reference, peaks, pd, first, lambda _: "Allow more, or slow down.")
    law = _met(arm, rig, reference, peaks, lambda gain: P(gain=gain), first, why)
    for q in _along(motion, poses):
        found = modes(linearise(arm, rig, law, q))
        if (found[:, 1] <= _UNDAMPED).any():
            raise ValueError(
                f"the P loop must be stable; at q = {np.round(q, 3).tolist()} it is not:"
                f" {why(law.gain)}"
            )
        if found[-1, 0] * 2 * np.pi * rig.period / 4 > _FASTEST:
            joint = int((np.abs(per_gain) * law.gain * np.diag(np.linalg.inv(arm.D(q)))).argmax())
            label = arm.dynamics.chain.joint_labels[joint]
            raise ValueError(
                f"the P loop must be slower than the sub-steps; that of {label} has a mode of"
                f" {found[-1, 0]:.0f} Hz. Allow it a peak of more than {peaks[joint]:g} pulses, or"
                " slow the reference down."
            )
    return law


def cascade_gains(
    arm: Arm, rig: Rig, reference: Reference, peak: ArrayLike, *, poses: int = 8
) -> Cascade:
    """Gains of a cascade, P on the position and PI on the speed, that tracks a reference with a
    given peak error.

    The speed loop is four times as fast as the position loop, its integral four times as slow as
    itself, on the largest inertia of each joint along the motion; arguments and refusals as of
    `p_gains`. Sampled with the rig's period.

    See Also
    --------
    plant.Cascade, plant.p_gains

    Examples
    --------
    >>> from plant import cascade_gains, puma560
    >>> law = cascade_gains(puma560.arm(), puma560.rig(), puma560.reference(), peak=200)
    >>> law.position.shape, law.period
    ((2,), 0.0007)
    """
    peaks, motion, _ = _asked(arm, rig, reference, peak)
    per_gain = np.abs(
        rig.drive.joint_torque(np.ones(arm.n), rig.position_in_pulses(np.ones(arm.n)))
    )
    inertia = _inertia(arm, motion, poses)

    def cascade(position: Floats) -> Cascade:
        inner = _INNER * position
        if (beyond := float((inner * rig.period).max()) / _FASTEST) > 1:
            joint = int(inner.argmax())
            label = arm.dynamics.chain.joint_labels[joint]
            least = beyond * peaks[joint]
            raise ValueError(
                f"the speed loop must be slower than the sampling; that of {label} needs"
                f" {inner[joint]:.0f} rad/s at a period of {rig.period:g} s. Allow a peak of"
                f" {least:.0f} pulses, or slow the reference down."
            )
        speed = inertia * inner / per_gain
        pole = _FILTER * float(inner.max())
        return Cascade(
            position=position,
            speed=speed,
            integral=speed * inner / _RESET,
            filter=pole,
            period=rig.period,
        )

    rate = np.abs(rig.position_in_pulses(motion.qd)).max(axis=0)
    first = np.maximum(rate, 1e-2 * rate.max()) / peaks
    law = _met(arm, rig, reference, peaks, cascade, first, lambda _: "Allow more, or slow down.")
    _require_stable(arm, rig, law, motion, poses)
    return law


def _asked(
    arm: Arm, rig: Rig, reference: Reference, peak: ArrayLike
) -> tuple[Floats, Motion, Floats]:
    """Peaks (n,) [pulses], the motion at 400 instants, and the largest motor torques (n,) that
    it takes [N m].
    """
    made = "Of a chain: d = Dynamics.from_chain(chain.with_rotors(rig.drive)), then d.arm(d.f())."
    n = instance("arm", arm, Arm, made).n
    peaks = array(
        "peak",
        np.broadcast_to(peak, n) if np.ndim(peak) == 0 else peak,
        (n,),
        advice="Give pulses.",
    )
    if (peaks < 1).any():
        raise ValueError(
            f"peak must be at least 1 pulse; got {peaks.min()}. P control needs an error to act on."
        )
    motion = reference(np.linspace(0, reference.duration, 400))
    warn_of_missing_rotors(arm, rig, motion.q[0])
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    torque = torque - rig.spring_torque(motion.q) + rig.drive.friction(motion.qd)
    torque = np.abs(rig.drive.motor_torque(torque)).max(axis=0)
    limit = rig.drive.motor_gain * rig.drive.current_limit
    if (torque > limit).any():
        joint = int(np.argmax(torque / limit))
        raise ValueError(
            "the amplifier must be able to drive the motion; the motor of"
            f" {arm.dynamics.chain.joint_labels[joint]} needs {torque[joint]:.3g} N m and has"
            f" {limit[joint]:.3g}. Slow the reference down."
        )
    return peaks, motion, torque


def _inertia(arm: Arm, motion: Motion, poses: int) -> Floats:
    """Largest inertia (n,) that each motor feels along the motion, the other joints free [kg
    m^2].
    """
    return np.max([1 / np.diag(np.linalg.inv(arm.D(q))) for q in _along(motion, poses)], axis=0)


def _along(motion: Motion, poses: int) -> Floats:
    return motion.q[:: max(1, len(motion.q) // poses)]


def _met(
    arm: Arm,
    rig: Rig,
    reference: Reference,
    peaks: Floats,
    law_of: Callable[[Floats], Any],
    gain: Floats,
    why: Callable[[Floats], str],
) -> Any:
    """The law whose gains, from the first ones on, track the reference with these peaks; ``why``
    not, of its gains.
    """
    tried: list[tuple[float, Law, Floats, Floats]] = []
    for _ in range(_ROUNDS):
        law = law_of(gain)
        with warnings.catch_warnings():
            # said above, once
            warnings.filterwarnings("ignore", message="the bodies of the arm have no rotors")
            reached = np.abs(simulate(arm, rig, law, reference).error_pulses).max(axis=0)
        tried.append((float((reached / peaks).max()), law, reached, gain))
        if ((reached <= peaks) & (reached >= 0.8 * peaks - 1)).all():
            break
        gain = gain * np.clip(np.maximum(reached, 0.5) / (0.9 * peaks), 0.5, 2.0)
    else:  # the peaks of a loop that hunts jump with its gains
        share, law, reached, gain = min(tried, key=lambda each: each[0])
        if share > _MET:
            joint = int(np.argmax(reached / peaks))
            raise ValueError(
                f"gains must meet a peak of {peaks} pulses; {_ROUNDS} attempts came to {reached} at"
                f" best, the furthest off at {arm.dynamics.chain.joint_labels[joint]}. {why(gain)}"
            )
    return law


def _require_stable(arm: Arm, rig: Rig, law: Law, motion: Motion, poses: int) -> None:
    """Refuse a sampled law whose linearised loops grow at the pose of most or of least inertia
    along the motion.
    """
    traces = [np.trace(arm.D(q)) for q in _along(motion, poses)]
    for k in {int(np.argmax(traces)), int(np.argmin(traces))}:
        q = _along(motion, poses)[k]
        if (pole := SampledLoops(arm, rig, law, q).unstable_pole()) is not None:
            hertz = abs(pole.imag) / (2 * np.pi)
            grows = f"at q = {np.round(q, 3).tolist()} it grows at {hertz:.0f} Hz"
            raise ValueError(f"the loop must be stable; {grows}. Allow a larger peak.")

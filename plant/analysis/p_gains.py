"""Gains of P, PD and cascade laws for any arm: as low as the tracking error allows, and stable."""

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plant.analysis.linearise import linearise, modes
from plant.analysis.sampled_loops import SampledLoops
from plant.laws import PD, Cascade, Law, P
from plant.machine import Rig
from plant.mechanics import Arm
from plant.motion import Motion, Reference
from plant.parts import Floats, array, frozen_settings, instance
from plant.simulation import simulate, warn_of_missing_rotors


@frozen_settings
class GainSettings:
    """Numbers of the search for gains, all chosen by hand.

    Parameters
    ----------
    simulations : int
        Simulations of the motion, each with corrected gains, until the peaks are met.
    tolerance : float
        Peak error over the allowed one with which the best of these gains is accepted: the peaks of
        a loop that hunts jump with its gains.
    fastest : float
        Largest angular frequency of a mode times the sub-step [rad] that the simulator and a
        control card resolve; of a cascade, of the speed loop times the sampling period.
    undamped : float
        Damping ratio up to which a mode counts as undamped: so much comes from the finite step of
        the derivative alone.
    damping : float
        Damping ratio that the derivative of a PD law gives a joint on its own.
    speed_ratio : float
        Bandwidth of a cascade's speed loop over that of its position loop.
    integral_ratio : float
        Bandwidth of a cascade's speed loop over the rate of its integral.
    filter_ratio : float
        Pole of the filter of the speed over the bandwidth of the loop that uses it.
    """

    simulations: int = 12
    tolerance: float = 1.1
    fastest: float = 0.5
    undamped: float = 1e-4
    damping: float = 0.7
    speed_ratio: float = 4.0
    integral_ratio: float = 4.0
    filter_ratio: float = 4.0


SETTINGS = GainSettings()


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

    The initial guess is static: the torque of the motion, friction included, over the allowed
    error. The loop oscillates about it, so the guess is corrected by simulating the motion until
    the peak is met; by loops that hunt, to 10 %.

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
    peaks, motion, torque = _demand(arm, rig, reference, peak)
    n = arm.n
    # Stiffness of a joint per unit of its gain [N m/rad]; its sign is the gear's.
    per_gain = rig.drive.joint_torque(np.ones(n), rig.position_in_pulses(np.ones(n)))
    inertia = _inertia(arm, motion, poses)
    viscous = rig.drive.joint_viscous()

    # A PD law has critical damping where rate = 2 sqrt(stiffness inertia).
    def pd(gain: Floats) -> PD:
        critical = 2 * np.sqrt(np.abs(per_gain) * gain * inertia)
        # Viscous friction gives a part of the damping already.
        rate = np.maximum(SETTINGS.damping * critical - viscous, 0) / np.abs(per_gain)
        bandwidth = float(np.sqrt(np.abs(per_gain) * gain / inertia).max())
        return PD(gain=gain, derivative=rate, filter=SETTINGS.filter_ratio * bandwidth)

    def advice(gain: Floats) -> str:
        # Damping ratio of each joint on its own, by viscous friction alone.
        ratio = viscous / (2 * np.sqrt(np.abs(per_gain) * gain * inertia))
        joint = arm.dynamics.chain.joint_labels[int(ratio.argmin())]
        return (
            f"{joint} has the least damping, a ratio of {ratio.min():.2g} by its viscous friction."
            " Allow more, slow down, pass derivative=True, or use cascade_gains."
        )

    # A joint that hardly moves starts with a gain above zero, from which the search can leave.
    guess = np.maximum(torque, 1e-3 * torque.max()) / peaks
    if derivative:
        return _met(arm, rig, reference, peaks, pd, guess)
    law = _met(arm, rig, reference, peaks, lambda gain: P(gain=gain), guess, advice)
    # The law meets the peaks; it must also be stable, and slow enough for its sampling.
    for q in _along(motion, poses):
        frequency, damping = modes(linearise(arm, rig, law, q)).T
        if (damping <= SETTINGS.undamped).any():
            raise ValueError(
                f"the P loop must be stable; at q = {np.round(q, 3).tolist()} it is not:"
                f" {advice(law.gain)}"
            )
        # `simulate` has four sub-steps per sample.
        if frequency[-1] * 2 * np.pi * rig.period / 4 > SETTINGS.fastest:
            joint = int((np.abs(per_gain) * law.gain * np.diag(np.linalg.inv(arm.D(q)))).argmax())
            label = arm.dynamics.chain.joint_labels[joint]
            raise ValueError(
                f"the P loop must be slower than the sub-steps; that of {label} has a mode of"
                f" {frequency[-1]:.0f} Hz. Allow it a peak of more than {peaks[joint]:g} pulses, or"
                " slow the reference down."
            )
    return law


def cascade_gains(
    arm: Arm, rig: Rig, reference: Reference, peak: ArrayLike, *, poses: int = 8
) -> Cascade:
    """Gains of a cascade, P on position and PI on speed, that tracks with a given peak error.

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
    peaks, motion, _ = _demand(arm, rig, reference, peak)
    n = arm.n
    # Torque of a unit gain on the joint per radian of error; the sign of a gear does not matter
    # here.
    per_gain = np.abs(rig.drive.joint_torque(np.ones(n), rig.position_in_pulses(np.ones(n))))
    inertia = _inertia(arm, motion, poses)

    def cascade(position: Floats) -> Cascade:
        bandwidth = SETTINGS.speed_ratio * position
        # The speed loop is the fastest one: it must be slow against the sampling.
        excess = float((bandwidth * rig.period).max()) / SETTINGS.fastest
        if excess > 1:
            joint = int(bandwidth.argmax())
            label = arm.dynamics.chain.joint_labels[joint]
            raise ValueError(
                f"the speed loop must be slower than the sampling; that of {label} needs"
                f" {bandwidth[joint]:.0f} rad/s at a period of {rig.period:g} s. Allow a peak of"
                f" {excess * peaks[joint]:.0f} pulses, or slow the reference down."
            )
        # The speed loop alone is of first order: gain over inertia is its bandwidth.
        speed = inertia * bandwidth / per_gain
        return Cascade(
            position=position,
            speed=speed,
            integral=speed * bandwidth / SETTINGS.integral_ratio,
            filter=SETTINGS.filter_ratio * float(bandwidth.max()),
            period=rig.period,
        )

    # A position loop alone lags by speed over gain.
    rate = np.abs(rig.position_in_pulses(motion.qd)).max(axis=0)
    guess = np.maximum(rate, 1e-2 * rate.max()) / peaks
    law = _met(arm, rig, reference, peaks, cascade, guess)
    _require_stable(arm, rig, law, motion, poses)
    return law


def _demand(
    arm: Arm, rig: Rig, reference: Reference, peak: ArrayLike
) -> tuple[Floats, Motion, Floats]:
    """Peaks (n,) [pulses], the motion at 400 instants, and its largest motor torques (n,) [N m]."""
    advice = "Of a chain: d = Dynamics.from_chain(chain.with_rotors(rig.drive)), then d.arm(d.f())."
    n = instance("arm", arm, Arm, advice).n
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
    # Once, not in every simulation.
    warn_of_missing_rotors(arm, rig, motion.q[0])
    # Rigid-body torque, less springs, and friction at the speeds of the motion.
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    # Springs carry a part of the weight, and friction adds to the torque that the motors must give.
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
    """Largest inertia (n,) of each joint along the motion, the other joints free [kg m^2]."""
    return np.max([1 / np.diag(np.linalg.inv(arm.D(q))) for q in _along(motion, poses)], axis=0)


def _along(motion: Motion, poses: int) -> Floats:
    # Poses at even intervals of time.
    return motion.q[:: max(1, len(motion.q) // poses)]


class _Trial(NamedTuple):
    """A law that was simulated, and its errors."""

    # Largest ratio of a peak error to the allowed one.
    excess: float
    law: Law
    # Peak errors (n,) [pulses], and the gains (n,) that gave them.
    peaks: Floats
    gain: Floats


def _met(
    arm: Arm,
    rig: Rig,
    reference: Reference,
    peaks: Floats,
    law_of: Callable[[Floats], Any],
    gain: Floats,
    advice: Callable[[Floats], str] = lambda _: "Allow more, or slow down.",
) -> Any:
    """The law whose gains, from an initial guess, track the reference with these peaks.

    A refusal ends with the ``advice`` for its gains.
    """
    trials = []
    for _ in range(SETTINGS.simulations):
        law = law_of(gain)
        with warnings.catch_warnings():
            # `_demand` has given this warning once.
            warnings.filterwarnings("ignore", message="the bodies of the arm have no rotors")
            reached = np.abs(simulate(arm, rig, law, reference).error_pulses).max(axis=0)
        trials.append(_Trial(float((reached / peaks).max()), law, reached, gain))
        if ((reached <= peaks) & (reached >= 0.8 * peaks - 1)).all():
            return law
        # The error of a stiff loop is about the torque over its gain; aim at nine tenths of the
        # peak. Half a pulse stands for no error, and a factor of two at most keeps the loop stable.
        gain = gain * np.clip(np.maximum(reached, 0.5) / (0.9 * peaks), 0.5, 2.0)
    best = min(trials, key=lambda trial: trial.excess)
    if best.excess > SETTINGS.tolerance:
        joint = int(np.argmax(best.peaks / peaks))
        raise ValueError(
            f"gains must meet a peak of {peaks} pulses; {SETTINGS.simulations} attempts came to"
            f" {best.peaks} at best, the furthest off at"
            f" {arm.dynamics.chain.joint_labels[joint]}. {advice(best.gain)}"
        )
    return best.law


def _require_stable(arm: Arm, rig: Rig, law: Law, motion: Motion, poses: int) -> None:
    """Refuse a sampled law whose loops grow at the pose of largest or of smallest inertia."""
    along = _along(motion, poses)
    # The extremes of inertia along the motion stand for all its poses.
    # The trace stands for the size of the inertia matrix.
    traces = [np.trace(arm.D(q)) for q in along]
    for k in {int(np.argmax(traces)), int(np.argmin(traces))}:
        pole = SampledLoops(arm, rig, law, along[k]).unstable_pole()
        if pole is not None:
            hertz = abs(pole.imag) / (2 * np.pi)
            growth = f"at q = {np.round(along[k], 3).tolist()} it grows at {hertz:.0f} Hz"
            raise ValueError(f"the loop must be stable; {growth}. Allow a larger peak.")

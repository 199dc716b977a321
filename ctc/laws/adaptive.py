"""Adaptive computed torque from the passivity of the arm: f-hat follows the tracking error."""

import functools

import casadi as ca
import numpy as np

from ctc.laws.model_law import ModelLaw
from plant import Fields, Rig, number, part, per_joint, scalars, structure
from plant.laws import SMOOTHED, Setpoint, Step, filtered_difference
from plant.parts import Nested, Vector, array, signs


@part
class Adaptive(ModelLaw):
    """tau = Y(q, qd, v, vd) f-hat + K s + friction(qd_r), d f-hat / dt = Gamma Y' s.

    v = qd_r + w e is the reference velocity, corrected by the error e = q_r - q, and s = v - qd =
    edot + w e. Once per sample: q is the middle of the encoder's cell, edot the filtered difference
    of e and qd = qd_r - edot. While a torque is at the amplifier's limit, f-hat stays as it is.

    Parameters
    ----------
    arm, rig
        As of `ComputedTorque`: f-hat starts at the arm's, friction and springs are fed forward, and
        not adapted.
    bandwidth : float
        w: how fast e goes to zero once s is zero [rad/s].
    gain : (n,) array_like
        K, torque per s [N m s/rad].
    adaptation : (p,) array_like
        Gamma, one number per parameter [f / (N m rad)]; zero keeps a parameter as it is.
    filter : float
        Pole of the first-order low-pass in front of the backward difference [rad/s].
    ranges : (p, 2) array_like, optional
        Where f-hat is kept; the arm's f must lie there.

    Raises
    ------
    ValueError
        As `ModelLaw`; negative gains, an arm outside the ranges.

    See Also
    --------
    ctc.ComputedTorque, ctc.SlidingMode

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import Adaptive, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> law = Adaptive(arm, rig, bandwidth=20.0, gain=(100, 40), adaptation=[0.1] * 9, filter=600.0)
    >>> path = puma560.reference()
    >>> report = evaluate(arm, rig, law, path, duration=0.2, backend="numba")
    >>> report.record.error_pulses.shape
    (286, 2)

    Source: Slotine and Li, On the adaptive control of robot manipulators (1987).
    """

    bandwidth: float = number(())
    gain: Vector = number(("n",))
    adaptation: Vector = number(("p",))
    filter: float = number(())
    ranges: Nested = structure(default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("bandwidth", "filter"), not_negative=("gain", "adaptation"))
        names = self.arm.dynamics.names
        # A wrong number of gains would be broadcast by casadi without a word.
        if len(self.adaptation) != len(names):
            raise ValueError(
                f"adaptation must have {len(names)} numbers, one for each of"
                f" {names[0]}..{names[-1]}; got {len(self.adaptation)}. Zero keeps a parameter as"
                " it is."
            )
        if self.ranges is not None:
            ranges = array(
                "ranges",
                self.ranges,
                (len(names), 2),
                advice="Give a low and a high end for each f.",
            )
            # The projection keeps f-hat in the box only if it starts there.
            outside = np.flatnonzero((self.arm.f < ranges[:, 0]) | (self.arm.f > ranges[:, 1]))
            if len(outside):
                i = outside[0]
                raise ValueError(
                    "ranges must hold the arm's f, where the adaptation starts;"
                    f" {names[i]} = {self.arm.f[i]:g} is not in [{ranges[i, 0]:g},"
                    f" {ranges[i, 1]:g}]. Widen them."
                )
            # Plain tuples, so that the law can be compared and saved.
            object.__setattr__(self, "ranges", tuple(tuple(row) for row in ranges.tolist()))

    @functools.cached_property
    def fields(self) -> Fields:
        """f-hat, which starts at the arm's f; the error's low-pass; the torque commanded last."""
        f = scalars(self.arm.dynamics.p, start=self.arm.f)
        return Fields(f=f, error=SMOOTHED, commanded=per_joint())

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One sample: error and its rate -> s -> torque with the old f-hat -> new f-hat."""
        before = self.fields.read(state, self.arm.n)
        f = before.f

        # 1. The error, its rate, and the reference velocity that the error corrects.
        q = rig.cell_centre(pulses)
        e = setpoint.q - q
        rate, memory = filtered_difference(e, before.error, self.filter, dt)
        s = rate + self.bandwidth * e
        v = setpoint.qd + self.bandwidth * e
        vd = setpoint.qdd + self.bandwidth * rate

        # 2. The torque: linear in f, so that the same regressor adapts f.
        Y = self.arm.dynamics.Y(q, setpoint.qd - rate, v, vd)
        model = Y @ f
        friction = self.rig.drive.friction(setpoint.qd)
        commanded = model + self.gain * s + friction - self.rig.spring_torque(q)

        # 3. Adapt, except while a torque is cut: the error then has another cause than f. Rounding
        # makes differences far below this share of the limit, beside that of amplifier or frames.
        drive = rig.drive
        missing = ca.fabs(drive.motor_torque(torque - before.commanded))
        cut = missing > 1e-9 * drive.motor_gain * drive.current_limit + rig.torque_rounding
        learning_time = ca.if_else(ca.sum1(cut) > 0, 0, dt)
        f = f + learning_time * self.adaptation * (Y.T @ s)
        if self.ranges is not None:
            low, high = np.transpose(self.ranges)
            f = ca.fmin(ca.fmax(f, low), high)
        return commanded, self.fields.write(self.arm.n, f=f, error=memory, commanded=commanded)

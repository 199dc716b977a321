"""A drive that takes MIT frames (q, qd, kp, kd, tau): its own PD loop, and a torque beside it."""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.laws.law import Law, Setpoint, Step
from plant.laws.terms import SMOOTHED, filtered_difference
from plant.machine import Frame, InnerLoop, Rig, nearest
from plant.mechanics import Arm
from plant.parts import (
    Fields,
    Floats,
    Vector,
    array,
    instance,
    number,
    part,
    real,
    signs,
    structure,
)

# kd = 1.4 w J of kp = w^2 J: a damping ratio of 0.7.
_DAMPING = 1.4


class FrameFields(NamedTuple):
    """Largest value of each field of a frame: [rad], [rad/s], [N m/rad], [N m s/rad], [N m]."""

    q: Any
    qd: Any
    kp: Any
    kd: Any
    tau: Any


@part
class MitDrive(InnerLoop, Law):
    """The PD loop of a drive: torque = kp (q_d - q) + kd (qd_d - qd) + tau, joint side.

    As the ``law`` of a log, its reference is q and qd of the frames; their tau is the record's
    `injected`. As the ``inner`` loop of a `Rig`, a law above it sends the frames: `Running.frame`.
    The torque field compensates for what rounding takes from position and speed.

    Parameters
    ----------
    kp, kd : (n,) array_like or float
        Gains of the frames [N m/rad], [N m s/rad], joint side. The drive has them rounded to a
        step of their fields (`whole_gains`); a simulation has them as they are.
    limits : tuple of five, optional
        Largest value of each field (q, qd, kp, kd, tau), SI, joint side: numbers, or one per joint.
        q, qd and tau are signed; kp and kd begin at 0.
    bits : tuple of five, optional
        Of each field.
    resolution : (n,) array_like or float, optional
        Counts per turn of the motor that the drive itself has.
    filter : float, optional
        Pole of the low-pass by which the drive takes its speed from its counts [rad/s].
    period : float, optional
        Period of the drive's loop [s]; the nearest value of which a whole number fits into one
        sample of the rig is used.

    Raises
    ------
    ValueError
        Gains below zero, beyond their fields, with what would fit, or lost in them: not 0, but 0 in
        the frame.

    See Also
    --------
    plant.PositionServo, plant.Rig

    Examples
    --------
    >>> from plant import MitDrive, puma560
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> limits = 12.5, 30, 5000, 500, 300
    >>> drive = MitDrive.for_arm(arm, rig, stiffness=20, limits=limits)
    >>> drive.kp.round(0), drive.kd.round(0)
    (array([2148.,  592.]), array([150.,  41.]))
    """

    kp: Vector = number(("n",), alike=True)
    kd: Vector = number(("n",), alike=True)
    filter: float = number((), default=2000.0)
    resolution: Vector = number(("n",), default=2.0**14, alike=True)
    limits: tuple[Any, ...] = structure(default=(12.5, 30.0, 500.0, 5.0, 10.0))
    bits: tuple[int, ...] = structure(default=(16, 12, 12, 12, 12))
    period: float = structure(float, default=1e-4)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("filter", "resolution"), not_negative=("kp", "kd"))
        object.__setattr__(self, "limits", _five("limits", self.limits, _limit))
        object.__setattr__(self, "bits", _five("bits", self.bits, _bit))
        self._require_fields()

    def _require_fields(self) -> None:
        """Refuse gains beyond the ends of their fields, and limits for other joints."""
        joints = [np.size(value) for value in (self.kp, self.kd, *self.limits) if np.ndim(value)]
        if joints:
            self.require_joints(joints[0])
        for name, bits in (("kp", self.bits[2]), ("kd", self.bits[3])):
            end = getattr(self.field_ends, name)
            step = _step(end, bits, signed=False)
            value, end = np.broadcast_arrays(np.atleast_1d(getattr(self, name)), end)
            beyond = np.flatnonzero(value > end)
            if len(beyond):
                i = beyond[0]
                raise ValueError(
                    f"{name} must fit its field, which ends at {float(end[i])}; got"
                    f" {float(value[i])} at joint {i}. Take {float(end[i])} or less, or what"
                    " MitDrive.for_arm finds."
                )
            _require_kept(name, value, step, np.rint(value / step))

    def require_joints(self, n: int, prefix: str = "") -> None:
        """As of `Part`; the limits that are given joint by joint count as well."""
        super().require_joints(n, prefix)
        for name, end in self.field_ends._asdict().items():
            if end.ndim and len(end) != n:
                raise ValueError(
                    f"{prefix}limits of {name} must have {n} joints; got {len(end)}. Give one per"
                    " joint, or one for all."
                )

    @classmethod
    def for_arm(
        cls,
        arm: Arm,
        rig: Rig,
        *,
        stiffness: float,
        pose: ArrayLike | None = None,
        limits: Sequence[Any] = (12.5, 30.0, 500.0, 5.0, 10.0),
        bits: Sequence[int] = (16, 12, 12, 12, 12),
        **fields: Any,
    ) -> Self:
        """Gains kp = w^2 J and kd = 1.4 w J within the ends of their fields.

        J = 1 / (D^-1)_jj is the inertia that a joint feels. A drive's own loop is at the motor and
        fast, so it damps elastic gears, which a delayed loop of the host excites: w should be as
        high as the fields allow.

        Parameters
        ----------
        arm, rig
        stiffness : float
            w [rad/s]; lowered for a joint whose kp or kd would exceed its field.
        pose : (n,) array_like, optional
            Working position [rad]; zeros by default.
        limits, bits, **fields
            As of `MitDrive`.

        Raises
        ------
        ValueError
            A stiffness that is not above zero, or that gives less than a step of a field.
        """
        instance("arm", arm, Arm, "The order is arm, rig.")
        instance("rig", rig, Rig, "The order is arm, rig.")
        w = real("stiffness", stiffness, "Give rad/s, such as 40.", positive=True)
        q = np.zeros(rig.n) if pose is None else array("pose", pose, (rig.n,), advice="Give rad.")
        inertia = 1 / np.diag(np.linalg.inv(arm.D(q)))
        # Without gains it checks what was given, and has the ends of the fields.
        fields |= {"limits": limits, "bits": bits}
        soft = cls(kp=0.0, kd=0.0, **fields)
        soft.require_joints(rig.n)
        end = soft.field_ends
        fastest = np.minimum(end.kd / (_DAMPING * inertia), np.sqrt(end.kp / inertia))
        w = np.minimum(w, fastest)
        gains = {}
        for name, gain, step in (
            ("kp", w * w * inertia, _step(end.kp, soft.bits[2], signed=False)),
            ("kd", _DAMPING * w * inertia, _step(end.kd, soft.bits[3], signed=False)),
        ):
            # Down to a whole step of each field, so that the frame has these gains exactly.
            steps = np.floor(gain / step + 1e-9)
            _require_kept(name, gain, step, steps)
            gains[name] = steps * step
        return cls(**gains, **fields)

    @property
    def field_ends(self) -> FrameFields:
        """Largest values of the fields, arrays or numbers."""
        return FrameFields(*(np.asarray(limit, float) for limit in self.limits))

    @property
    def whole_gains(self) -> tuple[list[int], list[int]]:
        """The integers of the fields of kp and kd, joint by joint."""
        end = self.field_ends
        kp, kd = (
            np.atleast_1d(np.rint(gain / _step(limit, bits, signed=False)).astype(int)).tolist()
            for gain, limit, bits in (
                (self.kp, end.kp, self.bits[2]),
                (self.kd, end.kd, self.bits[3]),
            )
        )
        return kp, kd

    sends = "frame"

    @functools.cached_property
    def fields(self) -> Fields:
        """The low-pass of the drive's counts."""
        return Fields(pulses=SMOOTHED)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = kp (q_d - q) + kd (qd_d - qd)."""
        before = self.fields.read(state, rig.n)
        coupling = rig.drive.coupling
        rate, memory = filtered_difference(pulses, before.pulses, self.filter, dt)
        error = coupling.shaft(rig.to_angle(setpoint.pulses - pulses))
        slower = coupling.shaft(setpoint.qd - rig.to_angle(rate))
        tau = coupling.joint_torque(self.kp * error + self.kd * slower)
        return tau, self.fields.write(rig.n, pulses=memory)

    def period_on(self, rig: Rig) -> float:
        """The period of which a sample of the rig has a whole number, next to the loop's."""
        return self.period_in(rig.period)

    def counts(self, rig: Rig, position: ca.SX) -> ca.SX:
        """As of `InnerLoop`, by the drive's own counter."""
        if rig.encoder.smooth:
            return rig.position_in_pulses(position)
        # The middle of the drive's own cell, in counts of the rig.
        per_radian = self.resolution * (1 / (2 * np.pi))
        own = ca.floor(per_radian * rig.drive.motor_angle(position)) + 0.5
        return rig.position_in_pulses(rig.drive.joint_angle(own / per_radian)) - rig.encoder.centre

    def stiffness_of(self, rig: Rig) -> Any:
        """The frame's kp."""
        return self.kp

    def damping_of(self, rig: Rig) -> Any:
        """The frame's kd."""
        return self.kd

    def torque_rounding(self, rig: Rig) -> Any:
        """Half a step of the torque field, on the motors."""
        half = np.broadcast_to(_step(self.field_ends.tau, self.bits[4]) / 2, rig.n)
        # One row per joint alone: roundings of several joints may add up on a coupled motor.
        shaft = np.abs(rig.drive.coupling.shaft_torque(np.diag(half))).sum(axis=0)
        return ca.DM(shaft) / ca.fabs(rig.drive.gear)

    def frame(self, rig: Rig, q: ca.SX, qd: ca.SX, torque: ca.SX, pulses: ca.SX) -> Frame:
        """The frame, rounded field by field, by which the drive gives this torque."""
        end = self.field_ends
        coupling = rig.drive.coupling
        angle = self._rounded(q, end.q, 0, rig)
        speed = self._rounded(qd, end.qd, 1, rig)
        # The torque makes up for what the other fields round, or cut off.
        less = coupling.joint_torque(
            self.kp * coupling.shaft(angle - q) + self.kd * coupling.shaft(speed - qd)
        )
        tau = self._rounded(torque - less, end.tau, 4, rig)
        return Frame(rig.position_in_pulses(angle) - rig.encoder.centre, speed, tau)

    def values(self, rig: Rig, frame: Frame) -> ca.SX:
        """The five fields (5 n, 1): q, qd, kp, kd, tau of all joints."""
        q = rig.to_angle(frame.pulses + rig.encoder.centre)
        one = ca.SX.ones(rig.n)
        return ca.vertcat(q, frame.qd, one * self.kp, one * self.kd, frame.torque)

    def _rounded(self, value: ca.SX, end: Floats, field: int, rig: Rig) -> ca.SX:
        """A value as its field has it: within its ends, at the nearest of its steps."""
        within = ca.fmin(ca.fmax(value, -end), end)
        if rig.encoder.smooth:
            return within
        # The steps begin at -end.
        step = _step(end, self.bits[field])
        return nearest((within + end) / step) * step - end


def _step(end: Floats, bits: int, *, signed: bool = True) -> Floats:
    """Step of a field of so many bits."""
    return (2 if signed else 1) * np.asarray(end) / (2**bits - 1)


def _require_kept(name: str, gain: Floats, step: Floats, steps: Floats) -> None:
    """Refuse a gain (n,) above zero of which its field would have so many `steps`: none."""
    lost = np.flatnonzero((gain > 0) & (steps == 0))
    if len(lost):
        i = lost[0]
        step = np.broadcast_to(step, gain.shape)
        raise ValueError(
            f"{name} must not be lost in its field, whose step is {step[i]:.4g}; got {gain[i]:.4g}"
            f" at joint {i}, which is 0 there. Take a higher gain or stiffness, or a lower limit."
        )


def _five(name: str, values: Any, one: Callable[[str, Any], Any]) -> tuple[Any, ...]:
    """The five values, each taken by `one`."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, (tuple, list)) or len(values) != 5:
        raise ValueError(
            f"{name} must be five, of (q, qd, kp, kd, tau); got {values!r:.60}. Take those of the"
            " drive's manual."
        )
    return tuple(
        one(f"{name} of {field}", value)
        for field, value in zip(FrameFields._fields, values, strict=True)
    )


def _limit(name: str, value: Any) -> Any:
    """A limit above zero, as a number, or as a tuple of one per joint."""
    limit = array(name, value, np.shape(value)[:1], advice="Give one number, or one per joint.")
    if not limit.size:
        raise ValueError(f"{name} must not be empty; got {value}. Take that of the drive's manual.")
    if not (limit > 0).all():
        raise ValueError(f"{name} must be positive; got {value}. Take that of the drive's manual.")
    return tuple(limit.tolist()) if limit.ndim else float(limit)


def _bit(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not 2 <= value <= 32:
        raise ValueError(f"{name} must be a whole number, 2 to 32; got {value!r}. 12 are usual.")
    return int(value)

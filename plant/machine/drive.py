"""The drive of each joint: motor, gear, friction, amplifier.

Source: paper Fig. 4 and appendix. Conventions: q_m = k q and tau = k tau_m, with k signed. Friction
is given on the motor side, as the paper measured it. On the joint the viscous coefficient b becomes
b k^2, and the Coulomb level c becomes c abs(k). If one motor moves several joints, these relations
hold for the shaft, the output of its gear, in place of the joint (`plant.mechanics.coupling`).
Without `current_lag` the motor torque is the commanded torque: the time constant of the current
loop is far below the mechanical one (paper 3.3, 4.2).
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.machine.drive_effects import (
    CurrentLag,
    FrictionDrift,
    LoadFriction,
    TorqueRipple,
    rounded,
    torque_steps,
)
from plant.machine.elasticity import Elasticity, Resonance
from plant.machine.friction import FrictionCurve, Presliding
from plant.mechanics import Coupling, read_urdf
from plant.parts import (
    ArrayOrSymbols,
    Floats,
    Part,
    Vector,
    choice,
    instance,
    joint_labels,
    joint_numbers,
    number,
    part,
    real,
    signs,
    structure,
)

# Fields of friction that is neither viscous nor Coulomb's, beside the curve.
_FURTHER = ("load_friction", "presliding", "friction_drift")

_FRICTION = ("viscous", "coulomb")  # fields that may be open


@part
class Drive(Part):
    """Motors and gears, *motor side* unless a field says otherwise.

    A field of numbers has one number per joint, or one for all.

    Parameters
    ----------
    gear : (n,) array_like
        k, motor turns per turn of the joint, signed: negative where the motor turns against the
        joint.
    motor_inertia : (n,) array_like
        Rotor inertia Jm [kg m^2]. The arm's parameters f already contain Jm k^2 (f1 and f7 of the
        paper), so Jm k^2 is not added to the inertia matrix D again.
    viscous : (n,) array_like or None
        Kfr-visc [N m s/rad]. None leaves it open: `identification.identify` estimates it together
        with f.
    coulomb : (n,) array_like or None
        Kfr-stat, static and sliding friction alike [N m]; None leaves it open, too.
    motor_gain : (n,) array_like
        K_i, motor torque per current [N m/A].
    current_limit : (n,) array_like
        Largest current of the amplifier [A]; infinity means no limit.
    curve : FrictionCurve, optional
        Friction that differs by direction, the Stribeck effect, viscous friction that saturates.
    coupling : Coupling, optional
        Coupling of motors that move several joints; the same as the chain's.
    elasticity : Elasticity, optional
        Stiffness [N m/rad], damping [N m s/rad] and backlash [rad] of the gears, joint side (also
        `Elasticity.from_resonance`); none by default: rigid gears.
    current_lag : float or CurrentLag, optional
        Time constant with which the motor currents follow the commanded ones [s]; none by default,
        and with 0.
    presliding : Presliding, optional
        Presliding distance [rad] and micro-damping [N m s/rad] of the friction; none by default.
    load_friction : (n,) array_like or LoadFriction, optional
        Rise of the Coulomb level as a share of the torque that the gear transmits, both joint side;
        none by default.
    friction_drift : FrictionDrift, optional
        Slow relative drift of viscous and dry friction from the start of a run; none by default.
    ripple : TorqueRipple, optional
        Cogging of the motors [N m] over their angle [rad]; none by default.
    torque_step : float or (n,) array_like, optional
        Motor torques are rounded to multiples of this step [N m]. Under CiA 402 it is a thousandth
        of the rated torque.
    joints : tuple of str, optional
        Names of the joints, for messages, tables and figures of the logs and the laws of this
        drive.
    left_open : tuple of str, optional
        Those of "viscous" and "coulomb" that are open. An open field is zero until it is
        identified. A field that is given as None is added here. A copy with 0 for a field that was
        open needs an empty tuple here, too.

    See Also
    --------
    plant.Rig, plant.Encoder, plant.FrictionCurve, plant.Elasticity

    Examples
    --------
    >>> from plant import puma560
    >>> drive = puma560.rig().drive
    >>> drive.motor_torque((10.0, 5.0)).round(4)           # of 10 and 5 N m at the joints [N m]
    array([ 0.0928, -0.0931])
    >>> drive.torque_limit().round(0)
    array([295., 153.])
    """

    gear: Vector = number(("n",))
    motor_inertia: Vector = number(("n",))
    viscous: Vector = number(("n",))
    coulomb: Vector = number(("n",))
    motor_gain: Vector = number(("n",))
    current_limit: Vector = number(("n",), finite=False)
    curve: FrictionCurve | None = structure(FrictionCurve, default=None)
    coupling: Coupling = structure(Coupling, default=Coupling())
    joints: tuple[str, ...] = structure(default=())
    elasticity: Any = structure(default=None)
    current_lag: Any = structure(default=None)
    presliding: Presliding | None = structure(Presliding, default=None)
    load_friction: Any = structure(default=None)
    friction_drift: FrictionDrift | None = structure(FrictionDrift, default=None)
    ripple: TorqueRipple | None = structure(TorqueRipple, default=None)
    torque_step: Any = structure(default=None)
    left_open: tuple[str, ...] = structure(default=())

    def __post_init__(self) -> None:
        # A string is one name.
        several = np.iterable(self.left_open) and not isinstance(self.left_open, str)
        opened: tuple[Any, ...] = tuple(self.left_open) if several else (self.left_open,)
        for name in opened:
            choice("left_open of Drive", name, _FRICTION)
        # None opens a kind of friction: it is zero until an identification finds it.
        for name in _FRICTION:
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros(np.shape(self.gear)))
                opened += (name,)
        super().__post_init__()
        # Numbers that an identification puts in close what was open.
        still_open = tuple(
            name for name in _FRICTION if name in opened and not getattr(self, name).any()
        )
        object.__setattr__(self, "left_open", still_open)
        # The names are checked before the numbers, since the messages below use them as labels.
        several = np.iterable(self.joints) and not isinstance(self.joints, str)
        joints = tuple(self.joints) if several else ()
        strings = several and all(isinstance(name, str) for name in joints)
        if not strings or len(set(joints)) not in (0, self.n) or len(joints) > self.n:
            raise ValueError(
                f"joints must be {self.n} different names, or none; got {self.joints!r:.80}. Name"
                " every joint."
            )
        object.__setattr__(self, "joints", joints)
        labels = joint_labels(joints, self.n)
        # A gear may be negative, but zero would leave the motor without effect.
        zero = self.gear == 0
        if zero.any():
            raise ValueError(
                f"gear must not be zero; got 0.0 at {labels[zero.argmax()]}. Its sign is the"
                " motor's."
            )
        signs(
            self,
            positive=("motor_gain", "current_limit"),
            not_negative=("motor_inertia", "viscous", "coulomb"),
            advice="Friction and gains are magnitudes.",
            labels=labels,
        )
        self.coupling.require_size(self.n, "drive")
        # Plain numbers become parts, so that all users find one form; a lag of 0 is none.
        if self.current_lag is not None and not isinstance(self.current_lag, CurrentLag):
            lag = real("current_lag", self.current_lag, "Give seconds, or None.")
            object.__setattr__(self, "current_lag", CurrentLag(time=lag) if lag else None)
        if self.torque_step is not None:
            object.__setattr__(self, "torque_step", torque_steps(self.torque_step, self.n))
        # Only here are the gears and the motors known that turn a resonance into a stiffness.
        if isinstance(self.elasticity, Resonance):
            object.__setattr__(self, "elasticity", self.elasticity.of(self))
        if self.load_friction is not None and not isinstance(self.load_friction, LoadFriction):
            object.__setattr__(self, "load_friction", LoadFriction(share=self.load_friction))
        if self.elasticity is not None:
            advice = "Give Elasticity(stiffness=..., ...)."
            instance("elasticity", self.elasticity, Elasticity, advice)
        self.require_joints(self.n)
        # A backlash beyond one turn of the motor is one that was given motor side.
        play = None if self.elasticity is None else self.elasticity.backlash
        if play is None:
            return
        excessive = play * np.abs(self.gear) > 2 * np.pi
        if excessive.any():
            i = np.argmax(excessive)
            turn = 2 * np.pi / abs(self.gear[i])
            raise ValueError(
                f"backlash must be within one turn of the motor, {turn:.3g} rad at {labels[i]}; got"
                f" {play[i]:g}. Give it joint side, in rad."
            )

    @classmethod
    def from_urdf(
        cls,
        path: str | Path,
        joints: Sequence[str] | None = None,
        *,
        base: str | None = None,
        tip: str | None = None,
        **fields: Any,
    ) -> Self:
        """A drive with the friction and efforts of a URDF file, on the joints of `Chain.from_urdf`.

        The other ``fields`` are those of a `Drive`: gear, motor_inertia and motor_gain, which no
        file has; fields that the file states as well replace its values. A missing friction, a
        missing effort or an effort of 0 is refused; so are those of joints with a `coupling`.

        Examples
        --------
        >>> from plant import Drive, read_robot
        >>> motors = {"gear": 101, "motor_inertia": 1e-4, "motor_gain": 0.1}
        >>> friction = {"viscous": 1e-3, "coulomb": 0.05}
        >>> model = read_robot("ur5e").model
        >>> drive = Drive.from_urdf(model, tip="forearm", **motors, **friction)
        >>> drive.torque_limit().round()
        array([150., 150., 150.])
        """
        chosen = read_urdf(path).chain_joints(joints, base, tip)
        # One gear for all joints: the number of joints comes from the file.
        if np.ndim(fields.get("gear", ())) == 0:
            fields["gear"] = np.full(len(chosen), fields["gear"])
        names = tuple(joint.name for joint in chosen)
        # A drive with placeholders first checks the fields. Its gears and motor gains then convert
        # the numbers of the file, which are joint side, to the motor side.
        placeholders = {"viscous": 0.0, "coulomb": 0.0, "current_limit": np.inf}
        drive = cls(**({"joints": names} | placeholders | fields))
        per_motor = np.abs(drive.gear)
        stated = np.array([(*joint.friction, joint.limits[3]) for joint in chosen]).T
        # b = b_joint / k^2, c = c_joint / abs(k), i = tau / (abs(k) K_i).
        scales = per_motor**2, per_motor, per_motor * drive.motor_gain
        changes: dict[str, Any] = {}
        for key, element, values, scale in zip(
            placeholders, ("damping", "friction", "effort"), stated, scales, strict=True
        ):
            if key in fields:
                continue
            if drive.coupling.matrix:
                raise ValueError(
                    f"{key} must be given of coupled motors; {Path(path).name} has the {element} of"
                    f" joints, which several motors bear. Give {key} motor side."
                )
            lacking = ~np.isfinite(values)
            if lacking.any():
                raise ValueError(
                    f"{element} of joint {names[lacking.argmax()]} in {Path(path).name} must be"
                    f" stated; it is not, or 0. Give {key} motor side (friction: or None)."
                )
            changes[key] = values / scale
        return dataclasses.replace(drive, **changes)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.gear.shape[0])

    def require_friction(self) -> None:
        """Refuse a drive whose friction is open."""
        if self.left_open:
            raise ValueError(
                f"friction must be known; this drive leaves {' and '.join(self.left_open)} open."
                " Take found.rig of identify, which finds it, or give numbers (0 is none) and"
                " left_open=()."
            )

    def motor_angle(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor angle q_m = k q [rad]."""
        # In each of these four crossings the sign of k is that of the paper: a positive motor angle
        # turns a joint with negative k backwards.
        return self.gear * self.coupling.shaft(q)

    def joint_angle(self, q_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint angle q = q_m / k [rad]."""
        return self.coupling.joint(q_m / self.gear)

    def joint_torque(self, tau_m: ArrayOrSymbols, times: ArrayOrSymbols = 1.0) -> ArrayOrSymbols:
        """Joint torque tau = k tau_m [N m] of motor torques, or of motor gains times a quantity."""
        # gear * tau_m first: gains (one per joint) are carried over before they meet the quantity.
        return self.coupling.joint_torque(self.gear * tau_m * times)

    def motor_torque(self, tau: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor torque tau_m = tau / k [N m]."""
        return self.coupling.shaft_torque(tau) / self.gear

    def current(self, tau: ArrayOrSymbols) -> ArrayOrSymbols:
        """Motor current [A] of a joint torque [N m]."""
        return self.motor_torque(joint_numbers("torque", tau, self.n)) / self.motor_gain

    def torque_limit(self) -> Floats:
        """Largest torque of the amplifier [N m], on the joint (of coupled motors: the shaft)."""
        # abs(k): a limit is a magnitude, whatever the direction of the gear.
        return self.motor_gain * self.current_limit * _magnitude(self.gear)

    def limited_to(self, torque: ArrayLike) -> Self:
        """This drive with amplifiers limited to these torques [N m], on the joint (or shaft)."""
        current = np.asarray(torque) / (self.motor_gain * np.abs(self.gear))
        return dataclasses.replace(self, current_limit=np.minimum(self.current_limit, current))

    def limited(self, tau: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint torque [N m] after rounding to `torque_step`, if any, and saturation."""
        limit: ArrayOrSymbols = self.torque_limit()
        # Rounding and saturation happen in the amplifier, so the torque goes to the shaft, is
        # limited there, and comes back. It is rounded first: the limit need not be a multiple
        # of the step.
        shaft = self.coupling.shaft_torque(tau)
        if self.torque_step is not None:
            shaft = rounded(shaft, np.array(self.torque_step) * _magnitude(self.gear))
        if isinstance(shaft, np.ndarray):
            return self.coupling.joint_torque(np.clip(shaft, -limit, limit))
        return self.coupling.joint_torque(ca.fmin(ca.fmax(shaft, -ca.fabs(limit)), ca.fabs(limit)))

    @property
    def torque_rounding(self) -> Floats | float:
        """Largest change of a motor torque [N m] by rounding to `torque_step`; 0 without."""
        return 0.0 if self.torque_step is None else np.array(self.torque_step) / 2

    def joint_viscous(self, qd: ArrayOrSymbols = 0.0) -> Any:
        """Viscous friction b k^2 [N m s/rad], on the joint (or shaft) at speeds qd [rad/s].

        The result times the speed is the viscous torque, even where that torque saturates.
        """
        viscous = self.viscous
        # The curve takes the speed of the motor, as the Coulomb level does.
        if self.curve is not None:
            viscous = self.curve.coefficient(viscous, self.gear * qd)
        # k enters squared: once for the speed of the motor, once for its torque.
        return viscous * self.gear * self.gear

    def joint_coulomb(self, qd: ArrayOrSymbols | None = None) -> ArrayOrSymbols:
        """Coulomb level c abs(k) [N m] on the joint (or shaft) at speeds qd [rad/s].

        Without qd it is the full Coulomb friction, plus what the curve adds at rest.
        """
        # The curve takes the speed of the motor, k qd; its level is even in it.
        level = self.coulomb
        if self.curve is not None:
            if qd is not None:
                level = self.curve.risen(level, self.gear * qd)
            level = level + self.curve.level(self.gear * (0.0 if qd is None else qd))
        return level * _magnitude(self.gear)

    def further_friction(self) -> list[str]:
        """Names of the fields of friction beyond viscous and Coulomb's that this drive has."""
        fields = [f"drive.{name}" for name in _FURTHER if getattr(self, name) is not None]
        if self.curve is not None:
            # A curve of zeros, or one that never saturates, is no friction.
            for name in ("offset", "breakaway", "viscous_offset", "saturation", "rise"):
                numbers = getattr(self.curve, name)
                if numbers is not None and (numbers[np.isfinite(numbers)] != 0).any():
                    fields.append(f"drive.curve.{name}")
        return fields

    def joint_presliding(self) -> tuple[ArrayOrSymbols, ArrayOrSymbols | None]:
        """Presliding distance [rad] and micro-damping [N m s/rad] (or None), joint (or shaft).

        d / abs(k), and the damping of the motor times k^2; zeros and None without presliding.
        """
        if self.presliding is None:
            return 0.0 * self.gear, None
        damping: Any = self.presliding.damping
        # Micro-damping is crossed like viscous friction, the distance like an angle.
        if damping is not None:
            damping = damping * self.gear * self.gear
        return self.presliding.distance / _magnitude(self.gear), damping

    def ripple_torque(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint torque of the motors' ripple [N m] at joint angles q [rad] on rigid gears.

        Without ripple the result is the number 0.0.
        """
        if self.ripple is None:
            return 0.0
        return self.joint_torque(self.ripple.torque(self.motor_angle(q)))

    def joint_offset(self) -> ArrayOrSymbols:
        """Friction offset [N m], on the joint (or shaft): the same in both directions of motion."""
        # Signed k: the offset has the direction of the motor, not of the motion.
        return 0.0 if self.curve is None else self.gear * self.curve.offset

    def friction(self, qd: ArrayOrSymbols, load: ArrayOrSymbols | None = None) -> ArrayOrSymbols:
        """Friction torque [N m], joint side, at joint speeds qd; no Coulomb part at rest.

        `load`: joint torque [N m] that the gears transmit; None leaves its friction out.
        """
        qd = self.coupling.shaft(qd)
        # sign(0) = 0: at rest a feed-forward does not know which way friction points.
        sign = np.sign(qd) if isinstance(qd, np.ndarray) else ca.sign(qd)
        level = self.loaded(self.joint_coulomb(qd), load)
        shaft = self.joint_viscous(qd) * qd + level * sign + self.joint_offset()
        return self.coupling.joint_torque(shaft)

    def loaded(self, level: ArrayOrSymbols, load: ArrayOrSymbols | None) -> ArrayOrSymbols:
        """Coulomb level [N m] of the shafts, raised by the load friction.

        `load`: joint torque [N m] that the gears transmit; None leaves the level as it is.
        """
        if load is None or self.load_friction is None:
            return level
        return level + self.load_friction.level(self.coupling.shaft_torque(load))

    def rotor_torque(self, qdd: ArrayOrSymbols) -> ArrayOrSymbols:
        """Torque that accelerates the rotors alone [N m], joint side, for qdd on rigid gears."""
        return self.coupling.joint_torque(self.reflected_inertia() * self.coupling.shaft(qdd))

    def reflected_inertia(self, motor_inertia: Floats | None = None) -> Floats:
        """Rotor inertia on the joint (or shaft), Jm k^2 [kg m^2]; by default of this drive's Jm."""
        inertia = self.motor_inertia if motor_inertia is None else motor_inertia
        return inertia * self.gear * self.gear


def _magnitude(x: ArrayOrSymbols) -> ArrayOrSymbols:
    return ca.fabs(x) if isinstance(x, ca.SX) else np.abs(x)

"""Motion of motors for their links behind elastic gears to follow a reference."""

import functools
from typing import Any

import casadi as ca
import numpy as np

from plant.machine import Drive, Rig
from plant.mechanics import Arm, Dynamics
from plant.motion.reference import Derived, Reference
from plant.parts import Floats, instance, part, structure


@part
class LinkReference(Derived):
    """Motion of the motors with which the links follow q_r: theta_r = q_r + tau_link / k.

    tau_link(q_r, qd_r, qdd_r) is the torque through the gears, D(q_r) qdd_r + h(q_r, qd_r) less
    that of springs and the motors' own share, and k their stiffness; their damping is neglected, 2
    (damping ratio) / (resonance [rad/s]) of the deflection's rate. Speed and acceleration are its
    derivatives along the motion, which take the jerk and the snap of q_r.

    Where the jerk of q_r jumps (both ends of `PointToPoint` and `Spline`, the points of `Scaled`),
    the speed of the motors jumps by the links' inertia over k times as much; where its acceleration
    jumps, the motors would have to jump themselves. A simulation starts with the motors on theta_r
    and the links as they hang at rest: if the motion begins with an acceleration, they are off by
    what it adds to tau_link / k, and oscillate.

    Parameters
    ----------
    arm : Arm or Identification
        As identified; an identification gives its rig, too: ``LinkReference(found,
        reference=path)``.
    rig : Rig, optional
        As identified, with ``drive.elasticity``.
    reference : Reference
        q_r, with ``higher`` derivatives: `Harmonics`, `PointToPoint`, `Spline`, or `Scaled` of
        them.

    Raises
    ------
    ValueError
        A rig that does not fit, without elastic gears, with backlash, or with its encoders on the
        links; a motion without higher derivatives, such as a `Table`; one so rough (that of
        `fastest`) that winding the gears alone takes more than the amplifiers give.

    See Also
    --------
    ctc.ComputedTorque, plant.Elasticity

    Examples
    --------
    >>> import dataclasses
    >>> from plant import Elasticity, LinkReference, puma560
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> gears = Elasticity.from_resonance(arm, hz=60, damping_ratio=0.02, drive=rig.drive)
    >>> stiff = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=gears))
    >>> path = LinkReference(arm, stiff, puma560.reference())
    >>> path([0.0]).q.round(2)
    array([[-0.,  0.]])
    """

    arm: Any = structure(kw_only=False)  # an identification goes in, too; its arm is kept
    rig: Rig = structure(kw_only=False, default=None)
    reference: Reference = structure(kw_only=False, default=None)

    def __post_init__(self) -> None:
        # In place of the arm an identification may be passed, which has a rig, too.
        identification = self.arm
        if not isinstance(self.arm, Arm) and isinstance(getattr(self.arm, "arm", None), Arm):
            object.__setattr__(self, "arm", identification.arm)
            if self.rig is None:
                object.__setattr__(self, "rig", identification.rig)
        advice = "Pass arm, rig and reference=, or an identification and reference=."
        for name, kind in (("arm", Arm), ("rig", Rig), ("reference", Reference)):
            instance(f"{name} of LinkReference", getattr(self, name), kind, advice)
        self.rig.require_fit(self.arm.dynamics.chain)
        require_elastic("LinkReference", self.rig)
        if self.reference.links is not self.reference:
            got = type(self.reference).__name__
            raise ValueError(
                f"reference must be the motion of the links; got {got}, of motors. Give its .links."
            )
        if self.reference.n != self.rig.n:
            raise ValueError(
                f"reference must have {self.rig.n} joints like the rig; got {self.reference.n}."
                " Match it."
            )
        # Last, since it evaluates the motion.
        self._require_smooth()

    def _require_smooth(self) -> None:
        """Refuse a motion for which winding the gears takes more than the amplifiers give."""
        # At the samples, at which a law reads this motion.
        t = np.arange(0.0, self.duration, self.rig.period)
        drive = self.rig.drive
        # The motors accelerate beyond their links, to wind the gears: that takes their inertia.
        winding = self.motion(t)[2] - self.reference.motion(t)[2]
        torque = np.abs(drive.reflected_inertia() * drive.coupling.shaft(winding))
        limit = drive.torque_limit()
        if (torque > limit).any():
            i, joint = np.unravel_index(np.argmax(torque / limit), torque.shape)
            chain = self.arm.dynamics.chain
            motor = chain.joint_labels[joint]
            unit = chain.joint_units[joint].effort
            needed = f"{torque[i, joint]:.3g} of {limit[joint]:.3g} {unit}"
            raise ValueError(
                f"reference must be smooth, with a bounded snap; at t = {t[i]:.3f} s the motor of"
                f" {motor} needs {needed} to wind its gear. Put a Spline through fewer points,"
                " or slow it down."
            )

    @property
    def links(self) -> Reference:
        """q_r, the motion of the links."""
        return self.reference

    @functools.cached_property
    def _motors(self) -> ca.Function:
        """(q, qd, qdd, jerk, snap) of the links -> (theta, thetad, thetadd), all (n, 1)."""
        names = "q", "qd", "qdd", "jerk", "snap"
        q, qd, qdd, jerk, snap = (ca.SX.sym(name, self.n) for name in names)
        arm = self.arm
        # The static deflection of the gears under the torque of the links; their damping is
        # neglected.
        torque = gear_torque(arm.dynamics, self.rig, q, qd, qdd, arm.f)
        theta = q + wound(self.rig.drive, torque)
        # Time derivatives by the chain rule: the state of the motion, and its rate.
        state = ca.vertcat(q, qd, qdd, jerk)
        rate = ca.vertcat(qd, qdd, jerk, snap)
        speed = ca.jtimes(theta, state, rate)
        motion = [theta, speed, ca.jtimes(speed, state, rate)]
        outputs = ca.cse([ca.densify(value) for value in motion])
        return ca.Function("motors", [q, qd, qdd, jerk, snap], outputs)

    def motion(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Motion of the motors at times (N,), as joints on rigid gears would have it."""
        q, qd, qdd = self.reference.motion(t)
        jerk, snap = self.reference.higher(t)
        if not len(t):  # casadi maps no function over no columns
            return q, qd, qdd
        results = self._motors.map(len(t))(q.T, qd.T, qdd.T, jerk.T, snap.T)
        theta, speed, acceleration = (result.full().T for result in results)
        return theta, speed, acceleration


def gear_torque(dynamics: Dynamics, rig: Rig, q: ca.SX, qd: ca.SX, qdd: ca.SX, f: ca.SX) -> ca.SX:
    """Torque through the gears (n, 1) [N m], on the joints, or on coupled shafts.

    D(q) qdd + h(q, qd) less that of springs and of the rotors' acceleration. q, qd, qdd (n, 1) are
    the motion of the links; the rotor inertias of the rig's drive are part of f (p, 1).
    """
    drive = rig.drive
    total = dynamics.D(q, f) @ qdd + dynamics.h(q, qd, f) - rig.spring_torque(q)
    rotors = drive.reflected_inertia() * drive.coupling.shaft(qdd)
    return drive.coupling.shaft_torque(total) - rotors


def wound(drive: Drive, torque: ca.SX) -> ca.SX:
    """Motor minus link (n, 1) [rad], joint side, under a torque through the gears [N m]."""
    return drive.coupling.joint(torque / drive.elasticity.stiffness)


def require_elastic(owner: str, rig: Rig) -> None:
    """Refuse a rig for which the motion of its motors does not follow from that of its links."""
    elasticity = rig.drive.elasticity
    if elasticity is None:
        raise ValueError(
            f"rig of {owner} must have elastic gears; got rigid ones. Give Drive(elasticity=...)."
        )
    if elasticity.backlash is not None and elasticity.backlash.any():
        raise ValueError(
            f"rig of {owner} must be without backlash; got {elasticity.backlash.max():g} rad, by"
            " which motors would have to jump where the torque reverses. Leave it out here; links"
            " are then off by half of it."
        )
    if rig.encoder.side == "link":
        raise ValueError(
            f"encoders in the rig of {owner} must be on the motors; got the links'. Follow q_r"
            " itself."
        )

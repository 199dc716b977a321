"""Friction in the model of computed torque: none, as the rig states it, or learnt at each turn.

The disturbance torque holds all that the model lacks: gravity, which stays where a joint turns
back, and friction, which turns with it. Just after a turn its change is therefore projected on that
of Coulomb and viscous friction, and moves from the one to the other, so that the torque does not
jump (docs/background/computed_torque.md).
"""

from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import Drive, Fields, Rig, per_joint
from plant.machine import friction_impulse
from plant.mechanics import Inverse
from plant.parts import array

# Added to a sum of squares of friction torques [N m]: no division by zero where there is no
# friction, and no effect on friction of 1e-3 N m or more.
_TINY = 1e-9


class ShaftFriction(NamedTuple):
    """Friction of the shafts in one sample (n, 1 each).

    `speed` of the reference [rad/s]; `viscous` friction [N m s/rad] and Coulomb `level` [N m];
    `needed`: joint torque that the reference needs for viscous friction and offset [N m]; `load`:
    joint torque that the gears transmit [N m]; `sweeps` over the joints for an impulse.
    """

    speed: ca.SX
    viscous: ca.SX
    level: ca.SX
    needed: ca.SX | float
    load: ca.SX
    sweeps: int

    def impulse(self, previous: ca.SX, time: ca.SX, mobility: Inverse, free: ca.SX) -> ca.SX:
        """Impulse of dry friction (n, 1) [N m s] within `time`, for a rate without it of `free`."""
        # The impulse that would stop the shaft at the reference's speed less the deviation's rate.
        stopping = -mobility.alone * (self.speed - free)
        held = friction_impulse(mobility, stopping, previous, time * self.level, self.sweeps)
        # Without friction not even the slope at rest may stay: linear analysis differentiates this.
        return ca.if_else(self.level > 0, held, 0)


class Learnt(NamedTuple):
    """Result of one sample: the `memory`, and what was corrected by what was learnt."""

    memory: Any
    friction: ShaftFriction
    needed: ca.SX
    disturbance: ca.SX


class NoFriction:
    """A model without friction; base of those that know some."""

    fields = Fields()

    def __init__(self, law: Any) -> None:
        self.law = law

    def at(self, memory: Any, speed: ca.SX, load: ca.SX) -> ShaftFriction:
        """Friction in this sample, at the reference's speed of the shafts (n, 1) [rad/s].

        `load` (n, 1): joint torque that the gears transmit on the reference [N m].
        """
        # Zeros, not a scalar: the state of a law without friction has the same length.
        zero = ca.SX.zeros(self.law.arm.n)
        return ShaftFriction(speed, zero, zero, 0, load, self.law.settings.friction_sweeps)

    def learn(
        self,
        memory: Any,
        friction: ShaftFriction,
        needed: ca.SX,
        disturbance: ca.SX,
        dt: ca.SX,
    ) -> Learnt:
        """What a sample teaches: here nothing."""
        return Learnt(memory, friction, needed, disturbance)


class StatedFriction(NoFriction):
    """Coulomb and viscous friction as the rig of the law states them."""

    def stated(self, speed: ca.SX, load: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Viscous friction [N m s/rad] and Coulomb level [N m] (n, 1) of the rig, on the shafts."""
        drive = self.law.rig.drive
        return drive.joint_viscous(speed), drive.loaded(drive.joint_coulomb(speed), load)

    def at(self, memory: Any, speed: ca.SX, load: ca.SX) -> ShaftFriction:
        """As of `NoFriction`."""
        viscous, level = self.stated(speed, load)
        return self._shafts(speed, viscous, level, load)

    def _shafts(self, speed: ca.SX, viscous: ca.SX, level: ca.SX, load: ca.SX) -> ShaftFriction:
        drive = self.law.rig.drive
        # Viscous friction and the constant offset of the drive are fed forward; Coulomb friction
        # depends on the desired direction and is added by the law.
        needed = drive.coupling.joint_torque(viscous * speed + drive.joint_offset())
        sweeps = self.law.settings.friction_sweeps
        return ShaftFriction(speed, viscous, level, needed, load, sweeps)


class LearntFriction(StatedFriction):
    """Friction of the rig, corrected by shares that are learnt where joints turn back.

    Its memory: the shares by which `coulomb` and `viscous` friction differ from the rig's; and, in
    the recent past, the reference's `heading` (-1 to 1), the viscous torque `drag` [N m] and the
    `disturbance` torque of the shafts [N m].
    """

    fields = Fields(
        coulomb=per_joint(),
        viscous=per_joint(),
        heading=per_joint(),
        drag=per_joint(),
        disturbance=per_joint(),
    )

    def at(self, memory: Any, speed: ca.SX, load: ca.SX) -> ShaftFriction:
        """As of `NoFriction`."""
        viscous, level = self.stated(speed, load)
        # A learnt share scales the rig's friction, so that zero is the rig's own.
        shares = 1 + memory.viscous, 1 + memory.coulomb
        return self._shafts(speed, viscous * shares[0], level * shares[1], load)

    def learn(
        self,
        memory: Any,
        friction: ShaftFriction,
        needed: ca.SX,
        disturbance: ca.SX,
        dt: ca.SX,
    ) -> Learnt:
        """Shares of friction, and a disturbance torque less what they took over."""
        law = self.law
        coupling = law.rig.drive.coupling
        viscous, level = self.stated(friction.speed, friction.load)
        drag = viscous * friction.speed
        heading = speed_share(law.rig, friction.speed, law.settings.sliding_speed)

        # 1. How much friction and disturbance changed since the turn.
        turned = heading - memory.heading
        changes = level * turned, drag - memory.drag
        # A start from rest changes the heading by 1 at most, and teaches nothing: gravity shows
        # there, too.
        rate = law.settings.learning_rate * ca.fabs(heading) * ca.fmax(ca.fabs(turned) - 1, 0)

        # 2. Project the one on the other: a step of least squares, at most all of it.
        shaft = coupling.shaft_torque(disturbance)
        step = (
            rate
            * dt
            / (1 + rate * dt)
            * (shaft - memory.disturbance)
            / (changes[0] ** 2 + changes[1] ** 2 + _TINY)
        )
        # Shares stay within `learnable`: a collision must not be learnt as friction.
        coulomb_share, viscous_share = (
            ca.fmin(ca.fmax(share + step * change, -law.learnable), law.learnable)
            for share, change in zip((memory.coulomb, memory.viscous), changes, strict=True)
        )

        # 3. Take what friction took over from the disturbance, now and in the recent past, so that
        # the torque does not jump.
        coulomb = coulomb_share - memory.coulomb
        viscous = viscous_share - memory.viscous
        shaft = shaft - level * heading * coulomb - drag * viscous
        before = memory.disturbance - level * memory.heading * coulomb - memory.drag * viscous

        # 4. The recent past follows while the joint moves.
        follow = ca.fabs(heading) * (1 - ca.exp(-dt / law.settings.learning_memory))
        memory = memory._replace(
            coulomb=coulomb_share,
            viscous=viscous_share,
            heading=memory.heading + follow * (heading - memory.heading),
            drag=memory.drag + follow * (drag - memory.drag),
            disturbance=before + follow * (shaft - before),
        )
        return Learnt(
            memory,
            friction._replace(level=friction.level + level * coulomb),
            needed + coupling.joint_torque(drag * viscous),
            coupling.joint_torque(shaft),
        )


def speed_share(rig: Rig, speed: ca.SX, full: float) -> ca.SX:
    """Speed of the shafts (n, 1) [rad/s] over a full one [pulses/s], within -1 and 1."""
    # The encoder counts turns of the motor, whatever the sign of the gear.
    pulses = rig.encoder.position_in_pulses(ca.fabs(rig.drive.gear) * speed) / full
    return ca.fmin(ca.fmax(pulses, -1), 1)


def shares(friction: ArrayLike, drive: Drive, limit: float | None) -> NDArray[np.float64]:
    """Shares (2, n) by which Coulomb and viscous friction, motor side, differ from a drive's.

    Shares beyond `limit` are refused; None is the limit of a law that learns none.
    """
    levels = array(
        "friction", friction, (2, drive.n), advice="Give that of a running controller, motor side."
    )
    stated = np.array([drive.coulomb, drive.viscous])
    # Where the rig states none, no share can give another level.
    absent = np.where(levels == stated, 1.0, np.inf)
    differs = np.divide(levels, stated, out=absent, where=stated > 0) - 1
    # 1e-9: shares at the limit that were divided and multiplied again.
    if limit is None or not (np.abs(differs) <= limit * (1 + 1e-9)).all():
        allowed = (
            "left out where none is learnt" if limit is None else f"within {limit:.0%} of the rig's"
        )
        raise ValueError(
            f"friction must be {allowed}; got {levels.tolist()}, the rig's are {stated.tolist()}."
        )
    return differs


def unexplained(
    torque: ArrayLike, law: Any, rig: Rig, q: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Torque (n,) that holds an arm beyond its weight and beyond the static friction known."""
    advice = "Give the joint torque that holds the arm now [N m, of slides N]."
    held = array("torque", torque, (rig.n,), advice=advice)
    coupling = rig.drive.coupling
    limit = rig.drive.torque_limit()
    # A wrong unit, such as N mm, would begin the observer with an absurd disturbance.
    if (np.abs(coupling.shaft_torque(held)) > limit).any():
        raise ValueError(f"torque must be within the amplifier's {limit}; got {held}. {advice}")
    # Gravity of the arm and springs of the rig hold the arm without any motor.
    weight = law.arm.h(q, np.zeros(rig.n)) - np.ravel(law.rig.spring_torque(q))
    lacking = coupling.shaft_torque(held - weight)
    level = law.rig.drive.joint_coulomb() if law.friction else 0.0
    # Static friction may carry anything within its cone, so that much tells nothing.
    return coupling.joint_torque(lacking - np.clip(lacking, -level, level))

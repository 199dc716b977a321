"""Arms, rigs and laws for the tests of the closed loop."""

import dataclasses

import casadi as ca
import numpy as np

from plant import (
    Body,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Law,
    Link,
    Lumping,
    P,
    Rig,
    StatelessLaw,
    number,
    part,
    structure,
)

PULSE = 7.3e-5
"""One pulse of the paper's joint 2 on the joint side [rad]."""


@part
class NoTorque(StatelessLaw):
    """Leaves the arm to itself."""

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return ca.SX.zeros(rig.n), state


@part
class Constant(StatelessLaw):
    """The same torque always."""

    torque: float = number(())
    period: float = structure()

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return self.torque * ca.SX.ones(rig.n), state


@part
class Counting(Law):
    """A torque of as many N m as there were samples: one number of state."""

    period: float = structure()

    def initial_state(self, n):
        return np.zeros(1)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return state * ca.SX.ones(rig.n), state + 1


@part
class SampledP(StatelessLaw):
    """The P controller as a digital loop: held from one of its samples to the next."""

    gain: np.ndarray = number(("n",))
    period: float = structure()

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return rig.drive.joint_torque(self.gain * (setpoint.pulses - pulses)), state


@part
class Filtered(Law):
    """A sampled law that uses everything a law is given: state, reference, pulses, last torque,
    dt and numbers.
    """

    gain: np.ndarray = number(("n",))
    rate: float = number(())
    period: float = structure()

    def initial_state(self, n):
        return np.linspace(0.1, 0.2, 2 * n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        n = rig.n
        error, last = rig.cell_centre(setpoint.pulses) - rig.cell_centre(pulses), state[:n]
        low = ca.exp(-self.rate * dt)
        slope = low * state[n:] + (1 - low) * (error - last) / dt
        asked = (
            900 * self.gain * error
            + 10 * slope
            + 0.1 * setpoint.qdd
            + ca.sin(setpoint.qd)
            - 0.02 * torque
        )
        return asked, ca.vertcat(error, slope)


def joint(mass, radius, inertia):
    """One link that lifts its mass: axis horizontal, x along the link, gravity torque m g r cos
    q; inertia about it.
    """
    chain = Chain(links=(Link(name="1", alpha=np.pi / 2, a=0.0, d=0.0),))
    dynamics = Dynamics(chain=chain, lumping=Lumping.standard(chain))
    izz = inertia - mass * radius**2
    return dynamics.arm(
        dynamics.f((Body(mass=mass, com=(radius, 0, 0), inertia=(0, 0, 0, 0, 0, izz)),))
    )


def direct_rig(coulomb, viscous, *, period=0.7e-3, smooth=True):
    """Motors without gears, an unlimited amplifier, and an encoder of the paper's resolution on
    the joint side.
    """
    n = len(coulomb)
    drive = Drive(
        gear=np.ones(n),
        motor_inertia=np.zeros(n),
        viscous=viscous,
        coulomb=coulomb,
        motor_gain=np.ones(n),
        current_limit=np.full(n, np.inf),
    )
    return Rig(
        drive=drive,
        encoder=Encoder(resolution=np.full(n, 2 * np.pi / PULSE), smooth=smooth),
        period=period,
    )


def stiff(rig, stiffness):
    """The P law that acts as a spring [N m/rad] between reference and joint."""
    return P(gain=np.asarray(stiffness) / rig.position_in_pulses(np.ones(rig.n)) / rig.drive.gear)


def without_friction(rig, *, viscous=False, smooth=False, period=None):
    """The same rig with neither kind of friction, or with the viscous one only."""
    zero = np.zeros(rig.n)
    drive = dataclasses.replace(
        rig.drive, coulomb=zero, viscous=rig.drive.viscous if viscous else zero
    )
    encoder = dataclasses.replace(rig.encoder, smooth=smooth)
    return dataclasses.replace(
        rig, drive=drive, encoder=encoder, period=rig.period if period is None else period
    )

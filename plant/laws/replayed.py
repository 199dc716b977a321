"""Laws that ask for what a log holds: an experiment in open loop, or one whose controller is not known."""

from __future__ import annotations

from plant.laws.law import StatelessLaw
from plant.parts.part import part

__all__ = ["LoggedCurrent", "LoggedTorque"]


@part
class LoggedTorque(StatelessLaw):
    """The joint torque of the record, as its column `torque` has it [N m].

    The torque of a sample acts from there to the next: between two samples it is held.
    """

    replays = "torque"

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = the logged one."""
        return setpoint.logged, state


@part
class LoggedCurrent(StatelessLaw):
    """The torque of the motor currents of the record, as its column `current` has them [A], by the rig's motor gain.

    The current of a sample acts from there to the next: between two samples it is held.
    """

    replays = "current"

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        """Tau = k K_i i."""
        return rig.drive.joint_torque(rig.drive.motor_gain, setpoint.logged), state

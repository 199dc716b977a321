"""Laws that repeat the torque or the current of a log: for experiments in open loop, or under an unknown controller."""

import casadi as ca

from plant.laws.law import Setpoint, StatelessLaw, Step
from plant.machine.rig import Rig
from plant.parts.part import part


@part
class LoggedTorque(StatelessLaw):
    """The logged joint torque, the record's column `torque` [N m], repeated in open loop.

    The torque of a sample acts from there to the next: zero-order hold.

    See Also
    --------
    plant.LoggedCurrent, identification.fit_torque

    Examples
    --------
    >>> from plant import LoggedTorque, replay, puma560, simulate
    >>> arm = puma560.arm()
    >>> record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.3)
    >>> again = replay(arm, record, law=LoggedTorque())
    >>> again.t.shape == record.t.shape
    True
    """

    replays = "torque"

    def equations(self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX) -> Step:
        """Tau = the logged one."""
        return setpoint.logged, state


@part
class LoggedCurrent(StatelessLaw):
    """The logged motor currents, the record's column `current` [A], repeated in open loop by the rig's motor gain.

    The current of a sample acts from there to the next: zero-order hold.

    See Also
    --------
    plant.LoggedTorque, plant.Record

    Examples
    --------
    >>> from plant import LoggedCurrent
    >>> LoggedCurrent()
    LoggedCurrent()
    """

    replays = "current"

    def equations(self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX) -> Step:
        """Tau = k K_i i."""
        return rig.drive.joint_torque(rig.drive.motor_gain, setpoint.logged), state

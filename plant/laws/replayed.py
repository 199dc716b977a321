"""Laws that repeat the torque or the current of a log, in open loop; and what a law without
memory commanded in one.
"""

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

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

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = the logged one."""
        return setpoint.logged, state


@part
class LoggedCurrent(StatelessLaw):
    """The logged motor currents, the record's column `current` [A], repeated in open loop by the
    rig's motor gain.

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

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """Tau = k K_i i."""
        return rig.drive.joint_torque(rig.drive.motor_gain, setpoint.logged), state


_AT_ONCE = 1 << 14  # samples that are worked out at once


def commanded_torque(record: Any) -> NDArray[np.float64] | None:
    """Commanded torques (N, n) [N m] of a record under a law without memory, before the limit;
    None for other laws.
    """
    law = record.law
    rig = record.rig
    if law is None or law.replays or law.has_memory(record.n):
        return None
    block = law.block(rig)
    counts = record.counts
    found = np.empty((len(record), record.n))
    zero = np.zeros(record.n)
    for start in range(0, len(record), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        pulses = record.reference_pulses[rows].T, counts[rows].T
        found[rows] = (
            block.step([], zero, zero, zero, *pulses, zero, rig.period, block.values)[0].full().T
        )
    return found

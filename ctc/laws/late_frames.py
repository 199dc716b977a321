"""Goals and frames that reach an inner loop late, by the time that the law's rig states."""

from typing import Any

import casadi as ca

from plant import Fields, Rig, per_joint


class LateFrames:
    """Delay between a sample and the frame that it sends; without an inner loop there is none.

    `delay` is that time [s], 0 or a number of the rig's transport; `period` that of the samples.
    """

    def __init__(self, rig: Rig) -> None:
        transport = None if rig.inner is None else rig.transport
        self.delay = 0 if transport is None else transport.delay
        self.period = rig.period
        self.fields = Fields() if transport is None else Fields(torque=per_joint())

    def acted(self, memory: Any, torque: ca.SX) -> ca.SX:
        """Mean torque (n, 1) [N m] of the sample that is over; `torque` is that sent last."""
        if not self.fields.fields:
            return torque
        # The frame before that one still acted for the time of the delay.
        return torque + self.delay / self.period * (memory.torque - torque)

    def following(self, torque: ca.SX) -> dict[str, ca.SX]:
        """The memory one sample later."""
        return {"torque": torque} if self.fields.fields else {}

"""Torques that were commanded and do not act yet."""

from typing import Any

import casadi as ca

from plant import Fields, per_joint


class DelayQueue:
    """The torques commanded in the last `samples` samples (0 or 1)."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.fields = Fields(commanded=per_joint()) if samples else Fields()

    def acting(self, memory: Any, commanded: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] that acts from now on, if `commanded` is the newest."""
        return memory.commanded if self.samples else commanded

    def following(self, memory: Any, commanded: ca.SX) -> Any:
        """The memory one sample later."""
        return memory._replace(commanded=commanded) if self.samples else memory

"""The lag of motor currents behind the commanded ones."""

import casadi as ca

from plant.parts.part import Part, number, part

_LONGEST = 0.02
"""Of a time constant [s]: a current loop of 8 Hz, which is none. Milliseconds given as seconds are above."""


@part
class CurrentLag(Part):
    """How the motor currents follow the commanded ones: a first-order lag.

    Parameters
    ----------
    time : float
        Time constant, at most 0.02 [s].
    """

    time: float = number(())

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.time > 0:
            raise ValueError(f"current_lag must be positive; got {self.time:g} s. Leave it out for none.")
        if self.time > _LONGEST:
            raise ValueError(f"current_lag must be at most {_LONGEST:g} s; got {self.time:g}. Give it in seconds.")


def lagging(commanded: ca.SX, driven: ca.SX, lag: CurrentLag, h: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Mean torque in a step of length h, and the torque at its end, of currents that follow with a time constant."""
    decay = ca.exp(-h / lag.time)
    end = commanded + (driven - commanded) * decay
    return commanded + (driven - commanded) * (lag.time / h) * (1 - decay), end

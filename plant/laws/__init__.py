"""Control laws as symbolic steps: the contract, P, PD, PID and cascade, laws that repeat a log.

Reading order: `law` (the contract) -> `terms` (rate, integral) -> `pid` -> `replayed`, `resumed`.
"""

from plant.laws.law import Block, Law, Setpoint, StatelessLaw, Step, block_of
from plant.laws.pid import PD, PID, Cascade, P
from plant.laws.replayed import LoggedTorque, commanded_torque
from plant.laws.resumed import FAST, AlongLog, Resumed
from plant.laws.terms import (
    ANTI_WINDUP,
    INTEGRATION,
    SMOOTHED,
    difference,
    filtered_difference,
    integrated,
    readings,
)

__all__ = [
    "ANTI_WINDUP",
    "FAST",
    "INTEGRATION",
    "PD",
    "PID",
    "SMOOTHED",
    "AlongLog",
    "Block",
    "Cascade",
    "Law",
    "LoggedTorque",
    "P",
    "Resumed",
    "Setpoint",
    "StatelessLaw",
    "Step",
    "block_of",
    "commanded_torque",
    "difference",
    "filtered_difference",
    "integrated",
    "readings",
]

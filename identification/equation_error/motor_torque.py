"""The torque of the motors along a record: commanded by its law, injected, or logged."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from plant import Record, Resumed
from plant.laws.replayed import commanded_torque
from plant.simulation.clock import Clock
from plant.simulation.injection import injected_beside
from plant.simulation.law_run import run_law


def torque_of(record: Record) -> NDArray[np.float64]:
    """Joint torques (N, n) [N m] of a record: commanded by its law, or logged where the law has a memory.

    A torque that a sampled law holds counts half at both ends of its sample, and so does one that was injected, which
    is added to what the law commanded. A law along its log is run.
    """
    law, rig = record.law, record.rig
    if isinstance(law, Resumed):
        clock = Clock.of(record)
        own = run_law(dataclasses.replace(record, law=law.along(rig))).around(clock.t[clock.rows], rig.period)
        return driven(record, own)
    commanded = commanded_torque(record)
    if commanded is not None:
        return driven(record, rig.drive.limited(commanded))
    return logged_torque(record)


def logged_torque(record: Record) -> NDArray[np.float64]:
    """Joint torques (N, n) [N m] that a record has logged, half at both ends of a sample that holds them."""
    law, rig = record.law, record.rig
    if record.torque is not None:
        logged = record.torque
    elif record.current is not None:
        logged = rig.drive.joint_torque(rig.drive.motor_gain * record.current)
    else:
        raise ValueError(
            f"the record must hold torques or currents; the counts under {type(law).__name__} do not give them. Log "
            "one of them, state what the law remembered (Resumed), or use identify, which finds it."
        )
    if law is None or (law.period is None and not law.replays):
        return logged
    return _held(logged)


def driven(record: Record, own: NDArray[np.float64]) -> NDArray[np.float64]:
    """Torque (N, n) [N m] of the motors: its law's own, and what was injected, within the amplifier's limit."""
    added = injected_beside(record)
    return own if added is None else record.rig.drive.limited(own + _held(added))


def _held(torque: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean (N, n) around each sample of a torque that is held to the next: at a sample, both act."""
    return (torque + np.vstack([torque[:1], torque[:-1]])) / 2

"""Whether a log is informative: motion, length, and torque below the amplifier's limit."""

from collections.abc import Sequence

import numpy as np

from identification.equation_error.motor_torque import torque_of
from identification.equation_error.naming import column_of
from identification.equation_error.pulse_fit import mode_in
from plant import Record
from plant.checkup.oscillation import own_oscillation

_LEAST_PULSES = 20
"""Counts that every motor has to move, at least."""

_LEAST_SAMPLES = 200
"""Fewer hold no oscillation of a position loop that stands out from its noise."""

_SATURATED = 0.5
"""Share of the samples at the amplifier's limit above which a log is refused."""

_PERIODS = 4
"""Of the slow mode that a log has to hold."""


def require_informative(record: Record, labels: Sequence[str]) -> None:
    """Refuse a log that is too short for the loop's mode, or in which a motor hardly moves or mostly saturates.

    Raises
    ------
    ValueError
        With the joint, by these labels.
    """
    moved = np.ptp(record.counts, axis=0)
    if (moved < _LEAST_PULSES).any():
        motor = int(np.argmin(moved))
        raise ValueError(
            f"every motor must move by at least {_LEAST_PULSES} pulses; that of {labels[motor]}"
            f"{column_of(record, 'counts', motor)} moves by {moved[motor]:.0f}. Log a motion of all joints, or leave "
            "out that record."
        )
    if len(record) < _LEAST_SAMPLES:
        raise ValueError(f"a log must have at least {_LEAST_SAMPLES} samples; got {len(record)}. Log longer.")
    drive, replays = record.rig.drive, record.law is not None and record.law.replays
    share = (np.abs(drive.current(torque_of(record))) >= drive.current_limit * (1 - 1e-9)).mean(axis=0)
    if (share > _SATURATED).any() and not replays:  # of a replay the torque is known, also at the limit
        motor = int(np.argmax(share))
        hz = own_oscillation(record)
        why, advice = (
            "" if hz is None else f": its loop swings by itself at {hz:.3g} Hz",
            "Slow the reference down or lower the gains.",
        )
        if record.reference is None and not record.reference_pulses.any():
            why, advice = (
                ": no reference came with it, so its law is taken to hold 0",
                "Map reference_position, or give reference=.",
            )
        raise ValueError(
            f"a log must be below the amplifier's limit; the motor of {labels[motor]}"
            f"{column_of(record, 'torque', motor)} is at it for {share[motor]:.0%} "
            f"of the samples{why}. {advice}"
        )
    seconds, mode = len(record) * record.rig.period, mode_in(record)
    if not mode > 0:
        raise ValueError(
            f"a log must show how its loop swings; sampled every {record.rig.period:g} s it does not. State rig.period "
            "in seconds, or log faster."
        )
    if seconds < _PERIODS / mode:
        raise ValueError(
            f"a log must last {_PERIODS} periods of its oscillation; {seconds:.3g} s hold "
            f"{seconds * mode:.1f} periods of {mode:.1f} Hz. Log longer."
        )

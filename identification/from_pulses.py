"""The equation error of records: torques by the law that made them, motion from counts, in a pass band of its own.

Under a law without memory the torque of the motors is known from the logged counts, as exactly as they are. Low
frequencies say little of inertias; above the slow mode of the position loop the rounding of the counts says more than
the arm. So the pass band is twice the frequency of that mode: found first in the spectrum of the tracking error, then,
once a first f is there, from the linearised loop.
"""

from __future__ import annotations

import numpy as np

from identification.equation_error import LINEAR, equations, weighted
from plant.linear import jacobians, modes

__all__ = ["equation_error", "mode_in", "pass_band", "sides_in", "torque_of"]

_BAND = 2.0
"""Pass band, in frequencies of the slow mode."""

_BEYOND, _FAR_MORE = 8.0, 1000.0
"""Pass band where nothing swings, in frequencies of the path; and what tells the path from rounding, in power."""

_CUTOFF = 2.5
"""Low-pass before differentiation, in pass bands."""

_LOWEST, _HIGHEST = 3.0, 0.1
"""Where a mode is looked for: from so many Hz to this share of the sample rate."""

_POSES = 8


def torque_of(record):
    """Joint torques (N, n) [N m] of a record: what its law asked for, or what was logged where a law has a memory.

    A torque that a sampled law holds counts half at both ends of its sample.
    """
    law, rig = record.law, record.rig
    if law is not None and not law.has_memory(record.n):
        block, zero = law.block(rig), np.zeros((record.n, len(record)))
        counts = record.counts.T
        asked, _ = block.step.map(len(record))(
            np.empty((0, len(record))), zero, zero, zero, record.reference_pulses.T, counts, zero,
            np.full((1, len(record)), rig.period), np.repeat(block.values[:, None], len(record), axis=1),
        )  # fmt: skip
        return rig.drive.limited(asked.full().T)
    if record.torque is None and record.current is None:
        raise ValueError(
            f"the record must hold torques or currents; the counts under {type(law).__name__} do not tell. Log them."
        )
    if record.torque is not None:
        logged = record.torque
    else:
        logged = rig.drive.joint_torque(rig.drive.motor_gain * record.current)
    if law is None or law.period is None:
        return logged
    return (logged + np.vstack([logged[:1], logged[:-1]])) / 2  # held from its sample to the next: at one, both act


def mode_in(record):
    """Frequency [Hz] at which the tracking errors of a record swing most, their accelerations compared."""
    error = record.error_pulses - record.error_pulses.mean(axis=0)
    power = np.abs(np.fft.rfft(error * np.hanning(len(error))[:, None], axis=0)) ** 2
    frequency = np.fft.rfftfreq(len(error), record.rig.period)
    power = np.convolve((power * frequency[:, None] ** 2).sum(axis=1), np.ones(5) / 5, mode="same")
    power[(frequency < _LOWEST) | (frequency > _HIGHEST / record.rig.period)] = 0
    return float(frequency[power.argmax()])


def path_in(record):
    """Highest frequency [Hz] at which the counts of a record hold far more than their rounding."""
    counts = record.counts
    power = np.abs(np.fft.rfft((counts - counts.mean(axis=0)) * np.hanning(len(counts))[:, None], axis=0)) ** 2
    rows = np.flatnonzero((power > _FAR_MORE * np.median(power[len(power) // 2 :], axis=0)).any(axis=1))
    return float(np.fft.rfftfreq(len(counts), record.rig.period)[rows.max(initial=1)])


def pass_band(record, arm=None):
    """Pass band [Hz] of a record's equation error: twice the slow mode, of the data or of a linearised arm.

    Under a law with a memory (computed torque) nothing swings, and the band is some times that of the path.
    """
    if record.law is not None and record.law.has_memory(record.n):
        return round(_BEYOND * path_in(record), 1)
    band = round(_BAND * mode_in(record), 1)
    if arm is None or record.law is None:
        return band
    angles = record.rig.angle(record.counts)
    poses = angles[:: max(1, len(angles) // _POSES)]
    found = [modes(jacobians(arm, record.rig, record.law, pose)[0]) for pose in poses]
    slow = [each[0, 0] for each in found if len(each)]
    return round(_BAND * float(np.max(slow)), 1) if slow else band


def equation_error(dynamics, records, unknown):
    """Fit of the torque equation to records, in their pass bands.

    Parameters
    ----------
    dynamics : Dynamics
    records : sequence of Record
    unknown : tuple of str
        All of f, and linear numbers of the drive; others keep what the record says of them.

    Returns
    -------
    TorqueFit
    """
    unknown = tuple(name for name in unknown if name in dynamics.names or name.startswith(LINEAR))
    bands, fit = [pass_band(record) for record in records], None
    for attempt in range(2):
        if attempt:
            arm = dynamics.arm(fit.values[[unknown.index(name) for name in dynamics.names]])
            try:
                bands = [pass_band(record, arm) for record in records]
            except (ValueError, np.linalg.LinAlgError):  # no arm yet that has a mode
                break
        sides = []
        for record, band in zip(records, bands, strict=True):
            q = record.rig.angle(record.counts)
            sides.append(sides_in(dynamics, record, band, unknown, q))
        fit = weighted(unknown, sides)
    return fit


def sides_in(dynamics, record, band, unknown, q):
    """The torque equation of a record along a motion q (N, n) [rad], in a band [Hz]."""
    rig = record.rig
    band = min(band, 0.4 / _CUTOFF / rig.period)
    every = max(1, int(1 / (2 * band * rig.period)))
    slowest = _speed_noise(rig, band)
    return equations(dynamics, q, torque_of(record), rig, _CUTOFF * band, band, every, unknown, slowest, {})


def _speed_noise(rig, band):
    """Three standard deviations (n,) of the joint speed that rounding makes in a band [rad/s]."""
    pulse = np.abs(rig.turned(np.eye(rig.n))).max(axis=0)
    return 3 * pulse / np.sqrt(12) * np.sqrt(2 * band * rig.period) * 2 * np.pi * band / np.sqrt(3)

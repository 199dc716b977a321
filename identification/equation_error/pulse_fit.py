"""The equation error of records: torques by the law that made them, motion from counts, in a pass band of its own.

Under a law without memory the torque of the motors is known from the logged counts, as exactly as they are. Low
frequencies say little of inertias; above the slow mode of the position loop the rounding of the counts says more than
the arm. So the pass band is twice the frequency of that mode: found first in the spectrum of the tracking error, then,
once a first f is there, from the linearised loop.
"""

from __future__ import annotations

import numpy as np

from identification.equation_error.torque_fit import LINEAR, equations, weighted
from plant.analysis.linearise import jacobians, modes
from plant.laws.law import commanded_torque

__all__ = [
    "equation_error", "fit_sides", "linear", "mode_in", "over_bands", "pass_band", "sides_in", "torque_of",
]  # fmt: skip

_BAND = 2.0
"""Pass band, in frequencies of the slow mode."""

_BEYOND, _FAR_MORE = 8.0, 1000.0
"""Pass band where nothing swings, in frequencies of the path; and what tells the path from rounding, in power."""

_CUTOFF = 2.5
"""Low-pass before differentiation, in pass bands."""

_CUTOFF_MOST = 0.4 / _CUTOFF
"""Highest pass band, in sample rates."""

_LOWEST, _HIGHEST = 3.0, 0.1
"""Where a mode is looked for: from so many Hz to this share of the sample rate."""

_POSES = 8

_ENOUGH = 5
"""Equations per unknown below which a band says too little."""

_BANDS = 2.0 ** np.arange(-1, 6, 0.5)
"""Bands that are tried where a torque was logged [Hz]."""


def torque_of(record):
    """Joint torques (N, n) [N m] of a record: what its law asked for, or what was logged where a law has a memory.

    A torque that a sampled law holds counts half at both ends of its sample.
    """
    law, rig = record.law, record.rig
    asked = commanded_torque(record)
    if asked is not None:
        return rig.drive.limited(asked)
    if record.torque is None and record.current is None:
        raise ValueError(
            f"the record must hold torques or currents; the counts under {type(law).__name__} do not tell. Log them."
        )
    if record.torque is not None:
        logged = record.torque
    else:
        logged = rig.drive.joint_torque(rig.drive.motor_gain * record.current)
    if law is None or (law.period is None and not law.replays):
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
    angles = record.rig.cell_centre(record.counts)
    poses = angles[:: max(1, len(angles) // _POSES)]
    found = [modes(jacobians(arm, record.rig, record.law, pose)[0]) for pose in poses]
    slow = [each[0, 0] for each in found if len(each)]
    return round(_BAND * float(np.max(slow)), 1) if slow else band


def equation_error(dynamics, records, unknown, known=None):
    """Fit of the torque equation to records, in their pass bands.

    Parameters
    ----------
    dynamics : Dynamics
    records : sequence of Record
    unknown : tuple of str
        All of f, and linear numbers of the drive; others keep what the record says of them.
    known : dict of str to float, optional
        What some of them are.

    Returns
    -------
    TorqueFit
        Of those that are not known.
    """
    known = known or {}
    unknown = linear(dynamics, unknown)
    bands, fit = [pass_band(record) for record in records], None
    for attempt in range(2):
        if attempt:
            values = known | dict(zip(fit.names, fit.values, strict=True))
            arm = dynamics.arm([values[name] for name in dynamics.names])
            try:
                bands = [pass_band(record, arm) for record in records]
            except (ValueError, np.linalg.LinAlgError):  # no arm yet that has a mode
                break
        sides = []
        for record, band in zip(records, bands, strict=True):
            q = record.rig.cell_centre(record.counts)
            sides.append(sides_in(dynamics, record, band, unknown, q))
        fit = fit_sides(unknown, known, sides)
    return fit


def over_bands(dynamics, records, unknown, known=None):
    """Fits of the torque equation to logged torques, band [Hz] -> TorqueFit.

    Too low a band holds too little of the motion; in too high a one the accelerations are those of the counts'
    rounding, and of what the torque does not know of: everything comes out too small. In between the equation holds
    best.
    """
    unknown, fits = linear(dynamics, unknown), {}
    even = [record.resampled(record.rig.period) for record in records]
    highest = min(_CUTOFF_MOST / record.rig.period for record in even)
    for band in _BANDS[highest > _BANDS]:
        try:
            sides = [
                sides_in(dynamics, record, band, unknown, record.rig.cell_centre(record.counts)) for record in even
            ]
            fit = fit_sides(unknown, known or {}, sides)
        except ValueError:  # a band without equations, or in which unknowns cannot be told apart
            continue
        if fit.rows >= _ENOUGH * len(fit.names):
            fits[float(band)] = fit
    if not fits:
        raise ValueError("a torque must show what is unknown in some band; it does in none. Log a livelier motion.")
    return fits


def linear(dynamics, unknown):
    """Those of the unknowns that enter the torque linearly."""
    return tuple(name for name in unknown if name in dynamics.names or name.startswith(LINEAR))


def fit_sides(unknown, known, sides):
    """Weighted fit of what is not known to equations of all the unknowns."""
    given = [i for i, name in enumerate(unknown) if name in known]
    open_ = [i for i, name in enumerate(unknown) if name not in known]
    values = np.array([known[unknown[i]] for i in given])
    less = [
        (wanted - (columns[:, :, given] * values).sum(axis=2), columns[:, :, open_], used)
        for wanted, columns, used in sides
    ]
    return weighted(tuple(unknown[i] for i in open_), less)


def sides_in(dynamics, record, band, unknown, q):
    """The torque equation of a record along a motion q (N, n) [rad], in a band [Hz]."""
    rig = record.rig
    band = min(band, _CUTOFF_MOST / rig.period)
    every = max(1, int(1 / (2 * band * rig.period)))
    slowest = _speed_noise(rig, band)
    return equations(
        dynamics, q, torque_of(record), rig, _CUTOFF * band, band, every, unknown, slowest, {}, record.valid
    )


def _speed_noise(rig, band):
    """Three standard deviations (n,) of the joint speed that rounding makes in a band [rad/s]."""
    pulse = np.abs(rig.to_angle(np.eye(rig.n))).max(axis=0)
    return 3 * pulse / np.sqrt(12) * np.sqrt(2 * band * rig.period) * 2 * np.pi * band / np.sqrt(3)

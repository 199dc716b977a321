"""Excitation of logs before a fit: joints that do not move, parameters that stay at a prior."""

from collections.abc import Sequence

import numpy as np

from identification.equation_error.filters import BAND_MOST, CUTOFF, derivatives
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import pass_band
from identification.equation_error.regressor import regressor_along
from plant import Dynamics, Record
from plant.checkup import hardly_moving, in_step, on_lines
from plant.motion import Motion
from plant.parts import Integers, frozen_settings, products


@frozen_settings
class ExcitationSettings:
    """When a motion excites a parameter; chosen by hand.

    Parameters
    ----------
    determined : float
        Standard deviation beside the log, relative to that of the prior, below which the log
        determines a parameter.
    in_step : float
        Least correlation of the smoothed speeds, tracking errors in them, of joints in step.
    torque_error : float
        Expected error of the torques of a log, relative to each joint's.
    """

    determined: float = 0.5
    in_step: float = 0.999
    torque_error: float = 0.02


SETTINGS = ExcitationSettings()


def still(records: Sequence[Record]) -> Integers:
    """Joints that hardly move in any record."""
    return np.flatnonzero(np.all([hardly_moving(record) for record in records], axis=0))


def unexcited(dynamics: Dynamics, records: Sequence[Record]) -> list[str]:
    """Joints that hardly move in any record, and pairs that move in step."""
    labels = dynamics.chain.joint_labels
    # Of all records together: joints in step in one may move apart in another.
    speeds = np.concatenate([_motion(record).qd for record in records])
    ranges = np.max([np.ptp(record.counts, axis=0) for record in records], axis=0)
    messages = [f"{labels[i]} moves by {ranges[i]:.0f} pulses" for i in still(records)]
    # Joints in step excite only the sum of their effects: their parameters cannot be separated.
    pairs = in_step(speeds, SETTINGS.in_step)
    return messages + [f"{labels[i]} and {labels[j]} move in step" for i, j in pairs]


def from_prior(dynamics: Dynamics, records: Sequence[Record], prior: Prior) -> list[str]:
    """Parameters of f that the logs leave to the prior."""
    shares = _shares(dynamics, records, [_motion(record) for record in records], prior)
    pairs = zip(dynamics.short_names, shares, strict=True)
    return [name for name, share in pairs if share > SETTINGS.determined]


def advice(dynamics: Dynamics, records: Sequence[Record], prior: Prior | None) -> str:
    """Sentences on the parameters that come from the prior, and on a motion that excites more."""
    text = ""
    if prior is not None:
        names = from_prior(dynamics, records, prior)
        text = (
            f"From the prior ({100 * prior.spread:.3g} %) are about {len(names)} of {dynamics.p}"
            f" parameters: {', '.join(names)}. "
        )
    return f"{text}design_motion(arm, rig, law, ...) gives a motion that excites more."


def _motion(record):
    """Motion in the pass band, with as many samples as are independent in it.

    Joints that hardly move stand still.
    """
    rig = record.rig
    # Rows without weight may hold anything.
    counts = on_lines(record, record.valid == 0).counts
    # Single counts of a joint at rest would pass for a motion of it.
    counts = np.where(hardly_moving(record), np.round(counts.mean(axis=0)), counts)
    band = min(pass_band(record), BAND_MOST / rig.period)
    motion = derivatives(rig.cell_centre(counts), rig.period, CUTOFF * band)
    # Two samples per period of the band are independent.
    every = max(1, int(1 / (2 * band * rig.period)))
    return Motion(*(signal[::every] for signal in motion))


def _shares(dynamics, records, motions, prior):
    """Standard deviations (p,) of f after the logs, as shares of those of the prior."""
    # In whitened coordinates the information of the prior is the unit matrix.
    root = np.linalg.inv(prior.whitening)
    # Each log adds its own, with the noise of each joint's torque.
    information = np.eye(dynamics.p)
    for record, motion in zip(records, motions, strict=True):
        regressor, _ = regressor_along(dynamics, record.rig, dynamics.names, motion)
        torque = np.sqrt(((regressor * prior.mean).sum(axis=2) ** 2).mean(axis=0))
        # A joint without load, as one about the vertical, still has the noise of its amplifier.
        noise = SETTINGS.torque_error * np.maximum(torque, 1e-3 * torque.max())
        information += products(np.reshape(regressor / noise[:, None], (-1, dynamics.p)) @ root)
    covariance = root @ np.linalg.inv(information) @ root.T
    return np.sqrt(np.diag(covariance) / np.diag(prior.covariance))

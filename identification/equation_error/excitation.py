"""What the motion of logs does not excite, before anything is fitted: joints, and parameters that stay at a prior."""

from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error.filters import derivatives
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import BAND_MOST, CUTOFF, pass_band
from identification.equation_error.regressor import regressor_along
from plant import Dynamics, Record
from plant.motion.reference import Motion
from plant.parts.fields import Floats
from plant.parts.sums import products

LEAST_PULSES = 20  # counts that a motor has to move, at least

_TOLD = 0.5  # share of its prior standard deviation below which a log tells a parameter

_TORQUE = 0.02  # error of a log's torques that is expected, as a share of each joint's

_IN_STEP = 0.9999  # correlation of two speeds from which on joints move in step


def unexcited(dynamics: Dynamics, records: Sequence[Record], prior: Prior) -> Iterator[str]:
    """A line where joints hardly move in any record, or move in step, and the parameters that stay at the prior."""
    labels, motions = dynamics.chain.joint_labels, [_motion(record) for record in records]
    moved = np.max([np.ptp(record.counts, axis=0) for record in records], axis=0)
    found = [f"{labels[i]} moves by {moved[i]:.0f} pulses" for i in np.flatnonzero(moved < LEAST_PULSES)]
    pairs = in_step(np.concatenate([motion.qd for motion in motions]))
    found += [f"{labels[i]} and {labels[j]} move in step" for i, j in pairs]
    if found:
        shares = _shares(dynamics, records, motions, prior)
        names = [name for name, share in zip(dynamics.short_names, shares, strict=True) if share > _TOLD]
        yield (
            f"the log does not excite all: {', '.join(found)}. From the prior are about {len(names)} of {dynamics.p} "
            f"parameters: {', '.join(names)}. design_motion(arm, rig, law, ...) gives a motion that excites more."
        )


def in_step(speeds: Floats) -> list[tuple[int, int]]:
    """Pairs of columns of speeds (N, n) that are proportional all along."""
    lengths = np.sqrt((speeds**2).sum(axis=0))
    together = products(speeds / np.where(lengths > 0, lengths, np.inf))
    return [(int(i), int(j)) for i, j in np.argwhere(np.triu(np.abs(together) > _IN_STEP, 1))]


def _motion(record: Record) -> Motion:
    """In the pass band, as many samples as are independent in it; joints that hardly move stand still."""
    rig, counts = record.rig, record.counts
    counts = np.where(np.ptp(counts, axis=0) < LEAST_PULSES, np.round(counts.mean(axis=0)), counts)
    band = min(pass_band(record), BAND_MOST / rig.period)
    every = slice(None, None, max(1, int(1 / (2 * band * rig.period))))
    return Motion(*(part[every] for part in derivatives(rig.cell_centre(counts), rig.period, CUTOFF * band)))


def _shares(dynamics: Dynamics, records: Sequence[Record], motions: Sequence[Motion], prior: Prior) -> Floats:
    """Standard deviations (p,) of f after the logs, as shares of those of the prior."""
    root = np.linalg.inv(prior.whitening)
    information = np.eye(dynamics.p)
    for record, motion in zip(records, motions, strict=True):
        regressor, _ = regressor_along(dynamics, record.rig, dynamics.names, motion)
        torque = np.sqrt(((regressor * prior.mean).sum(axis=2) ** 2).mean(axis=0))
        noise = _TORQUE * np.maximum(torque, 1e-3 * torque.max())
        information += products(np.reshape(regressor / noise[:, None], (-1, dynamics.p)) @ root)
    covariance = root @ np.linalg.inv(information) @ root.T
    return np.sqrt(np.diag(covariance) / np.diag(prior.covariance))

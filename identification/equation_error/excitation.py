"""What the motion of logs does not excite, before anything is fitted: joints, and parameters
that stay at a prior.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.filters import derivatives
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import BAND_MOST, CUTOFF, pass_band
from identification.equation_error.regressor import regressor_along
from plant import Dynamics, Record
from plant.checkup.counts import hardly_moving, in_step
from plant.motion.reference import Motion
from plant.parts.fields import Floats
from plant.parts.sums import products

_TOLD = 0.5  # share of its prior standard deviation below which a log tells a parameter

# correlation of two smoothed speeds, tracking errors in them, from which on joints move in step
_IN_STEP = 0.999

_TORQUE = 0.02  # error of a log's torques that is expected, as a share of each joint's


def still(records: Sequence[Record]) -> NDArray[np.intp]:
    """Joints that hardly move in any record."""
    return np.flatnonzero(np.all([hardly_moving(record) for record in records], axis=0))


def unexcited(dynamics: Dynamics, records: Sequence[Record]) -> list[str]:
    """Joints that hardly move in any record, and pairs that move in step."""
    labels = dynamics.chain.joint_labels
    speeds = np.concatenate([_motion(record).qd for record in records])
    moved = np.max([np.ptp(record.counts, axis=0) for record in records], axis=0)
    found = [f"{labels[i]} moves by {moved[i]:.0f} pulses" for i in still(records)]
    return found + [
        f"{labels[i]} and {labels[j]} move in step" for i, j in in_step(speeds, _IN_STEP)
    ]


def from_prior(dynamics: Dynamics, records: Sequence[Record], prior: Prior) -> list[str]:
    """Parameters of f that the logs leave to the prior."""
    shares = _shares(dynamics, records, [_motion(record) for record in records], prior)
    return [name for name, share in zip(dynamics.short_names, shares, strict=True) if share > _TOLD]


def advice(dynamics: Dynamics, records: Sequence[Record], prior: Prior | None) -> str:
    """What comes from the prior, and the motion that would excite it."""
    said = ""
    if prior is not None:
        names = from_prior(dynamics, records, prior)
        said = (
            f"From the prior ({100 * prior.spread:.3g} %) are about {len(names)} of {dynamics.p}"
            " parameters: "
        )
        said += f"{', '.join(names)}. "
    return f"{said}design_motion(arm, rig, law, ...) gives a motion that excites more."


def _motion(record: Record) -> Motion:
    """In the pass band, as many samples as are independent in it; joints that hardly move stand
    still.
    """
    rig = record.rig
    counts = record.counts
    counts = np.where(hardly_moving(record), np.round(counts.mean(axis=0)), counts)
    band = min(pass_band(record), BAND_MOST / rig.period)
    every = slice(None, None, max(1, int(1 / (2 * band * rig.period))))
    return Motion(
        *(part[every] for part in derivatives(rig.cell_centre(counts), rig.period, CUTOFF * band))
    )


def _shares(
    dynamics: Dynamics, records: Sequence[Record], motions: Sequence[Motion], prior: Prior
) -> Floats:
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

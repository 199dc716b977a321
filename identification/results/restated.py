"""Contradictions between model and log: the sign of gravity or of one joint.

The signs follow from least squares of the smoothed torques on the smoothed motion, with base
parameters and friction of any value. Where the torque of a sampled law was not logged, the law is
run along the log, and its initial integral is a constant.
"""

import dataclasses
import functools

import numpy as np

from identification.equation_error.law_memory import along_log
from identification.equation_error.least_squares import IDENTIFIABLE
from identification.equation_error.torque_logs import torque_of
from plant import Dynamics, Record
from plant.checkup.counts import hardly_moving
from plant.checkup.signals import Signals
from plant.parts.settings import frozen_settings
from plant.parts.sums import least, product


@frozen_settings
class RestatedSettings:
    """Limits from which on a statement is contradicted.

    Parameters
    ----------
    closer : float
        Ratio of the residual with a changed sign to that as stated, below which the sign is
        reported. Measured: at most 0.74 for wrong signs, at least 1.33 for right ones.
    rows : int
        Samples of a log that are compared; chosen by hand.
    """

    closer: float = 0.8
    rows: int = 400


SETTINGS = RestatedSettings()


@functools.lru_cache(maxsize=4)
def restated(dynamics: Dynamics, record: Record) -> list[str]:
    """A line about the one sign whose change explains the torques of a record better, or none."""
    law = record.law
    logged = record.torque is not None or record.current is not None
    sampled = not logged and law is not None and bool(law.period) and law.has_memory(record.n)
    if sampled:
        # The law's torque stands in for one that was not logged.
        record = dataclasses.replace(record, torque=torque_of(along_log(record)))
    signals = Signals(record)
    if signals.motor_torque is None or not signals.long_enough:
        return []
    residual = functools.partial(_left, dynamics, signals, integrated=sampled)
    stated = np.ones(dynamics.n)
    as_stated = residual(stated)
    alternatives = {"gravity acts the other way": residual(stated, gravity=-1.0)}
    # Of a single joint, f of any value takes the turn over.
    for i, label in enumerate(dynamics.chain.joint_labels if dynamics.n > 1 else ()):
        text = f"{label} turns the other way: its axis, or the signs of all its columns, are wrong"
        alternatives[text] = residual(np.where(np.arange(dynamics.n) == i, -1.0, 1.0))
    # One sign at most: two that are wrong are found one after another.
    best = min(alternatives, key=alternatives.__getitem__)
    # Written so that NaN, of a record in which nothing moves, gives no line.
    if not alternatives[best] < SETTINGS.closer * as_stated:
        return []
    return [
        f"{best}. So stated, the equation of motion leaves {alternatives[best]:.1%} of the torques"
        f" (rms); as it is, {as_stated:.1%}. Correct that, and identify again."
    ]


def _left(
    dynamics,
    signals,
    sign,
    gravity=1.0,
    *,
    integrated=False,
):
    """Share (rms) of the smoothed torques that the equation of motion leaves.

    `sign` (n,): of the joints. `gravity`: factor of the stated gravity. `integrated`: whether the
    law integrates, so that each torque has an unknown constant.
    """
    rig = signals.rig
    n = signals.n
    rows = np.flatnonzero(signals.clear)
    rows = rows[:: max(1, len(rows) // SETTINGS.rows)]

    # 1. Motion and torque of the joints. Counts of zero are an angle, which speeds do not have.
    zero = rig.to_angle(np.zeros(n))
    q, qd, qdd = (
        sign * (rig.to_angle(signal[rows]) - (order > 0) * zero)
        for order, signal in enumerate(signals.motion)
    )
    smooth_torque = signals.smooth(signals.motor_torque)
    torque = sign * rig.drive.gear * smooth_torque[rows]
    # Dry friction: signs of speeds, filtered like the torque.
    dry = np.column_stack([signals.smooth_even(np.sign(speed)) for speed in signals.motion[1].T])[
        rows
    ]

    # 2. The regressor. A pose at rest gives its part by gravity.
    still = np.zeros(n)
    Y = np.array([dynamics.Y(*state) for state in zip(q, qd, qdd, strict=True)])
    if gravity != 1:
        Y += (gravity - 1) * np.array([dynamics.Y(pose, still, still) for pose in q])
    terms = (qd, dry, np.ones_like(qd)) if integrated else (qd, dry)
    friction = [np.eye(n)[None] * term[:, :, None] for term in terms]

    # 3. Least squares, each joint in units of its torque.
    scale = np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-300)
    # Friction holds a joint that hardly moves, at any torque: without weight.
    scale[hardly_moving(signals.record)] = np.inf
    A = np.concatenate([Y, *friction], axis=2) / scale[:, None]
    b = (torque / scale).ravel()
    A = A.reshape(torque.size, -1)
    A = A / np.maximum(np.abs(A).max(axis=0), 1e-300)
    residual = b - product(A, least(A, b, rcond=IDENTIFIABLE.equations))
    return float(np.sqrt(np.mean(residual**2)))

"""Whether gravity, or one joint, of a chain stated the other way explains torques that the chain as it is does not.

Least squares of the smoothed torques on the smoothed motion, with base parameters and friction of any value.
"""

import functools

import numpy as np

from plant import Dynamics, Record
from plant.checkup.signals import Signals
from plant.parts.fields import Floats

_CLOSER, _ROWS = 0.8, 400
"""Share of what a chain leaves that another has to stay below, to be named: of wrong ones it is 0.74 at most, of right
ones 1.33 at least; and rows of a log that are compared."""


@functools.lru_cache(maxsize=4)
def restated(dynamics: Dynamics, record: Record) -> list[str]:
    """A line about the one sign whose change explains the torques of a record much better, or none."""
    signals, every = Signals(record), np.ones(dynamics.n)
    if signals.motor_torque is None or not signals.long_enough:
        return []
    before, tried = _left(dynamics, signals, every), {}
    tried["gravity acts the other way"] = _left(dynamics, signals, every, gravity=-1.0)
    for i, label in enumerate(dynamics.chain.joint_labels if dynamics.n > 1 else ()):
        said = f"{label} turns the other way: its axis, or the signs of all its columns, are wrong"
        tried[said] = _left(dynamics, signals, np.where(np.arange(dynamics.n) == i, -1.0, 1.0))
    best = min(tried, key=tried.__getitem__)
    if tried[best] > _CLOSER * before:
        return []
    return [
        f"{best}. So stated, the equation of motion leaves {tried[best]:.1%} of the torques (rms); as it is, "
        f"{before:.1%}. Correct that, and identify again."
    ]


def _left(dynamics: Dynamics, signals: Signals, sign: Floats, gravity: float = 1.0) -> float:
    """Share (rms) of the smoothed torques that the equation of motion leaves.

    `sign` (n,): by which joints are turned. `gravity`: factor of what it is stated to be.
    """
    rig, rows = signals.rig, np.flatnonzero(signals.clear)
    rows = rows[:: max(1, len(rows) // _ROWS)]
    zero, still = rig.to_angle(np.zeros(signals.n)), np.zeros(signals.n)
    q, qd, qdd = (sign * (rig.to_angle(each[rows]) - (k > 0) * zero) for k, each in enumerate(signals.motion))
    torque = sign * rig.drive.gear * signals.smooth(signals.motor_torque)[rows]  # type: ignore[arg-type]  # there is one
    dry = np.column_stack([signals.smooth_even(np.sign(each)) for each in signals.motion[1].T])[rows]
    Y = np.array([dynamics.Y(*state) for state in zip(q, qd, qdd, strict=True)])
    if gravity != 1:
        Y += (gravity - 1) * np.array([dynamics.Y(pose, still, still) for pose in q])
    rubs = [np.eye(signals.n)[None] * each[:, :, None] for each in (qd, dry)]
    scale = np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-300)
    A, b = np.concatenate([Y, *rubs], axis=2) / scale[:, None], (torque / scale).ravel()
    A = A.reshape(torque.size, -1)
    A = A / np.maximum(np.abs(A).max(axis=0), 1e-300)
    return float(np.sqrt(np.mean((b - A @ np.linalg.lstsq(A, b, rcond=1e-9)[0]) ** 2)))

"""What the loop is asked to follow, worked out beforehand for every step of the law, the log and the plant.

Samples are at t_k = k period, from 0. The sub-steps read the reference at their middle. The reference counts are
rounded by `fix` to whole pulses, also between samples, as the control card does. A record that comes without a
reference is replayed from its logged counts: straight lines between two samples, rounded by `fix`.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from plant.encoder import fix
from plant.reference import Motion

__all__ = ["Logged", "Path", "path_of", "smooth_rig", "start_of", "time_tables"]


class Path:
    """A reference as a rig sees it: motion and pulses."""

    def __init__(self, reference, rig):
        if reference.n != rig.n:
            raise ValueError(f"reference must have {rig.n} joints like the rig; got {reference.n}. Use a matching one.")
        self.reference, self.rig = reference, rig

    def __call__(self, t):
        motion = self.reference(t)
        return motion, self.rig.pulses(motion.q)

    def start(self):
        """Position and velocity (n,) of the reference at t = 0."""
        motion = self.reference(np.zeros(1))
        return motion.q[0], motion.qd[0]


class Logged:
    """The reference of a record that has none but its logged pulses (N, n), one row per `period` [s]."""

    def __init__(self, reference_pulses, rig):
        self.pulses, self.rig = reference_pulses, rig

    def __call__(self, t):
        place = np.asarray(t) / self.rig.period
        place = np.where(np.abs(place - np.round(place)) < 1e-9, np.round(place), place)
        row = np.clip(np.floor(place).astype(int), 0, len(self.pulses) - 1)
        following = np.minimum(row + 1, len(self.pulses) - 1)
        step = self.pulses[following] - self.pulses[row]
        pulses = self.pulses[row] + step * np.maximum(place - row, 0)[:, None]
        motion = Motion(self.rig.turned(pulses), self.rig.turned(step / self.rig.period), np.zeros_like(pulses))
        return motion, pulses if self.rig.encoder.smooth else fix(pulses)

    def start(self):
        """Position at t = 0, at rest: two counts say nothing of a velocity."""
        return self.rig.turned(self.pulses[0]), np.zeros(self.rig.n)


def smooth_rig(rig):
    """The same rig with an encoder that does not round."""
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))


def path_of(record, *, smooth=False):
    """What a record's loop was asked to follow: its reference where it has one, its logged counts otherwise.

    Smooth: not rounded to pulses; counts then stand for the middle of their cell.

    Raises
    ------
    ValueError
        The logged counts are not those of the reference.
    """
    if record.reference is None:
        counts = record.reference_pulses
        return Logged(record.rig.counted(counts), smooth_rig(record.rig)) if smooth else Logged(counts, record.rig)
    path = Path(record.reference, record.rig)
    off = np.abs(path(np.arange(len(record)) * record.rig.period)[1] - record.reference_pulses).max(axis=1)
    wrong = np.flatnonzero(off > 1)
    if len(wrong):
        raise ValueError(
            f"reference_pulses must be the reference's own, from t = 0; sample {wrong[0]} is {off[wrong[0]]:.0f} "
            "pulses off. Correct the reference, or leave it out to replay the logged counts."
        )
    return Path(record.reference, smooth_rig(record.rig)) if smooth else path


def start_of(record, path):
    """Position and velocity (n,) from which a record is replayed.

    As the record says; or the reference's, but a joint whose first error is a pulse or more (an arm that hangs in its
    P loop before it starts) is where its encoder says, in the middle of that cell.
    """
    if record.initial is not None:
        return record.initial
    q, qd = path.start()
    counted = record.rig.angle(record.reference_pulses[0] - record.error_pulses[0])
    coupling = record.rig.drive.coupling
    return coupling.joint(np.where(np.abs(record.error_pulses[0]) >= 1, *map(coupling.shaft, (counted, q)))), qd


def time_tables(loop, path, samples):
    """Rows of `loop.time_names` for every step of the law, the log and the plant.

    Parameters
    ----------
    loop : ClosedLoop
    path : Path or Logged
    samples : int

    Returns
    -------
    law_time, sample_time, step_time : numpy.ndarray
    """
    h, steps = loop.h, samples * loop.steps_per_sample
    period = h * loop.steps_per_law
    law = np.arange(-(-steps // loop.steps_per_law)) * period if loop.steps_per_law else np.empty(0)
    times = (law, np.arange(samples) * loop.rig.period, (np.arange(steps) + 0.5) * h)
    tables = []
    for t in times:
        motion, pulses = path(t)
        tables.append(np.ascontiguousarray(np.column_stack([*motion, pulses, np.full(len(t), h)])))
    return tuple(tables)

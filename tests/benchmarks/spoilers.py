"""One thing of a log spoiled, by functions of a record and random numbers."""

import dataclasses

import numpy as np

from plant import Encoder


def stated(rig, rounding):
    """The rig as its owner states it: he does not know the phase."""
    return dataclasses.replace(
        rig, encoder=Encoder(resolution=rig.encoder.resolution, rounding=rounding)
    )


def rows(record, row):
    names = ("error_pulses", "reference_pulses", "torque", "current")
    return dataclasses.replace(
        record, **{name: x[row] for name in names if (x := getattr(record, name)) is not None}
    )


def counting(record, counts):
    return dataclasses.replace(record, error_pulses=record.reference_pulses - counts)


def lost_packets(record, random):
    row = np.arange(len(record))
    for k in np.flatnonzero(random.random(len(row)) < random.uniform(0.002, 0.02))[1:]:
        row[k] = row[k - 1]
    return rows(record, row)


def stuck(record, random):
    counts, joint = np.array(record.counts), random.integers(record.n)
    for k in random.integers(10, len(record) - 10, 20):
        counts[k : k + random.integers(1, 5), joint] = counts[k - 1, joint]
    return counting(record, counts)


def glitches(record, random):
    counts = np.array(record.counts)
    counts[random.integers(10, len(record) - 10, 8), random.integers(record.n)] += random.integers(
        50, 500
    )
    return counting(record, counts)


def turn(record, random):
    counts, joint = np.array(record.counts), random.integers(record.n)
    counts[random.integers(len(record) // 4, len(record)) :, joint] += (
        record.rig.encoder.resolution[joint]
    )
    return counting(record, counts)


def late_stamps(record, random):
    t = np.array(record.t)
    t[random.integers(10, len(t) - 10, 30)] += 0.4 * record.rig.period
    return dataclasses.replace(record, t=t)


def other_rounding(record, random):
    other = "fix" if record.rig.encoder.rounding == "floor" else "floor"
    return dataclasses.replace(record, rig=stated(record.rig, other))


def late(record, random):
    samples, row = random.uniform(0.3, 2.0), np.arange(len(record))
    centres = record.rig.encoder.position_in_pulses(record.rig.encoder.cell_centre(record.counts))
    moved = np.column_stack([np.interp(row - samples, row, column) for column in centres.T])
    return counting(record, record.rig.encoder.quantised(moved))


def turned_torque(record, random):
    sign = np.where(np.arange(record.n) == random.integers(record.n), -1.0, 1.0)
    return dataclasses.replace(record, torque=record.torque * sign, current=None)


def milliseconds(record, random):
    return dataclasses.replace(record, t=1e3 * record.t)


SPOILED = (
    lost_packets,
    stuck,
    glitches,
    turn,
    late_stamps,
    other_rounding,
    late,
    turned_torque,
    milliseconds,
)

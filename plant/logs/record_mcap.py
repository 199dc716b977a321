"""A record as an MCAP file, for tools that draw signals."""

from pathlib import Path
from typing import Any

import numpy as np

from plant.logs.record_csv import COLUMNS
from plant.parts.mcap_file import McapFile, joint_topics


def write(record: Any, path: str | Path) -> None:
    """Write a record: its columns, and both motions in rad."""
    names = [name for name in (*(each[0] for each in COLUMNS), "valid") if getattr(record, name) is not None]
    columns = [getattr(record, name).reshape(len(record), -1) for name in names]
    topics = joint_topics(record.n, dict(zip(names, (each.shape[1] for each in columns), strict=True)))
    q, q_r = record.rig.cell_centre(record.counts), record.rig.to_angle(record.reference_pulses)
    torque = np.zeros((len(record), 0)) if record.torque is None else record.torque
    with McapFile(path, record.rig.drive.joints, record.n, topics) as file:
        for k, time in enumerate(np.rint(1e9 * (record.t - record.t[0])).astype(int).tolist()):
            file.append("/joint_states", time, (q[k], (), torque[k]))
            file.append("/reference", time, (q_r[k], (), ()))
            file.append("/sample", time, [each[k] for each in columns])

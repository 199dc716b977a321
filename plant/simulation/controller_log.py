"""The inputs of a controller in an experiment, as a file that its exported C replays."""

from pathlib import Path

import numpy as np

from plant.logs.record import Record
from plant.simulation.followed_path import path_of


def write_replay(record: Record, path: str | Path) -> None:
    """Write the inputs of a controller in an experiment, as ``main.c`` replays them.

    Parameters
    ----------
    record : Record
        With one sample per step of the law.
    path : str or Path
        CSV file of encoder counts and q_r, qd_r, qdd_r of all joints, one row per sample.

    Raises
    ------
    ValueError
        Counts that are not whole.

    See Also
    --------
    plant.Law, plant.Record

    Examples
    --------
    >>> from pathlib import Path
    >>> from plant import puma560, simulate, write_replay
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.2)
    >>> write_replay(record, "record.csv")
    >>> Path("record.csv").read_text()[:17]
    'pulses_1,pulses_2'
    """
    followed, law = path_of(record), record.law
    motion = followed(record.t)[0] if law is None else followed.setpoint(record.t, law)
    pulses = record.reference_pulses - record.error_pulses
    if (pulses != np.trunc(pulses)).any():
        raise ValueError("pulses of the record must be whole; got fractions. Simulate with an encoder that counts.")
    columns = (("pulses", ""), ("q_r", " [rad]"), ("qd_r", " [rad/s]"), ("qdd_r", " [rad/s^2]"))
    names = [f"{name}_{i + 1}{unit}" for name, unit in columns for i in range(record.n)]
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for counts, row in zip(pulses, np.hstack(motion), strict=True):
            file.write(",".join([*(f"{count:.0f}" for count in counts), *(f"{x:.17g}" for x in row)]) + "\n")

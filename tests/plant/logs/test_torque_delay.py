"""Torque columns that a drive exports a row late, and per mille of its rated torque."""

import dataclasses

import numpy as np
import pytest

from plant import Record, puma560, read_records, read_robot, simulate, write_robot

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
RATED = np.array([1.3, 1.1])  # of the motors [N m]
COLUMNS = {"t": "t", "counts": ["c1", "c2"], "torque": ["m1", "m2"]}
UNITS = {"t": "s", "torque": {"per mille of motor N m": RATED}}


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.3)


@pytest.fixture
def file(record, tmp_path):
    """A CSV of an EtherCAT master: 0x6077 two cycles late."""
    torque = 1e3 * RIG.drive.motor_torque(record.torque) / RATED
    late = np.vstack([torque[:1], torque[:1], torque[:-2]])
    rows = np.column_stack([record.t, record.counts, late])
    path = tmp_path / "drive.csv"
    np.savetxt(path, rows, delimiter=",", header="t,c1,c2,m1,m2", comments="")
    return path


def test_late_torques_come_to_the_counts_they_acted_on(record, file):
    options = {"rig": RIG, "columns": COLUMNS, "units": UNITS}
    late = Record.from_csv(file, **options)
    in_time = Record.from_csv(file, **options, torque_delay=2)
    assert np.abs(late.torque[:-2] - record.torque[:-2]).max() > 1
    np.testing.assert_allclose(in_time.torque[:-2], record.torque[:-2], rtol=1e-9, atol=1e-9)
    # The last rows have no torque any more, and no weight; the counts stay.
    np.testing.assert_array_equal(in_time.valid, np.arange(len(record)) < len(record) - 2)
    np.testing.assert_array_equal(in_time.counts[:-2], record.counts[:-2])
    (read,) = read_records(file, **options, torque_delay=2)
    np.testing.assert_array_equal(read.torque, in_time.torque)


def test_late_torques_of_whole_numbers_are_those_of_floats(record):
    torque = np.round(record.torque).astype(int)
    options = {"rig": RIG, "columns": {"counts": "c", "torque": "m"}, "units": {"torque": "N m"}}
    as_whole, as_float = (
        Record.from_table({"c": record.counts, "m": column}, **options, torque_delay=2)
        for column in (torque, torque.astype(float))
    )
    assert as_whole == as_float
    np.testing.assert_array_equal(as_whole.valid, np.arange(len(record)) < len(record) - 2)


def test_a_torque_keeps_the_weight_of_the_row_where_it_stood(record):
    """The row without weight, 5, has the torque of row 3."""
    weight = np.ones(len(record))
    weight[5] = 0.0
    table = {"c": record.counts, "m": record.torque, "w": weight}
    columns = {"counts": "c", "torque": "m", "valid": "w"}
    options = {"rig": RIG, "columns": columns, "units": {"torque": "N m"}}
    found = Record.from_table(table, **options, torque_delay=2)
    assert np.flatnonzero(found.valid[:-2] == 0).tolist() == [3, 5]
    assert (found.valid[-2:] == 0).all()


def test_a_robot_file_states_the_delay(tmp_path):
    robot = dataclasses.replace(
        read_robot("paper_puma560"), columns=COLUMNS, units={"t": "s"}, torque_delay=1
    )
    robot = dataclasses.replace(robot, units={"t": "s", "torque": "N m"})
    path = tmp_path / "robot.toml"
    write_robot(robot, path)
    assert "[log]\ntorque_delay = 1" in path.read_text()
    assert read_robot(path).torque_delay == 1
    path.write_text(path.read_text().replace("torque_delay", "torque_late"))
    with pytest.raises(ValueError, match="torque_delay"):
        read_robot(path)


@pytest.mark.parametrize("delay", [-1, 0.5])
def test_a_delay_is_of_whole_rows(file, delay):
    with pytest.raises(ValueError, match="torque_delay"):
        Record.from_csv(file, rig=RIG, columns=COLUMNS, units=UNITS, torque_delay=delay)


def test_a_delay_needs_a_torque(file):
    columns = {"t": "t", "counts": ["c1", "c2"]}
    with pytest.raises(ValueError, match="torque_delay"):
        Record.from_csv(file, rig=RIG, columns=columns, units={"t": "s"}, torque_delay=1)

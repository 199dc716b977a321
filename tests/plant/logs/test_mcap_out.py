"""Records and running controllers as MCAP: read back by the format's own reader, and by two readers
of CDR.

Kills at random times, and what a sample costs, are in tests/benchmarks/out_to_the_machine.py.
"""

import contextlib
import dataclasses
import io
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from ctc import ComputedTorque, evaluate
from plant import Guards, Record, SteppedArm, puma560, simulate

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk, Message, MessageIndex
from mcap_ros2.decoder import DecoderFactory

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW = ComputedTorque(ARM, RIG)
SCRIPT = Path(__file__).parents[2] / "oracles" / "logged_run.py"
COLUMNS = {"t": "/sample.log_time"} | {
    name: f"/sample.{name}" for name in ("error_pulses", "reference_pulses", "torque")
}
UNITS = {"t": "ns", "torque": "N m"}


def indexed(file, chunk):
    """Messages that the index of a chunk points at, where other readers than this format's in
    Python look for them.
    """
    file.seek(chunk.chunk_start_offset + 9)
    data, count = Chunk.read(ReadDataStream(file)).data, 0
    for channel, offset in chunk.message_index_offsets.items():
        file.seek(offset + 9)
        for when, place in MessageIndex.read(ReadDataStream(file)).records:
            message = Message.read(
                ReadDataStream(io.BytesIO(data[place + 9 :])),
                int.from_bytes(data[place + 1 : place + 9], "little"),
            )
            assert (message.channel_id, message.log_time) == (channel, when)
            count += 1
    return count


def messages(path):
    """Topic -> its messages, with their times [ns], through the index, each chunk held against
    its checksum.
    """
    found = {}
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
        assert (
            sum(indexed(file, chunk) for chunk in summary.chunk_indexes)
            == summary.statistics.message_count
        )
    assert summary.statistics.message_count == sum(map(len, found.values()))
    return found


def array(rows, field):
    return np.array([getattr(message, field) for _, message in rows])


def test_a_record_comes_back_in_all_its_columns(tmp_path):
    record = simulate(ARM, RIG, LAW, PATH, duration=0.2)
    record = dataclasses.replace(record, t=record.t + 5, valid=np.arange(len(record)) % 2)
    record.to_mcap(tmp_path / "a.mcap")
    found = messages(tmp_path / "a.mcap")
    for name in ("reference_pulses", "error_pulses", "torque", "current", "true_q", "true_qd"):
        np.testing.assert_array_equal(array(found["/sample"], name), getattr(record, name))
    np.testing.assert_array_equal(array(found["/sample"], "valid").ravel(), record.valid)
    np.testing.assert_array_equal(
        array(found["/joint_states"], "position"), RIG.cell_centre(record.counts)
    )
    np.testing.assert_array_equal(array(found["/joint_states"], "effort"), record.torque)
    np.testing.assert_array_equal(
        array(found["/reference"], "position"), RIG.to_angle(record.reference_pulses)
    )
    times = [when for when, _ in found["/sample"]]
    np.testing.assert_allclose(times, 1e9 * (record.t - 5), rtol=0, atol=1)
    assert [
        m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for _, m in found["/sample"]
    ] == times


def test_another_file_is_not_written_over(tmp_path):
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.01
    )
    for _ in range(2):
        record.to_mcap(tmp_path / "mine.mcap")
    (tmp_path / "mine.txt").write_text("mine")
    for name, says in (
        ("mine.txt", "must not exist, or be an MCAP file"),
        ("none/a.mcap", "in a folder that exists"),
        ("", "must not exist"),
    ):
        with pytest.raises(ValueError, match=says):
            record.to_mcap(tmp_path / name)
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_an_evaluation_is_read_again_as_a_record(tmp_path):
    record = evaluate(ARM, RIG, LAW, PATH, duration=0.2).record
    record.to_mcap(tmp_path / "a.mcap")
    again = Record.read(tmp_path / "a.mcap", rig=RIG, columns=COLUMNS, units=UNITS)
    for name in ("error_pulses", "reference_pulses", "torque"):
        np.testing.assert_array_equal(getattr(again, name), getattr(record, name))
    np.testing.assert_allclose(again.t, record.t, rtol=0, atol=1e-9)


def test_another_reader_of_cdr_reads_names_of_any_length_and_arrays_without_numbers(tmp_path):
    rosbags = pytest.importorskip("rosbags.typesys")
    record = simulate(ARM, RIG, LAW, PATH, duration=0.05)
    names = ("Gelenk für die Schulter", "b")
    record = dataclasses.replace(
        record, rig=dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, joints=names))
    )
    bare = dataclasses.replace(record, torque=None, current=None)
    types = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    for each in (record, bare):
        each.to_mcap(tmp_path / "a.mcap")
        with open(tmp_path / "a.mcap", "rb") as file:
            kept = [
                (c.topic, s.name, m.data)
                for s, c, m in make_reader(file).iter_messages()
                if "Joint" in s.name
            ]
        read = [(topic, types.deserialize_cdr(data, kind)) for topic, kind, data in kept]
        assert all(tuple(message.name) == names for _, message in read)
        torques = [message.effort for topic, message in read if topic == "/joint_states"]
        np.testing.assert_array_equal(
            torques, np.zeros((len(each), 0)) if each.torque is None else each.torque
        )


def test_a_controller_logs_its_samples_and_its_status(tmp_path):
    start = PATH([0.0])
    robot = SteppedArm(ARM, RIG, start.q[0], start.qd[0])
    counts = RIG.counts(start.q[0])
    controller, given, torques = LAW.start(RIG, counts), [], []
    with controller.log_to(tmp_path / "run.mcap"):
        for k in range(400):
            motion = PATH([k * RIG.period])
            # a reference that leaps: a safe stop
            q_r = motion.q[0] if k != 300 else motion.q[0] + 1.0
            given.append(counts)
            torques.append(
                controller.step(counts, q_r, motion.qd[0], motion.qdd[0], now=100 + k * RIG.period)
            )
            counts = robot.step(torques[-1])
    # no longer logged
    controller.step(counts, motion.q[0], motion.qd[0], motion.qdd[0], now=100 + 400 * RIG.period)
    found = messages(tmp_path / "run.mcap")
    sample = found["/sample"]
    np.testing.assert_array_equal(array(sample, "torque"), torques)
    np.testing.assert_array_equal(
        array(sample, "reference_pulses") - array(sample, "error_pulses"), given
    )
    # of 1e18
    np.testing.assert_allclose(
        np.diff([when for when, _ in sample]), 1e9 * RIG.period, rtol=0, atol=300
    )
    assert abs(sample[0][0] - time.time_ns()) < 600e9
    said = [message.data for _, message in found["/status"]]
    assert said[0] == "running"
    assert said[-1] == controller.status
    assert "safe stop" in said[-1]
    assert found["/status"][1][0] == sample[300][0]
    with pytest.raises(ValueError, match=r"must be a new file; .*run\.mcap is there"):
        controller.log_to(tmp_path / "run.mcap")


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300, -5.0])
@pytest.mark.parametrize("guards", [Guards(), None])
def test_a_clock_that_fails_stops_no_log(tmp_path, wrong, guards):
    """What the controller bridges, or takes as it comes, the log does too; what it refuses, it
    does not log.
    """
    counts, zero = RIG.counts(PATH([0.0]).q[0]), np.zeros(2)
    controller, taken = LAW.start(RIG, counts, guards=guards), 0
    with controller.log_to(tmp_path / "run.mcap"):
        for k in range(6):
            now = wrong if k == 3 else k * RIG.period
            # of a clock that does not advance, without guards
            with contextlib.suppress(ValueError):
                controller.step(counts, PATH([0.0]).q[0], zero, zero, now=now)
                taken += 1
    times = [when for when, _ in messages(tmp_path / "run.mcap")["/sample"]]
    assert len(times) == taken > 2
    assert (np.diff(times) >= 0).all()
    assert times[-1] - times[0] < 60e9


def started(*arguments):
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, SCRIPT, *map(str, arguments)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "running\n"
    return process


@pytest.mark.skipif(os.name != "posix", reason="kills and limits are those of POSIX")
def test_a_killed_controller_leaves_a_file_with_an_index(tmp_path):
    path = tmp_path / "run.mcap"
    with started(path) as process:
        while path.stat().st_size < 500_000:
            time.sleep(0.01)
        time.sleep(0.01)  # past the write that was seen
        process.kill()
    kept = messages(path)
    record = Record.read(path, rig=RIG, columns=COLUMNS, units=UNITS)
    assert len(record) == len(kept["/sample"]) > 500
    assert np.abs(record.error_pulses).max() <= 1


@pytest.mark.skipif(os.name != "posix", reason="kills and limits are those of POSIX")
def test_a_disk_that_is_full_leaves_what_it_could_hold(tmp_path):
    path = tmp_path / "run.mcap"
    with started(path, 300_000) as process:
        warning = process.stdout.read()
    assert "run.mcap ends here, since it cannot be written: " in warning
    assert 200_000 < path.stat().st_size <= 300_000
    assert len(messages(path)["/sample"]) > 300

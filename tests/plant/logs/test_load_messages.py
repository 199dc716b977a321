"""MCAP, bags of ROS 2 and LeRobot data sets: what their own libraries wrote is read; what is
spoilt is one refusal.
"""

import json
import shutil
from pathlib import Path

import message_files as files
import numpy as np
import pytest
from mcap.writer import Writer as PlainWriter
from message_files import COLUMNS, COMMANDS, FORMATS, JOINTS, START, UNITS, log, read, spoilt, write
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore
from spoilt_files import RIG, WarmChildren

from plant import LoadError, Record, read_records, read_table
from plant.logs import isolation

MUTATIONS = 20
LEROBOT = Path(files.__file__).with_name("lerobot")
SUFFIX = {"mcap": ".mcap"}


@pytest.fixture(scope="module")
def server():
    with WarmChildren() as children:
        isolation.run = children.cold
        yield children


@pytest.fixture
def children(server, monkeypatch):
    monkeypatch.setattr(isolation, "run", server)


@pytest.mark.parametrize("compress", [True, False])
@pytest.mark.parametrize("kind", FORMATS)
def test_every_format_gives_back_what_was_written(tmp_path, children, kind, compress):
    """By the joints' names, in whatever order; the command that held at each sample; every
    nanosecond of the stamps.
    """
    columns, path = log(), tmp_path / f"log{SUFFIX.get(kind, '')}"
    write(kind, path, columns, compress)
    record = read(kind, path)
    np.testing.assert_array_equal(record.counts, columns["counts"])
    np.testing.assert_array_equal(record.reference_pulses[1:], columns["commands"][1:])
    assert record.name.startswith(str(path))
    if kind == "lerobot":
        # float32, as the format has it
        np.testing.assert_allclose(record.t, columns["ns"] / 1e9, rtol=1e-7)
        return
    np.testing.assert_array_equal(record.t, columns["ns"] / 1e9)
    np.testing.assert_array_equal(record.torque, columns["torque"])
    # nothing was commanded before the first sample
    np.testing.assert_array_equal(record.valid, np.arange(120) > 0)


@pytest.mark.parametrize(("folder", "version"), [("v21", "v2.1"), ("v30", "v3.0")])
def test_data_sets_that_lerobot_itself_wrote(children, folder, version):
    """By `tests/oracles/lerobot/make.py`, whose formula they repeat to the last bit."""
    assert (
        json.loads((LEROBOT / folder / "meta" / "info.json").read_text())["codebase_version"]
        == version
    )
    t = {0: np.arange(30) / 500, 1: np.arange(40) / 500}
    for episode in t:
        table = read_table(LEROBOT / folder, episode=episode)
        q = np.column_stack(
            [0.8 * np.sin(2 * t[episode] + episode), 0.5 * np.cos(3 * t[episode])]
        ).astype(np.float32)
        np.testing.assert_array_equal(table["observation.state"], q)
        np.testing.assert_array_equal(table["action"], q + np.float32(0.001))
        np.testing.assert_array_equal(table["timestamp"], t[episode].astype(np.float32))
        one = read_table(
            LEROBOT / folder, episode=episode, names=["action.elbow.pos", "observation.state[0]"]
        )
        np.testing.assert_array_equal(one["action.elbow.pos"], table["action"][:, 1])
        np.testing.assert_array_equal(one["observation.state[0]"], q[:, 0])
    with pytest.raises(LoadError, match="must hold episode 2; it has 0 to 1"):
        read_table(LEROBOT / folder, episode=2)


@pytest.mark.filterwarnings("ignore")
def test_a_data_set_is_one_record_per_episode_and_a_pattern_one_per_file(tmp_path, children):
    columns = {"t": "timestamp", "position": "observation.state", "reference_position": "action"}
    options = {
        "rig": RIG,
        "columns": columns,
        "units": {"t": "s", "position": "rad", "reference_position": "rad"},
    }
    records = read_records(LEROBOT / "v30", **options)
    assert [len(record) for record in records] == [30, 40]
    assert [record.name.rpartition(", ")[2] for record in records] == ["episode 0", "episode 1"]
    assert [
        len(record)
        for record in read_records([LEROBOT / "v30", LEROBOT / "v21"], **options, episodes=[1])
    ] == [
        40,
        40,
    ]
    for k in range(3):
        write("mcap", tmp_path / f"run_{k}.mcap", log(100 + 10 * k))
    records = read_records(tmp_path / "run_*.mcap", rig=RIG, columns=COLUMNS, units=UNITS)
    assert [len(record) for record in records] == [100, 110, 120]
    (tmp_path / "run_1.mcap").write_bytes(b"")
    with pytest.raises(LoadError, match=r"run_1\.mcap "):
        read_records(tmp_path / "run_*.mcap", rig=RIG, columns=COLUMNS, units=UNITS)
    with pytest.raises(LoadError, match="must match a file; it matches none"):
        read_records(tmp_path / "*.csv", rig=RIG, columns=COLUMNS, units=UNITS)
    own = records[0]
    own.to_csv(tmp_path / "own.csv")
    assert read_records(tmp_path / "own.csv") == (own,)


def test_all_topics_as_a_table(tmp_path, children):
    write("mcap", tmp_path / "log.mcap", log())
    table = read_table(tmp_path / "log.mcap")
    assert table[f"{JOINTS}.stamp"][0] == START
    assert table[f"{JOINTS}.position"].shape == (240, 3)  # of shoulder, elbow and finger
    assert np.isnan(table[f"{JOINTS}.position"]).sum() == 120 * 3
    assert table[f"{COMMANDS}.data"].shape == (119, 2)
    assert set(read_table(tmp_path / "log.mcap", prefix=f"{COMMANDS}.")) == {
        "log_time",
        "layout.data_offset",
        "data",
    }


def test_json_in_mcap_is_read_and_other_encodings_are_named(tmp_path, children):
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = PlainWriter(file)
        writer.start()
        schema = writer.register_schema("drive", "jsonschema", b"{}")
        channels = [
            writer.register_channel(topic, kind, schema)
            for topic, kind in (("/a", "json"), ("/b", "protobuf"))
        ]
        for k in range(5):
            message = json.dumps(
                {"counts": [k, -k], "axis": {"names": ["x", "y"], "current": [0.5, k]}}
            ).encode()
            for channel in channels:
                writer.add_message(channel, 1000 * k, message, 1000 * k)
        writer.finish()
    table = read_table(tmp_path / "a.mcap", names=["/a.counts", "/a.axis.current.y", "/a.log_time"])
    np.testing.assert_array_equal(table["/a.counts"], [[k, -k] for k in range(5)])
    np.testing.assert_array_equal(table["/a.axis.current.y"], range(5))
    np.testing.assert_array_equal(table["/a.log_time"], 1000 * np.arange(5))
    with pytest.raises(LoadError, match=r"'/b' is protobuf with jsonschema. Convert it"):
        read_table(tmp_path / "a.mcap", names=["/b.counts"])
    with pytest.raises(
        LoadError,
        match=r"column '/a.axis.current.z' must be there; .* Did you mean '/a.axis.current",
    ):
        read_table(tmp_path / "a.mcap", names=["/a.axis.current.z"])


def test_arrays_of_messages_are_columns_by_joint_and_interface(tmp_path, children):
    """By the names beside them, by their own names, or by their index; joints in any order."""
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = PlainWriter(file)
        writer.start()
        schema = writer.register_schema("states", "jsonschema", b"{}")
        channel = writer.register_channel("/states", "json", schema)
        for k in range(7):
            joints = {
                "wrist": {"interface_names": ["position", "amps"], "values": [k, 0.5 * k]},
                "waist": {"interface_names": ["amps", "position", "heat"], "values": [-k, 9, 21]},
            }
            names = list(joints)[:: (-1) ** k]
            message = {
                "joint_names": names,
                "interface_values": [joints[name] for name in names],
                "motors": [{"id": name, "q": ord(name[1]) + k, "raw": [1, k]} for name in names],
                "cells": [{"volt": 3.7, "amp": i * k} for i in range(3)],
            }
            writer.add_message(channel, k, json.dumps(message).encode(), k)
        writer.finish()
    k = np.arange(7)
    for name, values in {
        "interface_values.wrist.amps": 0.5 * k,
        "interface_values.waist.amps": -k,
        "wrist.position": k,
        "waist.heat": np.full(7, 21),
        "motors.wrist.q": ord("r") + k,
        "motors.waist.raw[1]": k,
        "motors.waist.raw.1": k,
        "cells[2].amp": 2 * k,
        "cells.2.amp": 2 * k,
    }.items():
        column = read_table(tmp_path / "a.mcap", names=[f"/states.{name}"])[f"/states.{name}"]
        np.testing.assert_array_equal(column, values)
    assert "/states.interface_values.waist.heat" in read_table(tmp_path / "a.mcap")
    # Two arrays have a column of this short name, so it means neither.
    with pytest.raises(LoadError, match=r"column '/states.wrist.heat' must be there"):
        read_table(tmp_path / "a.mcap", names=["/states.wrist.heat"])


def test_a_bag_of_ros_1_is_read_by_the_names_of_its_joints(tmp_path, children):
    """The last bit of positions that another library wrote, and every nanosecond."""
    types = get_typestore(Stores.ROS1_NOETIC)
    state, header, time = (
        types.types[f"{package}/msg/{name}"]
        for package, name in (
            ("sensor_msgs", "JointState"),
            ("std_msgs", "Header"),
            ("builtin_interfaces", "Time"),
        )
    )
    columns = log(40)
    q = RIG.to_angle(columns["counts"])
    with Ros1Writer(tmp_path / "run.bag") as bag:
        connection = bag.add_connection("/js", state.__msgtype__, typestore=types)
        for k, ns in enumerate(columns["ns"]):
            seconds, nanoseconds = divmod(int(ns) + START, 10**9)
            message = state(
                header=header(k, time(seconds, nanoseconds), ""),
                name=["elbow", "shoulder"],
                position=q[k, ::-1].copy(),
                velocity=np.zeros(2),
                effort=np.zeros(0),
            )
            bag.write(connection, int(ns), types.serialize_ros1(message, state.__msgtype__))
    record = Record.read(
        tmp_path / "run.bag",
        rig=RIG,
        columns={"t": "/js.stamp", "position": ["/js.position.shoulder", "/js.position.elbow"]},
        units={"t": "ns", "position": "rad"},
    )
    np.testing.assert_array_equal(record.counts, columns["counts"])
    np.testing.assert_array_equal(record.t, columns["ns"] / 1e9)


def test_two_publishers_of_one_topic_are_not_mixed(tmp_path, children):
    write("mcap", tmp_path / "log.mcap", log())
    names = [f"{JOINTS}.position.shoulder", f"{JOINTS}.position.finger"]
    with pytest.raises(LoadError, match="must hold what is mapped in one message"):
        Record.read(tmp_path / "log.mcap", rig=RIG, columns={"counts": names})


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", FORMATS)
def test_spoilt_files(tmp_path, children, kind):
    path, rng = tmp_path / f"log{SUFFIX.get(kind, '')}", np.random.default_rng(7)
    read_some, sound = 0, {}
    for i in range(MUTATIONS):
        if i in (0, MUTATIONS // 2):
            write(kind, path, log(30), compress=i == 0)
            sound = files.contents(path)
        spoilt(path, sound, rng)
        said = None
        try:
            record = read(kind, path)
        except LoadError as error:
            said = str(error)
        if said is None:
            assert np.isfinite(record.error_pulses).all()
            read_some += 1
        else:
            assert "\n" not in said
            assert len(said) < 600
            assert str(path) in said
    assert read_some < MUTATIONS


@pytest.mark.parametrize("kind", ["mcap", "rosbag2"])
def test_spoilt_files_in_children_of_their_own(tmp_path, kind):
    """As users read them: nothing imported before, nothing forked."""
    path = tmp_path / f"log{SUFFIX.get(kind, '')}"
    write(kind, path, log(30))
    assert len(read(kind, path)) == 30
    spoilt(path, files.contents(path), np.random.default_rng(3))
    with pytest.raises(LoadError):
        read(kind, path)


@pytest.mark.parametrize(
    ("kind", "library"), [("mcap", "mcap"), ("rosbag2", "rosbags"), ("lerobot", "pyarrow")]
)
def test_a_missing_extra_says_what_to_install(tmp_path, monkeypatch, kind, library):
    monkeypatch.setattr(isolation, "find_spec", lambda name: None)
    write(kind, tmp_path / "log", log(30))
    with pytest.raises(LoadError, match=rf"needs {library} .*pip install 'onepulse\[{kind}\]'"):
        read(kind, tmp_path / "log")


def test_what_is_no_bag_and_no_data_set_says_what_it_lacks(tmp_path, children):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "folder.db3").mkdir()
    for name, message in (
        ("folder.db3", "must be a bag of ROS 2; the folder has no metadata.yaml"),
        ("folder.mcap", "must be a file; got a folder"),
        ("folder", r"must end in one of .* or be a folder with metadata.yaml or meta/info.json"),
    ):
        with pytest.raises(LoadError, match=message):
            Record.read(tmp_path / name, rig=RIG, columns=COLUMNS, units=UNITS)
    with pytest.raises(
        LoadError,
        match=r"must end in one of .* or be a folder with metadata.yaml or meta/info.json",
    ):
        read_table(tmp_path / "folder")
    (tmp_path / "text.mcap").write_text("time,c1\n")
    with pytest.raises(LoadError, match="must be an MCAP file; its first bytes are not"):
        read_table(tmp_path / "text.mcap")
    write("mcap", tmp_path / "cut.mcap", log(30))
    (tmp_path / "cut.mcap").write_bytes((tmp_path / "cut.mcap").read_bytes()[:-40])
    with pytest.raises(LoadError, match=r"must be complete; .* Run mcap recover on it"):
        read_table(tmp_path / "cut.mcap")
    with pytest.raises(
        LoadError, match=r"has no episodes, as a LeRobot data set does; got episode=1"
    ):
        read_table(tmp_path / "cut.mcap", episode=1)


@pytest.mark.parametrize(
    "pattern", ["../{episode_index}.parquet", "/etc/passwd", "{episode_index.real.x}", "{nobody}"]
)
def test_data_outside_of_a_data_set_is_not_read(tmp_path, children, pattern):
    shutil.copytree(LEROBOT / "v21", tmp_path / "set")
    shutil.copy(next((tmp_path / "set").rglob("*.parquet")), tmp_path / "0.parquet")
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    (tmp_path / "set" / "meta" / "info.json").write_text(json.dumps(info | {"data_path": pattern}))
    with pytest.raises(
        LoadError, match=r"must have (its data inside of its folder|a data_path that names files)"
    ):
        read_table(tmp_path / "set")

"""One log of the paper's arm as messages and as a data set, written by the formats' own libraries,
and how to spoil it.

`JOINTS` publishes states of the arm, with its joints in another order from the middle on, and in
between those of a finger; `COMMANDS` has no header and its own times.
"""

import json
import shutil
import sqlite3
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from mcap.writer import CompressionType
from mcap_ros2.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore
from spoilt_files import RIG, spoil

from plant import Record

FORMATS = ("mcap", "rosbag2", "bag_of_mcap", "lerobot")
JOINTS, COMMANDS, CHATTER = "/joint_states", "/forward_command_controller/commands", "/chatter"
START = 1_790_000_000_123_456_789  # of the stamps [ns]; a float holds no single nanosecond there
COLUMNS = {
    "t": f"{JOINTS}.stamp",
    "counts": [f"{JOINTS}.position.shoulder", f"{JOINTS}.position.elbow"],
    "torque": [f"{JOINTS}.effort.shoulder", f"{JOINTS}.effort.elbow"],
    "reference_pulses": [f"{COMMANDS}.data[0]", f"{COMMANDS}.data[1]"],
}
UNITS = {"t": "ns", "torque": "N m"}
OF_DATA_SET = {
    "t": "timestamp", "counts": ["observation.state.shoulder.pos", "observation.state.elbow.pos"],
    "reference_pulses": "action",
}  # fmt: skip

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_TYPES = {JOINTS: "sensor_msgs/msg/JointState", COMMANDS: "std_msgs/msg/Float64MultiArray",
          CHATTER: "std_msgs/msg/String"}  # fmt: skip


def log(N=120, seed=0):
    """What the files hold: times [ns] from `START`, counts, torques, and commanded counts, one
    row per sample.
    """
    rng = np.random.default_rng(seed)
    ns = np.round(1e9 * RIG.period * np.arange(N)).astype(np.int64) + rng.integers(0, 9999, N)
    counts = np.cumsum(rng.integers(-3, 4, (N, 2)), axis=0)
    return {"ns": ns - ns[0], "counts": counts, "torque": rng.normal(size=(N, 2)),
            "commands": np.cumsum(rng.integers(-3, 4, (N, 2)), axis=0)}  # fmt: skip


def messages(columns):
    """Topic, time of recording [ns] and fields of each message, in order of recording."""
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "base"}
    found = []
    for k, ns in enumerate((START + columns["ns"]).tolist()):
        order = [0, 1] if k < len(columns["ns"]) // 2 else [1, 0]
        stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
        state = {
            "header": header | {"stamp": stamp},
            "name": [("shoulder", "elbow")[i] for i in order],
            "velocity": [],
            "position": columns["counts"][k][order].astype(float).tolist(),
            "effort": columns["torque"][k][order].tolist(),
        }
        found.append((JOINTS, ns + 50_000, state))
        finger = {"name": ["finger"], "position": [0.1 * k], "effort": [], "velocity": [1.0]}
        found.append((JOINTS, ns + 60_000, {"header": header | {"stamp": stamp}, **finger}))
        if k:  # commanded a little before the sample, so that it is what the sample sees
            layout = {"dim": [], "data_offset": 0}
            found.append(
                (
                    COMMANDS,
                    ns - 20_000,
                    {"layout": layout, "data": columns["commands"][k].astype(float).tolist()},
                )
            )
        found.append((CHATTER, ns + 70_000, {"data": f"sample {k}"}))
    return sorted(found, key=lambda message: message[1])


def write(kind, path, columns, compress=True):
    """Write the log; `path` is a file for MCAP and a folder for the others."""
    if path.is_dir():
        shutil.rmtree(path)
    if kind == "mcap":
        compression = CompressionType.ZSTD if compress else CompressionType.NONE
        with (
            open(path, "wb") as file,
            McapWriter(file, chunk_size=4096, compression=compression) as writer,
        ):
            schemas = {
                topic: writer.register_msgdef(name, _STORE.generate_msgdef(name, ros_version=2)[0])
                for topic, name in _TYPES.items()
            }
            for topic, ns, fields in messages(columns):
                writer.write_message(topic, schemas[topic], fields, log_time=ns)
    elif kind in ("rosbag2", "bag_of_mcap"):
        plugin = StoragePlugin.SQLITE3 if kind == "rosbag2" else StoragePlugin.MCAP
        writer = BagWriter(path, version=9, storage_plugin=plugin)
        if compress and kind == "rosbag2":
            writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
        with writer:
            topics = {
                topic: writer.add_connection(topic, name, typestore=_STORE)
                for topic, name in _TYPES.items()
            }
            for topic, ns, fields in messages(columns):
                writer.write(
                    topics[topic],
                    ns,
                    _STORE.serialize_cdr(_typed(_TYPES[topic], fields), _TYPES[topic]),
                )
    else:
        _data_set(path, columns, compress)


def _typed(name, fields):
    """A message of rosbags."""
    kind = _STORE.types[name]
    fields = dict(fields)
    if "header" in fields:
        stamp = _STORE.types["builtin_interfaces/msg/Time"](**fields["header"]["stamp"])
        fields["header"] = _STORE.types["std_msgs/msg/Header"](
            stamp=stamp, frame_id=fields["header"]["frame_id"]
        )
    if "layout" in fields:
        fields["layout"] = _STORE.types["std_msgs/msg/MultiArrayLayout"](**fields["layout"])
    numbers = {
        key: np.array(value, float)
        for key, value in fields.items()
        if key in ("position", "velocity", "effort")
    }
    if name.endswith("Array"):
        numbers["data"] = np.array(fields["data"], float)
    return kind(**fields | numbers)


def _data_set(path, columns, compress):
    """As LeRobot lays it out in version 2.1, with the schema of its files; two episodes of the
    same log.
    """
    (path / "meta").mkdir(parents=True)
    names = ["shoulder.pos", "elbow.pos"]
    pair = {"dtype": "float32", "shape": [2], "names": names}
    features = {"observation.state": pair, "action": pair}
    features |= {
        name: {"dtype": "int64", "shape": [1], "names": None}
        for name in ("frame_index", "episode_index")
    }
    features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    info = {
        "codebase_version": "v2.1",
        "total_episodes": 2,
        "chunks_size": 1000,
        "fps": 1429,
        "features": features,
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    }
    (path / "meta" / "info.json").write_text(json.dumps(info, indent=4))
    (path / "data" / "chunk-000").mkdir(parents=True)
    for episode in range(2):
        N = len(columns["ns"]) - episode

        def pairs(values):
            return pa.array(values.astype(np.float32).tolist(), pa.list_(pa.float32(), 2))

        table = {
            "observation.state": pairs(columns["counts"][:N]),
            "action": pairs(columns["commands"][:N]),
            "timestamp": (columns["ns"][:N] / 1e9).astype(np.float32),
            "frame_index": np.arange(N),
            "episode_index": np.full(N, episode),
        }
        place = path / "data" / "chunk-000" / f"episode_{episode:06d}.parquet"
        pq.write_table(pa.table(table), place, compression="snappy" if compress else "none")


def read(kind, path):
    """The record of what `write` wrote."""
    columns, units = (OF_DATA_SET, {"t": "s"}) if kind == "lerobot" else (COLUMNS, UNITS)
    known = kind if kind in ("mcap", "lerobot") else "rosbag2"
    return Record._read(known, path, None, prefix="", rig=RIG, columns=columns, units=units)


# -- spoiling ------------------------------------------------------------------------------------
def contents(path):
    """Name -> bytes of a file or of all files in a folder."""
    files = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    return {
        str(file.relative_to(path)) if file != path else "": file.read_bytes() for file in files
    }


def restore(path, files):
    """Write what `contents` read."""
    for name, data in files.items():
        (path / name if name else path).write_bytes(data)


def spoilt(path, files, rng):
    """Put spoilt files in place: bytes of one of them, or something that its format understands."""
    restore(path, files)
    name = sorted(files)[int(rng.integers(len(files)))]
    place = path / name if name else path
    aware = {".json": _json, ".yaml": _yaml, ".mcap": _mcap, ".db3": _database, ".parquet": _table}[
        place.suffix
    ]
    if rng.random() < 0.5:
        place.write_bytes(spoil(files[name], rng))
    else:
        aware(place, rng)


ODD = (
    None,
    -1,
    10**30,
    "",
    "x" * 300,
    [],
    {},
    [[1, 2], [3]],
    0.5,
    True,
    "../../etc/passwd",
    "{episode_index.x}",
)


def _json(place, rng):
    """Another value in a random place, or a key that is gone."""
    whole = node = json.loads(place.read_text())
    while True:
        key = (
            sorted(node)[int(rng.integers(len(node)))]
            if isinstance(node, dict)
            else int(rng.integers(len(node)))
        )
        if not isinstance(node[key], (dict, list)) or not node[key] or rng.random() < 0.3:
            break
        node = node[key]
    if rng.random() < 0.3:
        del node[key]
    else:
        node[key] = ODD[int(rng.integers(len(ODD)))]
    place.write_text(json.dumps(whole))


def _yaml(place, rng):
    """Another value in a random line, a line that is gone, or one that comes twice."""
    lines = place.read_text().split("\n")
    at = int(rng.integers(len(lines)))
    head = lines[at].partition(":")[0]
    odd = json.dumps(ODD[int(rng.integers(len(ODD)))])
    lines[at : at + 1] = ([f"{head}: {odd}"], [], [lines[at]] * 2)[int(rng.integers(3))]
    place.write_text("\n".join(lines))


def _mcap(place, rng):
    """A record that is gone, comes twice, changes places with the next, lies about its length,
    or is spoilt inside.
    """
    data = place.read_bytes()
    starts, at = [], 8
    while at < len(data) - 8:
        starts.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    k = int(rng.integers(len(starts)))
    begin, end = starts[k], [*starts, at][k + 1]
    record = data[begin:end]
    length = struct.pack("<Q", int(rng.choice([0, 1, len(record), 1 << 20, 1 << 40, 1 << 63])))
    changed = (
        b"",
        record * 2,
        record[:1] + length + record[9:],
        bytes([int(rng.integers(1, 20))]) + record[1:],
        record[:9] + spoil(record[9:] or b"\0", rng),
    )[int(rng.integers(5))]
    place.write_bytes(data[:begin] + changed + data[end:])


def _database(place, rng):
    """Another blob, time or topic of a message, another definition or name of a topic, or a
    table that is gone.
    """
    with sqlite3.connect(place) as base:
        row = int(rng.integers(1, base.execute("SELECT count(*) FROM messages").fetchone()[0]))
        blob = base.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()[0]
        orders = (
            ("UPDATE messages SET data = ? WHERE id = ?", (spoil(blob, rng), row)),
            (
                "UPDATE messages SET timestamp = ? WHERE id = ?",
                (int(rng.choice([-1, 0, 1 << 62])), row),
            ),
            ("UPDATE messages SET data = ?", (b"",)),
            ("UPDATE messages SET topic_id = ? WHERE id = ?", (int(rng.integers(9)), row)),
            ("UPDATE topics SET type = ?", ("std_msgs/msg/Nothing",)),
            ("UPDATE topics SET name = ?", ("/other",)),
            (
                "UPDATE message_definitions SET encoded_message_definition = ?",
                ("int32[" * int(rng.integers(1, 99)),),
            ),
            ("DROP TABLE topics", ()),
        )
        base.execute(*orders[int(rng.integers(len(orders)))])
    base.close()


def _table(place, rng):
    """Lists of several lengths, missing cells, text, another name, no row, or lists in lists."""
    table = pq.read_table(place)
    at = int(rng.integers(table.num_columns))
    name, N = table.column_names[at], table.num_rows
    columns = (
        pa.array([[1.0] * (k % 4) for k in range(N)]),
        pa.array([None] * N, pa.float64()),
        pa.array(["a"] * N),
        pa.array([None if k % 3 else [1.0, 2.0] for k in range(N)]),
        pa.array([[[1.0]]] * N),
        pa.array([float("inf")] * N),
        pa.array([[None, 1.0]] * N),
    )
    kind = int(rng.integers(len(columns) + 2))
    if kind < len(columns):
        table = table.set_column(at, name, columns[kind])
    else:
        table = (
            table.slice(0, 0)
            if kind == len(columns)
            else table.rename_columns(["x"] * table.num_columns)
        )
    pq.write_table(table, place)

"""Tables as strangers export them, each with one feature and drawn numbers.

    python tests/benchmarks/strangers_tables.py [--seeds 3]

A log of drawn joints, gears, encoders and motions is written as loggers, drives, oscilloscopes,
MATLAB and ROS write it. Each file is read to the last count, or refused with the right word.
"""

import argparse
import contextlib
import io
import json
import re
import sys
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from plant import Drive, Encoder, Record, Rig

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
from spoilt_files import WarmChildren, opaque

# name -> what writes a file and reads it; filled by `variant`.
VARIANTS = {}


@dataclass(frozen=True)
class Log:
    """A log with drawn numbers, and the folder for its file."""

    random: np.random.Generator
    folder: Path
    rig: Rig
    t: np.ndarray
    counts: np.ndarray
    torque: np.ndarray

    @property
    def n(self):
        return self.counts.shape[1]

    @property
    def q(self):
        return self.rig.to_angle(self.counts)

    @property
    def table(self):
        """(N, 1 + 2 n): time, positions [rad], torques [N m]."""
        return np.column_stack([self.t, self.q, self.torque])

    def names(self, *styles):
        """Names of those columns, in a drawn style."""
        style = self.random.choice(
            styles or ("{}_{}", "{}{}", "Joint {} {}", "{}[{}]", "ax{1}.{0}")
        )
        joints = range(1, self.n + 1)
        if style == "Joint {} {}":
            style = "Joint {1} {0}"
        return ["time", *(style.format(w, i) for w in ("pos", "trq") for i in joints)]

    def read(self, path, columns, units=None, torque=True):
        """Whether the file gives the counts and the torques."""
        record = Record.read(path, rig=self.rig, columns=columns, units=units)
        good = np.array_equal(record.counts, self.counts)
        good &= bool(np.allclose(record.t, self.t - self.t[0], atol=1e-9))
        return good and (not torque or bool(np.allclose(record.torque, self.torque, rtol=1e-6)))

    def read_text(self, text, names, *, units=True, encoding="utf-8", suffix="csv"):
        """The same of a text with these names, in radians."""
        path = self.folder / f"run.{suffix}"
        path.write_bytes(text.encode(encoding))
        n = self.n
        columns = {"t": names[0], "position": names[1 : 1 + n], "torque": names[1 + n :]}
        stated = {"t": "s", "position": "rad", "torque": "N m"}
        return self.read(path, columns, stated if units else None)


def drawn(seed, folder):
    random = np.random.default_rng(seed)
    n = int(random.integers(2, 8))
    period = float(random.choice([1e-3, 2e-3, 4e-3, 8e-3]))
    rig = Rig(
        drive=Drive(
            gear=random.choice([-1, 1], n) * np.round(random.uniform(20, 160, n), 1),
            motor_inertia=(1e-4,) * n,
            viscous=(0,) * n,
            coulomb=(0,) * n,
            motor_gain=(0.2,) * n,
            current_limit=(1e4,) * n,
        ),
        encoder=Encoder(resolution=random.choice([1000, 2048, 4096, 8192], n)),
        period=period,
    )
    N = int(random.integers(60, 400))
    t = period * np.arange(N) + random.choice([0.0, 12.5])
    phase = t[:, None] * random.uniform(1, 5, n) + random.uniform(0, 6, n)
    per_radian = np.abs(rig.position_in_pulses(np.eye(n))).max(axis=0)
    counts = np.round(np.sin(phase) * random.uniform(0.4, 1.2, n) * per_radian)
    torque = np.cos(phase) * random.uniform(2, 80, n)
    return Log(random, folder, rig, np.round(t, 9), counts, np.round(torque, 9))


def variant(name):
    def registered(write):
        VARIANTS[name] = write
        return write

    return registered


def rows_of(log, separator=",", mark=".", end="", table=None, digits="%.12g", quote=""):
    """Rows of numbers as text."""
    table = log.table if table is None else table
    lines = (
        separator.join(quote + (digits % x).replace(".", mark) + quote for x in row)
        for row in table
    )
    return "".join(f"{line}{end}\n" for line in lines)


def refused(call, *words):
    """Whether a call is refused in one line that has all of these words."""
    try:
        call()
    except ValueError as error:
        text = str(error)
        missing = [word for word in words if not re.search(word, text)]
        if missing or "\n" in text:
            raise AssertionError(f"lacks {missing}: {text}") from None
        return True
    raise AssertionError("read without a word")


# -- separators, marks, ends ---------------------------------------------------------------------
for _what, _separator in (
    ("blanks", " "), ("several blanks", "   "), ("tabs", "\t"), ("semicolons", ";"), ("bars", "|"),
    ("commas and blanks", ", "),
):  # fmt: skip

    @variant(f"cells between {_what}")
    def _(log, separator=_separator):
        names = log.names("{}_{}", "{}{}", "{}[{}]")
        return log.read_text(separator.join(names) + "\n" + rows_of(log, separator), names)


for _what, _separator in (("blanks", " "), ("tabs", "\t"), ("semicolons", ";"), ("bars", "|")):

    @variant(f"decimal commas between {_what}")
    def _(log, separator=_separator):
        names = log.names("{}_{}", "{}{}")
        return log.read_text(separator.join(names) + "\n" + rows_of(log, separator, ","), names)


for _what, _of_names, _of_rows in (
    ("rows", False, True), ("the heading", True, False), ("all lines", True, True),
):  # fmt: skip

    @variant(f"a separator at the end of {_what}")
    def _(log, of_names=_of_names, of_rows=_of_rows):
        separator = log.random.choice([",", ";", "\t", "|"])
        names = log.names()
        heading = separator.join(names) + separator * of_names
        return log.read_text(
            f"{heading}\n" + rows_of(log, separator, end=separator * of_rows), names
        )


@variant("quoted cells with decimal commas between commas")
def _(log):
    names = log.names()
    heading = ",".join(f'"{name}"' for name in names)
    return log.read_text(f"{heading}\n" + rows_of(log, ",", ",", quote='"'), names)


for _encoding in ("utf-8-sig", "utf-16", "cp1252"):

    @variant(f"units with degree signs in {_encoding}")
    def _(log, encoding=_encoding):
        names = log.names("{}_{}", "Größe {} {}")
        units = ["[ms]", *["[°]"] * log.n, *["[Nm]"] * log.n]
        heading = ";".join(f"{name} {unit}" for name, unit in zip(names, units, strict=True))
        scale = np.repeat([1e3, 180 / np.pi, 1.0], [1, log.n, log.n])
        text = heading + "\n" + rows_of(log, ";", ",", table=log.table * scale)
        return log.read_text(text, names, units=False, encoding=encoding)


@variant("line ends of Windows")
def _(log):
    names = log.names()
    return log.read_text((",".join(names) + "\n" + rows_of(log)).replace("\n", "\r\n"), names)


# -- what stands above the rows ------------------------------------------------------------------
@variant("a preamble of a drive, of any length")
def _(log):
    names = log.names()
    keys = ["Device", "Firmware", "Serial", "Trigger level", "Comment", "Sampling"]
    lines = [
        f"{log.random.choice(keys)};{log.random.choice(['AX5000', 'a b c', '12', '0,25', ''])}\n"
        for _ in range(log.random.integers(1, 400))
    ]
    return log.read_text(
        "".join(lines) + "\n" + ";".join(names) + "\n" + rows_of(log, ";", ","), names
    )


@variant("a preamble of TwinCAT Scope")
def _(log):
    names = log.names()
    start = int(log.random.integers(10**16, 10**18))
    preamble = f"Name\trun\nFile\tC:\\run.csv\nStart\t{start}\tMonday\t15:56:24\nEnd\t{start + 9}\tx\ty\n\n"
    return log.read_text(preamble + "\t".join(names) + "\n" + rows_of(log, "\t"), names)


@variant("a preamble of an oscilloscope, without an empty line")
def _(log):
    names = log.names()
    preamble = (
        "Model,MDO{0}\nRecord Length,{0}\nSample Interval,{1:.3e}\nVertical Units,V\nLabel,\n"
    )
    preamble = preamble.format(log.random.integers(100, 9999), log.rig.period)
    return log.read_text(preamble + ",".join(names) + "\n" + rows_of(log, digits="%.11e"), names)


@variant("a preamble of words between blanks")
def _(log):
    names = log.names("{}_{}", "{}{}")
    preamble = f"Recorded by station {log.random.integers(99)}\nAll angles at the joint\n\n"
    return log.read_text(preamble + " ".join(names) + "\n" + rows_of(log, " "), names)


for _what, _form in (("words", "{}"), ("brackets", "[{}]")):

    @variant(f"a row of units in {_what}")
    def _(log, form=_form):
        names = log.names()
        units = ["ms", *["deg"] * log.n, *["Nm"] * log.n]
        scale = np.repeat([1e3, 180 / np.pi, 1.0], [1, log.n, log.n])
        heading = "\t".join(names) + "\n" + "\t".join(form.format(unit) for unit in units)
        text = heading + "\n" + rows_of(log, "\t", table=log.table * scale)
        return log.read_text(text, names, units=False)


@variant("units in brackets between blanks")
def _(log):
    names = log.names("{}_{}", "{}{}")
    units = ["s", *["gon"] * log.n, *["Nm"] * log.n]
    scale = np.repeat([1.0, 200 / np.pi, 1.0], [1, log.n, log.n])
    heading = " ".join(f"{name} ({unit})" for name, unit in zip(names, units, strict=True))
    text = heading + "\n" + rows_of(log, " ", table=log.table * scale)
    return log.read_text(text, names, units=False)


@variant("groups above the names")
def _(log):
    joints = [f"J{i}" for i in range(1, log.n + 1)]
    groups = [" ", "pos", *[""] * (log.n - 1), "trq", *[""] * (log.n - 1)]
    text = ";".join(groups) + "\n" + ";".join(["time", *joints, *joints]) + "\n" + rows_of(log, ";")
    names = ["time", *(f"{group}.{joint}" for group in ("pos", "trq") for joint in joints)]
    return log.read_text(text, names)


for _what, _mark in (("numpy", "# "), ("MATLAB", "%")):

    @variant(f"a heading with the mark of {_what}")
    def _(log, mark=_mark):
        names = log.names("{}_{}", "{}{}")
        notes = f"{mark}run {log.random.integers(99)}\n"
        return log.read_text(notes + mark + " ".join(names) + "\n" + rows_of(log, " "), names)


@variant("an index, and columns of words and of stamps")
def _(log):
    names = log.names()
    lines = rows_of(log).splitlines()
    text = "," + ",".join(names) + ",mode,stamp\n"
    text += "".join(
        f"{i},{line},{'RUN' if i % 7 else 'IDLE'},2026-03-0{i % 9 + 1} 10:00:00.5\n"
        for i, line in enumerate(lines)
    )
    return log.read_text(text, names)


@variant("words for missing cells in other columns")
def _(log):
    names = log.names()
    words = ("", "NA", "NULL", "nan", "-")
    lines = (f"{line},{words[i % 5]}\n" for i, line in enumerate(rows_of(log).splitlines()))
    return log.read_text(",".join([*names, "temperature"]) + "\n" + "".join(lines), names)


for _suffix in ("txt", "dat", "log"):

    @variant(f"a table that ends in .{_suffix}")
    def _(log, suffix=_suffix):
        names = log.names("{}_{}")
        return log.read_text(" ".join(names) + "\n" + rows_of(log, " "), names, suffix=suffix)


# -- what is no table ----------------------------------------------------------------------------
@variant("rows without a heading")
def _(log):
    return refused(
        lambda: log.read_text(rows_of(log, " "), log.names()), "name its columns in a line above"
    )


@variant("lines of name and value")
def _(log):
    sign = log.random.choice([":=", "=", ": ", " = "])
    text = "".join(f"Out.Data[{i}]{sign}{x:.6f}F16#B3\n" for i, x in enumerate(log.q[:, 0]))
    return refused(lambda: log.read_text(text, log.names()), "lines of name and value are not read")


@variant("lines of JSON")
def _(log):
    lines = (json.dumps({"t": t, "q": q}) for t, q in zip(log.t, log.q.tolist(), strict=True))
    return refused(lambda: log.read_text("\n".join(lines), log.names()), "lines of JSON")


@variant("decimal commas between commas")
def _(log):
    names = log.names("{}_{}")
    text = ",".join(names) + "\n" + rows_of(log, ",", ",", digits="%.6f")
    return refused(lambda: log.read_text(text, names), "decimals have a comma", "semicolons")


@variant("decimals of two kinds")
def _(log):
    names = log.names("{}_{}")
    text = ";".join(names) + "\n" + rows_of(log, ";", ",") + rows_of(log, ";", ".")
    return refused(lambda: log.read_text(text, names), "decimals with a (comma|point) in all rows")


@variant("a row that is cut off")
def _(log):
    names = log.names("{}_{}")
    lines = (",".join(names) + "\n" + rows_of(log)).splitlines()
    at = int(log.random.integers(1, len(lines)))
    lines[at] = lines[at].rpartition(",")[0]
    return refused(lambda: log.read_text("\n".join(lines), names), f"line {at + 1} must have")


@variant("an ending that is not read")
def _(log):
    ending = log.random.choice(["xlsx", "json", "npy", "pkl", "gz"])
    return refused(
        lambda: log.read_text("x", log.names(), suffix=ending),
        "must end in one of",
        "Save|Write|Unpack",
    )


# -- arrays --------------------------------------------------------------------------------------
BLOCKS = {"t": "t", "position": "q", "torque": "u"}
SAID = {"t": "s", "position": "rad", "torque": "N m"}
OF_TWO = {"t": "s", "position": "rad"}


def save(path, arrays):
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, arrays)
    else:
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
    return path


for _suffix in ("npz", "mat", "h5"):

    @variant(f"n x N arrays in {_suffix}")
    def _(log, suffix=_suffix):
        arrays = {"t": log.t[None], "q": log.q.T, "u": log.torque.T}
        return log.read(save(log.folder / f"a.{suffix}", arrays), BLOCKS, SAID)

    @variant(f"elements of an array in {_suffix}")
    def _(log, suffix=_suffix):
        transposed = log.random.choice([True, False])
        arrays = {"all": log.table.T if transposed else log.table}
        form = log.random.choice(["all[{}]", "all.{}"])
        place = [form.format(i) for i in range(1 + 2 * log.n)]
        columns = {"t": place[0], "position": place[1 : 1 + log.n], "torque": place[1 + log.n :]}
        return log.read(save(log.folder / f"a.{suffix}", arrays), columns, SAID)


@variant("n x 1 x N arrays in structures")
def _(log):
    def of(values):
        return {"data": values.T[:, None, :], "timestamps": log.t[None]}

    path = save(log.folder / "a.mat", {"log": {"enc": of(log.q), "trq": of(log.torque)}})
    columns = {"t": "log.enc.timestamps", "position": "log.enc.data", "torque": "log.trq.data"}
    return log.read(path, columns, SAID)


@variant("elements of lists in Parquet")
def _(log):
    table = {"t": log.t, "q": log.q.tolist(), "u": log.torque.tolist()}
    pq.write_table(pa.table(table), log.folder / "a.parquet")
    form = log.random.choice(["{}[{}]", "{}.{}"])
    columns = {
        "t": "t",
        "position": [form.format("q", i) for i in range(log.n)],
        "torque": [form.format("u", i) for i in range(log.n)],
    }
    return log.read(log.folder / "a.parquet", columns, SAID)


# -- MATLAB --------------------------------------------------------------------------------------
def matlab73(path, fill):
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM")
    return path


def put(group, name, values, matlab_class="double"):
    item = group.create_dataset(name, data=np.asarray(values).T)
    item.attrs["MATLAB_class"] = np.bytes_(matlab_class)
    return item


@variant("structures in MAT 7.3")
def _(log):
    def fill(file):
        run = file.create_group("run")
        run.attrs["MATLAB_class"] = np.bytes_("struct")
        put(run, "t", log.t[:, None])
        put(run, "q", log.q)
        put(run, "u", log.torque)

    path = matlab73(log.folder / "a.mat", fill)
    separator = log.random.choice(["/", "."])
    columns = {field: f"run{separator}{name}" for field, name in BLOCKS.items()}
    return log.read(path, columns, SAID)


@variant("an array of structures in MAT 7.3")
def _(log):
    def fill(file):
        scope, hidden = file.create_group("scope"), file.create_group("#refs#")
        put(scope, "time", log.t[None])
        signals = scope.create_group("signals")
        signals.attrs["MATLAB_class"] = np.bytes_("struct")
        places = [put(hidden, "a", log.q).ref, put(hidden, "b", log.torque).ref]
        signals.create_dataset("values", data=np.array([places], dtype=h5py.ref_dtype).T)

    path = matlab73(log.folder / "a.mat", fill)
    mark = log.random.choice(["/", "."])
    names = [f"scope{mark}time", *(f"scope{mark}signals[{k}]{mark}values" for k in range(2))]
    return log.read(path, dict(zip(BLOCKS, names, strict=True)), SAID)


for _class in ("timetable", "table", "timeseries"):

    @variant(f"a {_class} in MAT 7.3")
    def _(log, matlab_class=_class):
        def fill(file):
            place = np.uint32([[3707764736, 2, 1, 1, log.random.integers(1, 9), 1]])
            put(file, "run", place, matlab_class).attrs["MATLAB_object_decode"] = np.int32(3)

        path = matlab73(log.folder / "a.mat", fill)
        columns = {"t": "run.Time", "position": "run.q"}
        return refused(
            lambda: log.read(path, columns, OF_TWO), f"'run' is a MATLAB {matlab_class}", "save"
        )


@variant("a timetable in MAT 5")
def _(log):
    path = save(log.folder / "a.mat", {"other": log.t})
    path.write_bytes(path.read_bytes() + opaque("run", "timetable"))
    columns = {"t": "run.Time", "position": "run.q"}
    return refused(lambda: log.read(path, columns, OF_TWO), "'run' is a MATLAB timetable", "save")


# -- ROS -----------------------------------------------------------------------------------------
def recorded(path, topic, messages):
    """An MCAP file of JSON messages, one per millisecond of the log."""
    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("message", "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for time, message in messages:
            writer.add_message(channel, time, json.dumps(message).encode(), time)
        writer.finish()
    return path


@variant("a bag of ROS 1")
def _(log):
    types = get_typestore(Stores.ROS1_NOETIC)
    state, header, time = (
        types.types[name]
        for name in (
            "sensor_msgs/msg/JointState",
            "std_msgs/msg/Header",
            "builtin_interfaces/msg/Time",
        )
    )
    names = [f"joint_{i}" for i in range(log.n)]
    order = log.random.permutation(log.n)
    with Ros1Writer(log.folder / "run.bag") as bag:
        connection = bag.add_connection("/joint_states", state.__msgtype__, typestore=types)
        for k, stamp in enumerate(np.rint(1e9 * log.t).astype(int).tolist()):
            message = state(
                header=header(k, time(10**9 + stamp // 10**9, stamp % 10**9), ""),
                name=[names[i] for i in order],
                position=log.q[k, order],
                velocity=np.zeros(log.n),
                effort=log.torque[k, order],
            )
            bag.write(connection, stamp, types.serialize_ros1(message, state.__msgtype__))
    columns = {
        "t": "/joint_states.stamp",
        "position": [f"/joint_states.position.{name}" for name in names],
        "torque": [f"/joint_states.effort.{name}" for name in names],
    }
    return log.read(log.folder / "run.bag", columns, SAID | {"t": "ns"})


def interfaces(log, short):
    names = [f"axis_{i}" for i in range(log.n)]

    def message(k):
        order = log.random.permutation(log.n).tolist()
        return {
            "joint_names": [names[i] for i in order],
            "interface_values": [
                {
                    "interface_names": ["effort", "position", "temperature"],
                    "values": [log.torque[k, i], log.q[k, i], 40.0],
                }
                for i in order
            ],
        }

    topic = "/dynamic_joint_states"
    times = np.rint(1e9 * log.t).astype(int).tolist()
    path = recorded(
        log.folder / "a.mcap", topic, ((time, message(k)) for k, time in enumerate(times))
    )
    place = topic if short else f"{topic}.interface_values"
    columns = {
        "t": f"{topic}.log_time",
        "position": [f"{place}.{name}.position" for name in names],
        "torque": [f"{place}.{name}.effort" for name in names],
    }
    return log.read(path, columns, SAID | {"t": "ns"})


@variant("a DynamicJointState by its fields")
def _(log):
    return interfaces(log, short=False)


@variant("a DynamicJointState by joint and interface")
def _(log):
    return interfaces(log, short=True)


@variant("an array of messages by index")
def _(log):
    times = np.rint(1e9 * log.t).astype(int).tolist()
    messages = (
        (
            time,
            {
                "motors": [
                    {"q": q, "tau": u, "raw": [1, 2, 3]}
                    for q, u in zip(log.q[k].tolist(), log.torque[k].tolist(), strict=True)
                ]
            },
        )
        for k, time in enumerate(times)
    )
    path = recorded(log.folder / "a.mcap", "/low", messages)
    form = log.random.choice(["/low.motors[{}].{}", "/low.motors.{}.{}"])
    columns = {
        "t": "/low.log_time",
        "position": [form.format(i, "q") for i in range(log.n)],
        "torque": [form.format(i, "tau") for i in range(log.n)],
    }
    return log.read(path, columns, SAID | {"t": "ns"})


# -- units ---------------------------------------------------------------------------------------
TURN = {"turns": 1.0, "rev": 1.0, "gon": 400.0, "gradians": 400.0, "mrad": 2000 * np.pi}


def positions(log, values, unit, **others):
    path = save(log.folder / "a.npz", {"t": log.t, "q": values, "u": others.get("u", log.torque)})
    units = SAID | {"position": unit} | others.get("units", {})
    return log.read(path, BLOCKS, units)


for _word in TURN:

    @variant(f"positions in {_word}")
    def _(log, word=_word):
        return positions(log, log.q * TURN[word] / (2 * np.pi), word)


for _word in ("turns", "gon"):

    @variant(f"positions in {_word} that are called radians or degrees")
    def _(log, word=_word):
        stated = log.random.choice(["rad", "deg"])
        values = log.q * TURN[word] / (2 * np.pi)
        return refused(lambda: positions(log, values, str(stated)), f"'{word}'")


@variant("positions in rpm")
def _(log):
    return refused(lambda: positions(log, log.q, "rpm"), "must be one of 'rad', .*got 'rpm'")


@variant("normalised positions with their ranges")
def _(log):
    low = log.counts.min(axis=0) - log.random.integers(10, 900, log.n)
    high = log.counts.max(axis=0) + log.random.integers(10, 900, log.n)
    share = 200 * (log.counts - low) / (high - low) - 100
    ranges = np.column_stack([low, high])
    return positions(log, share, {"-100 to 100 of pulses": ranges})


@variant("normalised positions without their ranges")
def _(log):
    word = str(log.random.choice(["normalised", "normalized", "%", "-100 to 100"]))
    return refused(
        lambda: positions(log, 50 * log.q, word), "ranges of the joints", "-100 to 100 of"
    )


@variant("per mille of a rated torque")
def _(log):
    rated = np.round(log.random.uniform(0.2, 4, log.n), 3)
    share = 1000 * log.torque / log.rig.drive.gear / rated
    unit = {"torque": {"per mille of motor N m": rated}}
    return positions(log, log.q, "rad", u=share, units=unit)


@variant("per mille without the rated torque")
def _(log):
    word = str(log.random.choice(["per mille", "‰", "permille"]))
    return refused(
        lambda: positions(log, log.q, "rad", units={"torque": word}), "rated torque", "per mille of"
    )


@variant("an effort in ampere with its constant")
def _(log):
    constant = np.round(log.random.uniform(2, 20, log.n), 2)
    unit = {"torque": {"N m per A": constant}}
    return positions(log, log.q, "rad", u=log.torque / constant, units=unit)


@variant("an effort in ampere")
def _(log):
    return refused(
        lambda: positions(log, log.q, "rad", units={"torque": "A"}), "torque constant", "'current'"
    )


# -- a file without a mapping --------------------------------------------------------------------
@variant("a description whose mapping reads the file")
def _(log):
    names = log.names()
    scale = np.repeat([1e3, 180 / np.pi, 1.0], [1, log.n, log.n])
    path = log.folder / "run.csv"
    path.write_text(";".join(names) + "\n" + rows_of(log, ";", ",", table=log.table * scale))
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        contents = Record.read(path)
    if "Check this mapping" not in printed.getvalue():
        return False
    return log.read(path, contents.columns, contents.units)


def rows(seed):
    """Yield the name of each variant, whether it is as it should be, and what it was otherwise."""
    with warnings.catch_warnings(), WarmChildren():
        warnings.simplefilter("ignore")
        for k, (name, write) in enumerate(VARIANTS.items()):
            with tempfile.TemporaryDirectory() as folder:
                try:
                    good = write(drawn((seed, k), Path(folder)))
                    yield name, bool(good), "" if good else "other numbers than were written"
                # Whatever comes is the answer: a defect is one row of the table.
                except Exception as error:
                    yield name, False, f"{type(error).__name__}: {error}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seeds", type=int, default=3)
    options = parser.parse_args()
    good = total = 0
    for seed in range(options.seeds):
        for name, ok, message in rows(seed):
            good, total = good + ok, total + 1
            if not ok:
                print(f"seed {seed}  {name}: {message:.300}")
    print(f"{len(VARIANTS)} variants of tables: {good} of {total} as they should be")
    return 0 if good == total else 1


if __name__ == "__main__":
    sys.exit(main())

"""One small log in every format, files made from it by spoiling its bytes, and a reader that starts
quickly.

A child process spends nearly all of its time importing h5py, pyarrow and scipy. `WarmChildren`
imports them once and forks for every file: each is still read by the library's own code in a
process of its own, under its limits.
"""

import json
import re
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io

from plant import LoadError, Record, puma560
from plant.logs import child, isolation

RIG = puma560.rig()
FORMATS = ("csv", "npz", "mat", "hdf5", "parquet")
COLUMNS = {"t": "time", "counts": ["c1", "c2"], "torque": ["u1", "u2"], "valid": "ok"}
UNITS = {"t": "s", "torque": "N m"}


def log(N=200, seed=0):
    """Columns of a log of the paper's arm."""
    rng = np.random.default_rng(seed)
    counts = np.cumsum(rng.integers(-3, 4, (N, 2)), axis=0)
    torque = rng.normal(size=(N, 2))
    return {
        "time": RIG.period * np.arange(N), "c1": counts[:, 0], "c2": counts[:, 1].astype(float),
        "u1": torque[:, 0], "u2": torque[:, 1].astype(np.float32), "ok": np.ones(N, bool),
    }  # fmt: skip


def write(kind, path, columns, compress=True):
    """Write columns, by default compressed where the format can."""
    if kind == "csv":
        rows = np.column_stack([np.asarray(column, float) for column in columns.values()])
        with open(path, "w") as file:
            file.write(",".join(columns) + "\n")
            file.writelines(
                ",".join("" if np.isnan(x) else repr(float(x)) for x in row) + "\n" for row in rows
            )
    elif kind == "npz":
        with open(path, "wb") as file:
            (np.savez_compressed if compress else np.savez)(file, **columns)
    elif kind == "mat":
        with open(path, "wb") as file:
            scipy.io.savemat(file, columns, do_compression=compress)
    elif kind == "hdf5":
        with h5py.File(path, "w") as file:
            for name, column in columns.items():
                file.create_dataset(name, data=column, compression="gzip" if compress else None)
    else:
        pq.write_table(pa.table(columns), path, compression="snappy" if compress else "none")


def read(kind, path):
    """The record of a file that `write` wrote."""
    return Record._read(kind, path, None, prefix="", rig=RIG, columns=COLUMNS, units=UNITS)


def spoil(data, rng):
    """Bytes with some bits flipped, cut off, a block of zeros, a block twice, or something
    behind them.
    """
    data, at = bytearray(data), int(rng.integers(len(data)))
    end = at + int(rng.integers(1, 65))
    match int(rng.integers(5)):
        case 0:
            for place in rng.integers(8 * len(data), size=rng.integers(1, 9)):
                data[place // 8] ^= 1 << (place % 8)
        case 1:
            del data[at:]
        case 2:
            data[at:end] = bytes(len(data[at:end]))
        case 3:
            data[at:at] = data[at:end]
        case 4:
            data += rng.bytes(int(rng.integers(1, 300)))
    return bytes(data)


_SERVER = """
import io, json, os, signal, sys, time
import numpy, scipy.io, h5py
os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"
import pyarrow.parquet, pyarrow.compute
import mcap.reader, mcap_ros2.decoder, rosbags.highlevel, rosbags.typesys.stores.ros2_humble
sys.path.insert(0, sys.argv[1])
import child
sys.path.pop(0)
for line in sys.stdin:
    order, out, seconds = json.loads(line)
    process = os.fork()
    if not process:
        os.dup2(os.open(out, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        os._exit(child.main(order))
    end, done = time.monotonic() + seconds, 0
    while not done:
        done, status, usage = os.wait4(process, os.WNOHANG)
        if not done and time.monotonic() > end:
            os.kill(process, signal.SIGKILL)
            done, status, usage = os.wait4(process, 0)
            print(json.dumps([None, usage.ru_maxrss]), flush=True)
            break
        if not done:
            time.sleep(0.001)
    else:
        print(json.dumps([os.waitstatus_to_exitcode(status), usage.ru_maxrss]), flush=True)
"""


class WarmChildren:
    """In place of `run` in `plant.logs.isolation`; `.peak` is the largest memory of a child so
    far [kB].
    """

    def __init__(self):
        self.server = subprocess.Popen(  # noqa: S603 - this interpreter and the code above
            [sys.executable, "-P", "-c", _SERVER, str(Path(child.__file__).parent)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.peak = 0

    def __call__(self, command, *, timeout, **options):
        with tempfile.NamedTemporaryFile() as out:
            print(
                json.dumps([json.loads(command[-1]), out.name, timeout]),
                file=self.server.stdin,
                flush=True,
            )
            status, peak = json.loads(self.server.stdout.readline())
            self.peak = max(self.peak, peak)
            if status is None:
                raise subprocess.TimeoutExpired(command, timeout)
            return subprocess.CompletedProcess(command, status, Path(out.name).read_bytes(), b"")

    def __enter__(self):
        self.cold, isolation.run = isolation.run, self
        return self

    def __exit__(self, *_):
        isolation.run = self.cold
        self.server.stdin.close()
        self.server.wait()
        self.server.stdout.close()


def opaque(name, matlab_class="string"):
    """A variable as MATLAB writes an object of its own classes, such as a string or a table: it
    has no shape.
    """

    def element(kind, data):
        return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)

    text = b"".join(element(1, word) for word in (name.encode(), b"MCOS", matlab_class.encode()))
    inner = (
        element(6, struct.pack("<II", 9, 0))
        + element(5, struct.pack("<ii", 1, 1))
        + element(1, b"")
    )
    body = element(6, struct.pack("<II", 17, 0)) + text + element(14, inner + element(2, b"\x07"))
    return element(14, body)


def refused(call, *expected):
    """The call raises one `LoadError` of one line that matches every pattern."""
    with pytest.raises(LoadError) as refusal:
        call()
    text = str(refusal.value)
    assert "\n" not in text
    assert len(text) < 500
    for part in expected:
        assert re.search(part, text), text

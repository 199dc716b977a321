"""Isolated reading of log files: a corrupt file cannot crash this process or fill its memory.

NPZ archives are read here, after a check of the declared sizes and without pickles. Third-party
libraries read all other formats in a child process.
"""

import dataclasses
import io
import json
import math
import os
import signal
import struct
import sys
import zipfile
from collections.abc import Collection
from importlib.util import find_spec
from subprocess import DEVNULL, PIPE, TimeoutExpired, run
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from plant.logs import child
from plant.logs.formats.columns import (
    choice_of,
    refusals_left_out,
    require_real,
    require_size,
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReadingLimits:
    """Limits of time and memory for one log file; all chosen by hand.

    Parameters
    ----------
    seconds : float
        Run time of the child process [s], so that a failure takes less than 5 s in all.
    message_seconds : float
        The same for a file of messages [s]; Python decodes the messages one by one.
    memory : int
        Address space of the child, with its libraries and the copy that it sends [bytes].
    directory : int
        Directory of an NPZ archive [bytes].
    columns : int
        All columns together [bytes].
    messages : int
        A whole file of messages [bytes], of which only the wanted topics are read.
    """

    seconds: float = 4.5
    message_seconds: float = 60
    memory: int = 2 << 30
    directory: int = 4 << 20
    columns: int = 256 << 20
    messages: int = 64 << 30


LIMITS = ReadingLimits()
# Optional libraries of each kind; the extra that installs them has the name of the kind.
_LIBRARIES = {
    "hdf5": ("h5py",),
    "parquet": ("pyarrow",),
    "lerobot": ("pyarrow",),
    "mcap": ("mcap", "mcap_ros2"),
    "rosbag2": ("rosbags",),
}
# One thread per library saves address space; HDF5 loads no plugin that a file asks for.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": os.devnull}
# NPY version 3 differs only in Unicode names of fields, which columns of numbers do not have.
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}
# Beginning of a column that holds its whole header: numpy refuses one of more than 10,000 bytes.
_HEADER_BYTES = 1 << 14


def read_isolated(
    kind: str, path: str, names: Collection[str] | None, prefix: str, max_bytes: int, **options: Any
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Names and columns of a file, read by third-party libraries; refusals do not name the path.

    The `kind` (mat, hdf5, parquet, lerobot, mcap or rosbag2) names the reader, a module of
    `plant.logs.formats`. Without `names` it reads all columns that start with `prefix`. The columns
    that it reads must fit into `max_bytes`. Its options are ``episode`` for lerobot and ``clock``
    for mcap and rosbag2; ``numbers_only`` leaves out columns of anything but real numbers.
    """
    # A missing library is reported here, where the message can name the extra that installs it.
    for library in _LIBRARIES.get(kind, ()):
        if find_spec(library) is None:
            raise ValueError(
                f"needs {library} to be read; it is not installed. Run pip install"
                f" 'onepulse[{kind}]'."
            )
    seconds = LIMITS.message_seconds if "clock" in options else LIMITS.seconds
    order: dict[str, Any] = {
        "kind": kind,
        "path": path,
        "names": names,
        "prefix": prefix,
        "options": options,
    }
    # The limit of CPU time has a resolution of whole seconds.
    order |= {"seconds": int(np.ceil(seconds)), "memory": LIMITS.memory, "bytes": max_bytes}
    try:
        # -P keeps the folder of child.py off the path: libraries import modules of the same names.
        done = run(  # noqa: S603 - this interpreter and this package's own file
            [sys.executable, "-P", child.__file__, json.dumps(order)],
            stdin=DEVNULL,
            stdout=PIPE,
            stderr=DEVNULL,
            env=os.environ | _ENVIRONMENT,
            timeout=seconds,
            check=False,
        )
    except TimeoutExpired:
        raise ValueError(
            f"must be read within {seconds} s; it was not. Cut it, or save it as NPZ."
        ) from None
    if done.returncode == child.REFUSED:
        # The child's answer is a complete message for the user.
        raise ValueError(done.stdout.decode(errors="replace"))
    if done.returncode:
        # A negative status is the signal that ended the child, such as SIGSEGV in a library.
        end = (
            signal.Signals(-done.returncode).name
            if done.returncode < 0
            else f"status {done.returncode}"
        )
        raise ValueError(
            f"must be a sound {kind} file; its reader ended with {end}. Write the file again."
        )
    # The answer is one line of JSON, then the bytes of the columns in the order of that line.
    head = done.stdout[: done.stdout.index(b"\n")]
    available, read_names, shapes = json.loads(head)
    columns = dict[str, NDArray[Any]]()
    at = len(head) + 1
    for name, (dtype, shape) in zip(read_names, shapes, strict=True):
        count = math.prod(shape)
        # `frombuffer` refuses an offset at the end of the buffer, so an empty column starts at 0.
        columns[name] = np.frombuffer(done.stdout, dtype, count, at if count else 0).reshape(shape)
        at += columns[name].nbytes
    return available, columns


def read_npz(
    path: str,
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    numbers_only: bool = False,
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Names and columns of an NPZ archive, as `read_isolated` gives them of other formats."""
    # `zipfile` lists a directory of any size that the file declares, so check the size first.
    _require_small_directory(path)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        chosen = choice_of(names, prefix)
        wanted = {name: info for name, info in members.items() if chosen(name)}
        # numpy stores or deflates a column; it uses no other method.
        for name, info in wanted.items():
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                got = f"column {name!r} has ZIP method {info.compress_type}"
                raise ValueError(
                    f"must be compressed as numpy does; {got}. Save it with numpy.savez_compressed."
                )
        if numbers_only:
            # What is left out is not expanded, so its size does not count.
            wanted = {n: info for n, info in wanted.items() if _is_real(archive, n, info)}
        # The sizes that the directory declares are checked before anything is expanded.
        require_size(sum(info.file_size for info in wanted.values()), max_bytes)
        return list(members), {name: _array(archive, name, info) for name, info in wanted.items()}


def _require_small_directory(path: str) -> None:
    """Refuse an archive with so many members that listing them takes long."""
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        # The end record has 22 bytes, a comment of at most 64 KiB after it, and perhaps a ZIP64
        # locator of 20 bytes before it.
        file.seek(max(file.tell() - (1 << 16) - 22 - 20, 0))
        tail = file.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + 22:
        raise ValueError(
            "must be an NPZ archive; it has no directory of a ZIP file. Write it again."
        )
    # The size of the directory stands 12 bytes into the end record.
    (size,) = struct.unpack_from("<I", tail, at + 12)
    limit = LIMITS.directory
    # A ZIP64 locator announces sizes that the fields of the end record cannot hold.
    if size > limit or tail[max(at - 20, 0) : at].startswith(b"PK\6\7"):
        raise ValueError(
            f"must hold at most some {limit >> 7} columns; its directory is larger. Cut it."
        )


def _is_real(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> bool:
    """Whether a column holds real numbers, from its header alone."""
    with archive.open(info) as file, refusals_left_out(numbers_only=True):
        _header(io.BytesIO(file.read(_HEADER_BYTES)), name)
        return True
    return False


def _header(file: IO[bytes], name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether in Fortran's order, and type of a column of real numbers."""
    version = np.lib.format.read_magic(file)
    if version not in _HEADERS:
        raise ValueError(
            f"must be NPY version 1 or 2; got {version} in column {name!r}. Save it with"
            " numpy.savez."
        )
    shape, fortran, dtype = _HEADERS[version](file)
    require_real(name, dtype, dtype.kind in "biuf")
    return shape, fortran, dtype


def _array(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(info) as file:
        shape, fortran, dtype = _header(file, name)
        body = file.read()  # at most file_size bytes; `read` compares their checksum
    if len(body) != math.prod(shape) * dtype.itemsize:
        got = f"got {len(body)} bytes"
        raise ValueError(
            f"must hold {shape} of {dtype} in column {name!r}; {got}. Write the file again."
        )
    return np.frombuffer(body, dtype).reshape(shape, order="F" if fortran else "C")

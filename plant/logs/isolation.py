"""Reading a file so that a corrupt one can take neither this process nor its memory with it.

Of an NPZ archive sizes are checked before anything is expanded, and no pickle is ever opened; all
else, which libraries of others read, is read in a child process.
"""

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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs import child
from plant.logs.formats.columns import choice_of, require_real, require_size

_SECONDS = 4.5  # with what comes before and after, a failure takes less than 5
_MESSAGES = 60  # of files that hold messages, which are decoded one by one
_MEMORY = 2 << 30  # address space of the child, libraries and the copy that it sends included
# Optional; the kinds are named like the extras of this project.
_LIBRARIES = {
    "hdf5": ("h5py",),
    "parquet": ("pyarrow",),
    "lerobot": ("pyarrow",),
    "mcap": ("mcap", "mcap_ros2"),
    "rosbag2": ("rosbags",),
}
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": os.devnull}
_DIRECTORY = 4 << 20  # bytes
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def read_isolated(
    kind: str, path: str, names: Collection[str] | None, prefix: str, most: int, **options: Any
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Names in a file, and its columns, read by the libraries of others; refusals do not name the
    path.

    The `kind` (mat, hdf5, parquet, lerobot, mcap or rosbag2) is a file of `plant.logs.formats`;
    without `names` all columns that start with `prefix` are read. They may have `most` bytes.
    Options are those of that reader: ``episode`` of lerobot, ``clock`` of mcap and rosbag2.
    """
    for library in _LIBRARIES.get(kind, ()):
        if find_spec(library) is None:
            raise ValueError(
                f"needs {library} to be read; it is not installed. Run pip install"
                f" 'onepulse[{kind}]'."
            )
    seconds = _MESSAGES if "clock" in options else _SECONDS
    order: dict[str, Any] = {
        "kind": kind,
        "path": path,
        "names": names,
        "prefix": prefix,
        "options": options,
    }
    order |= {"seconds": int(np.ceil(seconds)), "memory": _MEMORY, "bytes": most}
    try:
        # -P: the folder of child.py holds files whose names other libraries import.
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
        raise ValueError(done.stdout.decode(errors="replace"))
    if done.returncode:
        end = (
            signal.Signals(-done.returncode).name
            if done.returncode < 0
            else f"status {done.returncode}"
        )
        raise ValueError(
            f"must be a sound {kind} file; its reader ended with {end}. Write the file again."
        )
    head = done.stdout[: done.stdout.index(b"\n")]
    known, found, shapes = json.loads(head)
    columns = dict[str, NDArray[Any]]()
    at = len(head) + 1
    for name, (dtype, shape) in zip(found, shapes, strict=True):
        count = math.prod(shape)
        columns[name] = np.frombuffer(done.stdout, dtype, count, at if count else 0).reshape(shape)
        at += columns[name].nbytes
    return known, columns


def read_npz(
    path: str, names: Collection[str] | None, prefix: str, most: int
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Names and columns of an NPZ archive, as `read_isolated` gives them of other formats."""
    _require_small_directory(path)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        chosen = choice_of(names, prefix)
        wanted = {name: info for name, info in members.items() if chosen(name)}
        for name, info in wanted.items():
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                got = f"column {name!r} has ZIP method {info.compress_type}"
                raise ValueError(
                    f"must be compressed as numpy does; {got}. Save it with numpy.savez_compressed."
                )
        require_size(sum(info.file_size for info in wanted.values()), most)
        return list(members), {name: _array(archive, name, info) for name, info in wanted.items()}


def _require_small_directory(path: str) -> None:
    """Refuse an archive of so many members that listing them takes long; numpy's have one per
    column.
    """
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(file.tell() - (1 << 16) - 22 - 20, 0))
        tail = file.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + 22:
        raise ValueError(
            "must be an NPZ archive; it has no directory of a ZIP file. Write it again."
        )
    (size,) = struct.unpack_from("<I", tail, at + 12)
    if size > _DIRECTORY or tail[max(at - 20, 0) : at].startswith(b"PK\6\7"):
        raise ValueError(
            f"must hold at most some {_DIRECTORY >> 7} columns; its directory is larger. Cut it."
        )


def _array(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(
                f"must be NPY version 1 or 2; got {version} in column {name!r}. Save it with"
                " numpy.savez."
            )
        shape, fortran, dtype = _HEADERS[version](file)
        require_real(name, dtype, dtype.kind in "biuf")
        body = file.read()  # at most file_size, and its checksum is compared
    if len(body) != math.prod(shape) * dtype.itemsize:
        got = f"got {len(body)} bytes"
        raise ValueError(
            f"must hold {shape} of {dtype} in column {name!r}; {got}. Write the file again."
        )
    return np.frombuffer(body, dtype).reshape(shape, order="F" if fortran else "C")

"""Reading a file in a child process, so that a corrupt one can take neither this process nor its memory with it."""

import json
import math
import os
import signal
import sys
from collections.abc import Collection
from importlib.util import find_spec
from subprocess import DEVNULL, PIPE, TimeoutExpired, run
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs import child

_SECONDS = 4.5  # with what comes before and after, a failure takes less than 5
_MESSAGES = 60  # of files that hold messages, which are decoded one by one
_MEMORY = 2 << 30  # address space of the child, libraries and the copy that it sends included
_LIBRARIES = {
    "hdf5": ("h5py",), "parquet": ("pyarrow",), "lerobot": ("pyarrow",), "mcap": ("mcap", "mcap_ros2"),
    "rosbag2": ("rosbags",),
}  # fmt: skip
"""Optional; the kinds are named like the extras of this project."""
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": os.devnull}


def read_isolated(
    kind: str, path: str, names: Collection[str] | None, prefix: str, most: int, **options: Any
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Read columns of a file by the libraries of others.

    Parameters
    ----------
    kind : str
        mat, hdf5, parquet, lerobot, mcap or rosbag2: a file of `plant.logs.formats`.
    path : str
    names : list of str, or None
        The columns; None reads all that start with `prefix`.
    most : int
        Bytes that they may have.
    options
        Of that reader: ``episode`` of lerobot, ``clock`` of mcap and rosbag2.

    Returns
    -------
    known : list of str
        Names in the file.
    columns : dict of numpy.ndarray

    Raises
    ------
    ValueError
        Whatever went wrong, without the path.
    """
    for library in _LIBRARIES.get(kind, ()):
        if find_spec(library) is None:
            raise ValueError(f"needs {library} to be read; it is not installed. Run pip install 'onepulse[{kind}]'.")
    seconds = _MESSAGES if "clock" in options else _SECONDS
    order: dict[str, Any] = {"kind": kind, "path": path, "names": names, "prefix": prefix, "options": options}
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
        raise ValueError(f"must be read within {seconds} s; it was not. Cut it, or save it as NPZ.") from None
    if done.returncode == child.REFUSED:
        raise ValueError(done.stdout.decode(errors="replace"))
    if done.returncode:
        end = signal.Signals(-done.returncode).name if done.returncode < 0 else f"status {done.returncode}"
        raise ValueError(f"must be a sound {kind} file; its reader ended with {end}. Write the file again.")
    head = done.stdout[: done.stdout.index(b"\n")]
    known, found, shapes = json.loads(head)
    columns, at = dict[str, NDArray[Any]](), len(head) + 1
    for name, (dtype, shape) in zip(found, shapes, strict=True):
        count = math.prod(shape)
        columns[name] = np.frombuffer(done.stdout, dtype, count, at if count else 0).reshape(shape)
        at += columns[name].nbytes
    return known, columns

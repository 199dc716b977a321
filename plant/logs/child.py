"""The child process that reads one file by third-party libraries, which a corrupt one may crash.

Run as a script it imports nothing of this project but `formats`, takes an order (JSON) as its
argument, and answers on stdout: a line of names, types and shapes (JSON) and the bytes of the
columns, or one line that says why not (exit status 3). What it may use is limited before it imports
what reads the file.
"""

import contextlib
import importlib
import importlib.util
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

REFUSED = 3

# What the package `formats` is called here: its folder is not on the path, and neither is this one,
# which holds files whose names other libraries import.
_FORMATS = "onepulse_formats"


def main(order: dict[str, Any]) -> int:
    """Read a file and write its columns to stdout.

    The order holds kind, path, names (or None), prefix and options; seconds, memory and bytes are
    the limits.
    """
    # 1. Keep stdout for the answer, and limit this process before any library is loaded.
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get into the answer
    _limit(order["seconds"], order["memory"])
    # 2. Read, and check the types here: an array of objects cannot be sent as bytes.
    refusal: Any = _part("columns").RefusalError
    try:
        available, columns = _part(order["kind"]).read(
            order["path"], order["names"], order["prefix"], order["bytes"], **order["options"]
        )
        import numpy as np

        arrays = [np.asarray(column) for column in columns.values()]
        for name, column in zip(columns, arrays, strict=True):
            _part("columns").require_real(name, column.dtype, column.dtype.kind in "biuf")
        # 3. Answer: a line of JSON, then the columns as they lie in memory.
        shapes = [[column.dtype.str, list(column.shape)] for column in arrays]
        with answer:
            answer.write(json.dumps([available, list(columns), shapes]).encode() + b"\n")
            for column in arrays:
                answer.write(np.ascontiguousarray(column).data.cast("B") if column.size else b"")
    except BaseException as error:  # the parent wants one line, whatever it was
        message = str(error)
        # A refusal of this project is complete; any other error is reported as a corrupt file.
        if not isinstance(error, refusal):
            message = (
                f"must be a sound file; reading it gave {f'{type(error).__name__} {message}':.200}."
                " Write it again."
            )
        # The answer may be closed already, if the error came while it was written.
        with contextlib.suppress(ValueError):
            answer.write(message.encode(errors="replace"))
            answer.close()
        return REFUSED
    return 0


def _part(name: str) -> ModuleType:
    """A file of `formats`, which is found beside this one."""
    if _FORMATS not in sys.modules:
        folder = Path(__file__).with_name("formats")
        # The package is registered under a name of its own, so that its relative imports work.
        spec = importlib.util.spec_from_file_location(
            _FORMATS, folder / "__init__.py", submodule_search_locations=[str(folder)]
        )
        sys.modules[_FORMATS] = importlib.util.module_from_spec(spec)  # type: ignore[arg-type]  # it is there
    return importlib.import_module(f"{_FORMATS}.{name}")


def _limit(seconds: int, memory: int) -> None:
    try:
        import resource
    except ImportError:  # Windows has none; the parent's clock still holds
        return
    # CPU time stops an endless loop, also when the parent is gone.
    limits = (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, memory),
    )
    # No core file: a crash is an expected answer here.
    for resource_kind, limit in (*limits, (resource.RLIMIT_CORE, 0)):
        # A soft limit cannot exceed an existing hard one.
        hard = resource.getrlimit(resource_kind)[1]
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(
                resource_kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard)
            )


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))

"""Columns of an NPZ archive: sizes are checked before anything is expanded, and no pickle is ever opened."""

import math
import os
import struct
import zipfile
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

_DIRECTORY = 4 << 20  # bytes
_HEADERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(
    path: str, names: Collection[str] | None, prefix: str, most: int
) -> tuple[list[str], dict[str, NDArray[Any]]]:
    """Read columns of an NPZ archive, as `read_isolated` does for other formats.

    Raises
    ------
    ValueError
        Objects, a size beyond `most` bytes, a header that does not fit its data; without the path.
    """
    _require_small_directory(path)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        wanted = {
            name: info
            for name, info in members.items()
            if (name.startswith(prefix) if names is None else name in names)
        }
        for name, info in wanted.items():
            if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(
                    f"must be compressed as numpy does; column {name!r} has ZIP method {info.compress_type}. Save it "
                    "with numpy.savez_compressed."
                )
        size = sum(info.file_size for info in wanted.values())
        if size > most:
            raise ValueError(
                f"must hold at most {most >> 20} MiB; it declares {size >> 20}. Cut the log into several files."
            )
        return list(members), {name: _array(archive, name, info) for name, info in wanted.items()}


def _require_small_directory(path: str) -> None:
    """Refuse an archive of so many members that listing them takes long; numpy's have one per column."""
    with open(path, "rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(file.tell() - (1 << 16) - 22 - 20, 0))
        tail = file.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + 22:
        raise ValueError("must be an NPZ archive; it has no directory of a ZIP file. Write it again.")
    (size,) = struct.unpack_from("<I", tail, at + 12)
    if size > _DIRECTORY or tail[max(at - 20, 0) : at].startswith(b"PK\6\7"):
        raise ValueError(f"must hold at most some {_DIRECTORY >> 7} columns; its directory is larger. Cut it.")


def _array(archive: zipfile.ZipFile, name: str, info: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"must be NPY version 1 or 2; got {version} in column {name!r}. Save it with numpy.savez.")
        shape, fortran, dtype = _HEADERS[version](file)
        if dtype.kind not in "biuf":
            raise ValueError(f"must hold real numbers; got {dtype} in column {name!r}. Leave it out with names=.")
        body = file.read()  # at most file_size, and its checksum is compared
    if len(body) != math.prod(shape) * dtype.itemsize:
        raise ValueError(
            f"must hold {shape} of {dtype} in column {name!r}; got {len(body)} bytes. Write the file again."
        )
    return np.frombuffer(body, dtype).reshape(shape, order="F" if fortran else "C")

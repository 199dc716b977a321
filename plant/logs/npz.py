"""Columns of an NPZ archive: sizes are checked before anything is expanded, and no pickle is ever opened."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["read_npz"]

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
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        wanted = {
            name: info
            for name, info in members.items()
            if (name.startswith(prefix) if names is None else name in names)
        }
        size = sum(info.file_size for info in wanted.values())
        if size > most:
            raise ValueError(
                f"must hold at most {most >> 20} MiB; it declares {size >> 20}. Cut the log into several files."
            )
        return list(members), {name: _array(archive, name, info) for name, info in wanted.items()}


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

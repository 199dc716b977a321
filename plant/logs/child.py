"""The child process that reads one MAT, HDF5 or Parquet file: a corrupt one may crash their C libraries.

Run as a script it imports nothing of this project, takes an order (JSON) as its argument, and answers on stdout: an NPZ
archive of the columns, or one line that says why not (exit status 3). What it may use is limited before it imports
what reads the file.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import struct
import sys
import zlib
from typing import Any

__all__ = ["REFUSED", "main"]

REFUSED = 3


def main(order: dict[str, Any]) -> int:
    """Read a file and write its columns to stdout.

    Parameters
    ----------
    order : dict
        kind, path, names (or None), prefix; seconds, memory and bytes are the limits.
    """
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints must not get into the answer
    _limit(order["seconds"], order["memory"])
    try:
        known, columns = {"mat": _mat, "hdf5": _hdf5, "parquet": _parquet}[order["kind"]](
            order["path"], _choice(order["names"], order["prefix"]), order["bytes"]
        )
        import numpy as np

        arrays = [np.asarray(column) for column in columns.values()]
        for name, column in zip(columns, arrays, strict=True):
            if column.dtype.kind not in "biuf":
                raise _RefusalError(
                    f"must hold real numbers; got {column.dtype} in column {name!r}. Leave it out with names=."
                )
        label = np.frombuffer(json.dumps([known, list(columns)]).encode(), np.uint8)
        with answer:
            np.savez(answer, label, *arrays)
    except BaseException as error:  # the parent wants one line, whatever it was
        text = str(error) if isinstance(error, _RefusalError) else f"{type(error).__name__} {error}"
        said = (
            text
            if isinstance(error, _RefusalError)
            else f"must be a sound file; reading it gave {text:.200}. Write it again."
        )
        with contextlib.suppress(ValueError):
            answer.write(said.encode(errors="replace"))
            answer.close()
        return REFUSED
    return 0


class _RefusalError(ValueError):
    """A message that is complete."""


def _limit(seconds, memory):
    try:
        import resource
    except ImportError:  # Windows has none; the parent's clock still holds
        return
    for what, most in ((resource.RLIMIT_AS, memory), (resource.RLIMIT_CPU, seconds), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(what)[1]
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _choice(names, prefix):
    return (lambda name: name.startswith(prefix)) if names is None else set(names).__contains__


def _require_size(size, most):
    if size > most:
        raise _RefusalError(
            f"must hold at most {most >> 20} MiB; it declares {size >> 20}. Cut the log into several files."
        )


# -- MAT ------------------------------------------------------------------------------------------------------------
def _mat(path, chosen, most):
    _require_bounded_mat(path, most)
    from scipy.io import loadmat, whosmat

    def load(names):
        found = loadmat(path, simplify_cells=True, variable_names=names)
        return dict(_flat({name: value for name, value in found.items() if name in names}))

    kinds = {name: kind for name, _, kind in whosmat(path)}
    columns = known = load([name for name in kinds if chosen(name) or _has_fields(chosen, name)])
    if not all(name in columns for name in getattr(chosen, "__self__", ())):  # what else there is, for the message
        known = load([name for name, kind in kinds.items() if kind == "struct"])
    plain = [name for name, kind in kinds.items() if kind != "struct"]
    return [*plain, *known], {name: value for name, value in columns.items() if chosen(name)}


def _has_fields(chosen, name):
    """Whether something inside the structure `name` may be wanted."""
    names = getattr(chosen, "__self__", None)
    return names is None or any(wanted.startswith(f"{name}.") for wanted in names)


def _flat(values, prefix=""):
    for name, value in values.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _require_bounded_mat(path, most):
    """Refuse what is no MAT v5, and what expands beyond `most` bytes, by what is declared and then by what comes."""
    with open(path, "rb") as file:
        head = file.read(128)
        if head[:4] == b"\x89HDF" or head[124:128] in (b"\x00\x02IM", b"\x02\x00MI"):
            raise _RefusalError(
                "must be MAT version 5; got 7.3, which is HDF5. Rename it to end in .h5, or use Record.from_hdf5."
            )
        if head[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
            raise _RefusalError("must be MAT version 5; its first 128 bytes are not. Save it with -v7 or -v6.")
        order, total, size = "<" if head[126:] == b"IM" else ">", 0, os.path.getsize(path)
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            start = file.tell()
            if start + length > size:
                raise _RefusalError(
                    f"must be complete; an element of {length} bytes goes beyond its end. Write it again."
                )
            if kind == 15:  # miCOMPRESSED
                inner = zlib.decompressobj().decompress(file.read(min(length, 512)), 8)
                declared = 8 + struct.unpack(f"{order}II", inner)[1] if len(inner) == 8 else 0
                _require_size(total + declared, most)
                file.seek(start)
                expanded = _expanded(file, length, declared)
            else:
                expanded = length
            total += expanded
            _require_size(total, most)
            file.seek(start + length)


def _expanded(file, length, declared):
    """Number of bytes that a compressed element expands to; refused above what it declares."""
    stream, total = zlib.decompressobj(), 0
    while length > 0 and not stream.eof:
        piece = file.read(min(length, 1 << 16))
        if not piece:
            break
        length -= len(piece)
        while piece and not stream.eof:
            total += len(stream.decompress(piece, 1 << 20))
            piece = stream.unconsumed_tail
            if total > declared + 8:  # padding
                raise _RefusalError(f"declares an element of {declared} bytes; it expands beyond them. Write it again.")
    return total


# -- HDF5 -----------------------------------------------------------------------------------------------------------
def _hdf5(path, chosen, most):
    import h5py

    with h5py.File(path, "r") as file:
        items = {}
        file.visititems(items.__setitem__)
        known = {name: item for name, item in items.items() if isinstance(item, h5py.Dataset)}
        for link in _links(file, items):
            if chosen(link) or any(name.startswith(f"{link}/") for name in getattr(chosen, "__self__", ())):
                raise _RefusalError(
                    f"must hold its own data; {link!r} is a link to another file. Copy it in, or choose others."
                )
        wanted = {name: item for name, item in known.items() if chosen(name)}
        for name, item in wanted.items():
            if item.is_virtual or item.external:
                raise _RefusalError(f"must hold its own data; column {name!r} points into another file. Copy it in.")
            if item.dtype.kind not in "biuf":
                raise _RefusalError(
                    f"must hold real numbers; got {item.dtype} in column {name!r}. Leave it out with names=."
                )
        _require_size(sum(math.prod(item.shape or ()) * item.dtype.itemsize for item in wanted.values()), most)
        # MATLAB writes its arrays with the axes in reverse.
        return list(known), {n: item[()].T if "MATLAB_class" in item.attrs else item[()] for n, item in wanted.items()}


def _links(file, items):
    """Names of the links to other files; they are not followed."""
    import h5py

    for place, group in {"": file, **items}.items():
        if isinstance(group, h5py.Group):
            for name in group:
                if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
                    yield f"{place}/{name}".lstrip("/")


# -- Parquet --------------------------------------------------------------------------------------------------------
def _parquet(path, chosen, most):
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # the others reserve more than they need
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        schema = file.schema_arrow
        wanted = [name for name in schema.names if chosen(name)]
        for name in wanted:
            kind = schema.field(name).type
            if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)):
                raise _RefusalError(f"must hold real numbers; got {kind} in column {name!r}. Leave it out with names=.")
        groups = [file.metadata.row_group(i).total_byte_size for i in range(file.metadata.num_row_groups)]
        _require_size(max(8 * file.metadata.num_rows * len(wanted), *groups, 0), most)
        table = file.read(columns=wanted, use_threads=False)
        return schema.names, {name: table.column(name).to_numpy() for name in wanted}


if __name__ == "__main__":
    sys.exit(main(json.loads(sys.argv[1])))

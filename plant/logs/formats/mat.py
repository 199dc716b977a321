"""MAT files of version 5, by scipy; fields of structures are named ``structure.field``."""

import os
import struct
import zlib
from collections.abc import Collection, Iterator
from typing import Any

from .columns import RefusalError, choice_of, homes_of, require_no_object, require_size


def read(
    path: str,
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    numbers_only: bool = False,
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of a MAT file; ``structure[k].field`` in an array of structures."""
    # The size is bounded before scipy expands anything.
    _require_bounded(path, max_bytes)
    import numpy as np
    from scipy.io import loadmat

    chosen = choice_of(names, prefix)
    kinds, objects = _kinds(path)
    for name, matlab_class in objects.items():
        if (chosen(name) or _may_hold(names, name)) and not numbers_only:
            require_no_object(name, matlab_class)

    def load(variables: list[str]) -> dict[str, Any]:
        contents = loadmat(path, squeeze_me=True, struct_as_record=True, variable_names=variables)
        return dict(_flat({name: value for name, value in contents.items() if name in variables}))

    # Only variables that may hold a wanted column are loaded; others may be large or unreadable.
    columns = held = load([name for name in kinds if chosen(name) or _may_hold(names, name)])
    # What else there is, for the message.
    if len(homes_of(names or (), columns)) < len(names or ()):
        held = load([name for name, kind in kinds.items() if kind == "struct"])
    # Plain variables are offered in messages without being loaded.
    plain = [name for name, kind in kinds.items() if kind != "struct"]
    wanted = {name: value for name, value in columns.items() if chosen(name)}
    if numbers_only:
        # scipy gives text as str and a scalar as a number of Python, with squeezed axes.
        wanted = {n: v for n, v in wanted.items() if np.asarray(v).dtype.kind in "biuf"}
    return [*plain, *held], wanted


def _kinds(path: str) -> tuple[dict[str, str], dict[str, str]]:
    """Name of each variable -> its class; the same of objects of MATLAB, which hold no columns."""
    from scipy.io import loadmat, whosmat

    try:
        return {name: kind for name, _, kind in whosmat(path)}, {}
    except TypeError:
        # `whosmat` fails on MATLAB objects, which have no shape; `loadmat` reads such files.
        contents = {
            name: value for name, value in loadmat(path).items() if not name.startswith("__")
        }
    # scipy does not read the name of an object as that of its variable, but as part of its value.
    opaque = [value for value in contents.values() if type(value).__name__ == "MatlabOpaque"]
    objects = {_text(value["s0"]): _text(value["s2"]) for value in opaque}
    return {
        name: "struct" if _fields(value) else ""
        for name, value in contents.items()
        if type(value).__name__ != "MatlabOpaque"
    }, objects


def _text(value: Any) -> str:
    """Text in a field of an object, which scipy keeps as an array of bytes."""
    (text,) = value.ravel()[:1]
    return text.decode(errors="replace") if isinstance(text, bytes) else str(text)


def _fields(value: Any) -> tuple[str, ...] | None:
    """Names of the fields of a structure, None of anything else."""
    fields = getattr(getattr(value, "dtype", None), "names", None)
    # scipy keeps objects of MATLAB in a structured array of its own, whose fields are no columns.
    return None if type(value).__name__ == "MatlabOpaque" else fields


def _may_hold(names: Collection[str] | None, name: str) -> bool:
    """Whether something inside the structure `name` may be wanted."""
    inside = (f"{name}.", f"{name}[", f"{name}/")
    return names is None or any(wanted.startswith(inside) for wanted in names)


def _flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Columns of nested structures; those without elements or without fields hold none."""
    for name, value in values.items():
        fields = _fields(value)
        if fields is None:
            if not _is_empty_structure(value):
                yield f"{prefix}{name}", value
        elif value.size == 1:
            yield from _flat({field: value[field].item() for field in fields}, f"{prefix}{name}.")
        else:
            # MATLAB counts elements by columns.
            for k, element in enumerate(value.ravel(order="F")):
                yield from _flat(
                    {field: element[field] for field in fields}, f"{prefix}{name}[{k}]."
                )


def _is_empty_structure(value: Any) -> bool:
    """Whether scipy made this of a structure without fields, or of one that was never assigned."""
    if value is None:
        return True
    of_objects = getattr(getattr(value, "dtype", None), "kind", "") == "O"
    return of_objects and all(element is None for element in value.ravel())


def _require_bounded(path: str, max_bytes: int) -> None:
    """Refuse other formats than MAT v5, and a declared or expanded size above `max_bytes`."""
    with open(path, "rb") as file:
        head = file.read(128)
        # Bytes 124 to 127 are version and byte order.
        if head[124:128] not in (b"\x00\x01IM", b"\x01\x00MI"):
            raise RefusalError(
                "must be MAT version 5; its first 128 bytes are not. Save it with -v7 or -v6."
            )
        # "IM" is "MI" written with the low byte at the front.
        order = "<" if head[126:] == b"IM" else ">"
        total = 0
        size = os.path.getsize(path)
        # Each element starts with a tag of 8 bytes: type and length.
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            start = file.tell()
            if start + length > size:
                got = f"an element of {length} bytes goes beyond its end"
                raise RefusalError(f"must be complete; {got}. Write it again.")
            if kind == 15:  # miCOMPRESSED
                # The tag inside of the compressed element declares its expanded size.
                inner = zlib.decompressobj().decompress(file.read(min(length, 512)), 8)
                declared = 8 + struct.unpack(f"{order}II", inner)[1] if len(inner) == 8 else 0
                require_size(total + declared, max_bytes)
                file.seek(start)
                # The declared size may be a lie, so the element is expanded piece by piece and
                # counted.
                expanded = _expanded(file, length, declared)
            else:
                expanded = length
            total += expanded
            require_size(total, max_bytes)
            file.seek(start + length)


def _expanded(file: Any, length: int, declared: int) -> int:
    """Number of bytes that a compressed element expands to; refused above what it declares."""
    stream = zlib.decompressobj()
    total = 0
    while length > 0 and not stream.eof:
        # Small pieces bound the memory, whatever the ratio of compression.
        piece = file.read(min(length, 1 << 16))
        if not piece:
            break
        length -= len(piece)
        while piece and not stream.eof:
            total += len(stream.decompress(piece, 1 << 20))
            piece = stream.unconsumed_tail
            if total > declared + 8:  # padding
                raise RefusalError(
                    f"declares an element of {declared} bytes; it expands beyond them. Write it"
                    " again."
                )
    return total

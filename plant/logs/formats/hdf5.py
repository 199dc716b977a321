"""Reads HDF5 files by h5py; data sets are named ``group/name``, also in structures of MATLAB.

MATLAB 7.3 stores each field of an array of structures as references to hidden data sets, one per
element; the second element is named ``structure[1]/field``. It stores an object as keys of a table
that only MATLAB can read.
"""

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from .columns import (
    RefusalError,
    choice_of,
    homes_of,
    refusals_left_out,
    require_no_object,
    require_real,
    require_size,
)

# Classes of MATLAB whose data sets may hold numbers; "" stands for a data set without a class.
_NUMERIC = {"", "double", "single", "logical", "struct", "cell"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
# Most elements that the references of one file may lead to, and most levels of references inside
# references that are followed. Both numbers were chosen by hand.
_MAX_ELEMENTS = 10_000
_MAX_DEPTH = 4


def read(
    path: str,
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    numbers_only: bool = False,
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of an HDF5 file, or of a MAT file of version 7.3."""
    # This import is not at the top, since the child process limits its memory before it loads a
    # library.
    import h5py

    chosen = choice_of(names, prefix)
    with h5py.File(path, "r") as file:
        items: dict[str, Any] = {}
        # `visititems` follows neither soft nor external links.
        file.visititems(items.__setitem__)
        # Through an external link, h5py would open a file that the user did not name. Only a link
        # that the user wants is refused; the others are not followed.
        for link in _links(file, items):
            if chosen(link) or any(name.startswith(f"{link}/") for name in names or ()):
                got = f"{link!r} is a link to another file"
                raise RefusalError(f"must hold its own data; {got}. Copy it in, or choose others.")
        datasets: dict[str, Any] = {}
        elements = _Elements()
        wants = _wants(names, prefix)
        for name, item in items.items():
            # References that lead to no wanted column are not followed.
            depth = _MAX_DEPTH if wants(name) else 0
            with refusals_left_out(numbers_only):
                datasets.update(_datasets(file, {name: item}, depth, elements))
        homes = (
            {name: name for name in datasets if chosen(name)}
            if names is None
            else homes_of(names, datasets)
        )
        # A wanted column may belong to an object of MATLAB: the column `tt/Time` is no data set, so
        # that the data set of the object, `tt`, is checked.
        asked = [name.replace(".", "/") for name in names or ()]
        for name, item in datasets.items():
            if name in homes.values() or any(place.startswith(f"{name}/") for place in asked):
                with refusals_left_out(numbers_only):
                    _require_own_numbers(name, item)
                    continue
                homes = {column: home for column, home in homes.items() if home != name}
        wanted = {name: datasets[home] for name, home in homes.items()}
        # The sizes come from the headers. Data sets that would expand beyond `max_bytes` are
        # therefore refused before they are read.
        require_size(
            sum(math.prod(item.shape or ()) * item.dtype.itemsize for item in wanted.values()),
            max_bytes,
        )
        # MATLAB writes its arrays with the axes in reverse.
        return list(datasets), {
            n: item[()].T if "MATLAB_class" in item.attrs else item[()]
            for n, item in wanted.items()
        }


class _Elements:
    """Counts the elements that the references of a file lead to, at most `_MAX_ELEMENTS`."""

    def __init__(self) -> None:
        self._count = 0

    def add(self, count: int) -> None:
        """Refuse elements beyond the limit, before they are read."""
        if self._count + count > _MAX_ELEMENTS:
            raise RefusalError(
                f"must hold at most {_MAX_ELEMENTS} elements of structures in all; it has more."
                " Save arrays, or choose others with names=."
            )
        self._count += count


def _wants(names: Collection[str] | None, prefix: str) -> Callable[[str], bool]:
    """Predicate of the data sets that may hold a wanted column, or refer to it."""

    def place(text: str) -> str:
        # The references of `structure[1]/field` are in the data set `structure/field`.
        return re.sub(r"\[\d*\]?", "", text).replace(".", "/")

    if names is None:
        start = place(prefix)
        return lambda name: place(name).startswith(start) or start.startswith(place(name))
    places = [f"{place(name)}/" for name in names]
    return lambda name: any(wanted.startswith(f"{place(name)}/") for wanted in places)


def _datasets(
    file: Any, items: Mapping[str, Any], depth: int, elements: _Elements
) -> Iterator[tuple[str, Any]]:
    """Yield the names and data sets of `items`, and of what the references in them lead to."""
    import h5py

    for name, item in items.items():
        # The hidden groups of MATLAB hold what references lead to.
        if (
            not isinstance(item, h5py.Dataset)
            or name.startswith("#")
            or "MATLAB_empty" in item.attrs
        ):
            continue
        if h5py.check_ref_dtype(item.dtype) is None or not depth or _is_elsewhere(item):
            yield name, item
            continue
        # A null data set has no shape and no elements.
        if item.shape is None:
            continue
        elements.add(item.size)
        group, _, field = name.rpartition("/")
        # A cell array has an attribute MATLAB_class of its own; a field of an array of structures
        # has none.
        is_cell = "MATLAB_class" in item.attrs
        # `...` gives an array of a scalar data set, too.
        for k, reference in enumerate(item[...].ravel()):
            if not reference:
                continue
            place = f"{name}[{k}]" if is_cell else f"{group}[{k}]/{field}"
            element = file[reference]
            inside: dict[str, Any] = {"": element}
            if isinstance(element, h5py.Group):
                inside = {}
                element.visititems(inside.__setitem__)
                # Many references may lead to one large group.
                elements.add(len(inside))
            for inner, dataset in _datasets(file, inside, depth - 1, elements):
                yield f"{place}/{inner}" if inner else place, dataset


def _is_elsewhere(item: Any) -> bool:
    """Whether a data set keeps its bytes in another file: a virtual one, or by external storage."""
    return bool(item.is_virtual or item.external)


def _require_own_numbers(name: str, item: Any) -> None:
    """Refuse a data set in another file, an object of MATLAB, and anything but real numbers."""
    if _is_elsewhere(item):
        raise RefusalError(
            f"must hold its own data; column {name!r} points into another file. Copy it in."
        )
    matlab = item.attrs.get("MATLAB_class", b"")
    matlab_class = matlab.decode(errors="replace") if isinstance(matlab, bytes) else str(matlab)
    if matlab_class not in _NUMERIC or "MATLAB_object_decode" in item.attrs:
        require_no_object(name, matlab_class)
    require_real(name, item.dtype, item.dtype.kind in "biuf")


def _links(file: Any, items: dict[str, Any]) -> Iterator[str]:
    """Names of the links to other files; they are not followed."""
    import h5py

    for parent, group in {"": file, **items}.items():
        if isinstance(group, h5py.Group):
            for name in group:
                # `getlink` returns the link itself and does not open its target.
                if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
                    yield f"{parent}/{name}".lstrip("/")

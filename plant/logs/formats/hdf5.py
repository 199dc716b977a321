"""HDF5 files, by h5py; data sets are named ``group/name``."""

import math
from collections.abc import Collection, Iterator
from typing import Any

from .columns import RefusalError, choice_of, require_real, require_size


def read(
    path: str, names: Collection[str] | None, prefix: str, max_bytes: int
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of an HDF5 file, or of a MAT file of version 7.3."""
    # The child limits its memory before a library is loaded.
    import h5py

    chosen = choice_of(names, prefix)
    with h5py.File(path, "r") as file:
        items: dict[str, Any] = {}
        # `visititems` follows neither soft nor external links.
        file.visititems(items.__setitem__)
        datasets = {name: item for name, item in items.items() if isinstance(item, h5py.Dataset)}
        # An external link would read a file that the user did not name; only wanted links are
        # refused.
        for link in _links(file, items):
            if chosen(link) or any(name.startswith(f"{link}/") for name in names or ()):
                got = f"{link!r} is a link to another file"
                raise RefusalError(f"must hold its own data; {got}. Copy it in, or choose others.")
        wanted = {name: item for name, item in datasets.items() if chosen(name)}
        for name, item in wanted.items():
            # The bytes of such a data set lie in another file too.
            if item.is_virtual or item.external:
                raise RefusalError(
                    f"must hold its own data; column {name!r} points into another file. Copy it in."
                )
            require_real(name, item.dtype, item.dtype.kind in "biuf")
        # Sizes come from the headers, so a bomb is refused before it expands.
        require_size(
            sum(math.prod(item.shape or ()) * item.dtype.itemsize for item in wanted.values()),
            max_bytes,
        )
        # MATLAB writes its arrays with the axes in reverse.
        return list(datasets), {
            n: item[()].T if "MATLAB_class" in item.attrs else item[()]
            for n, item in wanted.items()
        }


def _links(file: Any, items: dict[str, Any]) -> Iterator[str]:
    """Names of the links to other files; they are not followed."""
    import h5py

    for parent, group in {"": file, **items}.items():
        if isinstance(group, h5py.Group):
            for name in group:
                # `getlink` returns the link itself and does not open its target.
                if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
                    yield f"{parent}/{name}".lstrip("/")

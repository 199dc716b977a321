"""Parquet files, by pyarrow: flat columns, and lists of one length, which are blocks."""

import os
from collections.abc import Collection
from typing import Any

import numpy as np

from .columns import (
    Block,
    RefusalError,
    choice_of,
    home_of,
    picked,
    refusals_left_out,
    require_real,
    require_size,
)


def read(
    path: str,
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    numbers_only: bool = False,
) -> tuple[list[str], dict[str, Any]]:
    """Names and wanted columns of a Parquet file; ``name[i]`` is one column of a list."""
    available, blocks = read_blocks(path, names, prefix, max_bytes, numbers_only)
    if names is None:
        return available, {name: block.values for name, block in blocks.items()}
    columns = {name: picked(name, blocks) for name in names}
    available += [element for name, block in blocks.items() for element in block.elements(name)]
    return available, {name: values for name, values in columns.items() if values is not None}


def read_blocks(
    path: str,
    names: Collection[str] | None,
    prefix: str,
    max_bytes: int,
    numbers_only: bool = False,
) -> tuple[list[str], dict[str, Block]]:
    """Names of all columns, and those of which something is wanted."""
    os.environ["ARROW_DEFAULT_MEMORY_POOL"] = "system"  # the others reserve more than they need
    import pyarrow as pa
    import pyarrow.parquet as pq

    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        schema = file.schema_arrow
        chosen = choice_of(None, prefix)
        # An element such as name[2] needs its whole list.
        homes = {home_of(name, schema.names) for name in names or ()}
        wanted = [
            name for name in schema.names if (chosen(name) if names is None else name in homes)
        ]
        for name in tuple(wanted):
            type_ = schema.field(name).type
            # The type of a list is that of its elements.
            kind = type_.value_type if _is_list(pa, type_) else type_
            types = pa.types
            is_real = types.is_integer(kind) or types.is_floating(kind) or types.is_boolean(kind)
            with refusals_left_out(numbers_only):
                require_real(name, type_, is_real)
                continue
            wanted.remove(name)
        # The footer declares the sizes, so a bomb is refused before it expands.
        require_size(max(_size(file.metadata, wanted), 0), max_bytes)
        # Threads would count against the address space of the child.
        table = file.read(columns=wanted, use_threads=False)
        return schema.names, {
            name: Block(_numbers(pa, name, table.column(name))) for name in wanted
        }


def _is_list(pa: Any, kind: Any) -> bool:
    return bool(
        pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    )


def _size(metadata: Any, wanted: Collection[str]) -> int:
    """Bytes of the wanted columns as they are declared, or of the largest group once expanded."""
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    total = 0
    for group in groups:
        # A list counts its elements; as float64 each takes 8 bytes.
        chunks = (group.column(i) for i in range(group.num_columns))
        total += 8 * sum(
            c.num_values for c in chunks if home_of(c.path_in_schema, wanted) is not None
        )
    # The largest of three bounds, since the footer of a corrupt file may contradict itself.
    return max(
        total, 8 * metadata.num_rows * len(wanted), *(group.total_byte_size for group in groups), 0
    )


def _numbers(pa: Any, name: str, column: Any) -> Any:
    """A column as an array (N,), or lists of one length as (N, k); a missing cell is NaN."""
    if not _is_list(pa, column.type):
        return column.to_numpy()
    import pyarrow.compute as pc

    # Lists are rows of an array only if all have one length; a missing list is a row of NaN.
    lengths = pc.list_value_length(column)
    present = lengths.is_valid().to_numpy()
    sizes = np.unique(lengths.drop_null().to_numpy())
    if len(sizes) != 1 or not sizes[0]:
        got = "no value" if not len(sizes) else f"{sizes.min()} to {sizes.max()} values"
        raise RefusalError(
            f"must hold lists of one length; got {got} per row in column {name!r}. Leave it out."
        )
    flat = pc.list_flatten(column).to_numpy().reshape(-1, int(sizes[0]))
    if present.all():
        return flat
    rows = np.full((len(present), int(sizes[0])), np.nan)
    rows[present] = flat
    return rows

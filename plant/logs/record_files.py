"""Class methods of `Record` that read mapped columns of a file, one for each format and all with the same keywords."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from plant.logs.logfile import load_errors, read_file
from plant.logs.mapping import mapped_names
from plant.machine.rig import Rig
from plant.parts.arguments import instance, known_options

__all__ = ["Reader", "read_mapped", "reader"]

T = TypeVar("T")
Reader: TypeAlias = Callable[..., T]
"""A class method with the keywords of `Record.from_csv`, and what it gives."""


def reader(kind: str, what: str) -> Any:
    """Class method that reads mapped columns of one format."""

    def read(cls, path, *, rig, columns, units=None, wrap=None, prefix="", law=None, reference=None, initial=None):
        log = {"columns": columns, "units": units, "wrap": wrap, "prefix": prefix}
        return read_mapped(cls, kind, path, rig=rig, law=law, reference=reference, initial=initial, **log)

    read.__name__, read.__qualname__ = f"from_{kind}", f"Record.from_{kind}"
    read.__doc__ = f"Read mapped columns of {what}. Keywords as in `from_csv`, mapping as in `from_table`."
    return classmethod(known_options(read))


def read_mapped(cls: Any, kind: str, path: str | Path, *, prefix: str, **log: Any) -> Any:
    """Read the columns that a mapping needs, and make a record of them.

    Raises
    ------
    ValueError
        A mapping that fits no file.
    LoadError
        Everything else.
    """
    names = mapped_names(log["columns"], log["units"])
    instance("rig", log["rig"], Rig, "Pass rig=.")
    with load_errors(path):
        return cls.from_table(read_file(kind, path, names, prefix), **log)

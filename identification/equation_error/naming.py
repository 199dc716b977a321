"""Which record a refusal is about: its place in the list, and its file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from plant import Record

__all__ = ["RecordError", "column_of", "each_named", "first_problem", "record_label"]


class RecordError(ValueError):
    """A refusal that says which record it is about."""


def record_label(records: Sequence[Record], k: int, what: str = "records") -> str:
    """What messages call one of several records, or a single one that was read from a file; "" of the only one."""
    name = f" ({records[k].name})" if records[k].name else ""
    return f"{what}[{k}]{name}" if len(records) > 1 else f"the record{name}" * bool(name)


def column_of(record: Record, field: str, joint: int) -> str:
    """The column of a signal and a joint in the file of a record, as a clause; "" where no mapping names it."""
    column = record.column(field, joint)
    return "" if column == field else f", {column},"


def first_problem(records: Sequence[Record]) -> str:
    """What the checkup of the records calls wrong first, as a sentence with the record's name; "" where nothing is."""
    for k, record in enumerate(records):
        checkup = record.check()
        for finding in checkup.problems:
            if finding.verdict == "wrong":
                joint = "" if finding.joint is None else f" of {checkup.joint_labels[finding.joint]}"
                label = record_label(records, k)
                return f" {f'{label}: ' if label else ''}{finding.check}{joint}: {finding.advice}"
    return ""


def each_named(records: Sequence[Record], what: str = "records") -> Iterator[tuple[Record, Any]]:
    """Each record, with a context in which every refusal is about that record, and says so."""
    for k, record in enumerate(records):
        yield record, _about(record_label(records, k, what))


@contextlib.contextmanager
def _about(label: str) -> Iterator[None]:
    try:
        yield
    except RecordError:
        raise
    except ValueError as error:
        raise RecordError(f"{label}: {error}" if label else str(error)) from error

"""Logs of experiments: the `Record`, and the readers of files that make one.

Reading order: `record`; `clock_times` -> `dialect` -> `text_table` (text of any separator and
heading); `isolation` (with `child`, a process for what may crash) -> `logfile` (any format as a
table) -> `unit_words`, `units`, `stated_units` -> `mapping` (columns as fields of a record);
`column_roles` -> `contents` (what a log without a mapping holds); `record_csv` (the library's own
format), `record_files` (the others), `resampling`.
"""

from plant.logs.clock_times import is_instant, nanoseconds
from plant.logs.contents import contents_of
from plant.logs.logfile import read_file
from plant.logs.mapping import mapped_names
from plant.logs.record import Record
from plant.logs.record_csv import is_own
from plant.logs.several import files_of, notes_of

__all__ = [
    "Record",
    "contents_of",
    "files_of",
    "is_instant",
    "is_own",
    "mapped_names",
    "nanoseconds",
    "notes_of",
    "read_file",
]

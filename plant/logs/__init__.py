"""Logs of experiments: the `Record`, and the readers of files that make one.

Reading order: `record`; `clock_times` -> `dialect` -> `text_table` (text of any separator and
heading); `isolation` (with `child`, a process for what may crash) -> `logfile` (any format as a
table) -> `unit_words`, `units`, `stated_units` -> `mapping` (columns as fields of a record);
`column_roles` -> `contents` (what a log without a mapping holds); `record_csv` (the library's own
format), `record_files` (the others), `resampling`.
"""

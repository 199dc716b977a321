"""Logs of experiments: the `Record`, and the readers of files that make one.

Reading order: `record`; `isolation` (with `child`, a process for what may crash) -> `logfile` (any
format as a table) -> `mapping`, `units` (columns as fields of a record); `record_csv` (the
library's own format), `record_files` (the others), `resampling`.
"""

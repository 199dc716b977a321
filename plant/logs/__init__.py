"""Files of logs: read safely, mapped to a record, resampled.

Reading order: `csv_rows`, `npz`, `isolation` (a child process for what may crash, `child`) -> `logfile` (any format as
a table) -> `mapping`, `units` (columns as fields of a record) -> `record_csv` (the library's own format),
`record_files` (the others), `resampling`.
"""

__all__: list[str] = []

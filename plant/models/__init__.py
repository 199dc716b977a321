"""Model files and robot files: their bytes edited in place, checked and repaired, read and written.

Read `edits` (new inertials in a URDF or MJCF file, all other bytes as they were); `check` (`check_model`), with
`hypotheses` (mistakes undone) and `evidence` (shapes, other sides); `robot_file` (`read_robot`, `write_robot`), with
`tables` (parts as tables), `lumping_table`, `meaning` and `toml_text`.
"""

__all__: list[str] = []

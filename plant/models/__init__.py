"""Model files and robot files: checked and repaired, edited in place, read and written.

Reading order: `check` (`check_model`) with `hypotheses` (inertials without each mistake; shapes,
other sides), `agreement` (the evidence for one of them) and `joints_stated` (degrees, millimetres);
`edits` (new inertials in a URDF or MJCF file, all other bytes as they were); `robot_file`
(`read_robot`, `write_robot`) with `tables` (parts as tables, TOML text), `arm_table` (the table
[arm]) and `new_robot` (a file to complete).
"""

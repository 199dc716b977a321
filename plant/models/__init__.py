"""Model files and robot files: their bytes edited in place, checked and repaired, read and written.

Read `edits` (new inertials in a URDF or MJCF file, all other bytes as they were); `check`
(`check_model`), with `hypotheses` (mistakes undone; shapes, other sides) and `agreement` (what
speaks for which); `robot_file` (`read_robot`, `write_robot`), with `tables` (parts as tables) and
`arm_table`.
"""

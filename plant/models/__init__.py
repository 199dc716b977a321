"""Model files and robot files: their bytes edited in place, checked and repaired, read and written.

Read `edits` (new inertials in a URDF or MJCF file, all other bytes as they were).
"""

__all__: list[str] = []

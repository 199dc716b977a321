"""References, what they demand of the drives, and which parameters their excitation identifies.

Read `reference`, then `table` and `scaled` (other references), `demand` (torques along a path), `fastest` (the
time-optimal motion) and `visibility` (identifiability).
"""

__all__: list[str] = []

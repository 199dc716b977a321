"""Evaluation of laws by simulation: tracking error in encoder pulses, torque, chatter, saturation.

Read `evaluation` (one law), `comparison` (several); `table` and `animation` show them.
"""

__all__: list[str] = []

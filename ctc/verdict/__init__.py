"""Evaluation of laws by simulation: tracking error in encoder pulses, torque, chatter, saturation.

Read `evaluation` (one law), `comparison` (several); `animation` shows them.
"""

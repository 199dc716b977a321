"""Evaluation of laws by simulation: tracking error in encoder pulses, torque, chatter, saturation.

Read `evaluation` (one law), `evaluations` (several motions, or laws); `animation` shows them.
`servos`: play, and profiles of servos. `floating`: the force of a hand that guides an arm.
"""

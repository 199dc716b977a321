"""Least squares on the torque equation, with logged torques or with those that the law commanded.

Read `filtering`, `regressor` (and measured torque), `least_squares`, `torque_fit`, then `pulse_fit`
(counts alone).
"""

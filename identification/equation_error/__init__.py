"""Least squares on the torque equation, with logged torques or with those that the law commanded.

Read `filtering`, `least_squares`, `torque_fit` (regressor and measured torque), then `pulse_fit` (from counts alone).
"""

__all__: list[str] = []

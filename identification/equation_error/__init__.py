"""Least squares on the torque equation, with logged torques or with those that the law commanded.

Read `filters`, `regressor` (and measured torque), `least_squares`, `torque_fit`, then `pulse_fit`
(counts alone) and `logged_torques` (`fit_torque`), whose band `band_choice` chooses. `restated`
(mistakes in columns and gravity, whatever f is) and `arm_check` (no arm has these f) test it.
"""

"""Least squares on the torque equation, with logged torques or with those that the law commanded.

Read `filters`, `regressor` (and measured torque), `least_squares`, `torque_fit`, then `pulse_fit`
(counts alone) and `logged_torques` (`fit_torque`): its `torque_equations`, the band that
`band_choice` chooses, and the friction that `logged_friction` tries. `restated` (mistakes in
columns and gravity, whatever f is: `stated_equation`, on a `leaning_base` too, and `restatements`),
`own_rows` (a user's hypotheses beside them) and `arm_check` (no arm has these f) test it.
"""

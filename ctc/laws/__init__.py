"""Control laws that hold a model of the arm: computed torque and its rivals.

Read `model_law` (their base), `observer`, `gears`, `friction_model`, `start_boost`, `delay_queue`
(the blocks of computed torque), `computed_torque`; `computed_torque_settings`, `default_gains` and
`gear_gains` have its numbers. Then `computed_torque_pid`, `feed_forward`, `adaptive`,
`sliding_mode` and `float` in any order.
"""

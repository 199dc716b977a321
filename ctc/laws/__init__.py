"""Control laws that hold a model of the arm: computed torque and its rivals.

Read `model_law` (what they share), `observer`, `computed_torque`; then `computed_torque_pid`,
`feed_forward`, `adaptive`, `sliding_mode` in any order.
"""

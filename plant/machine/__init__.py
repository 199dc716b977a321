"""The machine between controller and links: motors, gears, friction, encoders, delay, springs.

Read `drive` (and its `friction`, `drive_effects`, `elasticity`), `encoder` and `known_torque`
(springs), together the `rig`; `motor_inertia` is the lower bound of an arm's inertia matrix, and
`unlikely` finds wrong units.
"""

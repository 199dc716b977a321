"""The machine between controller and links: motors, gears, friction, encoders, delay, springs.

Read `drive` (and its `friction`, `drive_effects`, `elasticity`), `encoder` and `known_torque`
(springs), together the `rig`; `motor_inertia` is the bound that the rig puts on an arm's inertia
matrix.
"""

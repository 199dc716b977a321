"""What stands between a controller and the links: motors, gears, friction, encoders, delay; and springs.

Read `drive` (and its `friction`, `presliding`, joined by `friction_step`; `drive_effects`; `elasticity` with its
`spring`), `encoder` and `known_torque` (`joint_spring`, `counterbalance`), together the `rig`; `gear_torque` is what
winds the gears; `motor_inertia` is the bound that the rig puts on an arm's inertia matrix.
"""

"""What stands between a controller and the links: motors, gears, friction, encoders, delay.

Read `drive` (and its `friction`), `encoder` and `transport`, together the `rig`; `motor_inertia` is the bound that it
puts on an arm's inertia matrix.
"""

__all__: list[str] = []

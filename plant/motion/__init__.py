"""References, what they demand of the drives, and which parameters their excitation identifies.

Read `reference`, then `smooth` and `table` (references to start from), `link_reference` (of motors
for the sake of their links behind elastic gears), `demand` (torques along a path), `fastest` (the
time-optimal motion), `everyday` (what an arm does all day) and `visibility` (identifiability, also
of a load).
"""

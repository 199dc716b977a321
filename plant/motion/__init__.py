"""References, what they demand of the drives, and which parameters their excitation identifies.

Read `reference`, then `smooth` and `table` (references to start from), `link_reference` (of motors
for the sake of their links behind elastic gears), `demand` (torques along a path), `fastest` (the
time-optimal motion), `everyday` (what an arm does all day) and `visibility` (identifiability, also
of a load).
"""

from plant.motion.everyday import motions_of, naming, of_motion, slowing
from plant.motion.link_reference import gear_torque, require_elastic, wound
from plant.motion.reference import Motion, Reference, Scaled
from plant.motion.smooth import Harmonics, Spline
from plant.motion.smooth_splines import smooth_splines
from plant.motion.table import Held

__all__ = [
    "Harmonics",
    "Held",
    "Motion",
    "Reference",
    "Scaled",
    "Spline",
    "gear_torque",
    "motions_of",
    "naming",
    "of_motion",
    "require_elastic",
    "slowing",
    "smooth_splines",
    "wound",
]

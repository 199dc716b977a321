"""The machine between controller and links: motors, gears, friction, encoders, delay, springs.

Read `drive` (and its `friction`, `drive_effects`, `elasticity`), `encoder` and `known_torque`
(springs), together the `rig`; `motor_inertia` is the lower bound of an arm's inertia matrix, and
`unlikely` finds wrong units.
"""

from plant.machine.drive import Drive
from plant.machine.drive_effects import CurrentLag, LoadFriction, lagging
from plant.machine.elasticity import DAMPING_RATIO, FOLLOWED, gears, joined, reduced, spring
from plant.machine.encoder import Encoder, fix, nearest
from plant.machine.friction import (
    REGULARISATION,
    Bristles,
    bristle_impulse,
    friction_impulse,
    smooth_bristle_impulse,
    smooth_impulse,
)
from plant.machine.inner_loop import Frame, InnerLoop
from plant.machine.motor_inertia import (
    LEAST_MOTOR_INERTIA,
    least_inertia_margin,
    require_inertia,
    rotors_alone,
    shaft_inertias,
)
from plant.machine.rig import DRY_FRICTION, Rig, punctual_rig, sliding_rig, smooth_rig
from plant.machine.unlikely import SLOWEST, unlikely_statements

__all__ = [
    "DAMPING_RATIO",
    "DRY_FRICTION",
    "FOLLOWED",
    "LEAST_MOTOR_INERTIA",
    "REGULARISATION",
    "SLOWEST",
    "Bristles",
    "CurrentLag",
    "Drive",
    "Encoder",
    "Frame",
    "InnerLoop",
    "LoadFriction",
    "Rig",
    "bristle_impulse",
    "fix",
    "friction_impulse",
    "gears",
    "joined",
    "lagging",
    "least_inertia_margin",
    "nearest",
    "punctual_rig",
    "reduced",
    "require_inertia",
    "rotors_alone",
    "shaft_inertias",
    "sliding_rig",
    "smooth_bristle_impulse",
    "smooth_impulse",
    "smooth_rig",
    "spring",
    "unlikely_statements",
]

"""Evaluation of laws by simulation: tracking error in encoder pulses, torque, chatter, saturation.

Read `evaluation` (one law), `evaluations` (several motions, or laws); `animation` shows them.
`servos`: play, and profiles of servos. `floating`: the force of a hand that guides an arm.
"""

from ctc.verdict.evaluation import Evaluation
from ctc.verdict.evaluations import Comparison, evaluate
from ctc.verdict.on_gears import (
    HIGHEST,
    LOWEST,
    SETTLED,
    FromRest,
    LowestResonance,
    above,
    arm_of,
    damping_of,
    from_rest,
    gear_numbers,
    lowest_resonance,
    require_followed,
    require_swinging,
    with_gears,
)
from ctc.verdict.servos import in_play, slow_profiles

__all__ = [
    "HIGHEST",
    "LOWEST",
    "SETTLED",
    "Comparison",
    "Evaluation",
    "FromRest",
    "LowestResonance",
    "above",
    "arm_of",
    "damping_of",
    "evaluate",
    "from_rest",
    "gear_numbers",
    "in_play",
    "lowest_resonance",
    "require_followed",
    "require_swinging",
    "slow_profiles",
    "with_gears",
]

"""Before the identification: ranges, pulse budget, excitation, motor tests, frequency responses.

Each stands alone: `ranges` (3.6), `motor`, `budget` (Cramer-Rao bound), `excitation` (with the
limits and signals of `multisine`), `response` (with the resonances of `gear_resonances`).
"""

from identification.planning.budget import pulse_budget
from identification.planning.motor import MotorFit
from identification.planning.ranges import Interval, centre_range, greatest_inertia
from identification.planning.response import FrequencyResponse

__all__ = [
    "FrequencyResponse",
    "Interval",
    "MotorFit",
    "centre_range",
    "greatest_inertia",
    "pulse_budget",
]

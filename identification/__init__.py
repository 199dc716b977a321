"""Identification: from records of encoder pulses to the arm's inertial parameters f.

Dynamics + Record(s) -> Arm, the same arm with f found. The rooms, each above all that it imports:

================ ===================================================================================
`payload`        a load in the gripper, from logs (`find_load`) or a short window of them
`repeatability`  `spread` of the result over seeds (4.2)
`procedure`      `identify`: prepare, search, assess (3.2)
`results`        `Identification`, its warnings and figures; what contradicts the model; Figs. 10-11
`search`         the genetic algorithm (3.7), six methods behind one interface
`planning`       before the experiment: ranges (3.6), pulse budget, excitation, motor tests
`replay`         the experiment repeated: objective (4), prediction error, Gauss-Newton
`equation_error` least squares on the torque equation, from torques or from counts alone
================ ===================================================================================
"""

from importlib.util import find_spec
from pathlib import Path

# The packages of this project import each other by name: a `plant` of another distribution that
# comes first on the path would be imported silently, and fail later.
_home = Path(__file__).resolve().parent.parent
_found = find_spec("plant")
if _found is None or _found.origin is None or Path(_found.origin).resolve().parent.parent != _home:
    raise ImportError(
        f"package 'plant' must be beside {_home / 'identification'}; it would be imported from"
        f" {_found.origin if _found else 'nowhere'}. Uninstall the other distribution, or put"
        f" {_home} first."
    )

from identification.equation_error.logged_torques import fit_torque
from identification.equation_error.naming import RecordError
from identification.payload.logged_load import find_load
from identification.planning.budget import pulse_budget
from identification.planning.excitation import design_motion
from identification.planning.motor import motor_test
from identification.planning.ranges import LinkSize, ranges
from identification.planning.response import frequency_response
from identification.procedure import identify
from identification.repeatability import spread
from identification.replay.objective import Objective
from identification.replay.timing import without_delay
from identification.results.gears import find_gears
from identification.results.identification import Identification
from identification.results.model_files import write_model
from identification.results.oscillation import oscillation
from identification.results.physical import nearest_physical
from identification.results.summary import IdentificationWarning
from identification.results.urscript import to_urscript
from identification.search.genetic import GeneticSettings, minimize_genetic
from identification.search.problem import Tolerances
from plant.parts.arguments import known_options

# The genetic algorithm imports nothing of this project, so a misspelt setting is caught from here.
known_options(GeneticSettings)

__all__ = [
    "GeneticSettings",
    "Identification",
    "IdentificationWarning",
    "LinkSize",
    "Objective",
    "RecordError",
    "Tolerances",
    "design_motion",
    "find_gears",
    "find_load",
    "fit_torque",
    "frequency_response",
    "identify",
    "minimize_genetic",
    "motor_test",
    "nearest_physical",
    "oscillation",
    "pulse_budget",
    "ranges",
    "spread",
    "to_urscript",
    "without_delay",
    "write_model",
]

"""Identification: from records of pulses to the arm's parameters f.

Reading order: `experiment` (a record, ready to be repeated), `objective` (equation (4) of a whole population) ->
`ranges` (where to search, 3.6) -> `genetic` (the genetic algorithm, 3.7) -> `equation_error` (torques, by
`least_squares` behind `filtering`), `from_pulses` (the same from counts alone) -> `prediction` (prediction error),
`gauss_newton` (its least squares) -> `search`, `polish`, `methods` (seven ways, one interface), `identify` (the
procedure of 3.2), `result`, `trust` (what to mind about it), `plots` -> `quality` (can this log say anything?),
`budget` (what will a motion say?), `physical` (bodies that have these f), `load` (in the hand of a known arm),
`timing` (is the log late?), `oscillation` (Figs. 10-11), `motor` (gain and friction before the arm), `spread` (how
much the result varies, 4.2).
"""

from importlib.util import find_spec
from pathlib import Path

_home, _found = Path(__file__).resolve().parent.parent, find_spec("plant")
if _found is None or _found.origin is None or Path(_found.origin).resolve().parent.parent != _home:
    raise ImportError(
        f"package 'plant' must be beside {_home / 'identification'}; it would be imported from "
        f"{_found.origin if _found else 'nowhere'}. Uninstall the other distribution, or put {_home} first."
    )

from identification.budget import Budget, pulse_budget  # noqa: E402
from identification.equation_error import TorqueFit, fit_torque  # noqa: E402
from identification.excitation import design_motion  # noqa: E402
from identification.filtering import derivatives, low_pass  # noqa: E402
from identification.genetic import GeneticResult, GeneticSettings, minimize_genetic  # noqa: E402
from identification.identify import identify  # noqa: E402
from identification.load import Load, find_load  # noqa: E402
from identification.motor import MotorFit, friction_from_motor_test, gain_from_current  # noqa: E402
from identification.objective import Objective  # noqa: E402
from identification.oscillation import Oscillation, oscillation  # noqa: E402
from identification.physical import Physical, nearest_physical  # noqa: E402
from identification.ranges import Interval, LinkSize, puma560_ranges, ranges  # noqa: E402
from identification.result import Identification  # noqa: E402
from identification.spread import Spread, spread  # noqa: E402
from identification.timing import without_delay  # noqa: E402
from plant.check import known_options  # noqa: E402

# The genetic algorithm imports nothing of this project, so a misspelt setting is caught from here.
known_options(GeneticSettings)

__all__ = [
    "Budget", "GeneticResult", "GeneticSettings", "Identification", "Interval", "LinkSize", "Load", "MotorFit",
    "Objective", "Oscillation", "Physical", "Spread", "TorqueFit", "derivatives", "design_motion", "find_load",
    "fit_torque", "friction_from_motor_test", "gain_from_current", "identify", "low_pass", "minimize_genetic",
    "nearest_physical", "oscillation", "pulse_budget", "puma560_ranges", "ranges", "spread", "without_delay",
]  # fmt: skip

"""Checks of a log before it is used: does it agree with its rig and its control law?

Reading order: `hypothesis` (mistakes, their score and ranking) -> `finding` (one line per check and
joint, and their table) -> `innovation` (how far counts deviate from their motion) -> `signals` and
`torque_regression` (signals that need no model of the arm) -> `counts`, `lost_rows` and `stamps`
(rows that are no measurement, and their times) -> `quantisation` and `rounding` -> `along_log` (a
law, run along a log) -> `apparent_inertia` and `oscillation` (what swings in a loop) -> `filtered`,
`motor_equation` and `priors` (columns that one filter smooths; a motor's torque, regressed on them;
what is known of its coefficients) -> `score` (how likely a log is) -> `undo`, `evidence`,
`gain_units` and `without_arm` (mistakes undone; what shows them; gains in another unit; the table
of what can be wrong) -> `trials` (its rows, tried on a log) -> `views` (its causes as findings) ->
`examine` (`record.check()`: all checks of a record).
"""

from plant.checkup.apparent_inertia import share_of_rotors
from plant.checkup.counts import hardly_asked, hardly_moving, in_step, renumbered
from plant.checkup.examine import examine
from plant.checkup.finding import Check, Checkup
from plant.checkup.hypothesis import (
    Candidate,
    Cause,
    Hypothesis,
    Rival,
    SelectionSettings,
    beside,
    each_joint,
    pairs,
    ranking,
    require_rows,
    select,
    whole,
)
from plant.checkup.innovation import LEAST_MOTION, SETTINGS, acceleration, longest_line
from plant.checkup.lost_rows import BRIDGED, bridged, lost_rows, off_reference, on_lines, short_gaps
from plant.checkup.motor_equation import Equation, Motion
from plant.checkup.oscillation import own_oscillations, spectrum
from plant.checkup.quantisation import STEP_NOTE, comb
from plant.checkup.rounding import fix_seen, rounding_doubts
from plant.checkup.score import Experiment
from plant.checkup.signals import Signals
from plant.checkup.stamps import time_findings
from plant.checkup.trials import Trials
from plant.checkup.undo import (
    counts_in_time,
    exchanged_torques,
    turned_joint,
    turned_reference,
    turned_torque,
    zero_shifted,
)
from plant.checkup.without_arm import TABLE

__all__ = [
    "BRIDGED",
    "LEAST_MOTION",
    "SETTINGS",
    "STEP_NOTE",
    "TABLE",
    "Candidate",
    "Cause",
    "Check",
    "Checkup",
    "Equation",
    "Experiment",
    "Hypothesis",
    "Motion",
    "Rival",
    "SelectionSettings",
    "Signals",
    "Trials",
    "acceleration",
    "beside",
    "bridged",
    "comb",
    "counts_in_time",
    "each_joint",
    "examine",
    "exchanged_torques",
    "fix_seen",
    "hardly_asked",
    "hardly_moving",
    "in_step",
    "longest_line",
    "lost_rows",
    "off_reference",
    "on_lines",
    "own_oscillations",
    "pairs",
    "ranking",
    "renumbered",
    "require_rows",
    "rounding_doubts",
    "select",
    "share_of_rotors",
    "short_gaps",
    "spectrum",
    "time_findings",
    "turned_joint",
    "turned_reference",
    "turned_torque",
    "whole",
    "zero_shifted",
]

"""What every description is made of: parts with named numbers, and checks of what a user gives.

Read `part` (named numbers, copies, descriptions; `fields` are their types), `settings` (numbers
with usual values) and `arguments` (the checks); then `saved` (files of parts and results: `kinds`
finds their classes, `plain` makes plain data of them, `saved` makes text of it, `files` writes it
whole) and `checkpoint` (finished stages of long work); `csv_rows` (numbers of a text file),
`checked_function` (casadi with checked shapes), `labels` (names of joints), `sums` (in a fixed
order) and `frozen` (results that compare). What a user sees: `tables` (text of 80 columns), `shown`
(results as text and as HTML) and `figures` (axes, colours, legends).

What most rooms need of it is exported here.
"""

from plant.parts.arguments import array, choice, instance, known_options, near, real, signs, whole
from plant.parts.checkpoint import Checkpoint
from plant.parts.fields import Bools, Floats, Integers, Nested, Vector
from plant.parts.frozen import Frozen, frozen
from plant.parts.kinds import kept
from plant.parts.messages import TURNS, JointUnits, ProgressBar, progress_bar, warn
from plant.parts.part import Part, number, part, structure
from plant.parts.saved import Saved
from plant.parts.settings import Settings, frozen_settings
from plant.parts.shown import Aside, Piece, Shown, Verdict, Warned
from plant.parts.tables import (
    Table,
    by_joint,
    heading,
    largest,
    largest_cell,
    significant,
    with_units,
)
from plant.parts.vector import Fields, per_joint, scalars

__all__ = [
    "TURNS",
    "Aside",
    "Bools",
    "Checkpoint",
    "Fields",
    "Floats",
    "Frozen",
    "Integers",
    "JointUnits",
    "Nested",
    "Part",
    "Piece",
    "ProgressBar",
    "Saved",
    "Settings",
    "Shown",
    "Table",
    "Vector",
    "Verdict",
    "Warned",
    "array",
    "by_joint",
    "choice",
    "frozen",
    "frozen_settings",
    "heading",
    "instance",
    "kept",
    "known_options",
    "largest",
    "largest_cell",
    "near",
    "number",
    "part",
    "per_joint",
    "progress_bar",
    "real",
    "scalars",
    "significant",
    "signs",
    "structure",
    "warn",
    "whole",
    "with_units",
]

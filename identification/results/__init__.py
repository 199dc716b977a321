"""Results of an identification: values, warnings, contradictions, figures, bodies, model files.

Read `identification` (the result), `diagnostics` (how well it repeats the records, and the mean of
records that disagree), `summary` (its text), `trust` (warnings) and `plots`. Contradictions:
`with_arm` (one row per cause), `alternatives` (score tests), `along_log` and `law_torques` (torques
that a model may lack), `refits` (fits of one more cause), `stepwise` (selection), `detection` (the
result), `model_error` (bias of the values), and `equation_error.restated`. Assumptions: `assumed`
(sensitivities), `seen` (range of the logs, priors). `physical`, `gears`, `oscillation` and
`urscript` stand alone. `model_files` writes inertials back (`nearest_bodies`: the search).
"""

from identification.results.alternatives import Sign
from identification.results.assumed import Assumed
from identification.results.detection import Detection
from identification.results.diagnostics import Diagnostics
from identification.results.gears import Gears
from identification.results.identification import Identification, covariance_of_f
from identification.results.law_torques import cut_off
from identification.results.model_error import consider, priors
from identification.results.model_files import WrittenModel
from identification.results.nearest_bodies import Block, nearest_realisation
from identification.results.oscillation import mode_spans
from identification.results.physical import Physical
from identification.results.plots import INTERVALS, draw_intervals, repeated
from identification.results.seen import (
    Seen,
    by_tolerances,
    combinations_of,
    counted,
    drifting,
    of_prior,
    origins,
    seen,
)
from identification.results.stepwise import detect
from identification.results.summary import (
    SummarySettings,
    doubts,
    explained_torque,
    notes,
    verdict_of,
    warn_of_doubts,
)
from identification.results.trust import inseparable, of_statements, pairs_of
from identification.results.with_arm import NUMBERS

__all__ = [
    "INTERVALS",
    "NUMBERS",
    "Assumed",
    "Block",
    "Detection",
    "Diagnostics",
    "Gears",
    "Identification",
    "Physical",
    "Seen",
    "Sign",
    "SummarySettings",
    "WrittenModel",
    "by_tolerances",
    "combinations_of",
    "consider",
    "counted",
    "covariance_of_f",
    "cut_off",
    "detect",
    "doubts",
    "draw_intervals",
    "drifting",
    "explained_torque",
    "inseparable",
    "mode_spans",
    "nearest_realisation",
    "notes",
    "of_prior",
    "of_statements",
    "origins",
    "pairs_of",
    "priors",
    "repeated",
    "seen",
    "verdict_of",
    "warn_of_doubts",
]

"""Least squares on the torque equation, with logged torques or with those that the law commanded.

Read `filters`, `regressor` (and measured torque), `least_squares`, `torque_fit`, then `pulse_fit`
(counts alone) and `logged_torques` (`fit_torque`): its `torque_equations`, the band that
`band_choice` chooses, and the friction that `logged_friction` tries. `restated` (mistakes in
columns and gravity, whatever f is: `stated_equation`, on a `leaning_base` too, with the main gain
of a law, `law_gains`, left open, and `restatements`; after `checked_up`, a checkup without an arm),
`own_rows` (a user's hypotheses beside them) and `arm_check` (no arm has these f) test it.
"""

from identification.equation_error.arm_check import FittedArm
from identification.equation_error.band_choice import FitTrial, choose_band
from identification.equation_error.between_runs import (
    ONE_LOG,
    BetweenRuns,
    between_runs,
    further_logs,
    runs_agree,
)
from identification.equation_error.bounds import bounded
from identification.equation_error.checked_up import checkup_of, misread
from identification.equation_error.estimate import Estimate
from identification.equation_error.excitation import advice, from_prior, still, unexcited
from identification.equation_error.filters import BAND_MOST, CUTOFF, derivatives, low_pass
from identification.equation_error.friction_trial import FrictionTrial, gain
from identification.equation_error.gear_fit import (
    GearFit,
    GearFitSettings,
    fit_deflection,
    fit_gears,
    record_band,
)
from identification.equation_error.law_gains import SMALL, own_numbers, with_numbers
from identification.equation_error.law_memory import (
    FADED,
    Memory,
    Resumption,
    along_log,
    at_work,
    closed,
    passes_start,
    reading,
    with_state,
)
from identification.equation_error.least_squares import (
    IDENTIFIABLE,
    NORMAL,
    SEGMENTS,
    NotIdentifiableError,
    along,
    at_least,
    covariance_of,
    directions,
    group_std,
    in_groups,
    least_squares,
    run_std,
    wider,
)
from identification.equation_error.logged_torques import fit_torque
from identification.equation_error.naming import (
    RecordError,
    column_of,
    each_named,
    held_out,
    of_each,
    record_label,
    short_names,
    units,
)
from identification.equation_error.own_rows import ranked_own_rows
from identification.equation_error.possible_bodies import (
    PointMasses,
    boxes_of,
    nearest_amounts,
    with_possible_bodies,
)
from identification.equation_error.prior import ROUNDING, Known, Prior, PriorRows
from identification.equation_error.pulse_fit import (
    NO_BAND,
    equation_error,
    fit_systems,
    mode_in,
    modes_along,
    over_bands,
    pass_band,
    path_in,
    system_of,
)
from identification.equation_error.random_effects import differing, restricted
from identification.equation_error.regressor import (
    LINEAR,
    SPRINGS,
    Filtering,
    Places,
    System,
    balance,
    linear,
    regressor_along,
    regressor_and_torque,
)
from identification.equation_error.restated import (
    HYPOTHESES,
    Mistakes,
    contradictions,
    mistakes_of,
    restated,
    wrong_statements,
)
from identification.equation_error.stated_equation import TorqueEquation
from identification.equation_error.stated_law import (
    begun,
    law_differs,
    likelier_variant,
    noise_of_torque,
    told_by_torque,
    torque_apart,
)
from identification.equation_error.torque_error import PredictsTorque, torque_error
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import (
    between_samples,
    evened,
    is_faster,
    measured_torque,
    torque_of,
)
from identification.equation_error.torque_noise import independent_noise, white_noise
from identification.equation_error.two_encoders import Deflections, Wound, fit_wound

__all__ = [
    "BAND_MOST",
    "CUTOFF",
    "FADED",
    "HYPOTHESES",
    "IDENTIFIABLE",
    "LINEAR",
    "NORMAL",
    "NO_BAND",
    "ONE_LOG",
    "ROUNDING",
    "SEGMENTS",
    "SMALL",
    "SPRINGS",
    "BetweenRuns",
    "Deflections",
    "Estimate",
    "Filtering",
    "FitTrial",
    "FittedArm",
    "FrictionTrial",
    "GearFit",
    "GearFitSettings",
    "Known",
    "Memory",
    "Mistakes",
    "NotIdentifiableError",
    "Places",
    "PointMasses",
    "PredictsTorque",
    "Prior",
    "PriorRows",
    "RecordError",
    "Resumption",
    "System",
    "TorqueEquation",
    "TorqueFit",
    "Wound",
    "advice",
    "along",
    "along_log",
    "at_least",
    "at_work",
    "balance",
    "begun",
    "between_runs",
    "between_samples",
    "bounded",
    "boxes_of",
    "checkup_of",
    "choose_band",
    "closed",
    "column_of",
    "contradictions",
    "covariance_of",
    "derivatives",
    "differing",
    "directions",
    "each_named",
    "equation_error",
    "evened",
    "fit_deflection",
    "fit_gears",
    "fit_systems",
    "fit_torque",
    "fit_wound",
    "from_prior",
    "further_logs",
    "gain",
    "group_std",
    "held_out",
    "in_groups",
    "independent_noise",
    "is_faster",
    "law_differs",
    "least_squares",
    "likelier_variant",
    "linear",
    "low_pass",
    "measured_torque",
    "misread",
    "mistakes_of",
    "mode_in",
    "modes_along",
    "nearest_amounts",
    "noise_of_torque",
    "of_each",
    "over_bands",
    "own_numbers",
    "pass_band",
    "passes_start",
    "path_in",
    "ranked_own_rows",
    "reading",
    "record_band",
    "record_label",
    "regressor_along",
    "regressor_and_torque",
    "restated",
    "restricted",
    "run_std",
    "runs_agree",
    "short_names",
    "still",
    "system_of",
    "told_by_torque",
    "torque_apart",
    "torque_error",
    "torque_of",
    "unexcited",
    "units",
    "weighted",
    "white_noise",
    "wider",
    "with_numbers",
    "with_possible_bodies",
    "with_state",
    "wrong_statements",
]

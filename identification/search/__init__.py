"""Methods of identification: the genetic algorithm of 3.7, and Gauss-Newton from good starts.

Read `problem` (their input), `outcome` (their output), `methods`, `polish` (start and fit), then
`memory` (laws with a memory), `elastic` (elastic gears) and `predictive` (does the model explain
the log?). `genetic` stands alone.
"""

from identification.search.genetic import (
    GeneticSettings,
    crossover,
    decode,
    encode,
    migrate,
    minimize_genetic,
    mutate,
    rank_linear,
    rank_nonlinear,
    reinsert,
    select,
)
from identification.search.memory import (
    as_repeated,
    as_tested,
    placed,
    repeating,
    run_again,
    with_memory,
)
from identification.search.methods import METHODS, prediction_error, triangular_root
from identification.search.outcome import Fit, GearResonance, Outcome, Search
from identification.search.polish import (
    FIT,
    by_stages,
    fit_of,
    from_inside,
    start_of_fit,
    torque_fit,
    with_undetermined,
)
from identification.search.predictive import (
    FALSE_ALARM,
    ROUGH,
    ROUNDINGS,
    Predicted,
    doubtful,
    exceeded_value,
    in_open_loop,
    predicted,
    simulated_record,
)
from identification.search.problem import (
    LONG,
    PARTS,
    Problem,
    Tolerances,
    in_parts,
    is_long,
    rows_of_parts,
)

__all__ = [
    "FALSE_ALARM",
    "FIT",
    "LONG",
    "METHODS",
    "PARTS",
    "ROUGH",
    "ROUNDINGS",
    "Fit",
    "GearResonance",
    "GeneticSettings",
    "Outcome",
    "Predicted",
    "Problem",
    "Search",
    "Tolerances",
    "as_repeated",
    "as_tested",
    "by_stages",
    "crossover",
    "decode",
    "doubtful",
    "encode",
    "exceeded_value",
    "fit_of",
    "from_inside",
    "in_open_loop",
    "in_parts",
    "is_long",
    "migrate",
    "minimize_genetic",
    "mutate",
    "placed",
    "predicted",
    "prediction_error",
    "rank_linear",
    "rank_nonlinear",
    "reinsert",
    "repeating",
    "rows_of_parts",
    "run_again",
    "select",
    "simulated_record",
    "start_of_fit",
    "torque_fit",
    "triangular_root",
    "with_memory",
    "with_undetermined",
]

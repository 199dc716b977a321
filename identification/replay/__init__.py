"""The experiment repeated with other numbers: objective (4), prediction error, their least squares.

Read `experiment`, `objective`; then `residual` (the protocol of a fit), `followed`, `prediction`
(innovations), `weak_directions` (what readings do not determine), `gauss_newton` and
`whole_deviations` (a covariance that holds over its deviations); `timing` is a use of them.
`resonances` is a prediction in other coordinates, `profile_likelihood` the interval of one of them.
`extended` is a prediction with what its rig leaves out, `optimum` its least sum of squares.
"""

from identification.replay.experiment import RATES, as_records, with_zeros
from identification.replay.extended import Extended, Number, joint_of, kind_of
from identification.replay.followed import FollowedSettings
from identification.replay.gauss_newton import (
    DEPENDENT,
    Solution,
    ended_on_bounds,
    gauss_newton,
    noise,
    reweighed,
    slopes,
    variance_inflation,
)
from identification.replay.objective import Objective, squared_error
from identification.replay.optimum import Optimum, Trial, backlash, compliance, fitted, nearest
from identification.replay.prediction import Prediction
from identification.replay.profile_likelihood import Profile
from identification.replay.residual import Batched, Reparametrised, WithPrior
from identification.replay.resonances import (
    DAMPING,
    INFLATION,
    STIFFNESS,
    Resonances,
    Start,
    link_inertia,
    on_gears,
)
from identification.replay.timing import delay_of, is_late, without_delay
from identification.replay.weak_directions import with_weak_directions
from identification.replay.whole_deviations import over_whole_deviations

__all__ = [
    "DAMPING",
    "DEPENDENT",
    "INFLATION",
    "RATES",
    "STIFFNESS",
    "Batched",
    "Extended",
    "FollowedSettings",
    "Number",
    "Objective",
    "Optimum",
    "Prediction",
    "Profile",
    "Reparametrised",
    "Resonances",
    "Solution",
    "Start",
    "Trial",
    "WithPrior",
    "as_records",
    "backlash",
    "compliance",
    "delay_of",
    "ended_on_bounds",
    "fitted",
    "gauss_newton",
    "is_late",
    "joint_of",
    "kind_of",
    "link_inertia",
    "nearest",
    "noise",
    "on_gears",
    "over_whole_deviations",
    "reweighed",
    "slopes",
    "squared_error",
    "variance_inflation",
    "with_weak_directions",
    "with_zeros",
    "without_delay",
]

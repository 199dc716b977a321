"""Equation error: the measured torque against regressor times unknowns, by weighted least squares.

tau = Y(q, qd, qdd) f + friction(qd) is linear in f and in the linear numbers of the drive
(`drive.viscous[0]`, `drive.coulomb[0]`, `drive.curve.offset[0]`), so one weighted least-squares fit
finds them all (`identification.equation_error.regressor`).

Source: M. Gautier, Dynamic identification of robots with power model, ICRA 1997 (parallel filtering
and decimation).
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.band_choice import FitTrial
from identification.equation_error.between_runs import BetweenRuns, between_runs
from identification.equation_error.bounds import bounded, brakes
from identification.equation_error.friction_trial import FrictionTrial
from identification.equation_error.least_squares import (
    SEGMENTS,
    at_least,
    covariance_of,
    group_std,
    least_squares,
)
from identification.equation_error.prior import Prior
from identification.equation_error.regressor import Places, System
from identification.equation_error.torque_error import Further, PredictsTorque, TorqueError
from identification.equation_error.torque_summary import summary_of, warnings_of
from plant import Arm, Dynamics, Reference, Rig
from plant.checkup import Cause
from plant.parts import Floats, Frozen, Integers, Piece, Shown, choice, frozen, norm, product


@frozen
class TorqueFit(PredictsTorque, Shown, Frozen):
    """Values of f and of linear numbers of the drive, fitted to torques.

    Attributes
    ----------
    dynamics : Dynamics
        The equations, whose f is fitted.
    names : tuple of str
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
        Of the values: of white noise, no less than how they differ between segments of the logs,
        and the variance between logs (`spread <../background/intervals>`). What the model lacks
        everywhere alike comes on top.
    noise_covariance : (k, k) numpy.ndarray
        From the variance of each joint's residual alone, taken as white after decimation.
    sigma : (n,) numpy.ndarray
        Standard deviation of each joint's residual [N m]; the weights of the fit are 1 / sigma, or
        as stated. NaN of a joint without equations.
    relative_error : float
        Length of the residual over length of the torque, all rows that were used; the torque of
        known numbers is part of it.
    rows : int
        Equations that were used.
    condition : float
        Condition number of the weighted columns, scaled to one length.
    known : dict of str to float
        Numbers that were stated and not fitted.
    freed : dict of str to (float, float)
        Estimate of a known number that is fitted like the unknowns, and its standard deviation;
        without numbers that are not separately identifiable.
    left_out : dict of str to str
        Joint -> reason for which its equations were not used.
    cutoff, band : float or None
        Low-pass before differentiation, and pass band in which both sides were compared [Hz].
    every : tuple of int
        Of each log, one row out of so many was used.
    least_speed : (n,) numpy.ndarray or None
        Joint speed below which equations were left out [rad/s].
    bands : tuple of FitTrial
        Trials on which the choice of the band rests, narrowest first; empty where it was stated.
    least_speeds : tuple of FitTrial
        The same of the least speed, most cautious first.
    between : BetweenRuns or None
        How two logs or more agree, and what their differences add to the covariance.
    friction : tuple of FrictionTrial
        Kinds of friction beside the fitted ones, by their prediction of blocks kept aside, best
        first; none where no Coulomb friction is unknown. They are reported, not fitted.
    rising : FrictionTrial or None
        Coulomb friction that rises with speed, as fitted, where blocks kept aside ask for it.
    bodies : (float, float)
        How much less the squared error on blocks kept aside is beside the chain's own bodies as a
        prior: share, and standard errors; NaN without such bodies, where the logs alone tell more
        of all f, and of a stated prior.
    prior : Prior or None
        Of f: the stated one, or the chain's own bodies where blocks kept aside ask for them.
    causes : tuple of Cause
        Mistakes in columns or gravity that contradict the equation of motion, whatever f is; the
        likeliest first.
    doubts : tuple of str
        Why these f are those of no arm, or of another rig; see `FittedArm`.
    free : dict of str to float
        Friction that would be negative without its bound, and is 0 or follows from one that is:
        name -> its estimate without bounds. Its standard deviation is that of the free estimate.
    rig : Rig or None
        Of the first log, with the fitted and the known friction.
    extra : dict of str to callable
        Further columns, as they were given.
    path : Reference or None
        Of the first log.
    error : TorqueError or None
        On the fit's own logs, as `error_on` has it on others; None where they are too short.
    """

    dynamics: Dynamics
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    noise_covariance: Floats
    sigma: Floats
    relative_error: float
    rows: int
    condition: float
    known: Mapping[str, float] = field(default_factory=dict)
    freed: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    cutoff: float | None = None
    band: float | None = None
    every: tuple[int, ...] = ()
    least_speed: Floats | None = None
    bands: tuple[FitTrial, ...] = ()
    least_speeds: tuple[FitTrial, ...] = ()
    between: BetweenRuns | None = None
    friction: tuple[FrictionTrial, ...] = ()
    rising: FrictionTrial | None = None
    bodies: tuple[float, float] = (np.nan, np.nan)
    prior: Prior | None = None
    causes: tuple[Cause, ...] = ()
    doubts: tuple[str, ...] = ()
    free: Mapping[str, float] = field(default_factory=dict)
    rig: Rig | Any = None
    path: Reference | None = None
    error: TorqueError | None = None
    extra: Mapping[str, Callable[..., ArrayLike]] = field(default_factory=dict)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names (k) of the values."""
        return self.names

    @property
    def arm(self) -> Arm:
        """The arm with these f, for `replay`, `nearest_physical` and computed torque."""
        return self.dynamics.arm(self.f)

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance (m, m) of numbers by their names; zero of numbers that were not fitted."""
        return covariance_of(names, self.names, self.covariance)

    @property
    def further(self) -> Further:
        """Further columns, and their values."""
        return {name: (column, self[name]) for name, column in self.extra.items()}

    @property
    def f(self) -> Floats:
        """All of f (p,), found or known, in the order of the dynamics."""
        return np.array([self[name] for name in self.dynamics.names])

    @property
    def std(self) -> Floats:
        """Standard deviations (k,) of the values."""
        return np.sqrt(np.diag(self.covariance))

    def __getitem__(self, name: str) -> float:
        """Value of one name, found or known."""
        if name in self.known:
            return self.known[name]
        return self.values[self.names.index(choice("a name of this fit", name, self.names))]

    def _short(self) -> str:
        return (
            f"{len(self.names)} values, {self.rows} equations, relative torque error"
            f" {self.relative_error:.2%}"
        )

    def _shown(self) -> Iterator[Piece]:
        yield from summary_of(self)

    @property
    def warnings(self) -> list[str]:
        """Doubts about the fit, one line each, at most three: causes before their effects."""
        return warnings_of(self)


def weighted(
    dynamics: Dynamics,
    names: tuple[str, ...],
    systems: Iterable[System],
    weights: Floats | None = None,
    seconds: Floats | None = None,
    prior: tuple[Floats, Floats] | None = None,
    braking: bool = False,
    **report: Any,
) -> TorqueFit:
    """Least squares of one or more logs' equations.

    `names`: of the columns. `systems`: one per record. `weights` (R, n): of each record and joint,
    up to a common factor; by default 1 over a joint's residual in an unweighted fit. `seconds`
    (R,): length of each log: the covariance counts how its segments, and logs, differ. `prior`:
    rows (m, k) and target (m,) of further equations, of standard deviation 1. `braking`: whether
    friction must not be negative. `report`: further fields of the result.
    """
    # 1. The equations of all logs.
    systems = tuple(systems)
    regressor = np.concatenate([system.regressor for system in systems])
    torque = np.concatenate([system.torque for system in systems])
    used = np.concatenate([system.used for system in systems])
    if used.sum() <= len(names):
        raise ValueError(
            f"a fit of {len(names)} numbers needs more equations; {used.sum()} are left. "
            "Log longer, move faster, or lower least_speed or every."
        )
    places = Places.of(systems)
    joint = places.joint
    rows = regressor[used]
    target = torque[used]

    # 2. Values, with the weights of the previous round's residual. A prior has a scale of its own,
    # so that the weights decide the values, and more rounds are needed; it starts from torques that
    # are all noise.
    weight = np.ones(len(target)) if weights is None else weights[places.record, joint]
    if prior is not None:
        weight /= norm(weight * target) / np.sqrt(len(target))
    # Residuals give the weights, and weights the residuals: the first round has equal weights, the
    # second those of its scatter.
    rounds = 2 if weights is None else 1
    if prior is not None:
        rounds += 2
    for _ in range(rounds):
        columns, torques = _with_prior(prior, rows * weight[:, None], target * weight)
        values, covariance, condition = least_squares(names, columns, torques)
        residual = target - product(rows, values)
        # Degrees of freedom that remain, per equation.
        freedom = 1 - len(values) / len(target)
        sigma = _deviations(residual, joint, torque.shape[1], freedom)
        # A joint without a residual, as in a noiseless log, must not have an infinite weight.
        if weights is None:
            weight = 1 / np.maximum(sigma, 1e-9 * np.abs(target).max())[joint]
        elif prior is not None:
            # Stated weights lack a factor, which decides how much the prior counts.
            scatter = norm(weight * residual) / np.sqrt(freedom * len(target))
            weight /= max(scatter, 1e-9 * np.abs(weight * target).max())
    metric = covariance

    # 3. Stated weights need not be the inverse noise: the covariance is White's, with the scatter
    # of each log and joint, and of a prior its own.
    if weights is not None:
        group = places.record * torque.shape[1] + joint
        spread = _deviations(residual, group, weights.size, freedom)
        scores = rows * (weight**2 * spread.reshape(weights.shape)[places.record, joint])[:, None]
        if prior is not None:
            scores = np.vstack([scores, prior[0]])
        covariance = covariance @ product(scores.T, scores) @ covariance
    noise = covariance

    # 4. Residuals are no white noise: the covariance is at least that by segments, and of several
    # logs that by their differences.
    between = None
    if seconds is not None:
        columns = rows * weight[:, None]
        remaining = residual * weight
        between, covariance = _by_segments(
            names, values, covariance, columns, remaining, places, seconds, prior
        )

    # 5. Friction that is not negative. The deviations are those of the free fit: an upper bound.
    free = dict[str, float]()
    if braking:
        nearest = bounded(values, metric, brakes(names))
        if nearest is not values:
            below = brakes(names) & (values < 0)
            free = {names[i]: float(values[i]) for i in np.flatnonzero(below)}
            values, residual = nearest, target - product(rows, nearest)
            sigma = _deviations(residual, joint, torque.shape[1], freedom)
    # Relative to the measured torque with the part of the known numbers: else a fit of little
    # unknown would look poor.
    measured = [system.torque if system.measured is None else system.measured for system in systems]
    length = norm(np.concatenate(measured)[used])
    return TorqueFit(
        dynamics=dynamics,
        names=names,
        values=values,
        covariance=covariance,
        noise_covariance=noise,
        sigma=sigma,
        between=between,
        relative_error=float(norm(residual) / length),
        rows=len(target),
        condition=condition,
        free=free,
        **report,
    )


def _with_prior(
    prior: tuple[Floats, Floats] | None, columns: Floats, torques: Floats
) -> tuple[Floats, Floats]:
    """Columns (M, k) and torques (M,) with the rows of a prior below them, if there is one."""
    if prior is None:
        return columns, torques
    rows, target = prior
    return np.vstack([columns, rows]), np.append(torques, target)


def _by_segments(
    names: tuple[str, ...],
    values: Floats,
    covariance: Floats,
    columns: Floats,
    remaining: Floats,
    places: Places,
    seconds: Floats,
    prior: tuple[Floats, Floats] | None,
) -> tuple[Any, Floats]:
    """How several logs differ, or None, and the covariance that counts segments and logs.

    `columns` (m, k) and `remaining` (m,): the weighted equations and what is left of them.
    """
    # A log without an equation is no run.
    heard, runs = np.unique(places.record, return_inverse=True)
    # Several segments per log; equations of one segment may correlate.
    blocks = places.segments(seconds, SEGMENTS * len(seconds))[0]
    # Numbered without gaps: a segment may have no equation.
    blocks = np.unique(blocks, return_inverse=True)[1]
    if prior is not None:
        # Rows of no log, which are in every fit of the others.
        columns = np.vstack([columns, prior[0]])
        remaining = np.append(remaining, prior[1] - product(prior[0], values))
        none = np.full(len(prior[1]), -1)
        runs, blocks = np.append(runs, none), np.append(blocks, none)
    if len(heard) == 1:
        return None, at_least(covariance, group_std(columns, remaining, blocks))
    between, covariance = between_runs(names, values, covariance, columns, remaining, runs, blocks)
    each = np.full((2, len(seconds), len(values)), np.nan)
    each[:, heard] = between.values, between.std
    return replace(between, values=each[0], std=each[1]), covariance


def _deviations(residual: Floats, group: Integers, groups: int, freedom: float) -> Floats:
    """Standard deviation of the residual in each group (groups,); NaN of an empty one."""
    deviations = np.full(groups, np.nan)
    for g in np.unique(group):
        deviations[g] = np.sqrt(np.mean(residual[group == g] ** 2) / freedom)
    return deviations

"""Equation error: the measured torque against regressor times unknowns, by weighted least squares.

tau = Y(q, qd, qdd) f + friction(qd) is linear in f and in the linear numbers of the drive
(`drive.viscous[0]`, `drive.coulomb[0]`, `drive.curve.offset[0]`), so one weighted least-squares fit
finds them all (`identification.equation_error.regressor`).

Source: M. Gautier, Dynamic identification of robots with power model, ICRA 1997 (parallel filtering
and decimation).
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.band_choice import FitTrial
from identification.equation_error.between_runs import ONE_LOG, BetweenRuns, between_runs
from identification.equation_error.friction_trial import FrictionTrial
from identification.equation_error.least_squares import SEGMENTS, at_least, group_std, least_squares
from identification.equation_error.naming import short_names
from identification.equation_error.regressor import Places, System
from plant import Dynamics
from plant.parts.arguments import choice
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Aside, Piece, Shown, Verdict, Warned, inside
from plant.parts.sums import norm, product
from plant.parts.tables import Table

# relative torque error above which something is wrong with the log rather than with the arm
_POOR = 0.3

_APART = 4.0  # standard deviations of a log by which f, which is the arm's, may differ between logs
# Standard deviations, and share of the larger, by which a known number differs from what the
# torques ask for where it is doubted.
_DOUBTED = 5.0
_OTHERWISE = 0.2


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TorqueFit(Shown, Frozen):
    """What a fit of the torque found.

    Attributes
    ----------
    dynamics : Dynamics
        What its names of f mean.
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
        Length of the residual over length of the torque, all rows that were used; what is known is
        part of the torque.
    rows : int
        Equations that were used.
    condition : float
        Condition number of the weighted columns, scaled to one length.
    known : dict of str to float
        What was not searched but given.
    freed : dict of str to (float, float)
        What the torques ask for where this one of the known numbers is not taken as known, and its
        standard deviation; without those that they do not tell from the unknowns.
    left_out : dict of str to str
        Joint -> why its equations were not used.
    cutoff, band : float or None
        Low-pass before differentiation, and pass band in which both sides were compared [Hz].
    every : tuple of int
        Of each log, one row out of so many was used.
    least_speed : (n,) numpy.ndarray or None
        Joint speed below which equations were left out [rad/s].
    bands : tuple of FitTrial
        What the choice of the band rests on, narrowest first; empty where the band was stated.
    least_speeds : tuple of FitTrial
        The same of the least speed, most cautious first.
    between : BetweenRuns or None
        How two logs or more agree, and what their differences add to the covariance.
    friction : tuple of FrictionTrial
        Kinds of friction beyond what is fitted, by what they predict of blocks kept aside, best
        first; none where no Coulomb friction is unknown. They are told, not fitted.
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
    known: Mapping[str, float] = dataclasses.field(default_factory=dict)
    freed: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    left_out: Mapping[str, str] = dataclasses.field(default_factory=dict)
    cutoff: float | None = None
    band: float | None = None
    every: tuple[int, ...] = ()
    least_speed: Floats | None = None
    bands: tuple[FitTrial, ...] = ()
    least_speeds: tuple[FitTrial, ...] = ()
    between: BetweenRuns | None = None
    friction: tuple[FrictionTrial, ...] = ()

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
        said = (
            f"{self.rows} equations, relative torque error {self.relative_error:.2%}, condition"
            f" {self.condition:.0f}"
        )
        yield Verdict(said, not self.warnings)
        yield Warned(self.warnings)
        found = zip(short_names(self.dynamics, self.names), self.values, self.std, strict=True)
        rows = [(name, f"{value:.5g}", f"+- {std:.2g}") for name, value, std in found]
        yield Table(
            (),
            rows + [(name, f"{value:.5g}", "known") for name, value in self._short_known()],
            words=(2,),
        )
        yield from (f"left out: {joint}, {why}" for joint, why in self.left_out.items())
        yield from choices(self)
        yield from (
            f"of other friction, the nearest to help is {trial}"
            for trial in self.friction[:1]
            if not trial.clear
        )
        yield from [ONE_LOG] if self.between is None else inside(self.between)
        yield Aside("What the parameters mean", self.dynamics.legend.splitlines())

    def _short_known(self) -> list[tuple[str, float]]:
        return list(zip(short_names(self.dynamics, self.known), self.known.values(), strict=True))

    @property
    def warnings(self) -> list[str]:
        """What looks wrong, one line each."""
        negative = [
            name
            for name, value in zip(self.names, self.values, strict=True)
            if name.startswith(("drive.viscous", "drive.coulomb")) and value < 0
        ]
        found = (
            [f"friction must not be negative; check signs and units ({', '.join(negative)})"]
            if negative
            else []
        )
        if self.relative_error > _POOR:
            found.append(
                f"{self.relative_error:.0%} of the torque is not explained; check units (rad, joint"
                " side N m), signs and the order of the joints"
            )
        found += [trial.advice for trial in self.friction[:1] if trial.clear]
        if self.between is not None and (apart := self.between.groups.get("f", 0.0)) > _APART:
            why = (
                "the model lacks something, or a load (find_load), or another robot; fit each alone"
            )
            found.append(f"the logs differ in f by {apart:.2g} standard deviations of one: {why}")
        for (label, value), name in zip(self._short_known(), self.known, strict=True):
            asked, std = self.freed.get(name, (value, 0.0))
            if abs(asked - value) > max(_DOUBTED * std, _OTHERWISE * max(abs(asked), abs(value))):
                found.append(
                    f"{label} is stated as {value:.4g}, but these torques ask for {asked:.4g} +-"
                    f" {std:.2g}: check it, its unit and its sign"
                )
        return found


def choices(fit: TorqueFit) -> Iterator[Piece]:
    """How band and least speeds were chosen; nothing where they were stated."""
    if fit.bands:
        yield (
            f"band {fit.band:g} Hz, chosen by torques of segments left out, compared in narrower"
            " bands:"
        )
        yield _trials(fit.bands)
    if fit.least_speeds and fit.least_speed is not None:
        speeds = ", ".join(f"{speed:.3g}" for speed in fit.least_speed)
        yield f"least speeds {speeds} rad/s, chosen in the same way, compared at higher speeds:"
        yield _trials(fit.least_speeds)


def _trials(trials: Iterable[FitTrial]) -> Table:
    return Table(
        ("", "equations", "standard errors", "against", ""),
        [trial.row for trial in trials],
        words=(4,),
    )


def weighted(
    dynamics: Dynamics,
    names: tuple[str, ...],
    systems: Iterable[System],
    weights: Floats | None = None,
    seconds: Floats | None = None,
    prior: tuple[Floats, Floats] | None = None,
    **report: Any,
) -> TorqueFit:
    """Least squares of one or more logs' equations.

    `names`: of the columns. `systems`: one per record. `weights` (R, n): of each record and joint,
    up to a common factor; by default 1 over a joint's residual in an unweighted fit. `seconds`
    (R,): length of each log: the covariance counts how its segments, and logs, differ. `prior`:
    rows (m, k) and target (m,) of further equations, of standard deviation 1. `report`: further
    fields of the result.
    """
    systems = tuple(systems)
    regressor, torque, used = (
        np.concatenate([getattr(system, part) for system in systems])
        for part in ("regressor", "torque", "used")
    )
    if used.sum() <= len(names):
        raise ValueError(
            f"a fit of {len(names)} numbers needs more equations; {used.sum()} are left. "
            "Log longer, move faster, or lower least_speed or every."
        )
    places = Places.of(systems)
    joint = places.joint
    rows = regressor[used]
    target = torque[used]
    weight = np.ones(len(target)) if weights is None else weights[places.record, joint]
    if prior is not None:  # torques that are all noise, to begin with
        weight /= norm(target) / np.sqrt(len(target))
    for _ in range((2 if weights is None else 1) + (2 if prior is not None else 0)):
        given = rows * weight[:, None], target * weight
        if prior is not None:
            given = np.vstack([given[0], prior[0]]), np.append(given[1], prior[1])
        values, covariance, condition = least_squares(names, *given)
        residual = target - product(rows, values)
        freedom = 1 - len(values) / len(target)  # degrees of freedom that are left, per equation
        sigma = _deviations(residual, joint, torque.shape[1], freedom)
        if weights is None:
            weight = 1 / np.maximum(sigma, 1e-9 * np.abs(target).max())[joint]
    if weights is not None:
        spread = _deviations(
            residual, places.record * torque.shape[1] + joint, weights.size, freedom
        )
        scores = rows * (weight**2 * spread.reshape(weights.shape)[places.record, joint])[:, None]
        covariance = covariance @ product(scores.T, scores) @ covariance
    whole = [each.torque if each.measured is None else each.measured for each in systems]
    length = norm(np.concatenate(whole)[used])
    noise = covariance
    between = None
    if seconds is not None:
        by_weight = rows * weight[:, None], residual * weight
        blocks = places.segments(seconds, SEGMENTS * len(seconds))[0]
        if len(seconds) > 1:
            blocks = np.unique(blocks, return_inverse=True)[1]
            between, covariance = between_runs(
                names, values, covariance, *by_weight, places.record, blocks
            )
        else:
            covariance = at_least(covariance, group_std(*by_weight, blocks))
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
        **report,
    )


def _deviations(residual: Floats, group: NDArray[np.intp], groups: int, freedom: float) -> Floats:
    """Standard deviation of the residual in each group (groups,); NaN of an empty one."""
    found = np.full(groups, np.nan)
    for g in np.unique(group):
        found[g] = np.sqrt(np.mean(residual[group == g] ** 2) / freedom)
    return found

"""What `find_load` found, and what should be known before the mass is trusted."""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error.least_squares import NORMAL
from identification.payload.load_search import LoadSearch
from identification.search.outcome import Fit
from identification.search.problem import Problem
from plant import Arm, Rig
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict, Warned
from plant.parts.tables import Table

# RMS innovation [pulses] above which more than rounding is left: 1.2 times 0.289
_EXPLAINED = 0.347

_BY_CHANCE = 4.0  # standard deviations of chi-square above its mean from which on it is not chance

# Share of a range within which a value lies at its end; standard deviations below zero from which
# on a mass is called negative; and Birge ratio from which on logs are said to differ.
_AT_END = 1e-6
_NEGATIVE = 2.0
_APART = 2.0


def birge(runs: Sequence[tuple[float, float]]) -> float:
    """Root of chi-square per degree of freedom of some masses; 0 of less than two."""
    told = [(mass, std) for mass, std in runs if np.isfinite(mass)]
    if len(told) < 2:
        return 0.0
    masses, stds = np.array(told).T
    mean = np.average(masses, weights=stds**-2)
    return float(np.sqrt((((masses - mean) / stds) ** 2).sum() / (len(told) - 1)))


def warnings_of(
    search: LoadSearch,
    fit: Fit,
    problem: Problem,
    std: Floats,
    runs: tuple[tuple[float, float], ...],
    friction: float | None,
    square: float,
    freedom: int,
) -> Iterator[str]:
    """Lines about a fit."""
    bounds = search.bounds(problem)
    values = fit.values
    for name, value, own, (low, high) in zip(fit.unknown, values, std, bounds, strict=True):
        if own > 0 and min(value - low, high - value) <= _AT_END * max(1.0, abs(value)):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} bound, {value:.4g}; intervals do not count that."
    if values[0] < -_NEGATIVE * std[0]:
        yield (
            "the mass is negative; the known arm is heavier than that of the log, or a sign or a"
            " unit is wrong."
        )
    if (fit.rms_innovation or 0.0) > _EXPLAINED:
        yield (
            f"rounding does not explain the fit: RMS innovation {fit.rms_innovation:.2f} pulses,"
            " rounding alone gives 0.29; arm, gears or friction differ from the model, and the"
            " mass may be off by more than its interval."
        )
    hidden = [
        name
        for name, own in zip(fit.unknown, std, strict=True)
        if own == 0 and name.startswith("drive.")
    ]
    if friction is None and hidden:
        yield (
            f"{', '.join(hidden)} is not identifiable from these logs, and was taken from the rig."
        )
    if friction is not None:
        said = "as exact" if friction == 0 else f"within {friction:.0%}"
        yield (
            f"friction was taken from the rig, {said}; leave friction out to find it beside the"
            " load."
        )
    if square > freedom + _BY_CHANCE * np.sqrt(2 * freedom):
        yield (
            f"no load on this arm explains the logs: chi-square {square:.0f} of {freedom}; arm,"
            " gears or friction differ from the model. The deviation counts that as if it were"
            " noise."
        )
    if search.covariance.any() and not freedom:
        yield (
            "the logs do not tell all of f: what is uncertain of the identified arm is not in the"
            " interval."
        )
    if birge(runs) > _APART:
        masses = ", ".join(f"{mass:.4g} +- {own:.2g}" for mass, own in runs)
        yield (
            f"the records alone differ more than their deviations: {masses} kg; the deviation"
            " counts that."
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Load(Shown, Frozen):
    """A load on the last link, or another one. Print it.

    Attributes
    ----------
    mass, std : float
        [kg]
    arm : Arm
        The known arm with this load.
    rms_innovation : float
        Root mean square of the innovations [pulses]; rounding alone gives 0.289.
    com, com_std : (3,) numpy.ndarray
        Centre of mass in the frame of the link's body [m]; NaN along an axis that is not
        identifiable from the torques. Of a given position it is that, with a deviation of 0.
    names : tuple of str
        Of all that was unknown: ``mass``, ``com[i]``, numbers of friction.
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
    rig : Rig
        Of the first record, with the friction that was found.
    runs : tuple of (float, float)
        Mass and standard deviation of each record alone [kg]; empty of a single one.
    chi_square, freedom : float, int
        By how much an arm with any f follows the logs better, and its degrees of freedom: about as
        many, by chance. NaN and 0 where the logs do not tell all of f, so that nothing was tested.
    warnings : tuple of str
        What should be known before the mass is trusted, one line each.
    """

    mass: float
    std: float
    arm: Arm
    rms_innovation: float
    com: Floats
    com_std: Floats
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    rig: Rig
    runs: tuple[tuple[float, float], ...] = ()
    chi_square: float = np.nan
    freedom: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def interval(self) -> Floats:
        """That holds the mass with 95 % (2,) [kg]."""
        return self.mass + NORMAL * self.std * np.array([-1.0, 1.0])

    def _short(self) -> str:
        count = len(self.warnings)
        return (
            f"{self.mass:.4g} +- {self.std:.2g}"
            f" kg{f', {count} warning' * bool(count)}{'s' * (count > 1)}"
        )

    def _shown(self) -> Iterator[Piece]:
        low, high = self.interval
        said = f"mass {self.mass:.4g} +- {self.std:.2g} kg, 95 % from {low:.4g} to {high:.4g}"
        yield Verdict(said, not self.warnings)
        where = [
            f"{axis} {at:.4g} +- {std:.2g}" if np.isfinite(at) else f"{axis} is not identifiable"
            for axis, at, std in zip("xyz", self.com, self.com_std, strict=True)
        ]
        yield f"centre of mass [m]: {', '.join(where)}"
        std = np.sqrt(np.diag(self.covariance))
        yield Table(
            (),
            [
                (name, f"{self.values[i]:.4g}", f"+- {std[i]:.2g}" if std[i] > 0 else "known")
                for i, name in enumerate(self.names)
                if name.startswith("drive.")
            ],
            words=(2,),
        )
        yield from (
            f"record {k} alone: {mass:.4g} +- {own:.2g} kg"
            for k, (mass, own) in enumerate(self.runs)
        )
        tested = (
            f"chi-square {self.chi_square:.1f} of {self.freedom}" if self.freedom else "not tested"
        )
        yield f"test of another arm in place of a load: {tested}"
        yield f"RMS innovation {self.rms_innovation:.3f} pulses (rounding alone gives 0.289)"
        yield Warned(self.warnings)

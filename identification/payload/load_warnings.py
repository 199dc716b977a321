"""What should be known before the mass of a load is trusted."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from identification.payload.load_search import LoadSearch
from identification.search.outcome import Fit
from identification.search.problem import Problem

_EXPLAINED = 0.347
"""RMS innovation [pulses] above which more than rounding is left: 1.2 times 0.289."""

_BY_CHANCE = 4.0
"""Standard deviations of chi-square above its mean from which on it is not chance."""

_AT_END, _NEGATIVE, _APART = 1e-6, 2.0, 2.0
"""Share of a range within which a value lies at its end; standard deviations below zero from which on a mass is called
negative; and Birge ratio from which on logs are said to differ."""


def birge(runs: Sequence[tuple[float, float]]) -> float:
    """Root of chi-square per degree of freedom of some masses; 0 of less than two."""
    told = [(mass, std) for mass, std in runs if np.isfinite(mass)]
    if len(told) < 2:
        return 0.0
    masses, stds = np.array(told).T
    mean = np.average(masses, weights=stds**-2)
    return float(np.sqrt((((masses - mean) / stds) ** 2).sum() / (len(told) - 1)))


def warnings_of(
    search: LoadSearch, fit: Fit, problem: Problem, std: NDArray[np.float64], runs: tuple[tuple[float, float], ...],
    friction: float | None, square: float, freedom: int,
) -> Iterator[str]:  # fmt: skip
    """Lines about a fit."""
    bounds, values = search.bounds(problem), fit.values
    for name, value, own, (low, high) in zip(fit.unknown, values, std, bounds, strict=True):
        if own > 0 and min(value - low, high - value) <= _AT_END * max(1.0, abs(value)):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} bound, {value:.4g}; intervals do not count that."
    if values[0] < -_NEGATIVE * std[0]:
        yield "the mass is negative; the known arm is heavier than that of the log, or a sign or a unit is wrong."
    if (fit.rms_innovation or 0.0) > _EXPLAINED:
        yield (
            f"rounding does not explain the fit: RMS innovation {fit.rms_innovation:.2f} pulses, rounding alone gives "
            "0.29; arm, gears or friction differ from the model, and the mass may be off by more than its interval."
        )
    hidden = [name for name, own in zip(fit.unknown, std, strict=True) if own == 0 and name.startswith("drive.")]
    if friction is None and hidden:
        yield f"{', '.join(hidden)} does not show in these logs, and was taken from the rig."
    if friction is not None:
        said = "as exact" if friction == 0 else f"within {friction:.0%}"
        yield f"friction was taken from the rig, {said}; leave friction out to find it beside the load."
    if square > freedom + _BY_CHANCE * np.sqrt(2 * freedom):
        yield (
            f"no load makes of this arm what the logs show: chi-square {square:.0f} of {freedom}; arm, gears or "
            "friction differ from the model. The deviation counts that as if it were noise."
        )
    if search.covariance.any() and not freedom:
        yield "the logs do not tell all of f: what is uncertain of the identified arm is not in the interval."
    if birge(runs) > _APART:
        masses = ", ".join(f"{mass:.4g} +- {own:.2g}" for mass, own in runs)
        yield f"the records alone differ more than their deviations: {masses} kg; the deviation counts that."

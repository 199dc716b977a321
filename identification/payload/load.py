"""Result of `find_load`: the load, its intervals, and warnings about them."""

from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error import NORMAL
from identification.payload.load_search import LoadSearch
from identification.search import Fit, Problem
from plant import Arm, Rig
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    Warned,
    frozen,
    frozen_settings,
)


@frozen_settings
class LoadWarningSettings:
    """Limits at which `find_load` warns.

    Chosen by hand; ``tests/benchmarks/find_load.py`` counts the loads with a warning.

    Parameters
    ----------
    explained : float
        RMS innovation that rounding explains [pulses]: 1.2 times 0.289, that of rounding alone.
    by_chance : float
        Standard deviations of chi-square above its mean that chance explains.
    at_end : float
        Distance from the end of a range within which a value lies on that end, as a share of the
        value, or of 1 if that is larger.
    negative : float
        Standard deviations below zero at which a mass is negative.
    apart : float
        Birge ratio above which the logs differ.
    """

    # What the model with a load does not explain.
    explained: float = 0.347
    by_chance: float = 4.0
    # Values and logs that contradict what the user states.
    at_end: float = 1e-6
    negative: float = 2.0
    apart: float = 2.0


WARNING = LoadWarningSettings()


def birge(runs: Sequence[tuple[float, float]]) -> float:
    """Birge ratio: root of chi-square per degree of freedom of masses; 0 of fewer than two."""
    fitted = [(mass, std) for mass, std in runs if np.isfinite(mass)]
    if len(fitted) < 2:
        return 0.0
    # Weighted by their deviations, equal masses give a ratio of about 1.
    masses, stds = np.array(fitted).T
    mean = np.average(masses, weights=stds**-2)
    return float(np.sqrt((((masses - mean) / stds) ** 2).sum() / (len(fitted) - 1)))


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
    """Warnings about a fit, one line each.

    `std` (k,): of its values. `runs`: mass and deviation of each record alone. `friction`: relative
    tolerance of friction that was taken from the rig; None where it was fitted. `square`,
    `freedom`: chi-square, and its degrees of freedom, by which another arm explains the logs.
    """
    # 1. Values that the range determined, not the log.
    bounds = search.bounds(problem)
    values = fit.values
    for name, value, deviation, (low, high) in zip(fit.unknown, values, std, bounds, strict=True):
        distance = min(value - low, high - value)
        if deviation > 0 and distance <= WARNING.at_end * max(1.0, abs(value)):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} bound, {value:.4g}; its interval leaves that out."
    if values[0] < -WARNING.negative * std[0]:
        yield (
            "the mass is negative; the known arm is heavier than the arm of the log, or a sign or"
            " a unit is wrong."
        )

    # 2. Effects that the model lacks.
    if (fit.rms_innovation or 0.0) > WARNING.explained:
        yield (
            f"rounding does not explain the fit: RMS innovation {fit.rms_innovation:.2f} pulses,"
            " rounding alone gives 0.29; arm, gears or friction differ from the model, and the"
            " mass may be off by more than its interval."
        )

    # 3. Friction that did not come from the log.
    hidden = [
        name
        for name, deviation in zip(fit.unknown, std, strict=True)
        if deviation == 0 and name.startswith("drive.")
    ]
    # Without `friction` the user expects that it is fitted; the other case has its own warning.
    if friction is None and hidden:
        yield (
            f"{', '.join(hidden)} is not identifiable from these logs, and was taken from the rig."
        )
    if friction is not None:
        tolerance = "as exact" if friction == 0 else f"within {friction:.0%}"
        yield (
            f"friction was taken from the rig, {tolerance}; leave friction out to find it beside"
            " the load."
        )

    # 4. Contradictions: another arm, and logs that differ.
    # The variance of chi-square is twice its degrees of freedom.
    if square > freedom + WARNING.by_chance * np.sqrt(2 * freedom):
        yield (
            f"no load on this arm explains the logs: chi-square {square:.0f} of {freedom}; arm,"
            " gears or friction differ from the model. The standard deviation includes that as if"
            " it were noise."
        )
    # Without degrees of freedom the covariance of the arm was not propagated to the load.
    if search.covariance.any() and not freedom:
        yield (
            "the logs do not determine all of f: the interval does not include the uncertainty of"
            " the identified arm."
        )
    if birge(runs) > WARNING.apart:
        masses = ", ".join(f"{mass:.4g} +- {deviation:.2g}" for mass, deviation in runs)
        yield (
            f"the masses of single records differ by more than their deviations: {masses} kg; the"
            " standard deviation of the mass includes that."
        )


@frozen
class Load(Shown, Frozen):
    """Mass and centre of mass of a load on a link, and the arm with it. Print it.

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
        identifiable from the torques. A given position has a deviation of 0.
    names : tuple of str
        Of the unknowns: ``mass``, ``com[i]``, numbers of friction.
    values : (k,) numpy.ndarray
    covariance : (k, k) numpy.ndarray
    rig : Rig
        That of the first record, with the fitted friction.
    runs : tuple of (float, float)
        Mass and standard deviation of each record alone [kg]; empty of a single one.
    chi_square, freedom : float, int
        By how much an arm with any f follows the logs better than this arm with a load, as a
        chi-square, and its degrees of freedom: about as much chance alone gives. NaN and 0 where
        nothing was tested, since the logs do not determine all of f.
    warnings : tuple of str
        Reasons for which the mass may be wrong, one line each.
    """

    # The load and the arm with it.
    mass: float
    std: float
    arm: Arm
    rms_innovation: float
    com: Floats
    com_std: Floats
    # All fitted numbers.
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    rig: Rig
    # Evidence that the interval is right.
    runs: tuple[tuple[float, float], ...] = ()
    chi_square: float = np.nan
    freedom: int = 0
    warnings: tuple[str, ...] = ()

    @property
    def interval(self) -> Floats:
        """95 % interval (2,) of the mass [kg]."""
        return self.mass + NORMAL * self.std * np.array([-1.0, 1.0])

    def _short(self) -> str:
        text = f"{self.mass:.4g} +- {self.std:.2g} kg"
        count = len(self.warnings)
        if count:
            text += f", {count} warning{'s' * (count > 1)}"
        return text

    def _shown(self) -> Iterator[Piece]:
        low, high = self.interval
        verdict = f"mass {self.mass:.4g} +- {self.std:.2g} kg, 95 % from {low:.4g} to {high:.4g}"
        yield Verdict(verdict, not self.warnings)
        # NaN stands for an axis without influence on any torque.
        centre = [
            f"{axis} {x:.4g} +- {std:.2g}" if np.isfinite(x) else f"{axis} is not identifiable"
            for axis, x, std in zip("xyz", self.com, self.com_std, strict=True)
        ]
        yield f"centre of mass [m]: {', '.join(centre)}"
        friction = []
        for name, value, variance in zip(
            self.names, self.values, np.diag(self.covariance), strict=True
        ):
            if name.startswith("drive."):
                # The variance of a number that the rig states exactly is zero.
                deviation = f"+- {np.sqrt(variance):.2g}" if variance > 0 else "known"
                friction.append((name, f"{value:.4g}", deviation))
        yield Table((), friction, words=(2,))
        for k, (mass, std) in enumerate(self.runs):
            yield f"record {k} alone: {mass:.4g} +- {std:.2g} kg"
        # The chi-square of an arm whose f the logs do not determine has no meaning.
        test = "not tested"
        if self.freedom:
            test = f"chi-square {self.chi_square:.1f} of {self.freedom}"
        yield f"test of another arm in place of a load: {test}"
        yield f"RMS innovation {self.rms_innovation:.3f} pulses (rounding alone gives 0.289)"
        yield Warned(self.warnings)

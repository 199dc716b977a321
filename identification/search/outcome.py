"""What a method of identification gives back: the fit, and how it came about."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.law_memory import Resumption
from identification.search.gear_resonance import GearResonance
from identification.search.genetic import GeneticResult, GeneticSettings
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown
from plant.parts.tables import Table

for _each in (GeneticSettings, GeneticResult, Resumption):  # they know nothing of files
    kept(_each)


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Fit(Shown, Frozen):
    """The values of the unknowns, and how well they are known.

    Attributes
    ----------
    unknown : tuple of str
        Names of what was searched.
    values : (k,) numpy.ndarray
    candidates : (C, k) numpy.ndarray
        Vectors that repeat the records as well as the values do, but for the noise of objective (4), best first; the
        values alone where a method tries no others. ``Uncertainty(plants=...)`` takes them for want of a covariance.
    covariance : (k, k) numpy.ndarray or None
        Of the values; None where the method provides none. It counts noise, scaled by the innovations and their
        autocorrelation, and what the rig may state wrongly: see `Tolerances`.
    noise_covariance : (k, k) numpy.ndarray or None
        What of it noise alone makes, if the rig is exact.
    rms_innovation : float or None
        Root mean square of the innovations [pulses]: counted positions minus their one-step predictions. Rounding alone
        gives 0.289.
    fallback_reason : str or None
        Why the values are not those of the last fit; its covariance then says nothing of them.
    zeros : (R, n) numpy.ndarray or None
        Where the joints of each record are when its counters say zero [rad], if that was unknown.
    resumptions : tuple of Resumption or None
        Of each record whose law had been at work before: its state, and where the arm was, at the first sample.
    gains : (2n,) numpy.ndarray or None
        Observer gains of the innovations, of position and of speed, where these were fitted.
    resonance : GearResonance or None
        Of elastic gears. Where it only gives a bound, stiffness and damping have no variance.
    """

    unknown: tuple[str, ...]
    values: NDArray[np.float64]
    candidates: NDArray[np.float64]
    covariance: NDArray[np.float64] | None = None
    noise_covariance: NDArray[np.float64] | None = None
    rms_innovation: float | None = None
    fallback_reason: str | None = None
    zeros: NDArray[np.float64] | None = None
    resumptions: tuple[Resumption | None, ...] = ()
    gains: NDArray[np.float64] | None = None
    resonance: GearResonance | None = None

    def _short(self) -> str:
        known = "no covariance" if self.covariance is None else "with covariance"
        return f"{len(self.values)} values, {known}{', a fallback' * bool(self.fallback_reason)}"

    def _shown(self) -> Iterator[Piece]:
        std = [""] * len(self.values) if self.covariance is None else [f"+- {each:.2g}" for each in self.std]
        rows = zip(self.unknown, self.values, std, strict=True)
        yield Table((), [(name, f"{value:.5g}", deviation) for name, value, deviation in rows], words=(2,))
        if self.fallback_reason:
            yield f"a fallback: {self.fallback_reason}"

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations (k,) of the values.

        Raises
        ------
        ValueError
            A fit without a covariance.
        """
        return np.sqrt(np.diag(self._required_covariance))

    @property
    def correlation(self) -> NDArray[np.float64]:
        """Correlations (k, k) of the values; of what was kept fixed, zero."""
        std = np.where(self.std > 0, self.std, np.inf)
        return self._required_covariance / np.outer(std, std)

    @property
    def _required_covariance(self) -> NDArray[np.float64]:
        if self.covariance is None:
            why = self.fallback_reason or "its method has none; use the default method"
            raise ValueError(f"standard deviations need a covariance; this fit provides none: {why}.")
        return self.covariance


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Outcome(Frozen):
    """What a method found.

    Attributes
    ----------
    fit : Fit
    message : str
        Why the search ended.
    evaluations : int
        Simulated experiments.
    genetic : GeneticResult or None
    rounding : (M,) numpy.ndarray or None
        Innovations of the records, weighted, as far as the rounding of counts makes them alike in every log; in the
        order of `Prediction`. None where it makes none, or was not simulated.
    stages : dict
        What each stage before the last found: name -> (k,) values.
    """

    fit: Fit
    message: str = ""
    evaluations: int = 0
    genetic: GeneticResult | None = None
    rounding: NDArray[np.float64] | None = None
    stages: dict[str, NDArray[np.float64]] = dataclasses.field(default_factory=dict)

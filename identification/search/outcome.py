"""What a method of identification gives back: the fit, its gears, how it came about, and what a
result keeps of it.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.between_runs import BetweenRuns
from identification.equation_error.law_memory import Resumption
from identification.equation_error.least_squares import covariance_of
from identification.equation_error.prior import Prior
from identification.search.genetic import GeneticResult, GeneticSettings
from identification.search.problem import Problem, Tolerances
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict, Warned
from plant.parts.tables import Table


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GearResonance(Shown, Frozen):
    """Locked-rotor resonances, sqrt(k / (D_ii - Jm_i k_i^2)) / 2 pi, at the pose where the
    reference begins.

    `joints`: what to call each joint. `pose` (n,): [rad]. `hz` (n,): [Hz]; infinite where the log
    does not tell the gear from a rigid one. `low`, `high` (n,): 95 % interval [Hz], from the
    profile likelihood. Without an upper end, low is a bound: the gear is stiffer. `damping_ratio`,
    `damping_low`, `damping_high` (n,): of the resonance, and its 95 % interval; where the log says
    little, it is what was expected, 0.005 to 0.05. `searched` (n,): whether the stiffness was
    unknown; the other resonances are those of the rig. `played`: joints whose gear has backlash
    that the rig does not state. A search takes it for compliance, in all gears that it looks for,
    so that low is a bound there: the gear is stiffer.
    """

    joints: tuple[str, ...]
    pose: Floats
    hz: Floats
    low: Floats
    high: Floats
    damping_ratio: Floats
    damping_low: Floats
    damping_high: Floats
    searched: NDArray[np.bool_]
    played: tuple[str, ...] = ()

    def beside_backlash(self, joints: tuple[str, ...]) -> Self:
        """What remains of it where the log shows backlash at these joints: bounds."""
        return dataclasses.replace(
            self, high=np.where(self.searched, np.inf, self.high), played=joints
        )

    def bounds(self, name: str) -> bool:
        """Whether an unknown is stiffness or damping of a gear of which the log gives a bound
        alone.
        """
        stiffer = np.flatnonzero(self.searched & np.isinf(self.high)).tolist()
        return name in [
            f"drive.elasticity.{what}[{i}]" for what in ("stiffness", "damping") for i in stiffer
        ]

    def _short(self) -> str:
        found = [
            f"{hz:.1f}" if np.isfinite(top) else f">{low:.0f}"
            for hz, low, top in zip(
                self.hz, self.low, np.where(self.searched, self.high, 0), strict=True
            )
        ]
        return f"{', '.join(found)} Hz"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict("resonance of each link against its locked motor, with 95 % intervals")
        rows = []
        for i, label in enumerate(self.joints):
            hz = f"{self.hz[i]:.1f}"
            ratio = (
                f"{self.damping_ratio[i]:.3f} [{self.damping_low[i]:.3f},"
                f" {self.damping_high[i]:.3f}]"
            )
            if not self.searched[i]:
                rows.append((label, hz, "as the rig says", ""))
            elif np.isinf(self.high[i]):
                rows.append((label, "", f"stiffer than {self.low[i]:.0f}", ""))
            else:
                rows.append((label, hz, f"[{self.low[i]:.1f}, {self.high[i]:.1f}]", ratio))
        yield Table(("", "[Hz]", "interval", "damping ratio"), rows, words=(2, 3))
        if self.played and self.searched.any():
            yield Warned(
                [
                    f"bounds alone: backlash was found at {', '.join(self.played)} that the rig"
                    " does not state, and the search takes it for compliance. State it in the"
                    " Elasticity, and identify again."
                ]
            )


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
        Vectors that repeat the records as well as the values do, but for the noise of objective
        (4), best first; the values alone where a method tries no others.
        ``Uncertainty(plants=...)`` takes them for want of a covariance.
    covariance : (k, k) numpy.ndarray or None
        Of the values; None where the method provides none. It counts noise, scaled by the
        innovations and their autocorrelation, and what the rig may state wrongly: see `Tolerances`.
    noise_covariance : (k, k) numpy.ndarray or None
        What of it noise alone makes, if the rig is exact.
    between : BetweenRuns or None
        How two records or more agree, and what their differences add to the covariance.
    rms_innovation : float or None
        Root mean square of the innovations [pulses]: counted positions minus their one-step
        predictions. Rounding alone gives 0.289.
    fallback_reason : str or None
        Why the values are not those of the last fit; its covariance then says nothing of them.
    zeros : (R, n) numpy.ndarray or None
        Where the joints of each record are when its counters say zero [rad], if that was unknown.
    resumptions : tuple of Resumption or None
        Of each record whose law had been at work before: its state, and where the arm was, at the
        first sample.
    gains : (2n,) numpy.ndarray or None
        Observer gains of the innovations, of position and of speed, where these were fitted.
    resonance : GearResonance or None
        Of elastic gears. Where it only gives a bound, stiffness and damping have no variance.
    prior : Prior or None
        Of f, if one was given.
    """

    unknown: tuple[str, ...]
    values: Floats
    candidates: Floats
    covariance: Floats | None = None
    noise_covariance: Floats | None = None
    between: BetweenRuns | None = None
    rms_innovation: float | None = None
    fallback_reason: str | None = None
    zeros: Floats | None = None
    resumptions: tuple[Resumption | None, ...] = ()
    gains: Floats | None = None
    resonance: GearResonance | None = None
    prior: Prior | None = None

    def _short(self) -> str:
        known = "no covariance" if self.covariance is None else "with covariance"
        return f"{len(self.values)} values, {known}{', a fallback' * bool(self.fallback_reason)}"

    def _shown(self) -> Iterator[Piece]:
        std = (
            [""] * len(self.values)
            if self.covariance is None
            else [f"+- {each:.2g}" for each in self.std]
        )
        rows = zip(self.unknown, self.values, std, strict=True)
        yield Table(
            (), [(name, f"{value:.5g}", deviation) for name, value, deviation in rows], words=(2,)
        )
        if self.fallback_reason:
            yield f"a fallback: {self.fallback_reason}"

    @property
    def std(self) -> Floats:
        """Standard deviations (k,) of the values.

        Raises
        ------
        ValueError
            A fit without a covariance.
        """
        return np.sqrt(np.diag(self._required_covariance))

    @property
    def correlation(self) -> Floats:
        """Correlations (k, k) of the values; of what was kept fixed, zero."""
        std = np.where(self.std > 0, self.std, np.inf)
        return self._required_covariance / np.outer(std, std)

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance (m, m) of numbers by their names; zero of what was not unknown, or where
        there is none.
        """
        if self.covariance is None:
            return np.zeros((len(names),) * 2)
        return covariance_of(names, self.unknown, self.covariance)

    @property
    def _required_covariance(self) -> Floats:
        if self.covariance is None:
            why = self.fallback_reason or "its method has none; use the default method"
            raise ValueError(
                f"standard deviations need a covariance; this fit provides none: {why}."
            )
        return self.covariance


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Outcome(Frozen):
    """What a method found.

    `message`: why the search ended. `evaluations`: simulated experiments. `rounding` (M,) or None:
    innovations of the records, weighted, as far as the rounding of counts makes them alike in every
    log; in the order of `Prediction`. None where it makes none, or was not simulated. `stages`:
    what each stage before the last found: name -> (k,) values. `grouped` (k,) or None: standard
    deviations from how values differ between segments, where what is tested is but a part of a long
    log.
    """

    fit: Fit
    message: str = ""
    evaluations: int = 0
    genetic: GeneticResult | None = None
    rounding: Floats | None = None
    grouped: Floats | None = None
    stages: dict[str, Floats] = dataclasses.field(default_factory=dict)


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Search(Shown, Frozen):
    """How the unknowns were searched.

    `tolerances`: within which the rigs are right, as the intervals count them. `ranges` (k, 2):
    those that were given. `stages`: what each stage before the last found: name -> (k,) values.
    `initial_objective`: objective (4) of the best candidate of the first generation [pulses^2]; of
    a method without generations, that of the result. `initial_population` (P, k). `initial_costs`
    (P,): objective (4) of each of them, inf for one that is no arm or diverges. `history`
    (generations + 1, 3): best, mean and worst finite objective of each generation. `evaluations`:
    simulated experiments. `seconds`: of the whole identification. `message`: why the search ended.
    """

    method: str
    seed: int
    settings: GeneticSettings
    tolerances: Tolerances
    ranges: Floats | None
    stages: dict[str, Floats]
    initial_objective: float
    initial_population: Floats
    initial_costs: Floats
    history: Floats
    evaluations: int
    seconds: float = dataclasses.field(compare=False)
    message: str

    def _short(self) -> str:
        return (
            f"{self.method}, seed {self.seed}, {self.evaluations} evaluations in"
            f" {self.seconds:.1f} s"
        )

    def _shown(self) -> Iterator[Piece]:
        yield f"{self.message}"
        rows = [
            ("method", self.method),
            ("seed", f"{self.seed}"),
            ("evaluations", f"{self.evaluations}"),
        ]
        rows += [
            ("generations", f"{max(len(self.history) - 1, 0)}"),
            ("time [s]", f"{self.seconds:.1f}"),
        ]
        yield Table((), rows)

    @classmethod
    def of(cls, problem: Problem, outcome: Outcome, objective: float, seconds: float) -> Self:
        """The search of a problem that had this outcome, with the result's objective (4)."""
        population: dict[str, Any] = {
            "initial_population": np.empty((0, len(problem.unknown))),
            "initial_costs": np.empty(0),
            "history": np.empty((0, 3)),
        }
        if (genetic := outcome.genetic) is not None:
            population = {name: getattr(genetic, name) for name in population}
            objective = genetic.initial_cost
        asked = {
            name: getattr(problem, name)
            for name in ("method", "seed", "settings", "tolerances", "ranges")
        }
        got = {name: getattr(outcome, name) for name in ("stages", "evaluations", "message")}
        return cls(initial_objective=objective, seconds=seconds, **asked, **population, **got)

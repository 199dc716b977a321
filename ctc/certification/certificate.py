"""Probability of leaving a pulse limit with its exact bounds, the worst plant, and the sensitivities.

The bounds are those of Clopper and Pearson, exact whatever the distribution of the errors.
"""

import dataclasses
import functools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.cells import Cell, cells, clopper_pearson
from ctc.certification.figure import plot_certificate
from ctc.certification.plants import Plants, Worst
from ctc.certification.reserves import Reserves, reserves
from ctc.certification.sensitivity import Influence, influences
from ctc.certification.statement import percent, shown, verdict
from ctc.verdict.conditions import FromRest, from_rest
from ctc.verdict.on_gears import SETTLED, LowestResonance, lowest_resonance
from identification.results.seen import Seen
from plant import Law, Reference
from plant.machine.elasticity import DAMPING_RATIO
from plant.parts.arguments import known_options
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.saved import Saved, versions
from plant.parts.shown import Piece, Shown
from plant.simulation.loop_kernel import LANES
from plant.simulation.population import Runs


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(Shown, Saved, Frozen):
    """Probability of leaving a pulse limit under parameter uncertainty, and why. Print it for a table.

    Attributes
    ----------
    law : Law
    reference : Reference
    plants : Plants
        What was drawn.
    runs : Runs
        Results of each: ``peak``, ``unrounded``, ``outside``, ``current``, ``first``.
    within : float
        Limit [pulses].
    confidence : float
    settings : dict
        ``steps_per_sample``, ``duration`` and ``after``.
    threads : int
    seconds : float
        That the runs took.
    seen : Seen or None
        What the logs show of gears, and where the path leaves them; None of an arm that was not identified.
    versions : dict
        Of the library, numpy, casadi and Python that made it.

    See Also
    --------
    ctc.certify

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import ComputedTorque, Uncertainty, certify
    >>> path = puma560.reference()
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> law = ComputedTorque(found, bandwidth=150)
    >>> certificate = certify(found, found.rig, law, path, Uncertainty(friction=0.02), samples=64, progress=False)
    >>> certificate.failures, certificate.upper < 0.1
    (0, True)
    """

    law: Law
    reference: Reference
    plants: Plants
    runs: Runs
    within: float
    confidence: float
    settings: dict[str, Any]
    seen: Seen | None = None
    threads: int = dataclasses.field(compare=False)
    seconds: float = dataclasses.field(compare=False)
    versions: dict[str, str] = dataclasses.field(compare=False, default_factory=versions)

    def provenance(self) -> dict[str, Any]:
        """The seed of the plants, and the versions that made it."""
        return {"versions": dict(self.versions), "seed": self.plants.seed}

    @property
    def failures(self) -> int:
        """How many of the loops left the limit at any sample, or diverged."""
        return int((self.runs.outside > 0).sum())

    @property
    def failures_before(self) -> int:
        """How many exceed the limit at a sample before ``after``, which does not count."""
        return int((self.runs.before > 0).sum())

    @property
    def probability(self) -> float:
        """Share of the loops that left the limit."""
        return self.failures / len(self.plants)

    @property
    def interval(self) -> tuple[float, float]:
        """Two-sided interval (low, high) of that probability, at the confidence."""
        return clopper_pearson(self.failures, len(self.plants), self.confidence)

    @property
    def upper(self) -> float:
        """One-sided upper bound of that probability, at the confidence; that of the worst cell of resonances."""
        if self.worst_cell is not None:
            return self.worst_cell.upper(self.confidence)
        return clopper_pearson(self.failures, len(self.plants), 2 * self.confidence - 1)[1]

    @functools.cached_property
    def cells(self) -> list[Cell]:
        """The stated ranges of resonance and damping in small parts, with what became of the plants in each."""
        return cells(self.plants.uncertainty, self.plants.names, self.plants.values, self.runs.outside > 0)

    @property
    def worst_cell(self) -> Cell | None:
        """The part of the stated resonances with the highest bound; None where none were stated."""
        return max(self.cells, key=lambda cell: cell.upper(self.confidence), default=None)

    @functools.cached_property
    def on_gears(self) -> LowestResonance | None:
        """On which elastic gears the nominal arm stays within the limit; None where the gears are elastic already.

        Stated delay, lag and other imperfections are at that end of their ranges which is farther from zero.
        """
        if self.plants.rig.drive.elasticity is not None:
            return None
        ratio = self.plants.uncertainty.lowest_damping
        after = max(SETTLED, self.settings["after"])
        return lowest_resonance(*self._loop, DAMPING_RATIO if ratio is None else ratio, after, self.threads, None)

    @functools.cached_property
    def from_rest(self) -> FromRest | None:
        """What the nominal arm does from rest, where the path begins in motion and leaves it behind."""
        return from_rest(*self._loop)

    @property
    def _loop(self) -> Any:
        """The nominal loop, its limit, its duration in whole periods and steps, as an `Evaluation` has them."""
        arm, rig, settings = self.plants.arm, self.plants.nominal, self.settings
        duration = math.ceil(settings["duration"] / rig.period - 1e-9) * rig.period
        return arm, rig, self.law, self.reference, self.within, duration, settings["steps_per_sample"]

    @property
    def holds(self) -> bool:
        """Whether no plant leaves the limit, nor the nominal arm from rest."""
        return self.failures == 0 and self.from_rest is None

    @property
    def lowest_resonance(self) -> float | None:
        """Locked-rotor resonance [Hz] above which the nominal arm stays within the limit on gears; see `on_gears`."""
        return None if self.on_gears is None else self.on_gears.hz

    @property
    def share_outside(self) -> float:
        """Share of all samples of all loops that are outside the limit."""
        return float(self.runs.outside.mean() / self.runs.samples)

    @property
    def saturation(self) -> NDArray[np.float64]:
        """Share of the loops that reach the amplifier's limit, (n,)."""
        limit = self.plants.rig.drive.current_limit
        return (np.isfinite(limit) & (self.runs.current >= limit * (1 - 1e-12))).mean(axis=0)

    @property
    def current_share(self) -> NDArray[np.float64]:
        """Largest motor current of a loop as a share of the amplifier's limit, median of the loops, (n,)."""
        limit = self.plants.rig.drive.current_limit
        median = np.median(self.runs.current, axis=0)
        return np.divide(median, limit, out=np.zeros(len(limit)), where=np.isfinite(limit))

    @property
    def sensitivities(self) -> list[Influence]:
        """Sensitivity of the peak error to each of the drawn numbers, the largest first.

        Of numbers that were fitted again on gears of the plant's resonance, to their deviation from that fit: what
        follows from the resonance is the resonance's.
        """
        names, values = self.plants.names, self.plants.values - self.plants.expected
        if self.plants.dropped:
            names, values = (*names, "lost samples"), np.column_stack([values, self.runs.lost])
        return influences(names, values, self.runs.unrounded.max(axis=1))

    @property
    def worst(self) -> Worst:
        """The plant with the largest counted error; among equals, with the largest before rounding."""
        peak, unrounded = self.runs.peak.max(axis=1), self.runs.unrounded.max(axis=1)
        return self.plant(int(np.lexsort((unrounded, peak))[-1]))

    def plant(self, index: int) -> Worst:
        """One of the plants, ready for `evaluate`.

        Returns
        -------
        Worst
        """
        if not isinstance(index, (int, np.integer)) or not 0 <= index < len(self.plants):
            raise ValueError(f"index must be a whole number from 0 to {len(self.plants) - 1}; got {index!r}.")
        arm, rig = self.plants.plant(index, LANES, self.settings["law_steps"])
        values = dict(zip(self.plants.names, self.plants.values[index].tolist(), strict=True))
        return Worst(arm=arm, rig=rig, peak=float(self.runs.peak[index].max()), index=int(index), values=values)

    @property
    def verdict(self) -> str:
        """What was found, and on which gears it holds: one sentence, two on rigid ones."""
        return verdict(self)

    @known_options
    def reserves(self, *, samples: int = 400, allowed: float = 0.0) -> Reserves:
        """Lowest bandwidth and longest period at which at most a share `allowed` of the first `samples` plants leaves.

        Parameters
        ----------
        samples : int
        allowed : float

        Returns
        -------
        Reserves
        """
        return reserves(self, samples, allowed)

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw peak errors, worst loop and sensitivities on (3,) Axes, (4,) where resonances were stated."""
        return plot_certificate(self, ax)

    def _short(self) -> str:
        bound = f"at most {percent(self.upper, up=True)}"
        share = f"{self.failures} of {len(self.plants)} plants leave ±{self.within:g} pulse"
        return f"{type(self.law).__name__}: {share}, {bound} of all"

    def _shown(self) -> Iterator[Piece]:
        return shown(self)

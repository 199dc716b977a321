"""What a certificate of one path and that of a set of motions have in common: who exceeds the limit, and why.

The bounds are those of Clopper and Pearson, exact whatever the distribution of the errors.
"""

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.cells import Cell, cells, clopper_pearson
from ctc.certification.plants import Plants
from ctc.certification.rare import Rare
from ctc.certification.sensitivity import Influence, influences
from ctc.certification.statement import percent
from plant import Law
from plant.parts.frozen import Frozen
from plant.parts.saved import Saved, versions
from plant.parts.shown import Shown
from plant.simulation.population import Runs


class _WithRuns:
    """What one path has as fields, and a set works out of its motions."""

    runs: Runs
    settings: dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certified(_WithRuns, Shown, Saved, Frozen):
    """Base of both: `plants` were run under `law`, with ``runs``; of a set each exceeds that does in any motion."""

    law: Law
    plants: Plants
    within: float
    confidence: float
    threads: int = dataclasses.field(compare=False)
    seconds: float = dataclasses.field(compare=False)
    rare: Rare | None = None
    versions: dict[str, str] = dataclasses.field(compare=False, default_factory=versions)

    def provenance(self) -> dict[str, Any]:
        """The seed of the samples, and the versions that made it."""
        return {"versions": dict(self.versions), "seed": self.plants.seed}

    @property
    def failures(self) -> int:
        """How many of the samples exceed the limit at any sampling instant that counts, or diverge."""
        return int((self.runs.outside > 0).sum())

    @property
    def failures_before(self) -> int:
        """How many exceed the limit at an instant before ``after``, which does not count."""
        return int((self.runs.before > 0).sum())

    @property
    def failures_with_start(self) -> int:
        """How many exceed the limit at any instant, those before ``after`` among them."""
        return int((self.runs.outside + self.runs.before > 0).sum())

    @property
    def probability(self) -> float:
        """Share of the samples that exceed the limit."""
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
        """The stated ranges of resonance and damping in small parts, with what became of the samples in each."""
        return cells(self.plants.uncertainty, self.plants.names, self.plants.values, self.runs.outside > 0)

    @property
    def worst_cell(self) -> Cell | None:
        """The part of the stated resonances with the highest bound; None where none were stated."""
        return max(self.cells, key=lambda cell: cell.upper(self.confidence), default=None)

    @property
    def share_outside(self) -> float:
        """Share of all sampling instants of all loops that exceed the limit."""
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
        """Sensitivity of the peak error to each of the uncertain numbers, the largest first.

        Of numbers that were fitted again on gears of the sample's resonance, to their deviation from that fit: what
        follows from the resonance is the resonance's.
        """
        names, values = self.plants.names, self.plants.values - self.plants.expected
        if self.plants.dropped:
            names, values = (*names, "lost samples"), np.column_stack([values, self.runs.lost])
        return influences(names, values, self.runs.unrounded.max(axis=1))

    def _short(self) -> str:
        bound = f"at most {percent(self.upper, up=True)}"
        share = f"{self.failures} of {len(self.plants)} samples exceed ±{self.within:g} pulse"
        return f"{type(self.law).__name__}: {share}, {bound} of all"

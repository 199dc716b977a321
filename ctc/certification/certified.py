"""What a certificate of one path and that of a set of motions have in common: who exceeds the
limit, and why.

The bounds are those of Clopper and Pearson, exact whatever the distribution of the errors.

Why: the sensitivity of the peak errors to each of the sampled numbers: the share of variance of its
own (first-order index). Errors often grow with a deviation to either side, so no line is fitted.
The loops are ranked by their peak, and cut in equal groups by one number; the share of the variance
of the ranks that lies between the groups is what that number explains, whatever the shape of the
dependence (the correlation ratio, less what chance gives). Spearman's rank correlation gives its
direction. Correlated numbers, such as the parameters of one identification, share what they
explain.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctc.certification.plants import Plants
from ctc.certification.rare import Rare
from ctc.certification.statement import percent
from ctc.certification.uncertainty import Uncertainty
from plant import Law
from plant.parts.frozen import Frozen
from plant.parts.saved import Saved, versions
from plant.parts.shown import Shown
from plant.simulation.population import Runs


def clopper_pearson(failures: int, samples: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval (low, high) of a probability, from how often something happened.

    ``clopper_pearson(k, n, 2 * c - 1)[1]`` is the one-sided upper bound at confidence c.
    """
    from scipy.special import betaincinv

    tail = (1 - confidence) / 2
    low = betaincinv(failures, samples - failures + 1, tail) if failures else 0.0
    high = betaincinv(failures + 1, samples - failures, 1 - tail) if failures < samples else 1.0
    return float(low), float(high)


_WIDTH = 1.1  # ratio of the resonances at the ends of a cell, at most
_DAMPINGS = 3  # cells in the range of the damping ratio


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Cell(Frozen):
    """A part of the range of resonance and damping, and what became of its plants.

    `name`: ``resonance``, or that of a joint, as ``resonance[0]``. `hz`, `damping_ratio`: lowest
    and highest. `count`, `failures`: plants in it, and those that exceed the limit.
    """

    name: str
    hz: tuple[float, float]
    damping_ratio: tuple[float, float]
    count: int
    failures: int

    def upper(self, confidence: float) -> float:
        """Upper bound of the probability to exceed the limit, one-sided, at a confidence; 1
        without plants.
        """
        return (
            clopper_pearson(self.failures, self.count, 2 * confidence - 1)[1] if self.count else 1.0
        )

    def __repr__(self) -> str:
        return f"Cell({self.name}: {self}; {self.failures} of {self.count} exceed the limit)"

    def __str__(self) -> str:
        (low, high), (least, most) = self.hz, self.damping_ratio
        damping = f"{least:.3g}" if least == most else f"{least:.3g} to {most:.3g}"
        return f"{low:.3g} to {high:.3g} Hz, damping ratio {damping}"


def cells(
    ranges: Uncertainty,
    names: tuple[str, ...],
    values: NDArray[np.float64],
    outside: NDArray[np.bool_],
) -> list[Cell]:
    """The ranges of resonance and damping in cells of at most 10 %; of several joints, each joint's
    own.

    Names (K) and values (P, K) are of the plants, without what does not vary; those `outside` (P,)
    exceed the limit.
    """
    found = []
    pairs = ranges.resonance or ()
    least, most = ranges.damping_ratio or (0.0, 0.0)
    for i, (low, high) in enumerate(pairs):
        name = "resonance" if len(pairs) == 1 else f"resonance[{i}]"
        edges = np.geomspace(
            low, high, max(1, int(np.ceil(np.log(high / low) / np.log(_WIDTH)))) + 1
        ).tolist()
        dampings = np.linspace(least, most, 1 + (_DAMPINGS if least < most else 1)).tolist()
        of_hz, of_ratio = (
            _place(names, values, *each) for each in ((name, edges), ("damping_ratio", dampings))
        )
        parts = (enumerate(itertools.pairwise(ends)) for ends in (edges, dampings))
        for (j, hz), (k, ratio) in itertools.product(*parts):
            inside = outside[(of_hz == j) & (of_ratio == k)]
            failures = int(inside.sum())
            found.append(
                Cell(name=name, hz=hz, damping_ratio=ratio, count=len(inside), failures=failures)
            )
    return found


def _place(
    names: tuple[str, ...], values: NDArray[np.float64], name: str, edges: Any
) -> NDArray[np.intp]:
    """In which interval between the edges the number of each plant (P,) is."""
    if name not in names:
        return np.zeros(len(values), int)
    return np.clip(
        np.searchsorted(edges, values[:, names.index(name)], side="right") - 1, 0, len(edges) - 2
    )


# groups, and how many loops a group must have at least
_GROUPS = 10
_LEAST = 20
# Share below which a number has no direction, and rank correlation from which on it has one.
_LITTLE = 0.005
_CLEAR = 0.1


class Influence(NamedTuple):
    """Sensitivity to one number: `share` of the variance explained (0 to 1), and rank
    correlation `direction`.
    """

    name: str
    share: float
    direction: float

    def __repr__(self) -> str:
        return f"Influence({self.name:.40}: {self.share:.1%}{f', {self.sense}' * bool(self.sense)})"

    @property
    def sense(self) -> str:
        """How the peak error depends on the number; empty where it explains nearly nothing."""
        if self.share < _LITTLE:
            return ""
        return (
            "increasing"
            if self.direction > _CLEAR
            else "decreasing"
            if self.direction < -_CLEAR
            else "either way"
        )


def influences(
    names: Sequence[str], values: NDArray[np.float64], peaks: NDArray[np.float64]
) -> list[Influence]:
    """Influence of each number, of values (P, K) on peaks (P,) that may be infinite, the largest
    share first.
    """
    from scipy.stats import rankdata

    ranks = rankdata(peaks)
    count = len(peaks)
    groups = min(_GROUPS, count // _LEAST)
    if groups < 2 or np.ptp(ranks) == 0:
        return [Influence(name, 0.0, 0.0) for name in names]
    total = ranks.var() * count
    found = []
    for name, column in zip(names, values.T, strict=True):
        own = rankdata(column)
        group = np.minimum((own - 0.5) * groups / count, groups - 1).astype(int)
        size = np.bincount(group, minlength=groups)
        means = np.bincount(group, weights=ranks, minlength=groups) / np.maximum(size, 1)
        between = (size * (means - ranks.mean()) ** 2).sum() / total
        share = 1 - (1 - between) * (count - 1) / (count - groups)
        found.append(Influence(name, max(0.0, float(share)), float(np.corrcoef(own, ranks)[0, 1])))
    return sorted(found, key=lambda influence: -influence.share)


class _WithRuns:
    """What one path has as fields, and a set works out of its motions."""

    runs: Runs
    settings: dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certified(_WithRuns, Shown, Saved, Frozen):
    """Base of both: `plants` were run under `law`, with ``runs``; of a set each exceeds that
    does in any motion.
    """

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
        """How many of the samples exceed the limit at any sampling instant that counts, or
        diverge.
        """
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
        """One-sided upper bound of that probability, at the confidence; that of the worst cell
        of resonances.
        """
        if self.worst_cell is not None:
            return self.worst_cell.upper(self.confidence)
        return clopper_pearson(self.failures, len(self.plants), 2 * self.confidence - 1)[1]

    @functools.cached_property
    def cells(self) -> list[Cell]:
        """The stated ranges of resonance and damping in small parts, with what became of the
        samples in each.
        """
        return cells(
            self.plants.uncertainty, self.plants.names, self.plants.values, self.runs.outside > 0
        )

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
        """Largest motor current of a loop as a share of the amplifier's limit, median of the
        loops, (n,).
        """
        limit = self.plants.rig.drive.current_limit
        median = np.median(self.runs.current, axis=0)
        return np.divide(median, limit, out=np.zeros(len(limit)), where=np.isfinite(limit))

    @property
    def sensitivities(self) -> list[Influence]:
        """Sensitivity of the peak error to each of the uncertain numbers, the largest first.

        Of numbers that were fitted again on gears of the sample's resonance, to their deviation
        from that fit: what follows from the resonance is the resonance's.
        """
        names = self.plants.names
        values = self.plants.values - self.plants.expected
        if self.plants.dropped:
            names = (*names, "lost samples")
            values = np.column_stack([values, self.runs.lost])
        return influences(names, values, self.runs.unrounded.max(axis=1))

    def _short(self) -> str:
        bound = f"at most {percent(self.upper, up=True)}"
        share = f"{self.failures} of {len(self.plants)} samples exceed ±{self.within:g} pulse"
        return f"{type(self.law).__name__}: {share}, {bound} of all"

"""Failure counts, exact bounds and sensitivities: the base of `Certificate` and `Certificates`.

The bounds are those of Clopper and Pearson, exact for any distribution of the errors.

The sensitivity to each sampled number is its first-order share of the variance of the peak errors.
Errors often grow with a deviation to either side, so no line is fitted. The loops are ranked by
their peak, and cut into equal groups by one number; the share of the variance of the ranks that
lies between the groups is explained by that number, whatever the shape of the dependence (the
correlation ratio, less the part expected by chance). Spearman's rank correlation gives its
direction. Correlated numbers, such as the parameters of one identification, share their part.
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
from plant.parts import Floats, Frozen, Saved, Shown, frozen, frozen_settings, versions
from plant.simulation import Runs


def clopper_pearson(failures: int, samples: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact two-sided interval (low, high) of a probability, from failures among samples.

    ``clopper_pearson(k, n, 2 * c - 1)[1]`` is the one-sided upper bound at confidence c.
    """
    from scipy.special import betaincinv

    # The ends are quantiles of beta distributions; without a failure, or a success, one end is
    # certain.
    tail = (1 - confidence) / 2
    low = betaincinv(failures, samples - failures + 1, tail) if failures else 0.0
    high = betaincinv(failures + 1, samples - failures, 1 - tail) if failures < samples else 1.0
    return float(low), float(high)


@frozen_settings
class CertifiedSettings:
    """Settings of the resonance cells and of the sensitivities, all chosen by hand.

    Parameters
    ----------
    cell_ratio : float
        Largest ratio of the resonances at the ends of a cell.
    damping_cells : int
        Cells in the range of the damping ratio.
    groups : int
        Largest number of groups into which one number cuts the loops.
    loops_per_group : int
        Least mean number of loops per group; fewer loops make fewer groups.
    negligible_share : float
        Share of the variance below which a number has no direction.
    clear_direction : float
        Magnitude of the rank correlation above which a number has one direction.
    """

    # Cells of the stated resonances
    cell_ratio: float = 1.1
    damping_cells: int = 3
    # Sensitivities
    groups: int = 10
    loops_per_group: int = 20
    negligible_share: float = 0.005
    clear_direction: float = 0.1


SETTINGS = CertifiedSettings()


@frozen
class Cell(Frozen):
    """A part of the range of resonance and damping, with its plants and failures.

    `name`: ``resonance``, or that of a joint, as ``resonance[0]``. `hz`, `damping_ratio`: lowest
    and highest. `count`, `failures`: plants in it, and those that exceed the limit.
    """

    name: str
    hz: tuple[float, float]
    damping_ratio: tuple[float, float]
    count: int
    failures: int

    def upper(self, confidence: float) -> float:
        """One-sided upper bound of the failure probability at a confidence; 1 without plants."""
        if not self.count:
            return 1.0
        # One-sided at this confidence, from a two-sided interval.
        return clopper_pearson(self.failures, self.count, 2 * confidence - 1)[1]

    def __repr__(self) -> str:
        return f"Cell({self.name}: {self}; {self.failures} of {self.count} exceed the limit)"

    def __str__(self) -> str:
        low, high = self.hz
        # A single damping ratio has no range.
        lightest, heaviest = self.damping_ratio
        damping = f"{lightest:.3g}"
        if lightest != heaviest:
            damping = f"{lightest:.3g} to {heaviest:.3g}"
        return f"{low:.3g} to {high:.3g} Hz, damping ratio {damping}"


def cells(
    ranges: Uncertainty,
    names: tuple[str, ...],
    values: Floats,
    outside: NDArray[np.bool_],
) -> list[Cell]:
    """Cells of resonance and damping: at most 10 % wide in resonance, a few equal parts in damping.

    If several ranges of resonance are stated, each joint has its own cells.

    `names` (K) are the numbers that vary among the plants, and `values` (P, K) their values. The
    mask `outside` (P,) marks the plants that exceed the limit.
    """
    result = []
    pairs = ranges.resonance or ()
    # Rigid gears have neither a resonance nor a damping ratio, and no cell.
    lightest, heaviest = ranges.damping_ratio or (0.0, 0.0)
    for i, (low, high) in enumerate(pairs):
        name = "resonance" if len(pairs) == 1 else f"resonance[{i}]"
        # Cells of equal ratio, since samples are uniform in the logarithm.
        count = max(1, int(np.ceil(np.log(high / low) / np.log(SETTINGS.cell_ratio))))
        edges = np.geomspace(low, high, count + 1).tolist()
        dampings = SETTINGS.damping_cells if lightest < heaviest else 1
        damping_edges = np.linspace(lightest, heaviest, dampings + 1).tolist()
        of_hz = _interval(names, values, name, edges)
        of_damping = _interval(names, values, "damping_ratio", damping_edges)
        for j, hz in enumerate(itertools.pairwise(edges)):
            # Every pair of intervals is a cell: the worst may be a corner of both ranges.
            for k, damping_ratio in enumerate(itertools.pairwise(damping_edges)):
                inside = outside[(of_hz == j) & (of_damping == k)]
                cell = Cell(
                    name=name,
                    hz=hz,
                    damping_ratio=damping_ratio,
                    count=len(inside),
                    failures=int(inside.sum()),
                )
                result.append(cell)
    return result


def _interval(names: tuple[str, ...], values: Floats, name: str, edges: Any) -> NDArray[np.intp]:
    """Index (P,) of the interval between the edges in which the number of each plant lies."""
    # A number that does not vary is no column of the values: it has a single interval.
    if name not in names:
        return np.zeros(len(values), int)
    index = np.searchsorted(edges, values[:, names.index(name)], side="right") - 1
    return np.clip(index, 0, len(edges) - 2)  # rounding may leave an outermost value outside


class Influence(NamedTuple):
    """Sensitivity to one number.

    `share`: part of the variance of the ranked peaks that the number explains (0 to 1).
    `direction`: rank correlation of the number and the peaks.
    """

    name: str
    share: float
    direction: float

    def __repr__(self) -> str:
        return f"Influence({self.name:.40}: {self.share:.1%}{f', {self.sense}' * bool(self.sense)})"

    @property
    def sense(self) -> str:
        """Change of the peak error as the number grows: increasing, decreasing or either way.

        The text is empty if the share of the variance is negligible.
        """
        if self.share < SETTINGS.negligible_share:
            return ""
        if self.direction > SETTINGS.clear_direction:
            return "increasing"
        if self.direction < -SETTINGS.clear_direction:
            return "decreasing"
        return "either way"


def influences(names: Sequence[str], values: Floats, peaks: Floats) -> list[Influence]:
    """Influence of each number on the peaks (P,), the largest share first.

    Values (P, K) are finite; peaks may be infinite.
    """
    from scipy.stats import rankdata

    # Ranks make a loop that diverged one among many, and need no assumption on the distribution.
    ranks = rankdata(peaks)
    count = len(peaks)
    # Too few loops, or peaks that are all alike, show no dependence.
    groups = min(SETTINGS.groups, count // SETTINGS.loops_per_group)
    if groups < 2 or np.ptp(ranks) == 0:
        return [Influence(name, 0.0, 0.0) for name in names]
    total = ranks.var() * count
    result = []
    for name, column in zip(names, values.T, strict=True):
        # 1. Cut the loops into groups of equal size by the number.
        column_ranks = rankdata(column)
        group = np.minimum((column_ranks - 0.5) * groups / count, groups - 1).astype(int)
        # 2. The variance between the groups' means. Ties may leave a group empty.
        size = np.bincount(group, minlength=groups)
        means = np.bincount(group, weights=ranks, minlength=groups) / np.maximum(size, 1)
        between = (size * (means - ranks.mean()) ** 2).sum() / total
        # 3. Groups cut at random lie apart, too: the part expected by chance is taken off.
        share = 1 - (1 - between) * (count - 1) / (count - np.count_nonzero(size))
        # A number that does not vary has no direction.
        varies = np.ptp(column_ranks) > 0
        direction = np.corrcoef(column_ranks, ranks)[0, 1] if varies else 0.0
        result.append(Influence(name, max(0.0, float(share)), float(direction)))
    # Correlated numbers share their part, so the shares need not sum to one.
    return sorted(result, key=lambda influence: -influence.share)


class _WithRuns:
    """Attributes that the certificate of one path stores, and that of a set of motions computes."""

    runs: Runs
    settings: dict[str, Any]


@frozen
class Certified(_WithRuns, Shown, Saved, Frozen):
    """Base of both certificates: the simulated ``runs`` of the `plants` under the `law`.

    In a set of motions, a sample exceeds the limit if it does so in any motion.
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
        """The seed of the samples, and the software versions that made the certificate."""
        return {"versions": dict(self.versions), "seed": self.plants.seed}

    @property
    def failures(self) -> int:
        """Number of samples that exceed the limit at any instant that counts, or diverge."""
        return int((self.runs.outside > 0).sum())

    @property
    def failures_before(self) -> int:
        """Number of samples that exceed the limit before ``after``, a time `failures` ignores."""
        return int((self.runs.before > 0).sum())

    @property
    def failures_with_start(self) -> int:
        """Number of samples that exceed the limit at any instant, also before ``after``."""
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
        """One-sided upper bound of that probability at the confidence.

        If resonances are stated, it is the bound of their worst cell.
        """
        # Resonances are known as a range without a distribution, so no average over it is a bound.
        if self.worst_cell is not None:
            return self.worst_cell.upper(self.confidence)
        return clopper_pearson(self.failures, len(self.plants), 2 * self.confidence - 1)[1]

    @functools.cached_property
    def cells(self) -> list[Cell]:
        """The stated ranges of resonance and damping in small parts, with samples and failures."""
        return cells(
            self.plants.uncertainty, self.plants.names, self.plants.values, self.runs.outside > 0
        )

    @property
    def worst_cell(self) -> Cell | None:
        """The cell of the stated resonances with the highest bound; None where none were stated."""
        return max(self.cells, key=lambda cell: cell.upper(self.confidence), default=None)

    @property
    def share_outside(self) -> float:
        """Share of all sampling instants of all loops that exceed the limit."""
        return float(self.runs.outside.mean() / self.runs.samples)

    @property
    def saturation(self) -> Floats:
        """Share of the loops that reach the amplifier's limit, (n,)."""
        limit = self.plants.rig.drive.current_limit
        # Rounding may leave a limited current just below the limit.
        return (np.isfinite(limit) & (self.runs.current >= limit * (1 - 1e-12))).mean(axis=0)

    @property
    def current_share(self) -> Floats:
        """Peak motor current as a share of the amplifier's limit, median of the loops, (n,)."""
        limit = self.plants.rig.drive.current_limit
        median = np.median(self.runs.current, axis=0)
        return np.divide(median, limit, out=np.zeros(len(limit)), where=np.isfinite(limit))

    @property
    def sensitivities(self) -> list[Influence]:
        """Sensitivity of the peak error to each of the uncertain numbers, the largest first.

        Some numbers are fitted again for the resonance of each sample. Only their deviation from
        that fit counts as theirs; the rest of their effect is attributed to the resonance.
        """
        names = self.plants.names
        values = self.plants.values - self.plants.expected
        # Lost samples are no property of a plant; their number in each loop is a further column.
        if self.plants.dropped:
            names = (*names, "lost samples")
            values = np.column_stack([values, self.runs.lost])
        return influences(names, values, self.runs.unrounded.max(axis=1))

    def _short(self) -> str:
        bound = f"at most {percent(self.upper, up=True)}"
        share = f"{self.failures} of {len(self.plants)} samples exceed ±{self.within:g} pulse"
        return f"{type(self.law).__name__}: {share}, {bound} of all"

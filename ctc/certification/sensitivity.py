"""Sensitivity of the peak errors to each of the sampled numbers: the share of variance of its own (first-order index).

Errors often grow with a deviation to either side, so no line is fitted. The loops are ranked by their peak, and cut in
equal groups by one number; the share of the variance of the ranks that lies between the groups is what that number
explains, whatever the shape of the dependence (the correlation ratio, less what chance gives). Spearman's rank
correlation gives its direction. Correlated numbers, such as the parameters of one identification, share what they
explain.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_GROUPS, _LEAST = 10, 20  # groups, and how many loops a group must have at least
_LITTLE, _CLEAR = 0.005, 0.1
"""Share below which a number has no direction, and rank correlation from which on it has one."""


class Influence(NamedTuple):
    """Sensitivity to one number: `share` of the variance explained (0 to 1), and rank correlation `direction`."""

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
        return "increasing" if self.direction > _CLEAR else "decreasing" if self.direction < -_CLEAR else "either way"


def influences(names: Sequence[str], values: NDArray[np.float64], peaks: NDArray[np.float64]) -> list[Influence]:
    """Influence of each number, of values (P, K) on peaks (P,) that may be infinite, the largest share first."""
    from scipy.stats import rankdata

    ranks, count = rankdata(peaks), len(peaks)
    groups = min(_GROUPS, count // _LEAST)
    if groups < 2 or np.ptp(ranks) == 0:
        return [Influence(name, 0.0, 0.0) for name in names]
    total, found = ranks.var() * count, []
    for name, column in zip(names, values.T, strict=True):
        own = rankdata(column)
        group = np.minimum((own - 0.5) * groups / count, groups - 1).astype(int)
        size = np.bincount(group, minlength=groups)
        means = np.bincount(group, weights=ranks, minlength=groups) / np.maximum(size, 1)
        between = (size * (means - ranks.mean()) ** 2).sum() / total
        share = 1 - (1 - between) * (count - 1) / (count - groups)
        found.append(Influence(name, max(0.0, float(share)), float(np.corrcoef(own, ranks)[0, 1])))
    return sorted(found, key=lambda influence: -influence.share)

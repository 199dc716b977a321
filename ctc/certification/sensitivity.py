"""Which of the drawn numbers hurts: how much of the spread of the peak errors each explains on its own.

Errors grow with a deviation to either side as often as to one, and of joints at rest they are all but equal: so no line
is fitted. The loops are ranked by their peak, and cut into equal groups by one number; the share of the variance of the
ranks that lies between the groups is what that number explains, in any shape (the correlation ratio, less what chance
gives). Spearman's rank correlation beside it says which direction hurts. Numbers that were drawn together, as the
parameters of one identification are, share what they explain.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

__all__ = ["Influence", "influences"]

_GROUPS, _LEAST = 10, 20
"""Groups, and how many loops a group must have at least."""

_LITTLE, _CLEAR = 0.005, 0.1
"""Share below which a number has no direction, and rank correlation from which on it has one."""


class Influence(NamedTuple):
    """What a drawn number does: `share` of the variance explained (0 to 1), `direction` from -1 (less hurts) to 1."""

    name: str
    share: float
    direction: float

    @property
    def sense(self):
        """The direction in words; none for what explains nearly nothing."""
        if self.share < _LITTLE:
            return ""
        return "more hurts" if self.direction > _CLEAR else "less hurts" if self.direction < -_CLEAR else "either way"


def influences(names, values, peaks):
    """Influence of each number, the largest share first.

    Parameters
    ----------
    names : sequence of str
    values : (P, K) numpy.ndarray
    peaks : (P,) numpy.ndarray
        May be infinite.

    Returns
    -------
    list of Influence
    """
    ranks, count = ranked(peaks), len(peaks)
    groups = min(_GROUPS, count // _LEAST)
    if groups < 2 or np.ptp(ranks) == 0:
        return [Influence(name, 0.0, 0.0) for name in names]
    total, found = ranks.var() * count, []
    for name, column in zip(names, values.T, strict=True):
        own = ranked(column)
        group = np.minimum((own - 0.5) * groups / count, groups - 1).astype(int)
        size = np.bincount(group, minlength=groups)
        means = np.bincount(group, weights=ranks, minlength=groups) / np.maximum(size, 1)
        between = (size * (means - ranks.mean()) ** 2).sum() / total
        share = 1 - (1 - between) * (count - 1) / (count - groups)
        found.append(Influence(name, max(0.0, float(share)), float(np.corrcoef(own, ranks)[0, 1])))
    return sorted(found, key=lambda influence: -influence.share)


def ranked(values):
    """Ranks (N,) from 1; equal values share the mean of theirs."""
    _, place, size = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(size) - (size - 1) / 2)[place]

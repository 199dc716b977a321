"""Stated ranges of resonance and damping in small parts, so that a bound of a range holds for its worst part."""

import dataclasses
import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.uncertainty import Uncertainty
from plant.parts.frozen import Frozen


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

    Attributes
    ----------
    name : str
        ``resonance``, or that of a joint, as ``resonance[0]``.
    hz, damping_ratio : tuple of float
        Lowest and highest.
    count, failures : int
        Plants in it, and those that exceed the limit.
    """

    name: str
    hz: tuple[float, float]
    damping_ratio: tuple[float, float]
    count: int
    failures: int

    def upper(self, confidence: float) -> float:
        """Upper bound of the probability to exceed the limit, one-sided, at a confidence; 1 without plants."""
        return clopper_pearson(self.failures, self.count, 2 * confidence - 1)[1] if self.count else 1.0

    def __repr__(self) -> str:
        return f"Cell({self.name}: {self}; {self.failures} of {self.count} exceed the limit)"

    def __str__(self) -> str:
        (low, high), (least, most) = self.hz, self.damping_ratio
        damping = f"{least:.3g}" if least == most else f"{least:.3g} to {most:.3g}"
        return f"{low:.3g} to {high:.3g} Hz, damping ratio {damping}"


def cells(
    ranges: Uncertainty, names: tuple[str, ...], values: NDArray[np.float64], outside: NDArray[np.bool_]
) -> list[Cell]:
    """The ranges of resonance and damping in cells of at most 10 %; of several joints, each joint's own.

    Names (K) and values (P, K) are of the plants, without what does not vary; those `outside` (P,) exceed the limit.
    """
    found, pairs = [], ranges.resonance or ()
    least, most = ranges.damping_ratio or (0.0, 0.0)
    for i, (low, high) in enumerate(pairs):
        name = "resonance" if len(pairs) == 1 else f"resonance[{i}]"
        edges = np.geomspace(low, high, max(1, int(np.ceil(np.log(high / low) / np.log(_WIDTH)))) + 1).tolist()
        dampings = np.linspace(least, most, 1 + (_DAMPINGS if least < most else 1)).tolist()
        of_hz, of_ratio = (_place(names, values, *each) for each in ((name, edges), ("damping_ratio", dampings)))
        parts = (enumerate(itertools.pairwise(ends)) for ends in (edges, dampings))
        for (j, hz), (k, ratio) in itertools.product(*parts):
            inside = outside[(of_hz == j) & (of_ratio == k)]
            failures = int(inside.sum())
            found.append(Cell(name=name, hz=hz, damping_ratio=ratio, count=len(inside), failures=failures))
    return found


def _place(names: tuple[str, ...], values: NDArray[np.float64], name: str, edges: Any) -> NDArray[np.intp]:
    """In which interval between the edges the number of each plant (P,) is."""
    if name not in names:
        return np.zeros(len(values), int)
    return np.clip(np.searchsorted(edges, values[:, names.index(name)], side="right") - 1, 0, len(edges) - 2)

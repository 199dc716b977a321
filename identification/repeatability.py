"""Spread of the result over a series of identifications. Source: paper 4.2 (alteration)."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.procedure import identify
from identification.results.identification import Identification
from plant import Dynamics, Record
from plant.parts.arguments import array
from plant.parts.checkpoint import Checkpoint
from plant.parts.frozen import Frozen

__all__ = ["Spread", "alteration", "spread"]


def alteration(f: ArrayLike) -> NDArray[np.float64]:
    """(max - min) / (2 abs(mean)) of each column of f (S, p), as a fraction. Source: paper 4.2."""
    f = np.asarray(f, float)
    return (f.max(axis=0) - f.min(axis=0)) / (2 * np.abs(f.mean(axis=0)))


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Spread(Frozen):
    """A series of identifications of the same records.

    Attributes
    ----------
    names : tuple of str
    runs : tuple of Identification
    f : (S, p) numpy.ndarray
    alteration : (p,) numpy.ndarray
        As a fraction.
    published : (p,) numpy.ndarray or None
        Alterations to print beside it.

    See Also
    --------
    identification.spread

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import spread
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> series = spread(puma560.dynamics(), record, seeds=range(2), progress=False)
    >>> series.f.shape
    (2, 9)
    """

    names: tuple[str, ...]
    runs: tuple[Identification, ...]
    f: NDArray[np.float64]
    alteration: NDArray[np.float64]
    published: NDArray[np.float64] | None

    def __str__(self) -> str:
        dynamics = self.runs[0].arm.dynamics
        lines = [f"{'':>4} {'mean':>9} {'min':>9} {'max':>9} {'alteration':>11}" + self._beside("paper")]
        for i, name in enumerate(dynamics.short_names):
            column = self.f[:, i]
            row = f"{name:>4} {column.mean():9.3f} {column.min():9.3f} {column.max():9.3f} "
            paper = "" if self.published is None else f"{self.published[i]:.0%}"
            lines.append(row + f"{self.alteration[i]:11.0%}" + self._beside(paper))
        first, last = (np.median([getattr(r, k) for r in self.runs]) for k in ("initial_objective", "objective"))
        lines.append(f"objective, median of {len(self.runs)} runs: {first:.0f} -> {last:.0f} pulses^2")
        return "\n".join([*lines, *dynamics.legend.splitlines()])

    def _beside(self, text: str) -> str:
        return "" if self.published is None else f" {text:>7}"


def spread(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    *,
    seeds: Iterable[int] = range(10),
    published: ArrayLike | None = None,
    method: str = "paper",
    checkpoint: str | Path | None = None,
    **options: Any,
) -> Spread:
    """Identify the same records with several seeds and say how much each f varies.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
    seeds : iterable of int
    published : (p,) array_like, optional
        Alterations to print beside the result, such as `plant.robots.puma560.PUBLISHED_ALTERATION`.
    method : str
        The paper's by default: it is its series that varies; the default of `identify` varies far less.
    checkpoint : str or Path, optional
        File in which finished stages of the runs are kept, as of `identify`; more seeds go on from those that it has.
    **options
        Of `identify`.

    Returns
    -------
    Spread
        Print it for the table.

    Raises
    ------
    ValueError
        Fewer than two seeds, or what `identify` refuses.

    See Also
    --------
    identification.Spread, identification.identify

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import spread
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> print(len(spread(puma560.dynamics(), record, seeds=range(2), progress=False).runs))
    2
    """
    seeds = tuple(seeds) if isinstance(seeds, Iterable) else (seeds,)
    if len(seeds) < 2:
        raise ValueError(f"seeds must be two or more; got {len(seeds)}. A spread needs a series of runs.")
    if published is not None:
        published = array("published", published, (dynamics.p,), advice="Give one alteration per f.")
    with Checkpoint(checkpoint, "spread") as kept:
        runs = tuple(
            identify(dynamics, records, seed=seed, method=method, checkpoint=kept.part(f"seed {seed}"), **options)
            for seed in seeds
        )
    f = np.array([run.f for run in runs])
    return Spread(names=dynamics.names, runs=runs, f=f, alteration=alteration(f), published=published)

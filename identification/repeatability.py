"""Spread of the result over a series of identifications. Source: paper 4.2 (alteration)."""

import functools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.procedure import identify
from identification.results import Identification
from plant import Dynamics, Record
from plant.parts import (
    Aside,
    Checkpoint,
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    array,
    frozen,
)
from plant.simulation import mapped


def alteration(f: ArrayLike) -> Floats:
    """(max - min) / (2 abs(mean)) of each column of f (S, p), as a fraction. Source: paper 4.2."""
    f = np.asarray(f, float)
    return (f.max(axis=0) - f.min(axis=0)) / (2 * np.abs(f.mean(axis=0)))


@frozen
class Spread(Shown, Frozen):
    """A series of identifications of the same records.

    `f` (S, p) has one row per run. `alteration` (p,) is a fraction. `published` (p,) holds
    alterations to print beside it.
    """

    names: tuple[str, ...]
    runs: tuple[Identification, ...]
    f: Floats
    alteration: Floats
    published: Floats | None

    def _short(self) -> str:
        return (
            f"{len(self.runs)} runs of {len(self.names)} values, alteration up to"
            f" {self.alteration.max():.0%}"
        )

    def _shown(self) -> Iterator[Piece]:
        # The median, as a single run may have a bad start.
        initial = np.median([run.initial_objective for run in self.runs])
        final = np.median([run.objective for run in self.runs])
        yield Verdict(
            f"objective, median of {len(self.runs)} runs: {initial:.0f} -> {final:.0f} pulses^2"
        )
        dynamics = self.runs[0].arm.dynamics
        # One row per parameter; the published alterations, if any, are the last column.
        columns = {
            "": dynamics.short_names,
            "mean": [f"{value:.3f}" for value in self.f.mean(axis=0)],
            "min": [f"{value:.3f}" for value in self.f.min(axis=0)],
            "max": [f"{value:.3f}" for value in self.f.max(axis=0)],
            "alteration": [f"{value:.0%}" for value in self.alteration],
        }
        if self.published is not None:
            columns["paper"] = [f"{value:.0%}" for value in self.published]
        yield Table(tuple(columns), list(zip(*columns.values(), strict=True)))
        yield Aside("What the parameters mean", dynamics.legend.splitlines())


def spread(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    *,
    seeds: Iterable[int] = range(10),
    published: ArrayLike | None = None,
    method: str = "paper",
    checkpoint: str | Path | None = None,
    executor: Any = None,
    **options: Any,
) -> Spread:
    """Identify the same records with several seeds, to see how much each value of f varies.

    Parameters
    ----------
    dynamics : Dynamics
    records : Record or sequence of Record
    seeds : iterable of int
    published : (p,) array_like, optional
        Alterations to print beside the result, such as `plant.robots.puma560.PUBLISHED_ALTERATION`.
    method : str
        Method of `identify`. The default here is the paper's, because its results vary with the
        seed; those of the default method of `identify` vary far less.
    checkpoint : str or Path, optional
        File that stores the finished stages of the runs, as in `identify`; a later call with more
        seeds continues from this file. It cannot be combined with an executor.
    executor : optional
        Runs the identifications in parallel: a `concurrent.futures.Executor`, a Dask ``Client``, or
        a function that makes one of these. It cannot be combined with a checkpoint.
    **options
        Of `identify`.

    Returns
    -------
    Spread
        Print it for the table.

    Raises
    ------
    ValueError
        Fewer than two seeds, or one seed twice; `published` that does not have one value per f; a
        checkpoint together with an executor; or input that `identify` refuses.

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import spread
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    >>> print(len(spread(puma560.dynamics(), record, seeds=range(2), progress=False).runs))
    2
    """
    # A bare number counts as one seed, so that the check below refuses it with a clear message.
    seeds = tuple(seeds) if isinstance(seeds, Iterable) else (seeds,)
    if len(seeds) < 2:
        raise ValueError(
            f"seeds must be two or more; got {len(seeds)}. A spread needs a series of runs."
        )
    if len(set(seeds)) < len(seeds):
        raise ValueError(
            f"seeds must differ; got {seeds}. Runs of one seed are alike, and show no spread."
        )
    if "seed" in options:
        raise ValueError(
            f"seeds must be given alone; got seed={options['seed']!r} as well. Leave seed out."
        )
    if published is not None:
        # Alterations of f alone, as the paper has no other unknowns.
        published = array(
            "published", published, (dynamics.p,), advice="Give one alteration per f."
        )
    # Processes cannot share a file of stages.
    if executor is not None and checkpoint is not None:
        raise ValueError("checkpoint must be left out with an executor; got both. Leave out one.")
    # The seed alone differs between runs.
    run = functools.partial(_run, dynamics, records, {"method": method, **options})
    # Without an executor the runs follow one another; each has a part of the file for its stages.
    if executor is None:
        with Checkpoint(checkpoint, "spread") as stored:
            runs = tuple(run(seed, checkpoint=stored.part(f"seed {seed}")) for seed in seeds)
    else:
        runs = tuple(mapped(run, seeds, executor))
    # The spread is that of f alone; the runs hold any further unknowns.
    f = np.array([run.f for run in runs])
    return Spread(
        names=dynamics.names, runs=runs, f=f, alteration=alteration(f), published=published
    )


def _run(
    dynamics: Dynamics, records: Any, options: dict[str, Any], seed: int, **checkpoint: Any
) -> Identification:
    # A function of this module, so that processes of an executor can import it.
    return identify(dynamics, records, seed=seed, **options, **checkpoint)

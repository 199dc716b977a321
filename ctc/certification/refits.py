"""An identification on rigid gears, fitted again on elastic ones of stated resonances.

A log of an elastic arm, identified with rigid gears, gives an f that makes up for them, off by many of its standard
deviations. Where a range of resonances is stated, what the log shows of f depends on the resonance; plants of a
resonance have the f that fits the log there.
"""

import dataclasses
import functools
import weakref
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.verdict.on_gears import with_gears
from identification import Identification
from identification.preparation import prepare
from identification.procedure import search
from identification.search.outcome import Fit
from plant import Arm, Elasticity
from plant.parts.checkpoint import Checkpoint
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.progress import progress_bar

_APART, _MOST = 1.15, 7
"""Ratio of the resonances of two fits, at most, and number of fits; a wider range has them farther apart."""

_ROUNDS = 2
"""Fits of the first resonance: its stiffness follows from the inertia, which the fit before gave. The next take it from
their neighbour."""

_REMEMBERED = 8  # ranges of one identification whose fits are kept, the last ones


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Refits(Frozen):
    """Fits over a range of resonances.

    Attributes
    ----------
    places : (K,) numpy.ndarray
        Of each fit in the range, from 0 to 1, in the logarithm of the resonance.
    values : (K, k) numpy.ndarray
        Of the unknowns.
    covariances : (K, k, k) numpy.ndarray
    """

    places: NDArray[np.float64]
    values: NDArray[np.float64]
    covariances: NDArray[np.float64]

    def centres(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (P, k) at places (P,) of the range."""
        return np.column_stack([np.interp(places, self.places, column) for column in self.values.T])

    def nearest(self, places: NDArray[np.float64]) -> NDArray[np.intp]:
        """Which fit (P,) is nearest to each place (P,)."""
        return np.abs(places[:, None] - self.places).argmin(axis=1)


_KEPT: weakref.WeakKeyDictionary[Identification, dict[Any, Refits | None]] = weakref.WeakKeyDictionary()
"""Fits of an identification by stated range, while it exists; an equal one, bit for bit, has the same."""


def refits(
    found: Identification, resonance: Any, damping_ratio: Any, pose: ArrayLike, progress: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Refits | None:  # fmt: skip
    """Fits of an identification's records on gears over the range; None where no resonance of it can be fitted.

    They are made once for each range, and kept with the identification.

    Parameters
    ----------
    found : Identification
        On rigid gears.
    resonance : sequence of (float, float)
        Lowest and highest [Hz], one pair or one for each joint.
    damping_ratio : (float, float)
        The fits have the middle of it.
    pose : (n,) array_like
        At which the resonances are those of the gears [rad].
    progress : bool
        Show a progress bar.
    checkpoint : Checkpoint, optional
        Of which each fit is a stage.
    """
    ranges, ratio = np.asarray(resonance, float), float(np.mean(damping_ratio))
    pose = np.asarray(pose, float)
    key = (ranges.shape, ranges.tobytes(), ratio, pose.tobytes())
    kept = _KEPT.setdefault(found, {})
    made = kept.pop(key) if key in kept else _fitted(found, ranges, ratio, pose, progress, Checkpoint(checkpoint, ""))
    kept[key] = made
    if len(kept) > _REMEMBERED:
        del kept[next(iter(kept))]
    return made


def _fitted(
    found: Identification, ranges: NDArray[np.float64], ratio: float, pose: NDArray[np.float64], progress: bool,
    checkpoint: Checkpoint,
) -> Refits | None:  # fmt: skip
    """The fits, made anew."""
    low, high = np.log(ranges).T
    count = int(np.clip(np.ceil((high - low).max() / np.log(_APART)) + 1, 1 if (high == low).all() else 2, _MOST))
    arm, fits = found.arm, dict[float, Fit]()
    with progress_bar(count + _ROUNDS - 1, "fits on gears", "fit", progress) as bar:
        for place in np.linspace(0, 1, count) if count > 1 else [0.5]:
            hz = np.exp(low + place * (high - low))
            for again in range(1 if fits else _ROUNDS):
                make = functools.partial(_on_gears, found, arm, hz, ratio, pose)
                fitted = checkpoint.stage(f"fit {again} on gears at {place}", make)
                bar.update()
                if fitted is None:
                    fits.pop(place, None)
                    break
                arm, fits[place] = fitted
    if not fits:
        return None
    values, covariances = (np.array([getattr(fit, name) for fit in fits.values()]) for name in ("values", "covariance"))
    places = np.array([*fits])
    for each in (places, values, covariances):
        each.setflags(write=False)  # they are shared
    return Refits(places=places, values=values, covariances=covariances)


def _on_gears(found: Identification, arm: Arm, hz: Any, ratio: float, pose: ArrayLike) -> tuple[Arm, Fit] | None:
    """Arm and fit of the records on gears with which an arm has this resonance; None where they cannot be fitted."""
    try:
        gears = Elasticity.from_resonance(arm, hz, ratio, drive=found.rig.drive, q=pose)
        records = [dataclasses.replace(record, rig=with_gears(record.rig, gears)) for record in found.records]
        problem = prepare(
            found.arm.dynamics, records, found.fit.unknown, (), "prediction_error", found.search.ranges, None,
            found.search.seed, False, {}, prior=found.fit.prior,
        )  # fmt: skip
        fit = search(problem, False).fit
    except ValueError:  # no fit on such gears: the log contradicts them, or they cannot carry the arm
        return None
    return None if fit.covariance is None else (problem.parts(fit.values)[0], fit)

"""What was identified of a plant, with its covariance; on gears of a stated range, as it depends on
their resonance.

A log of an elastic arm, identified with rigid gears, gives an f that makes up for them, off by many
of its standard deviations. Where a range of resonances is stated, what the log shows of f depends
on the resonance; plants of a resonance have the f that fits the log there.
"""

import dataclasses
import functools
import weakref
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.certification.uncertainty import Uncertainty
from ctc.verdict.on_gears import with_gears
from identification import Identification
from identification.preparation import prepare
from identification.procedure import search
from identification.search.outcome import Fit
from plant import Arm, Elasticity
from plant.parts.arguments import array, instance
from plant.parts.checkpoint import Checkpoint
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.messages import progress_bar
from plant.parts.sums import product

# Numbers of the rig by which a controller reads its counts: it and the plant have the same.
_KNOWN_TO_LAWS = ("drive.gear", "encoder.resolution")

# Ratio of the resonances of two fits, at most, and number of fits; a wider range has them farther
# apart.
_APART = 1.15
_MOST = 7

# Fits of the first resonance: its stiffness follows from the inertia, which the fit before gave.
# The next take it from their neighbour.
_ROUNDS = 2

_REMEMBERED = 8  # ranges of one identification whose fits are kept, the last ones


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Refits(Frozen):
    """Fits over a range of resonances: places (K,) from 0 to 1, in its logarithm; values and
    covariances of each.
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


# Fits of an identification by stated range, while it exists; an equal one, bit for bit, has the
# same.
_KEPT: weakref.WeakKeyDictionary[Identification, dict[Any, Refits | None]] = (
    weakref.WeakKeyDictionary()
)


def refits(
    found: Identification,
    resonance: Any,
    damping_ratio: Any,
    pose: ArrayLike,
    progress: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Refits | None:
    """Fits of an identification's records on gears over the range; None where no resonance of it
    can be fitted.

    They are made once for each range, the middle of the damping ratios and the pose [rad] at which
    the resonances [Hz] are those of the gears, and kept with the identification.
    """
    ranges = np.asarray(resonance, float)
    ratio = float(np.mean(damping_ratio))
    pose = np.asarray(pose, float)
    key = (ranges.shape, ranges.tobytes(), ratio, pose.tobytes())
    kept = _KEPT.setdefault(found, {})
    made = (
        kept.pop(key)
        if key in kept
        else _fitted(found, ranges, ratio, pose, progress, Checkpoint(checkpoint, ""))
    )
    kept[key] = made
    if len(kept) > _REMEMBERED:
        del kept[next(iter(kept))]
    return made


def _fitted(
    found: Identification,
    ranges: NDArray[np.float64],
    ratio: float,
    pose: NDArray[np.float64],
    progress: bool,
    checkpoint: Checkpoint,
) -> Refits | None:
    """The fits, made anew."""
    low, high = np.log(ranges).T
    count = int(
        np.clip(
            np.ceil((high - low).max() / np.log(_APART)) + 1, 1 if (high == low).all() else 2, _MOST
        )
    )
    arm = found.arm
    fits = dict[float, Fit]()
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
    values, covariances = (
        np.array([getattr(fit, name) for fit in fits.values()]) for name in ("values", "covariance")
    )
    places = np.array([*fits])
    for each in (places, values, covariances):
        each.setflags(write=False)  # they are shared
    return Refits(places=places, values=values, covariances=covariances)


def _on_gears(
    found: Identification, arm: Arm, hz: Any, ratio: float, pose: ArrayLike
) -> tuple[Arm, Fit] | None:
    """Arm and fit of the records on gears with which an arm has this resonance; None where they
    cannot be fitted.
    """
    try:
        gears = Elasticity.from_resonance(arm, hz, ratio, drive=found.rig.drive, q=pose)
        records = [
            dataclasses.replace(record, rig=with_gears(record.rig, gears))
            for record in found.records
        ]
        problem = prepare(
            found.arm.dynamics,
            records,
            found.fit.unknown,
            (),
            "prediction_error",
            found.search.ranges,
            None,
            found.search.seed,
            False,
            {},
            prior=found.fit.prior,
        )
        fit = search(problem, False).fit
    # no fit on such gears: the log contradicts them, or they cannot carry the arm
    except ValueError:
        return None
    return None if fit.covariance is None else (problem.parts(fit.values)[0], fit)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """Distribution of the k identified numbers of a plant, with roots (K, k, r) of their
    covariance, to be sampled.

    With refits, K of them on gears of the stated resonances, the arm is that of the middle of the
    range.
    """

    arm: Arm
    names: tuple[str, ...]
    values: NDArray[np.float64]
    roots: NDArray[np.float64]
    refits: Refits | None = None

    def draw(self, random: Any, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers (P, k) of plants whose resonances are at these places (P, m) of their ranges."""
        deviations = random.standard_normal((len(places), self.roots.shape[2]))
        if self.refits is None:
            return np.asarray(self.values + product(deviations, self.roots[0].T))
        roots = self.roots[self.refits.nearest(places.mean(axis=1))]
        return self.centres(places) + (roots * deviations[:, None]).sum(axis=2)

    def centres(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """What the numbers (P, k) of such plants would be if they were known exactly."""
        if self.refits is None:
            return np.tile(self.values, (len(places), 1))
        return self.refits.centres(places.mean(axis=1))


def identified(
    uncertainty: Uncertainty,
    found: Identification | Arm,
    pose: ArrayLike,
    progress: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Identified:
    """What an `Uncertainty` samples of what was identified.

    With a stated range of resonances the records of an identification on rigid gears are fitted
    again on such gears.
    """
    if isinstance(found, Identification):
        arm = found.arm
        names = found.fit.unknown
        values = found.fit.values
        covariance = found.covariance
    else:
        arm = instance(
            "found",
            found,
            Arm,
            "Give what identify gave, or an Arm and Uncertainty(covariance=...).",
        )
        names = arm.dynamics.names
        values = arm.f
        covariance = None
    if uncertainty.plants is not None:
        return Identified(arm=arm, names=(), values=np.empty(0), roots=np.empty((1, 0, 0)))
    again = None
    if uncertainty.covariance is not None:
        covariance = np.asarray(uncertainty.covariance)
    elif (
        isinstance(found, Identification)
        and uncertainty.resonance is not None
        and found.rig.drive.elasticity is None
    ):
        again = refits(
            found, uncertainty.resonance, uncertainty.damping_ratio, pose, progress, checkpoint
        )
        if again is None:
            hz = ", ".join(f"{low:g} to {high:g} Hz" for low, high in uncertainty.resonance)
            why = f"the records cannot be fitted on gears of {hz}, which would have shown in them"
            raise ValueError(
                f"resonance must be what the records allow; {why}. State higher ones, or none."
            )
    if covariance is None and again is None:
        reason = found.fit.fallback_reason if isinstance(found, Identification) else None
        give = (
            "such as found.assumed().covariance(1.0) of one that follows its log, or"
            " plants=found.candidates."
        )
        why = (
            f"{reason or 'it comes without a covariance'}. Pass Uncertainty(covariance=...), {give}"
        )
        raise ValueError(f"found must have a covariance: {why}")
    k = len(names)
    plant = [i for i, name in enumerate(names) if not name.startswith("law.")]
    given: Any = covariance if again is None else again.covariances
    if again is None:
        given = array(
            "covariance", given, (k, k), advice="Give one row per name of found.fit.unknown."
        )[None]
    for name in (names[i] for i in plant):
        if (
            name.startswith(_KNOWN_TO_LAWS)
            and (given[:, names.index(name), names.index(name)] > 0).any()
        ):
            raise ValueError(
                f"{name} cannot be sampled: controllers read their counts by it. Identify with it"
                " fixed."
            )
    names = tuple(names[i] for i in plant)
    values = np.asarray(values)[plant]
    if again is not None:
        again = dataclasses.replace(again, values=again.values[:, plant])
        (values,) = again.centres(np.array([0.5]))
        middle = dict(zip(names, values.tolist(), strict=True))
        arm = arm.dynamics.arm(
            [middle.get(name, f) for name, f in zip(arm.dynamics.names, arm.f, strict=True)]
        )
    roots = np.array([_root(each, plant) for each in given])
    return Identified(arm=arm, names=names, values=values, refits=again, roots=roots)


def _root(covariance: NDArray[np.float64], plant: list[int]) -> NDArray[np.float64]:
    """A root (k, k) of the covariance of these of the unknowns."""
    if np.abs(covariance - covariance.T).max(initial=0) > 1e-6 * np.abs(covariance).max(initial=0):
        raise ValueError(
            "covariance must be symmetric; this one is not. Pass L L^T, not its factor L."
        )
    covariance, scale = (
        covariance[np.ix_(plant, plant)],
        np.sqrt(np.abs(np.diag(covariance)[plant])),
    )
    scale[scale == 0] = 1.0  # what is known exactly
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2 / np.outer(scale, scale))
    if sizes.min() < -1e-6 * max(1.0, sizes.max()):
        has = (
            f"its correlations have the eigenvalue {sizes.min():.3g}. Check its order, or pass"
            " found.covariance."
        )
        raise ValueError(f"covariance must be positive semidefinite; {has}")
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(sizes, 0)))

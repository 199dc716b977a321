"""Distribution of the identified numbers of a plant.

A log of an elastic arm that is identified with rigid gears gives inertial parameters f that
compensate for the gears: they are off by many of their standard deviations. Where a range of
resonances is stated, the log is therefore fitted again on gears of several resonances, and a plant
that is drawn with a resonance has the f that fits the log on such gears.
"""

import dataclasses
import functools
import weakref
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.certification.uncertainty import Uncertainty
from ctc.verdict import with_gears
from identification import Identification
from identification.preparation import prepare
from identification.procedure import search
from identification.results import detect
from identification.search import Fit, Problem
from plant import Arm, Elasticity
from plant.parts import (
    Checkpoint,
    Floats,
    Frozen,
    array,
    frozen,
    frozen_settings,
    instance,
    kept,
    product,
    progress_bar,
)

# Numbers of the rig by which a controller reads its counts: it and the plant have the same.
_KNOWN_TO_LAWS = ("drive.gear", "encoder.resolution")


@frozen_settings
class RefitSettings:
    """Numbers of the fits over a range of resonances, all chosen by hand.

    Parameters
    ----------
    ratio : float
        Largest ratio of the resonances of neighbouring fits, while no more than `fits` are needed.
    fits : int
        Largest number of fits; a wider range has them farther apart.
    first_rounds : int
        How often the lowest resonance is fitted. The stiffness of gears follows from a resonance
        and an inertia; the first round has the inertia of the fit on rigid gears, and each later
        one that of the round before. Every other resonance takes the inertia of its neighbour.
    stored : int
        Number of ranges whose fits are stored for an identification; the oldest ones are dropped.
    """

    ratio: float = 1.15
    fits: int = 7
    first_rounds: int = 2
    stored: int = 8


SETTINGS = RefitSettings()


@kept
@frozen
class Refits(Frozen):
    """Fits over a range of resonances.

    `places` (K,): of the fits in the logarithm of the range, 0 at its lower end and 1 at its upper
    end. `values` (K, k), `covariances` (K, k, k): of each fit.
    """

    places: Floats
    values: Floats
    covariances: Floats

    def centres(self, places: Floats) -> Floats:
        """Values (P, k) at places (P,) of the range, between the fits on straight lines."""
        return np.column_stack([np.interp(places, self.places, column) for column in self.values.T])

    def nearest(self, places: Floats) -> NDArray[np.intp]:
        """Index (P,) of the fit that is nearest to each place (P,)."""
        return np.abs(places[:, None] - self.places).argmin(axis=1)


# Fits of an identification by stated range. They are dropped with the identification; one that is
# equal to it, bit for bit, finds the same fits meanwhile.
_STORE: weakref.WeakKeyDictionary[Identification, dict[Any, Refits | None]] = (
    weakref.WeakKeyDictionary()
)


def refits(
    identification: Identification,
    resonance: Any,
    damping_ratio: Any,
    pose: ArrayLike,
    progress: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Refits | None:
    """Fits of an identification's records on gears over the range of resonances.

    None if the records cannot be fitted at any of these resonances.

    They are made once for each range, middle of the damping ratios, and pose [rad] at which the
    gears have the resonances [Hz], and stored with the identification.
    """
    ranges = np.asarray(resonance, float)
    ratio = float(np.mean(damping_ratio))
    pose = np.asarray(pose, float)
    # Bytes, not numbers: stored fits serve exactly the range for which they were made.
    key = (ranges.shape, ranges.tobytes(), ratio, pose.tobytes())
    stored = _STORE.setdefault(identification, {})
    if key in stored:
        # It becomes the latest: the oldest range that is not used again is dropped first.
        result = stored.pop(key)
    else:
        part = Checkpoint(checkpoint, "")
        result = _fitted(identification, ranges, ratio, pose, progress, part)
    stored[key] = result
    if len(stored) > SETTINGS.stored:
        del stored[next(iter(stored))]
    return result


def _fitted(
    identification: Identification,
    ranges: Floats,
    ratio: float,
    pose: Floats,
    progress: bool,
    checkpoint: Checkpoint,
) -> Refits | None:
    """New fits over the ranges (m, 2) of resonances [Hz]."""
    # 1. Resonances of the fits, in equal ratios from the lowest to the highest.
    low, high = np.log(ranges).T
    # The widest range decides, as all joints go through theirs together.
    steps = np.ceil((high - low).max() / np.log(SETTINGS.ratio))
    fewest = 1 if (high == low).all() else 2
    count = int(np.clip(steps + 1, fewest, SETTINGS.fits))
    arm = identification.arm
    # 2. From low to high; each fit begins with the inertia of the one before.
    fits = dict[float, Fit]()
    arms = dict[float, Arm]()
    rounds = SETTINGS.first_rounds
    with progress_bar(count + rounds - 1, "fits on gears", "fit", progress) as bar:
        for fraction in np.linspace(0, 1, count) if count > 1 else [0.5]:
            hz = np.exp(low + fraction * (high - low))
            for i in range(1 if fits else rounds):
                make = functools.partial(_on_gears, identification, arm, hz, ratio, pose)
                fitted = checkpoint.stage(f"fit {i} on gears at {fraction}", make)
                bar.update()
                if fitted is None:
                    # A resonance whose rounds do not all succeed has no fit.
                    fits.pop(fraction, None)
                    break
                # The stiffness of the next gears follows from this arm's inertia.
                arm, fits[fraction] = fitted
                arms[fraction] = arm
    # 3. Resonances that the log contradicts have no fit; the nearest stands for them.
    if not fits:
        return None
    places = np.array([*fits])
    values = np.array([fit.values for fit in fits.values()])
    # A fit counts the noise of the log alone. What tolerances and the scatter between segments add
    # is taken from the middle of the range: a resonance hardly changes it.
    middle = min(fits, key=lambda fraction: abs(fraction - 0.5))
    hz = np.exp(low + middle * (high - low))
    widening = functools.partial(_beside_noise, identification, arms[middle], hz, ratio, pose)
    beside_noise = checkpoint.stage("tolerances on gears", widening)
    of_noise = [fit.covariance_of(fit.unknown) for fit in fits.values()]
    covariances = np.array(of_noise) + beside_noise
    for shared in (places, values, covariances):
        shared.setflags(write=False)  # all certificates of this range have the same arrays
    return Refits(places=places, values=values, covariances=covariances)


def _on_gears(
    identification: Identification, arm: Arm, hz: Any, ratio: float, pose: ArrayLike
) -> tuple[Arm, Fit] | None:
    """Arm and fit of the records on gears with this resonance [Hz]; None if no fit exists."""
    try:
        problem = _prepared(identification, arm, hz, ratio, pose)
        fit = search(problem).fit
    except ValueError:  # the log contradicts such gears, or they cannot carry the arm
        return None
    refitted, _, _ = problem.parts(fit.values)
    return None if fit.covariance is None else (refitted, fit)


def _beside_noise(
    identification: Identification, arm: Arm, hz: Any, ratio: float, pose: ArrayLike
) -> Floats:
    """Covariance (k, k) that tolerances and scatter add to that of noise, on gears of an arm."""
    problem = _prepared(identification, arm, hz, ratio, pose)
    outcome = search(problem)
    widened = detect(problem, outcome.fit, outcome).widened(outcome.fit)
    names = outcome.fit.unknown
    return widened.covariance_of(names) - outcome.fit.covariance_of(names)


def _prepared(
    identification: Identification, arm: Arm, hz: Any, ratio: float, pose: ArrayLike
) -> Problem:
    """The problem of the records, on gears with this resonance [Hz] in place of rigid drives."""
    gears = Elasticity.from_resonance(arm, hz, ratio, drive=identification.rig.drive, q=pose)
    records = [
        dataclasses.replace(record, rig=with_gears(record.rig, gears))
        for record in identification.records
    ]
    return prepare(
        dynamics=identification.arm.dynamics,
        records=records,
        unknown=identification.fit.unknown,
        held_out=(),
        method="prediction_error",
        ranges=identification.search.ranges,
        settings=None,
        seed=identification.search.seed,
        zeros=False,
        options={},
        tolerances=identification.search.tolerances,
        prior=identification.fit.prior,
    )


@frozen
class Identified:
    """Normal distribution of the k identified numbers of a plant.

    `arm`: that of the controller; with fits on gears, that of the middle of their range. `names`,
    `values` (k,): of the numbers. `roots` (K, k, k): of the covariance of each of the K fits on
    gears of the stated resonances, or of the only one without them. `of_rig`: identified numbers of
    the rig, name -> value, also where given arms replace the distribution. `refits`: these fits.
    """

    arm: Arm
    names: tuple[str, ...]
    values: Floats
    roots: Floats
    of_rig: dict[str, float]
    refits: Refits | None = None

    def draw(self, random: Any, places: Floats) -> Floats:
        """Numbers (P, k) of plants whose resonances are at these places (P, m) of their ranges."""
        # The same normal numbers for any fit: only their root depends on the resonance.
        deviations = random.standard_normal((len(places), self.roots.shape[2]))
        if self.refits is None:
            return np.asarray(self.values + product(deviations, self.roots[0].T))
        # Covariances are not interpolated: that of the nearest fit is a covariance for certain.
        roots = self.roots[self.refits.nearest(places.mean(axis=1))]
        return self.centres(places) + (roots * deviations[:, None]).sum(axis=2)

    def centres(self, places: Floats) -> Floats:
        """Expected numbers (P, k) of plants whose resonances are at these places (P, m)."""
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
    """Distribution of the identified numbers that an `Uncertainty` states.

    With a stated range of resonances the records of an identification on rigid gears are fitted
    again on such gears.
    """
    # Names, values and covariance come from the log, or from the arm alone.
    if isinstance(found, Identification):
        arm = found.arm
        names = found.fit.unknown
        values = found.fit.values
        covariance = found.covariance
    else:
        advice = "Give what identify gave, or an Arm and Uncertainty(covariance=...)."
        arm = instance("found", found, Arm, advice)
        names = arm.dynamics.names
        values = arm.f
        covariance = None
    # Numbers of the logged law are no property of the plant.
    plant = [i for i, name in enumerate(names) if not name.startswith("law.")]
    of_rig = {names[i]: values[i] for i in plant if names[i] not in arm.dynamics.names}
    # 1. The distribution: stated arms, a stated covariance, fits on gears, or that of the log.
    # Given arms replace the distribution: no number is drawn.
    if uncertainty.plants is not None:
        return Identified(
            arm=arm, names=(), values=np.empty(0), roots=np.empty((1, 0, 0)), of_rig=of_rig
        )
    fits = None
    if uncertainty.covariance is not None:
        covariance = np.asarray(uncertainty.covariance)
    elif (
        isinstance(found, Identification)
        and uncertainty.resonance is not None
        and found.rig.drive.elasticity is None
    ):
        fits = refits(
            found, uncertainty.resonance, uncertainty.damping_ratio, pose, progress, checkpoint
        )
        if fits is None:
            hz = ", ".join(f"{low:g} to {high:g} Hz" for low, high in uncertainty.resonance)
            raise ValueError(
                "resonance must be what the records allow; the records cannot be fitted on gears of"
                f" {hz}, which would have shown in them. State higher ones, or none."
            )
    if fits is not None:
        covariances = fits.covariances
    elif covariance is not None:
        advice = "Give one row per name of found.fit.unknown."
        covariances = array("covariance", covariance, (len(names),) * 2, advice=advice)[None]
    else:
        reason = found.fit.fallback_reason if isinstance(found, Identification) else None
        raise ValueError(
            f"found must have a covariance; {reason or 'an arm alone has none'}. Pass"
            " Uncertainty(covariance=...), such as found.assumed().covariance(1.0) of one that"
            " follows its log, or plants=found.candidates."
        )
    # 2. The numbers of it that belong to the plant.
    for i in plant:
        # Plants and controller have one rig: a plant cannot have another gear than its controller.
        if names[i].startswith(_KNOWN_TO_LAWS) and (covariances[:, i, i] > 0).any():
            raise ValueError(
                f"{names[i]} cannot be sampled: controllers read their counts by it. Identify with"
                " it fixed."
            )
    # The law's numbers are marginalised: their rows and columns go.
    names = tuple(names[i] for i in plant)
    values = np.asarray(values)[plant]
    if fits is not None:
        # The controller has the arm of the middle resonance.
        fits = dataclasses.replace(
            fits, values=fits.values[:, plant], covariances=covariances[:, plant][:, :, plant]
        )
        (values,) = fits.centres(np.array([0.5]))
        middle = dict(zip(names, values.tolist(), strict=True))
        of_rig = {name: middle[name] for name in of_rig}
        f = [middle.get(name, f) for name, f in zip(arm.dynamics.names, arm.f, strict=True)]
        arm = arm.dynamics.arm(f)
    roots = np.array([_root(covariance, plant) for covariance in covariances])
    return Identified(arm=arm, names=names, values=values, refits=fits, roots=roots, of_rig=of_rig)


def _root(covariance: Floats, plant: list[int]) -> Floats:
    """A root (k, k) of the covariance of the unknowns in the places `plant` (k,)."""
    # Rounding leaves asymmetry and negative eigenvalues of 1e-15; 1e-6 is a mistake of the user.
    tolerance = 1e-6
    asymmetry = np.abs(covariance - covariance.T).max(initial=0)
    if asymmetry > tolerance * np.abs(covariance).max(initial=0):
        raise ValueError(
            "covariance must be symmetric; this one is not. Pass L L^T, not its factor L."
        )
    covariance = covariance[np.ix_(plant, plant)]
    # Scaling to correlations makes eigenvalues of different units comparable.
    # Magnitudes: a negative variance is refused below, with its eigenvalue.
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale[scale == 0] = 1.0  # a number without uncertainty
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2 / np.outer(scale, scale))
    if sizes.min() < -tolerance * max(1.0, sizes.max()):
        reason = (
            f"its correlations have the eigenvalue {sizes.min():.3g}. Check its order, or pass"
            " found.covariance."
        )
        raise ValueError(f"covariance must be positive semidefinite; {reason}")
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(sizes, 0)))

"""What was identified of a plant, with its covariance; on gears of a stated range, as it depends on their resonance."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.certification.refits import Refits, refits
from ctc.certification.uncertainty import Uncertainty
from identification import Identification
from plant import Arm
from plant.parts.arguments import array, instance
from plant.parts.checkpoint import Checkpoint
from plant.parts.sums import product

_KNOWN_TO_LAWS = ("drive.gear", "encoder.resolution")
"""Numbers of the rig by which a controller reads its counts: it and the plant have the same."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """Distribution of the identified numbers of a plant, ready to be sampled.

    Attributes
    ----------
    arm : Arm
        With what was identified of f; with refits, with that of the middle of the range.
    names : tuple of str
        Of the numbers (k).
    values : (k,) numpy.ndarray
    roots : (K, k, r) numpy.ndarray
        Of the covariance; K = 1 without refits.
    refits : Refits or None
        Fits on gears of the stated resonances, of the same numbers.
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
    uncertainty: Uncertainty, found: Identification | Arm, pose: ArrayLike, progress: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Identified:  # fmt: skip
    """What an `Uncertainty` samples of what was identified.

    With a stated range of resonances the records of an identification on rigid gears are fitted again on such gears.

    Raises
    ------
    ValueError
        No covariance, or one that is none; gears or resolutions that were identified.
    """
    if isinstance(found, Identification):
        arm, names, values, covariance = found.arm, found.fit.unknown, found.fit.values, found.covariance
    else:
        arm = instance("found", found, Arm, "Give what identify gave, or an Arm and Uncertainty(covariance=...).")
        names, values, covariance = arm.dynamics.names, arm.f, None
    if uncertainty.plants is not None:
        return Identified(arm=arm, names=(), values=np.empty(0), roots=np.empty((1, 0, 0)))
    again = None
    if uncertainty.covariance is not None:
        covariance = np.asarray(uncertainty.covariance)
    elif isinstance(found, Identification) and uncertainty.resonance is not None and found.rig.drive.elasticity is None:
        again = refits(found, uncertainty.resonance, uncertainty.damping_ratio, pose, progress, checkpoint)
    if covariance is None and again is None:
        reason = found.fit.fallback_reason if isinstance(found, Identification) else None
        why = reason or "it comes without a covariance"
        raise ValueError(
            f"found must have a covariance: {why}. Pass Uncertainty(covariance=...), such as "
            "found.assumed().covariance(1.0) of an identification that follows its log, or plants=found.candidates."
        )
    k, plant = len(names), [i for i, name in enumerate(names) if not name.startswith("law.")]
    given: Any = covariance if again is None else again.covariances
    if again is None:
        given = array("covariance", given, (k, k), advice="Give one row per name of found.fit.unknown.")[None]
    for name in (names[i] for i in plant):
        if name.startswith(_KNOWN_TO_LAWS) and (given[:, names.index(name), names.index(name)] > 0).any():
            raise ValueError(f"{name} cannot be sampled: controllers read their counts by it. Identify with it fixed.")
    names, values = tuple(names[i] for i in plant), np.asarray(values)[plant]
    if again is not None:
        again = dataclasses.replace(again, values=again.values[:, plant])
        (values,) = again.centres(np.array([0.5]))
        middle = dict(zip(names, values.tolist(), strict=True))
        arm = arm.dynamics.arm([middle.get(name, f) for name, f in zip(arm.dynamics.names, arm.f, strict=True)])
    roots = np.array([_root(each, plant) for each in given])
    return Identified(arm=arm, names=names, values=values, refits=again, roots=roots)


def _root(covariance: NDArray[np.float64], plant: list[int]) -> NDArray[np.float64]:
    """A root (k, k) of the covariance of these of the unknowns."""
    if np.abs(covariance - covariance.T).max(initial=0) > 1e-6 * np.abs(covariance).max(initial=0):
        raise ValueError("covariance must be symmetric; this one is not. Pass L L^T, not its factor L.")
    covariance, scale = covariance[np.ix_(plant, plant)], np.sqrt(np.abs(np.diag(covariance)[plant]))
    scale[scale == 0] = 1.0  # what is known exactly
    sizes, axes = np.linalg.eigh((covariance + covariance.T) / 2 / np.outer(scale, scale))
    if sizes.min() < -1e-6 * max(1.0, sizes.max()):
        raise ValueError(
            f"covariance must be positive semidefinite; its correlations have the eigenvalue {sizes.min():.3g}. "
            "Check its order, or pass found.covariance."
        )
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(sizes, 0)))

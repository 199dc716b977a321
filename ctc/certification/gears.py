"""What gears and drives do that a rigid rig leaves out, drawn for each plant: resonance, damping, backlash, lag.

A resonance is stated as a range in which it lies, not as a distribution: somewhere in it is the one that the arm has.
The plants are spread over it, and what is said of them holds for the worst part of it (`ctc.certification.cells`).
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant import Arm, Elasticity, Rig
from plant.machine.elasticity import gears
from plant.parts.arguments import array, real
from plant.parts.frozen import Frozen

__all__ = ["Drawn", "Gears", "between"]

_USUAL = (0.01, 0.03)
"""Damping ratio unless stated."""

_FOLLOWED = 0.6
"""Phase [rad] of a resonance in one sub-step up to which its frequency is right to 1 %."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Drawn(Frozen):
    """Numbers of each plant, and those of its loop that follow from them.

    Attributes
    ----------
    names : tuple of str
    values : (P, K) numpy.ndarray
    derived_names : tuple of str
    derived : (P, L) numpy.ndarray
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    derived_names: tuple[str, ...]
    derived: NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Gears:
    """Distribution of what gears and drives do.

    Parameters
    ----------
    resonance : (2,) or (n, 2) array_like, optional
        Lowest and highest locked-rotor resonance at the reference's first pose [Hz]: one pair for all joints alike,
        or one for each. None for the rig's own gears.
    damping_ratio : float or (2,) array_like, optional
        Of that resonance, one value or a range; 0.01 to 0.03 by default.
    backlash : float or (2,) array_like
        Of each gear [rad], joint side; one value or uniform between two, each joint on its own.
    lag : float or (2,) array_like
        Time constant of the motor currents [s]; one value or uniform between two.

    Raises
    ------
    ValueError
    """

    resonance: Any = None
    damping_ratio: Any = None
    backlash: Any = (0.0, 0.0)
    lag: Any = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, unit in (("backlash", "rad"), ("lag", "s")):
            object.__setattr__(self, name, between(name, getattr(self, name), unit))
        if self.resonance is None:
            if self.damping_ratio is not None:
                ratio = between("damping_ratio", self.damping_ratio, "a ratio")
                object.__setattr__(self, "damping_ratio", ratio)
            return
        usual = _USUAL if self.damping_ratio is None else self.damping_ratio
        object.__setattr__(self, "damping_ratio", between("damping_ratio", usual, "a ratio"))
        if np.ndim(self.resonance) == 0:
            raise ValueError(f"resonance must be (lowest, highest) [Hz]; got {self.resonance!r:.60}. Give a range.")
        pairs = np.atleast_2d(np.asarray(self.resonance, float))
        pairs = array("resonance", pairs, ("m", 2), advice="Give the lowest and the highest [Hz].")
        if not ((pairs[:, 0] > 0) & (pairs[:, 0] <= pairs[:, 1])).all():
            low, high = pairs[np.flatnonzero(~((pairs[:, 0] > 0) & (pairs[:, 0] <= pairs[:, 1])))[0]]
            raise ValueError(
                f"resonance must be (lowest, highest), above 0 Hz; got ({low:g}, {high:g}). Swap or correct."
            )
        object.__setattr__(self, "resonance", tuple(map(tuple, pairs.tolist())))

    @property
    def lowest_damping(self) -> float | None:
        """Lowest damping ratio that is stated."""
        return None if self.damping_ratio is None or not self.damping_ratio[0] > 0 else float(self.damping_ratio[0])

    def require_followed(self, step: float) -> None:
        """Refuse resonances that steps of this length [s] cannot follow.

        Raises
        ------
        ValueError
        """
        most = _FOLLOWED / (2 * np.pi * step)
        if self.resonance is not None and np.max(self.resonance) > most:
            raise ValueError(
                f"resonance must be below {most:.0f} Hz, which sub-steps of {1e3 * step:.3g} ms can follow; got "
                f"{np.max(self.resonance):g}. Raise steps_per_sample, or leave it out: such a gear is rigid."
            )

    def prepared(self, arm: Arm, rig: Rig, pose: ArrayLike) -> Rig:
        """The rig with a place for each number that is drawn; elastic gears in the middle of their range."""
        drive = rig.drive
        if self.resonance is not None:
            if len(self.resonance) not in (1, rig.n):
                raise ValueError(
                    f"resonance must be one pair, or {rig.n}; got {len(self.resonance)}. Give (low, high)."
                )
            middle, play = np.sqrt(np.prod(self.resonance, axis=1)), np.zeros(rig.n) if self.backlash[1] else None
            elasticity = Elasticity.from_resonance(
                arm, middle, np.mean(self.damping_ratio), drive=drive, q=pose, backlash=play
            )
            drive = dataclasses.replace(drive, elasticity=elasticity)
        elif self.backlash[1]:
            if drive.elasticity is None:
                raise ValueError(
                    "backlash needs gears that give; got a rigid rig. State their resonance= as well [Hz]."
                )
            elasticity = dataclasses.replace(drive.elasticity, backlash=np.zeros(rig.n))
            drive = dataclasses.replace(drive, elasticity=elasticity)
        if self.lag[1]:
            drive = dataclasses.replace(drive, current_lag=self.lag[1])
        return dataclasses.replace(rig, drive=drive)

    def draw(self, random: Any, arm: Arm, rig: Rig, f: NDArray[np.float64], pose: ArrayLike) -> Drawn:
        """Draw for arms with these f (P, p) on a rig that is `prepared`."""
        count, n, derived = len(f), rig.n, np.empty((len(f), 0))
        names: list[str] = []
        derived_names: list[str] = []
        values: list[Any] = []
        if self.resonance is not None:
            low, high = np.log(self.resonance).T
            hz = np.exp(random.uniform(low, high, (count, len(low))))
            ratio = random.uniform(*self.damping_ratio, count)
            names = ["resonance"] if len(low) == 1 else [f"resonance[{i}]" for i in range(n)]
            names, values = [*names, "damping_ratio"], [*hz.T, ratio]
            found = gears(np.broadcast_to(hz, (count, n)), ratio[:, None], f @ _inertias(arm, rig, pose)
                          - rig.drive.reflected_inertia())  # fmt: skip
            derived = np.hstack(found)
            derived_names = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(n)]
        if self.backlash[1]:
            names += [f"drive.elasticity.backlash[{i}]" for i in range(n)]
            values += [*random.uniform(*self.backlash, (n, count))]
        if self.lag[1]:
            names, values = [*names, "drive.current_lag.time"], [*values, random.uniform(*self.lag, count)]
        drawn = np.column_stack(values) if values else np.empty((count, 0))
        return Drawn(names=tuple(names), values=drawn, derived_names=tuple(derived_names), derived=derived)


def _inertias(arm: Arm, rig: Rig, pose: ArrayLike) -> NDArray[np.float64]:
    """Diagonal (p, n) of D on the motors' shafts at a pose, of each parameter alone: D is linear in f."""
    own = [rig.drive.coupling.shaft_inertia(arm.dynamics.D(pose, unit)) for unit in np.eye(arm.dynamics.p)]
    return np.array([np.diag(matrix.full()) for matrix in own])


def between(name: str, value: Any, unit: str) -> tuple[float, float]:
    """(low, high) of one number, or of two."""
    if np.ndim(value) == 0:
        value = (real(name, value, f"Give {unit}, or the two ends of a range."),) * 2
    low, high = array(name, value, (2,), advice=f"Give one number [{unit}], or the two ends of a range.").tolist()
    if not 0 <= low <= high:
        raise ValueError(
            f"{name} must be from 0 upwards, the lower end first; got ({low:g}, {high:g}). Swap or correct."
        )
    return low, high

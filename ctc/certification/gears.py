"""What gears and drives do that a rigid rig leaves out, drawn for each plant: resonance, damping, imperfections.

A resonance is stated as a range in which it lies, not as a distribution: somewhere in it is the one that the arm has.
The plants are spread over it, and what is said of them holds for the worst part of it (`ctc.certification.cells`).
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.certification.imperfections import IMPERFECTIONS, Drawn, between, drawn_of, placed_in
from ctc.verdict.on_gears import require_followed, require_swinging
from plant import Arm, Elasticity, Rig
from plant.machine.elasticity import DAMPING_RATIO, gears
from plant.machine.motor_inertia import shaft_inertias
from plant.parts.arguments import array
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.sums import product

_SLOWEST = 1.0
"""Resonance [Hz] below which no gear of an arm has its own."""

_USUAL = (DAMPING_RATIO, 0.03)
"""Damping ratio unless stated."""


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Gears(Frozen):
    """Distribution of what gears and drives do.

    Parameters
    ----------
    resonance : (2,) or (n, 2) array_like, optional
        Lowest and highest locked-rotor resonance at the reference's first pose [Hz]: one pair for all joints alike,
        or one for each. None for the rig's own gears.
    damping_ratio : float or (2,) array_like, optional
        Of that resonance, one value or a range; 0.01 to 0.03 by default.
    imperfections : dict of str -> float or (2,) array_like
        One value, or uniform between two, each joint on its own:

        - ``backlash``: of each gear, joint side [rad]
        - ``lag``: time constant of the motor currents [s], of all
        - ``jitter``: largest displacement of a sampling instant, as a share of the period
        - ``friction_drift``: relative change of all friction, with a time constant of 1 s; may be negative
        - ``presliding``: distance of `plant.Presliding` [rad of the motor]
        - ``load_friction``: share of the transmitted torque
        - ``ripple``: amplitude, six cycles per turn of the motor [N m], motor side
        - ``quadrature``: amplitude of the encoder's error within four counts [pulses]

    Raises
    ------
    ValueError
    """

    resonance: Any = None
    damping_ratio: Any = None
    imperfections: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        ranges = {
            name: between(name, value, IMPERFECTIONS[name].unit, IMPERFECTIONS[name].signed)
            for name, value in self.imperfections.items()
        }
        object.__setattr__(self, "imperfections", ranges)
        stated = self.damping_ratio
        if stated is None and self.resonance is not None:
            stated = _USUAL
        object.__setattr__(self, "damping_ratio", None if stated is None else _damping(stated))
        if self.resonance is None:
            return
        if np.ndim(self.resonance) == 0:
            raise ValueError(f"resonance must be (lowest, highest) [Hz]; got {self.resonance!r:.60}. Give a range.")
        pairs = np.atleast_2d(np.asarray(self.resonance, float))
        pairs = array("resonance", pairs, ("m", 2), advice="Give the lowest and the highest [Hz].")
        if not ((pairs[:, 0] > 0) & (pairs[:, 0] <= pairs[:, 1])).all():
            low, high = pairs[np.flatnonzero(~((pairs[:, 0] > 0) & (pairs[:, 0] <= pairs[:, 1])))[0]]
            raise ValueError(
                f"resonance must be (lowest, highest), above 0 Hz; got ({low:g}, {high:g}). Swap or correct."
            )
        if pairs[:, 0].min() < _SLOWEST:
            raise ValueError(
                f"resonance must be {_SLOWEST:g} Hz or more; got {pairs.min():g}. No gear is so soft: is it in kHz?"
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
        if self.resonance is not None:
            require_followed("resonance", self.resonance, step)

    def require_possible(self, rig: Rig) -> None:
        """Refuse what this rig cannot have, before anything is fitted or drawn.

        Raises
        ------
        ValueError
        """
        if self.resonance is not None:
            if len(self.resonance) not in (1, rig.n):
                raise ValueError(
                    f"resonance must be one pair, or {rig.n}; got {len(self.resonance)}. Give (low, high)."
                )
            some = Elasticity(stiffness=np.ones(rig.n), damping=np.zeros(rig.n))
            rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=some))
        for ends in zip(*self.imperfections.values(), strict=True):
            placed_in(rig, {name: (0.0, end) for name, end in zip(self.imperfections, ends, strict=True)})

    def prepared(self, arm: Arm, rig: Rig, pose: ArrayLike) -> Rig:
        """The rig with a place for each number that is drawn; elastic gears in the middle of their range."""
        drive = rig.drive
        if self.resonance is not None:
            middle = np.sqrt(np.prod(self.resonance, axis=1))
            elasticity = Elasticity.from_resonance(arm, middle, np.mean(self.damping_ratio), drive=drive, q=pose)
            rig = dataclasses.replace(rig, drive=dataclasses.replace(drive, elasticity=elasticity))
        return placed_in(rig, self.imperfections)

    def places(self, random: Any, count: int) -> NDArray[np.float64]:
        """Where in their ranges resonances and damping ratio of each plant are (P, m + 1), from 0 to 1."""
        return random.uniform(0, 1, (count, 1 + len(self.resonance or ())))

    def draw(
        self, random: Any, arm: Arm, rig: Rig, f: NDArray[np.float64], pose: ArrayLike, places: NDArray[np.float64]
    ) -> Drawn:
        """Draw for arms with these f (P, p), at these `places`, on a rig that is `prepared`."""
        count, n = len(f), rig.n
        others = drawn_of(self.imperfections, random, count, n)
        if self.resonance is None:
            return others
        low, high = np.log(self.resonance).T
        hz = np.exp(low + places[:, :-1] * (high - low))
        ratio = self.damping_ratio[0] + places[:, -1:] * np.ptp(self.damping_ratio)
        links = product(f, shaft_inertias(arm.dynamics, rig, pose)) - rig.drive.reflected_inertia()
        found = gears(np.broadcast_to(hz, (count, n)), ratio, links)
        names = ["resonance"] if len(low) == 1 else [f"resonance[{i}]" for i in range(n)]
        own = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(n)]
        return Drawn(
            names=(*names, "damping_ratio", *others.names), values=np.hstack([hz, ratio, others.values]),
            derived_names=(*own, *others.derived_names), derived=np.hstack([*found, others.derived]),
        )  # fmt: skip


def _damping(ratio: Any) -> tuple[float, float]:
    """Lowest and highest damping ratio of one or two."""
    ends = between("damping_ratio", ratio, "a ratio")
    require_swinging(ends[1])
    return ends

"""The torque equation of an arm on a tilted base.

The torque is linear in gravity: the regressors under three directions of gravity give that under
any direction.
"""

import functools
from dataclasses import dataclass, replace

import numpy as np

from identification.equation_error.regressor import regressor_along
from plant import Dynamics, Rig
from plant.motion import Motion
from plant.parts import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class LeaningBase:
    """An arm along a motion, under three oblique directions of gravity.

    `gravity` (3,): as the chain states it. `axes` (2, 3): level axes of the base, about which it is
    tilted. `arms`: the arm under each direction. `weightless` (R, n, p): regressor without gravity.
    `weights` (3, R, n, p): what each gravity adds.
    """

    gravity: Floats
    axes: Floats
    arms: tuple[Dynamics, ...]
    weightless: Floats
    weights: Floats

    @classmethod
    def along(cls, dynamics: Dynamics, rig: Rig, motion: Motion) -> "LeaningBase":
        """The regressors along a motion (R, n)."""
        arms, axes = _oblique(dynamics)
        resting = Motion(motion.q, 0 * motion.q, 0 * motion.q)
        weights = np.array([regressor_along(arm, rig, arm.names, resting)[0] for arm in arms])
        moving = regressor_along(arms[0], rig, arms[0].names, motion)[0]
        return cls(
            gravity=np.array(dynamics.chain.gravity),
            axes=axes,
            arms=arms,
            weightless=moving - weights[0],
            weights=weights,
        )

    def turned(self, tilt: Floats) -> Floats:
        """Gravity (3,) in the frame of a base tilted by (2,) [rad]."""
        angle = np.hypot(*tilt)
        turned = np.cos(angle) * self.gravity
        turned += np.sinc(angle / np.pi) * np.cross(tilt @ self.axes, self.gravity)
        return turned

    def regressor(self, tilt: Floats, factor: float = 1.0) -> Floats:
        """Regressor (R, n, p) on a base tilted by (2,) [rad], with gravity times a factor."""
        turned = self.turned(tilt)
        gravities = np.array([arm.chain.gravity for arm in self.arms])
        shares = np.linalg.solve(gravities.T, factor * turned)
        return self.weightless + np.einsum("g,grnk->rnk", shares, self.weights)


@functools.lru_cache(maxsize=4)
def _oblique(dynamics: Dynamics) -> tuple[tuple[Dynamics, ...], Floats]:
    """The arm under three oblique directions of gravity, and the level axes (2, 3) of its base.

    Which parameters act depends on the direction: those of an oblique one act in all.
    """
    chain = dynamics.chain
    gravity = np.array(chain.gravity)
    size = np.linalg.norm(gravity)
    level = np.eye(3)[np.abs(gravity).argmin()]
    level = level - (level @ gravity) / size**2 * gravity
    axes = np.array([level, np.cross(gravity / size, level)]) / np.linalg.norm(level)
    # Oblique, and no two of them alike; chosen by hand.
    chains = [
        replace(chain, gravity=tuple(gravity + size * shares @ axes))
        for shares in np.array([[0.4, 0.3], [-0.5, 0.3], [0.2, -0.6]])
    ]
    first = Dynamics.from_chain(chains[0])
    # The parameters of the first, so that all regressors have the same columns.
    return (first, *(Dynamics(chain=chain, lumping=first.lumping) for chain in chains[1:])), axes

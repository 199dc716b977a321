"""Friction of all motors in one sub-step: viscous, and the impulse of what is dry.

Joins what a drive may have: Coulomb's law or presliding, the load on the gear, the drift. All of it is on the shafts.
"""

import dataclasses
from typing import Any

import casadi as ca

from plant.machine.drive import Drive
from plant.machine.friction import friction_impulse, smooth_impulse
from plant.machine.presliding import Bristles, bristle_impulse, smooth_bristle_impulse
from plant.mechanics.symmetric_inverse import Inverse

DRY_FRICTION = "drive.coulomb", "drive.curve.breakaway", "drive.load_friction", "drive.presliding.damping"
"""What the names of a rig's numbers begin with that are zero for joints without dry friction, as in linear analysis."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FrictionStep:
    """Friction of all motors in one sub-step of length h [s].

    ``impulse`` is that of dry friction in the step before [N m s], ``bristle`` the deflection of the bristles where the
    drive has presliding, ``drifted`` how much of its way the drift of friction has done; ``smooth`` is differentiable.
    """

    drive: Drive
    h: ca.SX
    impulse: ca.SX
    bristle: ca.SX | None = None
    drifted: ca.SX | None = None
    sweeps: int
    smooth: bool

    @property
    def viscous(self) -> Any:
        """Viscous friction [N m s/rad]."""
        return self._drifted(self.drive.joint_viscous())

    def __call__(
        self, inverse: Inverse, stopping: ca.SX, speed: ca.SX, load: ca.SX | None = None
    ) -> tuple[ca.SX, dict[str, ca.SX]]:
        """Impulse of dry friction (n, 1) [N m s], and the states that follow, by name.

        ``inverse``, ``stopping`` as of `friction_impulse`; the speed at the start of the step [rad/s]; ``load``: the
        torque that the gears transmit [N m], where friction depends on it.
        """
        drive, h = self.drive, self.h
        level = drive.joint_coulomb(speed)
        if load is not None:
            level = level + drive.load_friction.level(load)
        bound = h * self._drifted(level)
        if drive.presliding is None:
            if self.smooth:
                return smooth_impulse(inverse, stopping, bound), {}
            return friction_impulse(inverse, stopping, self.impulse, bound, self.sweeps), {}
        bristles = Bristles(self.bristle, *drive.joint_presliding())
        if self.smooth:
            impulse, following = smooth_bristle_impulse(inverse, stopping, bristles, bound, h)
        else:
            half = bristles.bent(speed, h / 2)
            impulse, following = bristle_impulse(inverse, stopping, self.impulse, half, bound, h, self.sweeps)
        return impulse, {"bristle": following}

    def _drifted(self, friction: Any) -> Any:
        drift = self.drive.friction_drift
        return friction if drift is None else friction * drift.factor(self.drifted)

"""Coulomb friction as a set-valued law with true stiction, by impulses.

In a step of length h the friction of joint i can give any impulse within +-C_i h. It gives the one that stops the
joint, or, if that is too large, the largest one against the motion. There is no branch, no regularisation and no
creep: sweeps over the joints (projected Gauss-Seidel) start from the impulse of the last step, so that a held arm is
held by the friction it already had. Source: paper Fig. 4 (static friction); the law is Coulomb's, with equal static
and sliding level.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from plant.parts.part import Part, number, part

__all__ = ["REGULARISATION", "FrictionCurve", "friction_impulse", "smooth_impulse"]

REGULARISATION = 1e-3
"""Joint speed [rad/s] at which the smooth law, used for derivatives only, reaches tanh(1) of the Coulomb level."""


@part
class FrictionCurve(Part):
    """What a constant Coulomb level leaves out: an offset, and more friction at rest than in motion. Motor side.

    Parameters
    ----------
    offset : (n,) array_like
        Torque against positive motion that stays when the motion turns [N m]. Coulomb friction that is c+ forwards and
        c- backwards is ``coulomb = (c+ + c-) / 2`` with ``offset = (c+ - c-) / 2``.
    breakaway : (n,) array_like
        By how much the level at rest exceeds ``coulomb`` [N m].
    speed : (n,) array_like
        Motor speed at which that excess has fallen to 1/e [rad/s]: Stribeck's, level = coulomb + breakaway
        exp(-(speed of the motor / speed)^2).
    """

    offset: np.ndarray = number(("n",))
    breakaway: np.ndarray = number(("n",))
    speed: np.ndarray = number(("n",))

    def __post_init__(self):
        super().__post_init__()
        if (self.breakaway < 0).any() or (self.speed <= 0).any():
            raise ValueError(
                f"breakaway must not be negative and speed must be positive; got {self.breakaway} and {self.speed}. "
                "Both are magnitudes."
            )

    def level(self, qd_m):
        """What is added to the Coulomb level at these motor speeds [N m]."""
        ratio = qd_m / self.speed
        return self.breakaway * (np.exp(-(ratio**2)) if isinstance(ratio, np.ndarray) else ca.exp(-(ratio**2)))


def friction_impulse(inverse, stopping, impulse, bound, sweeps):
    """Friction impulse (n, 1) of one step [N m s].

    Parameters
    ----------
    inverse : plant.mechanics.symmetric_inverse.Inverse
        Of the inertia matrix [kg m^2], joint side.
    stopping : casadi SX (n, 1)
        Impulse that would stop joint i if friction acted on it alone, -inverse.alone qd with the velocity at the end of
        the step without Coulomb friction [N m s].
    impulse : casadi SX (n, 1)
        Impulse of the last step [N m s], where the sweeps start.
    bound : casadi SX (n, 1)
        Largest impulse, Coulomb level times step [N m s].
    sweeps : int
    """
    n, impulse, bound = stopping.shape[0], ca.vertsplit(impulse), ca.fabs(bound)
    for _ in range(sweeps):
        for i in range(n):
            wanted = sum((inverse.share[i, j] * impulse[j] for j in range(n) if j != i), stopping[i])
            impulse[i] = ca.fmin(ca.fmax(wanted, -bound[i]), bound[i])
    return ca.vertcat(*impulse)


def smooth_impulse(inverse, stopping, bound):
    """The same with a differentiable law: -bound tanh(qd / REGULARISATION)."""
    qd = -inverse.diagonal * stopping
    return -bound * ca.tanh(qd / REGULARISATION)

"""Coulomb friction as a set-valued law with true stiction, by impulses.

In a step of length h the friction impulse of joint i lies within +-C_i h: it is the one that stops the joint, or, if
that is too large, the largest one against the motion. There is no branch, no regularisation and no creep: sweeps over
the joints (projected Gauss-Seidel) start from the impulse of the last step, so that an arm at rest stays held by the
friction that held it. Source: paper Fig. 4 (static friction); the law is Coulomb's, with equal static
and sliding level.
"""

from typing import Any

import casadi as ca
import numpy as np

from plant.mechanics.symmetric_inverse import Inverse
from plant.parts.arguments import signs
from plant.parts.fields import ArrayOrSymbols, Vector
from plant.parts.part import Part, number, part

REGULARISATION = 1e-3
"""Joint speed [rad/s] at which the smooth law, used for derivatives only, reaches tanh(1) of the Coulomb level."""


@part
class FrictionCurve(Part):
    """Friction beyond a constant Coulomb level: an offset, and the Stribeck effect. Motor side.

    Parameters
    ----------
    offset : (n,) array_like
        Friction torque that keeps its sign when the motion reverses [N m]. Coulomb friction that is c+ forwards and
        c- backwards is ``coulomb = (c+ + c-) / 2`` with ``offset = (c+ - c-) / 2``.
    breakaway : (n,) array_like, optional
        Excess of the breakaway level over ``coulomb`` [N m]; left out, with `speed`, there is none.
    speed : (n,) array_like, optional
        Stribeck speed, of the motor [rad/s]: level = coulomb + breakaway exp(-(motor speed / speed)^2).

    See Also
    --------
    plant.Drive, plant.Presliding, identification.motor_test

    Examples
    --------
    >>> from plant import FrictionCurve, puma560
    >>> curve = FrictionCurve(offset=(0, 0), breakaway=(0.02, 0.01), speed=(1.0, 1.0))
    >>> import dataclasses
    >>> drive = dataclasses.replace(puma560.rig().drive, curve=curve)
    >>> drive.curve.breakaway
    array([0.02, 0.01])
    """

    offset: Vector = number(("n",))
    breakaway: Any = number(("n",), default=None)
    speed: Any = number(("n",), default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        signs(self, positive=("speed",), not_negative=("breakaway",), advice="Both are magnitudes.")
        if (self.breakaway is None) != (self.speed is None):
            raise ValueError("breakaway and speed must be given together; one is missing. Give both, or neither.")

    def level(self, qd_m: ArrayOrSymbols) -> ArrayOrSymbols:
        """Excess over the Coulomb level [N m] at motor speeds [rad/s]."""
        if self.breakaway is None:
            return 0.0
        ratio = qd_m / self.speed
        return self.breakaway * (np.exp(-(ratio**2)) if isinstance(ratio, np.ndarray) else ca.exp(-(ratio**2)))


def friction_impulse(inverse: Inverse, stopping: ca.SX, impulse: ca.SX, bound: ca.SX, sweeps: int) -> ca.SX:
    """Friction impulse (n, 1) of one step [N m s]; the sweeps over the joints start from that of the last step.

    `inverse` is of the inertia matrix [kg m^2], joint side; `stopping` would stop joint i if friction acted on it
    alone: -inverse.alone qd, the velocity that of the end without Coulomb friction; `bound` is the Coulomb level times
    step.
    """
    n, impulses, bound = stopping.shape[0], ca.vertsplit(impulse), ca.fabs(bound)
    for _ in range(sweeps):
        for i in range(n):
            wanted = sum((inverse.share[i, j] * impulses[j] for j in range(n) if j != i), stopping[i])
            impulses[i] = ca.fmin(ca.fmax(wanted, -bound[i]), bound[i])
    return ca.vertcat(*impulses)


def smooth_impulse(inverse: Inverse, stopping: ca.SX, bound: ca.SX) -> ca.SX:
    """Friction impulse of a differentiable law: -bound tanh(qd / REGULARISATION)."""
    qd = -inverse.diagonal * stopping
    return -bound * ca.tanh(qd / REGULARISATION)

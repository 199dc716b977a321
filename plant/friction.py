"""Coulomb friction as a set-valued law with true stiction, by impulses.

In a step of length h the friction of joint i can give any impulse within +-C_i h. It gives the one that stops the
joint, or, if that is too large, the largest one against the motion. There is no branch, no regularisation and no
creep: sweeps over the joints (projected Gauss-Seidel) start from the impulse of the last step, so that a held arm is
held by the friction it already had. Source: paper Fig. 4 (static friction); the law is Coulomb's, with equal static
and sliding level.
"""

from __future__ import annotations

import casadi as ca

__all__ = ["REGULARISATION", "friction_impulse", "smooth_impulse"]

REGULARISATION = 1e-3
"""Joint speed [rad/s] at which the smooth law, used for derivatives only, reaches tanh(1) of the Coulomb level."""


def friction_impulse(inverse, stopping, impulse, bound, sweeps):
    """Friction impulse (n, 1) of one step [N m s].

    Parameters
    ----------
    inverse : plant.factor.Inverse
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

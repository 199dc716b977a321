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


def friction_impulse(inverse_inertia, qd, impulse, bound, sweeps):
    """Friction impulse of one step.

    Parameters
    ----------
    inverse_inertia : casadi SX (n, n)
        [1/(kg m^2)], joint side.
    qd : casadi SX (n, 1)
        Velocity at the end of the step without Coulomb friction [rad/s].
    impulse : casadi SX (n, 1)
        Impulse of the last step [N m s], where the sweeps start.
    bound : casadi SX (n, 1)
        Largest impulse, Coulomb level times step [N m s].
    sweeps : int

    Returns
    -------
    impulse, qd : casadi SX (n, 1)
        The impulse and the velocity at the end of the step with it.
    """
    n = qd.shape[0]
    felt = [1 / inverse_inertia[i, i] for i in range(n)]  # inertia that an impulse on joint i alone has to move
    alone = [-qd[i] * felt[i] for i in range(n)]  # impulse that would stop joint i if it were the only one
    share = [[-inverse_inertia[i, j] * felt[i] for j in range(n)] for i in range(n)]
    impulse = ca.vertsplit(impulse)
    for _ in range(sweeps):
        for i in range(n):
            stopping = sum((share[i][j] * impulse[j] for j in range(n) if j != i), alone[i])
            impulse[i] = ca.fmin(ca.fmax(stopping, -bound[i]), bound[i])
    impulse = ca.vertcat(*impulse)
    return impulse, qd + inverse_inertia @ impulse


def smooth_impulse(inverse_inertia, qd, bound):
    """The same with a differentiable law: -bound tanh(qd / REGULARISATION)."""
    impulse = -bound * ca.tanh(qd / REGULARISATION)
    return impulse, qd + inverse_inertia @ impulse

"""Spring, damper and backlash between a motor and its link in one sub-step.

A drift-kick-drift step whose kick is taken at the middle position plus kappa h times the change of speed. kappa = 0
is the explicit leapfrog step, 1/4 the implicit midpoint rule. With 1/12 the frequency of a spring is right to fourth
order in omega h; where (omega h)^2 exceeds 2, kappa grows to 1/3, and the step is stable for any stiffness. All that
changes the inertia, not the energy: none is added or lost. The damper is raised by (omega h)^2 / 12, which makes its
damping ratio right to fourth order too.
"""

from typing import Any, NamedTuple

import casadi as ca

FOLLOWED = 2
"""(omega h)^2 of the free vibration up to which its frequency is right to 1 %; beyond, a step has it too slow."""


class Spring(NamedTuple):
    """Torque on the link, and what the spring adds to the inertia in a step.

    Attributes
    ----------
    torque : casadi SX (n, 1)
        At the middle of the step, with the speeds at its start [N m].
    added : casadi SX (n, 1)
        Inertia by which it resists a change of the deflection's speed [kg m^2].
    """

    torque: ca.SX
    added: ca.SX


def reduced(motor: Any, link: Any) -> Any:
    """Inertia with which two, on either side of a spring, vibrate against each other [kg m^2]."""
    return motor * link / (motor + link)


def spring(elasticity: Any, deflection: ca.SX, rate: ca.SX, h: ca.SX, motor: ca.SX, link: ca.SX) -> Spring:
    """The spring of each gear in a step of length h.

    Parameters
    ----------
    elasticity : Elasticity
    deflection, rate : casadi SX (n, 1)
        Shaft minus link at the middle of the step [rad], and its rate at the start [rad/s].
    h : casadi SX
        [s]
    motor, link : casadi SX (n, 1)
        Inertias on both sides [kg m^2].
    """
    stiffness, swinging = elasticity.stiffness, reduced(motor, link)
    kick = h * h * stiffness
    added = ca.fmax(kick / 12, kick / 3 - swinging / 2)
    damping = elasticity.damping * (1 + ca.fmin(kick / swinging, FOLLOWED) / 12)
    if elasticity.backlash is not None:
        half = elasticity.backlash / 2
        wound = deflection - ca.fmin(ca.fmax(deflection, -half), half)
        touching = ca.if_else(ca.fabs(wound) > 0, 1, 0)
        stiffness, damping, deflection, added = touching * stiffness, touching * damping, wound, touching * added
    return Spring(stiffness * deflection + damping * rate, added + h / 2 * damping)

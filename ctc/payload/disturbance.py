"""Disturbance torque of an arm under any law: what acts beside the model, from counts and applied torque.

The extended-state observer of `ctc.laws.observer`, driven by the torque that really acted, runs beside the law and
feeds nothing back. D-hat times its disturbance acceleration is the torque that the model lacks: a load that is not in
it, friction that differs.
"""

import casadi as ca

from ctc.laws.observer import correct, predict
from plant import Rig, Setpoint
from plant.mechanics.symmetric_inverse import inverse


def observed(
    D: ca.SX, needed: ca.SX, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, omega: ca.SX,
    dt: ca.SX,
) -> ca.SX:  # fmt: skip
    """The observer's state, one sample later.

    Parameters
    ----------
    D : casadi SX (n, n)
        Inertia of the model at the reference [kg m^2].
    needed : casadi SX (n, 1)
        Torque that the model needs for the reference, friction included [N m].
    rig : Rig
    state : casadi SX (3 n, 1)
        Tracking error, its rate, disturbance acceleration [rad, rad/s, rad/s^2].
    setpoint : Setpoint
    pulses, torque : casadi SX (n, 1)
        Encoder counts now; joint torque applied since the last sample [N m].
    omega : casadi SX
        Triple pole [rad/s].
    dt : casadi SX

    Returns
    -------
    casadi SX (3 n, 1)
    """
    e, rate, disturbance = ca.vertsplit(state, rig.n)
    v = inverse(D).solve(torque - needed)
    measured = setpoint.q - rig.cell_centre(pulses)
    return ca.vertcat(*correct(*predict(e, rate, disturbance, v, dt), measured, omega, dt))

"""The closed loop linearised about a pose, for linear analysis with python-control."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from plant.laws import Law
from plant.machine import Rig
from plant.mechanics import Arm
from plant.parts import Floats
from plant.simulation import jacobians

if TYPE_CHECKING:
    import control


def linearise(arm: Arm, rig: Rig, law: Law, pose: ArrayLike) -> "control.StateSpace":
    """Linear model of the closed loop about a pose, under a law of fast hardware.

    The model is the derivative of the step that the simulator takes, in the limit of a short step.
    Two things that have no derivative are left out: the encoder does not round, and there is no
    Coulomb friction, as on a joint that moves without turning back.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    law : Law
        Without a period and without state, such as `P`.
    pose : (n,) array_like
        q [rad], at rest.

    Returns
    -------
    control.StateSpace
        States q, qd; inputs: reference [pulses]; outputs: tracking error [pulses]. Deviations from
        the pose.

    Raises
    ------
    ValueError
        A law with a period or with state.

    See Also
    --------
    plant.modes, ctc.margins, plant.to_control

    Examples
    --------
    >>> from plant import linearise, modes, puma560
    >>> system = linearise(puma560.arm(), puma560.rig(), puma560.p_law(), (0.0, 0.0))
    >>> modes(system).shape
    (2, 2)
    """
    import control

    n = arm.n
    A, B, C, states = jacobians(arm, rig, law, pose)
    # An error is the reference less the counted position: the reference acts on it directly.
    direct = np.eye(n)
    return control.StateSpace(
        A,
        B,
        C,
        direct,
        states=states,
        inputs=[f"reference_pulses[{i}]" for i in range(n)],
        outputs=[f"error_pulses[{i}]" for i in range(n)],
    )


def modes(system: Any) -> Floats:
    """Undamped frequencies [Hz] and damping ratios (k, 2) of the oscillating modes of a model.

    The slowest mode comes first. The matrix A may be given in place of the model.

    See Also
    --------
    plant.linearise

    Examples
    --------
    >>> from plant import linearise, modes, puma560
    >>> system = linearise(puma560.arm(), puma560.rig(), puma560.p_law(), (0.0, 0.0))
    >>> print(modes(system)[:, 0].round(1))  # [Hz]
    [28.8 41.7]
    """
    poles = np.linalg.eigvals(getattr(system, "A", system))
    # One pole of each conjugate pair; rounding gives real poles a tiny imaginary part.
    poles = poles[poles.imag > 1e-9 * np.abs(poles).max()]
    values = np.column_stack([np.abs(poles) / (2 * np.pi), -poles.real / np.abs(poles)])
    return values[np.argsort(values[:, 0])]

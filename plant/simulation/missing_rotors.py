"""A warning where an arm lacks the rotors of the drive that moves it."""

import numpy as np
from numpy.typing import NDArray

from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.parts.labels import joint_label
from plant.parts.user_warning import warn

_COUNTS = 0.1
"""Share of a joint's inertia above which its rotor matters."""


def warn_of_missing_rotors(arm: Arm, rig: Rig, q: NDArray[np.float64]) -> None:
    """Warn of an arm whose bodies say that there are no rotors, under a drive that has them.

    The inertia matrix holds the rotors (f1 and f7 of the paper hold Jm k^2); a drive does not add them. Without them an
    arm is lighter than its motors, and its loop faster than any real one.

    Parameters
    ----------
    arm : Arm
    rig : Rig
    q : (n,) numpy.ndarray
        Pose at which the rotors are compared with the joints' inertia [rad].
    """
    chain, rotors = arm.dynamics.chain, rig.drive.reflected_inertia()
    if not chain.bodies or chain.n != rig.n or any(body.rotor for body in chain.bodies):
        return
    stated = arm.dynamics.f(chain.bodies)
    if not np.allclose(arm.f, stated, rtol=1e-9, atol=1e-12 * np.abs(stated).max(initial=0.0)):
        return  # identified, or with rotors that the bodies do not show
    share = rotors / np.maximum(np.diag(arm.D(q)), 1e-300)
    if share.max() > _COUNTS:
        joint = int(share.argmax())
        label = joint_label([link.name for link in chain.links], joint)
        warn(
            f"the bodies of the arm have no rotors, and the drive has {rotors[joint]:.3g} kg m^2 at {label}, "
            f"{share[joint]:.2g} of the inertia there. Make the dynamics of chain.with_rotors(drive)."
        )

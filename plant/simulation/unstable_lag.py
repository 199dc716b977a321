"""Loops that the lag of their currents makes unstable."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from plant.laws.law import Law
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.parts.user_warning import warn
from plant.simulation.jacobians import jacobians

_ZERO = 1e-6
"""Growth of a pole, relative to its size, that may be rounding."""


def warn_of_unstable_lag(arm: Arm, rig: Rig, law: Law, pose: NDArray[np.float64]) -> None:
    """Warn of a fast law whose loop, linearised at a pose, is unstable with the currents' lag and stable without it."""
    if rig.drive.current_lag is None or law.has_memory(rig.n):
        return
    growing = _growing(arm, rig, law, pose)
    prompt = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_lag=None))
    if growing is None or _growing(arm, prompt, law, pose) is not None:
        return
    lag, name = rig.drive.current_lag.time, type(law).__name__
    warn(
        f"with a current_lag of {lag:g} s the loop of {name} is unstable: linearised "
        f"at the start it swings up at {abs(growing.imag) / (2 * math.pi):.3g} Hz with the time constant "
        f"{1 / growing.real:.2g} s; without lag it is stable. Lower the gains, or take a law with damping."
    )


def _growing(arm: Arm, rig: Rig, law: Law, pose: NDArray[np.float64]) -> complex | None:
    """The pole [1/s] that grows fastest; None where none does, or where the law holds no pose."""
    try:
        poles = np.linalg.eigvals(jacobians(arm, rig, law, pose)[0])
    except np.linalg.LinAlgError:  # a torque that does not depend on the counts
        return None
    fastest = complex(poles[np.argmax(poles.real)])
    return fastest if fastest.real > _ZERO * abs(poles).max() else None

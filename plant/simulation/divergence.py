"""Simulations that do not stay bounded, and what is said of them."""

from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from plant.mechanics.arm import Arm
from plant.simulation.closed_loop import ClosedLoop


class DivergenceError(ValueError):
    """A closed loop that did not stay bounded; the message says when, and which joint first.

    See Also
    --------
    plant.simulate, plant.LoadError

    Examples
    --------
    >>> import dataclasses
    >>> from plant import DivergenceError, PD, puma560, simulate
    >>> rig, law = puma560.rig(), PD(gain=(2000, 2000), derivative=(0, 0), filter=600.0)
    >>> unlimited = dataclasses.replace(rig.drive, current_limit=(float("inf"), float("inf")))
    >>> try:
    ...     record = simulate(puma560.arm(), dataclasses.replace(rig, drive=unlimited), law, puma560.reference())
    ... except DivergenceError:
    ...     print("the loop is unstable")
    the loop is unstable
    """


def refuse_divergence(loop: ClosedLoop, arm: Arm, log: NDArray[np.float64], final: NDArray[np.float64]) -> NoReturn:
    """Say when and where a simulation diverged.

    Raises
    ------
    DivergenceError
    """
    n = loop.n
    q = log[:, 2 * n : 3 * n]
    values = np.abs(np.where(np.isfinite(final[: 2 * n]), final[: 2 * n], np.inf)).reshape(2, n)
    label = arm.dynamics.chain.joint_labels[int(np.argmax(values.max(axis=0)))]
    finite = np.flatnonzero(np.isfinite(q).all(axis=1) & (np.abs(q).max(axis=1) < 1e3))
    time = (finite[-1] if len(finite) else 0) * loop.rig.period
    start = q[0] if len(finite) else final[:n]
    arm.require_positive(start)
    raise DivergenceError(
        f"the closed loop must stay bounded; it diverges after t = {time:.4f} s, {label} first. "
        "Lower the gains, shorten the law's period, or check that f belongs to this arm."
    )

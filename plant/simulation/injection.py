"""Torque that was injected beside the law's: what a simulation is given, and what of a record a loop has to add."""

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.parts.arguments import array

Injected: TypeAlias = Callable[[NDArray[Any]], ArrayLike] | ArrayLike
"""(N, n) [N m], joint side, one row per sample; or a function that gives them at the times (N,) of the samples."""

_OF_MOTORS = "torque", "current"
"""Columns that hold the whole torque of the motors: of a law that repeats one, nothing is added."""


def injected_at(given: Injected | None, t: NDArray[Any], n: int) -> NDArray[np.float64] | None:
    """Injected torque (N, n) [N m] at the samples t (N,), or None.

    Raises
    ------
    ValueError
        Another shape, not finite.
    """
    if given is None:
        return None
    values = given(t) if callable(given) else given
    what = "injected(t)" if callable(given) else "injected"
    return array(what, values, (len(t), n), advice="Give one row per sample, one joint torque per column [N m].")


def injected_beside(record: Any) -> NDArray[np.float64] | None:
    """Torque (N, n) [N m] that acts beside what a record's law commands; None where it repeats the motors' own."""
    return None if record.law is not None and record.law.replays in _OF_MOTORS else record.injected

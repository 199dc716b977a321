"""Arguments of a running controller's step: plain numbers, finite or not, and the time of a clock."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.parts.arguments import array


def numbers(name: str, value: ArrayLike, n: int, advice: str) -> NDArray[np.float64]:
    """Numbers of one argument, finite or not; whatever is no plain array of numbers is refused."""
    try:
        plain = np.asarray(value)
    except ValueError:
        return array(name, value, (n,), advice=advice, finite=False)
    if isinstance(value, np.ma.MaskedArray) or plain.dtype.kind not in "iuf":
        kind = "a masked array" if isinstance(value, np.ma.MaskedArray) else f"{plain.dtype} {value!r:.60}"
        raise ValueError(f"{name} must be plain numbers of shape ({n},); got {kind}. {advice}")
    return plain if plain.shape == (n,) else array(name, value, (n,), advice=advice, finite=False)


def clock(now: Any) -> float:
    """Time of a call [s]; one that is no number is infinite, since NaN stands for none."""
    if type(now) is not float and (isinstance(now, (bool, np.bool_)) or not isinstance(now, (int, float, np.number))):
        raise ValueError(f"now must be a number; got {now!r:.60}. Give seconds of a steady clock.")
    time = float(now)
    return time if time == time else np.inf

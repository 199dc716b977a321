"""casadi Functions called: with shapes checked that casadi broadcasts and transposes silently,
or without copies.
"""

from typing import Any

import casadi as ca
import numpy as np

from plant.parts.arguments import array
from plant.parts.fields import Floats


class CheckedFunction:
    """A casadi Function that refuses arguments of the wrong shape."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        names = self.function.name_in()
        if len(arguments) != len(names):
            given = (
                f"{self.function.name()} takes ({', '.join(names)}); got {len(arguments)} arguments"
            )
            raise ValueError(f"{given}. Give all of them, in this order.")
        checked: list[Any] = []
        for i, (name, value) in enumerate(zip(names, arguments, strict=True)):
            shape = self.function.size_in(i)
            if isinstance(value, (ca.SX, ca.MX, ca.DM)):
                if value.shape != shape:
                    raise ValueError(
                        f"{name} must have shape {shape}; got {value.shape}. Give a column."
                    )
                checked.append(value)
            else:
                advice = (
                    "Pass found.arm.f, or Dynamics.f(bodies)."
                    if name == "f"
                    else "One value per joint [SI]."
                )
                checked.append(array(name, value, (shape[0],), advice=advice))
        return self.function(*checked)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)

    def __repr__(self) -> str:
        return repr(self.function)


def evaluated(function: ca.Function, *inputs: Any) -> list[Floats]:
    """Dense outputs of a Function, each (columns, rows), at dense inputs that are given likewise.

    Nothing is converted: of long arrays some ten times as fast as a call.
    """
    buffer, evaluate = function.buffer()
    held = [np.ascontiguousarray(each, dtype=np.float64).reshape(-1) for each in inputs]
    found = [
        np.empty((function.size2_out(i), function.size1_out(i))) for i in range(function.n_out())
    ]
    for i, each in enumerate(held):
        buffer.set_arg(i, each.data)
    for i, each in enumerate(found):
        buffer.set_res(i, each.reshape(-1).data)
    evaluate()
    return found

"""Calls of casadi Functions: with checks of shapes, or without copies.

casadi itself broadcasts and transposes arguments silently.
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
            mismatch = (
                f"{self.function.name()} takes ({', '.join(names)}); got {len(arguments)} arguments"
            )
            raise ValueError(f"{mismatch}. Give all of them, in this order.")
        checked: list[Any] = []
        for i, (name, value) in enumerate(zip(names, arguments, strict=True)):
            shape = self.function.size_in(i)
            # Symbols must match exactly: casadi would repeat a scalar and transpose a row without a
            # word.
            if isinstance(value, (ca.SX, ca.MX, ca.DM)):
                if value.shape != shape:
                    raise ValueError(
                        f"{name} must have shape {shape}; got {value.shape}. Give a column."
                    )
                checked.append(value)
            else:
                # An inertial vector is a result or is computed; nobody types it in.
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
    """Dense outputs of a Function, each (columns, rows), at dense inputs of the same layout.

    The buffers are shared, not converted: for long arrays some ten times as fast as a call.
    """
    # casadi stores matrices by columns, hence (columns, rows) in numpy's order by rows.
    buffer, evaluate = function.buffer()
    arguments = [np.ascontiguousarray(values, dtype=np.float64).reshape(-1) for values in inputs]
    outputs = [
        np.empty((function.size2_out(i), function.size1_out(i))) for i in range(function.n_out())
    ]
    # The buffer keeps addresses only; the two lists keep the arrays alive until `evaluate`.
    for i, values in enumerate(arguments):
        buffer.set_arg(i, values.data)
    for i, values in enumerate(outputs):
        buffer.set_res(i, values.reshape(-1).data)
    evaluate()
    return outputs

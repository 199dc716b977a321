"""A casadi Function with a guard: casadi broadcasts a scalar and turns a row into a column without a word."""

from __future__ import annotations

import casadi as ca

from plant.parts.arguments import array

__all__ = ["CheckedFunction"]


class CheckedFunction:
    """A casadi Function that refuses wrong shapes, where casadi would broadcast or transpose without a word."""

    def __init__(self, function):
        self.function = function

    def __call__(self, *arguments):
        names = self.function.name_in()
        if len(arguments) != len(names):
            given = f"{self.function.name()} takes ({', '.join(names)}); got {len(arguments)} arguments"
            raise ValueError(f"{given}. Give all of them, in this order.")
        checked = []
        for i, (name, value) in enumerate(zip(names, arguments, strict=True)):
            shape = self.function.size_in(i)
            if isinstance(value, (ca.SX, ca.MX, ca.DM)):
                if value.shape != shape:
                    raise ValueError(f"{name} must have shape {shape}; got {value.shape}. Give a column.")
                checked.append(value)
            else:
                advice = "Pass found.arm.f, or Dynamics.f(bodies)." if name == "f" else "One value per joint [SI]."
                checked.append(array(name, value, (shape[0],), advice=advice))
        return self.function(*checked)

    def __getattr__(self, name):
        return getattr(self.function, name)

    def __repr__(self):
        return repr(self.function)

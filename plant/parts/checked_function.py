"""A casadi Function that checks the shapes of its arguments, where casadi broadcasts and transposes silently."""

from typing import Any

import casadi as ca

from plant.parts.arguments import array


class CheckedFunction:
    """A casadi Function that refuses arguments of the wrong shape."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function

    def __call__(self, *arguments: Any) -> Any:
        names = self.function.name_in()
        if len(arguments) != len(names):
            given = f"{self.function.name()} takes ({', '.join(names)}); got {len(arguments)} arguments"
            raise ValueError(f"{given}. Give all of them, in this order.")
        checked: list[Any] = []
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

    def __getattr__(self, name: str) -> Any:
        return getattr(self.function, name)

    def __repr__(self) -> str:
        return repr(self.function)

"""Torque of springs and counterbalances on the joints: a known function of where the arm is."""

import abc
import dataclasses
import functools
import operator
from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from plant.parts.fields import ArrayOrSymbols
from plant.parts.part import Part

_REFUSED = (TypeError, ValueError, RuntimeError, IndexError, AttributeError, NotImplementedError)
"""What casadi and numpy raise where a torque cannot be worked out."""


class KnownTorque(Part, abc.ABC):
    """Base of all that drives the joints beside the motors, by where they are: a `@part` class that gives ``torque``.

    It acts on the links, also behind elastic gears; no motor, no gear and no amplifier feels it but through the arm.
    Its fields declared with `plant.number` are numbers of the rig, ``springs.stiffness[0]``.

    See Also
    --------
    plant.JointSpring, plant.Counterbalance, plant.CosineTorque

    Examples
    --------
    >>> import casadi as ca
    >>> from plant import KnownTorque, number, part
    >>> @part
    ... class Cable(KnownTorque):
    ...     stiffness: object = number(("n",))
    ...     def torque(self, q):
    ...         return -self.stiffness * ca.sin(q)
    ...
    >>> print(Cable(stiffness=(3.0, 1.0)).torque((0.1, 0.0)))
    [-0.2995, -0]
    """

    @abc.abstractmethod
    def torque(self, q: ca.SX) -> ca.SX:
        """Torque (n, 1) [N m] on the joints at q (n, 1) [rad], in casadi; positive in the direction of q."""


def total_torque(parts: Iterable[KnownTorque], q: ArrayOrSymbols) -> ArrayOrSymbols:
    """Sum of their torques [N m] at q: (n, 1) of casadi symbols, (..., n) of an array (..., n) [rad]."""
    if isinstance(q, (ca.SX, ca.MX, ca.DM)):
        return functools.reduce(operator.add, (part.torque(q) for part in parts))
    angles = np.asarray(q, dtype=float)
    symbols = ca.SX.sym("q", angles.shape[-1])
    function = ca.Function("torque", [symbols], [ca.densify(total_torque(parts, symbols))])
    rows = angles.reshape(-1, angles.shape[-1])
    return function.map(len(rows))(rows.T).full().T.reshape(angles.shape) if len(rows) else angles.copy()


def require_torques(parts: Iterable[Any], n: int) -> None:
    """Refuse what is no torque of n joints.

    Raises
    ------
    ValueError
    """
    for part in parts:
        if not isinstance(part, KnownTorque):
            given = type(part).__name__
            raise ValueError(f"springs must be KnownTorque, or several; got {given}. Give JointSpring(stiffness=...).")
        kind = type(part).__name__
        for field in dataclasses.fields(part):
            value = getattr(part, field.name)
            if field.metadata.get("number") == ("n",) and value is not None and len(value) != n:
                raise ValueError(
                    f"{field.name} of {kind} must have {n} joints like the drive; got {len(value)}. Give one number "
                    "per joint, 0 where there is no spring."
                )
        q, numbers = ca.SX.sym("q", n), ca.SX.sym("numbers", len(part.number_names()))
        try:
            torque = part.with_numbers(numbers).torque(q)
        except _REFUSED as error:
            reason = (str(error).strip() or "it fails").splitlines()[-1][:80].rstrip(".")
            raise ValueError(f"torque of {kind} must be a casadi expression of q ({n}, 1); {reason}.") from error
        if not isinstance(torque, ca.SX) or torque.shape != (n, 1):
            given = torque.shape if isinstance(torque, (ca.SX, np.ndarray)) else type(torque).__name__
            raise ValueError(
                f"torque of {kind} must return casadi SX of shape ({n}, 1), one torque per joint; got {given}. Write "
                "ca.vertcat(...), 0 for joints that it does not drive."
            )
        known = {each.name() for each in (*ca.vertsplit(q), *ca.vertsplit(numbers))}
        free = [each.name() for each in ca.symvar(torque) if each.name() not in known]
        if free:
            raise ValueError(f"torque of {kind} must depend on q and the part's numbers alone; got {free[0]!r}.")

"""f as sums of standard parameters, by their names, in a robot file."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from plant.mechanics.chain import Chain
from plant.mechanics.lumping import STANDARD, Lumping, parameter_name
from plant.parts.arguments import choice, instance, real

_TORQUES = {"both": (True, True), "inertial": (True, False), "gravity": (False, True), "none": (False, False)}


def _names(chain: Chain) -> list[str]:
    return [parameter_name(name, link) for link in chain.links for name in STANDARD]


def lumping_table(lumping: Lumping, chain: Chain) -> dict[str, dict[str, Any]]:
    """Name of f -> its sum, ``{Izz3 = 1.0, J3 = 1.0, torque = "inertial"}``."""
    names, words = _names(chain), {flags: word for word, flags in _TORQUES.items()}
    table: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(lumping.names):
        row = np.array(lumping.matrix[i])
        table[name] = {names[k]: float(row[k]) for k in np.flatnonzero(row)}
        table[name]["torque"] = words[lumping.inertial[i], lumping.gravitational[i]]
    return table


def lumping_of(table: Mapping[str, Any], chain: Chain) -> Lumping:
    """The lumping of such a table.

    Raises
    ------
    ValueError
        A name that is no standard parameter of the chain, a torque that f cannot enter.
    """
    names, matrix, flags = _names(chain), [], []
    for name, given in table.items():
        where = f"{name} of [arm.parameters]"
        terms, row = dict(instance(where, given, dict, "Write {Izz2 = 1.0, torque = 'both'}.")), np.zeros(len(names))
        flags.append(_TORQUES[choice(f"torque of {where}", terms.pop("torque", "both"), tuple(_TORQUES))])
        for parameter, coefficient in terms.items():
            choice(f"a term of {where}", parameter, names)
            row[names.index(parameter)] = real(f"{parameter} in {where}", coefficient, "Give a number.")
        matrix.append(row)
    inertial, gravitational = zip(*flags, strict=True) if flags else ((), ())
    return Lumping(names=tuple(table), matrix=np.array(matrix), inertial=inertial, gravitational=gravitational)

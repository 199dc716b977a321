"""The table [arm] of a robot file: a chain from rows or from a model file beside it, what f is,
and f.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.mechanics.chain import Chain
from plant.mechanics.dynamics import Dynamics
from plant.mechanics.lumping import STANDARD, Lumping, parameter_name
from plant.models.tables import part_of, table_of
from plant.parts.arguments import choice, instance, real

_TORQUES = {
    "both": (True, True),
    "inertial": (True, False),
    "gravity": (False, True),
    "none": (False, False),
}


def _names(chain: Chain) -> list[str]:
    return [parameter_name(name, link) for link in chain.links for name in STANDARD]


def lumping_table(lumping: Lumping, chain: Chain) -> dict[str, dict[str, Any]]:
    """Name of f -> its sum, ``{Izz3 = 1.0, J3 = 1.0, torque = "inertial"}``."""
    names = _names(chain)
    words = {flags: word for word, flags in _TORQUES.items()}
    table: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(lumping.names):
        row = np.array(lumping.matrix[i])
        table[name] = {names[k]: float(row[k]) for k in np.flatnonzero(row)}
        table[name]["torque"] = words[lumping.inertial[i], lumping.gravitational[i]]
    return table


def lumping_of(table: Mapping[str, Any], chain: Chain) -> Lumping:
    """The lumping of such a table; a name that is no standard parameter of the chain is refused."""
    names = _names(chain)
    matrix = []
    flags = []
    for name, given in table.items():
        where = f"{name} of [arm.parameters]"
        terms = dict(instance(where, given, dict, "Write {Izz2 = 1.0, torque = 'both'}."))
        row = np.zeros(len(names))
        flags.append(
            _TORQUES[choice(f"torque of {where}", terms.pop("torque", "both"), tuple(_TORQUES))]
        )
        for parameter, coefficient in terms.items():
            choice(f"a term of {where}", parameter, names)
            row[names.index(parameter)] = real(
                f"{parameter} in {where}", coefficient, "Give a number."
            )
        matrix.append(row)
    inertial, gravitational = zip(*flags, strict=True) if flags else ((), ())
    return Lumping(
        names=tuple(table), matrix=np.array(matrix), inertial=inertial, gravitational=gravitational
    )


_ARM = (
    "table",
    "links",
    "urdf",
    "mjcf",
    "joints",
    "gravity",
    "bodies",
    "coupling",
    "limits",
    "rotors",
    "parameters",
    "ranges",
    "f",
)
_BASE = "base"
_ROTORLESS = "base without rotors"


def dynamics_of(table: dict[str, Any], chain: Chain, rig: Rig) -> tuple[Dynamics, Any]:
    """Dynamics of [arm], which has this chain, and its f."""
    rotors = table.get("rotors")
    if rotors is not None:
        choice("rotors of [arm]", rotors, ("drive",))
        chain = chain.with_rotors(rig.drive)
    parameters = table.get("parameters", _BASE)
    ranges: Any = table.get("ranges")
    if isinstance(parameters, Mapping):
        dynamics = Dynamics(chain=chain, lumping=lumping_of(parameters, chain), ranges=ranges)
    else:
        choice("parameters of [arm]", parameters, (_BASE, _ROTORLESS))
        dynamics = Dynamics.from_chain(chain, rotors=parameters == _BASE)
        dynamics = dataclasses.replace(dynamics, ranges=ranges)
    return dynamics, table.get("f", dynamics.f() if chain.bodies else None)


def model_beside(table: dict[str, Any], folder: Path) -> Path | None:
    """The model file that [arm] names."""
    named = table.get("urdf", table.get("mjcf"))
    return None if named is None else folder / str(named)


def chain_of(table: dict[str, Any], folder: Path) -> Chain:
    """The chain of [arm], without the rotors of a drive."""
    for key in table:
        choice("a key of [arm]", key, _ARM)
    sources = [key for key in ("links", "urdf", "mjcf") if key in table]
    if len(sources) != 1:
        raise ValueError(
            f"[arm] must have one of links, urdf, mjcf; got {' and '.join(sources) or 'none'}. Give"
            " one."
        )
    changes: dict[str, Any] = {key: table[key] for key in ("gravity",) if key in table}
    if sources != ["links"]:
        if unused := [key for key in ("table", "bodies", "limits") if key in table]:
            raise ValueError(
                f"[arm] must not have {unused[0]!r} beside a model file, which holds it. Remove"
                " one."
            )
        path = model_beside(table, folder)
        if path is None or not path.is_file():
            raise ValueError(
                f"{sources[0]} of [arm] must name a file; {path} is not there. Put it beside this"
                " one."
            )
        read = Chain.from_urdf if sources == ["urdf"] else Chain.from_mjcf
        chain = read(path, table.get("joints"))
    else:
        kept: dict[str, Any] = {
            key: table[key]
            for key in ("links", "gravity", "bodies", "coupling", "limits")
            if key in table
        }
        if (
            choice("table of [arm]", table.get("table", "modified"), ("modified", "standard"))
            == "modified"
        ):
            made: Chain = part_of(kept, "plant.Chain", "arm")
            return made
        bodies = tuple(part_of(each, "plant.Body", "arm.bodies") for each in kept.get("bodies", ()))
        chain = Chain.standard(kept["links"], bodies=bodies)
        if "limits" in table:
            changes["limits"] = part_of(table["limits"], "plant.Limits", "arm.limits")
    if "coupling" in table:
        changes["coupling"] = part_of(table["coupling"], "plant.Coupling", "arm.coupling")
    return dataclasses.replace(chain, **changes)


def arm_table(dynamics: Dynamics, arm: Arm | None) -> dict[str, Any]:
    """The table of dynamics, and of the f of an arm where its bodies do not say it."""
    chain = dynamics.chain
    table = table_of(chain, "plant.Chain")
    if dynamics.ranges is not None:
        table["ranges"] = [list(row) for row in dynamics.ranges]
    for word, rotors in ((_BASE, True), (_ROTORLESS, False)):
        if Dynamics.from_chain(chain, rotors=rotors).lumping == dynamics.lumping:
            table["parameters"] = word
            break
    else:
        table["parameters"] = lumping_table(dynamics.lumping, chain)
    if arm is not None and not (chain.bodies and np.array_equal(arm.f, dynamics.f())):
        table["f"] = arm.f.tolist()
    return table

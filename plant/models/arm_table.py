"""Convert the table [arm] of a robot file to a chain and its dynamics, and back."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plant.machine import Rig
from plant.mechanics import STANDARD, Arm, Chain, Dynamics, Lumping, parameter_name
from plant.models.tables import part_of, table_of
from plant.parts import choice, instance, real

# Word of a parameter of f -> whether it acts in the inertial torque, and in that of gravity.
_TORQUES = {
    "both": (True, True),
    "inertial": (True, False),
    "gravity": (False, True),
    "none": (False, False),
}


def _names(chain):
    return [parameter_name(name, link) for link in chain.links for name in STANDARD]


def lumping_table(lumping: Lumping, chain: Chain) -> dict[str, dict[str, Any]]:
    """Name of each parameter of f -> its sum of standard parameters, and the torque it acts in.

    An entry is ``{Izz3 = 1.0, J3 = 1.0, torque = "inertial"}``.
    """
    names = _names(chain)
    # Each pair of flags has only one word, so the pair can be looked up too.
    words = {flags: word for word, flags in _TORQUES.items()}
    table: dict[str, dict[str, Any]] = {}
    for i, name in enumerate(lumping.names):
        # A sum has few terms: only those that are not zero are written.
        row = np.array(lumping.matrix[i])
        table[name] = {names[k]: float(row[k]) for k in np.flatnonzero(row)}
        table[name]["torque"] = words[lumping.inertial[i], lumping.gravitational[i]]
    return table


def lumping_of(table: Mapping[str, Any], chain: Chain) -> Lumping:
    """Lumping of a table as `lumping_table` writes it; refuses a term unknown to the chain."""
    names = _names(chain)
    matrix = []
    flags = []
    for name, sum_table in table.items():
        label = f"{name} of [arm.parameters]"
        # A copy, from which the word of the torque is taken out.
        terms = dict(instance(label, sum_table, dict, "Write {Izz2 = 1.0, torque = 'both'}."))
        torque = choice(f"torque of {label}", terms.pop("torque", "both"), tuple(_TORQUES))
        flags.append(_TORQUES[torque])
        row = np.zeros(len(names))
        for parameter, coefficient in terms.items():
            choice(f"a term of {label}", parameter, names)
            number = real(f"{parameter} in {label}", coefficient, "Give a number.")
            row[names.index(parameter)] = number
        matrix.append(row)
    # For an empty table, zip returns nothing to unpack.
    inertial, gravitational = zip(*flags, strict=True) if flags else ((), ())
    return Lumping(
        names=tuple(table), matrix=np.array(matrix), inertial=inertial, gravitational=gravitational
    )


# Keys of [arm].
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
# Values of `parameters`: base parameters of the chain, with the rotors' inertias or without.
_BASE = "base"
_ROTORLESS = "base without rotors"


def dynamics_of(table: dict[str, Any], chain: Chain, rig: Rig) -> tuple[Dynamics, Any]:
    """Dynamics of [arm] with this chain; and f from the table, else from the bodies, else None."""
    rotors = table.get("rotors")
    # The chain stays as it is unless [arm] has the key `rotors`.
    if rotors is not None:
        choice("rotors of [arm]", rotors, ("drive",))
        # The rotors of the drive belong to the equations of motion.
        chain = chain.with_rotors(rig.drive)
    parameters = table.get("parameters", _BASE)
    ranges: Any = table.get("ranges")
    # Sums of the user, or base parameters by a word.
    if isinstance(parameters, Mapping):
        dynamics = Dynamics(chain=chain, lumping=lumping_of(parameters, chain), ranges=ranges)
    else:
        choice("parameters of [arm]", parameters, (_BASE, _ROTORLESS))
        dynamics = Dynamics.from_chain(chain, rotors=parameters == _BASE)
        dynamics = replace(dynamics, ranges=ranges)
    return dynamics, table.get("f", dynamics.f() if chain.bodies else None)


def model_beside(table: dict[str, Any], folder: Path) -> Path | None:
    """Path of the model file of [arm]; None without one."""
    name = table.get("urdf", table.get("mjcf"))
    return None if name is None else folder / str(name)


def chain_of(table: dict[str, Any], folder: Path) -> Chain:
    """The chain of [arm], without the rotors of a drive."""
    # 1. Exactly one source: rows of links, or a file.
    for key in table:
        choice("a key of [arm]", key, _ARM)
    sources = [key for key in ("links", "urdf", "mjcf") if key in table]
    if len(sources) != 1:
        raise ValueError(
            f"[arm] must have one of links, urdf, mjcf; got {' and '.join(sources) or 'none'}. Give"
            " one."
        )
    changes = {}
    if "gravity" in table:
        changes["gravity"] = table["gravity"]
    if sources != ["links"]:
        chain = _chain_of_file(table, sources[0], folder)
    else:
        if "joints" in table:
            raise ValueError(
                "[arm] must not have 'joints' beside 'links', which are all of its joints. Remove"
                " one."
            )
        convention = table.get("table", "modified")
        if choice("table of [arm]", convention, ("modified", "standard")) == "modified":
            # 2. A chain takes modified Denavit-Hartenberg rows as they are.
            keys = "links", "gravity", "bodies", "coupling", "limits"
            fields = {key: table[key] for key in keys if key in table}
            modified: Chain = part_of(fields, "plant.Chain", "arm")
            return modified

        # 3. Standard rows are converted, with the bodies in their frames.
        rows = instance("bodies of [arm]", table.get("bodies", []), list, "Write [[arm.bodies]].")
        bodies = [part_of(row, "plant.Body", f"arm.bodies[{i}]") for i, row in enumerate(rows)]
        # Fields that the conversion does not take are set afterwards.
        chain = Chain.standard(table["links"], bodies=tuple(bodies))
        if "limits" in table:
            changes["limits"] = part_of(table["limits"], "plant.Limits", "arm.limits")
    if "coupling" in table:
        changes["coupling"] = part_of(table["coupling"], "plant.Coupling", "arm.coupling")
    return replace(chain, **changes)


def _chain_of_file(table, source, folder):
    for key in ("table", "bodies", "limits"):
        if key in table:
            raise ValueError(
                f"[arm] must not have {key!r} beside a model file, which holds it. Remove one."
            )
    path = model_beside(table, folder)
    if path is None or not path.is_file():
        raise ValueError(
            f"{source} of [arm] must name a file; {path} is not there. Put it beside this one."
        )
    read = Chain.from_urdf if source == "urdf" else Chain.from_mjcf
    return read(path, table.get("joints"))


def arm_table(dynamics: Dynamics, arm: Arm | None) -> dict[str, Any]:
    """The table [arm] of the dynamics, with the arm's f unless the bodies give the same f."""
    chain = dynamics.chain
    table = table_of(chain, "plant.Chain")
    if dynamics.ranges is not None:
        table["ranges"] = [list(row) for row in dynamics.ranges]
    # A word, if the parameters are base parameters; otherwise the sums themselves.
    for word, rotors in ((_BASE, True), (_ROTORLESS, False)):
        if Dynamics.from_chain(chain, rotors=rotors).lumping == dynamics.lumping:
            table["parameters"] = word
            break
    else:
        table["parameters"] = lumping_table(dynamics.lumping, chain)
    # f is left out only if the bodies give the same f to the last bit.
    if arm is not None and not (chain.bodies and np.array_equal(arm.f, dynamics.f())):
        table["f"] = arm.f.tolist()
    return table

"""What to call parameters in tables and figures, and their units."""

from collections.abc import Iterable

import numpy as np

from plant import Dynamics
from plant.mechanics.lumping import STANDARD

_OF_RIG = {
    "drive.motor_inertia": "kg m²", "drive.viscous": "N m s/rad", "drive.coulomb": "N m", "drive.motor_gain": "N m/A",
    "drive.current_limit": "A", "drive.current_lag": "s", "drive.elasticity.stiffness": "N m/rad",
    "drive.elasticity.damping": "N m s/rad", "drive.elasticity.backlash": "rad", "drive.curve.offset": "N m",
    "drive.curve.breakaway": "N m", "drive.curve.speed": "rad/s", "law.gain": "N m per pulse",
}  # fmt: skip
"""Units of numbers of rig and law, of the side that they are stated on."""

_INERTIA = [kind.startswith(("I", "J")) for kind in STANDARD]
_FIRST = [kind in ("mx", "my", "mz") for kind in STANDARD]


def short_names(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """The same names with those of f short (`Dynamics.short_names`); `Dynamics.legend` says what they mean."""
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    return tuple(short.get(name, name) for name in names)


def units(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """Units of f and of numbers of rig and law, by name; "" of one whose unit is not known here.

    A parameter is an inertia where one is in it, else a first moment or a mass; one that enters the inertial torque
    alone is an inertia where all joints turn.
    """
    lumping, of_f = dynamics.lumping, dict[str, str]()
    turning = not any(link.prismatic for link in dynamics.chain.links)
    for i, name in enumerate(dynamics.names):
        row = np.asarray(np.any(np.reshape(lumping.matrix[i], (-1, len(STANDARD))), axis=0))
        if row[_INERTIA].any() or (turning and not lumping.gravitational[i]):
            of_f[name] = "kg m²"
        else:
            of_f[name] = "kg m" if row[_FIRST].any() else "kg"
    return tuple(of_f.get(name, _OF_RIG.get(name.partition("[")[0], "")) for name in names)

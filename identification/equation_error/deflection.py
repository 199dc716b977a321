"""Two position sensors: the stiffness of gears from their deflection, by regression on the torque that winds them up.

With the links counted too, their motion is measured, so the torque equation gives f whatever the gears are, and f the
torque on each link. The deflection is proportional to that torque, and by the damper to its rate, beside an offset:
the two sensors have zeros of their own.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.filtering import derivatives, low_pass
from identification.equation_error.least_squares import least_squares
from identification.equation_error.motor_torque import torque_of
from identification.equation_error.pulse_fit import CUTOFF, fit_systems, mode_in, speed_noise
from identification.equation_error.regressor import System, compared, linear, regressor_along
from identification.equation_error.torque_fit import TorqueFit
from plant import Dynamics, Record
from plant.parts.sums import dot, product

_BAND = 1.4
"""Pass band, in frequencies of the strongest oscillation."""

_SYSTEMATIC = 2.0
"""Errors of the torque on the links (f, filters at reversals) over the scatter of the equations."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Deflection:
    """Gears as two position sensors show them.

    Attributes
    ----------
    compliance, std : (n,) numpy.ndarray
        On the shafts [rad/(N m)].
    torque : TorqueFit
        Of f and linear numbers of the drive.
    """

    compliance: NDArray[np.float64]
    std: NDArray[np.float64]
    torque: TorqueFit


class _Seen:
    """A record with both sensors, in a pass band."""

    def __init__(self, record: Record) -> None:
        rig = self.rig = record.rig
        self.record, self.band = record, _BAND * mode_in(record)
        cutoff = CUTOFF * self.band
        self.motors = derivatives(rig.cell_centre(record.counts), rig.period, cutoff)
        self.links = derivatives(rig.cell_centre(record.link_counts), rig.period, cutoff)

    def system(self, dynamics: Dynamics, unknown: Sequence[str]) -> System:
        """The torque equation along the measured motions."""
        regressor, given = regressor_along(dynamics, self.rig, unknown, self.links, self.motors)
        return self._compared([torque_of(self.record) - given, *np.moveaxis(regressor, 2, 0)], True)

    def wound(self, dynamics: Dynamics, f: NDArray[np.float64]) -> System:
        """Deflections on the shafts, against the torque on the links, its rate and one."""
        coupling, period = self.rig.drive.coupling, self.rig.period
        Y, _ = regressor_along(dynamics, self.rig, dynamics.names, self.links, self.links)
        beside = self.rig.drive.rotor_torque(self.links.qdd) + self.rig.spring_torque(self.links.q)
        torque = (Y * f).sum(axis=2) - beside
        torque = low_pass(coupling.shaft_torque(torque), period, CUTOFF * self.band)
        deflection = coupling.shaft(self.motors.q - self.links.q)
        rate = np.gradient(torque, period, axis=0)
        return self._compared([deflection, torque, rate, np.ones_like(torque)], False)

    def _compared(self, signals: list[NDArray[np.float64]], moving: bool) -> System:
        rig, band = self.rig, self.band
        slowest = speed_noise(rig, band) if moving else np.zeros(rig.n)
        every = max(1, int(1 / (2 * band * rig.period)))
        valid = self.record.valid
        return compared(signals, self.motors.qd, rig.period, CUTOFF * band, band, every, slowest, valid)


def fit_deflection(
    dynamics: Dynamics, records: Sequence[Record], unknown: Sequence[str], known: Mapping[str, float]
) -> Deflection:
    """Compliance of gears from records with `link_counts`; arguments as for `equation_error`."""
    names, seen = linear(dynamics, records[0].rig, unknown), [_Seen(record) for record in records]
    torque = fit_systems(dynamics, names, known, [each.system(dynamics, names) for each in seen])
    values = dict(known) | dict(zip(torque.names, torque.values, strict=True))
    f = np.array([values[name] for name in dynamics.names])
    systems = [each.wound(dynamics, f) for each in seen]
    found = np.array([_fitted(systems, joint) for joint in range(dynamics.n)])
    return Deflection(compliance=found[:, 0], std=_SYSTEMATIC * found[:, 1], torque=torque)


def _fitted(systems: Sequence[System], joint: int) -> tuple[float, float]:
    """Compliance of one gear, and its standard deviation from the scatter of the equations."""
    rows, target = [], []
    for k, system in enumerate(systems):
        columns, deflection, some = system.regressor, system.torque, system.used[:, joint]
        own = np.zeros((some.sum(), len(systems)))
        own[:, k] = columns[some, joint, 2]  # each record has an offset of its own
        rows.append(np.column_stack([columns[some, joint, :2], own]))
        target.append(deflection[some, joint])
    matrix, measured = np.vstack(rows), np.concatenate(target)
    names = ["compliance", "its rate", *(f"offset of record {k}" for k in range(len(systems)))]
    values, covariance, _ = least_squares(names, matrix, measured)
    left = measured - product(matrix, values)
    std = np.sqrt(np.diag(covariance) * dot(left, left) / max(1, len(left) - len(values)))
    return float(values[0]), float(std[0])

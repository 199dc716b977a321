"""The equation error behind elastic gears: f for given compliances, and the compliances with which it fits best.

What friction and the rotor leave of a motor's torque its gear passes on, and is wound up by it: the deflection is
compliance times that torque. So the motion of the links follows from counts of the motors and from the law, and the
torque equation stays linear in f; a fit with other compliances takes milliseconds. All have a smooth least residual
where predicted positions have several.

Source: M. W. Spong, Modeling and control of elastic joint robots, ASME Journal of Dynamic Systems, Measurement, and
Control 109 (1987) (equations of motion).
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.filtering import derivatives, low_pass
from identification.equation_error.motor_torque import torque_of
from identification.equation_error.pulse_fit import CUTOFF, fit_systems, mode_in, speed_noise
from identification.equation_error.regressor import System, compared, linear, regressor_along
from identification.equation_error.torque_fit import TorqueFit
from plant import Dynamics, Record
from plant.motion.reference import Motion

_BANDS = (0.5, 0.7, 1.0, 1.4)
"""Pass bands that are tried, in frequencies of the strongest oscillation."""

_REPLAYED = (4.0, 8.0, 16.0, 32.0)
"""The same of logs that replay their torque [Hz]."""

_SPARSE = 4.0
"""Samples that are kept, per period of the cutoff: what is left is in the band alone."""

_ROUNDS, _NEAR = 6, 2
"""How often, at most, each gear is fitted anew with the others as they are; and how far, in places of the grid."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class GearFit:
    """The best fit in one pass band.

    Attributes
    ----------
    compliance : (n,) numpy.ndarray
        Of the gears, on the shafts [rad/(N m)].
    torque : TorqueFit
        Of f and linear numbers of the drive, with these compliances.
    """

    compliance: NDArray[np.float64]
    torque: TorqueFit


class _Wound:
    """A record in a pass band [Hz]: motion of its motors, and the torque with which they wind up their gears."""

    def __init__(self, record: Record, band: float) -> None:
        rig, self.rig, self.band = record.rig, record.rig, band
        cutoff, drive, torque = CUTOFF * band, rig.drive, torque_of(record)
        motors = derivatives(rig.cell_centre(record.counts), rig.period, cutoff)
        held = low_pass(torque - drive.friction(motors.qd), rig.period, cutoff)
        passed = drive.coupling.shaft_torque(held - drive.rotor_torque(motors.qdd))
        every = max(1, int(1 / (_SPARSE * cutoff * rig.period)))
        self.every, self.period, rows = every, every * rig.period, np.arange(0, len(torque), every)
        self.wind_up = tuple(x[rows] for x in _motion(passed, rig.period))
        self.motors = Motion(*(x[rows] for x in motors))
        self.torque = low_pass(torque, rig.period, cutoff)[rows]
        self.valid = np.minimum.reduceat(record.valid, rows)

    def system(self, dynamics: Dynamics, unknown: Sequence[str], compliance: NDArray[np.float64]) -> System:
        """The torque equation along the motion of the links."""
        joint, cutoff, period = self.rig.drive.coupling.joint, CUTOFF * self.band, self.period
        moved = zip(self.motors, self.wind_up, strict=True)
        links = Motion(*(motor - joint(compliance * passed) for motor, passed in moved))
        regressor, given = regressor_along(dynamics, self.rig, unknown, links, self.motors)
        signals = [self.torque - given, *np.moveaxis(regressor, 2, 0)]
        every, slowest = max(1, int(1 / (2 * self.band * period))), speed_noise(self.rig, self.band)
        kept = compared(signals, self.motors.qd, period, cutoff, self.band, every, slowest, self.valid)
        return dataclasses.replace(kept, sample=kept.sample * self.every, period=self.rig.period)


def _motion(x: NDArray[np.float64], period: float) -> tuple[NDArray[np.float64], ...]:
    """Samples (N, n), and their first and second derivatives by central differences."""
    rate = np.gradient(x, period, axis=0)
    return x, rate, np.gradient(rate, period, axis=0)


def fit_gears(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Sequence[str],
    known: Mapping[str, float],
    grid: NDArray[np.float64],
) -> list[GearFit]:
    """Fits with the best compliances of a grid, one for each pass band in which there is one.

    Parameters
    ----------
    dynamics, records, unknown, known
        As for `equation_error`; rigs may have elasticity or not.
    grid : (m, n) numpy.ndarray
        Compliances of each gear that are tried [rad/(N m)]: rows of all gears together first, then each on its own.
        A column of one value keeps that gear as it is.
    """
    names, fits = linear(dynamics, records[0].rig, unknown), []
    for i in range(len(_BANDS)):
        try:
            wound = [_Wound(record, _band(record, i)) for record in records]
            fits.append(_best(dynamics, wound, names, known, grid))
        except ValueError:  # a band without equations, or in which unknowns are not separately identifiable
            continue
    return fits


def _band(record: Record, i: int) -> float:
    replays = record.law is not None and bool(record.law.replays)
    return _REPLAYED[i] if replays else _BANDS[i] * mode_in(record)


def _best(
    dynamics: Dynamics,
    wound: Sequence[_Wound],
    names: tuple[str, ...],
    known: Mapping[str, float],
    grid: NDArray[np.float64],
) -> GearFit:
    """The best fit in a band: of all gears together, then of each while the others stay."""

    def fitted(compliance: NDArray[np.float64]) -> GearFit:
        systems = [each.system(dynamics, names, compliance) for each in wound]
        return GearFit(compliance=compliance, torque=fit_systems(dynamics, names, known, systems))

    best = min(map(fitted, np.unique(grid, axis=0)), key=_misfit)
    for _ in range(_ROUNDS):
        before = best
        for joint, column in enumerate(grid.T):
            values = np.unique(column)
            place = int(np.searchsorted(values, best.compliance[joint]))
            near = values[max(0, place - _NEAR) : place + _NEAR + 1]
            tried = [np.where(np.arange(grid.shape[1]) == joint, c, best.compliance) for c in near]
            best = min([best, *(fitted(c) for c in tried if c[joint] != best.compliance[joint])], key=_misfit)
        if best is before:
            break
    return best


def _misfit(fit: GearFit) -> float:
    """Negative logarithm of the likelihood, per equation of each joint."""
    return float(np.log(np.maximum(fit.torque.sigma, 1e-300)).sum())

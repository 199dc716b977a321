"""The equation error behind elastic gears: f for given compliances, and the compliances with which
it fits best.

What friction and the rotor leave of a motor's torque its gear passes on, and is wound up by it: the
deflection is compliance times that torque. So the motion of the links follows from counts of the
motors and from the law, and the torque equation stays linear in f; a fit with other compliances
takes milliseconds. All have a smooth least residual where predicted positions have several.

With the links counted too (`fit_deflection`), f follows whatever the gears are, and stiffness from
their deflection (`two_encoders`).

Source: M. W. Spong, Modeling and control of elastic joint robots, ASME Journal of Dynamic Systems,
Measurement, and Control 109 (1987) (equations of motion).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from identification.equation_error.filters import by_differences, derivatives, low_pass
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.prior import Known
from identification.equation_error.pulse_fit import CUTOFF, filtering_of, fit_systems, mode_in
from identification.equation_error.regressor import System, compared, linear, regressor_along
from identification.equation_error.torque_fit import TorqueFit
from identification.equation_error.torque_logs import torque_of
from identification.equation_error.two_encoders import Deflections, fit_wound
from plant import Dynamics, Record
from plant.motion.reference import Motion
from plant.parts.fields import Floats

_BAND = 1.4  # pass band, in frequencies of the strongest oscillation

# errors of the torque on the links (f, filters at reversals) over the scatter of the equations
_SYSTEMATIC = 2.0


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class GearFit:
    """Gears, as two position sensors show them or as they fit best in a pass band.

    `compliance` (n,): on the shafts [rad/(N m)]. `torque`: of f and linear numbers of the drive,
    beside them. `std` (n,) of the compliance, from two sensors alone.
    """

    compliance: Floats
    torque: TorqueFit
    std: Floats | None = None


def fit_deflection(
    dynamics: Dynamics, records: Sequence[Record], unknown: Sequence[str], known: Known
) -> GearFit:
    """Compliance of gears from records with `link_counts` of all; arguments as for
    `equation_error`.
    """
    names = linear(dynamics, records[0].rig, unknown)
    seen = [Deflections.of(record, _BAND * mode_in(record)) for record in records]
    torque = fit_systems(dynamics, names, known, [each.balance(dynamics, names) for each in seen])
    values = dict(known) | dict(zip(torque.names, torque.values, strict=True))
    wound = fit_wound(dynamics, seen, np.array([values[name] for name in dynamics.names]))[0]
    return GearFit(
        compliance=wound.values[0], std=_SYSTEMATIC * wound.half[0] / NORMAL, torque=torque
    )


# pass bands that are tested, in frequencies of the strongest oscillation
_BANDS = (0.5, 0.7, 1.0, 1.4)

_REPLAYED = (4.0, 8.0, 16.0, 32.0)  # the same of logs that replay their torque [Hz]

_SPARSE = 4.0  # samples that are kept, per period of the cutoff: what is left is in the band alone

# How often, at most, each gear is fitted anew with the others as they are; and how far, in places
# of the grid.
_ROUNDS = 6
_NEAR = 2


class _Wound:
    """A record in a pass band [Hz]: motion of its motors, and the torque with which they wind up
    their gears.
    """

    def __init__(self, record: Record, band: float) -> None:
        rig = record.rig
        self.rig = record.rig
        self.band = band
        cutoff = CUTOFF * band
        drive = rig.drive
        torque = torque_of(record)
        motors = derivatives(rig.cell_centre(record.counts), rig.period, cutoff)
        held = low_pass(torque - drive.friction(motors.qd), rig.period, cutoff)
        passed = drive.coupling.shaft_torque(held - drive.rotor_torque(motors.qdd))
        every = max(1, int(1 / (_SPARSE * cutoff * rig.period)))
        self.every, self.period, rows = every, every * rig.period, np.arange(0, len(torque), every)
        self.wind_up = tuple(x[rows] for x in by_differences(passed, rig.period))
        self.motors = Motion(*(x[rows] for x in motors))
        self.torque = low_pass(torque, rig.period, cutoff)[rows]
        self.valid = np.minimum.reduceat(record.valid, rows)

    def system(self, dynamics: Dynamics, unknown: Sequence[str], compliance: Floats) -> System:
        """The torque equation along the motion of the links."""
        joint = self.rig.drive.coupling.joint
        filtering = filtering_of(self.rig, self.band)
        moved = zip(self.motors, self.wind_up, strict=True)
        links = Motion(*(motor - joint(compliance * passed) for motor, passed in moved))
        regressor, given = regressor_along(dynamics, self.rig, unknown, links, self.motors)
        signals = [self.torque - given, *np.moveaxis(regressor, 2, 0)]
        filtering = filtering._replace(every=max(1, int(1 / (2 * self.band * self.period))))
        kept = compared(signals, self.motors.qd, self.period, filtering, self.valid)
        return dataclasses.replace(kept, sample=kept.sample * self.every, period=self.rig.period)


def fit_gears(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Sequence[str],
    known: Known,
    grid: Floats,
) -> list[GearFit]:
    """Fits with the best compliances of a grid, one for each pass band in which there is one.

    `dynamics`, `records`, `unknown`, `known`: as for `equation_error`; rigs may have elasticity or
    not. `grid` (m, n): compliances of each gear that are tested [rad/(N m)]: rows of all gears
    together first, then each on its own. A column of one value keeps that gear as it is.
    """
    names = linear(dynamics, records[0].rig, unknown)
    fits = []
    for i in range(len(_BANDS)):
        try:
            wound = [_Wound(record, _band(record, i)) for record in records]
            fits.append(_best(dynamics, wound, names, known, grid))
        # a band without equations, or in which unknowns are not separately identifiable
        except ValueError:
            continue
    return fits


def _band(record: Record, i: int) -> float:
    replays = record.law is not None and bool(record.law.replays)
    return _REPLAYED[i] if replays else _BANDS[i] * mode_in(record)


def _best(
    dynamics: Dynamics, wound: Sequence[_Wound], names: tuple[str, ...], known: Known, grid: Floats
) -> GearFit:
    """The best fit in a band: of all gears together, then of each while the others stay."""

    def fitted(compliance: Floats) -> GearFit:
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
            best = min(
                [best, *(fitted(c) for c in tried if c[joint] != best.compliance[joint])],
                key=_misfit,
            )
        if best is before:
            break
    return best


def _misfit(fit: GearFit) -> float:
    """Negative logarithm of the likelihood, per equation of each joint."""
    return float(np.log(np.maximum(fit.torque.sigma, 1e-300)).sum())

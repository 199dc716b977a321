"""Equation error behind elastic gears: f for given compliances, then the best compliances.

A gear passes on the torque of its motor less that of friction and rotor, and winds up by it: the
deflection is compliance times that torque. So the motion of the links follows from counts of the
motors and from the law, and the torque equation stays linear in f; a fit with other compliances
takes milliseconds. Its residual has one smooth minimum where predicted positions have several.

With the links counted too (`fit_deflection`), f follows whatever the gears are, and stiffness from
their deflection (`two_encoders`).

Source: M. W. Spong, Modeling and control of elastic joint robots, ASME Journal of Dynamic Systems,
Measurement, and Control 109 (1987) (equations of motion).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error.filters import CUTOFF, by_differences, derivatives, low_pass
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.naming import of_each
from identification.equation_error.prior import Known
from identification.equation_error.pulse_fit import (
    filtering_of,
    fit_systems,
    mode_in,
    without_gaps,
)
from identification.equation_error.regressor import balance, compared, linear, regressor_along
from identification.equation_error.torque_fit import TorqueFit
from identification.equation_error.torque_logs import torque_of
from identification.equation_error.two_encoders import Deflections, fit_wound
from plant import Dynamics, Record
from plant.motion import Motion
from plant.parts import Floats, frozen, frozen_settings


@frozen_settings
class GearFitSettings:
    """Bands and search of a fit of gears; chosen by hand.

    Parameters
    ----------
    bands : tuple of float
        Pass bands that are tested, in frequencies of the strongest oscillation.
    replayed_bands : tuple of float
        The same of logs that replay their torque [Hz]: no loop oscillates there.
    deflection_band : float
        Pass band of a log with encoders on both sides, in frequencies of the strongest oscillation.
    systematic : float
        Ratio of the errors of the torque on the links (f, filters at reversals) to the scatter of
        the equations.
    samples : float
        Samples that are kept per period of the cutoff: the low-passed signals hold no more.
    rounds : int
        Most times that each gear is fitted while the others stay.
    neighbours : int
        Places of the grid, on either side, at which a gear is fitted.
    """

    bands: tuple[float, ...] = (0.5, 0.7, 1.0, 1.4)
    replayed_bands: tuple[float, ...] = (4.0, 8.0, 16.0, 32.0)
    deflection_band: float = 1.4
    systematic: float = 2.0
    samples: float = 4.0
    rounds: int = 6
    neighbours: int = 2


SETTINGS = GearFitSettings()


@frozen
class GearFit:
    """Gears, as two position sensors show them or as they fit best in a pass band.

    `compliance` (n,): on the shafts [rad/(N m)]. `torque`: of f and linear numbers of the drive,
    beside them. `std` (n,) of the compliance, from two sensors alone.
    """

    compliance: Floats
    torque: TorqueFit
    std: Floats | None = None


def fit_deflection(
    dynamics: Dynamics, records: Sequence[Record], unknown: Sequence[str], known_values: Known
) -> GearFit:
    """Compliance of gears from records with `link_counts` of all.

    Arguments as for `equation_error`.
    """
    names = linear(dynamics, records[0].rig, unknown)
    records = of_each(without_gaps, records)
    deflections = of_each(
        lambda record: Deflections.of(record, SETTINGS.deflection_band * mode_in(record)), records
    )
    # 1. f along the motions of both sides, which do not depend on the gears.
    systems = [deflection.balance(dynamics, names) for deflection in deflections]
    torque = fit_systems(dynamics, names, known_values, systems)
    # All of f, stated and fitted numbers together.
    values = dict(known_values) | dict(zip(torque.names, torque.values, strict=True))

    # 2. The compliances, by the torques that follow from f.
    f = np.array([values[name] for name in dynamics.names])
    wound = fit_wound(dynamics, deflections, f)[0]
    std = SETTINGS.systematic * wound.half[0] / NORMAL
    return GearFit(compliance=wound.values[0], std=std, torque=torque)


class _Wound:
    """Motion of the motors and wind-up torque of the gears of a record in a pass band [Hz]."""

    def __init__(self, record, band):
        rig = record.rig
        self.rig = rig
        self.band = band
        cutoff = CUTOFF * band
        drive = rig.drive
        torque = torque_of(record)
        motors = derivatives(rig.cell_centre(record.counts), rig.period, cutoff)
        # The jumps of friction at reversals are filtered like the torque that makes up for them.
        held = low_pass(torque - drive.friction(motors.qd), rig.period, cutoff)
        passed = drive.coupling.shaft_torque(held - drive.rotor_torque(motors.qdd))
        # The low-passed signals are stored at a lower rate: the grid of compliances filters them
        # many times.
        every = max(1, int(1 / (SETTINGS.samples * cutoff * rig.period)))
        rows = np.arange(0, len(torque), every)
        self.every = every
        self.period = every * rig.period
        self.wind_up = tuple(x[rows] for x in by_differences(passed, rig.period))
        self.motors = Motion(*(x[rows] for x in motors))
        self.torque = low_pass(torque, rig.period, cutoff)[rows]
        # A kept sample counts as little as the worst of those that it stands for.
        self.valid = np.minimum.reduceat(record.valid, rows)

    def system(self, dynamics, unknown, compliance):
        """The torque equation along the motion of the links."""
        # Shafts wind up; a coupling makes joint angles of that.
        joint = self.rig.drive.coupling.joint
        filtering = filtering_of(self.rig, self.band)
        pairs = zip(self.motors, self.wind_up, strict=True)
        links = Motion(*(motor - joint(compliance * passed) for motor, passed in pairs))
        regressor, stated = regressor_along(dynamics, self.rig, unknown, links, self.motors)
        signals = [self.torque - stated, *np.moveaxis(regressor, 2, 0)]
        filtering = filtering._replace(every=max(1, int(1 / (2 * self.band * self.period))))
        system = compared(signals, self.motors.qd, self.period, filtering, self.valid)
        # Rows are numbered as in the log, of which these samples are a part.
        sample = system.sample * self.every
        return replace(system, sample=sample, period=self.rig.period)


def fit_gears(
    dynamics: Dynamics,
    records: Sequence[Record],
    unknown: Sequence[str],
    known_values: Known,
    grid: Floats,
) -> list[GearFit]:
    """Fits with the best compliances of a grid, one for each pass band in which there is one.

    `dynamics`, `records`, `unknown`, `known_values`: as for `equation_error`; rigs with elasticity
    or without. `grid` (m, n): tested compliances of each gear [rad/(N m)]: rows of all gears
    together first, then each on its own. A column of one value keeps that gear as it is.
    """
    names = linear(dynamics, records[0].rig, unknown)
    # Wrong names are wrong in every band: they are refused here, by name.
    of_each(lambda record: balance(dynamics, record.rig, names, True), records)
    records = of_each(without_gaps, records)
    fits = []
    for i in range(len(SETTINGS.bands)):
        try:
            wound = [_Wound(record, record_band(record, i)) for record in records]
            fits.append(_best(dynamics, wound, names, known_values, grid))
        except ValueError:
            # No equations in this band, or unknowns that are not separately identifiable in it.
            continue
    return fits


def record_band(record, i):
    """Upper frequency of a record's band `i` [Hz]; a replayed log has fixed ones."""
    replays = record.law is not None and bool(record.law.replays)
    return SETTINGS.replayed_bands[i] if replays else SETTINGS.bands[i] * mode_in(record)


def _best(dynamics, wound, names, known_values, grid):
    """The best fit in a band: of all gears together, then of each while the others stay."""

    def fitted(compliance):
        systems = [record.system(dynamics, names, compliance) for record in wound]
        return GearFit(
            compliance=compliance, torque=fit_systems(dynamics, names, known_values, systems)
        )

    # Rows of a grid may repeat where a gear stays as it is.
    best = min(map(fitted, np.unique(grid, axis=0)), key=_misfit)
    # Coordinate descent: the residual is smooth in each compliance, and the gears interact weakly.
    for _ in range(SETTINGS.rounds):
        previous = best
        for joint, column in enumerate(grid.T):
            values = np.unique(column)
            place = int(np.searchsorted(values, best.compliance[joint]))
            # Only the neighbours on the grid: a round costs a few fits per gear, and a minimum
            # further away is reached in several rounds.
            low = max(0, place - SETTINGS.neighbours)
            fits = [best]
            for value in values[low : place + SETTINGS.neighbours + 1]:
                if value != best.compliance[joint]:
                    of_joint = np.arange(grid.shape[1]) == joint
                    fits.append(fitted(np.where(of_joint, value, best.compliance)))
            best = min(fits, key=_misfit)
        # No gear has moved in this round: further rounds would repeat it.
        if best is previous:
            break
    return best


def _misfit(fit):
    """Negative logarithm of the likelihood, per equation of each joint that has one."""
    # Joint by joint: a sum of squares would let the strongest joint decide. A joint that stands
    # still has no equation, whatever the compliances.
    return float(np.nansum(np.log(np.maximum(fit.torque.sigma, 1e-300))))

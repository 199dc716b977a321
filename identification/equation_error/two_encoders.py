"""Stiffness and damping of gears with an encoder on either side, by deflection against torque.

With stiffness k and damping d, the torque is k times the deflection plus d times its rate. To first
order, the deflection is thus the torque over k, less d / k^2 times the torque's rate, plus an
offset, since the two encoders have different zeros. The parameters f of the dynamics give the
torques along the motion of the links. A link without an encoder follows its motor, less the
deflection of its gear if the rig states the elasticity.

Intervals include the differences between blocks of a log and between logs (`weighted`), and the
errors that all logs share: those of the torques and of f.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from identification.equation_error.filters import CUTOFF, by_differences, derivatives, low_pass
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.pulse_fit import filtering_of
from identification.equation_error.regressor import System, compared, regressor_along
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import torque_of
from plant import Dynamics, Record
from plant.checkup import on_lines
from plant.motion import Motion
from plant.parts import Bools, Floats, product, products

# Relative standard deviation of the torques from errors other than those of f: unstated gears,
# wrong lengths, a wrong direction of gravity. Chosen by hand.
_TORQUES = 2e-3


class Deflections(NamedTuple):
    """Motions of motors and links of a record in a pass band [Hz].

    `seen` (n,): gears with both encoders.
    """

    record: Record
    band: float
    motors: Motion
    links: Motion
    seen: Bools

    @classmethod
    def of(cls, record: Record, band: float) -> "Deflections":
        """Motions of a record with `link_counts`.

        The zeros of the links are set so that the mean deflection is zero.
        """
        # Counts without weight may be anything: filters would carry them into their neighbourhood,
        # and the mean would carry them everywhere.
        record = on_lines(record, record.valid == 0)
        rig = record.rig
        counts = record.counts
        link_counts = np.asarray(record.link_counts)
        seen = np.asarray(~np.isnan(link_counts).all(axis=0))
        # Links without an encoder are where their motors are, for now.
        link_counts = np.where(seen, link_counts, counts)
        link_counts = link_counts + (counts - link_counts).mean(axis=0)
        cutoff = CUTOFF * band
        motors = derivatives(rig.cell_centre(counts), rig.period, cutoff)
        links = derivatives(rig.cell_centre(link_counts), rig.period, cutoff)
        return cls(record, band, motors, links, seen)

    def balance(self, dynamics: Dynamics, unknown: Sequence[str]) -> System:
        """The torque equation along the measured motions."""
        rig = self.record.rig
        filtering = filtering_of(self.record.rig, self.band)
        regressor, stated = regressor_along(dynamics, rig, unknown, self.links, self.motors)
        signals = [torque_of(self.record) - stated, *np.moveaxis(regressor, 2, 0)]
        return compared(signals, self.motors.qd, rig.period, filtering, self.record.valid)

    def behind(self, dynamics: Dynamics, f: Floats, compliance: Floats) -> "Deflections":
        """The same, with links shifted to the mean deflection of gears of this compliance (n,)."""
        coupling = self.record.rig.drive.coupling
        mean = coupling.shaft((self.motors.q - self.links.q).mean(axis=0))
        # The mean torque, mostly that of gravity, causes the mean deflection.
        wound = compliance * self._passed(dynamics, f)[0].mean(axis=0)
        q = self.links.q + coupling.joint(mean - wound)
        return self._replace(links=self.links._replace(q=q))

    def wound(self, dynamics: Dynamics, f: Floats) -> System:
        """A system with the shafts' deflections in place of torques.

        Its columns are the torque on each shaft, the rate of this torque, and the regressor of f.
        """
        rig = self.record.rig
        filtering = filtering_of(self.record.rig, self.band)
        coupling = rig.drive.coupling
        # A gear winds up at rest, too: no speed is too slow.
        filtering = filtering._replace(slowest=np.zeros(rig.n))
        torque, Y = self._passed(dynamics, f)
        if rig.drive.elasticity is not None and not self.seen.all():
            # Links without an encoder lag by the deflection of the gears that the rig states.
            stated = np.where(self.seen, 0.0, torque / rig.drive.elasticity.stiffness)
            behind = by_differences(low_pass(stated, rig.period, CUTOFF * self.band), rig.period)
            pairs = zip(self.links, behind, strict=True)
            links = Motion(*(link - coupling.joint(deflection) for link, deflection in pairs))
            torque, Y = self._replace(links=links)._passed(dynamics, f)
        of_f = map(coupling.shaft_torque, np.moveaxis(Y, 2, 0))
        # Motor less link: the deflection has the sign of the torque that the gear passes on.
        deflection = coupling.shaft(self.motors.q - self.links.q)
        signals = [deflection, torque, np.gradient(torque, rig.period, axis=0), *of_f]
        system = compared(signals, self.motors.qd, rig.period, filtering, self.record.valid)
        return replace(system, used=system.used & self.seen)

    def _passed(self, dynamics, f):
        """Torque (N, n) that each gear passes to the links, and the regressor (N, n, p) of f.

        The torque is that on the shafts; the regressor is that of joint torques, with the rotors.
        """
        drive = self.record.rig.drive
        links = self.links
        Y, _ = regressor_along(dynamics, self.record.rig, dynamics.names, links, links)
        # f holds the rotors, which are on the motor's side of the gear.
        rotors = drive.rotor_torque(links.qdd)
        torque = (Y * f).sum(axis=2) - rotors - self.record.rig.spring_torque(links.q)
        return drive.coupling.shaft_torque(torque), Y


class Wound(NamedTuple):
    """Compliance of each gear and d / k^2, (2, n), with half-widths of their 95 % intervals.

    NaN of a gear without both encoders.
    """

    values: Floats
    half: Floats


def fit_wound(
    dynamics: Dynamics, records: Sequence[Deflections], f: Floats, covariance: Floats | None = None
) -> tuple[Wound, list[Wound], TorqueFit]:
    """Gears from all records together, gears from each record alone, and the fit to all records.

    All records must have link encoders at the same gears. `covariance` (p, p): of f.
    """
    seen = np.flatnonzero(records[0].seen)
    n = dynamics.n
    names = tuple(
        f"drive.elasticity.{term}[{j}]" for term in ("compliance", "damping") for j in seen
    )
    seconds = np.array([len(shown.record) * shown.record.rig.period for shown in records])

    # 1. Fit twice: first with the mean deflection of each gear at zero, then with the mean
    # deflection that follows from the compliance of the first fit.
    compliance = np.zeros(n)
    count = len(seen)
    for refined in (False, True):
        if refined:
            records = [shown.behind(dynamics, f, compliance) for shown in records]
        systems = [shown.wound(dynamics, f) for shown in records]
        equations = [_beside_offset(system, seen) for system in systems]
        fit = weighted(dynamics, names, equations, seconds=seconds)
        compliance[seen] = fit.values[:count]

    # 2. Of all records, and of each: its values, half-widths and equations.
    results = [(fit.values, NORMAL * fit.std, systems)]
    if fit.between is not None:
        results += [
            (values, half, [system])
            for values, half, system in zip(
                fit.between.values, fit.between.half_width, systems, strict=True
            )
        ]

    # 3. Intervals with the errors that all records share: of the torques, and of f.
    gears = []
    for values, half, of_result in results:
        half[:count] = np.hypot(half[:count], NORMAL * _TORQUES * values[:count])
        if covariance is not None:
            moves = _moved_by_f(of_result, seen, values[:count])
            variance = np.maximum(((moves @ covariance) * moves).sum(axis=1), 0)
            # An error of f moves all torques of a log together: no average over its rows reduces
            # it.
            half = np.hypot(half, NORMAL * np.sqrt(variance))
        of_joints = np.full((2, 2, n), np.nan)
        of_joints[:, :, seen] = values.reshape(2, -1), half.reshape(2, -1)
        gears.append(Wound(*of_joints))
    return gears[0], gears[1:] or gears[:1], fit


def _centred(x, used):
    """Columns (N', n, ...) less their means over the rows that count."""
    mask = used.reshape(*used.shape, *(1,) * (x.ndim - 2))
    return x - (x * mask).sum(axis=0) / np.maximum(mask.sum(axis=0), 1)


def _beside_offset(system, seen):
    """One record's equations without their offset, with a compliance and a damping per gear."""
    # The two encoders have different zeros, so the offset of a record says nothing about the gear.
    columns = _centred(system.regressor[:, :, :2], system.used)
    count = len(seen)
    regressor = np.zeros((*system.torque.shape, 2 * count))
    for i, j in enumerate(seen):
        regressor[:, j, i] = columns[:, j, 0]
        regressor[:, j, count + i] = -columns[:, j, 1]
    deflection = _centred(system.torque, system.used)
    return replace(system, regressor=regressor, torque=deflection)


def _moved_by_f(systems, seen, compliance):
    """Derivative (2 m, p) of the values by f, which changes the torques."""
    centred = [_centred(system.regressor, system.used) for system in systems]
    moves = []
    for j, c in zip(seen, compliance, strict=True):
        # A log in which the torque of this gear is constant tells nothing of it.
        if np.isnan(c):
            moves.append(np.full((2, centred[0].shape[2] - 2), np.nan))
            continue
        rows = np.vstack(
            [
                columns[system.used[:, j], j]
                for columns, system in zip(centred, systems, strict=True)
            ]
        )
        # Differentiate the normal equations: a change of the torque acts like a change of the
        # deflection by -c times it. The damping term and the residual are neglected.
        of_gear = rows[:, :2] * (1, -1)
        moves.append(-np.linalg.solve(products(of_gear), product(of_gear.T, c * rows[:, 2:])))
    return np.swapaxes(moves, 0, 1).reshape(2 * len(seen), -1)

"""Gears with an encoder on either side: their deflection against the torque of their links.

With stiffness k and damping d the torque is k times the deflection and d times its rate; so the
deflection is the torque over k, less d / k^2 times the torque's rate, beside an offset: two sensors
have zeros of their own. Torques follow from f along the motion of the links. Links without an
encoder are where their motors are, less what winds up the gears that the rig states.

Intervals count how blocks of a log, and logs, differ (`weighted`), and the covariance of f, which
all logs share.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.filters import by_differences, derivatives, low_pass
from identification.equation_error.least_squares import NORMAL
from identification.equation_error.pulse_fit import CUTOFF, filtering_of
from identification.equation_error.regressor import System, compared, regressor_along
from identification.equation_error.torque_fit import TorqueFit, weighted
from identification.equation_error.torque_logs import torque_of
from plant import Dynamics, Record
from plant.motion.reference import Motion
from plant.parts.fields import Floats
from plant.parts.sums import product, products

# Relative standard deviation of torques beside that of f: gears that no rig states, lengths,
# direction of gravity.
_TORQUES = 2e-3


class Deflections(NamedTuple):
    """What a record shows in a pass band [Hz]: motions of motors and links, `seen` (n,): gears
    with both encoders.
    """

    record: Record
    band: float
    motors: Motion
    links: Motion
    seen: NDArray[np.bool_]

    @classmethod
    def of(cls, record: Record, band: float) -> "Deflections":
        """Of a record with `link_counts`; their zeros are set so that the mean deflection is
        nought.
        """
        rig = record.rig
        counts = record.counts
        there = np.asarray(record.link_counts)
        seen = np.asarray(~np.isnan(there).all(axis=0))
        there = np.where(seen, there, counts)
        pulses = counts, there + (counts - there).mean(axis=0)
        motors, links = (
            derivatives(rig.cell_centre(each), rig.period, CUTOFF * band) for each in pulses
        )
        return cls(record, band, motors, links, seen)

    def balance(self, dynamics: Dynamics, unknown: Sequence[str]) -> System:
        """The torque equation along the measured motions."""
        rig = self.record.rig
        filtering = filtering_of(self.record.rig, self.band)
        regressor, given = regressor_along(dynamics, rig, unknown, self.links, self.motors)
        signals = [torque_of(self.record) - given, *np.moveaxis(regressor, 2, 0)]
        return compared(signals, self.motors.qd, rig.period, filtering, self.record.valid)

    def behind(self, dynamics: Dynamics, f: Floats, compliance: Floats) -> "Deflections":
        """The same with the zeros of the links where gears of this compliance (n,) have them."""
        coupling = self.record.rig.drive.coupling
        mean = coupling.shaft((self.motors.q - self.links.q).mean(axis=0))
        held = compliance * self._passed(dynamics, f)[0].mean(axis=0)
        return self._replace(
            links=self.links._replace(q=self.links.q + coupling.joint(mean - held))
        )

    def wound(self, dynamics: Dynamics, f: Floats) -> System:
        """Deflections of the shafts; regressor: the torque on each, its rate, and the regressor
        of f.
        """
        rig = self.record.rig
        filtering = filtering_of(self.record.rig, self.band)
        coupling = rig.drive.coupling
        still = filtering._replace(slowest=np.zeros(rig.n))
        torque, Y = self._passed(dynamics, f)
        if rig.drive.elasticity is not None and not self.seen.all():
            stated = np.where(self.seen, 0.0, torque / rig.drive.elasticity.stiffness)
            behind = by_differences(low_pass(stated, rig.period, CUTOFF * self.band), rig.period)
            links = Motion(
                *(each - coupling.joint(x) for each, x in zip(self.links, behind, strict=True))
            )
            torque, Y = self._replace(links=links)._passed(dynamics, f)
        of_f = map(coupling.shaft_torque, np.moveaxis(Y, 2, 0))
        deflection = coupling.shaft(self.motors.q - self.links.q)
        signals = [deflection, torque, np.gradient(torque, rig.period, axis=0), *of_f]
        whole = compared(signals, self.motors.qd, rig.period, still, self.record.valid)
        return dataclasses.replace(whole, used=whole.used & self.seen)

    def _passed(self, dynamics: Dynamics, f: Floats) -> tuple[Floats, Floats]:
        """Torque (N, n) that each gear passes to the links, and its regressor (N, n, p) on the
        joints.
        """
        drive = self.record.rig.drive
        links = self.links
        Y, _ = regressor_along(dynamics, self.record.rig, dynamics.names, links, links)
        torque = (
            (Y * f).sum(axis=2)
            - drive.rotor_torque(links.qdd)
            - self.record.rig.spring_torque(links.q)
        )
        return drive.coupling.shaft_torque(torque), Y


class Wound(NamedTuple):
    """Compliance of each gear, and d / k^2, (2, n); half-widths (2, n) of their 95 % intervals.
    NaN if not seen.
    """

    values: Floats
    half: Floats


def fit_wound(
    dynamics: Dynamics, records: Sequence[Deflections], f: Floats, covariance: Floats | None = None
) -> tuple[Wound, list[Wound], TorqueFit]:
    """Gears of all records, which see the same ones, and of each alone; and the fit.
    `covariance` (p, p): of f.
    """
    seen = np.flatnonzero(records[0].seen)
    n = dynamics.n
    names = tuple(
        f"drive.elasticity.{term}[{j}]" for term in ("compliance", "damping") for j in seen
    )
    seconds = np.array([len(each.record) * each.record.rig.period for each in records])
    compliance = np.zeros(n)
    for again in (False, True):  # the first time links have the mean position of their motors
        records = [each.behind(dynamics, f, compliance) for each in records] if again else records
        systems = [each.wound(dynamics, f) for each in records]
        fit = weighted(
            dynamics, names, [_beside_offset(system, seen) for system in systems], seconds=seconds
        )
        compliance[seen] = fit.values[: len(seen)]
    alone = [(fit.values, NORMAL * fit.std)]
    spread = [systems]
    if fit.between is not None:
        alone += zip(fit.between.values, fit.between.half_width, strict=True)
        spread += [[system] for system in systems]
    found = []
    for (values, half), some in zip(alone, spread, strict=True):
        half[: len(seen)] = np.hypot(half[: len(seen)], NORMAL * _TORQUES * values[: len(seen)])
        if covariance is not None:
            moves = _moved_by_f(some, seen, values[: len(seen)])
            half = np.hypot(
                half, NORMAL * np.sqrt(np.maximum(((moves @ covariance) * moves).sum(axis=1), 0))
            )
        whole = np.full((2, 2, n), np.nan)
        whole[:, :, seen] = values.reshape(2, -1), half.reshape(2, -1)
        found.append(Wound(*whole))
    return found[0], found[1:] or found[:1], fit


def _centred(x: Floats, used: NDArray[np.bool_]) -> Floats:
    """Columns (N', n, ...) less their means over the rows that count."""
    some = used.reshape(*used.shape, *(1,) * (x.ndim - 2))
    return np.asarray(x - (x * some).sum(axis=0) / np.maximum(some.sum(axis=0), 1))


def _beside_offset(system: System, seen: NDArray[np.intp]) -> System:
    """One record's equations without their offset, in what belongs to each gear."""
    columns = _centred(system.regressor[:, :, :2], system.used)
    count = len(seen)
    own = np.zeros((*system.torque.shape, 2 * count))
    for i, j in enumerate(seen):
        own[:, j, i], own[:, j, count + i] = columns[:, j, 0], -columns[:, j, 1]
    return dataclasses.replace(system, regressor=own, torque=_centred(system.torque, system.used))


def _moved_by_f(systems: Sequence[System], seen: NDArray[np.intp], compliance: Floats) -> Floats:
    """Change (2 m, p) of the values with f: it changes the torques."""
    centred = [_centred(system.regressor, system.used) for system in systems]
    moves = []
    for j, c in zip(seen, compliance, strict=True):
        rows = np.vstack(
            [each[system.used[:, j], j] for each, system in zip(centred, systems, strict=True)]
        )
        own = rows[:, :2] * (1, -1)
        moves.append(-np.linalg.solve(products(own), product(own.T, c * rows[:, 2:])))
    return np.swapaxes(moves, 0, 1).reshape(2 * len(seen), -1)

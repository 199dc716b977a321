"""Elastic gears by squared periods and damping ratios of their resonances.

Deflections are proportional to compliance, and rigid gears are at its zero. So a stiffness k is
searched as the squared period 1 / omega^2 = m / k. Here m is the link's inertia at a pose, D_ii
less the rotor's. A damping is searched as the logarithm of its resonance's damping ratio. A log
says little of damping, so each ratio has a prior, 0.5 to 5 % with 95 % probability, that weighs
like one more measurement.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import NORMAL
from identification.replay.gauss_newton import variance_inflation
from identification.replay.prediction import Prediction
from identification.replay.residual import Reparametrised, WithPrior
from plant import Dynamics, Elasticity, Record, Rig
from plant.parts import Floats, dot, frozen_settings

STIFFNESS = "drive.elasticity.stiffness"
DAMPING = "drive.elasticity.damping"


@frozen_settings
class ResonanceSettings:
    """Where resonances are searched, and with which steps; chosen by hand.

    Parameters
    ----------
    usual_damping : (float, float)
        Damping ratios between which 95 % of all gears are expected.
    resonances : (float, float)
        Bounds of the search [Hz]; a gear at the upper one is as good as rigid.
    damping : (float, float)
        Bounds of the damping ratio.
    least_step : float
        Least step of a squared period [s^2]: 0.8 % of that of 100 Hz.
    step : float
        Step of a squared period, relative.
    damping_step : float
        Step of the logarithm of a damping ratio.
    unstated : float
        Resonance [Hz] of the placeholder gears where the rig states none: a rotor's, on its gear.
    difference : float
        Relative step of the derivative of values by coordinates.
    """

    usual_damping: tuple[float, float] = (0.005, 0.05)
    resonances: tuple[float, float] = (4.0, 1000.0)
    damping: tuple[float, float] = (1e-3, 0.5)
    least_step: float = 0.008 / (2 * np.pi * 100) ** 2
    step: float = 0.003
    damping_step: float = 0.05
    unstated: float = 60.0
    difference: float = 1e-6


SETTINGS = ResonanceSettings()

# By how much variances of coordinates exceed those from scatter and autocorrelation of the
# innovations: rounding is no noise, it comes and goes with the speed
# (tests/benchmarks/elastic_identification.py).
INFLATION = 2.5

# Noise to begin with: that of rounding alone [pulses].
_NOISE = (INFLATION / 12) ** 0.5

# Mean and standard deviation of the logarithm of a damping ratio.
_LOG_RATIO = float(np.log(SETTINGS.usual_damping).mean())
_SPREAD = float(np.diff(np.log(SETTINGS.usual_damping))[0]) / 2 / NORMAL


def link_inertia(dynamics: Dynamics, rig: Rig, pose: ArrayLike) -> tuple[Floats, Floats]:
    """(A, rotors), (n, p) and (n,), of the inertia A f - rotors behind each gear [kg m^2].

    At a pose, with the other joints held.
    """
    # D is linear in f, and so is its diagonal on the shafts.
    f = ca.SX.sym("f", dynamics.p)
    inertia = ca.diag(dynamics.chain.coupling.shaft_inertia(dynamics.D(np.asarray(pose), f)))
    return ca.DM(ca.jacobian(inertia, f)).full(), rig.drive.reflected_inertia()


def on_gears(record: Record) -> Record:
    """The record on elastic gears, whose numbers are placeholders where its rig states none."""
    rig = record.rig
    rotors = rig.drive.reflected_inertia()
    if rig.drive.elasticity is not None:
        return record
    if not rotors.all():
        raise ValueError(
            "elastic gears need motors that weigh something; drive.motor_inertia is 0. Give it."
        )
    # Their numbers are not used before they are fitted, but a rig must have some.
    omega = 2 * np.pi * SETTINGS.unstated
    elasticity = Elasticity(
        stiffness=rotors * omega**2, damping=2 * np.exp(_LOG_RATIO) * rotors * omega
    )
    drive = replace(rig.drive, elasticity=elasticity)
    return replace(record, rig=replace(rig, drive=drive))


class Start(NamedTuple):
    """Where a search begins.

    `coordinates`, `steps` (k,): steps of central differences, zero where a coordinate is not
    varied. `bounds` (k, 2).
    """

    coordinates: Floats
    steps: Floats
    bounds: Floats


class Resonances(WithPrior):
    """A `Prediction` in coordinates of resonances, with expected damping ratios behind it.

    `rig`: with elasticity; its numbers that are not unknown stay. `pose` (n,): at which the
    resonances are meant [rad]. `fixed`: unknowns that stay as they are, in values. `measured` (2,
    n): compliances on the shafts and their standard deviations [rad/(N m)], where link sensors gave
    them; NaN of joints without one.

    Attributes: `stiffness`, `damping`: joint -> place of its coordinate. `noise`: factor of the
    expected values' rows, so that all rows have one variance; see `settle`.
    """

    def __init__(
        self,
        prediction: Prediction,
        dynamics: Dynamics,
        rig: Rig,
        pose: ArrayLike,
        fixed: Iterable[str] = (),
        measured: ArrayLike | None = None,
    ) -> None:
        self.prediction = prediction
        names = prediction.unknown
        self._elasticity = rig.drive.elasticity
        self._f = [names.index(name) for name in dynamics.names]
        self._slope, self._rotors = link_inertia(dynamics, rig, pose)
        searched = set(names) - set(fixed)
        joints = range(dynamics.n)
        # A gear with a fixed number has no coordinate: its value is that of the rig.
        self.stiffness, self.damping = (
            {i: names.index(f"{field}[{i}]") for i in joints if f"{field}[{i}]" in searched}
            for field in (STIFFNESS, DAMPING)
        )
        # Rows: compliance and its standard deviation, of each joint.
        compliances = np.full((dynamics.n, 2), np.nan)
        if measured is not None:
            compliances = np.transpose(measured)
        self._measured = {
            place: compliances[i].tolist()
            for i, place in self.stiffness.items()
            if np.isfinite(compliances[i]).all()
        }
        super().__init__(
            Reparametrised(prediction, names, self.values),
            self._deviations,
            len(self.damping) + len(self._measured),
            _NOISE,
        )

    def _deviations(self, coordinates):
        """Standardised deviations of damping ratios and of measured compliances.

        Damping ratios from the expected ones, compliances from the measured ones.
        """
        deviations = [
            (coordinates[place] - _LOG_RATIO) / _SPREAD for place in self.damping.values()
        ]
        if self._measured:
            values = self.values(coordinates)
            for place, (compliance, std) in self._measured.items():
                # The link sensors measured compliances: a stiffness is compared by its inverse.
                deviations.append((1 / values[place] - compliance) / std)
        return np.array(deviations)

    # -- coordinates ------------------------------------------------------------------------------
    def resonances(self, coordinates: Floats) -> tuple[Floats, Floats]:
        """Frequency [Hz] and damping ratio (n,) of each gear."""
        values = self.values(coordinates)
        m = self.inertia(coordinates)
        stiffness = self._stiffness(values)
        damping = np.array(self._elasticity.damping)
        for i, place in self.damping.items():
            damping[i] = values[place]
        return np.sqrt(stiffness / m) / (2 * np.pi), damping / (2 * np.sqrt(m * stiffness))

    def inertia(self, vector: Floats) -> Floats:
        """Inertia (n,) behind each gear, of values or coordinates."""
        return self._slope @ vector[self._f] - self._rotors

    def values(self, coordinates: Floats) -> Floats:
        """Values (k,) of the unknowns at coordinates (k,).

        NaN where no link is left behind a gear, or no compliance in it.
        """
        values = coordinates.copy()
        m = self.inertia(coordinates)
        m = np.where(m > 0, m, np.nan)
        # Stiffness first: a damping ratio is relative to it.
        for i, place in self.stiffness.items():
            values[place] = m[i] / coordinates[place] if coordinates[place] > 0 else np.nan
        for i, place in self.damping.items():
            # Damping of a damping ratio zeta = exp(z): d = 2 zeta sqrt(k m).
            values[place] = (
                2 * np.exp(coordinates[place]) * np.sqrt(m[i] * self._stiffness(values)[i])
            )
        return values

    def start(self, values: Floats, step: Floats, bounds: Floats) -> Start:
        """Coordinates, steps and bounds (k, 2) from those of values.

        Damping starts at the expected ratio. Bounds of stiffness and damping become those of
        resonances by the links of this start; they hold for no other links.

        Raises
        ------
        ValueError
            A range of stiffness lies wholly outside the resonances that are searched.
        """
        z = values.copy()
        steps = step.copy()
        bounds = bounds.copy()
        m = self.inertia(values)
        stiffness = self._stiffness(values)
        places = [*self.stiffness.values(), *self.damping.values()]
        bounds[places] = np.maximum(bounds[places], 0.0)
        # A stiffness without bounds has zero and infinity, whose inverses are meant.
        with np.errstate(divide="ignore", invalid="ignore"):
            for i, place in self.stiffness.items():
                given = bounds[place].copy()
                squared = (1 / (2 * np.pi * np.array(SETTINGS.resonances[::-1]))) ** 2
                bounds[place] = np.clip(m[i] / given[::-1], *squared)
                # A start that leaves no link there is none: it does not follow the log.
                if m[i] > 0 and not bounds[place, 0] < bounds[place, 1]:
                    low, high = SETTINGS.resonances
                    hz = np.sqrt(given / m[i]) / (2 * np.pi)
                    raise ValueError(
                        f"the range of {self.unknown[place]} must hold resonances from {low:g} to"
                        f" {high:g} Hz; {given[0]:g} to {given[1]:g} N m/rad is {hz[0]:.3g} to"
                        f" {hz[1]:.3g} Hz. Check its unit, or leave such a gear rigid."
                    )
                z[place] = np.clip(m[i] / values[place], *bounds[place])
                steps[place] = max(SETTINGS.least_step, SETTINGS.step * z[place])
                stiffness[i] = np.clip(values[place], *(m[i] / bounds[place, ::-1]))
            # Critical damping, 2 sqrt(k m), of the gears that the search begins with.
            critical = 2 * np.sqrt(np.maximum(m, 0) * stiffness)
            for i, place in self.damping.items():
                ends = np.log(bounds[place] / critical[i])
                bounds[place] = np.clip(ends, *np.log(SETTINGS.damping))
                # A range beyond the usual ratios counts as it is: equal ends would leave no step.
                if not bounds[place, 0] < bounds[place, 1]:
                    bounds[place] = ends
                z[place] = np.clip(_LOG_RATIO, *bounds[place])
                steps[place] = SETTINGS.damping_step
        return Start(z, steps, bounds)

    def slopes(self, coordinates: Floats) -> Floats:
        """Derivative (k, k) of the values by the coordinates."""
        # Steps are relative to the coordinate, or to 1 where it is zero.
        steps = SETTINGS.difference * np.maximum(
            np.abs(coordinates), np.where(coordinates == 0, 1.0, 0.0)
        )
        moved = [
            (self.values(coordinates + row), self.values(coordinates - row))
            for row in np.diag(steps)
        ]
        return np.column_stack(
            [(up - down) / (2 * step) for (up, down), step in zip(moved, steps, strict=True)]
        )

    def _stiffness(self, values):
        """Stiffness (n,), with what is unknown of it."""
        # Of the rig, where a gear is not searched.
        stiffness = np.array(self._elasticity.stiffness)
        for i, place in self.stiffness.items():
            stiffness[i] = values[place]
        return stiffness

    # -- weights ----------------------------------------------------------------------------------
    def reweigh(self, coordinates: Floats) -> bool:
        """As `Prediction.reweigh`."""
        # Other weights give other innovations, and the expected values must vary as much as these.
        changed = super().reweigh(coordinates)
        if changed:
            self.settle(coordinates)
        return changed

    def settle(self, coordinates: Floats) -> float:
        """Set the noise of the expected values' rows to that of the innovations.

        Return its variance.
        """
        # The innovations alone: deviations from expected values are no noise.
        rows = self.innovations(coordinates)
        innovations = rows[: len(rows) - self.count]
        readings = dot(self.weights, self.weights)
        variance = (
            dot(innovations, innovations) / readings * variance_inflation(innovations) * INFLATION
        )
        self.noise = float(np.sqrt(variance))
        return float(variance)

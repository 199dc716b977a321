"""Elastic gears in coordinates that a search can move in: squared periods and damping ratios of
their resonances.

Deflections are proportional to compliance, and rigid gears are at its zero; so each stiffness k is
searched as 1 / omega^2 = m / k, the compliance times the link's inertia m (D_ii less the rotor's)
at a pose, and each damping as the logarithm of the damping ratio of that resonance. A log says
little of damping: a ratio of 0.5 to 5 % is expected (95 %), which weighs like one more measurement.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.least_squares import NORMAL
from identification.replay.gauss_newton import variance_inflation
from identification.replay.prediction import Prediction
from plant import Dynamics, Elasticity, Record, Rig
from plant.compiler.background import shared_out
from plant.parts.fields import Floats
from plant.parts.sums import dot

STIFFNESS = "drive.elasticity.stiffness"
DAMPING = "drive.elasticity.damping"

_EXPECTED = (0.005, 0.05)  # damping ratios between which 95 % of all gears are expected

_USUAL = float(np.log(_EXPECTED).mean())
_SPREAD = float(np.diff(np.log(_EXPECTED))[0]) / 2 / NORMAL

# Resonances [Hz] and damping ratios between which a search stays; the last resonance is as good as
# rigid.
_BETWEEN = (4.0, 1000.0)
_RATIOS = (1e-3, 0.5)

# Steps of central differences: of a squared period at least [s^2], and relative; of ln of a damping
# ratio.
_SHORT = 0.008 / (2 * np.pi * 100) ** 2
_FINE = 0.003
_RATIO = 0.05

_ANY = 60.0  # resonance of a rotor on its gear that stands for one that is not known yet [Hz]

# By how much variances of coordinates exceed those from scatter and autocorrelation of the
# innovations: rounding is no noise, it comes and goes with the speed
# (tests/benchmarks/elastic_identification.py).
INFLATION = 2.5

_ROUNDING = (INFLATION / 12) ** 0.5  # noise to begin with: that of rounding alone [pulses]

_DIFFERENCE = 1e-6  # relative step of the derivative of values by coordinates


def link_inertia(dynamics: Dynamics, rig: Rig, pose: ArrayLike) -> tuple[Floats, Floats]:
    """(A, rotors), (n, p) and (n,): A f - rotors is the inertia behind each gear at a pose,
    others held [kg m^2].
    """
    f = ca.SX.sym("f", dynamics.p)
    own = ca.diag(dynamics.chain.coupling.shaft_inertia(dynamics.D(np.asarray(pose), f)))
    return ca.DM(ca.jacobian(own, f)).full(), rig.drive.reflected_inertia()


def on_gears(record: Record) -> Record:
    """The same record on elastic gears, where its rig says nothing of them; their numbers say
    nothing yet.
    """
    rig = record.rig
    rotors = record.rig.drive.reflected_inertia()
    if rig.drive.elasticity is not None:
        return record
    if not rotors.all():
        raise ValueError(
            "elastic gears need motors that weigh something; drive.motor_inertia is 0. Give it."
        )
    omega = 2 * np.pi * _ANY
    elasticity = Elasticity(
        stiffness=rotors * omega**2, damping=2 * np.exp(_USUAL) * rotors * omega
    )
    drive = dataclasses.replace(rig.drive, elasticity=elasticity)
    return dataclasses.replace(record, rig=dataclasses.replace(rig, drive=drive))


class Start(NamedTuple):
    """Where a search begins.

    `coordinates`, `steps` (k,): steps of central differences, zero where a coordinate is not
    varied. `bounds` (k, 2).
    """

    coordinates: Floats
    steps: Floats
    bounds: Floats


class Resonances:
    """A `Prediction` in coordinates of resonances, as `gauss_newton` takes it.

    `rig`: with elasticity; what is not unknown of it is as here. `pose` (n,): at which the
    resonances are meant [rad]. `kept`: unknowns that stay as they are, in values. `measured` (2,
    n): compliances on the shafts and their standard deviations [rad/(N m)], where link sensors gave
    them; NaN of joints without one.

    Attributes: `stiffness`, `damping`: joint -> place of its coordinate. `noise`: by which what is
    known beside the innovations is weighed, so that all are of one variance; see `settle`.
    """

    def __init__(
        self,
        prediction: Prediction,
        dynamics: Dynamics,
        rig: Rig,
        pose: ArrayLike,
        kept: Iterable[str] = (),
        measured: ArrayLike | None = None,
    ) -> None:
        self.prediction = prediction
        self.unknown = prediction.unknown
        self._elasticity = rig.drive.elasticity
        self._f = [self.unknown.index(name) for name in dynamics.names]
        self._slope, self._rotors = link_inertia(dynamics, rig, pose)
        searched = [name for name in self.unknown if name not in set(kept)]
        places = {name: self.unknown.index(name) for name in searched}
        self.stiffness, self.damping = (
            {i: places[f"{field}[{i}]"] for i in range(dynamics.n) if f"{field}[{i}]" in places}
            for field in (STIFFNESS, DAMPING)
        )
        self.noise = _ROUNDING
        self.dependent = prediction.dependent
        told = np.full((dynamics.n, 2), np.nan) if measured is None else np.transpose(measured)
        self._measured = {
            place: told[i].tolist()
            for i, place in self.stiffness.items()
            if np.isfinite(told[i]).all()
        }

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
        """Values (k,) of the unknowns; NaN where no link is left behind a gear, or no compliance
        in it.
        """
        values = coordinates.copy()
        m = self.inertia(coordinates)
        m = np.where(m > 0, m, np.nan)
        for i, place in self.stiffness.items():
            values[place] = m[i] / coordinates[place] if coordinates[place] > 0 else np.nan
        for i, place in self.damping.items():
            values[place] = (
                2 * np.exp(coordinates[place]) * np.sqrt(m[i] * self._stiffness(values)[i])
            )
        return values

    def start(self, values: Floats, step: Floats, bounds: Floats) -> Start:
        """Coordinates, steps and bounds (k, 2) of those of values; damping starts at what is
        expected.
        """
        z = values.copy()
        steps = step.copy()
        bounds = bounds.copy()
        m = self.inertia(values)
        root = 2 * np.sqrt(np.maximum(m, 0) * self._stiffness(values))
        places = [*self.stiffness.values(), *self.damping.values()]
        bounds[places] = np.maximum(bounds[places], 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            for i, place in self.stiffness.items():
                squared = (1 / (2 * np.pi * np.array(_BETWEEN[::-1]))) ** 2
                bounds[place] = np.clip(m[i] / bounds[place, ::-1], *squared)
                z[place] = np.clip(m[i] / values[place], *bounds[place])
                steps[place] = max(_SHORT, _FINE * z[place])
            for i, place in self.damping.items():
                bounds[place] = np.clip(np.log(bounds[place] / root[i]), *np.log(_RATIOS))
                z[place] = np.clip(_USUAL, *bounds[place])
                steps[place] = _RATIO
        return Start(z, steps, bounds)

    def slopes(self, coordinates: Floats) -> Floats:
        """Derivative (k, k) of the values by the coordinates."""
        steps = _DIFFERENCE * np.maximum(np.abs(coordinates), np.where(coordinates == 0, 1.0, 0.0))
        moved = [
            (self.values(coordinates + row), self.values(coordinates - row))
            for row in np.diag(steps)
        ]
        return np.column_stack(
            [(up - down) / (2 * step) for (up, down), step in zip(moved, steps, strict=True)]
        )

    def _stiffness(self, values: Floats) -> Floats:
        """Stiffness (n,), with what is unknown of it."""
        stiffness = np.array(self._elasticity.stiffness)
        for i, place in self.stiffness.items():
            stiffness[i] = values[place]
        return stiffness

    # -- what gauss_newton asks for ---------------------------------------------------------------
    @property
    def weights(self) -> Floats:
        """Weight of each innovation; of what is expected, none: it is no reading."""
        return np.append(self.prediction.weights, np.zeros(self._more))

    @property
    def scales(self) -> Floats:
        """What each innovation is divided by."""
        return np.append(self.prediction.scales, np.ones(self._more))

    @property
    def _more(self) -> int:
        """What is known beside the innovations."""
        return len(self.damping) + len(self._measured)

    def innovations(self, coordinates: Floats) -> Floats:
        """Innovations, and after them how far damping ratios are from what is expected,
        compliances from measured.
        """
        values = self.values(coordinates)
        if not np.isfinite(values).all():
            return np.full(len(self.weights), np.inf)
        known = [(coordinates[place] - _USUAL) / _SPREAD for place in self.damping.values()]
        known += [
            (1 / values[place] - compliance) / std
            for place, (compliance, std) in self._measured.items()
        ]
        return np.append(self.prediction.innovations(values), self.noise * np.array(known))

    def lost(self, coordinates: Floats) -> str:
        """What messages call the first record whose run with these coordinates diverges."""
        return self.prediction.lost(self.values(coordinates))

    def all_innovations(self, many: Iterable[Floats]) -> list[Any]:
        """The same for several vectors, side by side."""
        return shared_out(self.innovations, list(many), self.prediction.threads)

    def reweigh(self, coordinates: Floats) -> bool:
        """As `Prediction.reweigh`."""
        changed = self.prediction.reweigh(self.values(coordinates))
        if changed:
            self.settle(coordinates)
        return changed

    def settle(self, coordinates: Floats) -> float:
        """Weigh what is known by what innovations scatter, and give their variance as it counts
        for coordinates.
        """
        residual = self.innovations(coordinates)
        readings = dot(self.weights, self.weights)
        innovations = residual[: len(residual) - self._more]
        variance = (
            dot(innovations, innovations) / readings * variance_inflation(innovations) * INFLATION
        )
        self.noise = float(np.sqrt(variance))
        return float(variance)

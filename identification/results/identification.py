"""What an identification found, how, and how well it knows it."""

from __future__ import annotations

import dataclasses

import numpy as np

from identification.planning.budget import pulse_budget
from identification.results.plots import plot_identification
from identification.results.trust import warnings_of
from identification.search.genetic import GeneticSettings
from plant import Arm, Law, Rig
from plant.parts.frozen import Frozen

__all__ = ["Identification"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Identification(Frozen):
    """What was found, and how.

    Attributes
    ----------
    method : str
    arm : Arm
        The arm with the best f; D-hat and h-hat of a computed-torque controller.
    rig, law : Rig, Law
        Those of the (first) record, with whatever else was unknown filled in.
    f : (p,) numpy.ndarray
    unknown : tuple of str
        Names of what was searched; `values` (k,) are what was found for them.
    candidates : (C, k) numpy.ndarray
        Vectors that repeat the records as well as the values do, but for the noise of objective (4), best first; the
        values alone where a method tries no others. ``certify(..., plants=...)`` takes them for want of a covariance.
    covariance : (k, k) numpy.ndarray or None
        Of the values; None for a method that does not know it. Quantisation and what the model lacks show in the
        scatter from which it is made, and the memory of that scatter is counted.
    scatter : float or None
        Root mean square of what is left between model and counts, every sample predicted from those before (the
        *surprise*) [pulses]; rounding alone gives 0.289.
    trouble : str or None
        Why the values are not those of the last fit; then nothing is known of their uncertainty.
    ranges : (k, 2) numpy.ndarray or None
        Those that were given.
    stages : dict
        What each stage before the last found: name -> (k,) values.
    zeros : (R, n) numpy.ndarray or None
        Where the joints of each record are when its counters say zero [rad], if that was unknown.
    bands : dict
        Of logged torques: pass band [Hz] -> mean share that least squares in that band finds of f, each counted by how
        well that fit knows it.
    delay, delay_std : float
        By how many samples the counts are read late, against a simulation with what was found, and its deviation.
    records, held_out : tuple of Record
        Those that were searched, and those that were kept aside.
    difference, held_out_difference : float, float or None
        Root mean square, per sample and joint, between the errors measured and simulated with what was found [pulses]:
        in the records, and in those kept aside. Two roundings alone give 0.58.
    objective, initial_objective : float
        Objective (4) of the best candidate, at the end and in the first generation [pulses^2].
    initial_population : (P, k) numpy.ndarray
    initial_costs : (P,) numpy.ndarray
        Objective (4) of each of them, inf where it cannot be an arm or diverges.
    history : (generations + 1, 3) numpy.ndarray
        Best, mean and worst finite objective of each generation.
    evaluations : int
    seconds : float
    seed : int
    settings : GeneticSettings
    version : str
        Of the library.
    message : str
        Why the search ended.
    """

    method: str
    arm: Arm
    rig: Rig
    law: Law
    f: np.ndarray
    unknown: tuple
    values: np.ndarray
    candidates: np.ndarray
    covariance: np.ndarray | None
    scatter: float | None
    trouble: str | None
    ranges: np.ndarray | None
    stages: dict
    zeros: np.ndarray | None
    bands: dict
    delay: float
    delay_std: float
    records: tuple
    held_out: tuple
    difference: float
    held_out_difference: float | None
    objective: float
    initial_objective: float
    initial_population: np.ndarray
    initial_costs: np.ndarray
    history: np.ndarray
    evaluations: int
    seconds: float
    seed: int
    settings: GeneticSettings
    version: str
    message: str

    @property
    def std(self):
        """Standard deviations (k,) of the values."""
        if self.covariance is None:
            why = f"method {self.method!r}" if self.trouble is None else "this fit"
            raise ValueError(
                f"{why} does not know how well it knows; {self.trouble or 'use the default for an interval'}."
            )
        return np.sqrt(np.diag(self.covariance))

    def bound(self):
        """Smallest standard deviations (k,) that rounding at the samples allows any method on the first record.

        Cramer-Rao's bound from simulated sensitivities (`pulse_budget`); of what was kept fixed, zero.

        Raises
        ------
        ValueError
            A record without reference.
        """
        record = self.records[0]
        if record.reference is None:
            raise ValueError("the record must have a reference for a bound; it has none. Pass reference= with the log.")
        seconds = len(record) * record.rig.period
        budget = pulse_budget(self.arm, self.rig, self.law, record.reference, unknown=self.unknown, duration=seconds)
        return np.where(self.std > 0, budget.bound, 0.0)

    @property
    def correlation(self):
        """Correlations (k, k) of the values; of what was kept fixed, zero."""
        std = np.where(self.std > 0, self.std, np.inf)
        return self.covariance / np.outer(std, std)

    @property
    def warnings(self):
        """What a user should know before trusting the values, one line each; see `identification.results.trust`."""
        return warnings_of(self)

    def summary(self):
        """A table: each value, its standard deviation, the bound, its 95 % interval, what it goes with most."""
        width = max(map(len, self.unknown))
        lines = [f"{self.method}, {len(self.records)} record(s): {self.message}"]
        if self.covariance is None:
            lines += [f"{name:<{width}} {value:12.5g}" for name, value in zip(self.unknown, self.values, strict=True)]
        else:
            try:
                bounds = self.bound()
            except ValueError:  # no reference, or numbers that cannot be told apart
                bounds = np.full(len(self.values), np.nan)
            known = np.isfinite(bounds).all()
            head = f"{'value':>12} {'std':>9} {'bound' if known else '':>{9 * known}} {'95 % interval':>25}"
            lines.append(f"{'':<{width}} {head}   goes most with")
            others = self.correlation - np.eye(len(self.values))
            rows = zip(self.unknown, self.values, self.std, bounds, strict=True)
            for i, (name, value, std, bound) in enumerate(rows):
                if not std > 0:
                    lines.append(f"{name:<{width}} {value:12.5g}     known")
                    continue
                most = int(np.argmax(np.abs(others[i])))
                interval = f"[{value - 1.96 * std:.5g}, {value + 1.96 * std:.5g}]"
                together = f"{self.unknown[most]} ({others[i, most]:+.2f})"
                least = f"{bound:9.2g}" if known else ""
                lines.append(f"{name:<{width}} {value:12.5g} {std:9.2g} {least} {interval:>25}   {together}")
        lines.append(f"simulated and measured errors differ by {self.difference:.2f} pulses (rms)")
        if self.held_out_difference is not None:
            lines[-1] += f", in the record(s) kept aside by {self.held_out_difference:.2f}"
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])

    def plot(self):
        """Draw fit, surprises, spectrum and intervals; see `identification.results.plots.plot_identification`."""
        return plot_identification(self)

    def __repr__(self):
        f = np.array2string(self.f, precision=3, suppress_small=True)
        return (
            f"Identification(f={f}, objective {self.initial_objective:.0f} -> {self.objective:.0f} pulses^2, "
            f"{self.evaluations} evaluations in {self.seconds:.1f} s)"
        )

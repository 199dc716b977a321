"""The verdict: does the arm stay within so many encoder pulses of its path, and what does it cost in torque?"""

from __future__ import annotations

import dataclasses
import math
from numbers import Real

import numpy as np

from ctc.figures import plot_evaluation
from plant import Record
from plant.parts.arguments import choice, known_options
from plant.simulation.simulator import run

__all__ = ["Evaluation", "evaluate"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Evaluation:
    """How well an arm followed a reference under a law.

    Attributes
    ----------
    joints : tuple of str
        Names of the joints, those of the links that they move.
    record : Record
        The run, sample by sample.
    true_error_pulses : (N steps_per_sample, n) numpy.ndarray
        Reference minus joint, unrounded, at every sub-step [pulses].
    max_error_pulses : (n,) numpy.ndarray
        Largest integer encoder error, magnitude.
    max_true_error_pulses : (n,) numpy.ndarray
        Largest error of the joint itself, at every sub-step, magnitude [pulses].
    rms_error_pulses : (n,) numpy.ndarray
        Of the integer encoder error.
    peak_torque : (n,) numpy.ndarray
        Joint side, magnitude [N m].
    rms_torque : (n,) numpy.ndarray
        Joint side [N m].
    chatter : (n,) numpy.ndarray
        Mean change of the torque from one sample to the next, magnitude [N m].
    saturation : (n,) numpy.ndarray
        Share of the samples at the amplifier's limit.
    """

    joints: tuple
    record: Record
    true_error_pulses: np.ndarray

    @property
    def max_error_pulses(self):
        return np.abs(self.record.error_pulses).max(axis=0)

    @property
    def max_true_error_pulses(self):
        return np.abs(self.true_error_pulses).max(axis=0)

    @property
    def rms_error_pulses(self):
        return np.sqrt(np.mean(self.record.error_pulses**2, axis=0))

    @property
    def peak_torque(self):
        return np.abs(self.record.torque).max(axis=0)

    @property
    def rms_torque(self):
        return np.sqrt(np.mean(self.record.torque**2, axis=0))

    @property
    def chatter(self):
        return np.abs(np.diff(self.record.torque, axis=0)).mean(axis=0)

    @property
    def saturation(self):
        limit = self.record.rig.drive.current_limit
        return (np.abs(self.record.current) >= limit * (1 - 1e-12)).mean(axis=0)

    def fraction_within(self, k):
        """Share of the samples at which every joint's encoder error is within +-k pulses."""
        if not isinstance(k, Real) or not k >= 0:
            raise ValueError(f"k must be a number of pulses, 0 or more; got {k!r}. The promise is 1.")
        return float((np.abs(self.record.error_pulses) <= k).all(axis=1).mean())

    def share_within(self, k):
        """`fraction_within` as text, rounded down, so that 100.00% means all samples."""
        return f"{math.floor(self.fraction_within(k) * 1e4 + 1e-9) / 100:.2f}%"

    def within(self, k):
        """Whether every joint's encoder error is within +-k pulses at every sample."""
        return self.fraction_within(k) == 1.0

    def plot(self, axes=None):
        """Draw error and torque of every joint; see `ctc.figures.plot_evaluation`."""
        return plot_evaluation(self, axes)

    def __str__(self):
        def row(name, values, form):
            return f"{name:<34}" + "".join(f"{value:>12{form}}" for value in values)

        lines = [
            f"{type(self.record.law).__name__}: {self.share_within(1)} of {len(self.record)} samples within +-1 pulse",
            row("", [f"joint {name}" for name in self.joints], ""),
            row("encoder error, peak [pulses]", self.max_error_pulses, ".0f"),
            row("encoder error, RMS [pulses]", self.rms_error_pulses, ".2f"),
            row("true joint error, peak [pulses]", self.max_true_error_pulses, ".2f"),
            row("torque, peak [N m]", self.peak_torque, ".0f"),
            row("torque chatter per sample [N m]", self.chatter, ".1f"),
            row("share at the amplifier's limit", self.saturation, ".2%"),
        ]
        return "\n".join(lines)


@known_options
def evaluate(arm, rig, law, reference, *, backend="casadi", duration=None, steps_per_sample=16, initial=None):
    """Run an arm under a law and judge the tracking in encoder pulses.

    Parameters
    ----------
    arm : Arm
        The true arm, as far as anyone knows it.
    rig : Rig
    law : Law
    reference : Reference
    backend : {"casadi", "numba"}
        casadi evaluates the closed-loop step by `mapaccum`; the compiled kernel must give the same verdict.
    duration : float, optional
        [s]; by default one period of the reference.
    steps_per_sample : int
        Integration steps between two samples.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.

    Returns
    -------
    Evaluation
        Print it for a table; ``.within(1)`` is the verdict.

    Raises
    ------
    ValueError
        Bad input, or a loop that diverges.
    """
    choice("backend", backend, ("casadi", "numba"))
    trace = run(arm, rig, law, reference, duration, steps_per_sample, initial, backend)
    joints = tuple(link.name for link in arm.dynamics.chain.links)
    return Evaluation(joints=joints, record=trace.record, true_error_pulses=trace.true_error_pulses)

"""What was found when many possible plants were run: how many leave, how bad the worst is, and what makes it.

The bound on their share is exact (Clopper and Pearson), whatever the errors' distribution.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from ctc.certification.binomial import clopper_pearson
from ctc.certification.figure import plot_certificate
from ctc.certification.plants import Plants
from ctc.certification.population import Runs
from ctc.certification.reserves import reserves
from ctc.certification.sensitivity import influences
from plant import Arm, Law, Reference, Rig
from plant.parts.arguments import known_options
from plant.simulation.loop_kernel import LANES

__all__ = ["Certificate", "Worst"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Worst:
    """The plant with the largest error: ``evaluate(worst.arm, worst.rig, law, reference)`` runs it again.

    Attributes
    ----------
    arm, rig : Arm, Rig
        With load, friction, phase, delay and lost samples.
    peak : float
        Largest counted error [pulses]; inf if the loop diverged.
    index : int
        Which of the plants it is.
    values : dict
        What was drawn for it.
    """

    arm: Arm
    rig: Rig
    peak: float
    index: int
    values: dict


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Certificate:
    """How many of the plants that are possible leave the limit under a law, and why. Print it for a table.

    Attributes
    ----------
    law : Law
    reference : Reference
    plants : Plants
        What was drawn.
    runs : Runs
        What became of each: ``peak``, ``unrounded``, ``outside``, ``current``, ``first``.
    within : float
        Limit [pulses].
    confidence : float
    settings : dict
        ``steps_per_sample``, ``duration`` and ``after``.
    threads : int
    seconds : float
        That the runs took.
    """

    law: Law
    reference: Reference
    plants: Plants
    runs: Runs
    within: float
    confidence: float
    settings: dict
    threads: int
    seconds: float

    @property
    def failures(self):
        """How many of the loops left the limit at any sample, or diverged."""
        return int((self.runs.outside > 0).sum())

    @property
    def probability(self):
        """Share of the loops that left."""
        return self.failures / len(self.plants)

    @property
    def interval(self):
        """Two-sided interval (low, high) of that probability, at the confidence."""
        return clopper_pearson(self.failures, len(self.plants), self.confidence)

    @property
    def upper(self):
        """One-sided upper bound of that probability, at the confidence."""
        return clopper_pearson(self.failures, len(self.plants), 2 * self.confidence - 1)[1]

    @property
    def share_outside(self):
        """Share of all samples of all loops that are outside."""
        return float(self.runs.outside.mean() / self.runs.samples)

    @property
    def saturation(self):
        """Share of the loops that reach the amplifier's limit, (n,)."""
        limit = self.plants.rig.drive.current_limit
        return (np.isfinite(limit) & (self.runs.current >= limit * (1 - 1e-12))).mean(axis=0)

    @property
    def current_share(self):
        """Largest motor current of a loop as a share of the amplifier's limit, median of the loops, (n,)."""
        limit = self.plants.rig.drive.current_limit
        median = np.median(self.runs.current, axis=0)
        return np.divide(median, limit, out=np.zeros(len(limit)), where=np.isfinite(limit))

    @property
    def hurts(self):
        """Influence of all that was drawn on the peak error, the largest first (`ctc.certification.sensitivity`)."""
        names, values = self.plants.names, self.plants.values
        if self.plants.dropped:
            names, values = (*names, "lost samples"), np.column_stack([values, self.runs.lost])
        return influences(names, values, self.runs.unrounded.max(axis=1))

    @property
    def worst(self):
        """The plant with the largest counted error; among equals, with the largest before rounding."""
        peak, unrounded = self.runs.peak.max(axis=1), self.runs.unrounded.max(axis=1)
        return self.plant(int(np.lexsort((unrounded, peak))[-1]))

    def plant(self, index):
        """One of the plants, ready for `evaluate`.

        Returns
        -------
        Worst
        """
        if not isinstance(index, (int, np.integer)) or not 0 <= index < len(self.plants):
            raise ValueError(f"index must be a whole number from 0 to {len(self.plants) - 1}; got {index!r}.")
        arm, rig = self.plants.plant(index, LANES, self.settings["law_steps"])
        values = dict(zip(self.plants.names, self.plants.values[index].tolist(), strict=True))
        return Worst(arm=arm, rig=rig, peak=float(self.runs.peak[index].max()), index=index, values=values)

    @property
    def verdict(self):
        """One sentence."""
        count, limit = f"{len(self.plants):,} possible plants", f"±{self.within:g} pulse{'s' * (self.within != 1)}"
        sure = f"with {100 * self.confidence:g} % confidence"
        if not self.failures:
            return f"None of {count} leaves {limit}; {sure}, fewer than {_percent(self.upper, up=True)} of all would."
        share = _percent(self.probability)
        bound = _percent(self.upper, up=True)
        return f"{share} of {count} leave {limit} at some sample; {sure}, at most {bound} of all would."

    @known_options
    def margins(self, *, samples=400, allowed=0.0):
        """How far the law can be changed until more than a share `allowed` of the first `samples` plants leave.

        See `ctc.certification.reserves.reserves`, which this calls.
        """
        return reserves(self, samples, allowed)

    def plot(self):
        """Draw the verdict, the worst loop, and what hurts; see `ctc.certification.figure.plot_certificate`."""
        return plot_certificate(self)

    def __str__(self):
        worst, runs = self.worst, self.runs
        joints = [f"joint {link.name}" for link in self.plants.arm.dynamics.chain.links]

        def row(name, values):
            return f"{name:<42}" + "".join(f"{value:>12}" for value in values)

        low, high = self.interval
        lines = [
            f"{type(self.law).__name__}: {self.verdict}",
            row(
                f"probability, {100 * self.confidence:g} % interval", [f"{_percent(low)} to {_percent(high, up=True)}"]
            ),
            row("samples outside, share of all", [_percent(self.share_outside)]),
        ]
        if self.failures:
            lines.append(row("first left, median [s]", [f"{np.nanmedian(runs.first):.3f}"]))
        lines += [
            row("", joints),
            row("counted error, worst peak [pulses]", [f"{peak:.0f}" for peak in runs.peak.max(axis=0)]),
            *(
                row(f"error before rounding, {name} peak [pulses]", [f"{v:.2f}" for v in values])
                for name, values in (
                    ("median", np.median(runs.unrounded, axis=0)),
                    ("99 %", np.quantile(runs.unrounded, 0.99, axis=0, method="higher")),
                )
            ),
            row("motor current, median peak / limit", [f"{share:.0%}" for share in self.current_share]),
            row("loops that reach the limit", [_percent(share) for share in self.saturation]),
            f"worst: plant {worst.index}, {f'{worst.peak:.0f} pulse(s)' if np.isfinite(worst.peak) else 'diverges'}",
            f"{'what hurts':<28}{'explains':>10}",
            *(f"{each.name:<28}{each.share:>10.0%}{each.sense:>14}".rstrip() for each in self.hurts[:5]),
        ]
        if self.plants.redrawn:
            lines.append(f"{self.plants.redrawn} draws could be no arm, and were drawn again")
        return "\n".join(lines)


def _percent(share, up=False):
    """A probability as text, with two digits that count, or three; a bound is rounded up."""
    percent = 100 * share
    if percent > 0:
        step = 10.0 ** min(math.floor(math.log10(percent)) - 1, -1)
        percent = step * (math.ceil(percent / step - 1e-9) if up else round(percent / step))
    return f"{percent:.3g} %"

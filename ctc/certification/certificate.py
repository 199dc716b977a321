"""`Certificate`: probability of exceeding a pulse limit on one path, and the worst sample."""

import dataclasses
import functools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.certified import Certified
from ctc.certification.figure import plot_certificate
from ctc.certification.plants import Plants, Worst
from ctc.certification.reserves import Reserves, held, reserves
from ctc.certification.statement import shown, verdict
from ctc.verdict import SETTLED, FromRest, LowestResonance, evaluate, from_rest, lowest_resonance
from identification.results import Seen
from plant import Law, Reference
from plant.machine import DAMPING_RATIO
from plant.parts import Piece, frozen, kept, known_options
from plant.simulation import LANES, DivergenceError, Runs


@kept
@frozen
class Certificate(Certified):
    """Probability of exceeding a pulse limit under parameter uncertainty. Print it for a table.

    Attributes
    ----------
    law : Law
    reference : Reference
    plants : Plants
        The Monte Carlo samples.
    runs : Runs
        Results of each: ``peak``, ``unrounded``, ``outside``, ``current``, ``first``.
    within : float
        Limit [pulses].
    confidence : float
    settings : dict
        Among others ``steps_per_sample``, ``duration``, ``after`` and ``law_steps``.
    threads : int
    seconds : float
        Duration of the runs.
    seen : Seen or None
        What the logs would show of gears and of friction, and where the path exceeds the logs;
        None for an arm that was not identified.
    rare : Rare or None
        Result of ``certify(..., rare=)``.
    versions : dict
        Of the library, numpy, casadi and Python that made it.

    See Also
    --------
    ctc.certify

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, Uncertainty, certify
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> law = ComputedTorque(arm, rig, bandwidth=150)
    >>> stated = Uncertainty(plants=[arm.f], friction=0.02)
    >>> path = puma560.reference()
    >>> certificate = certify(arm, rig, law, path, stated, samples=64, progress=False)
    >>> certificate.failures, certificate.upper < 0.1
    (0, True)
    """

    reference: Reference
    runs: Runs
    settings: dict[str, Any]
    seen: Seen | None = None

    # Cached properties are simulations that not every user needs: they run when they are read.

    @functools.cached_property
    def on_gears(self) -> LowestResonance | None:
        """Lowest resonance of elastic gears on which the nominal arm keeps the limit.

        None if the gears of the rig are elastic.

        Stated delay, lag and other imperfections are at the end of their ranges that is farther
        from zero.
        """
        if self.plants.rig.drive.elasticity is not None:
            return None
        # The lowest stated damping ratio: light damping is the harder case.
        ratio, _ = self.plants.uncertainty.damping_ratio or (DAMPING_RATIO, DAMPING_RATIO)
        # On elastic gears the start does not count, whatever `after` was on these rigid ones.
        begins = max(SETTLED, self.settings["after"])
        return lowest_resonance(*self._loop, float(ratio), begins, self.threads, None)

    @functools.cached_property
    def from_rest(self) -> FromRest | None:
        """Run of the nominal arm from rest along a path that begins in motion.

        None if the path begins at rest, or if the arm keeps the limit.
        """
        return from_rest(*self._loop)

    @functools.cached_property
    def by_counts(self) -> NDArray[np.float64]:
        """Largest unrounded error (n,) [pulses] of a plant with the controller's own f and start.

        The encoder's rounding causes this part of the error, and uncertain f causes the rest.
        The values are infinite if this loop diverges.
        """
        arm, rig, law, path, _, duration, steps = self._loop
        with warnings.catch_warnings():
            # Warnings about rig and path were given with the samples.
            warnings.simplefilter("ignore")
            try:
                # The controller's own model as the plant: no parameter error remains.
                evaluation = evaluate(
                    getattr(law, "arm", arm),
                    rig,
                    law,
                    path,
                    duration=duration,
                    steps_per_sample=steps,
                )
            except DivergenceError:
                return np.full(rig.n, np.inf)
        # The error has one row per sub-step. The margin keeps the sample at `after` in spite of
        # floating-point rounding.
        begins = steps * math.ceil(self.settings["after"] / rig.period - 1e-9)
        return np.asarray(np.abs(evaluation.true_error_pulses[begins:]).max(axis=0))

    @functools.cached_property
    def friction_known(self) -> float | None:
        """Share of samples that exceed the limit with friction identified from the log.

        It is a share of the first 400 samples, or of all if there are fewer. It is None if there is
        no log, or if no sampled friction is left to identify.
        """
        # An arm without a log has no deviations of friction.
        deviations = {} if self.seen is None else self.seen.friction
        plants = self.plants.first(None)
        columns = [i for i, name in enumerate(plants.names) if name in deviations]
        # Nothing to narrow: friction was identified, or is not sampled.
        if not columns:
            return None
        rig = plants.rig
        levels = rig.numbers()
        values = plants.values.copy()
        for i in columns:
            name = plants.names[i]
            level = levels[name]
            # The same samples, their deviation scaled to that of an identification; a log that
            # shows less than is stated narrows nothing.
            narrower = min(1.0, deviations[name] / (plants.uncertainty.friction * level))
            values[:, i] = level + narrower * (values[:, i] - level)
        runs = self.run(dataclasses.replace(plants, values=values))
        return float((runs.outside > 0).mean())

    def run(self, plants: Plants, law: Law | None = None) -> Runs:
        """Run other samples, or another controller, with the settings of this certificate."""
        # `settings` also has entries that are no options of a population.
        options = {name: self.settings[name] for name in ("steps_per_sample", "duration", "after")}
        law = self.law if law is None else law
        return plants.under(law, self.reference, within=self.within, **options).run(self.threads)

    @property
    def _loop(self) -> Any:
        """Arguments of the nominal loop, in the order of an `Evaluation`.

        They are arm, rig, law, reference, limit, duration [s] rounded up to whole periods, and
        steps per sample.
        """
        # Without the offsets that are sampled about zero: they belong to the samples.
        rig = self.plants.nominal
        samples = math.ceil(self.settings["duration"] / rig.period - 1e-9)
        return (
            self.plants.arm,
            rig,
            self.law,
            self.reference,
            self.within,
            samples * rig.period,
            self.settings["steps_per_sample"],
        )

    @property
    def holds(self) -> bool:
        """Whether all samples, and the nominal arm from rest, keep the limit, and `rare` is met.

        False if a sample exceeds the limit, if the nominal arm does so from rest, or if failures
        are more frequent than `rare` allows.
        """
        # The count of failures first: it is known, the run from rest is a simulation.
        return (
            self.failures == 0 and self.from_rest is None and (self.rare is None or self.rare.met)
        )

    @property
    def lowest_resonance(self) -> float | None:
        """Locked-rotor resonance [Hz] above which the nominal arm keeps the limit.

        See `on_gears`.
        """
        return None if self.on_gears is None else self.on_gears.hz

    @property
    def worst(self) -> Worst:
        """The sample with the largest encoder error.

        Among equal errors it is the sample with the largest error before rounding.
        """
        # Whole pulses tie often; the error before rounding decides among equals.
        peak = self.runs.peak.max(axis=1)
        unrounded = self.runs.unrounded.max(axis=1)
        return self.plant(int(np.lexsort((unrounded, peak))[-1]))

    def plant(self, index: int) -> Worst:
        """One of the samples, ready for `evaluate`."""
        # Lost counts are drawn by blocks of the kernel's width: the same are lost again.
        arm, rig = self.plants.plant(index, LANES, self.settings["law_steps"])
        values = dict(zip(self.plants.names, self.plants.values[index].tolist(), strict=True))
        return Worst(
            arm=arm,
            rig=rig,
            peak=float(self.runs.peak[index].max()),
            index=int(index),
            values=values,
        )

    @property
    def verdict(self) -> str:
        """Failures, bound, and the gears on which they hold: one sentence, two on rigid gears."""
        return verdict(self)

    @known_options
    def reserves(self, *, samples: int | None = None, allowed: float = 0.0) -> Reserves:
        """Lowest bandwidth and longest period at which at most a share `allowed` of samples fails.

        Only the first `samples` are run: by default 400, or all if there are fewer.
        """
        return reserves(self, samples, allowed)

    @known_options
    def from_hold(self, *, samples: int | None = None) -> Any:
        """Certificate of the first `samples` (by default 400, or all if fewer), begun from a hold.

        In a hold, the disturbance torque of the controller is the torque that its model lacks at
        rest, and static friction carries a share of each joint's Coulomb level, drawn uniformly
        from -1 to 1. Without a hold, samples begin as at the release of a brake, with no
        disturbance torque.

        Raises
        ------
        ValueError
            More samples than there are; a path that begins in motion; a controller without a
            disturbance torque.
        """
        return held(self, samples)

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw peak errors, errors of some loops and the worst, and sensitivities on (3,) Axes.

        A stated range of resonances adds a fourth Axes.
        """
        return plot_certificate(self, ax)

    def _shown(self) -> Iterator[Piece]:
        return shown(self)

"""Probability of exceeding a pulse limit on one path with its exact bounds, the worst sample,
and the sensitivities.
"""

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
from ctc.verdict.evaluations import evaluate
from ctc.verdict.on_gears import SETTLED, FromRest, LowestResonance, from_rest, lowest_resonance
from identification.results.seen import Seen
from plant import Law, Reference
from plant.machine.elasticity import DAMPING_RATIO
from plant.parts.arguments import known_options
from plant.parts.kinds import kept
from plant.parts.shown import Piece
from plant.simulation.logged_run import DivergenceError
from plant.simulation.loop_kernel import LANES
from plant.simulation.population import Runs

_FIRST = 400  # samples of which is said what identifying friction would give


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(Certified):
    """Probability of exceeding a pulse limit under parameter uncertainty, and why. Print it for a
    table.

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
        ``steps_per_sample``, ``duration`` and ``after``.
    threads : int
    seconds : float
        That the runs took.
    seen : Seen or None
        What the logs show of gears, and where the path exceeds it; None of an arm that was not
        identified.
    rare : Rare or None
        What ``certify(..., rare=)`` asked for.
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
    >>> law, stated = ComputedTorque(arm, rig, bandwidth=150), Uncertainty(plants=[arm.f], friction=0.02)
    >>> certificate = certify(arm, rig, law, puma560.reference(), stated, samples=64, progress=False)
    >>> certificate.failures, certificate.upper < 0.1
    (0, True)
    """

    reference: Reference
    runs: Runs
    settings: dict[str, Any]
    seen: Seen | None = None

    @functools.cached_property
    def on_gears(self) -> LowestResonance | None:
        """On which elastic gears the nominal arm stays within the limit; None where the gears are
        elastic already.

        Stated delay, lag and other imperfections are at that end of their ranges which is farther
        from zero.
        """
        if self.plants.rig.drive.elasticity is not None:
            return None
        ratio, _ = self.plants.uncertainty.damping_ratio or (0.0, 0.0)
        after = max(SETTLED, self.settings["after"])
        return lowest_resonance(
            *self._loop, float(ratio or DAMPING_RATIO), after, self.threads, None
        )

    @functools.cached_property
    def from_rest(self) -> FromRest | None:
        """What the nominal arm does from rest, where the path begins in motion and exceeds the
        limit.
        """
        return from_rest(*self._loop)

    @functools.cached_property
    def by_counts(self) -> NDArray[np.float64]:
        """Largest error before rounding (n,) [pulses] where f and start are the controller's own:
        what rounding adds by itself, to what an unknown f does. Infinite where that loop diverges.
        """
        arm, rig, law, path, _, duration, steps = self._loop
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it says of rig and path was said of the samples
            try:
                own = evaluate(
                    getattr(law, "arm", arm),
                    rig,
                    law,
                    path,
                    duration=duration,
                    steps_per_sample=steps,
                )
            except DivergenceError:
                return np.full(rig.n, np.inf)
        begins = steps * math.ceil(self.settings["after"] / rig.period - 1e-9)
        return np.asarray(np.abs(own.true_error_pulses[begins:]).max(axis=0))

    @functools.cached_property
    def friction_known(self) -> float | None:
        """Share of the first samples that exceed the limit where friction is known as the log would
        identify it.

        None where all that is sampled of it was identified, or no log is there.
        """
        known = {} if self.seen is None else self.seen.friction
        plants = self.plants.first(min(_FIRST, len(self.plants)))
        stated = dict(
            zip(plants.rig.number_names(), plants.rig.number_values().tolist(), strict=True)
        )
        values = plants.values.copy()
        those = [i for i, name in enumerate(plants.names) if name in known]
        for i in those:
            level = stated[plants.names[i]]
            left = known[plants.names[i]] / (plants.uncertainty.friction * level)
            values[:, i] = level + min(1.0, left) * (values[:, i] - level)
        if not those:
            return None
        return float((self.run(dataclasses.replace(plants, values=values)).outside > 0).mean())

    def run(self, plants: Plants, law: Law | None = None) -> Runs:
        """Other samples, or under another controller, run as its own were."""
        options = {name: self.settings[name] for name in ("steps_per_sample", "duration", "after")}
        own = self.law if law is None else law
        return plants.under(own, self.reference, within=self.within, **options).run(self.threads)

    @property
    def _loop(self) -> Any:
        """The nominal loop, its limit, its duration in whole periods and steps, as an
        `Evaluation` has them.
        """
        arm = self.plants.arm
        rig = self.plants.nominal
        settings = self.settings
        duration = math.ceil(settings["duration"] / rig.period - 1e-9) * rig.period
        return (
            arm,
            rig,
            self.law,
            self.reference,
            self.within,
            duration,
            settings["steps_per_sample"],
        )

    @property
    def holds(self) -> bool:
        """Whether no sample exceeds the limit, nor the nominal arm from rest, and failures are
        as rare as was asked.
        """
        return (
            self.failures == 0 and self.from_rest is None and (self.rare is None or self.rare.met)
        )

    @property
    def lowest_resonance(self) -> float | None:
        """Locked-rotor resonance [Hz] above which the nominal arm stays within the limit on
        gears; see `on_gears`.
        """
        return None if self.on_gears is None else self.on_gears.hz

    @property
    def worst(self) -> Worst:
        """The sample with the largest encoder error; among equals, with the largest before
        rounding.
        """
        peak = self.runs.peak.max(axis=1)
        unrounded = self.runs.unrounded.max(axis=1)
        return self.plant(int(np.lexsort((unrounded, peak))[-1]))

    def plant(self, index: int) -> Worst:
        """One of the samples, ready for `evaluate`."""
        if not isinstance(index, (int, np.integer)) or not 0 <= index < len(self.plants):
            raise ValueError(
                f"index must be a whole number from 0 to {len(self.plants) - 1}; got {index!r}."
            )
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
        """What was found, and on which gears it holds: one sentence, two on rigid ones."""
        return verdict(self)

    @known_options
    def reserves(self, *, samples: int | None = None, allowed: float = 0.0) -> Reserves:
        """Lowest bandwidth and longest period at which at most a share `allowed` of the first
        `samples` exceeds it.

        Of 400 by default, or of all where there are fewer.
        """
        return reserves(self, samples, allowed)

    @known_options
    def from_hold(self, *, samples: int | None = None) -> Any:
        """The certificate of the first `samples` (400, or all) where the controller has held the
        arm at rest before.

        Its disturbance torque is then what the model lacks there, and static friction may carry
        anything: of each joint's Coulomb level any share from -1 to 1, uniform. By default samples
        begin as when a brake is let go, with no disturbance torque yet.

        Raises
        ------
        ValueError
            More samples than there are; a path that begins in motion; a controller without a
            disturbance torque.
        """
        return held(self, samples)

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw peak errors, worst loop and sensitivities on (3,) Axes, (4,) where resonances
        were stated.
        """
        return plot_certificate(self, ax)

    def _shown(self) -> Iterator[Piece]:
        return shown(self)

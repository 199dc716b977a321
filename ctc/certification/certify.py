"""`certify`: Monte Carlo probability that an arm exceeds a pulse limit under a controller.

A controller is designed for one estimate, and the arm differs from it. `certify` samples arms from
the uncertainty (`ctc.certification.uncertainty`), simulates each under the controller
(`plant.simulation.population`), and counts those that exceed the limit
(`ctc.certification.certified`). The result holds for the stated uncertainty alone.
"""

import dataclasses
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypedDict, Unpack, overload

import numpy as np

from ctc.certification.certificate import Certificate
from ctc.certification.certificates import Certificates
from ctc.certification.plants import Plants
from ctc.certification.rare import rare_failure, require_numbers
from ctc.certification.samples import draw
from ctc.certification.uncertainty import Uncertainty
from ctc.verdict import SETTLED, require_followed
from identification import Identification
from identification.results import Seen, seen, warn_of_doubts
from plant import Arm, Law, Reference, Rig
from plant.compiler import cores
from plant.motion import motions_of, naming
from plant.parts import Checkpoint, instance, known_options, progress_bar, real, whole
from plant.simulation import Runs

Motions = Reference | Mapping[str, Reference]


class Task:
    """Checked arguments of `certify` or `tune` (the `work`); `laws` are checked, but not kept.

    `motions` is name -> (reference, duration [s]); a single reference has the name "".
    `checkpoint` is bound to all inputs of the result, among them `settings` of the work.
    """

    def __init__(
        self,
        work: str,
        found: Identification | Arm,
        rig: Rig,
        laws: tuple[Law, ...],
        reference: Motions,
        uncertainty: Uncertainty | None,
        *,
        within: float,
        after: float | None,
        duration: float | None,
        samples: int,
        seed: int,
        threads: int | None,
        progress: bool,
        checkpoint: str | Path | Checkpoint | None,
        steps_per_sample: int,
        executor: Any,
        settings: tuple[Any, ...] = (),
        inputs: Mapping[str, Any] = {},
    ) -> None:
        # An executor runs the loops elsewhere, a checkpoint stores those that ended here.
        if executor is not None and checkpoint is not None:
            raise ValueError(
                "checkpoint must be left out with an executor; got both. Or use campaign(folder=)."
            )
        # 1. The parts: each message has the order of the arguments, which are often exchanged.
        order = f"The order is found, rig, {'law, ' if laws else ''}reference, uncertainty."
        instance("rig", rig, Rig, order)
        for law in laws:
            # A law that repeats a log reads no count, so no sample could change it.
            if instance("law", law, Law, order).replays:
                raise ValueError(
                    f"the law must be a controller; {type(law).__name__} repeats a log. Use"
                    " another."
                )
        # An identification stands for its arm.
        motions = motions_of(getattr(found, "arm", found), rig, reference, order)

        # 2. Numbers, and the duration of each motion.
        whole("samples", samples, "Leave it out.")
        self.seed = whole("seed", seed, "Leave it out.", least=0)
        # The number of threads changes no bit, so all cores may be used.
        self.threads = cores() if threads is None else whole("threads", threads, "Leave it out.")
        self.within = real("within", within, "Give pulses, such as 1.")
        self.motions = dict[str, tuple[Reference, float]]()
        for name, motion in motions.items():
            with naming(name):  # errors name the motion
                self.motions[name] = motion, _seconds(motion, duration, after, rig.period)

        # 3. The uncertainty. The integration steps must be short enough to follow its resonance.
        self.uncertainty = Uncertainty() if uncertainty is None else uncertainty
        instance(
            "uncertainty", self.uncertainty, Uncertainty, "Give Uncertainty(friction=0.1, ...)."
        )
        if self.uncertainty.resonance is not None:
            require_followed("resonance", self.uncertainty.resonance, rig.period, steps_per_sample)
        # A probability is no better than the covariance that it comes from.
        if isinstance(found, Identification):
            warn_of_doubts(found, work)
        self.found = found
        self.rig = rig
        self.progress = progress
        self.steps_per_sample = steps_per_sample
        # A mapping of one motion still gives a set.
        self.several = isinstance(reference, Mapping)
        self.reference = next(iter(motions.values()))

        # 4. A checkpoint of other inputs is refused, with the name of the first that differs.
        inputs = {
            "identification": found,
            "rig": rig,
            **inputs,
            "reference": motions if self.several else reference,
            "seed": self.seed,
            "uncertainty": self.uncertainty,
            "settings": (self.within, steps_per_sample, duration, after, *settings),
        }
        self.checkpoint = Checkpoint(checkpoint, work).bind(lambda: inputs)

    def sampled(self, count: int, further: int = 0, normals: Any = None) -> Plants:
        """Monte Carlo samples for all motions; resonances hold where the first motion starts.

        `further` is added to the seed; `normals` is passed to `draw`.
        """
        # The resonance of a gear depends on the pose, but all motions share the gears.
        pose = self.reference(np.zeros(1)).q[0]
        return draw(
            self.uncertainty,
            self.found,
            self.rig,
            int(count),
            self.seed + further,
            pose,
            self.progress,
            self.checkpoint,
            normals,
        )


def _seconds(
    motion: Reference, duration: float | None, after: float | None, period: float
) -> float:
    """Checked duration [s] of a motion, in which a sample must follow `after`."""
    seconds = motion.duration if duration is None else duration
    advice = "Leave it out for one period of the reference."
    # A user's own reference may have a wrong duration, too.
    seconds = real("duration", seconds, advice, positive=True)
    # Where no sample counts, none exceeds the limit. The margin is that of `Population`.
    last = (math.ceil(seconds / period - 1e-9) - 1) * period
    if after is not None:
        begins = real("after", after, "Give seconds, or 0.")
        if not 0 <= begins <= last + 1e-9 * period:
            raise ValueError(
                f"after must be from 0 to {last:g} s, the last sample; got {after:g}. Give less."
            )
    return seconds


class Options(TypedDict, total=False):
    """Options of `certify`, for the types of its calls."""

    samples: int
    seed: int
    within: float
    confidence: float
    after: float | None
    steps_per_sample: int
    duration: float | None
    threads: int | None
    progress: bool
    checkpoint: str | Path | Checkpoint | None
    rare: float | None
    executor: Any


# The type of the result follows from that of the reference: one certificate, or a set.
@overload
def certify(
    found: Identification | Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    uncertainty: Uncertainty | None = ...,
    **options: Unpack[Options],
) -> Certificate: ...
@overload
def certify(
    found: Identification | Arm,
    rig: Rig,
    law: Law,
    reference: Mapping[str, Reference],
    uncertainty: Uncertainty | None = ...,
    **options: Unpack[Options],
) -> Certificates: ...
@known_options
def certify(
    found: Identification | Arm,
    rig: Rig,
    law: Law,
    reference: Motions,
    uncertainty: Uncertainty | None = None,
    *,
    samples: int = 10_000,
    seed: int = 0,
    within: float = 1,
    confidence: float = 0.95,
    after: float | None = None,
    steps_per_sample: int = 16,
    duration: float | None = None,
    threads: int | None = None,
    progress: bool = True,
    checkpoint: str | Path | Checkpoint | None = None,
    rare: float | None = None,
    executor: Any = None,
) -> Certificate | Certificates:
    """Monte Carlo probability of exceeding a pulse limit under parameter uncertainty.

    Parameters
    ----------
    found : Identification or Arm
        Distribution of the sampled arms: ``found.fit.values`` with ``found.covariance``. An arm
        needs an uncertainty with `covariance` or `plants`.
    rig : Rig
        Rig of the samples, such as ``found.rig``. Numbers of it that were identified come from
        `found`.
    law : Law
        As designed, the same for all samples.
    reference : Reference, or mapping of str -> Reference
        The path, or several by name, such as `plant.everyday_motions`, each inside limits and
        torque. The arms begin with its position and speed. All motions have the same samples, those
        of a single call with this seed; a stated resonance is that at the pose where the first
        motion begins.
    uncertainty : Uncertainty, optional
        Unknown properties beside the covariance; by default friction that was not identified, by 10
        %, and the encoders' zeros. With no `resonance` the gears are the rig's, and the verdict on
        rigid gears states the lowest resonance on which it holds. For this resonance, each stated
        imperfection has the end of its range that is farther from zero.
    samples : int
        Number of closed loops. Without a failure the bound is about 3 / samples at 95 %, and a
        failure of probability p appears among some 3 / p. Of stated ranges the bound is that of the
        worst cell: 3 over the samples in it, some 170 of 10,000 in each of the 60 cells of 15 to
        100 Hz.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    within : float
        Limit of the encoder error [pulses].
    confidence : float
        Of the bounds.
    after : float, optional
        Time [s] from which sampling instants count; the certificate says how many samples exceed
        the limit before it. By default, on rigid gears all instants count, also the first, at which
        the arm is up to half a pulse off its reference. On elastic gears they count from 20 ms or
        from half the duration, whichever is earlier.
    steps_per_sample : int
        Integration steps between two samples, 16 as in `evaluate`.
    duration : float, optional
        Of each motion [s]; by default one period of the reference.
    threads : int, optional
        By default one per core. The result is the same, bit for bit, for any number.
    progress : bool
        Show progress bars of fits and loops where standard error is a terminal.
    checkpoint : str or Path, optional
        File that stores fits and finished loops: killed and called again with it, the work goes on,
        to the same bits. A file of other inputs, versions or another processor is refused.
    rare : float, optional
        Probability, such as 1e-6, down to which subset simulation estimates the probability that
        the error before rounding exceeds the limit. ``certificate.rare`` holds the estimate with
        its coefficient of variation. Where the counts exceed the limit, so does this error, unless
        the encoder has a `quadrature` error, with which `rare` is refused. The simulation ends
        early where failures are more frequent. With several motions it counts a failure in any of
        them.
    executor : optional
        Executor that simulates the samples, as of `campaign`, in place of `threads`, to the same
        bits. It takes no checkpoint.

    Returns
    -------
    Certificate
        Of a mapping `Certificates`: a row for each motion, `Certificate` by name, and ``.worst``,
        its name.

    Raises
    ------
    ValueError
        Bad input; no covariance to sample from; a motion of a mapping that exceeds limits or
        torque, with the factor by which to slow it down.

    Notes
    -----
    With a `resonance`, the records of an identification on rigid gears are fitted again on such
    gears: 2 fits for one resonance, 8 for a range of 2.3 or more from end to end, 3 to 6 s each for
    the record of path (6) on two busy cores (7 to 45 s together). They are kept with `found`: other
    controllers over the same range and middle of `damping_ratio` take them as they are.

    See Also
    --------
    ctc.Certificate, ctc.Uncertainty, ctc.tune, plant.everyday_motions

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import ComputedTorque, Uncertainty, certify
    >>> path = puma560.reference()
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> law = ComputedTorque(found)
    >>> stated = Uncertainty(friction=0.02)
    >>> certificate = certify(found, found.rig, law, path, stated, samples=64, progress=False)
    >>> certificate.failures
    0
    """
    # 1. Check everything before the first fit.
    started = time.perf_counter()
    task = Task(
        "certify",
        found,
        rig,
        (law,),
        reference,
        uncertainty,
        within=within,
        after=after,
        duration=duration,
        samples=samples,
        seed=seed,
        threads=threads,
        progress=progress,
        checkpoint=checkpoint,
        steps_per_sample=steps_per_sample,
        executor=executor,
        inputs={"law": law, "number of samples": samples},
        # Only the simulation of rare failures ends by the confidence; all else is made of the runs.
        settings=() if rare is None else (rare, confidence),
    )
    _require_probabilities(task, confidence, rare)
    # 2. Simulate the same samples along each motion.
    motions = dict[str, tuple[Reference, Runs, dict[str, Any], Seen | None]]()
    driven = dict[str, tuple[Reference, dict[str, Any]]]()
    probability = None
    seconds = sum(duration for _, duration in task.motions.values())
    # Fits on gears, and rare failures, take about as long as the loops.
    fits = 0.0 if task.uncertainty.resonance is None else seconds
    work = fits + seconds + (0.0 if rare is None else seconds)
    with task.checkpoint as stages, progress_bar(work, "certify", "s", progress) as bar:
        with bar.part(fits, "fits on gears"):
            plants = task.sampled(samples)
        for name, (path, motion_seconds) in task.motions.items():
            begins = _counted_from(plants.rig, motion_seconds, after)
            settings = _settings_of_run(motion_seconds, begins, steps_per_sample)
            driven[name] = path, settings
            population = plants.under(law, path, within=task.within, **settings)
            # A single motion has no name, and its stages no prefix.
            part = stages.part(name) if name else stages
            with bar.part(motion_seconds, name):
                runs = population.run(task.threads, part, progress=progress, executor=executor)
            # An arm without an identification has no log to be compared with.
            of_log = (
                seen(found, path, motion_seconds) if isinstance(found, Identification) else None
            )
            # `Certificate.plant` simulates one arm again with the same lost counts, which are drawn
            # per step of the controller.
            motions[name] = path, runs, settings | {"law_steps": population.law_steps}, of_log
        # Subset simulation draws samples of its own, and drives them along the same motions.
        if rare is not None:
            probability = stages.stage(
                "rare", lambda: rare_failure(task, law, driven, float(rare), float(confidence))
            )
    # 3. A set in any case; a single motion is its only member.
    certificates = Certificates(
        rare=probability,
        law=law,
        plants=plants,
        within=task.within,
        confidence=float(confidence),
        motions=motions,
        threads=task.threads,
        seconds=time.perf_counter() - started,
    )
    # In a set the probability of rare failures is that of a failure in at least one motion, and
    # belongs to the set; the certificate of a single motion takes it over.
    if task.several:
        return certificates
    return dataclasses.replace(certificates[""], rare=probability)


def _settings_of_run(seconds: float, begins: float, steps_per_sample: int) -> dict[str, Any]:
    """Arguments of a population's run along one motion."""
    return {"steps_per_sample": steps_per_sample, "duration": seconds, "after": begins}


def _counted_from(rig: Rig, seconds: float, after: float | None) -> float:
    """Time [s] of a motion from which on its errors count, unless it is stated."""
    if after is not None:
        return float(after)
    # The start counts on rigid gears, and not on elastic ones.
    settling = SETTLED if rig.drive.elasticity is not None else 0.0
    # Half of a short motion counts in any case.
    return min(settling, seconds / 2)


def _require_probabilities(task: Task, confidence: float, rare: float | None) -> None:
    """Refuse `within`, `confidence` or `rare` outside its range, and what `rare` cannot take."""
    # A bound below 50 % confidence would lie below the estimate.
    confidence = real("confidence", confidence, "Give a share, such as 0.95.")
    if task.within < 0 or not 0.5 < confidence < 1:
        raise ValueError(
            f"within must not be negative and confidence between 0.5 and 1; got {task.within:g}"
            f" and {confidence:g}. The promise is 1 pulse, the usual confidence 0.95."
        )
    if rare is None:
        return
    if not 0 < real("rare", rare, "Give a probability, such as 1e-6.") < 1:
        raise ValueError(
            f"rare must be between 0 and 1; got {rare:g}. Give a probability, such as 1e-6."
        )
    require_numbers(task.uncertainty)
    # An error within the encoder's period is none before rounding, but it shifts the counts.
    if task.rig.encoder.quadrature is not None or any(task.uncertainty.quadrature):
        raise ValueError(
            "rare needs an encoder without an error within its period: with one, counts exceed the"
            " limit where the error before rounding does not. Leave out rare or quadrature."
        )

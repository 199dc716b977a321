"""Monte Carlo probability that an arm leaves a pulse limit under a law, given the uncertainty of its parameters.

A law is designed for one estimate, and the arm differs from it. Plants are drawn from the uncertainty
(`ctc.certification.uncertainty`), each is simulated under the law (`ctc.certification.population`), and those that
leave the limit are counted (`ctc.certification.certificate`). It holds for the uncertainty that was drawn, no other.
"""

import time
from pathlib import Path
from typing import Any

import numpy as np

from ctc.certification.certificate import Certificate
from ctc.certification.samples import draw
from ctc.certification.uncertainty import Uncertainty
from ctc.verdict.on_gears import SETTLED
from identification import Identification
from identification.results.seen import seen
from identification.results.summary import warn_of_doubts
from plant import Arm, Law, Reference, Rig
from plant.parts.arguments import instance, known_options, real
from plant.parts.checkpoint import Checkpoint
from plant.simulation.threads import cores


@known_options
def certify(
    found: Identification | Arm, rig: Rig, law: Law, reference: Reference, uncertainty: Uncertainty | None = None, *,
    samples: int = 10_000, seed: int = 0, within: float = 1, confidence: float = 0.95, after: float | None = None,
    steps_per_sample: int = 16, duration: float | None = None, threads: int | None = None, progress: bool = True,
    checkpoint: str | Path | Checkpoint | None = None,
) -> Certificate:  # fmt: skip
    """Monte Carlo probability of leaving a pulse limit under parameter uncertainty.

    Parameters
    ----------
    found : Identification or Arm
        Where the samples are drawn: ``found.fit.values`` with ``found.covariance``. An arm needs an uncertainty with
        `covariance` or `plants`.
    rig : Rig
        Of the plants, such as ``found.rig``; what was identified of it is taken from `found` in any case.
    law : Law
        As designed, the same for all plants.
    reference : Reference
        The path to be driven; the plants begin with it, at its position and speed.
    uncertainty : Uncertainty, optional
        What is not known beside the covariance; by default friction that was not identified, by 10 %, and the
        encoders' zeros. With no `resonance` the gears are the rig's, and the verdict on rigid ones states the lowest
        resonance on which it holds (all that is stated at its end farther from zero).
    samples : int
        Number of plants, each a closed loop. Without a failure the bound is about 3 / samples at 95 %, and to see one
        that has a probability p takes some 3 / p. Of stated ranges the bound is that of the worst cell: 3 over the
        plants in it, of which 10,000 leave some 170 in each of the 60 cells of 15 to 100 Hz.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    within : float
        Limit of the counted error [pulses].
    confidence : float
        Of the bounds.
    after : float, optional
        Samples before this time do not count [s]. On rigid gears all count by default, also the first, at which the arm
        is up to half a pulse off its reference; on elastic ones those after 20 ms do.
    steps_per_sample : int
        Integration steps between two samples; 16 is what `evaluate` takes.
    duration : float, optional
        [s]; by default one period of the reference.
    threads : int, optional
        By default one per core. The result is the same, bit for bit, for any number.
    progress : bool
        Show progress bars, of the fits below and of the loops, where standard error is a terminal.
    checkpoint : str or Path, optional
        File in which these fits and finished loops are kept: killed and called again with it, the work goes on, to the
        same bits. One of other inputs, versions or another processor is refused.

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        Bad input; no covariance to draw from.

    Notes
    -----
    With a `resonance`, the records of an identification on rigid gears are fitted again on such gears: 2 fits for one
    resonance, 8 for a range of 2.3 or more from end to end, 3 to 6 s each for the record of path (6) on two busy cores
    (7 to 45 s together). They are kept with `found`: other laws over the same range and middle of `damping_ratio` take
    them as they are.

    See Also
    --------
    ctc.Certificate, ctc.Uncertainty, ctc.tune

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import ComputedTorque, Uncertainty, certify
    >>> path = puma560.reference()
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> law = ComputedTorque(found, bandwidth=150)
    >>> stated = Uncertainty(friction=0.02)
    >>> certificate = certify(found, found.rig, law, path, stated, samples=64, progress=False)
    >>> certificate.failures
    0
    """
    started = time.perf_counter()
    order = "The order is found, rig, law, reference, uncertainty."
    for name, value, kind in (("rig", rig, Rig), ("law", law, Law), ("reference", reference, Reference)):
        instance(name, value, kind, order)
    _whole("samples", samples, 1)
    _whole("seed", seed, 0)
    _whole("threads", 1 if threads is None else threads, 1)
    within = real("within", within, "Give pulses, such as 1.")
    confidence = real("confidence", confidence, "Give a share, such as 0.95.")
    if within < 0 or not 0.5 < confidence < 1:
        raise ValueError(
            f"within must not be negative and confidence between 0.5 and 1; got {within:g} and {confidence:g}. "
            "The promise is 1 pulse, the usual confidence 0.95."
        )
    duration = reference.duration if duration is None else duration
    duration = real("duration", duration, "Leave it out for one period of the reference.", positive=True)
    if after is not None and not 0 <= real("after", after, "Give seconds, or 0.") < duration:
        raise ValueError(f"after must be from 0 to below the duration {duration:g} s; got {after:g}. Give seconds.")
    if law.replays:
        raise ValueError(f"the law must be a controller; {type(law).__name__} repeats a log. Use another.")
    stated = Uncertainty() if uncertainty is None else uncertainty
    instance("uncertainty", stated, Uncertainty, "Give Uncertainty(friction=0.1, ...).")
    stated.require_followed(rig.period / steps_per_sample)
    of_log = None
    if isinstance(found, Identification):
        warn_of_doubts(found, "certify")
        of_log = seen(found, reference, duration)
    pose, kept = reference(np.zeros(1)).q[0], Checkpoint(checkpoint, "certify")

    def inputs() -> dict[str, Any]:
        return {
            "identification": found, "rig": rig, "law": law, "reference": reference, "seed": int(seed),
            "number of samples": int(samples), "uncertainty": stated,
            "settings": (within, steps_per_sample, duration, after),
        }  # fmt: skip

    with kept.bind(inputs):
        drawn = draw(stated, found, rig, int(samples), int(seed), pose, progress, kept)
        if after is None:
            after = 0.0 if drawn.rig.drive.elasticity is None else min(SETTLED, duration / 2)
        settings: dict[str, Any] = {"steps_per_sample": steps_per_sample, "duration": duration, "after": float(after)}
        population = drawn.under(law, reference, within=within, **settings)
        threads = int(threads or cores())
        runs = population.run(threads, kept, progress=progress)
    return Certificate(
        law=law, reference=reference, plants=drawn, runs=runs, within=within, confidence=confidence,
        settings=settings | {"law_steps": population.law_steps}, threads=threads,
        seen=of_log, seconds=time.perf_counter() - started,
    )  # fmt: skip


def _whole(name: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}; got {value!r}. Leave it out.")

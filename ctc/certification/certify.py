"""The verdict over what is not known: how probable is it that the arm leaves so many pulses, and what makes it?

A law is made from one estimate; the arm is another one. Many arms that could be it are drawn
(`ctc.certification.uncertainty`), every one of them is run under the law (`ctc.certification.population`), and those
that leave are counted (`ctc.certification.certificate`). What is said holds for what was drawn, and for nothing else.
"""

from __future__ import annotations

import time

import numpy as np

from ctc.certification.certificate import Certificate
from ctc.certification.population import Population
from ctc.certification.uncertainty import Uncertainty
from plant import Law, Reference, Rig
from plant.parts.arguments import instance, known_options, real
from plant.simulation.threads import cores

__all__ = ["certify"]


@known_options
def certify(
    law, found, rig, reference, *, samples=10_000, seed=0, within=1, confidence=0.95, covariance=None, plants=None,
    friction=0.1, load=0.0, load_position=None, phase=True, delay=0.0, dropped=0.0, after=0.0, steps_per_sample=16,
    duration=None, threads=None,
):  # fmt: skip
    """Probability that an arm leaves its limit under a law, over what is not known of the arm.

    Parameters
    ----------
    law : Law
        As designed; only the plants differ.
    found : Identification or Arm
        Where the plants are drawn: ``found.values`` with ``found.covariance``. An arm needs one of `covariance` and
        `plants`.
    rig : Rig
        Of the plants, such as ``found.rig``; what `found` knows of it is used in any case.
    reference : Reference
    samples : int
        Closed loops.
    seed : int
    within : float
        Limit of the counted error [pulses].
    confidence : float
        Of the bounds.
    covariance, plants, friction, load, load_position, phase, delay, dropped
        What is drawn: see `ctc.certification.uncertainty.Uncertainty`.
    after : float
        Samples before this time do not count [s]: by default all do, also those in which the law finds the arm up to
        half a pulse off its reference.
    steps_per_sample : int
        Integration steps between two samples; 16 is what `evaluate` takes.
    duration : float, optional
        [s]; by default one period of the reference.
    threads : int, optional
        By default one per core. The result is the same bits for any number.

    Returns
    -------
    Certificate

    Raises
    ------
    ValueError
        Bad input; no covariance to draw from.
    """
    started = time.perf_counter()
    order = "The order is law, found, rig, reference."
    for name, value, kind in (("law", law, Law), ("rig", rig, Rig), ("reference", reference, Reference)):
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
    if not 0 <= real("after", after, "Give seconds, or 0.") < duration:
        raise ValueError(f"after must be from 0 to below the duration {duration:g} s; got {after:g}. Give seconds.")
    if law.replays:
        raise ValueError(f"the law must be a controller; {type(law).__name__} repeats a log. Use another.")
    uncertainty = Uncertainty(
        covariance=covariance, plants=plants, friction=friction, load=load, load_position=load_position, phase=phase,
        delay=delay, dropped=dropped,
    )  # fmt: skip
    drawn = uncertainty.draw(found, rig, int(samples), int(seed))
    settings = {"steps_per_sample": steps_per_sample, "duration": duration, "after": float(after)}
    population = Population(law, drawn, reference, within=within, **settings)
    threads = int(threads or cores())
    runs = population.run(threads)
    return Certificate(
        law=law, reference=reference, plants=drawn, runs=runs, within=within, confidence=confidence,
        settings=settings | {"law_steps": population.law_steps}, threads=threads,
        seconds=time.perf_counter() - started,
    )  # fmt: skip


def _whole(name, value, least):
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}; got {value!r}. Leave it out.")

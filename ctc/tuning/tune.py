"""Search for the controller with the least chatter that keeps a limit under uncertainty."""

import contextlib
import dataclasses
import functools
import operator
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ctc.certification import Certificate, Certificates, Motions, Task, Uncertainty, certify
from ctc.tuning.effort_scale import effort_scale
from ctc.tuning.inner_loops import inner_trials
from ctc.tuning.known_gears import KnownGears, with_known_gears
from ctc.tuning.search import SETTINGS, Tunings
from ctc.tuning.tuning import Family, Trial, Tuning, families, varied
from ctc.verdict import SETTLED
from identification import Identification, IdentificationWarning
from plant import Arm, Rig
from plant.machine import InnerLoop
from plant.parts import Floats, ProgressBar, known_options, progress_bar, real, warn
from plant.simulation import Executor

_RANK = operator.attrgetter("rank")


@known_options
def tune(
    found: Identification | Arm,
    rig: Rig,
    reference: Motions,
    uncertainty: Uncertainty | None = None,
    *,
    within: float = 1,
    allowed: float = 0.0,
    vary: str | Iterable[str] = (),
    after: float = SETTLED,
    inner: Mapping[Any, InnerLoop] | None = None,
    samples: int = 10_000,
    seed: int = 0,
    duration: float | None = None,
    threads: int | None = None,
    progress: bool = True,
    checkpoint: str | Path | None = None,
    executor: Any = None,
) -> Tuning:
    """Find the controller with the least torque chatter that keeps its limit under uncertainty.

    The genetic algorithm searches tunings of computed torque with observer, of computed torque with
    a PID that rolls off, and of feed-forward with PD, on samples of the uncertainty; the best are
    tested on independent samples. The search of computed torque with observer begins with its
    default, and keeps the dead zone and boost of the default if they are not to `vary`. Torque
    chatter is the mean change of the torque from one sampling instant to the next. The least is the
    least in shares of each joint's torque along the reference, mean of the joints (`Trial.noise`);
    tables show it in N m, or N of a slide.

    Parameters
    ----------
    found : Identification or Arm
        The model of the controllers, and the distribution of the samples; an arm needs its
        `covariance` or `plants`. With a `resonance`, an identification on rigid gears is fitted
        again on such gears: the controllers have the f of the middle.
    rig : Rig
        Of the samples, such as ``found.rig``.
    reference : Reference, or mapping of str -> Reference
        The path, or several motions by name, as for `certify`; the controller must keep the limit
        in all of them.
    uncertainty : Uncertainty, optional
        Unknown properties, as for `certify`.
    allowed : float
        Share of the samples that may exceed the limit, such as 0.05, for less chatter. Of the
        independent samples so few exceed it that a controller chosen beforehand would keep the
        share with 95 % confidence. This one was chosen on them, so the certificate, on samples of
        its own, is the verdict.
    vary : str or sequence of str
        Further numbers of computed torque with observer that the search varies beside its two
        bandwidths: `dead_zone`, `start_boost`, `start_time`, `learnable`, and those of
        `ComputedTorqueSettings`, such as `sliding_speed`; not `friction_sweeps` and
        `predicted_stiffness`. From a quarter to four times the default, shares up to 1.
    after : float
        Sampling instants before this time do not count [s].
    inner : mapping of InnerLoop, optional
        Inner loops of servos or drives to choose from, by the value of their register or a name:
        ``{P: PositionServo(gain=P * unit) for P in (8, 16, 32)}``, or a `MitDrive` for each
        stiffness. The default computed torque is judged above each. The search goes on above the
        one under which the fewest samples exceed the limit, and of several the quietest.
    samples : int
        Of the certificate.
    within, seed, duration, threads, progress, checkpoint, executor
        As of `certify`.

    Returns
    -------
    Tuning
        ``.law``, the table of all families in ``.table``, the controller's ``.certificate``, and
        the trials of the inner loops in ``.inner``, the chosen one first.
        Where none holds, that with which the fewest samples exceed the limit.

    Raises
    ------
    ValueError
        Bad input, as of `certify`; a number to `vary` that computed torque does not have.

    Notes
    -----
    With a set of motions the search begins with the two that are hardest for the initial tunings,
    and others join where a check fails. A family whose initial tunings all have twice the chatter
    of a tuning that holds in another family is not searched. On two cores 51 s for path (6), three
    minutes for the nine everyday motions of two joints, and for one motion of six joints
    (tests/benchmarks/tuning.py --time); fits on elastic gears, as of `certify`, come before.

    See Also
    --------
    ctc.certify, ctc.ComputedTorque, plant.everyday_motions

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import identify
    >>> from ctc import Uncertainty, tune
    >>> path = puma560.reference()
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path)
    >>> found = identify(puma560.dynamics(), record, progress=False)
    >>> stated = Uncertainty(friction=0.02)
    >>> tuning = tune(found, found.rig, path, stated, samples=8, duration=0.1, progress=False)
    >>> print(tuning.law.bandwidth > 0, tuning.certificate.failures)
    True 0
    """
    # 1. The inner loop, arguments and samples.
    task_above = functools.partial(
        _task,
        found,
        reference,
        uncertainty,
        within=within,
        after=after,
        duration=duration,
        samples=samples,
        seed=seed,
        threads=threads,
        executor=executor,
        settings=(allowed, *varied(vary)),
    )
    judged_by = {"within": within, "after": after}
    loops = inner_trials(inner, rig, task_above, SETTINGS, judged_by)
    if loops:
        rig = dataclasses.replace(rig, inner=loops[0].inner)
    task = task_above(rig, progress=progress, checkpoint=checkpoint)
    # Samples of the search and of the checks have seeds of their own: a tuning is chosen on the
    # former, tested on the latter, and certified on a third set.
    searched = SETTINGS.initial_samples_allowed if allowed else SETTINGS.initial_samples
    validated = SETTINGS.validation_samples // min(len(task.motions), SETTINGS.shared_motions)
    searching = task.sampled(searched, 0)
    fresh = task.sampled(validated, 1)
    # 2. The best tuning of each family.
    common = _common_options(task, fresh, after, allowed)
    laws = families(found, fresh.arm, fresh.own, task.reference, varied(vary))
    # Workers of an executor start once, for searches, checks and certificate.
    context = contextlib.nullcontext() if executor is None else Executor(executor)
    with context as shared, task.checkpoint as stages:
        searches = _searches(laws, stages, common, {"threads": task.threads, "executor": shared})
        seconds = sum(duration for _, duration in task.motions.values())
        of_certificate = samples * seconds * task.steps_per_sample
        # Known beforehand, so that the bar can tell the time that is left.
        work = sum(search.work(searched) for search in searches) + of_certificate
        with progress_bar(work, "tune", "step", progress) as bar:
            trials, interrupted = _searched(searches, searching.numbers()[1], seed, bar)
            # 3. The quietest that holds, and its certificate.
            best = min(trials, key=_RANK)
            # Whoever has pressed Ctrl-C waits for few samples only, which no checkpoint may hold.
            if interrupted:
                samples = min(samples, SETTINGS.interrupted_samples)
            judged: dict[str, Any] = {"within": within, "after": after, "duration": duration}
            running = {"threads": threads, "progress": progress, "executor": executor}
            part = None if interrupted or executor is not None else stages.part("certificate")
            with warnings.catch_warnings(), bar.part(of_certificate, "certificate"):
                warnings.simplefilter("ignore", IdentificationWarning)  # `tune` has given it
                options = judged | running | {"samples": samples, "checkpoint": part}
                certificate: Certificate | Certificates = certify(
                    found, rig, best.law, reference, task.uncertainty, seed=seed + 2, **options
                )
            # An executor's workers have their own populations, and Ctrl-C ends the waiting.
            waits = not interrupted and executor is None
            gears = _known_gears(fresh, task, stages, common) if waits else ()
    return Tuning(
        law=best.law,
        trials=tuple(trials),
        certificate=certificate,
        fresh=validated,
        interrupted=interrupted,
        known_gears=gears,
        inner=loops,
    )


def _task(
    found: Any,
    reference: Motions,
    uncertainty: Uncertainty | None,
    rig: Rig,
    **options: Any,
) -> Task:
    """The checked work of a search above this rig."""
    steps = SETTINGS.search_steps
    return Task("tune", found, rig, (), reference, uncertainty, steps_per_sample=steps, **options)


def _searches(
    laws: Iterable[Family], stages: Any, common: dict[str, Any], run_options: dict[str, Any]
) -> list[Tunings]:
    """The search of each family, with a part of the checkpoint of its own."""
    return [
        Tunings(family=law, checkpoint=stages.part(law.name), run_options=run_options, **common)
        for law in laws
    ]


def _searched(
    searches: list[Tunings], samples: Floats, seed: int, bar: ProgressBar
) -> tuple[list[Trial], bool]:
    """The best trial of each family, and whether Ctrl-C ended the search.

    A second Ctrl-C ends all work.
    """
    checks: list[list[Trial]] = []
    try:
        for search in searches:
            best = [min(trials, key=_RANK) for trials in checks]
            # A family that cannot be quieter than what holds already is given up early.
            beat = min((trial.noise for trial in best if trial.holds), default=np.inf)
            checks.append([])
            name = search.family.name
            work = search.work(len(samples))
            with bar.part(work, name), progress_bar(work, name, "step", True) as part:
                shown = dataclasses.replace(search, show=part.update)
                shown.best(samples, seed, checks[-1], beat)
    except KeyboardInterrupt:
        warn("tune: interrupted; the best so far is certified. Another Ctrl-C ends all")
        # Before any check, the first initial tuning is the best: that of the default controller.
        if not any(checks):
            checks = [searches[0].checked(searches[0].initial()[:1])[0]]
        return [min(trials, key=_RANK) for trials in checks if trials], True
    return [min(trials, key=_RANK) for trials in checks], False


def _known_gears(
    fresh: Any, task: Task, stages: Any, common: dict[str, Any]
) -> tuple[KnownGears, ...]:
    """What stating elastic gears would gain, from a checkpoint where it is there."""
    simulated = common["options"] | {"steps_per_sample": SETTINGS.check_steps}
    gears: tuple[KnownGears, ...] = stages.stage(
        "known gears",
        lambda: with_known_gears(
            fresh, common["motions"], simulated, common["scale"], task.threads
        ),
    )
    return gears


def _common_options(task: Task, fresh: Any, after: float, allowed: float) -> dict[str, Any]:
    """Options that the searches of all families share."""
    if not task.within > 0:
        raise ValueError(f"within must be positive; got {task.within:g}. The promise is 1 pulse.")
    if not 0 <= real("allowed", allowed, "Give a share, such as 0.05.") < 1:
        raise ValueError(
            f"allowed must be from 0 to below 1; got {allowed:g}. Give a share, such as 0.05."
        )
    return {
        "plants": fresh,
        "motions": tuple(task.motions.values()),
        "options": {"within": task.within, "after": after},
        "scale": effort_scale(fresh.arm, fresh.rig, task.motions),
        "allowed": float(allowed),
        "settings": SETTINGS,
    }

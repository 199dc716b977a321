"""From records to an arm: the identification procedure of the paper."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from tqdm import tqdm

import plant
from identification.equation_error.pulse_fit import over_bands
from identification.planning.quality import require_informative
from identification.replay.experiment import checked
from identification.replay.objective import Objective
from identification.replay.timing import delay_of
from identification.results.identification import Identification
from identification.search.genetic import GeneticSettings
from identification.search.methods import METHODS
from identification.search.problem import Search
from plant.parts.arguments import array, choice, instance, known_options

__all__ = ["identify"]


@known_options
def identify(
    dynamics,
    records,
    *,
    seed=0,
    method="seeded",
    progress=True,
    ranges=None,
    unknown=None,
    settings=None,
    steps_per_sample=4,
    sweeps=3,
    threads=None,
    held_out=None,
    zeros=False,
):
    """Find the parameters with which the model repeats the tracking errors of the robot.

    Steps 1-6 of 3.2: the robot has followed a trajectory under P control (1) and its errors are in the record (2); a
    population is drawn from the ranges (3), evaluated by objective (4), and evolved (5); the best ever seen is the
    result (6). That is ``method="paper"``. By default the ranges are drawn around a fit of the torque equation to the
    counts, and the best is the start of a last fit that predicts every sample from those before (`METHODS`).

    Parameters
    ----------
    dynamics : Dynamics
        The equations with f open.
    records : Record or sequence of Record
        From `plant.simulate` or one of `Record`'s readers. Of a log under a fast law only pulses are read;
        `LoggedTorque` and `LoggedCurrent` repeat its torques or currents.
    seed : int
        Same seed, same result, to the bit, on any number of threads.
    method : {"seeded", "paper", "genetic", "equation_error", "didim", "output_error", "prediction_error"}
        See `identification.search.methods`. "paper" is 3.7 as printed.
    progress : bool
        Show a progress bar.
    ranges : (k, 2) array_like, optional
        Where to search each unknown; "paper" and "genetic" take ``dynamics.ranges`` by default, the others need none.
    unknown : sequence of str, optional
        Names of what to find: all of f by default; numbers of rig or law may be added (``drive.viscous[0]``).
    settings : GeneticSettings, optional
        By default `GeneticSettings.paper()`.
    steps_per_sample, sweeps : int
        Sub-steps of the model, and sweeps of its friction law.
    threads : int, optional
        By default one per core.
    held_out : Record or sequence of Record, optional
        Records that are not searched, only repeated with what was found; by default the last of several, except by the
        paper's method. Give () to search them all.
    zeros : bool
        In logs that replay their torque: the counters were set to zero where the arm happened to hang, so where the
        joints are then is found as well, for each record (``found.zeros``). Held-out records are taken as they are.

    Returns
    -------
    Identification

    Raises
    ------
    ValueError
        Bad input, or no candidate that can be simulated.

    Source: paper 3.2, 3.7.
    """
    choice("method", method, tuple(METHODS))
    instance("zeros", zeros, bool, "Give True or False.")
    started = time.perf_counter()
    options = {"steps_per_sample": steps_per_sample, "sweeps": sweeps, "threads": threads}
    records, _ = checked(dynamics, records, unknown)
    if held_out is None:
        several = len(records) > 1 and method != "paper"
        records, held_out = (records[:-1], records[-1:]) if several else (records, ())
    elif isinstance(held_out, (tuple, list)) and not held_out:
        held_out = ()
    else:
        held_out, _ = checked(dynamics, held_out, unknown)
    objective = Objective(dynamics, records, unknown, **options)
    kept = Objective(dynamics, held_out, unknown, **options) if len(held_out) else None
    for record in objective.records:
        require_informative(record)
    if ranges is not None:
        ranges = array("ranges", ranges, (objective.p, 2), advice="Give (low, high) for each unknown.")
        for name, (low, high) in zip(objective.unknown, ranges, strict=True):
            if low > high:
                raise ValueError(f"ranges must be (low, high); that of {name} is ({low:g}, {high:g}). Swap its ends.")
    settings = GeneticSettings.paper() if settings is None else settings
    if not isinstance(settings, GeneticSettings):
        given = type(settings).__name__
        raise ValueError(f"settings must be GeneticSettings; got {given}. Leave it out for those of the paper.")
    first = objective.records[0]
    if zeros and not all(record.law.replays for record in objective.records):
        raise ValueError("zeros can be found only of logs that replay their torque; got a controller. Leave it out.")
    if zeros and method not in ("seeded", "prediction_error", "output_error"):
        raise ValueError(f"zeros must be found by prediction or output error; got method={method!r}. Use the default.")
    known = dict(zip(first.rig.number_names(), first.rig.number_values(), strict=True))
    known |= dict(zip(first.law.number_names("law."), first.law.number_values(), strict=True))
    nominal = np.array([known.get(name, np.nan) for name in objective.unknown])
    with tqdm(total=settings.generations, desc="identify", unit="generation", disable=not progress, leave=False) as bar:

        def show(state):
            bar.set_postfix_str(f"best {state.best_cost:.0f} pulses^2")
            bar.update()

        search = Search(
            dynamics=dynamics, records=objective.records, unknown=objective.unknown, objective=objective,
            nominal=nominal, ranges=ranges, settings=settings, seed=seed, zeros=zeros, options=options, show=show,
        )  # fmt: skip
        outcome = METHODS[method](search)
    genetic, k = outcome.genetic, objective.p
    if outcome.zeros is not None:
        objective = Objective(dynamics, _moved(objective.records, outcome.zeros), unknown, **options)
    cost = genetic.cost if method in ("paper", "genetic") else float(objective(outcome.values[None])[0])
    if not np.isfinite(cost) and genetic is not None:
        raise ValueError(
            f"some candidate must repeat the experiment; all {outcome.evaluations} diverged or had no sound inertia. "
            "Widen or correct the ranges, and check gains, gears and signs of rig and law."
        )
    named = dict(zip(objective.unknown, outcome.values, strict=True))
    f = np.array([named[name] for name in dynamics.names])
    delay, delay_std = np.nan, np.inf
    replayed = any(record.law.replays for record in objective.records)
    if outcome.covariance is not None and not replayed:  # what is not known to be near says nothing of timing
        delay, delay_std = delay_of(dynamics, objective.records, objective.unknown, outcome.values, **options)
    return Identification(
        method=method,
        arm=dynamics.arm(f),
        rig=first.rig.filled(named),
        law=first.law.filled(named, "law."),
        f=f,
        unknown=objective.unknown,
        values=outcome.values,
        candidates=outcome.values[None] if outcome.candidates is None else outcome.candidates,
        covariance=outcome.covariance,
        scatter=outcome.scatter,
        trouble=outcome.trouble,
        ranges=ranges,
        stages=outcome.stages,
        zeros=outcome.zeros,
        bands=_bands(dynamics, search, outcome.values),
        delay=delay,
        delay_std=delay_std,
        records=objective.records,
        held_out=tuple(held_out),
        difference=_difference(cost, objective),
        held_out_difference=None if kept is None else _difference(float(kept(outcome.values[None])[0]), kept),
        objective=cost,
        initial_objective=cost if genetic is None else genetic.initial_cost,
        initial_population=np.empty((0, k)) if genetic is None else genetic.initial_population,
        initial_costs=np.empty(0) if genetic is None else genetic.initial_costs,
        history=np.empty((0, 3)) if genetic is None else genetic.history,
        evaluations=outcome.evaluations,
        seconds=time.perf_counter() - started,
        seed=seed,
        settings=settings,
        version=plant.__version__,
        message=outcome.message,
    )


def _moved(records, zeros):
    """The same records with their counters' zeros where they are."""
    pairs = zip(records, zeros, strict=True)
    return [dataclasses.replace(r, error_pulses=r.error_pulses - r.rig.position_in_pulses(zero)) for r, zero in pairs]


def _bands(dynamics, search, values):
    """Least squares on logged torques in bands of their own, as a share of what was found: band [Hz] -> mean share."""
    if not all(record.law.replays for record in search.records):
        return {}
    found, shares = dict(zip(search.unknown, values, strict=True)), {}
    for band, fit in over_bands(dynamics, search.records, search.unknown, search.known).items():
        names = [name for name in dynamics.names if name in fit.names and found[name]]
        ours, least = np.array([found[name] for name in names]), np.array([fit[name] for name in names])
        std = fit.std[[fit.names.index(name) for name in names]]
        shares[band] = float(np.average(least / ours, weights=(ours / std) ** 2))
    return shares


def _difference(cost, objective):
    """Objective (4) as a root mean square per sample and joint [pulses]."""
    return float(np.sqrt(cost / sum(record.error_pulses.size for record in objective.records)))

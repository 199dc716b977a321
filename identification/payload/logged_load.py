"""The load on a known arm, from logs of its own: mass, centre of mass, and friction beside it.

Friction changes with load, temperature and wear; a load that is found with friction taken as stated is as wrong as that
is. So friction and its offsets are unknown beside the load, or stated with a deviation that counts in the interval.
Where several logs have been made, the spread between them counts too: each is fitted alone, and the covariance is
multiplied by their Birge ratio, squared, where that exceeds one.

Source: R. T. Birge, The calculation of errors by the method of least squares, Physical Review 40 (1932).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.payload.load import Load
from identification.payload.load_search import LoadSearch
from identification.payload.unknown_load import UnknownLoad
from identification.preparation import prepare
from identification.replay.experiment import as_records
from identification.search.memory import with_memory
from identification.search.outcome import Fit, Outcome
from identification.search.problem import Problem
from plant import Arm, FrictionCurve, Record, Rig
from plant.parts.arguments import array, instance, known_options, real

__all__ = ["find_load"]

_HEAVIEST, _LIGHTEST = 1e3, 1e-3
"""[kg]; the lightest where the centre is unknown, of which nothing has none."""

_EXPLAINED = 0.347
"""RMS innovation [pulses] above which more than rounding is left: 1.2 times 0.289."""

_AT_END, _NEGATIVE, _APART = 1e-6, 2.0, 2.0
"""Share of a range within which a value lies at its end; standard deviations below zero from which on a mass is called
negative; and Birge ratio from which on logs are said to differ."""


@known_options
def find_load(
    arm: Arm,
    record: Record | Sequence[Record],
    position: ArrayLike | None = None,
    *,
    link: int | str = -1,
    mass: tuple[float, float] | None = None,
    inertia: ArrayLike | None = None,
    friction: float | None = None,
    steps_per_sample: int = 4,
) -> Load:
    """A load on a known arm, from one log or several, under any law.

    Parameters
    ----------
    arm : Arm
        Without the load, such as ``found.arm``; taken as known.
    record : Record or sequence of Record
        Made with the load. The torque is that of the law, as for `identify`: a law with a memory is run along its log,
        also where this was cut; or that of the log.
    position : (3,) array_like, optional
        Centre of mass in the frame of the link's body [m]. Left out, it is found, along the axes that show.
    link : int or str
        Place of the link in the chain, or its name.
    mass : (low, high), optional
        Range of the mass [kg].
    inertia : (6,) array_like, optional
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz of the load about its centre [kg m^2]; by default none, a point.
    friction : float, optional
        Relative standard deviation of the rigs' viscous and Coulomb friction, and of offsets in the Coulomb level; 0
        takes them as exact. By default all are unknown.
    steps_per_sample : int

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Bad input, or a load that is not identifiable (a log that does not move it).
    """
    instance("arm", arm, Arm, "The order is arm, record, position.")
    given = record if isinstance(record, (tuple, list)) else (record,)
    for each in given:
        instance("record", each, Record, "The order is arm, record, position.")
    records, _ = as_records(arm.dynamics, [_with_offsets(each) for each in given], None)
    if position is not None:
        position = array("position", position, (3,), advice="Give x, y and z in the frame of the link's body [m].")
    moments = array("inertia", np.zeros(6) if inertia is None else inertia, (6,), advice="Give Ixx ... Izz [kg m^2].")
    load = UnknownLoad.of(arm.dynamics, link, position, moments)
    least = -_HEAVIEST if position is not None else _LIGHTEST
    low, high = array("mass", (least, _HEAVIEST) if mass is None else mass, (2,), advice="Give (low, high) [kg].")
    if not low < high or (position is None and low <= 0):
        rule = "increase" if not low < high else "be positive where the place of the load is unknown"
        raise ValueError(f"mass must {rule}; got {low:g} to {high:g}. Give (low, high) [kg].")
    if friction is not None and real("friction", friction, "Give a share, such as 0.1, or 0.") < 0:
        raise ValueError(f"friction must not be negative; got {friction:g}. Give a share, such as 0.1, or 0.")
    search = _search(arm, records[0].rig, load, (float(low), float(high)), friction)
    options = {"steps_per_sample": steps_per_sample, "sweeps": 3, "threads": None}
    outcome, problem = _followed(arm, records, search, options)
    runs, ratio = _alone(arm, records, search, options)
    return _assessed(arm, search, outcome, problem, runs, ratio, friction)


def _with_offsets(record: Record) -> Record:
    """The record with a friction offset in its rig, 0 where it states none."""
    drive = record.rig.drive
    if drive.curve is not None:
        return record
    none = (0.0,) * record.n
    curve = FrictionCurve(offset=none, breakaway=none, speed=(1.0,) * record.n)
    rig = dataclasses.replace(record.rig, drive=dataclasses.replace(drive, curve=curve))
    return dataclasses.replace(record, rig=rig)


def _search(arm: Arm, rig: Rig, load: UnknownLoad, mass: tuple[float, float], friction: float | None) -> LoadSearch:
    drive = rig.drive
    offset = np.zeros(rig.n) if drive.curve is None else drive.curve.offset
    stated = [drive.viscous, drive.coulomb, offset]
    deviation = [np.inf * np.ones(rig.n)] * 3
    if friction is not None:
        deviation = [friction * np.abs(each) for each in (drive.viscous, drive.coulomb, drive.coulomb)]
    return LoadSearch(
        f=arm.f, load=load, mass=mass, friction=np.concatenate(stated), deviation=np.concatenate(deviation)
    )


def _followed(
    arm: Arm, records: Sequence[Record], search: LoadSearch, options: Mapping[str, object]
) -> tuple[Outcome, Problem]:
    names = [f"{kind}[{i}]" for kind in ("drive.viscous", "drive.coulomb", "drive.curve.offset") for i in range(arm.n)]
    unknown = (*arm.dynamics.names, *names)
    problem = prepare(arm.dynamics, records, unknown, (), "prediction_error", None, None, 0, False, dict(options))
    return with_memory(problem, search.fitted), problem


def _alone(
    arm: Arm, records: Sequence[Record], search: LoadSearch, options: Mapping[str, object]
) -> tuple[tuple[tuple[float, float], ...], float]:
    """Mass and deviation of each record alone, and their Birge ratio, at least 1."""
    if len(records) < 2:
        return (), 1.0
    runs = []
    for record in records:
        try:
            fit = _followed(arm, [record], search, options)[0].fit
        except ValueError:  # one log alone need not tell
            runs.append((np.nan, np.inf))
            continue
        runs.append((float(fit.values[0]), float(fit.std[0])))
    masses, stds = np.array(runs).T
    told = np.isfinite(masses)
    if told.sum() < 2:
        return tuple(runs), 1.0
    weight = 1 / stds[told] ** 2
    mean = (weight * masses[told]).sum() / weight.sum()
    ratio = float(np.sqrt((weight * (masses[told] - mean) ** 2).sum() / (told.sum() - 1)))
    return tuple(runs), max(1.0, ratio)


def _assessed(
    arm: Arm, search: LoadSearch, outcome: Outcome, problem: Problem, runs: tuple[tuple[float, float], ...],
    ratio: float, friction: float | None,
) -> Load:  # fmt: skip
    fit, load, count = outcome.fit, search.load, len(search.load.names)
    covariance = np.asarray(fit.covariance) * ratio**2
    std = np.sqrt(np.diag(covariance))
    com = load.com(fit.values)
    com_std = np.zeros(3)
    com_std[list(load.shown)] = std[1:count]
    if load.shown:
        hidden = [axis for axis in range(3) if axis not in load.shown]
        com[hidden] = com_std[hidden] = np.nan
    arm_with = arm.dynamics.arm(arm.f + load.increments(fit.values))
    named = dict(zip(fit.unknown[count:], fit.values[count:], strict=True))
    return Load(
        mass=float(fit.values[0]), std=float(std[0]), arm=arm_with, rms_innovation=float(fit.rms_innovation or 0.0),
        com=com, com_std=com_std, names=fit.unknown, values=fit.values, covariance=covariance,
        rig=problem.records[0].rig.filled(named), runs=runs,
        warnings=tuple(_warnings(search, fit, problem, std, runs, ratio, friction)),
    )  # fmt: skip


def _warnings(
    search: LoadSearch, fit: Fit, problem: Problem, std: NDArray[np.float64], runs: tuple[tuple[float, float], ...],
    ratio: float, friction: float | None,
) -> Iterator[str]:  # fmt: skip
    """Lines about a fit."""
    bounds, values = search.bounds(problem), fit.values
    for name, value, own, (low, high) in zip(fit.unknown, values, std, bounds, strict=True):
        if own > 0 and min(value - low, high - value) <= _AT_END * max(1.0, abs(value)):
            end = "lower" if value - low < high - value else "upper"
            yield f"{name} ends at the {end} bound, {value:.4g}; its interval and those of the others do not hold."
    if values[0] < -_NEGATIVE * std[0]:
        yield "the mass is negative; the known arm is heavier than that of the log, or a sign or a unit is wrong."
    if (fit.rms_innovation or 0.0) > _EXPLAINED:
        yield (
            f"rounding does not explain the fit: RMS innovation {fit.rms_innovation:.2f} pulses, rounding alone gives "
            "0.29; arm, gears or friction differ from the model, and the mass may be off by more than its interval."
        )
    hidden = [name for name, own in zip(fit.unknown, std, strict=True) if own == 0 and name.startswith("drive.")]
    if friction is None and hidden:
        yield f"{', '.join(hidden)} does not show in these logs, and was taken from the rig."
    if friction is not None:
        said = "as exact" if friction == 0 else f"within {friction:.0%}"
        yield f"friction was taken from the rig, {said}; leave friction out to find it beside the load."
    if ratio > _APART:
        masses = ", ".join(f"{mass:.4g} +- {own:.2g}" for mass, own in runs)
        yield f"the records alone differ more than their deviations: {masses} kg; the deviation counts that."

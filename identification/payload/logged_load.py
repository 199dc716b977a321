"""`find_load`: mass and centre of mass of a load on a known arm, from logs, with unknown friction.

Friction changes with load, temperature and wear, and an error of it is an error of the load. So
friction and its offsets are unknown beside the load, or stated with a deviation that widens the
interval.

The interval includes the errors of the model as far as the logs show them. All of f is fitted
freely; its difference from the known f that no load explains gives a chi-square. Of several logs,
each is also fitted alone, which gives another one. The covariance is multiplied by the larger one
per degree of freedom (the squared Birge ratio), where that exceeds one. An identified arm has a
covariance: the load is then the generalised least squares of the difference in f. An `Arm` counts
as exact; under sampled laws, deviations of hundredths of a gram are then too small.

Source: R. T. Birge, The calculation of errors by the method of least squares, Physical Review 40
(1932).
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import (
    TorqueFit,
    along_log,
    covariance_of,
    measured_torque,
    of_each,
    wrong_statements,
)
from identification.payload.load import Load, birge, warnings_of
from identification.payload.load_search import LoadSearch, UnknownLoad
from identification.replay import Objective, as_records
from identification.results import Identification, covariance_of_f, warn_of_doubts
from identification.search import GeneticSettings, Outcome, Problem, with_memory
from plant import Arm, FrictionCurve, LoggedTorque, Record, Rig
from plant.checkup import bridged
from plant.parts import Floats, array, instance, known_options, real

# Range of the mass where the user states none [kg]: wider than any load on a robot, but finite for
# Gauss-Newton. A centre is only defined of a positive mass.
_HEAVIEST = 1e3
_LIGHTEST = 1e-3


@known_options
def find_load(
    arm: Identification | TorqueFit | Arm,
    record: Record | Sequence[Record],
    position: ArrayLike | None = None,
    *,
    link: int | str = -1,
    mass: tuple[float, float] | None = None,
    inertia: ArrayLike | None = None,
    friction: float | None = None,
    steps_per_sample: int = 4,
) -> Load:
    """Mass and centre of mass of a load on a known arm, from one log or several, under any law.

    Parameters
    ----------
    arm : Identification, TorqueFit or Arm
        Without the load. Of an identified or fitted arm the covariance of f counts; an `Arm` is
        taken as exact.
    record : Record or sequence of Record
        Made with the load. The torque is that of the law, as for `identify`: a law with a memory is
        run along its log, also if this was cut; or that of the log, also if no law is known.
    position : (3,) array_like, optional
        Centre of mass in the frame of the link's body [m]. By default it is unknown, along the axes
        on which the torques depend.
    link : int or str
        Number of the link in the chain, or its name.
    mass : (low, high), optional
        Range of the mass [kg].
    inertia : (6,) array_like, optional
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz of the load about its centre [kg m^2]; by default none, a
        point.
    friction : float, optional
        Relative standard deviation of the rigs' viscous and Coulomb friction, and of offsets in the
        Coulomb level; 0 takes them as exact. By default all are unknown, offsets within the Coulomb
        level: in a log that was cut a constant torque may also come from the law's memory.
    steps_per_sample : int

    Returns
    -------
    Load

    Raises
    ------
    ValueError
        Bad input, or a load that is not identifiable (a log that does not move it).

    See Also
    --------
    ctc.PayloadEstimator, plant.Body

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from identification import find_load
    >>> rig, law, path = puma560.rig(), puma560.p_law(), puma560.reference()
    >>> record = simulate(puma560.literature_arm(1.5), rig, law, path)
    >>> load = find_load(puma560.literature_arm(0.0), record, (0.0, -0.43, 0.0))
    >>> print(0 < load.mass < 3)
    True
    """
    # 1. Arm and records.
    known_arm, covariance = _known(arm)
    arm = instance("arm", known_arm, Arm, "The order is arm, record, position.")
    originals, _ = as_records(arm.dynamics, record, None)
    records = [bridged(_with_offsets(original)) for original in originals]

    # 2. The load, and the ranges of its numbers.
    if position is not None:
        # A stated centre leaves the mass as the only number of the load.
        position = array(
            "position",
            position,
            (3,),
            advice="Give x, y and z in the frame of the link's body [m].",
        )
    # The rotational inertia is no unknown; by default the load is a point.
    moments = array(
        "inertia",
        np.zeros(6) if inertia is None else inertia,
        (6,),
        advice="Give Ixx ... Izz [kg m^2].",
    )
    load = UnknownLoad.of(arm.dynamics, link, position, moments)
    if mass is None:
        # With a known centre the mass may be negative: it shows a wrong sign or a heavier arm.
        mass = (-_HEAVIEST if position is not None else _LIGHTEST, _HEAVIEST)
    low, high = array("mass", mass, (2,), advice="Give (low, high) [kg].")
    # The centre of no mass has no effect, so an unknown centre needs a positive mass.
    if not low < high or (position is None and low <= 0):
        rule = (
            "increase" if not low < high else "be positive where the place of the load is unknown"
        )
        raise ValueError(f"mass must {rule}; got {low:g} to {high:g}. Give (low, high) [kg].")
    if friction is not None and real("friction", friction, "Give a share, such as 0.1, or 0.") < 0:
        raise ValueError(
            f"friction must not be negative; got {friction:g}. Give a share, such as 0.1, or 0."
        )

    # 3. The fit of all records, and of each alone.
    search = _search(arm, records[0].rig, load, (float(low), float(high)), friction, covariance)
    options = {"steps_per_sample": steps_per_sample, "sweeps": 3, "threads": None}
    # All records together determine the load; each alone, its scatter.
    outcome, problem = _followed(arm, records, search, options)
    runs, ratio = _alone(arm, records, search, options)
    result = _assessed(arm, search, outcome, problem, runs, ratio, friction)
    if not result.warnings:
        return result
    # A wrong statement of a log explains any warning, but accuses no log that has none.
    lines = (wrong_statements(arm.dynamics, record) for record in records)
    statements = dict.fromkeys(itertools.chain.from_iterable(lines))
    return replace(result, warnings=(*statements, *result.warnings))


def _known(source: Identification | TorqueFit | Arm) -> tuple[Arm, Floats]:
    """The arm of a fit, and the covariance (p, p) of its f; 0 of an exact arm."""
    if not isinstance(source, (Identification, TorqueFit)):
        # Anything else than an arm is refused by the caller.
        p = len(source.f) if isinstance(source, Arm) else 0
        return source, np.zeros((p, p))
    warn_of_doubts(source, "find_load")
    if isinstance(source, TorqueFit):
        arm = source.dynamics.arm(source.f)
        return arm, covariance_of(source.dynamics.names, source.names, source.covariance)
    return source.arm, covariance_of_f(source, source.arm)


def _with_offsets(record: Record) -> Record:
    """The record with a friction offset in its rig; without a law it replays its torque."""
    drive = record.rig.drive
    if record.law is None:
        # The loop that gave the torque is nobody's to know: a drive's is faster than the log.
        law = LoggedTorque(held=False)
        record = replace(record, law=law, torque=measured_torque(record))
    # A curve of friction has an offset already.
    if drive.curve is not None:
        return record
    curve = FrictionCurve(offset=np.zeros(record.n))
    rig = replace(record.rig, drive=replace(drive, curve=curve))
    return replace(record, rig=rig)


def _search(
    arm: Arm,
    rig: Rig,
    load: UnknownLoad,
    mass: tuple[float, float],
    friction: float | None,
    covariance: Floats,
) -> LoadSearch:
    """Fit of the load: viscous and Coulomb friction and offsets, with their prior deviations."""
    drive = rig.drive
    offset = np.zeros(rig.n) if drive.curve is None else drive.curve.offset
    if friction is None:
        # Without a Coulomb level nothing limits an offset.
        level = np.where(drive.coulomb > 0, drive.coulomb, np.inf)
        deviation = [np.full(rig.n, np.inf), np.full(rig.n, np.inf), level]
    else:
        # An offset is stated as 0: its deviation is that of the Coulomb level.
        deviation = [
            friction * np.abs(level) for level in (drive.viscous, drive.coulomb, drive.coulomb)
        ]
    return LoadSearch(
        f=arm.f,
        load=load,
        mass=mass,
        friction=np.concatenate([drive.viscous, drive.coulomb, offset]),
        deviation=np.concatenate(deviation),
        covariance=covariance,
    )


def _followed(
    arm: Arm, records: Sequence[Record], search: LoadSearch, options: Mapping[str, Any]
) -> tuple[Outcome, Problem]:
    """Outcome of the fit, and its problem: of laws that started with their logs, or before."""
    # The order of `LoadSearch.friction`.
    kinds = ("drive.viscous", "drive.coulomb", "drive.curve.offset")
    unknown = (*arm.dynamics.names, *(f"{kind}[{i}]" for kind in kinds for i in range(arm.n)))
    objective = Objective(arm.dynamics, records, unknown, **options)
    followed = of_each(along_log, objective.records)
    problem = Problem(
        dynamics=arm.dynamics,
        records=tuple(followed),
        unknown=unknown,
        objective=objective,
        # A load needs every record: none is left for validation.
        held_out=None,
        nominal=np.append(arm.f, search.friction),
        ranges=None,
        method="prediction_error",
        settings=GeneticSettings.paper(),
        seed=0,
        zeros=False,
        options=dict(options),
    )
    # `with_memory` returns the better outcome alone; remember the problem of each.
    fits = []

    def fitted(problem: Problem) -> Outcome:
        outcome = search.fitted(problem)
        fits.append((outcome, problem))
        return outcome

    best = with_memory(problem, fitted)
    return next((outcome, problem) for outcome, problem in fits if outcome is best)


def _alone(
    arm: Arm, records: Sequence[Record], search: LoadSearch, options: Mapping[str, Any]
) -> tuple[tuple[tuple[float, float], ...], float]:
    """Mass and deviation of each record alone, and their Birge ratio, at least 1."""
    # One record has no scatter between records.
    if len(records) < 2:
        return (), 1.0
    runs = []
    for record in records:
        try:
            fit = _followed(arm, [record], search, options)[0].fit
        except ValueError:  # one log alone need not determine the load
            runs.append((np.nan, np.inf))
            continue
        runs.append((float(fit.values[0]), float(fit.std[0])))
    return tuple(runs), max(1.0, birge(runs))


def _assessed(
    arm: Arm,
    search: LoadSearch,
    outcome: Outcome,
    problem: Problem,
    runs: tuple[tuple[float, float], ...],
    ratio: float,
    friction: float | None,
) -> Load:
    """Load of a fit: corrected for the uncertain arm, its interval widened by the Birge ratio."""
    # 1. The difference from a free f: its part along the load, and the ratio of the rest.
    free = search.free(problem, outcome)
    load = search.load
    count = len(load.names)
    square = free.square
    freedom = free.freedom
    if freedom:
        ratio = max(ratio, np.sqrt(square / freedom))
    fit = outcome.fit
    # The known arm's uncertainty moves the numbers of the load and widens them.
    covariance = np.array(fit.covariance)
    if free.covariance is not None:
        values = fit.values + np.append(free.shares, np.zeros(len(fit.values) - count))
        fit = replace(fit, values=np.clip(values, *search.bounds(problem).T))
        covariance[:count, :count] = free.covariance
    covariance *= ratio**2

    # 2. The centre of mass; NaN along axes on which no torque depends.
    std = np.sqrt(np.diag(covariance))
    com = load.com(fit.values)
    com_std = np.zeros(3)
    com_std[list(load.shown)] = std[1:count]
    if load.shown:
        hidden = [axis for axis in range(3) if axis not in load.shown]
        com[hidden] = np.nan
        com_std[hidden] = np.nan
    loaded_arm = arm.dynamics.arm(arm.f + load.increments(fit.values))
    # The rig with the fitted friction, for a controller of the loaded arm.
    named = dict(zip(fit.unknown[count:], fit.values[count:], strict=True))
    return Load(
        mass=float(fit.values[0]),
        std=float(std[0]),
        arm=loaded_arm,
        rms_innovation=float(fit.rms_innovation or 0.0),
        com=com,
        com_std=com_std,
        names=fit.unknown,
        values=fit.values,
        covariance=covariance,
        rig=problem.records[0].rig.filled(named),
        runs=runs,
        chi_square=square,
        freedom=freedom,
        warnings=tuple(warnings_of(search, fit, problem, std, runs, friction, square, freedom)),
    )

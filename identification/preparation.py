"""Preparation of a search: records, searched and held out, unknowns, and checks of the input."""

import operator
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import (
    Known,
    Prior,
    advice,
    along_log,
    column_of,
    fit_torque,
    linear,
    misread,
    mode_in,
    naming,
    over_bands,
    still,
    told_by_torque,
    torque_of,
    unexcited,
)
from identification.replay import DAMPING, STIFFNESS, Objective, as_records, on_gears
from identification.search import METHODS, GeneticSettings, Problem, Tolerances
from plant import Dynamics, LoggedCurrent, LoggedTorque, Record
from plant.checkup import LEAST_MOTION, bridged, own_oscillations
from plant.parts import array, choice, frozen_settings, instance, require_room, warn
from plant.simulation import with_path


@frozen_settings
class LogSettings:
    """Limits beyond which a log is refused; chosen by hand.

    Parameters
    ----------
    samples : int
        Least number of samples: in fewer, no oscillation of a position loop stands out from noise.
    saturated : float
        Share of the samples at the amplifier's limit above which the torque is not that of the law.
    periods : float
        Periods of the slow mode of the loop that a log must hold.
    """

    samples: int = 200
    saturated: float = 0.5
    periods: float = 4


SETTINGS = LogSettings()


def require_informative(record: Record, labels: Sequence[str], *, prior: bool = False) -> None:
    """Refuse a log that is too short, or in which a motor hardly moves or mostly saturates.

    With a prior, some motors may stand still.
    """
    # From the plainest reason to the subtlest, as the first one is the message.
    _require_motion(record, labels, prior)
    if len(record) < SETTINGS.samples:
        raise ValueError(
            f"a log must have at least {SETTINGS.samples} samples; got {len(record)}. Log longer."
        )
    _require_unsaturated(record, labels)
    # A loop whose law has a memory is damped, and its pass band is that of the path. A logged
    # torque shows the inertias where it accelerates the arm. Neither log needs an oscillation.
    law = record.law
    if law is not None and (law.has_memory(record.n) or law.replays in ("torque", "current")):
        return
    seconds = len(record) * record.rig.period
    # The loop's own oscillation shows the inertias: the log must hold some periods of it.
    mode = mode_in(record)
    if seconds < SETTINGS.periods / mode:
        raise ValueError(
            f"a log must last {SETTINGS.periods} periods of its oscillation; {seconds:.3g} s hold "
            f"{seconds * mode:.1f} periods of {mode:.1f} Hz. Log longer."
        )


def _require_motion(record, labels, prior):
    # A prior can stand in for some motors, but not for all.
    moved = np.ptp(record.counts, axis=0)
    if (moved < LEAST_MOTION).any() and not (prior and moved.max() >= LEAST_MOTION):
        motor = int(np.argmin(moved))
        raise ValueError(
            f"every motor must move by at least {LEAST_MOTION} pulses; that of"
            f" {labels[motor]}{column_of(record, 'counts', motor)} moves by {moved[motor]:.0f}. Log"
            " a motion of all joints (design_motion), leave out that record, or give prior=, such"
            " as 0.3, for what it does not excite."
        )


def _require_unsaturated(record, labels):
    # At the limit the torque is not that of the law.
    drive = record.rig.drive
    current = np.abs(drive.current(torque_of(record)))
    share = (current >= drive.current_limit * (1 - 1e-9)).mean(axis=0)  # within rounding
    # The torque of a replay is known at the limit as well.
    replays = record.law is not None and record.law.replays
    if replays or not (share > SETTINGS.saturated).any():
        return
    motor = int(np.argmax(share))
    # The advice depends on the likely cause: no reference, columns that were misread, or a loop
    # that oscillates between the limits.
    reason = ""
    advice = "Slow the reference down or lower the gains."
    correction = ""
    if record.reference is None and not record.reference_pulses.any():
        reason = ": no reference came with it, so its law is taken to hold 0"
        advice = "Map reference_position, or give reference=."
    else:
        if oscillations := own_oscillations(record):
            reason = f": its loop oscillates at {oscillations[0]:.3g} Hz"
        if misreading := misread(record, limited=True):
            correction = f"{misreading[0]} As it is, "
            advice = "Correct that first."
    raise ValueError(
        f"{correction}a log must be below the amplifier's limit; by its law the motor of"
        f" {labels[motor]}{column_of(record, 'torque', motor)} is at it for {share[motor]:.0%} of"
        f" the samples{reason}. {advice}"
    )


def prepare(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    unknown: Iterable[str] | None,
    held_out: Record | Sequence[Record] | None,
    method: str,
    ranges: ArrayLike | None,
    settings: GeneticSettings | None,
    seed: int,
    zeros: bool,
    options: dict[str, Any],
    tolerances: Tolerances | None = None,
    prior: Any = None,
) -> Problem:
    """Prepare the problem of a method; bad input is refused here, before any search."""
    choice("method", method, tuple(METHODS))
    instance("zeros", zeros, bool, "Give True or False.")

    # 1. Records and unknowns.
    all_records, unknown = as_records(dynamics, records, unknown)
    naming.of_each(lambda record: record.rig.require_fit(dynamics.chain), all_records)
    searched, validation = _set_aside(dynamics, all_records, held_out, method)
    # Ranges of the user's unknowns alone leave no room for others.
    complete = np.iterable(ranges) and len(tuple(ranges)) == len(unknown)
    labels = dynamics.chain.joint_labels
    # Names once each, those of the user first.
    unknown = (*unknown, *_left_open(searched, labels, unknown, complete))
    of_f = _prior(dynamics, searched, prior)
    held = _held(dynamics, searched, unknown, of_f)
    searched, validation = (
        tuple(_with_held(record, held) for record in records) for records in (searched, validation)
    )
    if ranges is None and not zeros:
        searched, validation, unknown = _by_direction(dynamics, searched, validation, unknown)
    _require_room(dynamics, (*searched, *validation), unknown, method)

    # 2. The objective, and the logs as `told_by_torque` or `along_log` prepares them for a search.
    objective = Objective(dynamics, searched, unknown, **options)
    # A law with unknown gains cannot be run along the log beforehand.
    of_law = any(name.startswith("law.") for name in objective.unknown)
    elastic = any(record.rig.drive.elasticity is not None for record in objective.records)
    told = [None if of_law or elastic else told_by_torque(log) for log in objective.records]
    followed = tuple(
        along_log(record, unknown_law=of_law) if state is None else state[0]
        for record, state in zip(objective.records, told, strict=True)
    )
    # The check takes the logs in this form, in which the torque of a law counts like a logged one.
    naming.of_each(
        lambda record: require_informative(record, labels, prior=of_f is not None), followed
    )
    # Settings count for the methods with a genetic search, and are checked for all.
    chosen = GeneticSettings.paper() if settings is None else settings
    settings = instance("settings", chosen, GeneticSettings, "Leave it out for those of the paper.")
    # An error in a record held out names that record.
    with naming.held_out(validation, len(searched), among=held_out is None):
        aside = Objective(dynamics, validation, unknown, **options) if validation else None
    _require_different(searched, validation)
    problem = Problem(
        dynamics=dynamics,
        records=followed,
        unknown=objective.unknown,
        objective=objective,
        held_out=aside,
        nominal=_nominal(objective),
        ranges=None if ranges is None else _validated_ranges(ranges, objective.unknown),
        method=method,
        settings=settings,
        seed=seed,
        zeros=zeros,
        options=options,
        tolerances=tolerances or Tolerances(),
        prior=of_f,
        memories=tuple(state and state[1] for state in told) if any(told) else (),
    )

    # 3. Combinations that the method or the log cannot identify.
    _require_possible(problem)
    # This is no error: with a prior, or with unknowns of the rig alone, the log may suffice.
    if joints := unexcited(dynamics, followed):
        warn(
            f"identify: the log does not excite all: {', '.join(joints)}."
            f" {advice(dynamics, followed, of_f)}"
        )
    return problem


def _require_possible(problem):
    """Refuse zeros and gears where the method, or the log, cannot find them."""
    if problem.zeros and not all(problem.replays):
        raise ValueError(
            "zeros can be found only of logs that replay their torque; got a controller. Leave it"
            " out."
        )
    gears = [name for name in problem.unknown if name.startswith("drive.elasticity")]
    if gears and problem.method == "equation_error":
        raise ValueError(
            f"{gears[0]} can be found by prediction error, the default; got"
            f" method={problem.method!r}. Use it."
        )
    if problem.zeros and problem.method not in ("seeded", "prediction_error", "output_error"):
        raise ValueError(
            "zeros must be found by prediction or output error; got"
            f" method={problem.method!r}. Use the default."
        )


def _prior(dynamics, records, prior):
    """The prior of a user; by default the model's own bodies, if a joint moves in no log."""
    if prior is None:
        return Prior.of_model(dynamics, records[0].rig) if still(records).size else None
    return Prior.of(dynamics, records[0].rig, prior)


def _left_open(records, labels, unknown, complete):
    """Further unknowns: friction that the rig leaves open, of joints that move.

    `complete`: whether no unknowns can be added. Warns of friction that is taken as zero.
    """
    drive = records[0].rig.drive
    idle = still(records)
    further = []
    # If no joint moves, the log is refused.
    if idle.size == drive.n:
        return further
    taken = dict[str, list[str]]()
    for kind in drive.left_open:
        for i in range(drive.n):
            name = f"drive.{kind}[{i}]"
            if name in unknown:
                continue
            if i in idle:
                taken.setdefault(f"{labels[i]} hardly moves", []).append(name)
            elif complete:
                taken.setdefault("ranges have no row for it", []).append(name)
            else:
                further.append(name)
    for reason, names in taken.items():
        warn(f"identify: friction {', '.join(names)} is taken as zero: {reason}.")
    return further


def _held(dynamics, records, unknown, prior):
    """Whether the torques of the logs are held for a sample.

    The assumption that explains the torques better is taken: both have the same unknowns. The
    answer is None where no log leaves this open, or where no band has a fit of both.
    """
    held, sampled = ([_with_held(record, held) for record in records] for held in (True, False))
    if all(map(operator.is_, held, records)):
        return None
    try:
        # The same equations and unknowns twice: only the instants of the torques differ.
        fits = over_bands(dynamics, held, unknown, Known({}, prior))
        others = over_bands(dynamics, sampled, unknown, Known({}, prior))
        # Half a sample is a larger share of a period in a wider band.
        band = max(fits.keys() & others.keys())
    except ValueError:
        # Torques without a fit in one band do not say how they change; the methods say why.
        return None
    return fits[band].relative_error <= others[band].relative_error


def _with_held(record, held):
    """The record with a torque that is held, or not, where its law leaves that open."""
    law = record.law
    if not isinstance(law, LoggedTorque | LoggedCurrent) or law.held is not None:
        return record
    return replace(record, law=replace(law, held=held))


def _by_direction(dynamics, searched, validation, unknown):
    """Records and unknowns, with friction by direction where the logged torques show it.

    They change only if all searched logs replay their torques or currents, and the rig leaves its
    Coulomb friction open.
    """
    drive = searched[0].rig.drive
    torques = all(
        record.law is not None and record.law.replays in ("torque", "current")
        for record in searched
    )
    if not torques or drive.curve is not None or "coulomb" not in drive.left_open:
        return searched, validation, unknown
    try:
        # The friction alone: it does not depend on a prior of f.
        equations = linear(dynamics, searched[0].rig, unknown)
        fit = fit_torque(dynamics, searched, unknown=equations, prior=False)
    except ValueError:
        # Torques that give no fit say nothing of friction; the methods say why.
        return searched, validation, unknown
    names = [name for name in fit.names if name.startswith("drive.curve") and name not in unknown]
    if not names:
        return searched, validation, unknown
    # The same numbers, none of which is known beforehand. Friction that rises with speed explains
    # torques, but holds nothing at rest: a simulated joint would creep where the real one stands.
    curve = replace(fit.rig.drive.curve, rise=None)
    curve = curve.filled(dict.fromkeys(curve.number_names(), 0.0))

    def opened(record):
        drive = replace(record.rig.drive, curve=curve)
        return replace(record, rig=replace(record.rig, drive=drive))

    return tuple(map(opened, searched)), tuple(map(opened, validation)), (*unknown, *names)


def _require_different(searched, validation):
    """Refuse a log that comes twice: its rounding would count as that of two."""
    records = (*searched, *validation)
    for i, record in enumerate(records):
        for k, earlier in enumerate(records[:i]):
            if np.array_equal(record.t, earlier.t) and np.array_equal(
                record.counts, earlier.counts
            ):
                rule = "each log must come once"
                if k < len(searched) <= i:
                    rule = "a validation log must not be among those searched"
                label = naming.record_label(records, k)
                copy = naming.record_label(records, i)
                raise ValueError(f"{rule}; {copy} is {label} again. Leave one out.")


def _require_room(dynamics, records, unknown, method):
    """Refuse logs that memory does not hold."""
    n = dynamics.n
    numbers = len(unknown) if isinstance(unknown, Sequence) else dynamics.p
    # Records held out are simulated, and count as well.
    samples = sum(len(record) for record in records)
    # Peak memory for a sample, measured for two and for six joints: tables, and two copies of the
    # regressor or, with methods that follow the counts, 3.5 copies of all sensitivities.
    follows = method not in ("paper", "equation_error")
    sensitivities = 3.5 * (numbers + 2 * n) if follows else 2.0 * numbers
    require_room(
        f"{samples:,} samples of {n} joints with {numbers} unknowns",
        samples,
        8.0 * (60 + n * sensitivities),
        "Give {most} samples or fewer (record.cut), or fewer unknowns.",
        fixed=0.2e9,  # bytes of the kernels, and of the compiler, beside the samples
    )


def with_gears(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    held_out: Record | Sequence[Record] | None,
    unknown: Iterable[str] | None,
    method: str,
    ranges: ArrayLike | None,
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """Records on elastic gears, searched and held out, and the unknowns with those of the gears."""
    if ranges is not None:
        raise ValueError(
            "ranges need every unknown by name; got elasticity=True. Name stiffness and damping"
            " instead."
        )
    records, unknown = as_records(dynamics, records, unknown)
    searched, validation = _set_aside(dynamics, records, held_out, method)
    # Unknowns of the user keep their places; those of the gears follow.
    gears = [f"{field}[{i}]" for field in (STIFFNESS, DAMPING) for i in range(dynamics.n)]
    unknown = (*unknown, *(name for name in gears if name not in unknown))
    return tuple(map(on_gears, searched)), tuple(map(on_gears, validation)), unknown


def _set_aside(
    dynamics,
    records,
    held_out,
    method,
):
    """Records that are searched, and that are held out; lost rows are bridged, without weight."""
    # Straight lines bridge lost rows, which have no weight then.
    searched = tuple(naming.of_each(bridged, records))
    if method != "paper":  # which follows the straight lines between counts
        searched = tuple(map(with_path, searched))
    if held_out is None:
        # One record is needed for the search.
        if len(searched) > 1 and method != "paper":
            return searched[:-1], searched[-1:]
        return searched, ()
    if isinstance(held_out, (tuple, list)) and not held_out:
        return searched, ()
    validation = as_records(dynamics, held_out, None)[0]
    return searched, tuple(map(with_path, naming.of_each(bridged, validation)))


def _validated_ranges(ranges, unknown):
    """Ranges (k, 2) of the unknowns; an error where an end is on the wrong side."""
    pairs = array("ranges", ranges, (len(unknown), 2), advice="Give (low, high) for each unknown.")
    for name, (low, high) in zip(unknown, pairs, strict=True):
        # Equal ends are allowed: they state a value.
        if low > high:
            raise ValueError(
                f"ranges must be (low, high); that of {name} is ({low:g}, {high:g}). Swap its ends."
            )
    return pairs


def _nominal(objective):
    """The unknowns (k,) as rig and law of the first record have them; NaN for f."""
    rig = objective.records[0].rig
    law = objective.records[0].law
    stated = rig.numbers()
    if law is not None:
        stated |= law.numbers("law.")
    return np.array([stated.get(name, np.nan) for name in objective.unknown])

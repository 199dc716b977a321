"""What a method is given: informative records, searched and held out, their unknowns, and no bad
input.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import naming
from identification.equation_error.excitation import advice, still, unexcited
from identification.equation_error.law_memory import along_log
from identification.equation_error.naming import column_of
from identification.equation_error.prior import Prior
from identification.equation_error.pulse_fit import mode_in
from identification.equation_error.torque_logs import torque_of
from identification.replay.experiment import as_records
from identification.replay.objective import Objective
from identification.replay.resonances import DAMPING, STIFFNESS, on_gears
from identification.search.genetic import GeneticSettings
from identification.search.methods import METHODS
from identification.search.problem import Problem, Tolerances
from plant import Dynamics, Record
from plant.checkup.lost_rows import bridged
from plant.checkup.oscillation import own_oscillations
from plant.checkup.signals import LEAST_MOTION
from plant.parts.arguments import array, choice, instance
from plant.parts.fields import Floats
from plant.parts.messages import warn
from plant.parts.room import require_room
from plant.simulation.followed_path import with_path

_LEAST_SAMPLES = 200  # fewer hold no oscillation of a position loop that stands out from its noise

_SATURATED = 0.5  # share of the samples at the amplifier's limit above which a log is refused

_PERIODS = 4  # of the slow mode that a log has to hold


def require_informative(record: Record, labels: Sequence[str], *, prior: bool = False) -> None:
    """Refuse a log that is too short for the loop's mode, or in which a motor hardly moves or
    mostly saturates.

    With a prior, some motors may stand still.
    """
    moved = np.ptp(record.counts, axis=0)
    if (moved < LEAST_MOTION).any() and not (prior and moved.max() >= LEAST_MOTION):
        motor = int(np.argmin(moved))
        raise ValueError(
            f"every motor must move by at least {LEAST_MOTION} pulses; that of"
            f" {labels[motor]}{column_of(record, 'counts', motor)} moves by {moved[motor]:.0f}. Log"
            " a motion of all joints (design_motion), leave out that record, or give prior=, such"
            " as 0.3, for what it does not excite."
        )
    if len(record) < _LEAST_SAMPLES:
        raise ValueError(
            f"a log must have at least {_LEAST_SAMPLES} samples; got {len(record)}. Log longer."
        )
    drive = record.rig.drive
    replays = record.law is not None and record.law.replays
    share = (np.abs(drive.current(torque_of(record))) >= drive.current_limit * (1 - 1e-9)).mean(
        axis=0
    )
    # of a replay the torque is known, also at the limit
    if (share > _SATURATED).any() and not replays:
        motor = int(np.argmax(share))
        why = "".join(
            f": its loop oscillates at {hz:.3g} Hz" for hz in own_oscillations(record)[:1]
        )
        advice = "Slow the reference down or lower the gains."
        wrong = ""
        if record.reference is None and not record.reference_pulses.any():
            why = ": no reference came with it, so its law is taken to hold 0"
            advice = "Map reference_position, or give reference=."
        elif wrong := naming.misread(record, limited=True):
            wrong = f"{wrong[1:]} As it is, "
            advice = "Correct that first."
        raise ValueError(
            f"{wrong}a log must be below the amplifier's limit; the motor of {labels[motor]}"
            f"{column_of(record, 'torque', motor)} is at it for {share[motor]:.0%} "
            f"of the samples{why}. {advice}"
        )
    seconds = len(record) * record.rig.period
    mode = mode_in(record)
    if not mode > 0:
        raise ValueError(
            f"a log must show the oscillation of its loop; sampled every {record.rig.period:g} s it"
            " does not. State rig.period in seconds, or log faster."
        )
    if seconds < _PERIODS / mode:
        raise ValueError(
            f"a log must last {_PERIODS} periods of its oscillation; {seconds:.3g} s hold "
            f"{seconds * mode:.1f} periods of {mode:.1f} Hz. Log longer."
        )


_FIXED = 0.2e9  # bytes beside the samples: kernels, and what compiles them


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
    """The problem that a method is given; bad input is refused here, before any search."""
    choice("method", method, tuple(METHODS))
    instance("zeros", zeros, bool, "Give True or False.")
    of_all, unknown = as_records(dynamics, records, unknown)
    naming.of_each(lambda record: record.rig.require_fit(dynamics.chain), of_all)
    unknown = tuple(dict.fromkeys([*unknown, *_left_open(of_all, dynamics.chain.joint_labels)]))
    searched, kept = _set_aside(dynamics, of_all, held_out, method)
    known = _known(dynamics, searched, prior)
    _require_room(dynamics, (*searched, *kept), unknown, method)
    objective = Objective(dynamics, searched, unknown, **options)
    of_law = any(name.startswith("law.") for name in objective.unknown)
    followed = tuple(along_log(record, unknown_law=of_law) for record in objective.records)
    labels = dynamics.chain.joint_labels
    naming.of_each(
        lambda record: require_informative(record, labels, prior=known is not None), followed
    )
    chosen = GeneticSettings.paper() if settings is None else settings
    settings = instance("settings", chosen, GeneticSettings, "Leave it out for those of the paper.")
    with naming.held_out(kept, len(searched), among=held_out is None):
        aside = Objective(dynamics, kept, unknown, **options) if kept else None
    _require_different(searched, kept)
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
        prior=known,
    )
    if zeros and not all(problem.replays):
        raise ValueError(
            "zeros can be found only of logs that replay their torque; got a controller. Leave it"
            " out."
        )
    found = [name for name in problem.unknown if name.startswith("drive.elasticity")]
    if found and method == "equation_error":
        raise ValueError(
            f"{found[0]} can be found by prediction error, the default; got method={method!r}."
            " Use it."
        )
    if zeros and method not in ("seeded", "prediction_error", "output_error"):
        raise ValueError(
            f"zeros must be found by prediction or output error; got method={method!r}. Use the"
            " default."
        )
    if said := unexcited(dynamics, followed):
        warn(
            f"identify: the log does not excite all: {', '.join(said)}."
            f" {advice(dynamics, followed, known)}"
        )
    return problem


def _known(dynamics: Dynamics, records: Sequence[Record], given: Any) -> Prior | None:
    """The prior that was given; by default that of the model's own bodies, if a joint hardly
    moves in any record.
    """
    if given is None:
        return Prior.of_model(dynamics, records[0].rig) if still(records).size else None
    return given if isinstance(given, Prior) else Prior.of(dynamics, records[0].rig, given)


def _left_open(records: Sequence[Record], labels: Sequence[str]) -> list[str]:
    """Friction that the rig leaves open, of joints that move; of others it stays zero, which is
    said.
    """
    drive = records[0].rig.drive
    idle = still(records)
    if drive.left_open and idle.size < drive.n:
        for i in idle.tolist():
            warn(f"identify: friction of {labels[i]} is taken as zero: the joint hardly moves.")
    return [
        f"drive.{kind}[{i}]" for kind in drive.left_open for i in range(drive.n) if i not in idle
    ]


def _require_different(searched: Sequence[Record], kept: Sequence[Record]) -> None:
    """Refuse a log that comes twice: its rounding would count as that of two."""
    every = (*searched, *kept)
    for i, record in enumerate(every):
        for k, before in enumerate(every[:i]):
            if np.array_equal(record.t, before.t) and np.array_equal(record.counts, before.counts):
                aside = k < len(searched) <= i
                told = (
                    "a validation log must not be among those searched"
                    if aside
                    else "each log must come once"
                )
                first, second = (naming.record_label(every, place) for place in (k, i))
                raise ValueError(f"{told}; {second} is {first} again. Leave one out.")


def _require_room(
    dynamics: Dynamics, records: Sequence[Record], unknown: Iterable[str] | None, method: str
) -> None:
    """Refuse logs that memory does not hold.

    What a sample takes at the peak was measured for two and for six joints: tables and two copies
    of the regressor, or, of methods that follow the counts, some three of all sensitivities.
    """
    numbers = len(unknown) if isinstance(unknown, Sequence) else dynamics.p
    follows = method not in ("paper", "equation_error")
    each = 8.0 * (
        60 + dynamics.n * (3.5 * (numbers + 2 * dynamics.n) if follows else 2.0 * numbers)
    )
    samples = sum(len(record) for record in records)
    what = f"{samples:,} samples of {dynamics.n} joints with {numbers} unknowns"
    fewer = "Give {most} samples or fewer (record.cut), or fewer unknowns."
    require_room(what, samples, each, fewer, fixed=_FIXED)


def with_gears(
    dynamics: Dynamics,
    records: Record | Sequence[Record],
    held_out: Record | Sequence[Record] | None,
    unknown: Iterable[str] | None,
    method: str,
    ranges: ArrayLike | None,
) -> tuple[tuple[Record, ...], tuple[Record, ...], tuple[str, ...]]:
    """Records that are searched and held out, on elastic gears, and the unknowns with those of
    the gears.
    """
    if ranges is not None:
        raise ValueError(
            "ranges need every unknown by name; got elasticity=True. Name stiffness and damping"
            " instead."
        )
    given, unknown = as_records(dynamics, records, unknown)
    searched, kept = (
        tuple(map(on_gears, some)) for some in _set_aside(dynamics, given, held_out, method)
    )
    gears = [f"{field}[{i}]" for field in (STIFFNESS, DAMPING) for i in range(dynamics.n)]
    return searched, kept, (*unknown, *(name for name in gears if name not in unknown))


def _set_aside(
    dynamics: Dynamics,
    records: Sequence[Record],
    held_out: Record | Sequence[Record] | None,
    method: str,
) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Records that are searched, and records that are held out; lost rows of all are bridged,
    without weight.
    """
    searched = tuple(naming.of_each(bridged, records))
    if method != "paper":  # which follows the straight lines between counts
        searched = tuple(map(with_path, searched))
    if held_out is None:
        return (
            (searched[:-1], searched[-1:])
            if len(searched) > 1 and method != "paper"
            else (searched, ())
        )
    if isinstance(held_out, (tuple, list)) and not held_out:
        return searched, ()
    return searched, tuple(
        map(with_path, naming.of_each(bridged, as_records(dynamics, held_out, None)[0]))
    )


def _validated_ranges(ranges: ArrayLike, unknown: tuple[str, ...]) -> Floats:
    pairs = array("ranges", ranges, (len(unknown), 2), advice="Give (low, high) for each unknown.")
    for name, (low, high) in zip(unknown, pairs, strict=True):
        if low > high:
            raise ValueError(
                f"ranges must be (low, high); that of {name} is ({low:g}, {high:g}). Swap its ends."
            )
    return pairs


def _nominal(objective: Objective) -> Floats:
    """The unknowns (k,) as rig and law of the first record have them; NaN for f."""
    rig = objective.records[0].rig
    law = objective.records[0].law
    known = dict(zip(rig.number_names(), rig.number_values(), strict=True))
    if law is not None:
        known |= dict(zip(law.number_names("law."), law.number_values(), strict=True))
    return np.array([known.get(name, np.nan) for name in objective.unknown])

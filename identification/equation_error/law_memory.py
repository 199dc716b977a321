"""What a law remembered when its log began.

A law with a memory gives its torque once its state before the log's first sample is known. It is
not in the log, where this begins in the middle of a motion; but it acts on the torque, an integral
for as long as the log lasts. Here it is fitted together with f, by the torque equation, in those
directions in which it shows in the torque.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error.pulse_fit import BAND_MOST, BANDS, ENOUGH, filtering_of
from identification.equation_error.regressor import linear, regressor_and_torque
from identification.equation_error.torque_fit import weighted
from identification.equation_error.torque_logs import law_torque
from plant import Dynamics, LoggedCurrent, LoggedTorque, Record, Resumed
from plant.parts.fields import Floats
from plant.parts.sums import least, norm, product, triangle
from plant.simulation.clock import Clock
from plant.simulation.law_run import LawRun, run_from, run_law

_FIRST = 10  # samples whose speed the arm had before

# Samples after which what a law does of its state is looked at; before, it is as if the arm had
# begun otherwise.
FADED = 30

# torque that a change of state makes at first and then no longer, in the largest of the log: at
# most
_MILD = 0.03

# Of a reference rebuilt from counts: a number of knots, relative, and the share of torque that it
# may change.
_FINER = 2.2
_HIDDEN = 0.005

_ROUNDS = 3  # fits of the state; a law that saturates is not linear in it

# change in the second half of a log, in the largest magnitude, up to which a state is a flag
_STILL = 1e-3

_SMALL = 1e-4  # step of the derivatives by the state, in the largest magnitudes of the run

# share of the torque that a state must make, for a change of its own size, to be fitted
_SEEN = 1e-3

# standard deviation of a state that is expected, in the largest magnitudes of the run
_AT_MOST = 2.0


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """Directions in which a law's state before its log shows in the torque.

    `state` (s,): from which they are counted. `directions` (s, r): changes of the state, each of
    which makes a torque of 1 N m (rms over the log and all joints); none where the state is known,
    or does not show. `usual` (r,): how far states are apart in the log, along each [N m], with
    torques of no more than its largest.
    """

    state: Floats
    directions: Floats
    usual: Floats

    def at(self, coordinates: Floats) -> Floats:
        """State (s,) at coordinates (r,) [N m]."""
        return np.asarray(self.state + self.directions @ coordinates)


class Resumption(NamedTuple):
    """Where a record's law and arm were at its first sample: the law's state (s,), and q and qd
    (2, n).
    """

    state: Floats
    initial: Floats


def along_log(record: Record, *, unknown_law: bool = False) -> Record:
    """The record of a law with a memory as one whose torque is known: as it was logged, or from the
    law's own run.

    Of a law without memory, or one that repeats a column, it is returned as it is. Where numbers of
    the law are unknown, what was logged is left aside. Fast hardware with a memory goes on from a
    state, in the loop: between samples it feels the arm.
    """
    law = record.law
    if law is None or law.replays or not law.has_memory(record.n):
        return record
    whole = (record.reference_pulses == np.trunc(record.reference_pulses)).all()
    if (
        law.period is None
        and record.reference is None
        and whole
        and np.ptp(record.reference_pulses) > 0
    ):
        raise ValueError(
            f"the reference of a fast {type(law).__name__} must be known between samples, since its"
            " memory is; whole counts leave it open. Give reference=, or the reference without"
            " rounding (reference_position)."
        )
    sampled = law.period is not None and not unknown_law
    if sampled and record.torque is not None:
        return dataclasses.replace(record, law=LoggedTorque())
    if sampled and record.current is not None:
        return dataclasses.replace(record, law=LoggedCurrent())
    resumed = (
        law if isinstance(law, Resumed) else Resumed(law=law, state=law.initial_state(record.n))
    )
    return (
        dataclasses.replace(record, law=resumed) if law.period is None else reading(record, resumed)
    )


def reading(record: Record, law: Resumed) -> Record:
    """The record with its law reading the log's counts, also where it is fast hardware."""
    return dataclasses.replace(record, law=law.along(record.rig))


def with_state(dynamics: Dynamics, record: Record, unknown: Iterable[str]) -> tuple[Record, Memory]:
    """A record, its law in the state in which it may have been, as far as the torque equation
    tells.

    It had been at work for a while: what no longer changes in the log (a flag that the law has
    begun) is as it is there, and its filters have followed counts and reference on straight lines.

    `record`: of `along_log`, with a law that goes on from a state. `unknown`: what is unknown of
    arm and drive.
    """
    given: Any = record.law
    record, usual = at_work(record, given)
    names = linear(dynamics, record.rig, unknown)
    bands = BANDS[BAND_MOST / record.rig.period > BANDS]
    for _ in range(_ROUNDS):
        run = run_law(record)
        memory, columns = state_directions(record, run, usual)
        if not len(columns):
            break
        coordinates, bands = _fitted(dynamics, record, names, run, columns, memory.usual, bands)
        change = memory.directions @ coordinates
        record = _moved(record, change)
        memory = dataclasses.replace(memory, state=memory.state + change)
    return dataclasses.replace(record, law=dataclasses.replace(given, state=memory.state)), memory


def at_work(record: Record, law: Resumed) -> tuple[Record, Floats]:
    """The record, its law reading the log as if at work before it, and usual magnitudes (s,) of
    its state.
    """
    record = reading(record, law)
    _require_reference(record)
    states = run_law(record).states
    usual = states[len(states) // 2 :]
    still = np.ptp(usual, axis=0) <= _STILL * np.abs(states).max(axis=0)
    begun = np.where(still, np.median(usual, axis=0), run_law(_before(record)).states[-1])
    return _moved(record, begun - law.state), np.abs(usual).max(axis=0)


def _before(record: Record) -> Record:
    """Some samples before the record, its counts and its reference on straight lines to the
    first.
    """
    t = record.rig.period * np.arange(FADED)
    rows = np.flatnonzero(record.valid)[:_FIRST]
    back = t - record.rig.period * FADED
    lines = []
    for column in (record.counts, record.reference_pulses):
        slope = np.polynomial.polynomial.polyfit(record.t[rows] - record.t[0], column[rows], 1)[1]
        lines.append(np.rint(column[rows[0]] + slope * back[:, None]))
    counts, reference = lines
    return Record(
        t=t,
        rig=record.rig,
        law=record.law,
        reference_pulses=reference,
        error_pulses=reference - counts,
    )


def _require_reference(record: Record) -> None:
    """Refuse a law whose torque hangs on what the rounding of its reference hides."""
    if record.reference is not None:
        return
    torque = run_law(record).given
    hidden = np.sqrt(np.mean((run_law(record, _FINER).given - torque) ** 2) / np.mean(torque**2))
    if hidden > _HIDDEN:
        law: Any = record.law
        raise ValueError(
            f"the torque of {type(law.law).__name__} must follow from reference and counts; whole"
            f" counts of the reference leave {hidden:.1%} of it open. Give reference=, the"
            " reference without rounding (reference_position), or the torque."
        )


def _moved(record: Record, change: Any) -> Record:
    law: Any = record.law
    return dataclasses.replace(record, law=dataclasses.replace(law, state=law.state + change))


def state_directions(record: Record, run: LawRun, scale: Floats) -> tuple[Memory, Floats]:
    """Directions of states of these magnitudes (s,), and the torques (r, N, n) at the samples
    that each makes.
    """
    clock = Clock.of(record)
    period = record.rig.period
    law: Any = record.law
    t = clock.t[clock.rows]
    torque = run.around(t, period)
    varied = np.flatnonzero(scale)
    by_state = [np.zeros(0)]
    for moved in run_from(record, law.state + _SMALL * np.diag(scale)[varied]):
        by_state.append((moved.around(t, period) - torque).ravel() / _SMALL)
    each = np.reshape(np.concatenate(by_state), (-1, torque.size)).T
    at_once, later = (np.abs(part).max(axis=0) for part in np.split(each, [FADED * record.n]))
    strongest = np.maximum(at_once - later, 1e-12)
    # a filter's memory acts at once, and saturates
    mild = np.minimum(1.0, _MILD * np.abs(torque).max() / strongest)
    scale = scale.copy()
    each = each * mild
    scale[varied] *= mild
    _, sizes, shares = np.linalg.svd(triangle(each[FADED * record.n :]))
    seen = sizes > _SEEN * norm(torque)
    unit = np.sqrt(torque.size) / sizes[seen]
    directions = np.zeros((len(scale), seen.sum()))
    directions[varied] = scale[varied, None] * shares[seen].T * unit
    columns = (product(each, shares[seen].T) * unit).T.reshape(-1, *torque.shape)
    most = (
        np.abs(torque).max() / np.abs(columns).max(axis=(1, 2), initial=0.0)
        if len(columns)
        else unit
    )
    return (
        Memory(state=np.array(law.state), directions=directions, usual=np.minimum(1 / unit, most)),
        columns,
    )


def _fitted(
    dynamics: Dynamics,
    record: Record,
    unknown: tuple[str, ...],
    run: LawRun,
    columns: Floats,
    usual: Floats,
    bands: Floats,
) -> tuple[Floats, Floats]:
    """Coordinates (r,) [N m] with which the torque equation holds best, of such as are usual;
    and in which bands.
    """
    rig = record.rig
    torque = law_torque(record, run)
    fits = []
    extra = {f"state[{i}]": lambda *_, column=column: -column for i, column in enumerate(columns)}
    for band in bands:
        try:
            system = regressor_and_torque(
                dynamics,
                rig.cell_centre(record.counts),
                torque,
                rig,
                filtering_of(rig, band),
                unknown,
                extra,
                record.valid,
            )
            fit = weighted(dynamics, (*unknown, *extra), [system])
        # too few equations in this band, or unknowns that are not separately identifiable
        except ValueError:
            continue
        if fit.rows >= ENOUGH * len(fit.names):
            fits.append((fit.relative_error, fit.sigma, system, band))
    if not fits:
        return np.zeros(len(columns)), bands
    _, sigma, best, band = min(fits, key=lambda each: each[0])
    weight = 1 / sigma[np.nonzero(best.used)[1]]
    expected = np.hstack([np.zeros((len(columns), len(unknown))), np.diag(1 / (_AT_MOST * usual))])
    rows = np.vstack([best.regressor[best.used] * weight[:, None], expected])
    values = least(rows, np.append(best.torque[best.used] * weight, np.zeros(len(columns))))
    return np.asarray(values[len(unknown) :]), np.array([band])

"""State of a law with memory when its log began.

The torque of such a law can be computed once its state before the log's first sample is known. A
log that begins in the middle of a motion does not contain this state. Yet the state acts on the
torque, and the state of an integral does so as long as the log lasts. Here the torque equation fits
the state together with f, the parameters of the arm, in the directions that the torque shows.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np

from identification.equation_error.filters import BAND_MOST
from identification.equation_error.pulse_fit import BANDS, ENOUGH, filtering_of
from identification.equation_error.regressor import linear, regressor_and_torque
from identification.equation_error.torque_fit import weighted
from identification.equation_error.torque_logs import is_faster, law_torque
from plant import Dynamics, LoggedCurrent, LoggedTorque, Record, Resumed
from plant.laws import AlongLog
from plant.machine import InnerLoop
from plant.parts import Floats, frozen, frozen_settings, least, norm, product, triangle
from plant.simulation import Clock, LawRun, run_from, run_law

# Number of first samples that are not used to find directions of a state: there, the torque made by
# a state looks like the torque of an arm that began elsewhere. `_before` makes as many samples, and
# `passes_start` fits parabolas to one sample more.
FADED = 30


@frozen_settings
class LawMemorySettings:
    """How the state of a law is fitted; chosen by hand.

    A number called relative is a share of the largest magnitude in the run.

    Parameters
    ----------
    alike : int
        Number of first samples that give a straight line, on which the arm is taken to have moved
        before the log.
    closest : int
        Number of first samples that give a parabola, which replaces the line of a joint that bends.
    bent : float
        Largest distance of the counts from their line [pulses] that does not count as a bend.
        Rounding alone makes 1; a joint of log 11 of ``any_rig.py --period 0.005`` is 170 off.
    initial_torque : float
        A change of state is reduced until its largest torque in the first samples exceeds its
        largest later torque by no more than this, relative.
    finer : float
        Ratio of knots of a second reference to those of the first; both are rebuilt from counts.
    hidden : float
        Largest difference between the torques of these two references: its rms, as a share of the
        rms of the torque.
    rounds : int
        Number of fits of the state: where the law saturates, its torque is not linear in its state,
        and one fit does not suffice.
    worse : float
        Largest increase, by a change of the state, of what f leaves of the torque, relative. The
        boost of a computed torque is far from linear: two whole changes took it from 0.7 to 2.5 and
        on to where the law diverged (``tests/identification/search/test_memory.py``).
    halvings : int
        Number of times that a change which leaves more is halved before no change is made.
    flag : float
        A state is taken for a flag if its range in the second half of the log is at most this,
        relative.
    step : float
        Step of the derivatives by the state, as a share of the usual magnitude of the state.
    least_torque : float
        Share of the law's torque that a change of the state by its own size must exceed; otherwise
        the state is not fitted.
    deviation : float
        Expected standard deviation of a state, as a share of `Memory.usual`.
    beside : float
        Margin on each side of the range of a state in the second half of a log, in widths of that
        range. A law whose first state lies outside this margin began with the log.
    """

    alike: int = 10
    closest: int = 6
    bent: float = 1.5
    initial_torque: float = 0.03
    finer: float = 2.2
    hidden: float = 0.005
    rounds: int = 3
    worse: float = 0.01
    halvings: int = 4
    flag: float = 1e-3
    step: float = 1e-4
    least_torque: float = 1e-3
    deviation: float = 2.0
    beside: float = 0.5


SETTINGS = LawMemorySettings()


@frozen
class Memory:
    """Directions in which a law's state before its log shows in the torque.

    `state` (s,): origin of the coordinates. `directions` (s, r): changes of the state, each of
    which makes a torque of 1 N m (rms over the log and all joints); none where the state is known
    or does not show. `usual` (r,): usual size of the state in the log along each direction [N m],
    limited so that no torque exceeds the largest in the log. `noise` (n,): noise of the logged
    torque that determines the state [N m]; then `usual` holds standard deviations. None where no
    logged torque determines it.
    """

    state: Floats
    directions: Floats
    usual: Floats
    noise: Floats | None = None

    @property
    def deviations(self) -> Floats:
        """Standard deviations (r,) of the coordinates before the counts are read [N m]."""
        return self.usual if self.noise is not None else SETTINGS.deviation * self.usual

    @classmethod
    def known(cls, state: Floats) -> Self:
        """A state (s,) that is known exactly, for an arm whose start is not."""
        return cls(state=state, directions=np.zeros((len(state), 0)), usual=np.empty(0))

    def at(self, coordinates: Floats) -> Floats:
        """State (s,) at coordinates (r,) [N m]."""
        return self.state + self.directions @ coordinates


class Resumption(NamedTuple):
    """State of a record's law (s,), and q and qd (2, n) of its arm, at the first sample.

    `deviations` (2, n): standard deviations of q and qd; None where they were not estimated.
    """

    state: Floats
    initial: Floats
    deviations: Floats | None = None


def along_log(record: Record, *, unknown_law: bool = False) -> Record:
    """The record with a law whose torque is known: as logged, or from its own run.

    A record whose law has no memory, or repeats a column, is returned unchanged. Where numbers of
    the law are unknown, a logged torque or current is not used. Fast hardware with a memory resumes
    from a state and stays in the loop, because it feels the arm between samples.
    """
    law = record.law
    if law is None or law.replays or not law.has_memory(record.n):
        return record
    # Fast hardware differentiates its reference between samples, where whole counts stand still.
    rounded = (record.reference_pulses == np.trunc(record.reference_pulses)).all(axis=0)
    moving = np.ptp(record.reference_pulses, axis=0) > 0
    if law.period is None and record.reference is None and (rounded & moving).any():
        raise ValueError(
            f"the reference of a fast {type(law).__name__} must be known between samples, since its"
            " memory is; whole counts leave it open. Give reference=, or the reference without"
            " rounding (reference_position)."
        )
    # A logged torque holds the effect of any state: with it the state need not be known.
    sampled = law.period is not None and not unknown_law
    held = not is_faster(record)
    if sampled and record.torque is not None:
        return replace(record, law=LoggedTorque(held=held))
    if sampled and record.current is not None:
        return replace(record, law=LoggedCurrent(held=held))
    resumed = law
    if not isinstance(resumed, Resumed):
        resumed = Resumed(law=law, state=law.initial_state(record.n))
    if law.period is None:
        return replace(record, law=resumed)
    return reading(record, resumed)


def torque_along_log(record: Record, under_way: bool) -> Floats:
    """Joint torque (N, n) [N m] that a sampled law with memory gives along the counts of its log.

    `under_way`: whether the law was at work before, see `is_under_way`. Its filters then start as
    if counts and reference had moved before the log as they move in its first samples.
    """
    return law_torque(_begun(record, under_way))


def is_under_way(dynamics: Dynamics, record: Record) -> bool:
    """Whether f explains the torque of a sampled law better if the law was at work before its log.

    Of a law that was, filters at rest would take the first counts for a jump. Of a law that began
    with its log, a state as after a motion is wrong, and an observer may keep that error.
    """
    if isinstance(record.law, Resumed):
        return False
    names = linear(dynamics, record.rig, dynamics.names)
    # A band in two octaves suffices to compare.
    bands = BANDS[BAND_MOST / record.rig.period > BANDS][::4]
    least = []
    for under_way in (False, True):
        along = _begun(record, under_way)
        run = run_law(along)
        least.append(min(_unexplained(dynamics, along, names, run, band) for band in bands))
    began, at_work_before = least
    return not began < at_work_before


def _begun(record, under_way):
    """The record with its law reading the log from its first state, or from one under way."""
    along = along_log(record)
    if not under_way:
        return along
    return _moved(along, run_law(_before(along)).states[-1] - along.law.state)


def reading(record: Record, law: Resumed) -> Record:
    """The record with its law reading the log's counts, also where it is fast hardware."""
    return replace(record, law=law.along(record.rig))


def closed(record: Record) -> Record:
    """The record of `along_log`, in which an inner loop reads the simulated arm again.

    An inner loop reads its counts many times per sample, and the steps of its goal bend the motion
    between rows. No state must be fitted for it: its memory begins with the goal and the count at
    the start.
    """
    law = record.law
    if isinstance(law, AlongLog) and isinstance(law.law, InnerLoop):
        return replace(record, law=law.law)
    return record


def with_state(dynamics: Dynamics, record: Record, unknown: Iterable[str]) -> tuple[Record, Memory]:
    """A record whose law has the state that best fits the torque equation, and its uncertainty.

    The law is taken to have been at work before the log. A state that no longer changes in the log
    (a flag that the law has set) starts at its value there. Filters start as if counts and
    reference had moved before the log as they move in its first samples.

    `record`: of `along_log`, with a law that goes on from a state. `unknown`: what is unknown of
    arm and drive.
    """
    law: Any = record.law
    record, usual = at_work(record, law)
    names = linear(dynamics, record.rig, unknown)
    bands = BANDS[BAND_MOST / record.rig.period > BANDS]
    run = run_law(record)
    for _ in range(SETTINGS.rounds):
        # Directions are taken anew in each round: where the law saturates, they depend on its
        # state.
        memory, columns = state_directions(record, run, usual)
        # No direction of the state shows in the torque: there is nothing to fit.
        if not len(columns):
            break
        # The first round chooses a band, and the later rounds keep it.
        fitted = _fitted(dynamics, record, names, run, columns, memory.deviations, bands)
        if fitted is None:
            break
        coordinates, band = fitted
        bands = np.array([band])
        changed = _changed(dynamics, record, names, run, memory.directions @ coordinates, band)
        if changed is None:
            break
        record, run = changed
    begun: Any = record.law
    # The law as it was given, without the log that it read here.
    resumed = replace(record, law=replace(law, state=begun.state))
    return resumed, replace(memory, state=begun.state)


def at_work(record: Record, law: Resumed) -> tuple[Record, Floats]:
    """The record with a law that was at work before it, and usual magnitudes (s,) of its state."""
    record = reading(record, law)
    _require_reference(record)
    # The second half of the log, in which a state that starts with the law has settled.
    states = run_law(record).states
    usual = states[len(states) // 2 :]
    still = np.ptp(usual, axis=0) <= SETTINGS.flag * np.abs(states).max(axis=0)
    # Flags start at their later value, filters as after a motion like the log's first samples.
    begun = np.where(still, np.median(usual, axis=0), run_law(_before(record)).states[-1])
    return _moved(record, begun - law.state), np.abs(usual).max(axis=0)


def passes_start(record: Record, memory: Memory) -> bool:
    """Whether the state of a law that starts with its log comes near its first value again later.

    An integral that begins with the log climbs to the weight of the joint, and stays near it. The
    integral of a law that was at work holds this weight from the start. A light weight cannot be
    distinguished from the changes that friction makes. But when the controller begins to carry a
    weight, the error bends more than in the second half of the log; the answer is then False.
    """
    from scipy.signal import savgol_filter

    law: Any = record.law
    bends = np.abs(savgol_filter(record.error_pulses, FADED + 1, 2, deriv=2, axis=0))
    if (bends[0] > bends[len(bends) // 2 :].max(axis=0)).any():
        return False
    states = run_law(reading(record, law)).states
    usual = states[len(states) // 2 :]
    sizes = np.abs(usual).max(axis=0)
    # The state that makes most of each torque, whatever its unit is.
    shares = np.abs(memory.directions) / np.where(sizes > 0, sizes, np.inf)[:, None]
    places = shares.argmax(axis=0)
    low, high = usual.min(axis=0)[places], usual.max(axis=0)[places]
    begun = law.state[places]
    margin = SETTINGS.beside * (high - low)
    return bool(((begun > low - margin) & (begun < high + margin)).any())


def _before(record):
    """Samples before the record, whose counts and reference lead to its first ones."""
    t = record.rig.period * np.arange(FADED)
    rows = np.flatnonzero(record.valid)[: SETTINGS.alike]
    since = record.t[rows] - record.t[0]
    # The last of these samples is one period before the first of the record.
    back = t - record.rig.period * FADED
    columns = (record.counts, record.reference_pulses)
    counts, reference = (_extended(since, column[rows], back) for column in columns)
    return Record(
        t=t,
        rig=record.rig,
        law=record.law,
        reference_pulses=reference,
        error_pulses=reference - counts,
    )


def _extended(since, column, back):
    """Whole counts (N, n) at times `back`, which lead to those of a column (s, n) at `since`."""
    polynomial = np.polynomial.polynomial
    line = polynomial.polyfit(since, column, 1)
    # The line leads to the first of these samples, which may be later than the log's first.
    counts = column[0] + line[1] * (back[:, None] - since[0])
    # A joint whose counts visibly bend (long samples, fine encoder) also moved on a bend before.
    bent = np.abs(polynomial.polyval(since, line).T - column).max(axis=0) > SETTINGS.bent
    first = slice(SETTINGS.closest)
    parabola = polynomial.polyfit(since[first], column[first], 2)
    return np.rint(np.where(bent, polynomial.polyval(back, parabola).T, counts))


def _require_reference(record):
    """Refuse a law whose torque depends on digits that the rounding of its reference hides."""
    if record.reference is not None:
        return
    # A smoother and a rougher curve through the same counts: if the law gives them different
    # torques, the torque of the true reference differs from both.
    torque = run_law(record).given
    finer = run_law(record, SETTINGS.finer).given
    hidden = np.sqrt(np.mean((finer - torque) ** 2) / np.mean(torque**2))
    if hidden > SETTINGS.hidden:
        law = record.law
        raise ValueError(
            f"the torque of {type(law.law).__name__} must follow from reference and counts; whole"
            f" counts of the reference leave {hidden:.1%} of it open. Give reference=, the"
            " reference without rounding (reference_position), or the torque."
        )


def _moved(record, change):
    law = record.law
    return replace(record, law=replace(law, state=law.state + change))


def state_directions(
    record: Record, run: LawRun, scale: Floats, *, faded: int = FADED
) -> tuple[Memory, Floats]:
    """Directions of a state whose elements have these magnitudes (s,), and their torques (r, N, n).

    `faded`: number of first samples that are not used to find directions; if they were used, the
    memory of a filter would appear as a direction.
    """
    # 1. Torque by each state, from runs of the law along the log.
    clock = Clock.of(record)
    period = record.rig.period
    law: Any = record.law
    t = clock.t[clock.rows]
    torque = run.around(t, period)
    # A state that was zero throughout has no magnitude to be varied by.
    varied = np.flatnonzero(scale)
    by_state = [np.zeros(0)]
    step = SETTINGS.step
    for run_beside in run_from(record, law.state + step * np.diag(scale)[varied]):
        by_state.append((run_beside.around(t, period) - torque).ravel() / step)
    effects = np.reshape(np.concatenate(by_state), (-1, torque.size)).T

    # 2. A filter's memory acts at once and could saturate the law: reduce such changes of state.
    parts = np.split(effects, [faded * record.n])
    initial, later = (np.abs(part).max(axis=0, initial=0.0) for part in parts)
    fading = np.maximum(initial - later, 1e-12)
    share = np.minimum(1.0, SETTINGS.initial_torque * np.abs(torque).max() / fading)
    effects = effects * share
    scale = scale.copy()
    scale[varied] *= share

    # 3. Principal directions that the torque shows, each scaled to a torque of 1 N m.
    _, sizes, axes = np.linalg.svd(triangle(effects[faded * record.n :]))
    shown = sizes > SETTINGS.least_torque * norm(torque)
    unit = np.sqrt(torque.size) / sizes[shown]
    directions = np.zeros((len(scale), shown.sum()))
    directions[varied] = scale[varied, None] * axes[shown].T * unit
    columns = (product(effects, axes[shown].T) * unit).T.reshape(-1, *torque.shape)

    # 4. Usual sizes of the state in the log, limited so that no torque exceeds the log's largest.
    largest = unit
    if len(columns):
        largest = np.abs(torque).max() / np.abs(columns).max(axis=(1, 2), initial=0.0)
    usual = np.minimum(1 / unit, largest)
    return Memory(state=np.array(law.state), directions=directions, usual=usual), columns


def _changed(dynamics, record, unknown, run, change, band):
    """The record and its run after a change of the law's state (s,), or after a part of the change.

    None where each part leaves more of the torque unexplained than no change.
    """
    most = (1 + SETTINGS.worse) * _unexplained(dynamics, record, unknown, run, band)
    for halving in range(SETTINGS.halvings + 1):
        moved = _moved(record, change / 2**halving)
        beside = run_law(moved)
        if _unexplained(dynamics, moved, unknown, beside, band) <= most:
            return moved, beside
    return None


def _unexplained(dynamics, record, unknown, run, band):
    """Share of the torque of a run that f leaves; infinite where the law diverges, or none fits."""
    if not np.isfinite(run.given).all():
        return np.inf
    try:
        equations = _equations(dynamics, record, unknown, run, band)
        return weighted(dynamics, tuple(unknown), [equations]).relative_error
    except ValueError:
        # Too few equations in this band, or unknowns that are not separately identifiable.
        return np.inf


def _equations(dynamics, record, unknown, run, band, columns=()):
    """The torque equation of a run in one band, with the torques of a state (r, N, n) beside f."""
    rig = record.rig
    # The law's torque contains the torque of the state. As an unknown, that torque moves to the
    # other side of the equation, and its sign changes.
    extra = {f"state[{i}]": lambda *_, column=column: -column for i, column in enumerate(columns)}
    return regressor_and_torque(
        dynamics,
        rig.cell_centre(record.counts),
        law_torque(record, run),
        rig,
        filtering_of(rig, band),
        unknown,
        extra,
        record.valid,
    )


def _fitted(dynamics, record, unknown, run, columns, deviations, bands):
    """Coordinates (r,) [N m] that fit best with their deviations as a prior, and the band used.

    None where no band has equations enough.
    """
    names = (*unknown, *(f"state[{i}]" for i in range(len(columns))))
    fits = []
    for band in bands:
        try:
            system = _equations(dynamics, record, unknown, run, band, columns)
            fit = weighted(dynamics, names, [system])
        except ValueError:
            # Too few equations in this band, or unknowns that are not separately identifiable.
            continue
        if fit.rows >= ENOUGH * len(fit.names):
            fits.append((fit.relative_error, fit.sigma, system, band))
    if not fits:
        return None
    _, sigma, best, band = min(fits, key=lambda fit: fit[0])

    # Solve the same equations again, with the deviations of the state as a prior. Each equation is
    # divided by the scatter of its joint, so that equations and prior have the same unit: one
    # standard deviation.
    weight = 1 / sigma[np.nonzero(best.used)[1]]
    expected = np.hstack([np.zeros((len(columns), len(unknown))), np.diag(1 / deviations)])
    rows = np.vstack([best.regressor[best.used] * weight[:, None], expected])
    values = least(rows, np.append(best.torque[best.used] * weight, np.zeros(len(columns))))
    return values[len(unknown) :], band

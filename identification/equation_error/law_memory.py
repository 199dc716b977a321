"""State of a law with memory when its log began.

The torque of such a law follows once its state before the log's first sample is known. That state
is not in a log that begins in the middle of a motion; but it acts on the torque, an integral for as
long as the log lasts. Here it is fitted together with f, by the torque equation, in the directions
that the torque shows.
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
from plant.laws.resumed import AlongLog
from plant.machine.inner_loop import InnerLoop
from plant.parts import Floats, frozen, frozen_settings
from plant.parts.sums import least, norm, product, triangle
from plant.simulation.clock import Clock
from plant.simulation.law_run import LawRun, run_from, run_law

# Samples after which the effect of a state on the torque counts; before them it looks as if the arm
# had begun elsewhere.
FADED = 30


@frozen_settings
class LawMemorySettings:
    """How the state of a law is fitted; chosen by hand.

    Relative numbers are shares of the largest magnitude in the run.

    Parameters
    ----------
    alike : int
        First samples of a log, on whose straight line the arm is taken to have moved before it.
    closest : int
        The first of them, on whose parabola it has moved where it bends.
    bent : float
        Largest distance of the counts from their line [pulses] that is no bend. Rounding alone
        makes 1; a joint of log 11 of ``any_rig.py --period 0.005`` is 170 off.
    initial_torque : float
        Largest torque that a change of state makes in the first samples alone, relative.
    finer : float
        Ratio of knots in a second reference that is rebuilt from counts, to compare torques.
    hidden : float
        Largest share of the torque that these two references may differ by.
    rounds : int
        Fits of the state: a law that saturates is not linear in it.
    flag : float
        Change in the second half of a log up to which a state is a flag, relative.
    step : float
        Step of the derivatives by the state, relative.
    least_torque : float
        Share of the torque that a state must make, for a change of its own size, to be fitted.
    deviation : float
        Expected standard deviation of a state, relative.
    beside : float
        Distance from the range of a state in the second half of a log, in widths of that range,
        from which on the law began with the log.
    """

    alike: int = 10
    closest: int = 6
    bent: float = 1.5
    initial_torque: float = 0.03
    finer: float = 2.2
    hidden: float = 0.005
    rounds: int = 3
    flag: float = 1e-3
    step: float = 1e-4
    least_torque: float = 1e-3
    deviation: float = 2.0
    beside: float = 0.5


SETTINGS = LawMemorySettings()


@frozen
class Memory:
    """Directions in which a law's state before its log shows in the torque.

    `state` (s,): from which they are counted. `directions` (s, r): changes of the state, each of
    which makes a torque of 1 N m (rms over the log and all joints); none where the state is known,
    or does not show. `usual` (r,): how far states are apart in the log, along each [N m], with
    torques of no more than its largest. `noise` (n,): of a logged torque that tells the state
    [N m]; the usual distances are standard deviations by it. None where no torque tells it.
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
        """A state (s,) that is not in doubt, beside a start of the arm that is."""
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

    Of a law without memory, or one that repeats a column, it is returned as it is. Where numbers of
    the law are unknown, what was logged is left aside. Fast hardware with a memory goes on from a
    state, in the loop: between samples it feels the arm.
    """
    law = record.law
    if law is None or law.replays or not law.has_memory(record.n):
        return record
    # Fast hardware differentiates its reference between samples, where whole counts stand still.
    rounded = (record.reference_pulses == np.trunc(record.reference_pulses)).all()
    moving = np.ptp(record.reference_pulses) > 0
    if law.period is None and record.reference is None and rounded and moving:
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


def reading(record: Record, law: Resumed) -> Record:
    """The record with its law reading the log's counts, also where it is fast hardware."""
    return replace(record, law=law.along(record.rig))


def closed(record: Record) -> Record:
    """The record of `along_log` with an inner loop in the loop again, which reads the arm itself.

    It reads its counts many times in a sample, and steps of its goal bend the motion between rows;
    its memory begins by itself, with the goal and the count of the log's start.
    """
    law = record.law
    if isinstance(law, AlongLog) and isinstance(law.law, InnerLoop):
        return replace(record, law=law.law)
    return record


def with_state(dynamics: Dynamics, record: Record, unknown: Iterable[str]) -> tuple[Record, Memory]:
    """A record with its law in the state of best torque equation, and that state's uncertainty.

    It had been at work for a while: a state that no longer changes in the log (a flag that the law
    has begun) has its value there, and filters have followed counts and reference as they go on.

    `record`: of `along_log`, with a law that goes on from a state. `unknown`: what is unknown of
    arm and drive.
    """
    law: Any = record.law
    record, usual = at_work(record, law)
    names = linear(dynamics, record.rig, unknown)
    bands = BANDS[BAND_MOST / record.rig.period > BANDS]
    for _ in range(SETTINGS.rounds):
        run = run_law(record)
        # Directions are taken anew in each round: where the law saturates, they depend on its
        # state.
        memory, columns = state_directions(record, run, usual)
        # No direction of the state shows in the torque: there is nothing to fit.
        if not len(columns):
            break
        # The first round chooses a band, and the later rounds keep it.
        coordinates, bands = _fitted(
            dynamics, record, names, run, columns, memory.deviations, bands
        )
        change = memory.directions @ coordinates
        record = _moved(record, change)
        memory = replace(memory, state=memory.state + change)
    # The law as it was given, without the log that it read here.
    return replace(record, law=replace(law, state=memory.state)), memory


def at_work(record: Record, law: Resumed) -> tuple[Record, Floats]:
    """The record with a law that was at work before it, and usual magnitudes (s,) of its state."""
    record = reading(record, law)
    _require_reference(record)
    # The second half of the log, in which a state that starts with the law has settled.
    states = run_law(record).states
    usual = states[len(states) // 2 :]
    still = np.ptp(usual, axis=0) <= SETTINGS.flag * np.abs(states).max(axis=0)
    # Flags as they are later in the log, filters as after a motion like its first samples.
    begun = np.where(still, np.median(usual, axis=0), run_law(_before(record)).states[-1])
    return _moved(record, begun - law.state), np.abs(usual).max(axis=0)


def passes_start(record: Record, memory: Memory) -> bool:
    """Whether a law's state moves, later in its log, about where it would have begun with the log.

    An integral that begins with the log climbs to the weight of the joint, and stays about there.
    One that was at work has this weight already. A light weight lies within what friction changes;
    but where the controller begins to carry it, errors bend more than they ever do later.
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
    counts = column[0] + line[1] * back[:, None]
    # A joint that a long sample, or a fine encoder, shows to bend has bent before, too.
    bent = np.abs(polynomial.polyval(since, line).T - column).max(axis=0) > SETTINGS.bent
    first = slice(SETTINGS.closest)
    parabola = polynomial.polyfit(since[first], column[first], 2)
    return np.rint(np.where(bent, polynomial.polyval(back, parabola).T, counts))


def _require_reference(record):
    """Refuse a law whose torque depends on digits that the rounding of its reference hides."""
    if record.reference is not None:
        return
    # A smoother and a rougher curve through the same counts: if the law tells them apart, the true
    # reference gave another torque than either.
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
    """Directions of states of these magnitudes (s,), and the torques (r, N, n) that each makes.

    `faded`: samples whose torque shows no direction; without them a filter's memory is one.
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

    # 2. A filter's memory acts at once, and would saturate: such changes are made smaller.
    parts = np.split(effects, [faded * record.n])
    initial, later = (np.abs(part).max(axis=0, initial=0.0) for part in parts)
    fading = np.maximum(initial - later, 1e-12)
    share = np.minimum(1.0, SETTINGS.initial_torque * np.abs(torque).max() / fading)
    effects = effects * share
    scale = scale.copy()
    scale[varied] *= share

    # 3. Principal directions of the torque, those that it shows, scaled to 1 N m.
    _, sizes, axes = np.linalg.svd(triangle(effects[faded * record.n :]))
    shown = sizes > SETTINGS.least_torque * norm(torque)
    unit = np.sqrt(torque.size) / sizes[shown]
    directions = np.zeros((len(scale), shown.sum()))
    directions[varied] = scale[varied, None] * axes[shown].T * unit
    columns = (product(effects, axes[shown].T) * unit).T.reshape(-1, *torque.shape)

    # 4. States as far apart as in the log, with torques of no more than its largest.
    largest = unit
    if len(columns):
        largest = np.abs(torque).max() / np.abs(columns).max(axis=(1, 2), initial=0.0)
    usual = np.minimum(1 / unit, largest)
    return Memory(state=np.array(law.state), directions=directions, usual=usual), columns


def _fitted(dynamics, record, unknown, run, columns, deviations, bands):
    """Coordinates (r,) [N m] of the least residual beside their deviations, and its band."""
    rig = record.rig
    torque = law_torque(record, run)
    fits = []
    # The torque of a state is measured with the law's: it stands on the other side of the equation.
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
        except ValueError:
            # Too few equations in this band, or unknowns that are not separately identifiable.
            continue
        if fit.rows >= ENOUGH * len(fit.names):
            fits.append((fit.relative_error, fit.sigma, system, band))
    if not fits:
        return np.zeros(len(columns)), bands
    _, sigma, best, band = min(fits, key=lambda fit: fit[0])

    # The same equations again, with the deviations of the state as a prior beside them.
    # Each equation by the scatter of its joint, so that the prior has the same unit: one standard
    # deviation.
    weight = 1 / sigma[np.nonzero(best.used)[1]]
    expected = np.hstack([np.zeros((len(columns), len(unknown))), np.diag(1 / deviations)])
    rows = np.vstack([best.regressor[best.used] * weight[:, None], expected])
    values = least(rows, np.append(best.torque[best.used] * weight, np.zeros(len(columns))))
    return values[len(unknown) :], np.array([band])

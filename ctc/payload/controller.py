"""The running controller of a payload estimator: collect, identify, swap."""

import dataclasses
import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from identification.payload import PayloadEstimate, Window, shared_worker
from plant.parts import Floats, Piece, Shown, frozen_settings
from plant.realtime import Running


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PayloadEvent(Shown):
    """A change of the load, as it was detected and as it was identified.

    `time` of its detection [s], counted in periods from the start; 0 for the load at the start.
    `kind`: "start", "taken", "dropped" or "changed". `before`: mass in the model before [kg].
    `after`: identified mass [kg]; NaN until then. `swapped`: time of the swap of the model [s]; NaN
    until then. `windows`: number of windows evaluated. `message`: of the last window; those of
    earlier ones stated why they were not used.
    """

    time: float
    kind: str
    before: float
    after: float = float("nan")
    swapped: float = float("nan")
    windows: int = 0
    message: str = "collecting"

    def _short(self) -> str:
        return f"{self.time:.3f} s, {self.kind}, {self.before:.3g} -> {self.after:.3g} kg"

    def _shown(self) -> Iterator[Piece]:
        yield self._short()
        yield f"{self.windows} windows; the last: {self.message}"


@frozen_settings
class StageSettings:
    """Times and thresholds of the stages; chosen by hand, tested by tests/benchmarks/payload.py.

    Parameters
    ----------
    settling_time : float
        Time after the start [s] in which the observers settle: nothing is collected, and no change
        is looked for.
    retry_share : float
        Share of a window after which the next one is evaluated, where one was not sufficient.
    swap_alarm : float
        Increase of the alarm's limit just after a swap, as a share of it: friction that differs
        comes back into the observer.
    swap_alarm_time : float
        Time constant with which that increase decays [s].
    lead : float
        Lead of a loop over the clock [s] above which it is a simulation, and waits for its answer.
    patience : float
        Longest such wait [s].
    empty_share : float
        Share of the heaviest load below which a gripper counts as empty.
    """

    settling_time: float = 0.1
    retry_share: float = 0.25
    swap_alarm: float = 2.0
    swap_alarm_time: float = 0.05
    lead: float = 5e-3
    patience: float = 60.0
    empty_share: float = 0.1


SETTINGS = StageSettings()


class PayloadController:
    """A running controller that estimates its load; made by `PayloadEstimator.start`.

    Attributes
    ----------
    load : PayloadEstimate
        The present estimate: ``.mass``, ``.std``, ``.interval``; ``.sufficient`` says whether the
        model has it or holds the prior, and ``.message`` why.
    events : list of PayloadEvent
        Changes of the load, with times and masses before and after; the first is the load at the
        start.
    stage : str
        "settling", "collecting", "identifying" or "holding".
    running : Running
        The running control law: ``.torque``, ``.status``, ``.stopped`` and the rest.
    change : float
        The statistic on which changes are detected; `PayloadEstimator.alarm` is its limit.
    """

    def __init__(self, estimator: Any, running: Running) -> None:
        self.estimator = estimator
        self.running = running
        # Views of the running state: to write `wanted` is to swap the model at the next step.
        state = running.core.law_state(running.n)
        places = estimator.loop_law.places(running.n)
        self._wanted = _view(state, places["wanted"])
        self._change = _view(state, places["change"])
        self._samples = estimator.specification.samples
        self.period = running.period
        # One sample more than a window: the torque of the sample before it acts at its start.
        self._counts = np.zeros((self._samples + 1, running.n))
        self._torque = np.zeros_like(self._counts)
        self._worker: Any = None
        # A process of its own keeps the identification from delaying a call of this loop.
        # Estimators are compiled here, before the loop starts.
        if estimator.beside:
            self._worker = shared_worker()
            self._number = self._worker.prepare(estimator.specification)
        else:
            self._find = estimator.specification.made()
        self._begin()

    def _begin(self) -> None:
        self._calls = 0
        self._settled_at = round(SETTINGS.settling_time / self.period)
        self._job = -1
        self._swapped = 0
        self._bridged = 0
        self.stage = "settling"
        self.load = self.estimator.prior
        self.events: list[PayloadEvent] = []

    def reset(self, pulses: ArrayLike) -> None:
        """Start anew, as `Running.reset`: with the prior, and without events."""
        self.running.reset(pulses)
        self._begin()

    @property
    def change(self) -> float:
        return float(self._change[0])

    @property
    def torque(self) -> Floats:
        """Joint torque of the last call (n,) [N m]."""
        return self.running.torque

    @property
    def status(self) -> str:
        """As of `Running`."""
        return self.running.status

    @property
    def stopped(self) -> bool:
        """As of `Running`."""
        return self.running.stopped

    def step(self, *arguments: Any, **options: Any) -> Floats:
        """Torque to apply until the next call, as `Running.step`; call it once per period."""
        torque = self.running.step(*arguments, **options)
        # The buffers are rings, so that a step allocates nothing.
        row = self._calls % len(self._counts)
        self._counts[row] = self.running.pulses
        self._torque[row] = torque
        self._calls += 1
        if not self.running.stopped:
            self._proceed()
        return torque

    # -- the stages -------------------------------------------------------------------------------
    def _proceed(self) -> None:
        if self.stage == "holding":
            # A swap restarts the observer, and friction that differs from the model enters it
            # again: the limit starts high and decays to its value.
            since = (self._calls - self._swapped) * self.period
            increase = SETTINGS.swap_alarm * math.exp(-since / SETTINGS.swap_alarm_time)
            if abs(self.change) > self.estimator.alarm * (1 + increase):
                kind = "taken" if self.change > 0 else "dropped"
                self._begin_event((self._calls - 1) * self.period, kind)
                # The model returns to the prior: the previous load is wrong from now on.
                self.load = self.estimator.prior
                self._wanted[:] = self.load.parameters
        elif self.stage == "settling":
            if self._calls > self._settled_at:
                self._begin_event(0.0, "start")
        elif self.stage == "collecting":
            # A late or lost sample leaves a gap in the window, which then begins anew: kernels
            # smooth counts at equal steps.
            if self.running.bridged != self._bridged:
                self._collect(self._samples)
            elif self._calls >= self._full:
                self._identify()
        else:
            self._await()

    def _collect(self, samples: int) -> None:
        self.stage = "collecting"
        self._full = self._calls + samples
        self._bridged = self.running.bridged

    def _begin_event(self, seconds: float, kind: str) -> None:
        """Record a change of the load at that time, and collect a full window."""
        self.events.append(PayloadEvent(time=seconds, kind=kind, before=float(self._wanted[0])))
        self._collect(self._samples)

    def _identify(self) -> None:
        order = np.arange(self._calls - self._samples - 1, self._calls) % len(self._counts)
        # Indices sort the ring by time; fancy indexing copies, so that the following steps may
        # overwrite the ring while the estimator works.
        counts = self._counts[order]
        torque = self._torque[order]
        window = Window(counts[1:], torque[1:], torque[0])
        if self._worker is None:
            self._identified(self._find(window))
        else:
            self._job = self._worker.submit(self._number, window)
            self._submitted_call = self._calls
            self._submitted_time = time.perf_counter()
            self.stage = "identifying"

    def _await(self) -> None:
        """Take the estimate when it is there.

        Only a loop that is ahead of the clock waits for it, never one that the clock paces.
        """
        # A simulation runs faster than the clock: without waiting, it would be over before the
        # estimate arrives. A loop on a robot must never wait.
        loop_time = (self._calls - self._submitted_call) * self.period
        if loop_time - (time.perf_counter() - self._submitted_time) > SETTINGS.lead:
            estimate = self._worker.wait(self._job, SETTINGS.patience)
        else:
            estimate = self._polled()
        if estimate is not None:
            self._identified(estimate)

    def _polled(self) -> PayloadEstimate | None:
        """The answer, if it is there; the prior, with the reason, if there will be none."""
        try:
            estimate: PayloadEstimate | None = self._worker.poll(self._job)
        except ValueError as error:
            # A loop on a robot must go on where its estimator fails or its process has ended.
            return dataclasses.replace(self.estimator.prior, message=str(error))
        return estimate

    def _identified(self, estimate: PayloadEstimate) -> None:
        event = self.events[-1]
        event = dataclasses.replace(event, windows=event.windows + 1, message=estimate.message)
        self.load = estimate
        if estimate.sufficient:
            self._wanted[:] = estimate.parameters
            event = dataclasses.replace(
                event,
                kind=self._kind(event, estimate.mass),
                after=estimate.mass,
                swapped=self._calls * self.period,
            )
            self.stage = "holding"
            self._swapped = self._calls
        else:
            # The model keeps the prior that it holds already; only the reason is new.
            self.load = dataclasses.replace(self.estimator.prior, message=estimate.message)
            # A window that the model explains may become sufficient with a few more samples. Any
            # other may hold the change itself, so that none of its samples is used again.
            share = SETTINGS.retry_share if estimate.explained else 1
            self._collect(round(share * self._samples))
        self.events[-1] = event

    # What counts as empty depends on the heaviest load, not on the precision of the estimate.
    def _kind(self, event: PayloadEvent, mass: float) -> str:
        empty = SETTINGS.empty_share * self.estimator.shape.mass[1]
        if event.kind == "start":
            return "start"
        if mass <= empty < event.before:
            return "dropped"
        return "taken" if event.before <= empty < mass else "changed"


def _view(state: Floats, place: range) -> Floats:
    """View of the numbers of a field in the state, so that writing them changes the state."""
    return state[place.start : place.stop]

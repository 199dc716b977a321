"""The running controller of a payload estimator, and the three stages around it."""

import dataclasses
import math
import time
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.payload.kernel_estimate import Window
from identification.payload.posterior import PayloadEstimate
from identification.payload.worker import Worker, shared_worker
from plant.parts.shown import Piece, Shown
from plant.realtime.running import Running


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PayloadEvent(Shown):
    """A change of the load, as it was detected and as it was identified.

    `time`: when it was detected [s], counted in periods from the start; 0 for the load at the
    start. `kind`: "start", "taken", "dropped" or "changed". `before`: mass in the model before
    [kg]. `after`: mass that was identified [kg]; NaN until then. `swapped`: when the model was
    swapped to it [s]; NaN until then. `windows`: that were evaluated; of those before the last the
    message stated why they were not used. `message`: of the last window.
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


# from the start, in which nothing is collected and no change is looked for: the observers settle
# [s]
_SETTLE = 0.1
# share of a window after which, where one was not sufficient, the next one is evaluated
_AGAIN = 0.25
# By how much the alarm's limit is higher just after a swap, as a share, and how fast that passes
# [s]: friction that differs comes back into the observer.
_FRESH = 2.0
_FRESH_TIME = 0.05

# a loop that is so far ahead of the clock is a simulation, and waits for its answer [s]
_AHEAD = 5e-3
_PATIENCE = 60.0  # for how long it would [s]
_EMPTY = 0.1  # share of the heaviest load below which a gripper counts as empty


class PayloadController:
    """A running controller that estimates its load; made by `PayloadEstimator.start`.

    Attributes
    ----------
    load : PayloadEstimate
        What is known of the load now: ``.mass``, ``.std``, ``.interval``; ``.sufficient`` says
        whether the model has it or holds the prior, and ``.message`` why.
    events : list of PayloadEvent
        What happened, with times, masses before and after; the first is the load at the start.
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
        places = estimator.loop_law.places(running.n)
        state = running.core.law_state(running.n)
        self._wanted, self._change = (
            state[places[name].start : places[name].stop] for name in ("wanted", "change")
        )
        self._samples = estimator.specification.samples
        self.period = running.period
        self._counts, self._torque = np.zeros((2, self._samples + 1, running.n))
        self._worker: Worker | None = None
        if estimator.beside:
            self._worker = shared_worker()
            self._number = self._worker.prepare(estimator.specification)
        else:
            self._find = estimator.specification.made()
        self._begin()

    def _begin(self) -> None:
        self._calls, self._from, self._job, self._swapped = 0, round(_SETTLE / self.period), -1, 0
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
    def torque(self) -> NDArray[np.float64]:
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

    def step(self, *arguments: Any, **options: Any) -> NDArray[np.float64]:
        """Torque to be applied until the next call, as `Running.step`; to be called once per
        period.
        """
        torque = self.running.step(*arguments, **options)
        row = self._calls % len(self._counts)
        self._counts[row], self._torque[row] = self.running.pulses, torque
        self._calls += 1
        if not self.running.stopped:
            self._proceed()
        return torque

    # -- the stages -------------------------------------------------------------------------------
    def _proceed(self) -> None:
        if self.stage == "holding":
            since = (self._calls - self._swapped) * self.period
            if abs(self._change[0]) > self.estimator.alarm * (
                1 + _FRESH * math.exp(-since / _FRESH_TIME)
            ):
                self._detected(float(self._change[0]))
        elif self.stage == "settling":
            if self._calls > self._from:
                self.events.append(
                    PayloadEvent(time=0.0, kind="start", before=float(self._wanted[0]))
                )
                self._collect(self._samples)
        elif self.stage == "collecting":
            # a sample was late or lost: the window would lie
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

    def _detected(self, change: float) -> None:
        """A change: the model goes back to the prior, and a window begins."""
        kind = "taken" if change > 0 else "dropped"
        now = (self._calls - 1) * self.period
        self.events.append(PayloadEvent(time=now, kind=kind, before=float(self._wanted[0])))
        self.load = self.estimator.prior
        self._wanted[:] = self.load.parameters
        self._collect(self._samples)

    def _identify(self) -> None:
        order = np.arange(self._calls - self._samples - 1, self._calls) % len(self._counts)
        counts = self._counts[order]
        torque = self._torque[order]
        window = Window(counts[1:], torque[1:], torque[0])
        if self._worker is None:
            self._identified(self._find(window))
        else:
            self._job = self._worker.submit(self._number, window)
            self._asked = self._calls, time.perf_counter()
            self.stage = "identifying"

    def _await(self) -> None:
        """Take the answer when it is there; a loop ahead of the clock waits for it, one paced by
        it never does.
        """
        worker, (calls, asked) = cast(Worker, self._worker), self._asked
        ahead = (self._calls - calls) * self.period - (time.perf_counter() - asked)
        if ahead > _AHEAD:
            self._identified(worker.wait(self._job, _PATIENCE))
        elif (answer := worker.poll(self._job)) is not None:
            self._identified(answer)

    def _identified(self, estimate: PayloadEstimate) -> None:
        event = dataclasses.replace(
            self.events[-1], windows=self.events[-1].windows + 1, message=estimate.message
        )
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
            self.load = dataclasses.replace(self.estimator.prior, message=estimate.message)
            self._collect(round(_AGAIN * self._samples) if estimate.explained else self._samples)
        self.events[-1] = event

    def _kind(self, event: PayloadEvent, after: float) -> str:
        empty = _EMPTY * self.estimator.shape.mass[1]
        if event.kind == "start":
            return "start"
        if after <= empty < event.before:
            return "dropped"
        return "taken" if event.before <= empty < after else "changed"

"""A law run along a log: its torque follows from reference, counts and its previous memory.

A law steps at its own period; one without a period is stepped four times per sample.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from plant.laws import FAST, AlongLog
from plant.logs import Record
from plant.parts import Floats, Frozen, frozen
from plant.simulation.clock import Clock
from plant.simulation.followed_path import Logged, path_of


@frozen
class LawRun(Frozen):
    """Steps of a law along a log."""

    # Times (K,) of the steps, from the log's first sample [s].
    t: Floats
    # Joint torque (K, n) after the amplifier's limit [N m], held to the next step.
    given: Floats
    # Memory (K, s) of the law after each step.
    states: Floats

    def around(self, t: Floats, width: float) -> Floats:
        """Mean torque (N, n) [N m] over a time `width` [s] around each of the times t (N,) [s]."""
        # The last torque is held for one more step, and beyond the end of every window.
        last = self.t[-1] - self.t[-2] if len(self.t) > 1 else width
        ends = np.append(self.t, self.t[-1] + width + last)
        # A mean is the difference of the torque's integral over the window's length.
        impulse = np.cumsum(np.diff(ends)[:, None] * self.given, axis=0)
        integral = np.vstack([np.zeros(self.given.shape[1]), impulse])
        # A window at the start of the log is shorter.
        low = np.maximum(t - width / 2, 0.0)
        high = t + width / 2
        means = [
            (np.interp(high, ends, joint) - np.interp(low, ends, joint)) / (high - low)
            for joint in integral.T
        ]
        return np.column_stack(means)


def run_law(record: Record, finer: float = 1.0) -> LawRun:
    """Run the law of a record, an `AlongLog`, along its reference and its counts.

    A reference that is rebuilt from commanded counts has `finer` times as many knots.
    """
    law = record.law
    return next(run_from(record, [getattr(law, "state", None)], finer))


def run_from(record: Record, states: Iterable[Any], finer: float = 1.0) -> Iterator[LawRun]:
    """Runs as of `run_law`, one from each of some states (s,) of the law."""
    law = record.law
    rig = record.rig
    if not isinstance(law, AlongLog):
        raise ValueError(
            f"the law must be AlongLog; got {type(law).__name__}. Give AlongLog(law=, state=)."
        )
    clock = Clock.of(record)
    path = path_of(record, clock, smooth=not law.rounds)
    # A law without a period is stepped so often that its steps hardly matter.
    period = law.period or rig.period / FAST
    steps = int(np.floor(clock.t[clock.rows[-1]] / period + 1e-6)) + 1
    t = np.asarray(period * np.arange(steps), dtype=np.float64)
    motion = path.smoothed(t, finer) if isinstance(path, Logged) else path.setpoint(t)
    # The law reads what its controller read: the motion, commanded counts, and its own counts.
    columns = *motion, path(t)[1], clock.between(law.replayed(record), t)
    for torque, memory in law.steps(rig, columns, period, states):
        yield LawRun(t=t, given=torque, states=memory)

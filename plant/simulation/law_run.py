"""A law run along a log: the torque that it commanded follows from reference and counts, and from its memory before.

A law steps at its own period; one without a period is stepped four times per sample.
"""

import dataclasses
import functools
from collections.abc import Iterable, Iterator
from typing import Any

import casadi as ca
import numpy as np

from plant.laws.resumed import AlongLog
from plant.logs.record import Record
from plant.parts.checked_function import evaluated
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.simulation.clock import Clock
from plant.simulation.followed_path import Logged, path_of

_FAST = 4
"""Steps per sample of a law without a period."""

_AT_ONCE = 1000  # steps of a law in one call


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LawRun(Frozen):
    """Steps of a law along a log, at times t (K,) from its first sample [s].

    Each has `given` (K, n), joint torque after the amplifier's limit [N m], held to the next step, and leaves the law
    with the memory `states` (K, s).
    """

    t: Floats
    given: Floats
    states: Floats

    def around(self, t: Floats, width: float) -> Floats:
        """Mean (N, n) [N m] of the torque given over a time `width` [s] around each of the times t (N,) [s]."""
        ends = np.append(self.t, self.t[-1] + width + (self.t[-1] - self.t[-2] if len(self.t) > 1 else width))
        done = np.vstack([np.zeros(self.given.shape[1]), np.cumsum(np.diff(ends)[:, None] * self.given, axis=0)])
        low, high = np.maximum(t - width / 2, 0.0), t + width / 2
        means = [(np.interp(high, ends, own) - np.interp(low, ends, own)) / (high - low) for own in done.T]
        return np.column_stack(means)


def run_law(record: Record, finer: float = 1.0) -> LawRun:
    """Run the law of a record, an `AlongLog`, along its reference and its counts.

    A reference that is rebuilt from commanded counts has `finer` times as many knots.
    """
    law: Any = record.law
    return next(run_from(record, [getattr(law, "state", None)], finer))


def run_from(record: Record, states: Iterable[Any], finer: float = 1.0) -> Iterator[LawRun]:
    """The same runs from each of some states (s,) of the law."""
    law, rig = record.law, record.rig
    if not isinstance(law, AlongLog):
        raise ValueError(f"the law must be AlongLog; got {type(law).__name__}. Give AlongLog(law=, state=).")
    block, clock = law.block(rig), Clock.of(record)
    path, period = path_of(record, clock, smooth=not law.rounds), law.period or rig.period / _FAST
    t = np.asarray(period * np.arange(int(np.floor(clock.t[clock.rows[-1]] / period + 1e-6)) + 1), dtype=np.float64)
    motion = path.smoothed(t, finer) if isinstance(path, Logged) else path.setpoint(t)
    counts, n, s = clock.between(law.replayed(record), t), rig.n, len(block.initial)
    along, blocks = _repeated(_step(block, rig).serialize()), -(-len(t) // _AT_ONCE)
    rows = np.minimum(np.arange(blocks * _AT_ONCE), len(t) - 1).reshape(blocks, -1)  # the last one is filled up
    columns = *motion, path(t)[1], counts, np.full((len(t), 1), period)
    own = len(block.values) - len(rig.number_values())
    for state in states:
        numbers = np.concatenate([block.values[: own - s + 1], state, block.values[own:]])
        carried, last = np.empty((rows.size, s + n)), np.concatenate([block.initial, np.zeros(n)])
        for some in rows:
            first = some[0]
            (done,) = evaluated(along, last, *(part[some] for part in columns), np.tile(numbers, (_AT_ONCE, 1)))
            carried[first : first + _AT_ONCE], last = done, done[-1]
        yield LawRun(t=t, given=carried[: len(t), s:], states=carried[: len(t), : s - 1])


def _step(block: Any, rig: Any) -> ca.Function:
    """(memory and torque, reference, counts, dt, numbers) -> memory and torque a step later."""
    n, s, own = rig.n, len(block.initial), len(block.values) - len(rig.number_values())
    carried, dt, numbers = ca.SX.sym("carried", s + n), ca.SX.sym("dt"), ca.SX.sym("numbers", len(block.values))
    columns = [ca.SX.sym(name, n) for name in ("q", "qd", "qdd", "reference_pulses", "counts")]
    asked, following = block.step(carried[:s], *columns[:4], columns[4], carried[s:], dt, numbers, columns[4])
    given = rig.with_numbers(numbers[own:]).drive.limited(asked)
    return ca.Function("step", [carried, *columns, dt, numbers], [ca.densify(ca.vertcat(following, given))])


@functools.lru_cache(maxsize=8)
def _repeated(step: str) -> ca.Function:
    """Some steps in a row; `step` is serialised, the same for laws that differ in numbers."""
    return ca.Function.deserialize(step).mapaccum("along", _AT_ONCE, {"base": 10})

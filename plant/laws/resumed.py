"""Laws that go on where they were: from a state in the middle of a motion, on the arm or along
the counts of a log.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.laws.law import Block, Law, Setpoint, Step
from plant.machine.rig import Rig
from plant.parts.checked_function import evaluated
from plant.parts.fields import Floats, Vector
from plant.parts.part import Part, number, part, structure

FAST = 4  # steps per sample along a log, of a law without a period

_AT_ONCE = 1000  # steps of a law in one call


@part
class Resumed(Law):
    """A law that goes on from a state, where it would start anew: its first step finds the memory
    as it was.

    Its numbers have the names of the law's own, and then ``state[j]``.

    Parameters
    ----------
    law : Law
        A controller.
    state : (s,) array_like
        Its memory before the first step, as `Law.initial_state` has it at a start.

    See Also
    --------
    plant.Law

    Examples
    --------
    >>> from plant import PD, Resumed
    >>> law = Resumed(law=PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600.0), state=(1.0, 0.5, 0, 0))
    >>> law.initial_state(2)
    array([0., 0., 0., 1.])
    """

    law: Law = structure(Law)
    state: Vector = number(("s",))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.law.replays or isinstance(self.law, Resumed):
            raise ValueError(
                f"law must be a controller; got {type(self.law).__name__}. Give that which made the"
                " log."
            )

    @property
    def period(self) -> float | None:  # type: ignore[override]  # declared, and here the law's
        """That of the law [s], or None."""
        return self.law.period

    def _leaves(self, prefix: str = "") -> Iterator[tuple[str, Part, dataclasses.Field[Any], Any]]:
        yield from self.law._leaves(prefix)
        yield f"{prefix}state", self, self.__dataclass_fields__["state"], self.state

    def along(self, rig: Rig) -> AlongLog:
        """The same law, from the same state, reading the counts of a log that was made with a
        rig.
        """
        return AlongLog(law=self.law, state=self.state, whole=not rig.encoder.smooth)

    def initial_state(self, n: int) -> NDArray[np.float64]:
        """Nothing yet, and a flag that the first step is to come."""
        return np.append(np.zeros(len(self.law.initial_state(n))), 1.0)

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step for a rig."""
        count = len(self.law.initial_state(rig.n))
        if len(self.state) != count:
            given = (
                f"state of {type(self.law).__name__} must have {count} numbers; got"
                f" {len(self.state)}"
            )
            raise ValueError(f"{given}. Give what its initial_state({rig.n}) has, as it was.")
        return super().block(rig)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One step of the law."""
        memory = state[:-1]
        first = state[-1]
        asked, following = self.law.equations(
            rig, memory + first * self.state, setpoint, pulses, torque, dt
        )
        return asked, ca.vertcat(following, 0)


@part
class AlongLog(Resumed):
    """A law that reads the counts of its record in place of the arm's: its torque is that of the
    log; as `Resumed`.

    ``whole``: counts are whole numbers that the law reads as they are. Fast hardware, without a
    period, is given straight lines between the middles of their cells.
    """

    whole: bool = structure(bool, default=True)
    replays = "counts"

    def replayed(self, record: Any) -> NDArray[np.float64]:
        """Counts (N, n) that the law reads, on straight lines across samples that are not valid."""
        counts = record.counts
        known = record.valid > 0
        encoder = record.rig.encoder
        if not self.rounds:
            counts = encoder.position_in_pulses(encoder.cell_centre(counts))
        if not known.any():
            raise ValueError(
                "the record must have valid samples; it has none. Check the column valid."
            )
        return np.column_stack(
            [np.interp(record.t, record.t[known], column[known]) for column in counts.T]
        )

    @property
    def rounds(self) -> bool:
        """Whether the law reads whole counts, and a rounded reference."""
        return self.whole and self.period is not None

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step; the rig's encoder counts as the law's did, also where the
        rig is smooth.
        """
        encoder = dataclasses.replace(rig.encoder, smooth=not self.rounds)
        return super().block(dataclasses.replace(rig, encoder=encoder))

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One step of the law, at the counts of the log."""
        return super().equations(
            rig, state, setpoint._replace(logged=None), setpoint.logged, torque, dt
        )

    def steps(
        self, rig: Rig, columns: Sequence[Floats], period: float, states: Iterable[Any]
    ) -> Iterator[tuple[Floats, Floats]]:
        """Joint torque (K, n) after the amplifier's limit [N m] and memory (K, s) of K steps, from
        each of some states.

        `columns`: q, qd, qdd, reference_pulses and counts, each (K, n), at times that are a
        `period` [s] apart.
        """
        block = self.block(rig)
        count = len(columns[-1])
        n = rig.n
        s = len(block.initial)
        own = len(block.values) - len(rig.number_values())
        along = _repeated(_step(block, rig).serialize())
        blocks = -(-count // _AT_ONCE)
        # the last one is filled up
        rows = np.minimum(np.arange(blocks * _AT_ONCE), count - 1).reshape(blocks, -1)
        given = *columns, np.full((count, 1), period)
        for state in states:
            numbers = np.concatenate([block.values[: own - s + 1], state, block.values[own:]])
            carried = np.empty((rows.size, s + n))
            last = np.concatenate([block.initial, np.zeros(n)])
            for some in rows:
                first = some[0]
                (done,) = evaluated(
                    along, last, *(part[some] for part in given), np.tile(numbers, (_AT_ONCE, 1))
                )
                carried[first : first + _AT_ONCE], last = done, done[-1]
            yield carried[:count, s:], carried[:count, : s - 1]


def _step(block: Any, rig: Any) -> ca.Function:
    """(memory and torque, reference, counts, dt, numbers) -> memory and torque a step later."""
    n = rig.n
    s = len(block.initial)
    own = len(block.values) - len(rig.number_values())
    carried = ca.SX.sym("carried", s + n)
    dt = ca.SX.sym("dt")
    numbers = ca.SX.sym("numbers", len(block.values))
    columns = [ca.SX.sym(name, n) for name in ("q", "qd", "qdd", "reference_pulses", "counts")]
    asked, following = block.step(
        carried[:s], *columns[:4], columns[4], carried[s:], dt, numbers, columns[4]
    )
    given = rig.with_numbers(numbers[own:]).drive.limited(asked)
    return ca.Function(
        "step", [carried, *columns, dt, numbers], [ca.densify(ca.vertcat(following, given))]
    )


@functools.lru_cache(maxsize=8)
def _repeated(step: str) -> ca.Function:
    """Some steps in a row; `step` is serialised, the same for laws that differ in numbers."""
    return ca.Function.deserialize(step).mapaccum("along", _AT_ONCE, {"base": 10})

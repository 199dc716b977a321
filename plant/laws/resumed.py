"""Laws that go on from a state in the middle of a motion, on the arm or along a log's counts."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.laws.law import Block, Law, Setpoint, Step, state_of
from plant.machine import Rig
from plant.parts import (
    Fields,
    Floats,
    Part,
    Vector,
    evaluated,
    number,
    part,
    per_joint,
    scalars,
    structure,
    vector_of,
)

FAST = 4  # steps per sample along a log, of a law without a period

# Steps of a law in one call of casadi, chosen by hand: it bounds the memory of a long log, and
# changes no result.
_STEPS_PER_CALL = 1000


@part
class Resumed(Law):
    """A law that continues from a state: its first step finds the memory of an earlier run.

    Its numbers have the names of the inner law's numbers, followed by ``state[j]``.

    Parameters
    ----------
    law : Law
        A controller.
    state : (s,) array_like
        Memory before the first step, in the layout of ``law.initial_state``.

    See Also
    --------
    plant.Law

    Examples
    --------
    >>> from plant import PD, Resumed
    >>> pd = PD(gain=(0.2, 0.1), derivative=(0.004, 0.002), filter=600.0)
    >>> law = Resumed(law=pd, state=(1.0, 0.5, 0, 0))
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
        # Under the inner law's own names: a fit of its gains needs no other names for a resumed
        # law.
        yield from self.law._leaves(prefix)
        yield f"{prefix}state", self, self.__dataclass_fields__["state"], self.state

    def along(self, rig: Rig) -> AlongLog:
        """The same law from the same state, reading the counts of a log made with this rig."""
        return AlongLog(law=self.law, state=self.state, whole=not rig.encoder.smooth)

    def around(self, law: Law, n: int) -> Self:
        """Another law of n joints in this state, as far as its memory has the same names."""
        memory = self.law.fields.read(self.state, n)
        begins = law.fields.read(law.initial_state(n), n)
        state = law.fields.write(n, **_remembered(begins, memory))
        return dataclasses.replace(self, law=law, state=state)

    @functools.cached_property
    def fields(self) -> Fields:
        """The law's memory, and 1 until the first step is done.

        The memory is zero until then: the first step adds `state`, so that those numbers stay
        symbols of the kernel.
        """
        memory = vector_of(self.law.fields, lambda n: np.zeros(state_of(self.law).length(n)))
        return Fields(law=memory, begins=scalars(start=1.0))

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step for a rig."""
        # Here, since only the rig says how many joints the memory is for.
        length = len(self.law.initial_state(rig.n))
        if len(self.state) != length:
            raise ValueError(
                f"state of {type(self.law).__name__} must have {length} numbers; got"
                f" {len(self.state)}. Give what its initial_state({rig.n}) has, as it was."
            )
        return super().block(rig)

    def equations(
        self, rig: Rig, state: ca.SX, setpoint: Setpoint, pulses: ca.SX, torque: ca.SX, dt: ca.SX
    ) -> Step:
        """One step of the law."""
        now = self.fields.read(state, rig.n)
        # A sum in place of a choice: the derivative by the state is then simply one.
        memory = now.law + now.begins * self.state
        commanded, memory = self.law.equations(rig, memory, setpoint, pulses, torque, dt)
        return commanded, self.fields.write(rig.n, law=memory, begins=0)


def _remembered(begins: Any, memory: Any) -> dict[str, Any]:
    """Values of a record by name: those of a memory where it has such a field."""
    values = {}
    for name, initial in begins._asdict().items():
        value = getattr(memory, name, initial)
        if isinstance(initial, tuple):  # a group of fields
            values[name] = _remembered(initial, value)
        else:
            values[name] = value if np.shape(value) == np.shape(initial) else initial
    return values


@part
class AlongLog(Resumed):
    """A resumed law that reads the counts of its record in place of the arm's.

    It therefore commands the torque of the log. ``whole``: the counts are whole numbers, and a
    sampled law reads them as they are. Fast hardware, without a period, reads straight lines
    between the middles of their cells.
    """

    whole: bool = structure(bool, default=True)
    replays = "counts"

    @property
    def interpolates(self) -> bool:
        """Counts change between samples."""
        return True

    def replayed(self, record: Any) -> NDArray[np.float64]:
        """Counts (N, n) that the law reads, on straight lines across samples that are not valid."""
        counts = record.counts
        valid = record.valid > 0
        encoder = record.rig.encoder
        if not self.rounds:
            counts = encoder.position_in_pulses(encoder.cell_centre(counts))
        if not valid.any():
            raise ValueError(
                "the record must have valid samples; it has none. Check the column valid."
            )
        return np.column_stack(
            [np.interp(record.t, record.t[valid], column[valid]) for column in counts.T]
        )

    @property
    def rounds(self) -> bool:
        """Whether the law reads whole counts, and a rounded reference."""
        return self.whole and self.period is not None

    def block(self, rig: Rig) -> Block:
        """This law as a symbolic step.

        The encoder rounds as that of the law did, also where the rig is smooth.
        """
        # A fit simulates smooth encoders; the law of the log read whole counts.
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
        """Joint torque (K, n) after the limit [N m] and memory (K, s) of K steps, for each state.

        `columns`: q, qd, qdd, reference_pulses and counts, each (K, n), at times that are a
        `period` [s] apart.
        """
        block, along = _prepared(self, rig)
        count = len(columns[-1])
        n = rig.n
        carried_fields = _carried(block)
        laws = len(block.values) - len(rig.number_values())
        # Rounded up: the last call may be filled with repeated rows.
        calls = -(-count // _STEPS_PER_CALL)
        # The function takes a fixed number of steps; the last call repeats the last row.
        rows = np.minimum(np.arange(calls * _STEPS_PER_CALL), count - 1).reshape(calls, -1)
        inputs = *columns, np.full((count, 1), period)
        for state in states:
            numbers = np.concatenate(
                [block.values[: laws - np.size(self.state)], state, block.values[laws:]]
            )
            done = np.empty((rows.size, carried_fields.length(n)))
            carried = carried_fields.initial(n)
            for call in rows:
                (steps,) = evaluated(
                    along,
                    carried,
                    *(column[call] for column in inputs),
                    np.tile(numbers, (_STEPS_PER_CALL, 1)),
                )
                done[call[0] : call[0] + _STEPS_PER_CALL] = steps
                carried = steps[-1]
            record = carried_fields.read(done[:count].T, n)
            yield record.torque.T, self.fields.read(record.state, n).law.T


def _carried(block: Block) -> Fields:
    """The vector that goes from step to step along a log."""
    return Fields(state=vector_of(initial=lambda n: block.initial), torque=per_joint())


def _step(block: Block, rig: Rig) -> ca.Function:
    """(memory and torque, reference, counts, dt, numbers) -> memory and torque a step later."""
    n = rig.n
    fields = _carried(block)
    laws = len(block.values) - len(rig.number_values())
    vector = ca.SX.sym("carried", fields.length(n))
    # By name, so that memory and torque cannot change places.
    carried = fields.read(vector, n)
    dt = ca.SX.sym("dt")
    numbers = ca.SX.sym("numbers", len(block.values))
    columns = [ca.SX.sym(name, n) for name in ("q", "qd", "qdd", "reference_pulses", "counts")]
    counts = columns[-1]
    commanded, following = block.step(carried.state, *columns, carried.torque, dt, numbers, counts)
    # Limited as in the log: the memory of a law depends on what really acted.
    torque = rig.with_numbers(numbers[laws:]).drive.limited(commanded)
    after = ca.densify(fields.write(n, state=following, torque=torque))
    return ca.Function("step", [vector, *columns, dt, numbers], [after])


# A law is run many times along one log, and its equations take longer than the run.
@functools.lru_cache(maxsize=8)
def _prepared(law: AlongLog, rig: Rig) -> tuple[Block, ca.Function]:
    """The block of a law, and the function that repeats its step."""
    block = law.block(rig)
    # Text as the key: laws that differ in numbers alone share the compiled steps.
    return block, _repeated(_step(block, rig).serialize())


@functools.lru_cache(maxsize=8)
def _repeated(step: str) -> ca.Function:
    """Many steps in a row; `step` is serialised, the same for laws that differ in numbers."""
    return ca.Function.deserialize(step).mapaccum("along", _STEPS_PER_CALL, {"base": 10})

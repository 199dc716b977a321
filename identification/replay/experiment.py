"""One record, ready to be repeated by a closed loop with other numbers; objective and prediction share it."""

import dataclasses
import difflib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.logs.record import Record
from plant.machine.rig import smooth_rig
from plant.mechanics.dynamics import Dynamics
from plant.parts.arguments import instance
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import path_of, start_of
from plant.simulation.loop_kernel import loop_kernel
from plant.simulation.simulator import injected_beside

_GEARED = ("drive.gear", "drive.coupling", "encoder.resolution")
"""Numbers that turn counts into angles."""


def as_records(
    dynamics: Dynamics, records: Record | Iterable[Record], unknown: Iterable[str] | None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records and unknown names as tuples, or a refusal; by default all of f is unknown; f1, ... are short."""
    records = tuple(records) if isinstance(records, Iterable) else (records,)
    if not records or not all(isinstance(record, Record) for record in records):
        given = type(next(r for r in records if not isinstance(r, Record))).__name__ if records else "none"
        raise ValueError(f"records must be at least one Record; got {given}. Pass what simulate or from_csv gave.")
    instance("dynamics", dynamics, Dynamics, "Pass the equations with f open, such as puma560.dynamics().")
    if isinstance(unknown, str) or not (unknown is None or np.iterable(unknown)):
        raise ValueError(f"unknown must be a sequence of names; got {unknown!r}. Write ({unknown!r},).")
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    unknown = tuple(dynamics.names if unknown is None else (long.get(name, name) for name in unknown))
    twice = [name for i, name in enumerate(unknown) if name in unknown[:i]]
    if twice:
        raise ValueError(f"unknown must name each number once; {twice[0]} comes twice. Leave one out.")
    return records, unknown


def with_zeros(records: Iterable[Record], zeros: NDArray[np.float64]) -> list[Record]:
    """The same records with their counters' zeros (R, n) [rad] where they are."""
    pairs = zip(records, zeros, strict=True)
    return [dataclasses.replace(r, error_pulses=r.error_pulses - r.rig.position_in_pulses(zero)) for r, zero in pairs]


class Experiment:
    """The closed loop of a record and all that it needs to run.

    `places`: where the unknowns are among the loop's numbers. `driven`: path, clock, and what is replayed and injected:
    what a kernel is driven by. `numbers`: as the record says; f is NaN. `begin`: q and qd (n,) at its start, by the
    record's rig.
    """

    def __init__(
        self, dynamics: Dynamics, record: Record, unknown: Sequence[str], *, smooth: bool = False, **options: Any
    ) -> None:
        if record.law is None:
            raise ValueError("the record must name the law that made it; got None. Pass law= when loading it.")
        if record.n != dynamics.n:
            raise ValueError(
                f"the record must have {dynamics.n} joints; it has {record.n}. Use the record of this arm."
            )
        rig = smooth_rig(record.rig) if smooth else record.rig
        self.record, added = record, injected_beside(record)
        self.loop = ClosedLoop(dynamics=dynamics, rig=rig, law=record.law, injected=added is not None, **options)
        names = self.loop.number_names
        for name in unknown:
            if name not in names:
                near = difflib.get_close_matches(str(name), names, n=1, cutoff=0.6)
                hint = f"Did you mean {near[0]!r}? " if near else ""
                if str(name).startswith("drive.curve"):
                    hint = "Give the drive a FrictionCurve first. "
                if str(name).startswith("springs") and record.rig.springs is None:
                    hint = "Give the rig its springs first, such as a JointSpring. "
                raise ValueError(
                    f"unknown must name numbers of this experiment; got {name!r}. {hint}Known: {', '.join(names)}."
                )
        open_f = [name for name in dynamics.names if name not in unknown]
        if open_f:
            raise ValueError(
                f"unknown must include all of f; {', '.join(open_f)} are missing. Add them to unknown, and fix what is "
                "known by equal ends of its range."
            )
        self.places = [names.index(name) for name in unknown]
        self.clock = Clock.of(record)
        path = self.path(smooth and not getattr(record.law, "rounds", False))
        self.driven = {"path": path, "clock": self.clock, "replayed": record.law.replayed(record), "injected": added}
        self.numbers = self.loop.number_values(np.full(dynamics.p, np.nan))
        self.begin = start_of(record, path_of(record, self.clock))
        self._geared = any(name.startswith(_GEARED) for name in unknown)

    def path(self, smooth: bool) -> Any:
        """The commanded path; smooth: not rounded to pulses."""
        return path_of(self.record, self.clock, smooth=smooth)

    def began(self, numbers: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and speed (n,) at the start with these numbers (k,), or (n, P) with (k, P): where the counts say.

        Rows of numbers that no rig can have begin as by the record's rig.
        """
        if not self._geared:
            return self.begin
        rig, own = self.record.rig, self.record.rig.number_names()
        first = self.loop.number_names.index(own[0])
        columns = np.reshape(numbers, (len(numbers), -1))[first : first + len(own)].T
        states = []
        for row in columns:
            try:
                turned = rig.with_numbers(row)
            except ValueError:
                turned = rig
            states.append([turned.to_angle(rig.position_in_pulses(each)) for each in self.begin])
        q, qd = np.moveaxis(np.array(states), 0, -1).reshape(2, -1, *numbers.shape[1:])
        return q, qd

    def kernel(self, lanes: Sequence[int] = ()) -> Any:
        """The compiled loop; `lanes` are the numbers that differ between individuals."""
        return loop_kernel(self.loop, lanes, uneven=self.clock.even is None)

    def data(self, measured: NDArray[np.float64]) -> NDArray[np.float64]:
        """What was measured (N, n), with the root of each sample's weight behind it, for all samples (M, n + 1)."""
        return self.clock.measured(np.column_stack([measured, np.sqrt(self.record.valid)]))

    @property
    def steps(self) -> int:
        """Sub-steps of a whole run."""
        return len(self.clock) * self.loop.steps_per_sample

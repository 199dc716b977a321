"""The compiled closed loop, for one individual or for many."""

import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np

from plant.compiler.kernel_cache import Kernel
from plant.parts.fields import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.followed_path import Logged, Path
from plant.simulation.loop_source import loop_source
from plant.simulation.time_tables import in_blocks, samples_of_law, time_tables

K = TypeVar("K", bound="_Compiled")

# individuals side by side in the loop of a population, chosen by tests/benchmarks/speed.py
LANES = 40


LOGGED = 8  # the same where each is logged


# samples of a logged run of many at once: their errors stay in the processor's cache
_AT_ONCE = 1 << 14


class _Compiled:
    """A closed loop compiled, for `width` individuals side by side.

    `lanes` are the numbers (positions in ``loop.number_names``) that differ between individuals;
    `uneven` steps have several lengths.
    """

    usual = LANES
    many = "population"

    def __init__(
        self,
        loop: ClosedLoop,
        lanes: Iterable[int],
        width: int | None = None,
        *,
        uneven: bool = False,
    ) -> None:
        self.loop, self.lanes, self._uneven = loop, tuple(lanes), uneven
        self.width = self.usual if width is None else width
        self.uniform = tuple(i for i in range(len(loop.number_names)) if i not in set(self.lanes))
        self._programs = dict[str, tuple[Kernel, dict[str, list[int]]]]()

    def program(self, name: str) -> tuple[Kernel, dict[str, list[int]]]:
        """``single`` or that of many, and the columns that it reads of its tables; made when it
        is first asked for.
        """
        if name not in self._programs:
            width = 1 if name == "single" else self.width
            source, columns = loop_source(
                self.loop, self.lanes, self.uniform, self._uneven, name, width
            )
            self._programs[name] = Kernel(source, [name]), columns
        return self._programs[name]

    def prepared(self, tables: Sequence[Floats], *, logged: bool = False) -> tuple[Any, ...]:
        """The columns of the tables (law_time, sample_time, step_time, data) that a run reads; and
        h.

        `logged` is for a run of one individual with its log.
        """
        return self._prepared(tables, self.program("single" if logged else self.many)[1])

    def along(
        self,
        loop: ClosedLoop,
        path: Path | Logged,
        clock: Clock,
        data: Floats,
        *,
        logged: bool = False,
        replayed: Floats | None = None,
        injected: Floats | None = None,
    ) -> tuple[Any, ...]:
        """What a run of a loop along a path reads, as from `prepared`; columns that it does not
        read are never made.

        The loop has this structure, and may have other numbers. Path, clock, replayed and injected
        are as for `time_tables`, `data` is (M, m).
        """
        narrow, places = _narrow(self.program("single" if logged else self.many)[1])
        return self._prepared(
            (*time_tables(loop, path, clock, replayed, injected, narrow), data), places
        )

    def blocks(
        self,
        loop: ClosedLoop,
        path: Path | Logged,
        clock: Clock,
        replayed: Floats | None = None,
        injected: Floats | None = None,
        *,
        samples: int,
    ) -> Iterator[tuple[Any, ...]]:
        """The same without data, in blocks of about so many samples one after another."""
        narrow, places = _narrow(self.program(self.many)[1])
        for tables in in_blocks(loop, path, clock, replayed, injected, narrow, samples=samples):
            yield self._prepared((*tables, np.empty((len(tables[1]), 0))), places)

    def _prepared(self, tables: Sequence[Floats], columns: dict[str, list[int]]) -> tuple[Any, ...]:
        """The columns of the tables, and the length of a step."""
        lengths = np.concatenate([table[:, -1] for table in tables[:3]])
        if not self._uneven and len(lengths) and np.ptp(lengths) > 0:
            raise ValueError(
                f"all steps must have one length; got {lengths.min()} to {lengths.max()} s. Say"
                " uneven."
            )
        used = [
            np.ascontiguousarray(table[:, some])
            for table, some in zip(tables, columns.values(), strict=True)
        ]
        return *used, lengths[0] if len(lengths) else 0.0


class LoopKernel(_Compiled):
    """A closed loop compiled: one individual with its log, or `width` individuals without."""

    def run(
        self,
        tables: tuple[Any, ...],
        initial: Floats,
        lanes: Floats,
        uniform: Floats,
        logs: tuple[Floats, Floats] | None = None,
    ) -> tuple[Floats, int]:
        """Final states (s, W), and the number of sub-steps done: fewer than wanted if every
        individual has diverged.

        Tables are from `prepared`, initial states (s, W), own numbers `lanes` (L, W), all others
        `uniform` (U,). With `logs`, sample_log and step_log to be filled, there is one individual,
        otherwise `width`.
        """
        name, logged = ("population", [np.empty((0, 0))] * 2) if logs is None else ("single", logs)
        numbers = np.append(uniform, tables[-1])
        final = np.empty_like(initial)
        steps = self.program(name)[0].call(
            name, initial, lanes, numbers, *tables[:-1], *logged, final
        )
        return final, steps


class LoggedKernel(_Compiled):
    """A closed loop compiled for `width` individuals, with the tracking errors of each."""

    usual = LOGGED
    many = "logged"

    def with_data(self, tables: tuple[Any, ...], data: Floats) -> tuple[Any, ...]:
        """The same tables with other data (M, m)."""
        return (
            *tables[:3],
            np.ascontiguousarray(data[:, self.program("logged")[1]["data"]]),
            tables[4],
        )

    def with_held(self, tables: tuple[Any, ...], name: str, held: Floats) -> tuple[Any, ...]:
        """The same tables with another "injected" torque, or what else is "logged" and held, (M,
        n) at all samples.
        """
        first = self.loop.time_fields.at(self.loop.n)[name].start
        changed = list(tables)
        for i, which, times in ((1, "sample", 1), (2, "step", self.loop.steps_per_sample)):
            joints = np.array(self.program("logged")[1][which], int) - first
            own = (joints >= 0) & (joints < self.loop.n)
            changed[i] = tables[i].copy()
            changed[i][:, own] = np.repeat(held[:, joints[own]], times, axis=0)
        return tuple(changed)

    def parts(
        self, tables: tuple[Any, ...], samples: int
    ) -> Iterator[tuple[slice, tuple[Any, ...]]]:
        """The tables of so many samples in parts that are run one after another: their samples,
        and their tables.
        """
        steps = self.loop.steps_per_sample
        every = self.loop.steps_per_law
        size = _AT_ONCE * samples_of_law(self.loop)
        for begin in range(0, samples, size):
            end = min(begin + size, samples)
            of_law = slice(begin * steps // every, -(-end * steps // every)) if every else slice(0)
            rows = of_law, slice(begin, end), slice(begin * steps, end * steps), slice(begin, end)
            yield (
                rows[1],
                (*(table[some] for table, some in zip(tables, rows, strict=False)), tables[-1]),
            )

    def run(
        self, tables: tuple[Any, ...], samples: int, initial: Floats, lanes: Floats, uniform: Floats
    ) -> tuple[Floats, Floats]:
        """Final states (s, W), and errors (N, n, W) [pulses] at so many samples; NaN after all have
        diverged.

        What it is given is as of `LoopKernel`.
        """
        n = self.loop.n
        final = np.empty_like(initial)
        errors = np.empty((samples, n, self.width))
        numbers = np.append(uniform, tables[-1])
        rows = errors.reshape(-1, self.width)
        kernel, _ = self.program("logged")
        steps = kernel.call(
            "logged", initial, lanes, numbers, *tables[:-1], rows, np.empty((0, 0)), final
        )
        errors[-(-steps // self.loop.steps_per_sample) :] = np.nan
        return final, errors


def _narrow(columns: dict[str, list[int]]) -> tuple[list[list[int]], dict[str, list[int]]]:
    """Columns of the time tables that are read, and where they are when there are no others;
    those of the data.
    """
    narrow = [columns[which] for which in ("law", "sample", "step")]
    places = {which: list(range(len(columns[which]))) for which in ("law", "sample", "step")}
    return narrow, {**places, "data": columns["data"]}


class Structure:
    """A loop compared by its structure alone: loops that differ in numbers share one kernel."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop = loop
        functions = (loop.law_step, loop.sample, loop.substep)
        self.key = (
            tuple(None if f is None else f.serialize() for f in functions),
            loop.steps_per_law,
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Structure):
            return NotImplemented
        return self.key == other.key and self.loop.steps_per_sample == other.loop.steps_per_sample

    def __hash__(self) -> int:
        return hash(self.key)


@functools.lru_cache(maxsize=128)
def _cached(kind: type[K], key: Structure, lanes: tuple[int, ...], uneven: bool) -> K:
    return kind(key.loop, lanes, uneven=uneven)


def loop_kernel(loop: ClosedLoop, lanes: Iterable[int] = (), *, uneven: bool = False) -> LoopKernel:
    """Compiled kernel of a closed loop; `lanes` are the numbers that differ between individuals."""
    return _cached(LoopKernel, Structure(loop), tuple(lanes), uneven)


def logged_kernel(loop: ClosedLoop, lanes: Iterable[int], *, uneven: bool = False) -> LoggedKernel:
    """Compiled kernel of a closed loop that logs the tracking errors of individuals side by
    side.
    """
    return _cached(LoggedKernel, Structure(loop), tuple(lanes), uneven)

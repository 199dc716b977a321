"""The compiled closed loop, for one individual or for many."""

import functools
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from plant.compiler import Kernel
from plant.parts import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop
from plant.simulation.loop_source import loop_source
from plant.simulation.time_tables import column_at, in_blocks, samples_of_law, time_tables

K = TypeVar("K", bound="_Compiled")

# Individuals side by side in the loop of a population; tests/benchmarks/speed.py chose it.
LANES = 40

# Individuals side by side where each is logged.
LOGGED = 8

# Numbers in a cache line of 64 bytes.
_CACHE_LINE = 8

# Samples of a logged run that are run at once: their errors stay in the processor's cache.
_AT_ONCE = 1 << 14

_Columns: TypeAlias = dict[str, list[int]]
"""Columns that a kernel reads of its tables: of law, sample and step, and of the data."""


class _Program(NamedTuple):
    """One kernel, the columns that it reads of its tables, and the rows of its memory."""

    kernel: Kernel
    columns: _Columns
    rows: int


class _Compiled:
    """A closed loop compiled, for `width` individuals side by side.

    `lanes` are the numbers (positions in ``loop.number_names``) that differ between individuals;
    `uneven` steps have several lengths.
    """

    default_width = LANES
    program_name = "population"

    def __init__(
        self,
        loop,
        lanes,
        width=None,
        *,
        uneven=False,
    ):
        self.loop = loop
        self.lanes = tuple(lanes)
        self._uneven = uneven
        self.width = self.default_width if width is None else width
        # All other numbers are the same for all individuals.
        self.uniform = tuple(i for i in range(len(loop.number_names)) if i not in set(self.lanes))
        self._programs = {}

    def program(self, name):
        """The kernel ``single`` or `program_name`."""
        # Made on demand: most loops run one of the two.
        if name not in self._programs:
            width = 1 if name == "single" else self.width
            source, columns, rows = loop_source(
                self.loop, self.lanes, self.uniform, self._uneven, name, width
            )
            self._programs[name] = _Program(Kernel(source, [name]), columns, rows)
        return self._programs[name]

    def _columns(self, logged):
        return self.program("single" if logged else self.program_name).columns

    def _run(self, name, tables, initial, lanes, uniform, logs):
        """Final states, and the number of sub-steps done; the logs are filled."""
        program = self.program(name)
        law, sample, step, data, h = tables
        states, width = initial.shape
        # Rows begin where cache lines of 64 bytes do.
        space = np.empty(program.rows * width + _CACHE_LINE)
        first = -(space.ctypes.data // space.itemsize) % _CACHE_LINE
        memory = space[first : first + program.rows * width].reshape(-1, width)
        # The kernel takes states and numbers from their rows, and leaves the last states there.
        state, numbers, _ = np.split(memory, [states, states + len(lanes)])
        state[:] = initial
        numbers[:] = lanes
        # The length of a sub-step stands behind the uniform numbers.
        arrays = np.append(uniform, h), law, sample, step, data
        done = program.kernel.call(name, memory, *arrays, *logs, len(step))
        return state.copy(), done

    def prepared(self, tables, *, logged=False):
        """Columns that a run reads of the tables (law, sample, step, data), and the step length h.

        `logged` is for a run of one individual with its log.
        """
        return self._prepared(tables, self._columns(logged))

    def along(
        self,
        loop,
        path,
        clock,
        data,
        *,
        logged=False,
        replayed=None,
        injected=None,
    ):
        """Tables of a run of a loop along a path, as from `prepared`, without unread columns.

        The loop has this structure, and may have other numbers. Path, clock, replayed and injected
        are as for `time_tables`, `data` is (M, m).
        """
        # A long path has many columns of which a kernel reads few; the others are never computed.
        narrow, places = _narrow(self._columns(logged))
        tables = time_tables(loop, path, clock, replayed, injected, narrow)
        return self._prepared((*tables, data), places)

    def blocks(
        self,
        loop,
        path,
        clock,
        replayed=None,
        injected=None,
        *,
        samples,
    ):
        """Tables as from `along`, without data, in successive blocks of about `samples`."""
        narrow, places = _narrow(self._columns(logged=False))
        for tables in in_blocks(loop, path, clock, replayed, injected, narrow, samples=samples):
            yield self._prepared((*tables, np.empty((len(tables[1]), 0))), places)

    def _prepared(self, tables, columns):
        """The columns of the tables, and the length of a step."""
        # Behind the columns of each table in time stands the length of the sub-step.
        # One length for all is a number of the kernel, not a column.
        lengths = np.concatenate([table[:, -1] for table in tables[:3]])
        if not self._uneven and len(lengths) and np.ptp(lengths) > 0:
            raise ValueError(
                f"all steps must have one length; got {lengths.min()} to {lengths.max()} s. Say"
                " uneven."
            )
        used = [
            np.ascontiguousarray(table[:, places])
            for table, places in zip(tables, columns.values(), strict=True)
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
        """Final states (s, W), and the number of sub-steps done, fewer if all have diverged.

        Tables are from `prepared`, initial states (s, W), numbers of each individual `lanes`
        (L, W), all others `uniform` (U,). With `logs`, sample_log and step_log to be filled, there
        is one individual, otherwise `width`.
        """
        # One individual writes a log; a population has none, but its kernel takes the arrays.
        name = "single"
        if logs is None:
            name = self.program_name
            logs = np.empty((0, 0)), np.empty((0, 0))
        return self._run(name, tables, initial, lanes, uniform, logs)


class LoggedKernel(_Compiled):
    """A closed loop compiled for `width` individuals, with the tracking errors of each."""

    default_width = LOGGED
    program_name = "logged"

    def with_data(self, tables: tuple[Any, ...], data: Floats) -> tuple[Any, ...]:
        """The same tables with other data (M, m)."""
        # The other tables depend on path and clock alone, and are shared.
        law, sample, step, _, h = tables
        columns = self._columns(logged=False)["data"]
        return law, sample, step, np.ascontiguousarray(data[:, columns]), h

    def with_column(
        self, loop: ClosedLoop, tables: tuple[Any, ...], name: str, values: Floats, clock: Clock
    ) -> tuple[Any, ...]:
        """The same tables with other values (N, n) of the "injected" or the "logged" column."""
        law, sample, step, data, h = tables
        begin = self.loop.time_fields.at(self.loop.n)[name].start

        # The law of this loop: loops of one structure share a kernel, and may hold torques or not.
        held = name == "injected" or not loop.law.interpolates
        values_at = column_at(values, clock, held=held)

        def changed(table, block, t, sample):
            # A kernel reads a few columns of a field, so each goes to the joint that it belongs to.
            joints = np.array(self._columns(logged=False)[block], int) - begin
            field = (joints >= 0) & (joints < self.loop.n)
            table = table.copy()
            table[:, field] = values_at(t, sample)[:, joints[field]]
            return table

        steps = self.loop.steps_per_sample
        places = np.arange(len(clock) * steps)
        sample = changed(sample, "sample", clock.t, np.arange(len(clock)))
        step = changed(step, "step", clock.middles(steps, places), places // steps)
        return law, sample, step, data, h

    def parts(
        self, tables: tuple[Any, ...], samples: int
    ) -> Iterator[tuple[slice, tuple[Any, ...]]]:
        """Samples and tables of the parts of a long run, which are run one after another."""
        law, sample, step, data, h = tables
        steps = self.loop.steps_per_sample
        every = self.loop.steps_per_law
        # Each part begins with a step of the law.
        size = _AT_ONCE * samples_of_law(self.loop)
        for begin in range(0, samples, size):
            end = min(begin + size, samples)
            part = slice(begin, end)
            of_law = slice(begin * steps // every, -(-end * steps // every)) if every else slice(0)
            of_step = slice(begin * steps, end * steps)
            yield part, (law[of_law], sample[part], step[of_step], data[part], h)

    def run(
        self, tables: tuple[Any, ...], samples: int, initial: Floats, lanes: Floats, uniform: Floats
    ) -> tuple[Floats, Floats]:
        """Final states (s, W), and errors (N, n, W) [pulses], NaN after all have diverged.

        N is `samples`; the other arguments are as of `LoopKernel.run`.
        """
        errors = np.empty((samples, self.loop.n, self.width))
        # Samples that the kernel does not reach are overwritten below.
        logs = errors.reshape(-1, self.width), np.empty((0, 0))
        final, steps = self._run("logged", tables, initial, lanes, uniform, logs)
        # The kernel stopped here: no sample after it was written.
        errors[-(-steps // self.loop.steps_per_sample) :] = np.nan
        return final, errors


def _narrow(columns):
    """Columns of the time tables that a kernel reads, and their places in tables of them alone."""
    narrow = [columns[block] for block in ("law", "sample", "step")]
    places = {block: list(range(len(columns[block]))) for block in ("law", "sample", "step")}
    return narrow, {**places, "data": columns["data"]}


class Structure:
    """A loop compared by its structure alone: loops that differ in numbers share one kernel."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.loop = loop
        # The text of the functions is the structure; their numbers are inputs.
        functions = (loop.law_step, loop.sample, loop.substep)
        self.key = (
            tuple(None if f is None else f.serialize() for f in functions),
            loop.steps_per_law,
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Structure):
            return NotImplemented
        # The numbers of steps are bounds of the loops in the kernel.
        return self.key == other.key and self.loop.steps_per_sample == other.loop.steps_per_sample

    def __hash__(self) -> int:
        return hash(self.key)


# Compiling is slow: loops of one structure share a kernel.
@functools.lru_cache(maxsize=128)
def _cached(kind, key, lanes, uneven):
    return kind(key.loop, lanes, uneven=uneven)


def loop_kernel(loop: ClosedLoop, lanes: Iterable[int] = (), *, uneven: bool = False) -> LoopKernel:
    """Compiled kernel of a closed loop; `lanes` are the numbers that differ between individuals."""
    return _cached(LoopKernel, Structure(loop), tuple(lanes), uneven)


def logged_kernel(loop: ClosedLoop, lanes: Iterable[int], *, uneven: bool = False) -> LoggedKernel:
    """Compiled kernel of a closed loop that logs the errors of individuals side by side."""
    return _cached(LoggedKernel, Structure(loop), tuple(lanes), uneven)

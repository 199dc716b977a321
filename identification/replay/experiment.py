"""One record, ready to be repeated by a closed loop with other numbers.

`Experiment` is the base of the objective and of the prediction. `Rounding` simulates the log of a
record with encoders that round; the model of a `Prediction` does not round.
"""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from plant import Dynamics, Phase, Record
from plant.compiler import shared_out
from plant.machine import smooth_rig
from plant.parts import Floats, instance, near, several
from plant.simulation import (
    LOGGED,
    Clock,
    ClosedLoop,
    Logged,
    closed_loop,
    counts_along,
    injected_beside,
    logged_kernel,
    loop_kernel,
    path_of,
    start_of,
)

# Words among the unknowns, and the numbers that each stands for.
GROUPS = {"friction": ("drive.viscous", "drive.coulomb"), "gains": ("law.gain",)}

# Beginnings of the names of numbers that turn counts into angles.
_GEARED = ("drive.gear", "drive.coupling", "encoder.resolution")


def as_records(
    dynamics: Dynamics, records: Record | Iterable[Record], unknown: Iterable[str] | None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records and unknown names as tuples, or a refusal; by default all of f is unknown.

    A name may be a short one (f1, ...) or a word: "f" stands for all of f, and each of `GROUPS` for
    its numbers of all joints. If no name is of f, all of f precedes the names.
    """
    # 1. Types: a generator, a string or a single record are common slips.
    records = tuple(records) if isinstance(records, Iterable) else (records,)
    if not records or not all(isinstance(record, Record) for record in records):
        wrong = [type(record).__name__ for record in records if not isinstance(record, Record)]
        raise ValueError(
            f"records must be at least one Record; got {wrong[0] if wrong else 'none'}. Pass what"
            " simulate or from_csv gave."
        )
    instance(
        "dynamics",
        dynamics,
        Dynamics,
        "Pass the equations with f open, such as puma560.dynamics().",
    )
    if unknown is None:
        return records, dynamics.names
    # A string is one word, not a sequence of letters.
    several_words = np.iterable(unknown) and not isinstance(unknown, str)
    words: tuple[Any, ...] = tuple(unknown) if several_words else (unknown,)
    wrong = [word for word in words if not isinstance(word, str)]
    if wrong or (not several_words and unknown not in GROUPS):
        got = (wrong or words)[0]
        advice = "A name is a string, such as 'f1'." if wrong else f"Write ({got!r},)."
        raise ValueError(
            f"unknown must be {' or '.join(GROUPS)}, or a sequence of names; got {got!r:.60}."
            f" {near(got, GROUPS, advice, cutoff=0.8)}"
        )

    # 2. Words and short names become the names of numbers.
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    expanded = {"f": dynamics.names}
    for word, numbers in GROUPS.items():
        expanded[word] = tuple(f"{name}[{i}]" for name in numbers for i in range(dynamics.n))
    for word in words:
        # A word with a typing error would pass for the name of a number, and be refused as such.
        advice = "" if word in GROUPS else near(word, GROUPS, cutoff=0.6)
        if advice:
            takes = f"unknown must be {', '.join(GROUPS)} or names such as drive.viscous[0]"
            raise ValueError(f"{takes}; got {word!r}. {advice}")
    names = [name for word in words for name in expanded.get(word, (long.get(word, word),))]
    # Where nothing of f is named, all of it is unknown beside what is named.
    if names and not set(names) & set(dynamics.names):
        names = [*dynamics.names, *names]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    # A word may overlap with a name, as "friction" with drive.viscous[0]; a name alone may not.
    if twice and not any(word in expanded for word in words):
        raise ValueError(
            f"unknown must name each number once; {twice[0]} comes twice. Leave one out."
        )
    return records, tuple(dict.fromkeys(names))


def with_zeros(records: Iterable[Record], zeros: Floats) -> list[Record]:
    """The records with their counts moved by offsets of the encoders (R, n) [rad]."""
    moved = []
    for record, zero in zip(records, zeros, strict=True):
        # Counts are the reference less the error: a smaller error means a larger count.
        errors = record.error_pulses - record.rig.position_in_pulses(zero)
        moved.append(replace(record, error_pulses=errors))
    return moved


class Experiment:
    """The closed loop of a record, with its path, its clock and its numbers.

    `places`: indices of the unknowns among the loop's numbers. `driven`: inputs of a kernel: path,
    clock, and the signals that are replayed and injected. `numbers`: those of the record's rig and
    law; f is NaN. `begin`: q and qd (n,) at the start, by the record's rig.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        record: Record,
        unknown: Sequence[str],
        *,
        smooth: bool = False,
        **options,
    ) -> None:
        if record.law is None:
            raise ValueError(
                "the record must name the law that made it; got None. Pass law= when loading it."
            )

        # 1. The loop.
        rig = smooth_rig(record.rig) if smooth else record.rig
        self.record = record
        injected = injected_beside(record)
        self.loop = closed_loop(
            dynamics=dynamics, rig=rig, law=record.law, injected=injected is not None, **options
        )

        # 2. The unknowns are numbers of that loop, all of f among them.
        names = self.loop.number_names
        for name in unknown:
            if name not in names:
                hint = near(name, names, cutoff=0.6)
                if str(name).startswith("drive.curve") and record.rig.drive.curve is None:
                    hint = "Give the drive a FrictionCurve first."
                if str(name).startswith("springs") and record.rig.springs is None:
                    hint = "Give the rig its springs first, such as a JointSpring."
                hint = hint or f"Known: {several(names)}."
                raise ValueError(
                    f"unknown must name numbers of this experiment; got {name!r}. {hint}"
                )
        # f is not stated anywhere: a record has a rig and a law, and no arm.
        open_f = [name for name in dynamics.names if name not in unknown]
        if open_f:
            raise ValueError(
                f"unknown must include all of f; {', '.join(open_f)} are missing. Add them to"
                " unknown, and fix what is known by equal ends of its range."
            )
        self.places = [names.index(name) for name in unknown]

        # 3. The signals that drive it.
        self.clock = Clock.of(record)
        # A law that reads whole counts of its log reads a rounded reference, too.
        path = self.path(smooth and not getattr(record.law, "rounds", False))
        self.driven = {
            "path": path,
            "clock": self.clock,
            "replayed": record.law.replayed(record),
            "injected": injected,
        }
        # f is open: NaN would show up at once if it were used.
        self.numbers = self.loop.number_values(np.full(dynamics.p, np.nan))
        self.begin = start_of(record, path_of(record, self.clock))
        # Without an unknown gear the start of the record is that of all candidates.
        geared = [i for i, name in enumerate(names) if name.startswith(_GEARED)]
        self._geared = geared if set(geared) & set(self.places) else []

    def path(self, smooth: bool) -> Any:
        """The commanded path; smooth: not rounded to pulses."""
        return path_of(self.record, self.clock, smooth=smooth)

    def began(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Position and speed at the start, from the counts, of a loop with these numbers.

        They are (n,) for numbers (k,), and (n, P) for numbers (k, P) unless the record's own start,
        (n,), is that of all. For numbers that no rig can have, the record's rig gives them.
        """
        # One vector of numbers is a population of one.
        columns = np.reshape(numbers, (len(numbers), -1))
        if (columns[self._geared] == self.numbers[self._geared, None]).all():
            return self.begin
        # The counts are measured, the angles follow from them by the gears of each candidate.
        rig = self.record.rig
        names = rig.number_names()
        begin = self.loop.number_names.index(names[0])
        pulses = [rig.position_in_pulses(angle) for angle in self.begin]
        states = []
        for values in columns[begin : begin + len(names)].T:
            try:
                # A search may propose numbers that a rig refuses: the cost of such a candidate is
                # decided elsewhere.
                candidate = rig.with_numbers(values)
            except ValueError:
                candidate = rig
            states.append([candidate.to_angle(position) for position in pulses])
        q, qd = np.moveaxis(np.array(states), 0, -1).reshape(2, -1, *numbers.shape[1:])
        return q, qd

    def kernel(self, lanes: Sequence[int] = ()) -> Any:
        """The compiled loop; `lanes`: indices of the numbers that differ between individuals."""
        return loop_kernel(self.loop, lanes, uneven=self.clock.even is None)

    def data(self, measured: Floats) -> Floats:
        """Measured columns (N, n) and the root of the weight, at all samples (M, n + 1)."""
        return self.clock.measured(np.column_stack([measured, np.sqrt(self.record.valid)]))

    @property
    def steps(self) -> int:
        """Sub-steps of a whole run."""
        return len(self.clock) * self.loop.steps_per_sample


# Sub-steps per sample that are tried: fast hardware reads each count when it comes, and a log does
# not say how fast its hardware is.
RATES = 16, 64, 256

# Sub-steps that are simulated at once: at 256 per sample, the tables of a whole log do not fit into
# memory.
_AT_ONCE = 1 << 17


class Rounding(Experiment):
    """The loop of a record, without correction and with encoders that round.

    `steps`: sub-steps per sample, in each of which the loop reads rounded counts.
    """

    def __init__(self, loop: ClosedLoop, record: Record, steps: int) -> None:
        rig = record.rig
        n = record.n
        # An encoder with a phase, zero if need be: its shift is a number that lanes can differ in.
        self._shift = np.zeros(n) if rig.encoder.phase is None else rig.encoder.phase.shift
        encoder = replace(rig.encoder, phase=Phase(shift=self._shift))
        phased = replace(rig, encoder=encoder)
        super().__init__(
            loop.dynamics,
            replace(record, rig=phased),
            loop.dynamics.names,
            steps_per_sample=steps,
            sweeps=loop.sweeps,
        )
        self._phase = [self.loop.number_names.index(f"encoder.phase.shift[{i}]") for i in range(n)]
        # The shifts of the encoders differ between lanes, all other numbers are the same in them.
        self._kernel = logged_kernel(self.loop, self._phase, uneven=self.clock.even is None)
        self._reference = counts_along(self.driven["path"], self.clock.t)

    def path(self, smooth: bool) -> Any:
        """The commanded path of the loop with rounding encoders.

        If it is known from whole logged counts, it is the smoothest motion that they allow, rounded
        at every instant.
        """
        path = super().path(smooth)
        return _Rounded(path) if isinstance(path, Logged) and path.whole else path

    def counts(
        self, start, numbers: Floats, names: Sequence[str], shifts: Sequence[Floats], threads: int
    ) -> list[Floats]:
        """Counts (N, n) of the loop, for each of the `shifts` (n,) of its encoders [pulses].

        `start`: position and speed (n,). `numbers` (k,): values of `names`; all others are those of
        the record.
        """
        # By name: the loop with phases has more numbers than the one that the values belong to.
        stated = dict(zip(names, numbers.tolist(), strict=True))
        values = self.numbers.copy()
        for i, name in enumerate(self.loop.number_names):
            values[i] = stated.get(name, values[i])
        groups = [
            self._shift + np.array(shifts[i : i + LOGGED]) for i in range(0, len(shifts), LOGGED)
        ]
        state = self.loop.initial_state(start[0], start[1], values)
        # A group fills the lanes of one kernel call.
        logs = shared_out(functools.partial(self._group, state, values), groups, threads)
        return [counts for group in logs for counts in group]

    def _group(self, start, numbers, phases):
        """Counts, W arrays (N, n), of encoders with these phases (W, n), side by side."""
        # Empty lanes repeat the last encoders: a kernel has no lane that does nothing.
        empty = phases[-1:].repeat(LOGGED - len(phases), axis=0)
        lanes = np.vstack([phases, empty]).T.copy()
        state = start[:, None].repeat(LOGGED, axis=1)
        rows = self.clock.rows
        done = 0
        logs = np.empty((len(phases), len(rows), self.loop.n))
        for tables in self._kernel.blocks(
            self.loop, **self.driven, samples=_AT_ONCE // self.loop.steps_per_sample
        ):
            state, errors = self._kernel.run(
                tables, len(tables[1]), state, lanes, numbers[list(self._kernel.uniform)]
            )
            end = done + len(errors)
            # Samples that bridge a gap of the log are not in it, and are left out.
            in_block = slice(*np.searchsorted(rows, (done, end)).tolist())
            for j, counts in enumerate(logs):
                of_block = self._reference[done:end] - errors[:, :, j]
                counts[in_block] = of_block[rows[in_block] - done]
            done = end
        if not self.loop.sound(state).all() or not np.isfinite(logs).all():
            raise ValueError(
                "the model must stay on the log's path; simulated with what was found, it diverges."
                " Check the gains of the law, and the identified numbers."
            )
        return list(logs)


class _Rounded:
    """A smooth motion through logged counts, in counts."""

    def __init__(self, logged):
        self.logged = logged

    def __call__(self, t):
        motion = self.logged.smoothed(t)
        return motion, self.logged.rig.counts(motion.q)

    def setpoint(self, t):
        """Setpoint of a law at times t (N,)."""
        return self.logged.setpoint(t)

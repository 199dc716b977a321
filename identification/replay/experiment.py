"""One record, ready to be repeated by a closed loop with other numbers; objective and prediction
share it.

And the log that the loop makes itself, with encoders that round, where `Prediction`'s model does
not.
"""

import dataclasses
import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from plant import Phase
from plant.compiler.background import shared_out
from plant.logs.record import Record
from plant.machine.rig import smooth_rig
from plant.mechanics.dynamics import Dynamics
from plant.motion.reference import Motion
from plant.parts.arguments import instance, near, several
from plant.parts.fields import Floats
from plant.simulation.clock import Clock
from plant.simulation.closed_loop import ClosedLoop, closed_loop
from plant.simulation.followed_path import Logged, counts_along, path_of, start_of
from plant.simulation.loop_kernel import LOGGED, logged_kernel, loop_kernel
from plant.simulation.simulator import injected_beside

# What one word stands for among the unknowns.
GROUPS = {"friction": ("drive.viscous", "drive.coulomb"), "gains": ("law.gain",)}

# numbers that turn counts into angles
_GEARED = ("drive.gear", "drive.coupling", "encoder.resolution")


def as_records(
    dynamics: Dynamics, records: Record | Iterable[Record], unknown: Iterable[str] | None
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """Records and unknown names as tuples, or a refusal; by default all of f is unknown.

    Names may be short (f1, ...), and words: "f" is all of f, each of `GROUPS` a number per joint,
    alone beside f.
    """
    records = tuple(records) if isinstance(records, Iterable) else (records,)
    if not records or not all(isinstance(record, Record) for record in records):
        given = (
            type(next(r for r in records if not isinstance(r, Record))).__name__
            if records
            else "none"
        )
        raise ValueError(
            f"records must be at least one Record; got {given}. Pass what simulate or from_csv"
            " gave."
        )
    instance(
        "dynamics",
        dynamics,
        Dynamics,
        "Pass the equations with f open, such as puma560.dynamics().",
    )
    if (isinstance(unknown, str) and unknown not in GROUPS) or not (
        unknown is None or np.iterable(unknown)
    ):
        meant = near(unknown, GROUPS, f"Write ({unknown!r},).", cutoff=0.8)
        raise ValueError(
            f"unknown must be {' or '.join(GROUPS)}, or a sequence of names; got {unknown!r}."
            f" {meant}"
        )
    if unknown is None:
        return records, dynamics.names
    long = dict(zip(dynamics.short_names, dynamics.names, strict=True))
    stands = {"f": dynamics.names}
    stands |= {
        word: tuple(f"{name}[{i}]" for name in of for i in range(dynamics.n))
        for word, of in GROUPS.items()
    }
    words: tuple[str, ...] = ("f", unknown) if isinstance(unknown, str) else tuple(unknown)
    for word in words:
        if word not in GROUPS and (meant := near(word, GROUPS, cutoff=0.6)):
            takes = f"unknown must be {', '.join(GROUPS)} or names such as drive.viscous[0]"
            raise ValueError(f"{takes}; got {word!r}. {meant}")
    names = [name for word in words for name in stands.get(word, (long.get(word, word),))]
    twice = [name for i, name in enumerate(names) if name in names[:i]]
    if twice and not any(word in stands for word in words):
        raise ValueError(
            f"unknown must name each number once; {twice[0]} comes twice. Leave one out."
        )
    return records, tuple(dict.fromkeys(names))


def with_zeros(records: Iterable[Record], zeros: Floats) -> list[Record]:
    """The same records with their encoder offsets (R, n) [rad] where they are."""
    pairs = zip(records, zeros, strict=True)
    return [
        dataclasses.replace(r, error_pulses=r.error_pulses - r.rig.position_in_pulses(zero))
        for r, zero in pairs
    ]


class Experiment:
    """The closed loop of a record and all that it needs to run.

    `places`: where the unknowns are among the loop's numbers. `driven`: path, clock, and what is
    replayed and injected: what a kernel is driven by. `numbers`: as the record says; f is NaN.
    `begin`: q and qd (n,) at its start, by the record's rig.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        record: Record,
        unknown: Sequence[str],
        *,
        smooth: bool = False,
        **options: Any,
    ) -> None:
        if record.law is None:
            raise ValueError(
                "the record must name the law that made it; got None. Pass law= when loading it."
            )
        if record.n != dynamics.n:
            raise ValueError(
                f"the record must have {dynamics.n} joints; it has {record.n}. Use one of this arm."
            )
        rig = smooth_rig(record.rig) if smooth else record.rig
        self.record, added = record, injected_beside(record)
        self.loop = closed_loop(
            dynamics=dynamics, rig=rig, law=record.law, injected=added is not None, **options
        )
        names = self.loop.number_names
        for name in unknown:
            if name not in names:
                hint = near(name, names, cutoff=0.6)
                if str(name).startswith("drive.curve"):
                    hint = "Give the drive a FrictionCurve first."
                if str(name).startswith("springs") and record.rig.springs is None:
                    hint = "Give the rig its springs first, such as a JointSpring."
                known = hint or f"Known: {several(names)}."
                raise ValueError(
                    f"unknown must name numbers of this experiment; got {name!r}. {known}"
                )
        open_f = [name for name in dynamics.names if name not in unknown]
        if open_f:
            raise ValueError(
                f"unknown must include all of f; {', '.join(open_f)} are missing. Add them to"
                " unknown, and fix what is known by equal ends of its range."
            )
        self.places = [names.index(name) for name in unknown]
        self.clock = Clock.of(record)
        path = self.path(smooth and not getattr(record.law, "rounds", False))
        self.driven = {
            "path": path,
            "clock": self.clock,
            "replayed": record.law.replayed(record),
            "injected": added,
        }
        self.numbers = self.loop.number_values(np.full(dynamics.p, np.nan))
        self.begin = start_of(record, path_of(record, self.clock))
        geared = [i for i, name in enumerate(names) if name.startswith(_GEARED)]
        self._geared = geared if set(geared) & set(self.places) else []

    def path(self, smooth: bool) -> Any:
        """The commanded path; smooth: not rounded to pulses."""
        return path_of(self.record, self.clock, smooth=smooth)

    def began(self, numbers: Floats) -> tuple[Floats, Floats]:
        """Position and speed (n,) at the start with these numbers (k,), or (n, P) with (k, P):
        where the counts say.

        Rows of numbers that no rig can have begin as by the record's rig.
        """
        every = np.reshape(numbers, (len(numbers), -1))
        if (every[self._geared] == self.numbers[self._geared, None]).all():
            return self.begin
        rig = self.record.rig
        own = self.record.rig.number_names()
        first = self.loop.number_names.index(own[0])
        states = []
        for row in every[first : first + len(own)].T:
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

    def data(self, measured: Floats) -> Floats:
        """What was measured (N, n), with the root of each sample's weight behind it, for all
        samples (M, n + 1).
        """
        return self.clock.measured(np.column_stack([measured, np.sqrt(self.record.valid)]))

    @property
    def steps(self) -> int:
        """Sub-steps of a whole run."""
        return len(self.clock) * self.loop.steps_per_sample


RATES = 16, 64, 256  # sub-steps per sample: fast hardware feels each count when it comes

_AT_ONCE = 1 << 17  # sub-steps that are simulated at once: their tables are large


class Rounding(Experiment):
    """The loop of a record, as `loop` has it, without correction and with rounding, which it feels
    at so many `steps` in a sample.
    """

    def __init__(self, loop: ClosedLoop, record: Record, steps: int) -> None:
        rig = record.rig
        n = record.n
        self._own = np.zeros(n) if rig.encoder.phase is None else rig.encoder.phase.shift
        phased = dataclasses.replace(
            rig, encoder=dataclasses.replace(rig.encoder, phase=Phase(shift=self._own))
        )
        super().__init__(
            loop.dynamics,
            dataclasses.replace(record, rig=phased),
            loop.dynamics.names,
            steps_per_sample=steps,
            sweeps=loop.sweeps,
        )
        self._phase = [self.loop.number_names.index(f"encoder.phase.shift[{i}]") for i in range(n)]
        self._kernel = logged_kernel(self.loop, self._phase, uneven=self.clock.even is None)
        self._reference = counts_along(self.driven["path"], self.clock.t)

    def path(self, smooth: bool) -> Any:
        """The commanded path; of logged counts, the smoothest motion that they allow, rounded at
        every instant.
        """
        path = super().path(smooth)
        return _Rounded(path) if isinstance(path, Logged) and path.whole else path

    def counts(
        self,
        start: Any,
        numbers: Floats,
        names: Sequence[str],
        shifts: Sequence[Floats],
        threads: int,
    ) -> list[Floats]:
        """Counts (N, n) from a start, with numbers (k,) of these names, for encoders shifted by
        so many pulses (n,).
        """
        own = self.numbers.copy()
        given = dict(zip(names, numbers.tolist(), strict=True))
        for i, name in enumerate(self.loop.number_names):
            own[i] = given.get(name, own[i])
        groups = [
            self._own + np.array(shifts[i : i + LOGGED]) for i in range(0, len(shifts), LOGGED)
        ]
        state = self.loop.initial_state(start[0], start[1], own)
        made = shared_out(functools.partial(self._group, state, own), groups, threads)
        return [counts for group in made for counts in group]

    def _group(self, start: Floats, numbers: Floats, phases: Floats) -> list[Floats]:
        """Counts (N, n) by encoders with these phases (W, n), side by side."""
        lanes = np.vstack([phases, phases[-1:].repeat(LOGGED - len(phases), axis=0)]).T.copy()
        state = start[:, None].repeat(LOGGED, axis=1)
        rows = self.clock.rows
        done = 0
        found = np.empty((len(phases), len(rows), self.loop.n))
        for tables in self._kernel.blocks(
            self.loop, **self.driven, samples=_AT_ONCE // self.loop.steps_per_sample
        ):
            state, errors = self._kernel.run(
                tables, len(tables[1]), state, lanes, numbers[list(self._kernel.uniform)]
            )
            own = slice(*np.searchsorted(rows, (done, done + len(errors))).tolist())
            for j, counts in enumerate(found):
                counts[own] = (self._reference[done : done + len(errors)] - errors[:, :, j])[
                    rows[own] - done
                ]
            done += len(errors)
        if not self.loop.sound(state).all() or not np.isfinite(found).all():
            raise ValueError(
                "the model must stay on the log's path; simulated with what was found, it diverges."
            )
        return list(found)


class _Rounded:
    """A smooth motion through logged counts, in counts."""

    def __init__(self, logged: Logged) -> None:
        self.logged = logged

    def __call__(self, t: Floats) -> tuple[Motion, Floats]:
        motion = self.logged.smoothed(t)
        return motion, self.logged.rig.counts(motion.q)

    def setpoint(self, t: Floats) -> Motion:
        """What a law is given at times t (N,)."""
        return self.logged.setpoint(t)

"""Input of a method of identification: experiments, unknowns, ranges, and parts of long logs.

Parts replace a long log in the genetic search and in the tests of the rig, where a fraction of its
samples suffices. They are spread evenly, so that they show slow and late changes; they may miss an
event that is shorter than the distance between two parts. The values of the fit and their
covariance come from all samples.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np

from identification.equation_error import Known, Memory, Prior
from identification.replay import Objective, Prediction
from identification.search.genetic import GeneticSettings
from plant import Arm, Dynamics, Law, Record, Resumed, Rig
from plant.machine import InnerLoop
from plant.parts import Checkpoint, Floats, Frozen, frozen, kept, real, signs


@kept
@frozen
class Tolerances(Frozen):
    """Standard deviations of the numbers that a rig states; zero takes a number as exact.

    Parameters
    ----------
    gear : float
        Of the gears, relative; it includes the errors of counts per turn and of lengths.
    offset : float
        Of a constant torque that each motor has besides its friction, as a share of the rms torque
        of that motor in the log.
    friction : float
        Of viscous and Coulomb friction that is not among the unknowns, as a share of the rms torque
        of the motor in the log.
    lag : float
        Lag of the currents behind the commands [s].
    delay : float
        Delay of the counts [samples].

    Raises
    ------
    ValueError
        A negative number.

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> from identification import Tolerances
    >>> Tolerances(gear=0.0).gear
    0.0
    """

    # Relative, and as shares of the torque in the log.
    gear: float = 0.008
    offset: float = 0.01
    friction: float = 0.01
    # Times; zero takes them as exact.
    lag: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        names = [field.name for field in dataclasses.fields(self)]
        for name in names:
            real(name, getattr(self, name), "Give a standard deviation; 0 takes it for exact.")
        signs(self, not_negative=names, advice="0 takes it for exact.")

    @property
    def within(self) -> str:
        """All that are not zero, as a text."""
        torque = "of the motor's torque (rms)"
        texts = (
            (self.gear, f"gears {100 * self.gear:g} %"),
            (self.offset, f"offsets of the torque {100 * self.offset:g} % {torque}"),
            (self.friction, f"friction that is not unknown {100 * self.friction:g} % {torque}"),
            (self.lag, f"lag {1e3 * self.lag:g} ms"),
            (self.delay, f"delay {self.delay:g} samples"),
        )
        return ", ".join(text for deviation, text in texts if deviation)

    def __str__(self) -> str:
        if not self.within:
            return "take the rig for exact, and the lengths of links"
        return f"a rig that is right within {self.within}, and links of exactly the stated lengths"

    @classmethod
    def none(cls) -> Self:
        """Tolerances of zero: the rig is exact."""
        return cls(**dict.fromkeys((field.name for field in dataclasses.fields(cls)), 0.0))


# Variance of the difference of two rounded logs [pulses^2]: rounding is uniform within a count,
# with variance 1 / 12, and objective (4) compares a measured log with a simulated one.
_TWO_ROUNDINGS = 1 / 6

# Names of numbers that cannot be negative: dissipation, stiffness, and gains of a stable loop.
_POSITIVE = re.compile(
    r"drive\.(viscous|coulomb|elasticity)|law\.gain|springs(\[\d+\])?\.stiffness"
)

# As a share of the stated number, or of 1 if that number is zero: the size of the negative value
# that tests whether a part accepts negative numbers, and the least value of an unknown that cannot
# be zero.
_TINY = 1e-9


@frozen
class Problem:
    """An identification problem: records, the names of the unknowns, their ranges, and options.

    `dynamics`, `records`, `unknown`: as for `identify`; a law with a memory reads the log of its
    record (`plant.AlongLog`), or the record repeats the logged torque. `objective`: objective (4)
    of these unknowns in these records. `held_out`: objective (4) of them in the validation records.
    `nominal` (k,): the values that rig and law of the first record state; NaN for the parameters f
    of the dynamics. `ranges` (k, 2) or None. `zeros`: whether the
    zeros of each record's counters are unknown. `options`: sub-steps, sweeps and threads of the
    model. `tolerances`: standard deviations of the numbers of the rigs. `show`: called with the
    best cost after each generation. `memories`: the unknown state of each record's law before the
    log. `prior`: of f, or None. `checkpoint`: storage of finished stages.
    """

    # The experiment.
    dynamics: Dynamics
    records: tuple[Record, ...]
    unknown: tuple[str, ...]
    objective: Objective
    held_out: Objective | None
    # Where to search, and how.
    nominal: Floats
    ranges: Floats | None
    method: str
    settings: GeneticSettings
    seed: int
    zeros: bool
    options: dict[str, Any]
    # Knowledge beside the records, and the course of the run.
    tolerances: Tolerances = dataclasses.field(default_factory=Tolerances)
    show: Callable[..., Any] | None = None
    memories: tuple[Memory | None, ...] = ()
    prior: Prior | None = None
    checkpoint: Checkpoint = dataclasses.field(default_factory=lambda: Checkpoint(None, ""))

    @property
    def inputs(self) -> dict[str, Any]:
        """Everything that determines the result, by name; a checkpoint refuses other inputs."""
        validation = None if self.held_out is None else self.held_out.records
        # The number of threads changes the time of a run, not its result.
        model = {name: value for name, value in self.options.items() if name != "threads"}
        return {
            "arm": self.dynamics,
            "log": (self.objective.records, validation),
            "unknowns": self.unknown,
            "method": self.method,
            "seed": self.seed,
            "settings": (
                self.settings,
                self.ranges,
                self.zeros,
                self.tolerances,
                model,
                self.prior,
            ),
        }

    @property
    def replays(self) -> list[bool]:
        """Whether the law of each record replays logged values in place of a controller."""
        return [record.law is not None and bool(record.law.replays) for record in self.records]

    @property
    def repeats_torques(self) -> bool:
        """Whether every record repeats its logged torques or currents."""
        laws = [record.law for record in self.records]
        return all(law is not None and law.replays in ("torque", "current") for law in laws)

    @property
    def each_memory(self) -> list[Memory | None]:
        """The unknown state of the law of each record, or None."""
        return list(self.memories or [None] * len(self.records))

    @property
    def elastic(self) -> bool:
        """Whether the gears of any record are elastic."""
        return any(record.rig.drive.elasticity is not None for record in self.records)

    @property
    def everywhere(self) -> Floats | None:
        """Ranges (k, 2) of the problem; without them, those of the dynamics if only f is unknown.

        None if neither exists.
        """
        ranges = self.dynamics.ranges
        # The dynamics have ranges of f alone.
        if self.ranges is None and ranges is not None and self.unknown == self.dynamics.names:
            return np.array(ranges)
        return self.ranges

    @property
    def known(self) -> Known:
        """The unknowns whose range has two equal ends, name -> value; and the prior."""
        # Methods leave these numbers out of every fit.
        rows = () if self.ranges is None else zip(self.unknown, self.ranges.tolist(), strict=True)
        return Known({name: low for name, (low, high) in rows if low == high}, self.prior)

    @property
    def bounds(self) -> Floats:
        """Ranges (k, 2) of the problem, or, if it has none, the physical limits of each unknown."""
        if self.ranges is not None:
            return self.ranges
        low = [self._least(name) for name in self.unknown]
        return np.column_stack([low, np.full(len(low), np.inf)])

    def _least(self, name: str) -> float:
        """Least value of an unknown that its part accepts; -inf where it takes any sign."""
        if _POSITIVE.match(name):
            return 0.0
        if name in self.dynamics.names:
            return -np.inf
        stated = float(self.nominal[self.unknown.index(name)])
        tiny = _TINY * (stated or 1.0)
        if stated < 0 or self._accepts(name, -tiny):
            return -np.inf
        return 0.0 if self._accepts(name, 0.0) else tiny

    def _accepts(self, name: str, value: float) -> bool:
        """Whether rig and law of the first record can have this value of an unknown."""
        record = self.objective.records[0]
        law: Any = record.law  # an Objective refuses records without a law
        named = dict(zip(self.unknown, self.nominal.tolist(), strict=True)) | {name: value}
        # A part checks its numbers when it is made.
        try:
            record.rig.filled(named)
            law.filled(named, "law.")
        except ValueError:
            return False
        return True

    @property
    def steps(self) -> int:
        """Steps of the model per sample."""
        return int(self.options.get("steps_per_sample", 4))

    def in_steps(self, count: int) -> Self:
        """The same problem, whose model takes at least `count` steps per sample."""
        if self.steps >= count:
            return self
        options = self.options | {"steps_per_sample": count}

        def refined(objective: Objective) -> Objective:
            return Objective(self.dynamics, objective.records, objective.unknown, **options)

        return dataclasses.replace(
            self,
            options=options,
            objective=refined(self.objective),
            held_out=None if self.held_out is None else refined(self.held_out),
        )

    def prediction(self, **settings: Any) -> Prediction:
        """`Prediction` of these unknowns in these records; `settings`: further arguments of it."""
        return Prediction(
            self.dynamics, self.records, self.unknown, prior=self.prior, **settings, **self.options
        )

    def costs(self, vectors: Floats) -> Floats:
        """Objective (4) of vectors (P, k) with the cost of the prior [pulses^2].

        The squares of the prior have unit variance. The noise of objective (4) has the variance of
        two roundings, which therefore scales these squares to pulses^2.
        """
        costs = self.objective(vectors)
        if self.prior is None:
            return costs
        columns = self.prior.places(self.unknown)
        return costs + _TWO_ROUNDINGS * self.prior.squares(vectors[:, columns])

    def parts(self, values: Floats) -> tuple[Arm, Rig, Law]:
        """Arm, rig and law of the first record with these values (k,) of the unknowns."""
        named = dict(zip(self.unknown, values, strict=True))
        record = self.objective.records[0]
        law: Any = record.law  # an Objective refuses records without a law
        law = law.filled(named, "law.")
        # The state belongs to the record, not to the identified controller.
        if isinstance(law, Resumed):
            law = law.law
        arm = self.dynamics.arm([named[name] for name in self.dynamics.names])
        rig = record.rig.filled(named)
        # If the law of the log is an inner loop, later laws run above it: it goes into the rig.
        if isinstance(law, InnerLoop):
            rig = dataclasses.replace(rig, inner=law)
        return arm, rig, law


# A record of more samples than this is long; parts of as many samples in all replace it.
LONG = 50_000
PARTS = 20

# A part with less than this share of the count changes of the liveliest part in its stretch gives
# way to that one. Chosen by hand: evenly spread parts are right unless they mostly rest.
_STILL = 0.5


def is_long(record: Record) -> bool:
    """Whether parts replace a record: it is long, and its law and rig can start in the middle."""
    law = record.law
    rig = record.rig
    if len(record) <= LONG or law is None or law.replays == "counts":
        return False
    # The state of a law, and counts in transport, come from samples before the part.
    remembers = not law.replays and law.has_memory(record.n)
    return not remembers and rig.transport is None and rig.jitter is None


def parts_of(record: Record) -> list[slice]:
    """Return the samples of each part of a record; one slice of all samples if it is not replaced.

    The record is divided into `PARTS` stretches with one part each. The parts are evenly spread,
    but a part with few count changes gives way to the part of its stretch with the most of them.
    """
    if not is_long(record):
        return [slice(0, len(record))]
    # Samples of a part.
    size = LONG // PARTS
    count = len(record)
    # A sample reads a joint when its count changes; invalid samples read nothing.
    moved = np.minimum(np.abs(np.diff(record.counts, axis=0)), 1).sum(axis=1) * record.valid[1:]
    # Running sum of the joints that changed their count up to each sample, so that a difference of
    # two entries gives the readings of a part.
    changes = np.concatenate([[0, 0], np.cumsum(moved)])
    parts = []
    ends = np.linspace(0, count, PARTS + 1).astype(int)
    evenly = np.linspace(0, count - size, PARTS).astype(int)
    for low, high, even in zip(ends[:-1], ends[1:], evenly, strict=True):
        # Candidates overlap by three quarters; the evenly spread one comes last.
        begins = np.append(np.arange(low, high - size + 1, size // 4), even)
        readings = changes[begins + size] - changes[begins]
        begin = int(even if readings[-1] >= _STILL * readings.max() else begins[readings.argmax()])
        parts.append(slice(begin, begin + size))
    return parts


def in_parts(record: Record) -> list[Record]:
    """The parts of a record as records; a short record as it is."""
    if not is_long(record):
        return [record]
    # `cut` leaves out the sample at its second time, so a cut up to infinity keeps the last sample.
    ends = np.append(record.t, np.inf)
    return [record.cut(ends[rows.start], ends[rows.stop]) for rows in parts_of(record)]


def rows_of_parts(
    innovations: Floats | None, records: Sequence[Record], begin: int
) -> Floats | None:
    """Select the innovations of the parts from those (M,) of all samples and joints.

    The first `begin` rows precede those of all records. They belong to a prior, and are kept.
    """
    if innovations is None:
        return None
    # Innovations are stored sample by sample, all joints of a sample together.
    rows = [np.arange(begin)]
    for record in records:
        n = record.n
        rows += [
            np.arange(begin + part.start * n, begin + part.stop * n) for part in parts_of(record)
        ]
        begin += record.counts.size
    return innovations[np.concatenate(rows)]

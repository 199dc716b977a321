"""What a method of identification is given: experiments, unknowns, and where to look.

Parts stand for a long log where a fraction of it tells enough: in the genetic search, and in tests
of the rig. They are spread over all of it, so that what changes slowly, or late, is in them; what
lasts shorter than from one to the next may be in none. Values and the covariance of the fit are
those of the whole log.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np

from identification.equation_error.law_memory import Memory
from identification.equation_error.prior import Known, Prior
from identification.replay.objective import Objective
from identification.replay.prediction import Prediction
from identification.search.genetic import GeneticSettings
from plant import Arm, Dynamics, Law, Record, Resumed, Rig
from plant.parts.arguments import real, signs
from plant.parts.checkpoint import Checkpoint
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Tolerances(Frozen):
    """Standard deviations of what a rig states; zero takes a number for exact.

    Parameters
    ----------
    gear : float
        Of the gears, with counts per turn and lengths, relative.
    offset : float
        Of a constant torque of each motor beside its friction, as a share of its torque in the log
        (rms).
    friction : float
        Of viscous and Coulomb numbers that are not unknowns, as a share of the motor's torque in
        the log (rms).
    lag : float
        Of currents behind commands [s].
    delay : float
        Of the counts [samples].

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

    gear: float = 0.008
    offset: float = 0.01
    friction: float = 0.01
    lag: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name in (names := [field.name for field in dataclasses.fields(self)]):
            real(name, getattr(self, name), "Give a standard deviation; 0 takes it for exact.")
        signs(self, not_negative=names, advice="0 takes it for exact.")

    def __str__(self) -> str:
        torque = "of the motor's torque (rms)"
        said = []
        said += [f"gears {100 * self.gear:g} %"] * bool(self.gear)
        said += [f"offsets of the torque {100 * self.offset:g} % {torque}"] * bool(self.offset)
        said += [f"friction that is not unknown {100 * self.friction:g} % {torque}"] * bool(
            self.friction
        )
        said += [f"lag {1e3 * self.lag:g} ms"] * bool(self.lag) + [
            f"delay {self.delay:g} samples"
        ] * bool(self.delay)
        if not said:
            return "take the rig for exact, and the lengths of links"
        return (
            f"a rig that is right within {', '.join(said)}, and links of exactly the stated lengths"
        )

    @classmethod
    def none(cls) -> Self:
        """All that the rig states taken for exact."""
        return cls(**dict.fromkeys((field.name for field in dataclasses.fields(cls)), 0.0))


_TWO_ROUNDINGS = 1 / 6  # variance of the difference of two logs that are rounded [pulses^2]

# What the names of numbers that cannot be negative begin with.
_POSITIVE = re.compile(
    r"drive\.(viscous|coulomb|elasticity)|law\.gain|springs(\[\d+\])?\.stiffness"
)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What is unknown in which records, and where to look for it.

    `dynamics`, `records`, `unknown`: as for `identify`; records of laws with a memory read their
    log (`plant.AlongLog`), or repeat its torque. `objective`: of these unknowns in these records.
    `held_out`: the same in the records that are not searched. `nominal` (k,): the unknowns as rig
    and law of the first record have them; NaN for f. `ranges` (k, 2) or None. `zeros`: whether the
    zeros of each record's counters are unknown. `options`: sub-steps, sweeps and threads of the
    model. `tolerances`: within which the records' rigs are right. `show`: called with the best cost
    after each generation. `memories`: of each record, what is unknown of its law's state before the
    log. `prior`: of f, or None. `checkpoint`: where finished stages are kept.
    """

    dynamics: Dynamics
    records: tuple[Record, ...]
    unknown: tuple[str, ...]
    objective: Objective
    held_out: Objective | None
    nominal: Floats
    ranges: Floats | None
    method: str
    settings: GeneticSettings
    seed: int
    zeros: bool
    options: dict[str, Any]
    tolerances: Tolerances = dataclasses.field(default_factory=Tolerances)
    show: Callable[..., Any] | None = None
    memories: tuple[Memory | None, ...] = ()
    prior: Prior | None = None
    checkpoint: Checkpoint = dataclasses.field(default_factory=lambda: Checkpoint(None, ""))

    @property
    def inputs(self) -> dict[str, Any]:
        """All that decides the result, by name."""
        kept = None if self.held_out is None else self.held_out.records
        model = {name: value for name, value in self.options.items() if name != "threads"}
        return {
            "arm": self.dynamics,
            "log": (self.objective.records, kept),
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
        """Of each record, whether its law repeats logged torques in place of a controller."""
        return [record.law is not None and bool(record.law.replays) for record in self.records]

    @property
    def elastic(self) -> bool:
        """Whether the gears of a record are elastic."""
        return any(record.rig.drive.elasticity is not None for record in self.records)

    @property
    def everywhere(self) -> Floats | None:
        """Ranges (k, 2), or those of the dynamics; None where there are neither."""
        if (
            self.ranges is None
            and self.unknown == self.dynamics.names
            and self.dynamics.ranges is not None
        ):
            return np.array(self.dynamics.ranges)
        return self.ranges

    @property
    def known(self) -> Known:
        """What needs no search, because both ends of its range are one: name -> value; and the
        prior.
        """
        rows = () if self.ranges is None else zip(self.unknown, self.ranges.tolist(), strict=True)
        return Known({name: low for name, (low, high) in rows if low == high}, self.prior)

    @property
    def bounds(self) -> Floats:
        """Ranges (k, 2), or what physics says where there are none."""
        if self.ranges is not None:
            return self.ranges
        low = [0.0 if _POSITIVE.match(name) else -np.inf for name in self.unknown]
        return np.column_stack([low, np.full(len(low), np.inf)])

    def prediction(self, **settings: Any) -> Prediction:
        """Of these unknowns in these records; `settings`: those of `Prediction` beside its
        options.
        """
        return Prediction(
            self.dynamics, self.records, self.unknown, prior=self.prior, **settings, **self.options
        )

    def costs(self, vectors: Floats) -> Floats:
        """Objective (4) of vectors (P, k), with what the prior costs where two roundings are the
        noise [pulses^2].
        """
        costs = self.objective(vectors)
        if self.prior is None:
            return costs
        return costs + _TWO_ROUNDINGS * self.prior.squares(
            vectors[:, self.prior.places(self.unknown)]
        )

    def parts(self, values: Floats) -> tuple[Arm, Rig, Law]:
        """Arm, rig and law of the first record with these values (k,) of the unknowns."""
        named = dict(zip(self.unknown, values, strict=True))
        first = self.objective.records[0]
        law = first.law.filled(named, "law.")  # type: ignore[union-attr]  # an Objective refuses records without a law
        law = law.law if isinstance(law, Resumed) else law
        return (
            self.dynamics.arm([named[name] for name in self.dynamics.names]),
            first.rig.filled(named),
            law,
        )


# Samples above which a record is long, and parts that stand for it then, of so many samples
# together.
LONG = 50_000
PARTS = 20

# readings of a part, in those of the best one of its stretch, below which that one is taken
_STILL = 0.5


def is_long(record: Record) -> bool:
    """Whether parts stand for a record: not if its law or rig cannot go on from the middle of
    it.
    """
    law = record.law
    rig = record.rig
    knows = (
        law is not None
        and law.replays != "counts"
        and (law.replays or not law.has_memory(record.n))
    )
    return len(record) > LONG and knows and rig.transport is None and rig.jitter is None


def parts_of(record: Record) -> list[slice]:
    """Samples of the parts of a record: evenly from first to last where it moves; all of a short
    one.

    A part in which few counts change is replaced by the one in its twentieth of the record in which
    most do.
    """
    if not is_long(record):
        return [slice(0, len(record))]
    size = LONG // PARTS
    count = len(record)
    moved = np.minimum(np.abs(np.diff(record.counts, axis=0)), 1).sum(axis=1) * record.valid[1:]
    seen = np.concatenate([[0, 0], np.cumsum(moved)])
    found = list[slice]()
    ends = np.linspace(0, count, PARTS + 1).astype(int)
    for first, last, even in zip(
        ends, ends[1:], np.linspace(0, count - size, PARTS).astype(int), strict=False
    ):
        begins = np.append(np.arange(first, last - size + 1, size // 4), even)
        readings = seen[begins + size] - seen[begins]
        begin = int(even if readings[-1] >= _STILL * readings.max() else begins[readings.argmax()])
        found.append(slice(begin, begin + size))
    return found


def in_parts(record: Record) -> list[Record]:
    """The parts of a record as records; a short one as it is."""
    if not is_long(record):
        return [record]
    ends = np.append(record.t, np.inf)
    return [record.cut(ends[rows.start], ends[rows.stop]) for rows in parts_of(record)]


def rows_of_parts(whole: Floats | None, records: Sequence[Record], before: int) -> Floats | None:
    """Rows of the parts, of rows (M,) of all samples and joints of records with so many rows
    before them.
    """
    if whole is None:
        return None
    kept = [np.arange(before)]
    begin = before
    for record in records:
        kept += [
            np.arange(begin + rows.start * record.n, begin + rows.stop * record.n)
            for rows in parts_of(record)
        ]
        begin += record.counts.size
    return whole[np.concatenate(kept)]

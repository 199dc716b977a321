"""A model with numbers that its rig leaves out, such as elastic gears, a lag, other friction.

Each such number is zero where the rig is right. The innovations are those of `Prediction`, from one
compiled loop, in which currents that do not lag follow at once. Elastic gears need another loop,
with springs. At coarse sub-steps, a joint with even the stiffest springs does not stick quite like
one with rigid gears when it reverses; a log would seem to contradict these springs.
"""

import copy
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from identification.equation_error import Prior, PriorRows, between_samples
from identification.replay.prediction import Prediction
from identification.replay.residual import Stacked
from identification.replay.timing import without_delay
from plant import Dynamics, Elasticity, FrictionCurve, Law, Record
from plant.compiler import cores
from plant.parts import Floats, frozen_settings, instance


@frozen_settings
class ExtensionSettings:
    """Numbers of a rig that stand for an effect which is absent, and limits of its size.

    Parameters
    ----------
    rigid : float
        Locked-rotor resonance of a gear that is as good as rigid [Hz]; chosen by hand.
    prompt : float
        Time constant of currents that do not lag [s]; chosen by hand.
    damping : float
        Damping ratio of gears that are tested: the middle of the usual range, at which the
        detection is measured.
    """

    rigid: float = 1e5
    prompt: float = 1e-9
    damping: float = 0.02


SETTINGS = ExtensionSettings()

_SPRINGS = "drive.elasticity"  # beginning of the numbers of a loop with elastic gears


@dataclass(frozen=True, kw_only=True)
class Number:
    """A kind of number that is zero in a model where its rig, or its law, is right.

    Parameters
    ----------
    name : str
        Kind, "gear"; the number of a joint is ``gear[1]``, that of a law ``law.gain[1]``.
    place : str
        Where its value is among the numbers of the rig, ``drive.gear``; "law" of those of a law;
        empty where the model has no such number.
    of_joints : bool
        Whether each joint has one.
    relative : bool
        Whether it is a relative error of the stated value; otherwise it is added to it.
    least : float
        Lowest value.
    removable : bool
        Whether its lowest value is the one that takes away all of the stated value.
    gives : bool
        Whether it acts only in a loop with elastic gears.
    step : float
        Size at which its effect is computed, small enough that the effect is linear.
    scale : callable, optional
        ``scale(torque, speed)`` is the unit (n,) of step and tolerance, from torque [N m] and speed
        [rad/s] of each motor (rms).
    tolerance : str
        Field of `Tolerances` that states its standard deviation.
    unit : str
        Its unit in messages.
    """

    name: str
    place: str
    of_joints: bool = True
    relative: bool = False
    least: float = 0.0
    removable: bool = False
    gives: bool = False
    step: float = 0.0
    scale: Callable[[Floats, Floats], Floats] | None = None
    tolerance: str = ""
    unit: str = ""

    @classmethod
    def share(cls, name: str, place: str, *, of_joints: bool = True, tolerance: str = "") -> Self:
        """A relative error of the stated value, which lowers that value by half at most."""
        # A larger change is not an error of one number; below -1 the value would change its sign.
        return cls(
            name=name,
            place=place,
            of_joints=of_joints,
            relative=True,
            least=-0.5,
            step=1e-4,
            tolerance=tolerance,
        )

    def size(self, share: float, name: str, efforts: Floats) -> float:
        """A share of the unit of one of these numbers; `efforts` (2, n): torque and speed."""
        return share * float(self.scale(*efforts)[joint_of(name)]) if self.scale else share


def kind_of(name: str) -> str:
    """Kind of a number: "gear" of ``gear[1]``, "law" of ``law.gain[0]``."""
    return name.partition("[")[0].partition(".")[0]


def joint_of(name: str) -> int:
    """Joint of a number such as ``gear[1]``."""
    return int(name.partition("[")[2].partition("]")[0])


class Extended(Stacked):
    """Innovations of a model that follows records, with effects that its rig leaves out.

    `unknown`: all of f, and numbers of rig and law. `f` (p,): approximate values, from which the
    link inertia behind each elastic gear follows. `numbers`: kinds of numbers that the rig may
    leave out. `prior`: of f. `runs`: number of consecutive records that make up each run of the
    robot; by default each record is a run. `**options`: sub-steps and sweeps, as for `Prediction`.

    Attributes: `unknown`: names of the values that `innovations` takes: the given names, observer
    gains, then `extra`. `extra`: names of the numbers that are zero where the rig is right. Those
    that need elastic gears are missing where the motor inertia is unknown or D does not exceed it.
    `kinds`: the kind of each name. `gains`, `gain_steps` (2n,): observer gains to begin with, and
    steps of their central differences. `gain_bounds` (2n, 2). `least` (e,): the lowest value of
    each of `extra`. `weights`, `scales` (M,): as of `Prediction`. `rounding` (M,): innovations
    caused by the rounding of counts, which acted on the real loop and which this model omits; zero
    unless set. `between`: sum of squares [pulses^2] of the innovations that the torque of a faster
    loop may cause between the samples of a log; zero where no loop is faster.
    """

    between = 0.0

    def __init__(
        self,
        dynamics: Dynamics,
        records: Sequence[Record],
        unknown: Sequence[str],
        f: Floats,
        numbers: Sequence[Number],
        *,
        prior: Prior | None = None,
        runs: Sequence[int] | None = None,
        threads: int | None = None,
        **options,
    ) -> None:
        links = _link_inertia(dynamics, records[0], f)
        self.dynamics = dynamics
        # A torque is injected into each record, zero if need be: one kernel serves all of them.
        self.records = tuple(replace(record, injected=_beside(record)) for record in records)
        self.threads = int(threads or cores())
        # The prior is of all records together: each record's prediction has none.
        settings = {**options, "threads": self.threads, "moving": prior is not None}
        self._logs = [
            _Log(dynamics, record, tuple(unknown), links, numbers, settings)
            for record in self.records
        ]
        # `late` and `of` make the model again, with other records or another arm.
        arguments = {"prior": prior, "runs": runs, "threads": threads, **options}
        self._again = lambda dynamics, records: Extended(
            dynamics, records, unknown, f, numbers, **arguments
        )
        self._runs = [1] * len(self.records) if runs is None else runs
        # Observer gains, by their names and bounds the same for each record.
        prediction = self._logs[0].prediction
        self.gains = prediction.nuisances
        self.gain_steps = prediction.nuisance_steps
        self.gain_bounds = prediction.nuisance_bounds
        # Records of different laws have different numbers of the law.
        least: dict[str, float] = {}
        self.kinds: dict[str, Number] = {}
        for log in reversed(self._logs):
            self.kinds = {**log.kinds, **self.kinds}
            least |= {name: log.least(name) for name in log.kinds}
        self.extra = tuple(self.kinds)
        self.least = np.array([least[name] for name in self.extra])
        gain_names = prediction.unknown[len(prediction.unknown) - len(self.gains) :]
        self.unknown = (*unknown, *gain_names, *self.extra)
        weights = [log.prediction.weights for log in self._logs]
        super().__init__(PriorRows(prior, self.unknown), weights)
        self.rounding = np.zeros(len(self.weights))

    def all_innovations(self, vectors: Iterable[Floats]) -> list[Floats]:
        """Innovations (M,) at each of several vectors, less those that rounding causes."""
        rows = super().all_innovations(vectors)
        for row in rows:
            row -= self.rounding
        return rows

    def parts(self, vectors: Sequence[Floats]) -> Iterator[list[Floats]]:
        """Rows of each record with each of the vectors."""
        for log in self._logs:
            yield log.all_innovations([self._apart(values) for values in vectors])

    def _apart(self, values):
        """Unknowns and observer gains, and the extra numbers by name."""
        count = len(values) - len(self.extra)
        return values[:count], dict(zip(self.extra, values[count:], strict=True))

    def late(self, samples: float) -> "Extended":
        """The same model, following records whose counts are so many samples later."""
        records = [without_delay(record, -samples) for record in self.records]
        return self._other(self.dynamics, records)

    def of(self, dynamics: Dynamics) -> "Extended":
        """The same model of another arm, whose f have the same names."""
        return self._other(dynamics, self.records)

    def _other(self, dynamics, records):
        model = self._again(dynamics, records)
        # The same weights: sums of squares of both are compared.
        model.scales = self.scales
        model.rounding = self.rounding
        model.prior = self.prior
        model.between = self.between
        return model

    def read_between(self, values: Floats) -> None:
        """Find `between` at these values."""
        changes = map(between_samples, self.records)
        torques = [
            np.zeros(record.counts.shape) if change is None else change
            for record, change in zip(self.records, changes, strict=True)
        ]
        if any(map(np.any, torques)):
            change = self.pushed(torques).innovations(values) - self.innovations(values)
            self.between = float((change**2).sum())

    def pushed(self, torques: Sequence[Floats]) -> "Extended":
        """The same model, with torques (N, n) [N m] along each record beside those of its law."""
        model = copy.copy(self)
        injected = [
            _beside(record) + torque for record, torque in zip(self.records, torques, strict=True)
        ]
        model.records = tuple(
            replace(record, injected=torque)
            for record, torque in zip(self.records, injected, strict=True)
        )
        # Only the injected column changes: kernels and tables of the path stay.
        model._logs = [log.beside(torque) for log, torque in zip(self._logs, injected, strict=True)]
        return model

    def stated(self) -> dict[str, float]:
        """Friction that the first rig states, by the names of what is beyond it."""
        # The least that friction beyond the stated can be is the stated friction, taken away.
        return {
            name: -least
            for name, least in zip(self.extra, self.least.tolist(), strict=True)
            if self.kinds[name].removable and least < 0
        }

    def place(self, name: str) -> int:
        """Where one of `extra` is among the unknowns."""
        return len(self.unknown) - len(self.extra) + self.extra.index(name)

    def rows(self) -> list[slice]:
        """Where the innovations of each record are."""
        lengths = [self.prior.count, *(len(log.prediction.weights) for log in self._logs)]
        ends = np.cumsum(lengths).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    def runs(self) -> list[slice]:
        """Where the innovations of each run are."""
        rows = self.rows()
        # A run is a number of records that follow one another: from the first row of the first to
        # the last row of the last.
        ends = [0, *np.cumsum(self._runs).tolist()]
        return [
            slice(rows[begin].start, rows[end - 1].stop) for begin, end in itertools.pairwise(ends)
        ]


def _beside(record):
    """Torque (N, n) [N m] that is injected, zero where none is."""
    return np.zeros(record.counts.shape) if record.injected is None else record.injected


def _link_inertia(dynamics, record, f):
    """Inertia (n,) that each gear drives where a log begins [kg m^2].

    None where none is left beside the motor's.
    """
    pose = record.rig.cell_centre(record.counts[0])
    rotors = record.rig.drive.reflected_inertia()
    inertia = dynamics.chain.coupling.shaft_inertia(ca.DM(dynamics.arm(f).D(pose))).full()
    # D counts the rotors, which are on the motor's side of the gear.
    links = np.diag(inertia) - rotors
    return links if (links > 0).all() and (rotors > 0).all() else None


class _Log:
    """One record, followed by a model whose gears can give and whose currents can lag.

    `kinds`: the kind of each number that may be wrong, by its name. `prediction`: the model with
    rigid gears.
    """

    def __init__(self, dynamics, record, unknown, links, numbers, options):
        self._links = links
        self._damped = record.rig.drive.elasticity is not None
        self._springs = None
        rig = _with_springs(record.rig, links)

        # 1. Numbers of rig and law that can be changed, as they are stated. Those of a law with
        # memory cannot: its state in the log is that of the stated ones.
        law = instance("law", record.law, Law, "Give the record its law.")
        of_rig = rig.numbers()
        of_law = {}
        if not (law.replays or law.has_memory(rig.n)):
            of_law = {
                name: value for name, value in law.numbers("law.").items() if name not in unknown
            }
        # Without an inertia behind the gear no resonance is defined, and so no compliance.
        numbers = [
            number for number in numbers if number.place and (links is not None or not number.gives)
        ]
        joints = [f"[{i}]" for i in range(rig.n)]
        self.kinds = {
            f"{number.name}{joint}": number
            for number in numbers
            if number.of_joints
            for joint in joints
        }
        for number in numbers:
            if not number.of_joints:
                names = of_law if number.place == "law" else (number.name,)
                self.kinds |= dict.fromkeys(names, number)
        places = (_SPRINGS, *(number.place for number in numbers))
        self._stated = {
            name: value
            for name, value in of_rig.items()
            if name.startswith(places) and name not in unknown
        }
        self._stated |= of_law
        self._given = len(unknown)

        # 2. The loop with rigid gears; that with springs is compiled when a gear first gives.
        self._rigid = rig.drive.elasticity is not None and not self._damped
        plain = rig
        if self._rigid:
            drive = replace(rig.drive, elasticity=None)
            plain = replace(rig, drive=drive)
        self._made = lambda rig, names: Prediction(
            dynamics, replace(record, rig=rig), (*unknown, *names), **options
        )
        self._sprung = rig
        self.prediction = self._made(plain, self._names(giving=False))

    def beside(self, torque):
        """The same with another torque (N, n) [N m] injected."""
        log = copy.copy(self)
        log.prediction = self.prediction.beside([torque])
        # Made again when it is needed, with that torque.
        log._springs = None
        log._made = lambda rig, names: self._made(rig, names).beside([torque])
        return log

    def _names(self, *, giving):
        """Of what is stated, in a loop with springs or without."""
        return [
            name
            for name in self._stated
            if giving or not (self._rigid and name.startswith(_SPRINGS))
        ]

    def all_innovations(self, vectors):
        """Innovations at values and extra numbers, each in the loop that it needs."""
        # Numbers of the laws of other records do nothing here.
        vectors = [
            (values, {name: extra[name] for name in extra if name in self.kinds})
            for values, extra in vectors
        ]
        # Stiff springs are not quite rigid gears: only vectors whose gears give take that loop.
        gives = [
            self._rigid and any(extra[name] for name in extra if self.kinds[name].gives)
            for _, extra in vectors
        ]
        if any(gives) and self._springs is None:
            self._springs = self._made(self._sprung, self._names(giving=True))
        # Each loop simulates its vectors side by side; the results go back to their order.
        of_loop = {}
        for giving, prediction in ((False, self.prediction), (True, self._springs)):
            numbers = [
                self._numbers(values, extra, giving=giving)
                for (values, extra), in_loop in zip(vectors, gives, strict=True)
                if in_loop == giving
            ]
            rows = prediction.all_innovations(numbers) if prediction is not None and numbers else ()
            of_loop[giving] = iter(rows)
        return [next(of_loop[giving]) for giving in gives]

    def _numbers(self, values, extra, *, giving):
        """The vector of unknowns that the prediction takes."""
        # From what is stated to what the extra numbers make of it, in the order of the names.
        numbers = {name: self._stated[name] for name in self._names(giving=giving)}
        for name, value in extra.items():
            # Zero changes nothing, and nearly all of them are zero in each of many vectors.
            if not value:
                continue
            number = self.kinds[name]
            place = self._place(name)
            # A compliance is not a number of the rig: it becomes a stiffness, and with it a
            # damping.
            if number.name == "compliance" and value > 0:
                self._give(numbers, name, value)
            elif place in numbers:
                stated = numbers[place]
                if number.relative:
                    numbers[place] = stated * (1 + value)
                else:
                    # A difference of the slopes may go below the least that the number can be.
                    numbers[place] = stated + max(value, self.least(name))
        return np.concatenate(
            [values[: self._given], list(numbers.values()), values[self._given :]]
        )

    def _place(self, name):
        """Where one of the extra numbers is among those of the rig or the law."""
        number = self.kinds[name]
        return name if number.place == "law" else number.place + name.removeprefix(number.name)

    def least(self, name):
        """The least that one of the extra numbers can be."""
        number = self.kinds[name]
        # What is stated can be taken away, and no more.
        # No -0.0, which is printed.
        return (
            -self._stated.get(self._place(name), 0.0) or 0.0 if number.removable else number.least
        )

    def _give(self, numbers, name, compliance):
        """Put a spring of so much compliance [1/Hz^2] in series with a gear."""
        place = self._place(name)
        if place not in numbers:
            return
        link = self._links[joint_of(name)]
        # Compliances in series add. k = m omega^2, where m is the link and the rotor is locked.
        numbers[place] = 1 / (1 / numbers[place] + compliance / (4 * np.pi**2 * link))
        if not self._damped:
            # Of the damping ratio zeta: d = 2 zeta sqrt(k m).
            damping = 2 * SETTINGS.damping * float(np.sqrt(numbers[place] * link))
            numbers[place.replace("stiffness", "damping")] = damping


def _with_springs(rig, links):
    """An equivalent rig that has numbers for elasticity, lagging currents and torque offsets."""
    drive = rig.drive
    gears = drive.elasticity
    if gears is None and links is not None:
        # k = m omega^2 of a resonance so high that the gear is as good as rigid.
        stiffness = links * (2 * np.pi * SETTINGS.rigid) ** 2
        damping = 2 * SETTINGS.damping * np.sqrt(stiffness * links)
        gears = Elasticity(stiffness=stiffness, damping=damping)
    # A gear whose stiffness is stated may have backlash beside it.
    if gears is not None and gears.backlash is None:
        gears = replace(gears, backlash=np.zeros(rig.n))
    # A loop has these numbers only if its rig states them: with values that change nothing.
    lag = drive.current_lag or SETTINGS.prompt
    curve = drive.curve or FrictionCurve(offset=np.zeros(rig.n))
    drive = replace(drive, elasticity=gears, current_lag=lag, curve=curve)
    return replace(rig, drive=drive)

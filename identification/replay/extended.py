"""A model with what its rig leaves out: elastic gears, backlash, lagging currents, other friction,
late counts.

Each is a number that is zero where the rig is right. The innovations are those of `Prediction`, of
one compiled loop whose currents are prompt where they do not lag. Where gears are elastic it is
another, with springs: at coarse sub-steps even the stiffest do not stick quite like rigid ones
where a joint turns back, which a log would be taken to contradict.
"""

import copy
import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from identification.equation_error.prior import Prior, PriorRows
from identification.replay.followed import joined
from identification.replay.prediction import Prediction
from identification.replay.timing import without_delay
from plant import Dynamics, Elasticity, FrictionCurve, Law, Record, Rig
from plant.compiler.background import cores
from plant.parts.arguments import instance
from plant.parts.fields import Floats

_RIGID = 1e5  # locked-rotor resonance of a rigid gear [Hz]

_PROMPT = 1e-9  # lag of currents that do not lag [s]

# Damping ratio of gears that are tested: the middle of the usual range, at which the detection is
# measured.
_DAMPING = 0.02

_PLACES = {
    "backlash": "drive.elasticity.backlash",
    "lag": "drive.current_lag.time",
    "offset": "drive.curve.offset",
}

_FRICTION = ("viscous", "coulomb")

_GIVING = ("compliance", "backlash")

# what is a relative error of a number, and how far below it may be
_SHARES = ("gear", "motor_gain", "law.")

_LEAST_SHARE = -0.5


class Extended:
    """Innovations of a model that follows records, with what its rig leaves out.

    `unknown`: all of f, and numbers of rig and law. `f` (p,): known roughly: it says what the links
    weigh whose gears give. `prior`: of f. `runs`: how many of the records, one after another, are
    parts of each run of the robot; by default each is one. `**options`: sub-steps and sweeps, as
    for `Prediction`.

    Attributes: `unknown`: what `innovations` takes values for: the given names, observer gains,
    then `extra`. `extra`: what the rig may leave out, or have wrong, zero where it is right:
    ``compliance[i]``, one over the square of the locked-rotor resonance [1/Hz^2]; ``backlash[i]``
    [rad]; ``viscous[i]`` and ``coulomb[i]``, friction beyond the rig's, motor side [N m s/rad, N
    m]; ``lag`` of the currents [s]; relative errors of ``gear[i]``, ``motor_gain[i]`` and of the
    gains of a law without memory, by their names. No compliance and backlash where the rig knows no
    motor inertia, or D falls short of it. `gains`, `gain_steps` (2n,): observer gains to begin
    with, and steps of their central differences. `gain_bounds` (2n, 2). `least` (e,): the least
    that each of `extra` can be: friction is not negative, less than none nothing gives or lags.
    `weights`, `scales` (M,): as of `Prediction`.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        records: Sequence[Record],
        unknown: Sequence[str],
        f: Floats,
        *,
        prior: Prior | None = None,
        runs: Sequence[int] | None = None,
        threads: int | None = None,
        **options: Any,
    ) -> None:
        n = dynamics.n
        links = _link_inertia(dynamics, records[0], f)
        # one kernel for all
        records = [dataclasses.replace(record, injected=_beside(record)) for record in records]
        self.dynamics, self.records, self.threads = (
            dynamics,
            tuple(records),
            int(threads or cores()),
        )
        own = {**options, "threads": self.threads, "moving": prior is not None}
        self._logs = [_Log(dynamics, record, tuple(unknown), links, own) for record in records]
        kept = {"prior": prior, "runs": runs, "threads": threads, **options}
        self._again = lambda of, others: Extended(of, others, unknown, f, **kept)
        self._runs = [1] * len(records) if runs is None else runs
        first = self._logs[0].prediction
        self.gains = first.nuisances
        self.gain_steps = first.nuisance_steps
        self.gain_bounds = first.nuisance_bounds
        names = (*(() if links is None else _GIVING), *_FRICTION, "offset", "gear", "motor_gain")
        self.extra = (
            *(f"{name}[{i}]" for name in names for i in range(n)),
            "lag",
            *self._logs[0].law,
        )
        self.least = np.array([self._logs[0].least(name) for name in self.extra])
        self.unknown = (
            *unknown,
            *first.unknown[len(first.unknown) - len(self.gains) :],
            *self.extra,
        )
        self.prior = PriorRows(prior, self.unknown)
        own_weights = [log.prediction.weights for log in self._logs]
        self.weights = np.concatenate([np.zeros(self.prior.count), *own_weights])
        self.scales = np.ones(len(self.weights))

    def innovations(self, values: Floats) -> Floats:
        """Weighted innovations (M,), scaled, with these values (k,) of the unknowns; inf where
        the run diverges.
        """
        return self.all_innovations([values])[0]

    def all_innovations(self, many: Iterable[Floats]) -> list[Floats]:
        """The same for several vectors of values, side by side."""
        many = list(many)
        of_record = [
            log.all_innovations([self._apart(values) for values in many]) for log in self._logs
        ]
        return [
            joined(row, self.scales)
            for row in zip(map(self.prior.of, many), *of_record, strict=True)
        ]

    def _apart(self, values: Floats) -> tuple[Floats, dict[str, float]]:
        """Unknowns and observer gains, and the extra numbers by name."""
        count = len(values) - len(self.extra)
        return values[:count], dict(zip(self.extra, values[count:], strict=True))

    def late(self, samples: float) -> "Extended":
        """The same model, following records whose counts are so many samples later."""
        return self._other(
            self.dynamics, [without_delay(record, -samples) for record in self.records]
        )

    def of(self, dynamics: Dynamics) -> "Extended":
        """The same model of another arm, whose f have the same names."""
        return self._other(dynamics, self.records)

    def _other(self, dynamics: Dynamics, records: Sequence[Record]) -> "Extended":
        other = self._again(dynamics, records)
        other.scales = self.scales
        other.prior = self.prior
        return other

    def pushed(self, torques: Sequence[Floats]) -> "Extended":
        """The same model, with torques (N, n) [N m] along each record beside those of its law."""
        other = copy.copy(self)
        every = [
            _beside(record) + torque for record, torque in zip(self.records, torques, strict=True)
        ]
        pairs = list(zip(self.records, self._logs, every, strict=True))
        other.records = tuple(
            dataclasses.replace(record, injected=torque) for record, _, torque in pairs
        )
        other._logs = [log.beside(torque) for _, log, torque in pairs]
        return other

    def stated(self) -> dict[str, float]:
        """Friction that the first rig states, by the names of what is beyond it."""
        pairs = zip(self.extra, self.least.tolist(), strict=True)
        return {name: -value for name, value in pairs if name.startswith(_FRICTION) and value < 0}

    def place(self, name: str) -> int:
        """Where one of `extra` is among the unknowns."""
        return len(self.unknown) - len(self.extra) + self.extra.index(name)

    def rows(self) -> list[slice]:
        """Where the innovations of each record are."""
        ends = np.cumsum(
            [self.prior.count, *(len(log.prediction.weights) for log in self._logs)]
        ).tolist()
        return [slice(*pair) for pair in itertools.pairwise(ends)]

    def runs(self) -> list[slice]:
        """Where the innovations of each run are."""
        rows = self.rows()
        ends = [0, *np.cumsum(self._runs).tolist()]
        return [
            slice(rows[first].start, rows[last - 1].stop)
            for first, last in itertools.pairwise(ends)
        ]


def _beside(record: Record) -> Floats:
    """Torque (N, n) [N m] that is injected, zero where none is."""
    return np.zeros(record.counts.shape) if record.injected is None else record.injected


def _link_inertia(dynamics: Dynamics, record: Record, f: Floats) -> Floats | None:
    """Inertia (n,) of what each gear drives where a log begins [kg m^2]; None where none is left
    beside the motor's.
    """
    pose = record.rig.cell_centre(record.counts[0])
    rotors = record.rig.drive.reflected_inertia()
    links = (
        np.diag(dynamics.chain.coupling.shaft_inertia(ca.DM(dynamics.arm(f).D(pose))).full())
        - rotors
    )
    return links if (links > 0).all() and (rotors > 0).all() else None


class _Log:
    """One record, followed by a model whose gears can give and whose currents can lag."""

    def __init__(
        self,
        dynamics: Dynamics,
        record: Record,
        unknown: tuple[str, ...],
        links: Floats | None,
        own: dict[str, Any],
    ) -> None:
        self._links = links
        self._damped = record.rig.drive.elasticity is not None
        self._springs: Prediction | None = None
        rig = _with_springs(record.rig, links)
        some = (*_FRICTION, "elasticity", "current_lag", "curve.offset", "gear", "motor_gain")
        kinds = tuple(f"drive.{kind}" for kind in some)
        numbers = dict(zip(rig.number_names(), rig.number_values().tolist(), strict=True))
        of_law: Law = instance("law", record.law, Law, "Give the record its law.")  # type: ignore[assignment]  # checked
        law = dict(zip(of_law.number_names("law."), of_law.number_values().tolist(), strict=True))
        lasting = record.law is None or record.law.replays or record.law.has_memory(rig.n)
        self.law = () if lasting else tuple(name for name in law if name not in unknown)
        self._stated = {
            name: numbers[name]
            for name in numbers
            if name.startswith(kinds) and name not in unknown
        }
        self._stated |= {name: law[name] for name in self.law}
        self._given = len(unknown)
        self._rigid = rig.drive.elasticity is not None and not self._damped
        plain = (
            dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=None))
            if self._rigid
            else rig
        )
        self._made = lambda rig, names: Prediction(
            dynamics, dataclasses.replace(record, rig=rig), (*unknown, *names), **own
        )
        self._sprung, self.prediction = rig, self._made(plain, self._names(giving=False))

    def beside(self, torque: Floats) -> "_Log":
        """The same with another torque (N, n) [N m] injected."""
        other = copy.copy(self)
        other.prediction = self.prediction.beside([torque])
        other._springs = None
        other._made = lambda rig, names: self._made(rig, names).beside([torque])
        return other

    def _names(self, *, giving: bool) -> list[str]:
        """Of what is stated, in a loop with springs or without."""
        return [
            name
            for name in self._stated
            if giving or not (self._rigid and name.startswith("drive.elasticity"))
        ]

    def all_innovations(self, many: Iterable[tuple[Floats, dict[str, float]]]) -> list[Floats]:
        many = list(many)
        gives = [
            self._rigid and any(extra[name] for name in extra if name.startswith(_GIVING))
            for _, extra in many
        ]
        if any(gives) and self._springs is None:
            self._springs = self._made(self._sprung, self._names(giving=True))
        of_loop = {}
        for giving, prediction in ((False, self.prediction), (True, self._springs)):
            some = [
                self._numbers(*each, giving=giving)
                for each, own in zip(many, gives, strict=True)
                if own == giving
            ]
            of_loop[giving] = iter(
                prediction.all_innovations(some) if prediction is not None and some else ()
            )
        return [next(of_loop[giving]) for giving in gives]

    def _numbers(self, values: Floats, extra: dict[str, float], *, giving: bool) -> Floats:
        """All that the prediction is given."""
        numbers = {name: self._stated[name] for name in self._names(giving=giving)}
        for name, value in extra.items():
            kind, bracket, joint = name.partition("[")
            place = (
                name if name in self.law else _PLACES.get(kind, f"drive.{kind}") + bracket + joint
            )
            if kind == "compliance" and value > 0:
                self._give(numbers, bracket + joint, value)
            elif place in numbers:
                own = numbers[place]
                numbers[place] = (
                    own * (1 + value)
                    if kind.startswith(_SHARES)
                    else own + max(value, self.least(name))
                )
        return np.concatenate(
            [values[: self._given], list(numbers.values()), values[self._given :]]
        )

    def least(self, name: str) -> float:
        """The least that one of the extra numbers can be."""
        if name.startswith(_SHARES):
            return _LEAST_SHARE
        return (
            -np.inf if name.startswith("offset") else -self._stated.get(f"drive.{name}", 0.0) or 0.0
        )

    def _give(self, numbers: dict[str, float], joint: str, compliance: float) -> None:
        """Put a spring of so much compliance [1/Hz^2] in series with a gear."""
        place, link = f"drive.elasticity.stiffness{joint}", self._links[int(joint[1:-1])]  # type: ignore[index]  # a joint is named
        if place in numbers:
            numbers[place] = 1 / (1 / numbers[place] + compliance / (4 * np.pi**2 * link))
            if not self._damped:
                numbers[f"drive.elasticity.damping{joint}"] = (
                    2 * _DAMPING * float(np.sqrt(numbers[place] * link))
                )


def _with_springs(rig: Rig, links: Floats | None) -> Rig:
    """A rig that behaves alike, and has the numbers by which gears are elastic, currents lag and
    torques are offset.
    """
    drive = rig.drive
    gears = rig.drive.elasticity
    if gears is None and links is not None:
        stiffness = links * (2 * np.pi * _RIGID) ** 2
        gears = Elasticity(stiffness=stiffness, damping=2 * _DAMPING * np.sqrt(stiffness * links))
    if gears is not None and gears.backlash is None:
        gears = dataclasses.replace(gears, backlash=np.zeros(rig.n))
    lag = drive.current_lag or _PROMPT
    curve = drive.curve or FrictionCurve(offset=np.zeros(rig.n))
    return dataclasses.replace(
        rig, drive=dataclasses.replace(drive, elasticity=gears, current_lag=lag, curve=curve)
    )

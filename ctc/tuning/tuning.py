"""Families of control laws with the numbers by which each is tuned; what the best of each does, and
the certificate.

A tuning is a row of numbers, one per variable; `Family.numbers` gives those of the law, so that
many tunings run side by side in one kernel.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.certificate import Certificate
from ctc.certification.certificates import Certificates
from ctc.certification.statement import SEARCH, percent
from ctc.laws.computed_torque import ComputedTorque
from ctc.laws.computed_torque_pid import ComputedTorquePID
from ctc.laws.feed_forward import FeedForward
from ctc.stability.design import motor_gain
from identification import IdentificationWarning
from plant import PD, Arm, Law, Reference, Rig
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

Numbers = Mapping[str, NDArray[np.float64]]

_USUAL = "dead_zone", "start_boost", "start_time"  # of the default, and not searched


def _named(values: Numbers) -> Numbers:
    """Of a law whose variables are numbers of its own."""
    return {f"law.{name}": value for name, value in values.items()}


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Family:
    """A law, in any tuning; lowest and highest of its variables; tunings with which its search
    begins; and what makes of variables by name, each (T,), numbers of the law.
    """

    name: str
    law: Law
    variables: dict[str, tuple[float, float]]
    known: list[dict[str, float]]
    numbers: Callable[[Numbers], Numbers] = _named

    def tuned(self, values: NDArray[np.float64]) -> Law:
        """The law with these values (k,) of its variables."""
        named = {
            name: np.array([value]) for name, value in zip(self.variables, values, strict=True)
        }
        return self.law.filled(
            {name: float(own[0]) for name, own in self.numbers(named).items()}, "law."
        )


def families(found: Any, arm: Arm, rig: Rig, reference: Reference) -> list[Family]:
    """Computed torque with observer and with PID, and feed-forward with PD, about an identified
    arm.

    That with observer has the dead zone and the boost that are the default of what was `found`, and
    its search begins with the default. At the reference's first pose the PD gains of the joints are
    in proportion to their inertia.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentificationWarning)  # said by tune
        usual = ComputedTorque(found, rig)
    observed = ComputedTorque(arm, rig, **{name: getattr(usual, name) for name in _USUAL})
    most = 0.6 / rig.period  # [rad/s]: a bandwidth beyond has too few samples
    corner = 3.0 / rig.period
    found = [
        Family(
            name="computed torque with observer",
            law=observed,
            variables={"bandwidth": (10.0, min(400.0, most)), "observer_ratio": (0.5, 4.0)},
            known=[
                {"bandwidth": usual.bandwidth, "observer_ratio": usual.observer_ratio},
                *(
                    {"bandwidth": w, "observer_ratio": 1.5}
                    for w in (20.0, 60.0, 100.0, 150.0, 200.0)
                ),
            ],
        ),
        Family(
            name="computed torque with PID that rolls off",
            law=ComputedTorquePID(
                arm,
                rig,
                bandwidth=150.0,
                ratio=1.5,
                integral=40.0,
                roll_off=1000.0,
                roll_off_damping=0.8,
            ),
            variables={
                "bandwidth": (30.0, min(500.0, most)),
                "ratio": (0.6, 8.0),
                "integral": (0.5, 150.0),
                "roll_off": (100.0, corner),
                "roll_off_damping": (0.3, 1.5),
            },
            known=[
                dict(
                    zip(
                        ("bandwidth", "ratio", "integral", "roll_off", "roll_off_damping"),
                        row,
                        strict=True,
                    )
                )
                for row in (
                    (206, 1.28, 24.0, 2124, 0.96),
                    (177, 1.52, 79.5, 2969, 0.91),
                    (155, 1.66, 40.6, 449, 0.53),
                )
            ],
        ),
    ]
    if rig.drive.coupling.matrix:
        return found
    unit = motor_gain(rig, np.diag(arm.D(reference(np.zeros(1)).q[0])), 1.0)
    pd = PD(gain=unit * 150.0**2, derivative=unit * 300.0, filter=corner, period=rig.period)

    def numbers(values: Numbers) -> Numbers:
        w = values["bandwidth"]
        damping = values["damping"]
        each = {f"law.feedback.gain[{i}]": unit[i] * w**2 for i in range(rig.n)}
        each |= {f"law.feedback.derivative[{i}]": unit[i] * 2 * damping * w for i in range(rig.n)}
        return each | {"law.feedback.filter": values["filter"]}

    feed_forward = Family(
        name="feed-forward with PD",
        law=FeedForward(arm, rig, feedback=pd),
        numbers=numbers,
        variables={
            "bandwidth": (20.0, min(500.0, most)),
            "damping": (0.2, 3.0),
            "filter": (200.0, 2 * corner),
        },
        known=[
            {"bandwidth": w, "damping": d, "filter": 3000.0}
            for w in (150.0, 250.0)
            for d in (0.7, 1.0)
        ],
    )
    return [*found, feed_forward]


_EACH = 3  # joints up to which a row has the chatter of each; with more it has the largest


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Trial(Shown, Frozen):
    """A tuning on independent samples.

    `numbers`: its variables. `left`, `of`: samples that exceed the limit, and of how many: a check
    ends early where more do than may. `allowed`: samples that may. `peak`: largest tracking error
    of any of them [pulses]; infinite where one diverged. `chatter` (n,): mean change of the torque
    from sample to sample, mean of the samples [N m]; infinite where one diverged. `noise`: the same
    in shares of each joint's torque along the reference, mean of the joints.
    """

    family: str
    law: Law
    numbers: dict[str, float]
    left: int
    of: int
    allowed: int
    peak: float
    chatter: NDArray[np.float64]
    noise: float

    @property
    def rank(self) -> tuple[float, float]:
        """Smaller is better: the share of the samples that fails beyond those that may, then the
        noise.
        """
        return max(self.left - self.allowed, 0) / self.of, self.noise

    @property
    def holds(self) -> bool:
        """Whether no more samples exceed the limit than may."""
        return self.left <= self.allowed

    @property
    def tuned(self) -> str:
        """Its variables as a text."""
        return ", ".join(f"{name} {value:.4g}" for name, value in self.numbers.items())

    def _short(self) -> str:
        return (
            f"{self.family}: {self.left} of {self.of} samples exceed the limit, {self.allowed} may"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()}; {self.tuned}", self.holds)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tuning(Shown, Frozen):
    """What `tune` found. Print it for the table and the verdict.

    Controllers are chosen by how many of the validation samples exceed the limit, so those counts
    flatter; the certificate has its own samples.

    Attributes
    ----------
    law : Law
        That with the least chatter that keeps its limit on all validation samples but those that
        may exceed it; where none does, that with which the fewest do.
    trials : tuple of Trial
        The best of each family.
    certificate : Certificate or Certificates
        Of the controller, on samples of its own; of a mapping of motions, one for each.
    fresh : int
        Validation samples of a trial that holds.
    """

    law: Law
    trials: tuple[Trial, ...]
    certificate: Certificate | Certificates
    fresh: int

    @property
    def holds(self) -> bool:
        """Whether one was found that keeps its limit on all validation samples but those that
        may exceed it.
        """
        return any(trial.holds for trial in self.trials)

    @property
    def table(self) -> str:
        """The best tuning of each family: share of the validation samples that exceeds the
        limit, chatter, numbers.
        """
        return "\n".join(self._table().lines())

    def _table(self) -> Table:
        rows = []
        for trial in sorted(self.trials, key=lambda trial: trial.rank):
            each = (
                trial.chatter
                if len(trial.chatter) <= _EACH
                else np.max(trial.chatter, keepdims=True)
            )
            chatter = " / ".join(f"{x:.1f}" for x in each)
            rows.append((trial.family, percent(trial.left / trial.of), chatter, trial.tuned))
        return Table(("", "exceed", "chatter [N m]", "tuned"), rows, words=(3,))

    def _short(self) -> str:
        best = min(self.trials, key=lambda trial: trial.rank)
        return (
            f"{best.family}, {'holds' if self.holds else 'does not hold'}; {len(self.trials)}"
            " families"
        )

    def _shown(self) -> Iterator[Piece]:
        most = self.trials[0].allowed
        where = f"all but {most} of {self.fresh} samples" if most else "all samples"
        if not self.holds:
            yield Verdict(
                f"No controller keeps the limit on {where}; with this one the fewest exceed it.",
                False,
            )
            near, quiet = (
                min(self.trials, key=key)
                for key in (lambda each: each.peak, lambda each: each.noise)
            )
            yield f"least peak: {near.peak:.0f} pulses, {near.family} ({near.tuned})"
            yield f"least chatter: {quiet.chatter.max():.2g} N m, {quiet.family} ({quiet.tuned})"
        yield from (piece for piece in self.certificate._shown() if piece is not SEARCH)
        yield "the best tuning of each family, on independent validation samples:"
        yield self._table()

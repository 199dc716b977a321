"""Families of control laws with their tuning variables, and the result of a search: `Tuning`.

A tuning is a row of numbers, one per variable. `Family.numbers` converts it to numbers of the law,
so that one kernel runs many tunings side by side.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from ctc.certification import SEARCH, Certificate, Certificates, percent
from ctc.laws import ComputedTorque, ComputedTorquePID, FeedForward, VariedSettings
from ctc.stability import motor_gain
from ctc.tuning.inner_loops import InnerTrial, inner_table
from ctc.tuning.known_gears import SETTINGS, KnownGears
from identification import IdentificationWarning
from plant import PD, Arm, Law, Reference, Rig
from plant.parts import (
    Floats,
    Frozen,
    Piece,
    Shown,
    Table,
    Verdict,
    frozen,
    heading,
    inside,
    kept,
    largest,
    largest_cell,
    near,
    several,
    significant,
    with_units,
)

Numbers = Mapping[str, Floats]

# Fields of the default computed torque that a tuning of it keeps, if they are not varied.
_OF_DEFAULT = "dead_zone", "start_boost", "start_time"

# Further numbers of computed torque with observer that `tune` can vary: fields, and settings.
_FIELDS = (*_OF_DEFAULT, "learnable")
_SETTINGS = tuple(
    field.name for field in dataclasses.fields(VariedSettings) if "number" in field.metadata
)

# The range of a number to vary reaches from its default divided by this factor to its default times
# the factor. The factor is chosen by hand, so that ranges reach beyond every default of
# `default_gains`. Shares have fixed ranges, since their defaults may be zero.
_FACTOR = 4.0
_SHARES = {"dead_zone": (0.05, 1.0), "learnable": (0.05, 0.99)}


# Variables in rad/s: a long period limits them, and a slower tuning has less of all of them.
_FREQUENCIES = ("bandwidth", "integral", "roll_off", "filter")


def _up_to(limit: float, lowest: float, highest: float) -> tuple[float, float]:
    """A range from `lowest` to `highest`, below a limit that falls with the period."""
    highest = min(highest, limit)
    # At a long period even `lowest` is beyond the limit: the range then lies below the limit.
    return min(lowest, highest / _FACTOR), highest


def _inside(
    tunings: Iterable[Mapping[str, float]], variables: dict[str, tuple[float, float]]
) -> list[dict[str, float]]:
    """Tunings within the ranges of their variables, each once; a fast one is slowed as a whole."""
    inside: list[dict[str, float]] = []
    for tuning in tunings:
        # One factor for all frequencies keeps the shape of a loop. At their upper ends alone, where
        # clipping would put them, most loops are unstable.
        shares = [variables[name][1] / tuning[name] for name in _FREQUENCIES if name in tuning]
        factor = min(1.0, *shares)
        slowed = {
            name: value * factor if name in _FREQUENCIES else value
            for name, value in tuning.items()
        }
        clipped = {name: float(np.clip(slowed[name], *variables[name])) for name in variables}
        if clipped not in inside:
            inside.append(clipped)
    return inside


def _named(values: Numbers) -> Numbers:
    """Numbers of a law whose variables are fields of it, or of its settings."""
    return {
        f"law.settings.{name}" if name in _SETTINGS else f"law.{name}": value
        for name, value in values.items()
    }


@frozen
class Family:
    """A law with variables to tune, their ranges, and the tunings with which the search begins.

    `variables`: name -> (lowest, highest). `initial`: tunings with which the search begins.
    `numbers`: converts variables by name, each (T,) for T tunings, to numbers of the law.
    """

    name: str
    law: Law
    variables: dict[str, tuple[float, float]]
    initial: list[dict[str, float]]
    numbers: Callable[[Numbers], Numbers] = _named

    def tuned(self, values: Floats) -> Law:
        """The law with these values (k,) of its variables."""
        # As columns of one row: `numbers` serves one tuning and many.
        columns = dict(zip(self.variables, values[:, None], strict=True))
        numbers = {name: float(column[0]) for name, column in self.numbers(columns).items()}
        law = self.law.filled(numbers, "law.")
        # Settings are numbers during the search alone: the result is the law that a user writes.
        settings = getattr(law, "settings", None)
        if isinstance(settings, VariedSettings):
            return dataclasses.replace(law, settings=settings.plain)
        return law


def families(
    found: Any, arm: Arm, rig: Rig, reference: Reference, vary: Sequence[str] = ()
) -> list[Family]:
    """The families of laws that `tune` searches, for an identified arm.

    They are computed torque with observer, computed torque with PID, and, unless the drive couples
    joints, feed-forward with PD.

    Computed torque with observer takes its dead zone and its boost from the default for what was
    `found`, unless `vary` names them; its search begins with the default. The PD gains of the
    joints are in proportion to their inertia at the reference's first pose.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentificationWarning)  # `tune` has given it already
        # An identification has a better default than its arm: it knows how sure f is.
        default = ComputedTorque(found, rig)
    # A bandwidth above 0.6 rad per period has too few samples. A roll-off may be five times faster,
    # and the filter of a PD ten times.
    fastest = 0.6 / rig.period
    corner = 3.0 / rig.period
    # `PD` has one gain for each motor, which does not suit motors that turn several joints.
    if rig.drive.coupling.matrix:
        return [
            _with_observer(arm, rig, default, fastest, vary),
            _with_pid(arm, rig, fastest, corner),
        ]
    return [
        _with_observer(arm, rig, default, fastest, vary),
        _with_pid(arm, rig, fastest, corner),
        _feed_forward(arm, rig, reference, fastest, corner),
    ]


def varied(vary: str | Iterable[str]) -> tuple[str, ...]:
    """Names of further numbers of computed torque with observer, checked, each once."""
    names = (vary,) if isinstance(vary, str) else tuple(vary)
    allowed = (*_FIELDS, *_SETTINGS)
    for name in names:
        if name not in allowed:
            raise ValueError(
                f"vary must name numbers of ComputedTorque or ComputedTorqueSettings; got {name!r}."
                f" {near(name, allowed, f'Take of {several(allowed)}.')}"
            )
    return tuple(dict.fromkeys(names))


def _with_observer(
    arm: Arm, rig: Rig, default: ComputedTorque, fastest: float, vary: Sequence[str]
) -> Family:
    fields: dict[str, Any] = {name: getattr(default, name) for name in _OF_DEFAULT}
    # Without a setting to vary, the law keeps its settings as structure, and with them its kernel.
    if any(name in _SETTINGS for name in vary):
        fields["settings"] = VariedSettings.of(default.settings)
    usual = {
        name: getattr(default.settings if name in _SETTINGS else default, name) for name in vary
    }
    ranges = {
        name: _SHARES.get(name, (value / _FACTOR, value * _FACTOR)) for name, value in usual.items()
    }
    variables = {
        "bandwidth": _up_to(fastest, 10.0, 400.0),
        "observer_ratio": (0.5, 4.0),
    } | ranges
    # The default suits the arm as identified; with stated gears, the bandwidth may have to be far
    # lower.
    slower = [{"bandwidth": w, "observer_ratio": 1.5} for w in (20.0, 60.0, 100.0, 150.0, 200.0)]
    gains = [{"bandwidth": default.bandwidth, "observer_ratio": default.observer_ratio}, *slower]
    return Family(
        name="computed torque with observer",
        law=ComputedTorque(arm, rig, **fields),
        variables=variables,
        # A dead zone of zero, which has no logarithm, begins at the least of its range.
        initial=_inside([tuning | usual for tuning in gains], variables),
    )


def _with_pid(arm: Arm, rig: Rig, fastest: float, corner: float) -> Family:
    variables = {
        "bandwidth": _up_to(fastest, 30.0, 500.0),
        "ratio": (0.6, 8.0),
        "integral": (0.5, 150.0),
        "roll_off": _up_to(corner, 100.0, np.inf),
        "roll_off_damping": (0.3, 1.5),
    }
    # Tunings that earlier searches ended with, on rigid and on elastic gears.
    rows = (
        (206, 1.28, 24.0, 2124, 0.96),
        (177, 1.52, 79.5, 2969, 0.91),
        (155, 1.66, 40.6, 449, 0.53),
    )
    return Family(
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
        variables=variables,
        initial=_inside([dict(zip(variables, row, strict=True)) for row in rows], variables),
    )


def _feed_forward(
    arm: Arm, rig: Rig, reference: Reference, fastest: float, corner: float
) -> Family:
    inertia = np.diag(arm.D(reference(np.zeros(1)).q[0]))
    # Motor torque per pulse for an acceleration of 1 rad/s^2 per rad, for each joint.
    unit = motor_gain(rig, inertia, 1.0)
    # Any gains: the search replaces them before the first simulation.
    pd = PD(gain=unit * 150.0**2, derivative=unit * 300.0, filter=corner, period=rig.period)

    def numbers(values: Numbers) -> Numbers:
        """Gains for error poles of this bandwidth and damping, at each joint's inertia."""
        w = values["bandwidth"]
        damping = values["damping"]
        gains = {f"law.feedback.gain[{i}]": unit[i] * w**2 for i in range(rig.n)}
        gains |= {f"law.feedback.derivative[{i}]": unit[i] * 2 * damping * w for i in range(rig.n)}
        return gains | {"law.feedback.filter": values["filter"]}

    variables = {
        "bandwidth": _up_to(fastest, 20.0, 500.0),
        "damping": (0.2, 3.0),
        "filter": _up_to(2 * corner, 200.0, np.inf),
    }
    tunings = [
        {"bandwidth": w, "damping": d, "filter": 3000.0} for w in (150.0, 250.0) for d in (0.7, 1.0)
    ]
    return Family(
        name="feed-forward with PD",
        law=FeedForward(arm, rig, feedback=pd),
        numbers=numbers,
        variables=variables,
        initial=_inside(tunings, variables),
    )


@kept
@frozen
class Trial(Shown, Frozen):
    """A tuning on independent samples.

    `numbers`: its variables. `left`, `of`: samples that exceed the limit, and samples simulated; a
    check ends early where more exceed it than may. `allowed`: samples that may. `peak`: largest
    tracking error of any sample [pulses]; infinite where one diverged. `chatter` (n,): mean change
    of the torque from one sampling instant to the next, mean of the samples [N m]; infinite where
    one diverged. `noise`: the same in shares of each joint's torque along the reference, mean of
    the joints.
    """

    family: str
    law: Law
    numbers: dict[str, float]
    left: int
    of: int
    allowed: int
    peak: float
    chatter: Floats
    noise: float

    @property
    def rank(self) -> tuple[float, float]:
        """Rank of a trial; a smaller one is better.

        The share of failing samples beyond the allowed ones comes first, then the noise.
        """
        # A share, since a check that ends early has fewer samples.
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


@frozen
class Tuning(Shown, Frozen):
    """Result of `tune`: the controller, the best of each family, and the certificate. Print it.

    A controller is chosen for its few failures on the validation samples, so these counts are
    optimistic; the certificate has its own samples.

    Attributes
    ----------
    law : Law
        The controller with the least `Trial.noise` among those that keep the limit on all but the
        allowed number of validation samples. If there is none, the one with the least share of
        failing samples beyond the allowed number (`Trial.rank`).
    trials : tuple of Trial
        The best of each family.
    certificate : Certificate or Certificates
        Of the controller, on samples of its own; of a mapping of motions, one for each.
    fresh : int
        Number of validation samples; a trial that does not hold may have fewer.
    interrupted : bool
        Whether Ctrl-C ended the search; the controller is then the best one found before.
    known_gears : tuple of KnownGears
        For a wide range of resonances: results of computed torque whose model has the gears, at
        several resonances in the range.
    inner : tuple of InnerTrial
        The inner loops that were stated, the chosen one first.
    """

    law: Law
    trials: tuple[Trial, ...]
    certificate: Certificate | Certificates
    fresh: int
    interrupted: bool = False
    known_gears: tuple[KnownGears, ...] = ()
    inner: tuple[InnerTrial, ...] = ()

    @property
    def holds(self) -> bool:
        """Whether a controller was found that keeps its limit on the validation samples.

        At most the allowed number of samples may exceed it.
        """
        return any(trial.holds for trial in self.trials)

    @property
    def table(self) -> str:
        """The best tuning of each family.

        Each row has the share of the validation samples that exceeds the limit, the chatter of each
        joint, and the numbers; the first is the best by `Trial.rank`.
        """
        return "\n".join(self._table().lines())

    def _table(self) -> Table:
        rows = []
        for trial in sorted(self.trials, key=lambda trial: trial.rank):
            # A row has room for three joints; of more it shows the largest.
            few = len(trial.chatter) <= 3
            chatter = largest_cell(trial.chatter, self._efforts)
            if few:
                chatter = " / ".join(with_units(map(significant, trial.chatter), self._efforts))
            rows.append((trial.family, percent(trial.left / trial.of), chatter, trial.tuned))
        return Table(("", "exceed", heading("chatter", self._efforts), "tuned"), rows, words=(3,))

    @property
    def _efforts(self) -> list[str]:
        """Units of the torques of the joints."""
        return self.certificate.plants.arm.dynamics.chain.effort_units

    def _loudest(self, chatter: Floats) -> str:
        """The largest chatter (n,), in its unit; of joints that turn and that slide, each."""
        joints = largest(chatter, self._efforts)
        return ", ".join(f"{significant(chatter[j])} {self._efforts[j]}" for j in joints)

    def _short(self) -> str:
        # The same tuning as the law of the result.
        best = min(self.trials, key=lambda trial: trial.rank)
        return (
            f"{best.family}, {'holds' if self.holds else 'does not hold'}; {len(self.trials)}"
            " families"
        )

    def _failing(self, samples: str) -> Iterator[Piece]:
        """What the search and the certificate say of a controller that does not keep the limit."""
        best = min(self.trials, key=lambda trial: trial.rank)
        share = best.left / best.of
        yield Verdict(
            f"No controller keeps the limit on {samples} of the search: with this one, the fewest,"
            f" {best.left} of {best.of} exceed it ({percent(share)}).",
            False,
        )
        # A certificate with few samples may have no failure, although some of the more
        # numerous samples of the search exceed the limit.
        count = len(self.certificate.plants)
        if not self.certificate.failures:
            yield (
                f"the certificate has {count:,} other samples; with a probability of"
                f" {percent((1 - share) ** count)} none of so many exceeds it"
            )

    def _shown(self) -> Iterator[Piece]:
        allowed = self.trials[0].allowed
        samples = f"all but {allowed} of {self.fresh} samples" if allowed else "all samples"
        if self.interrupted:
            yield "the search was interrupted: this is the best controller until then"
        if not self.holds:
            yield from self._failing(samples)
            # The least peak shows which limit could be kept, and the least chatter how quiet a loop
            # could be without the limit; each has its own tuning. The least is that of `noise`, in
            # shares of the torques, and the text shows it in N m.
            closest = min(self.trials, key=lambda trial: trial.peak)
            quietest = min(self.trials, key=lambda trial: trial.noise)
            yield f"least peak: {closest.peak:.0f} pulses, {closest.family} ({closest.tuned})"
            chatter = self._loudest(quietest.chatter)
            yield f"least chatter: {chatter}, {quietest.family} ({quietest.tuned})"
        # The certificate advises to call `tune`, which has just searched.
        pieces = self.certificate._shown() if self.holds else inside(self.certificate)
        yield from (piece for piece in pieces if piece is not SEARCH)
        yield from self._with_known_gears()
        if self.inner:
            yield f"inner loops under the default computed torque; chosen: {self.inner[0].fields}"
            yield inner_table(self.inner, self._efforts)
        yield "the best tuning of each family, on independent validation samples:"
        yield self._table()

    def _with_known_gears(self) -> Iterator[Piece]:
        """What identified gears would gain, where that is much."""
        best = min(self.trials, key=lambda trial: trial.rank)
        loud = largest(best.chatter, self._efforts)
        limit = np.where(best.holds, SETTINGS.gain * best.chatter, np.inf)
        quiet = [
            gears
            for gears in self.known_gears
            if not gears.left
            and all(
                gears.chatter[joint] < limit[other]
                for joint, other in zip(largest(gears.chatter, self._efforts), loud, strict=True)
            )
        ]
        if quiet:
            places = several([f"{gears.hz:.3g}" for gears in quiet], len(quiet))
            chatter = self._loudest(np.max([gears.chatter for gears in quiet], axis=0))
            whole_range = "no controller for the whole range keeps it"
            if best.holds:
                whole_range = f"this one, for the whole range, has {self._loudest(best.chatter)}"
            yield (
                f"the range of resonances decides: with gears of {places} Hz known to 10 %,"
                f" computed torque keeps the limit with {chatter} of chatter; {whole_range}."
                " identify(..., elasticity=True) finds them"
            )

"""A robot's log against its own past: which parameters changed, each with its probability of a
false alarm.
"""

import contextlib
import dataclasses
import datetime
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import Effect
from identification import Identification
from identification.equation_error.torque_fit import TorqueFit
from plant import Dynamics, Record
from plant.parts.arguments import real
from plant.parts.fields import Floats
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_NOTES = (
    'Give notes={"robot": "cell_7", "time": "2026-05-12"}; of files, or in a plan,'
    ' notes="{robot}_{time}".'
)
# Unix s: neither parts of a date nor milliseconds
_EARLIEST = 1e8
_LATEST = 1e11
_TAIL = 1e-6  # probability below which none is told
_LINE = 3  # logs before it from which on a line is laid through a robot's
_KNOWN = 3.0  # standard deviations of the past from which on a change is told as a share of it


class Logged(NamedTuple):
    """What one identification says of a robot at a time [Unix s]; `temperature` NaN where not
    known.
    """

    robot: str
    time: float
    temperature: float
    values: dict[str, tuple[float, float]]


class Source(NamedTuple):
    """Where it comes from."""

    records: tuple[Record, ...]
    dynamics: Dynamics
    method: str
    names: tuple[str, ...]
    covariance: Floats


def logged(found: Sequence[Any], notes: Mapping[str, Any] | None) -> tuple[Logged, Source]:
    """What `Fleet` takes: an Identification, or a record and what was identified of it, with
    notes of both.
    """
    fit = found[-1] if found else None
    advice = "Give found, or record and found."
    beside = len(found) == 2 and isinstance(found[0], Record)
    if isinstance(fit, Identification) and (beside or len(found) == 1):
        if fit.covariance is None:
            why = fit.fit.fallback_reason or f"method {fit.search.method!r} gives none"
            raise ValueError(
                f"found must have a covariance; it has none: {why}. Identify with method 'seeded'."
            )
        own = fit.arm.dynamics, fit.search.method, tuple(fit.fit.unknown), fit.covariance
        values = fit.fit.values
        records = fit.records
    elif isinstance(fit, TorqueFit) and beside:
        own = (fit.dynamics, "fit_torque", fit.names, fit.covariance)
        values = fit.values
        records = ()
    else:
        got = ", ".join(type(each).__name__ for each in found) or "nothing"
        raise ValueError(
            f"a fleet takes what identify found, or a Record and what was found; got {got}."
            f" {advice}"
        )
    records = (found[0],) if beside else records
    said = [{**(record.notes or {}), **(notes or {})} for record in records]
    robots = {str(each.get("robot", "")) for each in said}
    missing = "robot" if robots == {""} else "time" if "time" not in said[0] else ""
    if missing:
        raise ValueError(
            f"the record must have notes of robot and time; {missing} is missing. {_NOTES}"
        )
    if len(robots) > 1:
        raise ValueError(
            f"records must be of one robot; got {', '.join(sorted(robots))}. Identify each by"
            " itself."
        )
    warm = [
        real("temperature", each["temperature"], "Give °C.")
        for each in said
        if "temperature" in each
    ]
    std = np.sqrt(np.diag(own[-1]))
    known = {
        name: (value, s)
        for name, value, s in zip(own[2], values.tolist(), std.tolist(), strict=True)
    }
    temperature = float(np.mean(warm)) if warm else np.nan
    return Logged(robots.pop(), seconds_of(said[0]["time"]), temperature, known), Source(
        tuple(records), *own
    )


def seconds_of(time: Any) -> float:
    """Unix seconds of a note: a number, or a date of ISO 8601, of UTC where it says no other."""
    try:
        day = time if isinstance(time, datetime.datetime) else datetime.datetime.fromisoformat(time)
        return (day if day.tzinfo else day.replace(tzinfo=datetime.UTC)).timestamp()
    except (TypeError, ValueError):
        pass
    with contextlib.suppress(TypeError, ValueError):
        if _EARLIEST <= float(time) < _LATEST:
            return float(time)
    raise ValueError(
        f"time must be Unix seconds after 1973, or a date such as 2026-05-12; got {time!r:.40}."
        " Give one."
    )


class Change(NamedTuple):
    """A parameter now and before, or, where it drifts, at the robot's first log, a time [Unix s];
    `std` of the difference, and the probability of a false alarm.
    """

    name: str
    label: str
    unit: str
    before: float
    after: float
    std: float
    false_alarm: float
    since: float | None = None

    def __str__(self) -> str:
        by = abs(self.after) - abs(self.before)
        said = "" if self.since is None else f" since {day_of(self.since)}"
        if abs(self.before) > _KNOWN * self.std:
            return (
                f"{self.label} {'up' if by > 0 else 'down'} {100 * abs(by / self.before):.2g}"
                f" %{said}"
            )
        return (
            f"{self.label} changed by"
            f" {f'{self.after - self.before:+.2g} {self.unit}'.rstrip()}{said}"
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Judgement(Shown):
    """What became of a robot between its past and a log.

    Attributes
    ----------
    robot : str
    time : float
        Of the log [Unix s].
    looked : tuple of Change
        Of all parameters that can be compared, the surest change first: against the mean of the
        past, or along a line through all logs, whichever is surer. The probability of a false alarm
        is that of a change so large by chance in any of them: Student's, of noise and of what weeks
        differ by, times the number of tests.
    changes : tuple of Change
        Those below `level`.
    level : float
    unknown : str
        Why nothing can be compared; "" otherwise.
    """

    robot: str
    time: float
    looked: tuple[Change, ...]
    level: float
    unknown: str = ""

    @property
    def changes(self) -> tuple[Change, ...]:
        """Those whose probability of a false alarm is below the level."""
        return tuple(change for change in self.looked if change.false_alarm < self.level)

    @property
    def verdict(self) -> str:
        """In words: "same arm", or what changed."""
        if self.unknown:
            return f"not judged: {self.unknown}"
        if not self.changes:
            return "same arm"
        return ", ".join(
            f"{change} (false alarm {chance_of(change.false_alarm)})" for change in self.changes
        )

    @property
    def day(self) -> str:
        """Of the log."""
        return day_of(self.time)

    def _short(self) -> str:
        return f"{self.robot}: {self.verdict}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(
            f"{self.robot}, {self.day}: {self.verdict}", None if self.unknown else not self.changes
        )
        rows = [
            (
                each.label,
                f"{each.before:.4g}",
                f"{each.after:.4g}",
                each.unit,
                f"{(each.after - each.before) / each.std:+.1f}",
                chance_of(each.false_alarm),
            )
            for each in self.looked
        ]
        if rows:
            yield Table(
                ("", "before", "now", "unit", "in standard deviations", "false alarm"), rows
            )


def chance_of(probability: float) -> str:
    """In words; no tail of a distribution is known beyond one in a million."""
    return f"{probability:.1g}" if probability >= _TAIL else f"below {_TAIL:g}"


def day_of(time: float) -> str:
    """ISO date of Unix seconds."""
    return datetime.datetime.fromtimestamp(time, datetime.UTC).date().isoformat()


def judged(log: Logged, effects: Sequence[Effect], level: float) -> Judgement:
    """A log against those of the same robot before it."""
    tests = list[Change]()
    unknown = "it has no log before this one of the same parameters"
    for effect in effects:
        of = effect.of
        if log.robot not in of.robots or not 0 < log.values.get(of.name, (0.0, 0.0))[1] < np.inf:
            continue
        past = (of.robot == of.robots.index(log.robot)) & (of.time < log.time)
        if past.any() and effect.freedom:
            tests += _tests(log, effect, past)
        elif past.any():
            unknown = "no robot has two logs yet, so what weeks differ by is not known"
    surest = dict[str, Change]()
    for each in sorted(tests, key=lambda each: each.false_alarm):
        surest.setdefault(
            each.name, each._replace(false_alarm=min(1.0, len(tests) * each.false_alarm))
        )
    said = "" if surest else unknown
    return Judgement(
        robot=log.robot, time=log.time, looked=tuple(surest.values()), level=level, unknown=said
    )


def _tests(log: Logged, effect: Effect, past: NDArray[np.bool_]) -> Iterator[Change]:
    """One parameter against its past (M,), at the temperature of the new log where all are
    known.
    """
    of = effect.of
    (value, std), weight = log.values[of.name], 1 / (of.std[past] ** 2 + effect.weeks**2)
    warmer = log.temperature - of.temperature[past]
    y = of.value[past]
    cold = not (np.isfinite(effect.slope) and np.isfinite(warmer).all())
    y, own = (y, 0.0) if cold else (y + effect.slope * warmer, effect.slope_std)
    total = float(weight.sum())
    now = 1 / (std**2 + effect.weeks**2)
    before = float((weight * y).sum()) / total
    variance = (
        1 / now + 1 / total + (0.0 if cold else own * float((weight * warmer).sum()) / total) ** 2
    )
    yield _change(effect, before, value, float(np.sqrt(variance)))
    if len(y) < _LINE:
        return
    time = np.append(of.time[past], log.time)
    y = np.append(y, value)
    weight = np.append(weight, now)
    lasts = np.ptp(time)
    time = time - (weight * time).sum() / weight.sum()
    lever = weight * time / (weight * time**2).sum() * lasts
    by = float((lever * y).sum())
    middle = float((weight * y).sum() / weight.sum())
    begin = middle + by * time.min() / lasts
    apart = 0.0 if cold else own * float((lever[:-1] * warmer).sum())
    variance = float((lever**2 / weight).sum()) + apart**2
    yield _change(effect, begin, begin + by, float(np.sqrt(variance)), float(of.time[past].min()))


def _change(
    effect: Effect, before: float, after: float, std: float, since: float | None = None
) -> Change:
    from scipy.special import stdtr

    chance = 2 * float(stdtr(effect.freedom, -abs(after - before) / std))
    return Change(
        effect.of.name, effect.of.label, effect.of.unit, before, after, std, chance, since
    )

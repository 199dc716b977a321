"""Judge a robot's log against its own past: changed parameters, probabilities of a false alarm."""

import contextlib
import datetime
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ctc.campaigns.effects import Effect
from identification import Identification
from identification.equation_error import TorqueFit
from plant import Dynamics, Record
from plant.parts import (
    Floats,
    Piece,
    Shown,
    Table,
    Verdict,
    frozen,
    frozen_settings,
    instance,
    real,
)

# Advice of two messages: where notes come from.
_NOTES = (
    'Give notes={"robot": "cell_7", "time": "2026-05-12"}; of files, or in a plan,'
    ' notes="{robot}_{time}".'
)


@frozen_settings
class JudgementSettings:
    """How a log is judged and a change is worded; chosen by hand.

    Parameters
    ----------
    earliest, latest : float
        Range of a time [Unix s]: smaller numbers are parts of a date, larger ones milliseconds.
    tail : float
        Smallest probability that is printed: no tail of a distribution holds beyond it.
    line : int
        Earlier logs of a robot from which on a line is laid through them.
    relative : float
        A change is given as a percentage only where the earlier value exceeds so many standard
        deviations of the difference.
    """

    earliest: float = 1e8
    latest: float = 1e11
    tail: float = 1e-6
    line: int = 3
    relative: float = 3.0


JUDGEMENT = JudgementSettings()


class Logged(NamedTuple):
    """Values of one robot at a time [Unix s], each (value, std); `temperature` may be NaN."""

    robot: str
    time: float
    temperature: float
    values: dict[str, tuple[float, float]]


class Source(NamedTuple):
    """Records, model and method of an identification, and names and covariance of its values."""

    records: tuple[Record, ...]
    dynamics: Dynamics
    method: str
    names: tuple[str, ...]
    covariance: Floats


def logged(results: Sequence[Any], notes: Mapping[str, Any] | None) -> tuple[Logged, Source]:
    """Read what `Fleet` takes: an Identification, or a record and its fit, with notes of both."""
    # Both kinds of results are read at once, so that the rest knows values alone.
    source, fitted = _source_of(results)
    if notes is not None:
        instance("notes", notes, Mapping, _NOTES)
    # Notes of the call go before those of the records.
    remarks = [{**(record.notes or {}), **(notes or {})} for record in source.records]

    # 1. The notes of all records must name one robot, and those of one record a time.
    robots = {_robot_of(remark) for remark in remarks}
    times = [remark["time"] for remark in remarks if "time" in remark]
    if "" in robots or not times:
        missing = "robot" if "" in robots else "time"
        raise ValueError(
            f"the record must have notes of robot and time; {missing} is missing. {_NOTES}"
        )
    if len(robots) > 1:
        raise ValueError(
            f"records must be of one robot; got {', '.join(sorted(robots))}. Identify each by"
            " itself."
        )

    # 2. Several records of one identification share its values: their mean temperature.
    temperatures = [
        real("temperature", remark["temperature"], "Give °C.")
        for remark in remarks
        if "temperature" in remark
    ]
    temperature = float(np.mean(temperatures)) if temperatures else np.nan
    # A change is judged parameter by parameter: their correlations are not used.
    std = np.sqrt(np.diag(source.covariance)).tolist()
    pairs = zip(fitted.tolist(), std, strict=True)
    values = dict(zip(source.names, pairs, strict=True))
    return Logged(robots.pop(), seconds_of(times[0]), temperature, values), source


def _robot_of(remark: Mapping[str, Any]) -> str:
    """Name of the robot in notes; "" where they have none."""
    robot = remark.get("robot")
    # A record keeps the number 7 as 7.0; as text it is "7", as in names of files.
    if isinstance(robot, float) and robot.is_integer():
        robot = int(robot)
    return "" if robot is None else str(robot)


def _source_of(results: Sequence[Any]) -> tuple[Source, Floats]:
    """Source and values of an identification, or of a record and the fit of it."""
    fit = results[-1] if results else None
    # A record may be given beside its fit, which then need not hold it.
    beside = len(results) == 2 and isinstance(results[0], Record)
    if isinstance(fit, Identification) and (beside or len(results) == 1):
        if fit.covariance is None:
            why = fit.fit.fallback_reason or f"method {fit.search.method!r} gives none"
            raise ValueError(
                f"found must have a covariance; it has none: {why}. Identify with method 'seeded'."
            )
        # A record given beside it stands for those that it was identified of.
        records = (results[0],) if beside else tuple(fit.records)
        names = tuple(fit.fit.unknown)
        return (
            Source(records, fit.arm.dynamics, fit.search.method, names, fit.covariance),
            fit.fit.values,
        )
    if isinstance(fit, TorqueFit) and beside:
        # A fit of torques keeps no record.
        return (
            Source((results[0],), fit.dynamics, "fit_torque", fit.names, fit.covariance),
            fit.values,
        )
    got = ", ".join(type(result).__name__ for result in results) or "nothing"
    raise ValueError(
        f"a fleet takes the result of identify, or a Record and its fit; got {got}."
        " Give found, or record and found."
    )


def seconds_of(time: Any) -> float:
    """Unix seconds of a note: a number, or a date of ISO 8601, of UTC where it has no zone."""
    # Of a longer text of digits, `fromisoformat` would take the ninth for a separator.
    dated = isinstance(time, str) and not (time.isdigit() and len(time) > len("20260512"))
    if dated or isinstance(time, datetime.date):
        with contextlib.suppress(ValueError):
            # A date and its text are the same instant.
            day = datetime.datetime.fromisoformat(str(time))
            return (day if day.tzinfo else day.replace(tzinfo=datetime.UTC)).timestamp()
    # Names of files give numbers as texts.
    with contextlib.suppress(TypeError, ValueError):
        if JUDGEMENT.earliest <= float(time) < JUDGEMENT.latest:
            return float(time)
    raise ValueError(
        f"time must be Unix seconds after 1973, or a date such as 2026-05-12; got {time!r:.40}."
        " Give one."
    )


class Change(NamedTuple):
    """A parameter before and after, the standard deviation of the difference, its false alarm.

    `since`: where the parameter drifts, the time [Unix s] of the robot's first log, at which
    `before` holds.
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
        # A drift has a beginning, a step has none.
        since = "" if self.since is None else f" since {day_of(self.since)}"
        # A percentage would be arbitrary of a value that noise hides, or whose sign has changed.
        certain = abs(self.before) > JUDGEMENT.relative * self.std
        if certain and self.before * self.after > 0:
            growth = abs(self.after) - abs(self.before)
            direction = "up" if growth > 0 else "down"
            percentage = 100 * abs(growth / self.before)
            figure = f"{percentage:.2g}" if percentage < 10 else f"{percentage:.0f}"
            return f"{self.label} {direction} {figure} %{since}"
        difference = f"{self.after - self.before:+.2g} {self.unit}".rstrip()
        return f"{self.label} changed by {difference}{since}"


@frozen
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
    statements : tuple of str
        What the log, its rig or its law states wrongly, where something changed or the fit has
        doubts: it may explain a change, or hide one.
    """

    robot: str
    time: float
    looked: tuple[Change, ...]
    level: float
    unknown: str = ""
    statements: tuple[str, ...] = ()

    @property
    def changes(self) -> tuple[Change, ...]:
        """Those whose probability of a false alarm is below the level."""
        return tuple(change for change in self.looked if change.false_alarm < self.level)

    @property
    def verdict(self) -> str:
        """In words: wrong statements; what changed, or "same arm"."""
        words = ", ".join(
            f"{change} (false alarm {chance_of(change.false_alarm)})" for change in self.changes
        )
        if self.unknown:
            words = f"not judged: {self.unknown}"
        if not self.statements:
            return words or "same arm"
        wrong = f"wrong statements: {' '.join(self.statements)}"
        return f"{wrong} As stated: {words}" if words else wrong

    @property
    def day(self) -> str:
        """Of the log."""
        return day_of(self.time)

    def _short(self) -> str:
        return f"{self.robot}: {self.verdict}"

    def _shown(self) -> Iterator[Piece]:
        # Neither good nor bad where nothing could be compared.
        good = None if self.unknown else not (self.changes or self.statements)
        yield Verdict(f"{self.robot}, {self.day}: {self.verdict}", good)
        rows = [
            (
                change.label,
                f"{change.before:.4g}",
                f"{change.after:.4g}",
                change.unit,
                f"{(change.after - change.before) / change.std:+.1f}",
                chance_of(change.false_alarm),
            )
            for change in self.looked
        ]
        if rows:
            yield Table(
                ("", "before", "now", "unit", "in standard deviations", "false alarm"), rows
            )


def chance_of(probability: float) -> str:
    """A probability in words, with a limit below which no distribution is trusted."""
    tail = JUDGEMENT.tail
    return f"{probability:.1g}" if probability >= tail else f"below {tail:g}"


def day_of(time: float) -> str:
    """ISO date of Unix seconds."""
    return datetime.datetime.fromtimestamp(time, datetime.UTC).date().isoformat()


def judged(log: Logged, effects: Sequence[Effect], level: float) -> Judgement:
    """Judge a log against the earlier ones of the same robot."""
    tests = list[Change]()
    unknown = "it has no log before this one of the same parameters"
    # Parameters are compared by name, whatever model or method they were identified with.
    for effect in effects:
        of = effect.of
        # Parameters that this log lacks, or that were assumed (no standard deviation), are not
        # compared.
        _, std = log.values.get(of.name, (0.0, 0.0))
        if log.robot not in of.robots or not 0 < std < np.inf:
            continue
        past = (of.robot == of.robots.index(log.robot)) & (of.time < log.time)
        if past.any() and effect.freedom:
            tests += _tests(log, effect, past)
        elif past.any():
            unknown = "no robot has two logs yet, so what weeks differ by is not known"
    # The surest test of each parameter speaks for it; all tests count as chances of a false alarm.
    surest = dict[str, Change]()
    for change in sorted(tests, key=lambda test: test.false_alarm):
        false_alarm = min(1.0, len(tests) * change.false_alarm)
        surest.setdefault(change.name, change._replace(false_alarm=false_alarm))
    return Judgement(
        robot=log.robot,
        time=log.time,
        looked=tuple(surest.values()),
        level=level,
        unknown="" if surest else unknown,
    )


def _tests(log: Logged, effect: Effect, past: NDArray[np.bool_]) -> Iterator[Change]:
    """Compare one parameter with its past (M,): its mean, then a line through all logs.

    All values are converted to the temperature of the new log where every temperature is noted.
    """
    of = effect.of
    value, std = log.values[of.name]
    # Errors of a fit and scatter of weeks are independent: their variances add.
    weight = 1 / (of.std[past] ** 2 + effect.weeks**2)
    weight_now = 1 / (std**2 + effect.weeks**2)
    # Values at their own temperatures, before they are converted.
    y = of.value[past]
    warmer = log.temperature - of.temperature[past]
    slope_std = 0.0
    if np.isfinite(effect.slope) and np.isfinite(warmer).all():
        y = y + effect.slope * warmer
        slope_std = effect.slope_std
    else:
        # Without a correction none of its error remains.
        warmer = np.zeros(len(y))

    # 1. Against the mean of the past: sees a step.
    total = float(weight.sum())
    mean = float((weight * y).sum()) / total
    by_slope = slope_std * float((weight * warmer).sum()) / total
    variance = 1 / weight_now + 1 / total + by_slope**2
    yield _change(effect, mean, value, float(np.sqrt(variance)))
    # A line through fewer logs has more uncertainty than the step.
    if len(y) < JUDGEMENT.line:
        return

    # 2. Along a line through all logs: sees a drift that no single step shows.
    # The new log is the last point of the line.
    time = np.append(of.time[past], log.time)
    y = np.append(y, value)
    weight = np.append(weight, weight_now)
    duration = np.ptp(time)
    # Times about their weighted mean make slope and mean of the line independent.
    time = time - (weight * time).sum() / weight.sum()
    # The drift over the duration is this linear function of the values.
    lever = weight * time / (weight * time**2).sum() * duration
    drift = float((lever * y).sum())
    middle = float((weight * y).sum() / weight.sum())
    begin = middle + drift * time.min() / duration
    by_slope = slope_std * float((lever[:-1] * warmer).sum())
    variance = float((lever**2 / weight).sum()) + by_slope**2
    first_time = float(of.time[past].min())
    yield _change(effect, begin, begin + drift, float(np.sqrt(variance)), first_time)


def _change(
    effect: Effect, old: float, new: float, std: float, since: float | None = None
) -> Change:
    from scipy.special import stdtr

    # Student's, two-sided: the scatter of weeks is itself an estimate.
    chance = 2 * float(stdtr(effect.freedom, -abs(new - old) / std))
    of = effect.of
    return Change(of.name, of.label, of.unit, old, new, std, chance, since)

"""Score tests for effects that the rig does not model, at the optimum of the model without them.

The effect of a number that is zero in the model, projected off the effects of the fitted unknowns,
is a direction in which the innovations of a right model lie by chance alone. The sum of squares
along it, in units of their variance (inflated by their autocorrelation), is a chi-square. Effects
that are not linear are tried at several sizes (`identification.replay.optimum`).

Source: R. F. Engle, Wald, likelihood ratio, and Lagrange multiplier tests in econometrics, Handbook
of Econometrics II, 1984, ch. 13.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from identification.equation_error.least_squares import along, directions
from identification.replay.extended import Number, joint_of, kind_of
from identification.replay.optimum import Optimum, Trial, backlash, compliance
from identification.results.along_log import at_reversals
from identification.results.assumed import SHARE, longer
from plant.checkup.hypothesis import log_odds
from plant.compiler.background import shared_out
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen, frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict


@dataclass(frozen=True, kw_only=True)
class ScoreTestSettings:
    """Sizes and thresholds of the score tests.

    The values were chosen by hand. They are held by ``tests/benchmarks/detection.py`` (the cause
    that comes first, by robot), ``silent_mistakes.py`` (nine mistakes, each reported in 10 of 10
    logs) and ``healthy.py`` (0 of 200 right logs accused).

    Parameters
    ----------
    by_chance : float
        Probability with which a right model exceeds the threshold of one test.
    delay : float
        Delay of the counts [samples] whose effect is taken.
    shortest, longest : float
        Relative errors of a length between which it is tried: a smaller one is rounding, and a
        larger one is beyond a linear estimate.
    reversal_samples : int
        Samples at which a load changes sign that the test of reversals needs.
    reversal_ratio : float
        Ratio of the mean squared innovations there to those elsewhere above which the model fails.
    unexplained : float
        Share of an effect that must remain beside those of the unknowns, so that it is tested.
    absorbed : float
        Share of the squares of an effect below which its correction is not advised: the unknowns
        can produce the rest. Where counts are late, three tenths and more remain; on a real drive
        with unknown viscous friction, 0.0001, and the correction moved that friction to seven times
        its value.
    """

    by_chance: float = 1e-5
    delay: float = 0.05
    shortest: float = 0.05
    longest: float = 0.5
    reversal_samples: int = 30
    reversal_ratio: float = 3.0
    unexplained: float = 1e-3
    absorbed: float = 0.01


SETTINGS = ScoreTestSettings()

_Effects: TypeAlias = Mapping[str, Floats]


@dataclass(frozen=True, kw_only=True)
class ArmHypothesis:
    """One thing that can be wrong with an arm, its rig or its log: effect, test, fit and words.

    Parameters
    ----------
    name : str
        Of the cause, "gear".
    sentence, remedy : str
        What is wrong, and what a user does about it. Their fields: `{each}`, the sizes by joint;
        `{chance}`, the evidence; `{value}`, the first size in the unit of the model; `{scaled}`,
        a common factor of all sizes; `{joint}`, `{size}` of a cause with a line per joint;
        `{freedom}`, `{chi_square}`, `{threshold}`.
    telling : str
        A measurement that distinguishes this cause from other ones, and from unknowns.
    biased : bool
        Whether the unknowns take a part of its effect over.
    title : str
        The effect in a list of those that a log does not show.
    each : str
        One size: `{size}` in `unit`, `{joint}`, `{total}` and `{stated}` beside the rig's value,
        `{kind}`, `{cycles}`, `{late}`.
    between : str
        Between the sizes of two joints.
    unit : str
        Of the sizes in messages.
    convert : callable
        From the unit of the model to `unit`.
    numbers : tuple of Number
        Numbers of the model that are zero where the rig is right.
    torques : callable, optional
        ``torques(at)`` gives the torques along each record per unit of further numbers, by name.
    effect : callable, optional
        ``effect(at)`` (M,) on the innovations, per unit, where the cause is no number of a model.
    prefix : str
        Beginning of the names of its numbers, where that is neither its name nor theirs.
    signed : bool
        Whether its numbers may have either sign; otherwise only positive ones make sense.
    least_samples : float
        Lowest size, in samples: a smaller one is an error of timing.
    choices : int
        Values of a further number of which each pair of numbers has the best.
    against : float
        Natural logarithm of the odds against it before the log is read.
    spread : float
        Standard deviation of its sizes where it holds, in the unit of its numbers, or of `scale`.
        A log that determines a size much better costs evidence (Occam's factor); without one, the
        threshold of chance stands for that.
    scale : callable, optional
        As of a `Number`, for numbers of a torque along the log.
    timing : bool
        Whether it shifts the log in time. Two of these are not told apart, and straight lines
        through counts lag by half a pulse: along them they are not tested.
    suspected : bool
        Whether it is tested only where another effect is half significant: it takes time.
    gears : bool
        Whether each gear can have it once more; other causes do not follow it.
    shares : bool
        Whether its sizes are shares of what the rig states.
    falling : bool
        Whether `convert` gives a small number for a large effect.
    shown : callable
        ``shown(sign)`` gives the sizes that a message has, by name.
    test : callable
        ``test(hypothesis, at, effects)`` yields the `Sign` of an optimum.
    refit : callable, optional
        ``refit(hypothesis, point, sign)`` fits the model with this cause; without one it is no
        number of a model.
    """

    name: str
    sentence: str = ""
    remedy: str = ""
    telling: str = ""
    biased: bool = False
    title: str = ""
    each: str = "{size:+.2g} {unit} at {joint}"
    between: str = ", "
    unit: str = ""
    convert: Callable[[float], float] = float
    numbers: tuple[Number, ...] = ()
    torques: Callable[[Optimum], dict[str, list[Floats]]] | None = None
    effect: Callable[[Optimum], Floats] | None = None
    prefix: str = ""
    signed: bool = False
    least_samples: float = 0.0
    choices: int = 1
    against: float = 4.6
    spread: float = 0.0
    scale: Callable[[Floats, Floats], Floats] | None = None
    timing: bool = False
    suspected: bool = False
    gears: bool = False
    shares: bool = False
    falling: bool = False
    shown: Callable[["Sign"], dict[str, float]] = lambda sign: sign.values
    test: Callable[..., Iterator["Sign"]] | None = None
    refit: Callable[..., Any] | None = None

    def has(self, number: str) -> bool:
        """Whether a number of the model belongs to this cause."""
        kinds = [kind.name for kind in self.numbers]
        return kind_of(number) in (self.prefix or self.name, *kinds)

    def log_odds(self, sign: "Sign", efforts: Floats) -> float:
        """Log odds for this cause with the sizes of a sign, against none; `efforts`: as above."""
        kinds = {number.name: number for number in self.numbers}
        occam = self.against + math.log(self.choices) * sign.freedom / 2
        for name, visible in sign.visible.items():
            number = kinds.get(kind_of(name)) or Number(name=name, place="", scale=self.scale)
            spread = number.size(self.spread, name, efforts)
            # Visible is the size at which chi-square is at its threshold.
            occam += 0.5 * math.log1p(spread**2 * sign.threshold / visible**2)
        if not self.spread:
            occam = sign.threshold / 2
        return log_odds(sign.chi_square, against=occam)


@kept
@frozen
class Sign(Shown, Frozen):
    """Test of one effect that the rig may leave out, at the optimum of the model without it.

    Attributes
    ----------
    name : str
        "compliance", "backlash", "lag", "delay", "friction", "offset" of torques, "gear",
        "cogging", "length" of a link, "lead" of a law's torque, "reversals" of the load, or
        "disagreement": of the records with each other.
    chi_square : float
        Decrease of the sum of squared innovations with it, in units of their (inflated) variance.
    freedom : int
        Mean chi-square of a log without this effect.
    threshold : float
        Chi-square above which it is significant.
    explained : float
        Decrease of the sum of squared innovations [pulses^2].
    values : dict
        Estimates, in the units of `Extended`.
    visible : dict
        Smallest value of each that this log would show, in the same units.
    rivals : tuple of str
        Alternatives that explain nearly as much.
    log_odds : float
        Natural logarithm of the odds for this effect against none; NaN of one not selected.
    others : tuple of (str, float)
        The effects that come next, and their log odds.
    absorbing : tuple of str
        Unknowns that can produce nearly the same effect, so that the log hardly tells which of them
        is wrong.
    """

    name: str
    chi_square: float
    freedom: int
    threshold: float
    explained: float
    values: dict[str, float]
    visible: dict[str, float]
    rivals: tuple[str, ...] = ()
    absorbing: tuple[str, ...] = ()
    log_odds: float = math.nan
    others: tuple[tuple[str, float], ...] = ()

    @property
    def significant(self) -> bool:
        """Whether chi-square is above its threshold."""
        return bool(self.chi_square > self.threshold)

    def _short(self) -> str:
        return (
            f"{self.name}, chi-square {self.chi_square:.0f} of {self.freedom}, by chance below"
            f" {self.threshold:.0f}"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()}{': significant' * self.significant}", not self.significant)


def effects_of(
    at: Optimum, hypotheses: Sequence[ArmHypothesis], efforts: Floats
) -> dict[str, Floats]:
    """Effect (M,) on the innovations of each number of these hypotheses, per unit.

    `efforts` (2, n): torque and speed of each motor (rms). Compliance does not act linearly: its
    effect is that from rigid to stiff.
    """
    model = at.model
    steps = {
        name: number.size(number.step, name, efforts)
        for name, number in model.kinds.items()
        if number.step
    }
    # One row of values per number, with that number moved away from the optimum.
    moves = np.zeros((len(steps), len(at.values)))
    for row, (name, size) in zip(moves, steps.items(), strict=True):
        row[model.place(name)] = size
    # All at once, so that threads share the runs; the rows are fresh and are changed in place.
    changes = dict(zip(steps, model.all_innovations(at.values + moves), strict=True))
    for name, moved in changes.items():
        moved -= at.innovations
        moved /= steps[name]
    others = {row.name: row.effect(at) for row in hypotheses if row.effect is not None}
    return {**changes, **others}


def effect_of_delay(at: Optimum) -> Floats:
    """Effect (M,) of a delay of the counts [samples], by counts that are read later."""
    later = at.model.late(SETTINGS.delay).innovations(at.values)
    return (at.innovations - later) / SETTINGS.delay


def _threshold(freedom: int, choices: float = 1.0) -> float:
    """Chi-square that a right model exceeds by chance, as the best of so many choices."""
    from scipy.special import chdtri

    # The best of several tests exceeds a threshold as often as all of them together.
    return float(chdtri(freedom, SETTINGS.by_chance / choices))


def linear(
    hypothesis: ArmHypothesis, at: Optimum, effects: _Effects, choices: float = 1.0
) -> Iterator[Sign]:
    """The score test of numbers that act linearly, as the best of so many choices.

    Yields nothing if the effects can hardly be distinguished from those of the unknowns.
    """
    # 1. The part of each effect that the unknowns cannot take over.
    changes = {number: row for number, row in effects.items() if hypothesis.has(number)}
    rows = {number: at.left(change) for number, change in changes.items()}
    rows = {
        number: row
        for number, row in rows.items()
        if (row**2).sum() > SETTINGS.unexplained**2 * (changes[number] ** 2).sum()
    }
    if not rows:  # the unknowns take all of them over
        return
    residual = at.before
    freedom = len(rows)
    # A pair has one number more, such as the cycles per turn of a cosine and a sine.
    choices *= hypothesis.choices ** (freedom / 2)
    # 2. The significant sum of squares, and the size of each number that would explain it alone.
    limit = _threshold(freedom, choices) * at.unit(residual)
    lowest = hypothesis.least_samples * at.model.records[0].rig.period
    visible = {
        number: max(lowest, float(np.sqrt(limit / (row**2).sum()))) for number, row in rows.items()
    }
    remaining = residual
    size = np.empty(0)
    # 3. Least squares. Numbers below the lowest sensible value are left out, and the rest is fitted
    # again.
    while rows:
        matrix = np.array(list(rows.values()))
        size = -along(directions(matrix), matrix, residual)
        remaining = residual + np.einsum("i,im->m", size, matrix)
        # All values make sense.
        if hypothesis.signed or not (size < lowest).any():
            break
        rows = {
            number: row
            for (number, row), value in zip(rows.items(), size, strict=True)
            if value > lowest
        }
        remaining = residual
    # No number is left if none came out positive: then nothing is explained.
    values = dict(zip(rows, size.tolist(), strict=False))
    sign = _sign(at, hypothesis.name, freedom, remaining, values, visible, choices)
    yield replace(sign, absorbing=_absorbing(at, changes, values))


def _absorbing(at: Optimum, changes: _Effects, values: Mapping[str, float]) -> tuple[str, ...]:
    """Names of the unknowns that can produce nearly the same effect as these values."""
    if not values:
        return ()
    effect = np.sum([value * changes[name] for name, value in values.items()], axis=0)
    if (at.left(effect) ** 2).sum() > SETTINGS.absorbed * (effect**2).sum():
        return ()
    rates = at.rates[: at.unknown]
    parts = along(at.basis, at.rates, effect)[: at.unknown] * np.sqrt((rates**2).sum(axis=1))
    names = [at.model.unknown[i] for i in np.flatnonzero(at.step)[: at.unknown]]
    # Those that take over at least half as much as the first.
    largest = np.abs(parts).max()
    return tuple(name for name, part in zip(names, parts, strict=True) if 2 * abs(part) > largest)


def _sign(
    at: Optimum,
    name: str,
    freedom: int,
    remaining: Floats,
    values: dict[str, float],
    visible: dict[str, float],
    choices: float = 1.0,
) -> Sign:
    """The test of an alternative beside which so much (M,) of the innovations remains."""
    return Sign(
        name=name,
        chi_square=at.chi_square(remaining),
        freedom=freedom,
        threshold=_threshold(freedom, choices),
        explained=float((at.before**2).sum() - (remaining**2).sum()),
        values=values,
        visible=visible,
    )


def elastic(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """Of compliance the score test, or the trial of a resonance that explains more."""
    # A resonance above half of the sampling rate would not show, whatever the innovations are.
    smallest = (2 * max(record.rig.period for record in at.model.records)) ** 2
    for sign in linear(hypothesis, at, effects):
        # Far from rigid, the effect of a spring is not that of the linear estimate.
        best = max(compliance(at), key=lambda trial: trial.chi_square)
        visible = {name: max(value, smallest) for name, value in sign.visible.items()}
        sign = replace(sign, visible=visible)
        if best.chi_square < sign.chi_square:
            yield sign
        else:
            yield replace(
                sign, chi_square=best.chi_square, explained=best.explained, values=best.values
            )


def playing(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """The best trial of backlash; visible is the narrowest detectable width of each joint."""
    # Teeth touch through springs.
    if not any(number.gives for number in at.model.kinds.values()):
        return
    trials = backlash(at)
    freedom = 2  # the width of one gear, and its compliance
    threshold = _threshold(freedom)
    visible = dict[str, float]()
    for trial in trials:
        for name, value in trial.values.items():
            if hypothesis.has(name) and trial.effect > threshold:
                visible.setdefault(name, value)  # trials come from narrow to wide
    none = Trial(values={}, chi_square=-np.inf, explained=0.0, effect=0.0)
    best = max(trials, key=lambda trial: trial.chi_square, default=none)
    yield Sign(
        name=hypothesis.name,
        chi_square=best.chi_square,
        freedom=freedom,
        threshold=threshold,
        explained=best.explained,
        values=best.values,
        visible=visible,
    )


def lengths(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """The sign of the one length that explains most."""
    # Lengths of the first link place the base: they do not act.
    names = [name for name in longer(at.model.dynamics) if joint_of(name)]
    # Each needs its own model, so they run on all cores.
    rows = shared_out(lambda name: effect_of_length(at, name), names, at.model.threads)
    acting = {name: row for name, row in zip(names, rows, strict=True) if np.isfinite(row).all()}
    plausible = [
        sign
        for name, row in acting.items()
        for sign in linear(hypothesis, at, {name: row}, len(acting))
        if SETTINGS.shortest <= abs(*sign.values.values()) <= SETTINGS.longest
    ]
    # Lengths are nearly one thing for the log: at most one is reported.
    yield from sorted(plausible, key=lambda sign: -sign.chi_square)[:1]


def effect_of_length(at: Optimum, name: str) -> Floats:
    """Effect (M,) on the innovations of a length, relative."""
    # By a difference, as the model has no length as a number.
    longer_model = at.model.of(longer(at.model.dynamics)[name])
    return (longer_model.innovations(at.values) - at.innovations) / SHARE


def untested(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """No test: the intervals count the tolerance of its numbers, and results their effects."""
    yield from ()


def reversals(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """Whether the model fails where loads change sign, as with wide backlash; the worst joint."""
    # Mean squares, as the samples near a reversal are few.
    ratios = [
        ((crossing**2).mean() / (elsewhere**2).mean(), i, crossing)
        for i, crossing, elsewhere in at_reversals(at)
        if min(len(crossing), len(elsewhere)) > SETTINGS.reversal_samples and elsewhere.any()
    ]
    if not ratios:
        return
    ratio, i, crossing = max(ratios, key=lambda item: item[0])
    yield Sign(
        name=hypothesis.name,
        # As if the innovations were independent, with the variance of those elsewhere.
        chi_square=ratio * len(crossing),
        freedom=len(crossing),
        threshold=SETTINGS.reversal_ratio * len(crossing),
        explained=(crossing**2).sum() * (1 - 1 / ratio),
        values={f"{hypothesis.name}[{i}]": ratio},
        visible={},
    )


def disagreement(hypothesis: ArmHypothesis, at: Optimum, effects: _Effects) -> Iterator[Sign]:
    """Whether each record alone would have other values of the unknowns."""
    records = at.model.runs()
    # A single record agrees with itself.
    if len(records) < 2:
        return
    # Values of their own for every record but one, beside the common values, span them all.
    rows = []
    for record in records[1:]:
        alone = np.zeros((at.unknown, len(at.innovations)))
        alone[:, record] = at.rates[: at.unknown, record]
        rows += [at.left(row) for row in alone]
    matrix = np.array(rows)
    basis = directions(matrix)
    remaining = at.before - np.einsum("i,im->m", along(basis, matrix, at.before), matrix)
    yield _sign(at, hypothesis.name, len(basis), remaining, {}, {})

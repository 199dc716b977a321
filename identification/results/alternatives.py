"""Score tests for effects that the rig does not model, at the optimum of the model without them.

The effect of a number that is zero in the model, projected off the effects of the fitted unknowns,
is a direction in which the innovations of a right model lie by chance alone. The sum of squares
along it, in units of their variance, is a chi-square. Its log odds are half of what exceeds a
threshold, which follows from the odds against the cause and from its prior sizes. Effects that are
not linear are tried at several sizes (`identification.replay.optimum`).

Source: R. F. Engle, Wald, likelihood ratio, and Lagrange multiplier tests in econometrics, Handbook
of Econometrics II, 1984, ch. 13; R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90,
1995.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from identification.equation_error import along, directions
from identification.replay import Number, Optimum, Trial, backlash, compliance, joint_of, kind_of
from identification.results.along_log import at_reversals
from identification.results.assumed import SHARE, longer
from plant.compiler import shared_out
from plant.parts import Floats, Frozen, Piece, Shown, Verdict, frozen, kept


@dataclass(frozen=True, kw_only=True)
class ScoreTestSettings:
    """Sizes of the score tests.

    The values were chosen by hand. They are held by ``tests/benchmarks/detection.py`` (the cause
    that comes first, by robot), ``silent_mistakes.py`` (nine mistakes, each reported in 10 of 10
    logs) and ``healthy.py`` (0 of 200 right logs accused).

    Parameters
    ----------
    wide : float
        Prior standard deviation of a number that states none, as a multiple of the standard
        deviation with which the log determines that number.
    delay : float
        Delay of the counts [samples] whose effect is taken.
    shortest, longest : float
        Smallest and largest relative error of a length that may be reported: a smaller one is
        rounding, and a larger one is beyond a linear estimate.
    share_of_variant : float
        A variant of a law is reported only if its estimated share differs from 1 by less than this.
    reversal_samples : int
        The test of reversals needs more samples than this, both near reversals and elsewhere.
    reversal_ratio : float
        Ratio of the mean squared innovations there to those elsewhere that a right model may have.
    unexplained : float
        Share of an effect that must remain beside those of the unknowns, so that it is tested.
    suspicious : float
        Share of its threshold from which on a chi-square asks for further tests.
    absorbed : float
        Share of the squares of an effect below which its correction is not advised: the unknowns
        can produce the rest. Where counts are late, three tenths and more remain; on a real drive
        with unknown viscous friction, 0.0001, and the correction moved that friction to seven times
        its value.
    """

    wide: float = 10.0
    delay: float = 0.05
    shortest: float = 0.05
    longest: float = 0.5
    share_of_variant: float = 0.3
    reversal_samples: int = 30
    reversal_ratio: float = 3.0
    unexplained: float = 1e-3
    suspicious: float = 1 / 3
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
        `{value}`, the first size in the unit of the model; `{joint}`, `{size}` of a cause with a
        line per joint;
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
    of_slides : tuple of str and callable, optional
        `unit` and `convert` for a joint that slides; by default the two above.
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
        Number of values that were tried for a further parameter; each pair of numbers uses the
        best of them.
    against : float
        Natural logarithm of the odds against it before the log is read.
    spread : float
        Standard deviation of its sizes where it holds, in the unit of its numbers, or of `scale`.
        A log that determines a size much better costs evidence (Occam's factor).
    scale : callable, optional
        As of a `Number`, for numbers of a torque along the log.
    timing : bool
        Whether it shifts the log in time. Two of these are not told apart, and straight lines
        through counts lag by half a pulse: along them they are not tested.
    suspected : bool
        Whether it is tested only where another effect is a third of its threshold: it takes time.
    minor : str
        Field of `Tolerances` that its numbers have where they have no tolerance of their own.
    minor_share : float
        Share of their tolerance below which its numbers give no warning (see
        ``docs/background/intervals.md``).
    gears : bool
        Whether each gear can have it once more; other causes do not follow it.
    shares : bool
        Whether its sizes are shares of what the rig states.
    falling : bool
        Whether `convert` gives a small number for a large effect.
    shown : callable
        ``shown(sign)`` gives the sizes that a message has, by name; by default those that are
        `detectable`.
    test : callable
        ``test(hypothesis, point)`` yields the `Sign` of a `Point`.
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
    of_slides: tuple[str, Callable[[float], float]] | None = None
    numbers: tuple[Number, ...] = ()
    torques: Callable[[Optimum], dict[str, list[Floats]]] | None = None
    effect: Callable[[Optimum], Floats] | None = None
    prefix: str = ""
    signed: bool = False
    least_samples: float = 0.0
    choices: int = 1
    against: float = 6.0
    spread: float = 0.0
    scale: Callable[[Floats, Floats], Floats] | None = None
    timing: bool = False
    suspected: bool = False
    minor: str = ""
    minor_share: float = 0.3
    gears: bool = False
    shares: bool = False
    falling: bool = False
    shown: Callable[["Sign"], dict[str, float]] = lambda sign: sign.detectable
    test: Callable[..., Iterator["Sign"]] | None = None
    refit: Callable[..., Any] | None = None

    def has(self, number: str) -> bool:
        """Whether a number of the model belongs to this cause."""
        kinds = [kind.name for kind in self.numbers]
        return kind_of(number) in (self.prefix or self.name, *kinds)

    def threshold(
        self, rows: _Effects, residual: Floats, unit: float, efforts: Floats, choices: float = 1.0
    ) -> float:
        """Chi-square at which the odds for some numbers are even.

        `rows`: effect (M,) of each beside the unknowns, by name. `residual` (M,): without them;
        `unit`: its variance with them. `efforts`: as of a `Number`; `choices`: of which these
        numbers are the best.
        """
        # Effects of the prior sizes, in units of what remains.
        scaled = np.array(
            [self.size(self.spread, name, efforts) * row for name, row in rows.items()]
        ) / math.sqrt(unit)
        precisions, axes = np.linalg.eigh(scaled @ scaled.T)
        precisions = np.maximum(precisions, 1e-12)  # rounding can make zero negative
        explained = (axes.T @ (scaled @ residual)) ** 2 / precisions
        # A pair has one number more, such as the cycles per turn of a cosine and a sine.
        return self._even(precisions, explained, choices * self.choices ** (len(rows) / 2))

    def threshold_of(self, freedom: int) -> float:
        """The same of numbers without a prior size."""
        return self._even(np.full(freedom, SETTINGS.wide**2), np.ones(freedom), 1.0)

    def _even(self, precisions: Floats, explained: Floats, choices: float) -> float:
        """Even odds, from squares of prior sizes in units of those that the log determines."""
        occam = 0.5 * float(np.log1p(precisions).sum()) + math.log(choices)
        # A prior narrower than the likelihood explains a part of a chi-square only.
        explicable = np.average(precisions / (1 + precisions), weights=explained + 1e-300)
        return 2 * (self.against + occam) / float(explicable)

    def size(self, share: float, name: str, efforts: Floats) -> float:
        """Size of one of its numbers at a share of its scale; `efforts` as of a `Number`."""
        kinds = {number.name: number for number in self.numbers}
        along_log = Number(name=self.name, place="", scale=self.scale)
        return kinds.get(kind_of(name), along_log).size(share, name, efforts)


@dataclass(frozen=True, kw_only=True, eq=False)
class Point:
    """The optimum beside which causes are tested.

    `step` (m,), `bounds` (m, 2): of its values. `effects`: change of the innovations (M,) with each
    number that the rig leaves out; `testable`: of those that this log can show. `torques`: along
    the log, of numbers that act as one. `efforts` (2, n): torque and speed of each motor (rms).
    `causes`: those that it has, as accepted.
    """

    at: Optimum
    step: Floats
    bounds: Floats
    effects: _Effects
    testable: _Effects
    torques: Mapping[str, Sequence[Floats]]
    efforts: Floats
    causes: tuple["Sign", ...] = ()


@kept
@frozen
class Sign(Shown, Frozen):
    """Test of one effect that the rig may leave out, at the optimum of the model without it.

    Attributes
    ----------
    name : str
        "compliance", "backlash", "lag", "delay", "friction", "offset" of torques, "gear",
        "cogging", "breakaway", "length" of a link, "lead" of a law's torque, "law gain", "limit" of
        the torque, "variant" of a law,
        "reversals" of the load, or "disagreement": of the records with each other.
    chi_square : float
        Decrease of the sum of squared innovations with it, in units of their variance, which counts
        that they are not independent.
    freedom : int
        Numbers of the effect.
    threshold : float
        Chi-square at which the odds for it are even: above, it is significant.
    explained : float
        Decrease of the sum of squared innovations [pulses^2].
    values : dict
        Estimates, in the units of `Extended`.
    visible : dict
        Smallest value of each that this log would show, in the same units.
    rivals : tuple of str
        Alternatives that explain nearly as much.
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
    others: tuple[tuple[str, float], ...] = ()

    @property
    def detectable(self) -> dict[str, float]:
        """The values that this log shows, without joints whose value is noise; else all."""
        shown = {
            name: value
            for name, value in self.values.items()
            if abs(value) > self.visible.get(name, 0.0)
        }
        return shown or self.values

    @property
    def log_odds(self) -> float:
        """Natural logarithm of the odds for this effect against none."""
        return (self.chi_square - self.threshold) / 2

    @property
    def significant(self) -> bool:
        """Whether the odds are for it."""
        return self.log_odds > 0

    @property
    def suspicious(self) -> bool:
        """Whether it comes near to what is significant."""
        return self.chi_square > SETTINGS.suspicious * self.threshold

    def _short(self) -> str:
        return (
            f"{self.name}, chi-square {self.chi_square:.0f} of {self.freedom}, even odds at"
            f" {self.threshold:.0f}"
        )

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()}{': significant' * self.significant}", not self.significant)


def effects_of(
    at: Optimum, hypotheses: Sequence[ArmHypothesis], efforts: Floats
) -> dict[str, Floats]:
    """Effect (M,) on the innovations, per unit, of each number of the model and each hypothesis.

    Numbers of the model without a step, and hypotheses without an `effect`, are left out.

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


def linear(
    hypothesis: ArmHypothesis,
    point: Point,
    effects: _Effects | None = None,
    choices: float = 1.0,
) -> Iterator[Sign]:
    """The score test of numbers that act linearly, as the best of so many choices.

    `effects`: of the numbers, by default those of the point. Yields nothing if the effects can
    hardly be distinguished from those of the unknowns.
    """
    # 1. The part of each effect that the unknowns cannot take over.
    at = point.at
    effects = point.testable if effects is None else effects
    changes = {number: row for number, row in effects.items() if hypothesis.has(number)}
    if not changes:
        return
    lefts = at.left(np.array([*changes.values()]))
    rows = dict(zip(changes, lefts, strict=True))
    rows = {
        number: row
        for number, row in rows.items()
        if (row**2).sum() > SETTINGS.unexplained**2 * (changes[number] ** 2).sum()
    }
    if not rows:  # the unknowns take all of them over
        return
    residual = at.before
    # Before numbers are left out: all of them were free to explain the residual.
    freedom = len(rows)
    lowest = hypothesis.least_samples * at.model.records[0].rig.period
    tested = rows
    remaining = residual
    size = np.empty(0)
    # 2. Least squares. Numbers below the lowest sensible value are left out, and the rest is fitted
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
    # If no value exceeds the lowest sensible one, no number is left and nothing is explained.
    values = dict(zip(rows, size.tolist(), strict=False))
    # 3. The sum of squares at even odds, and the size of each number that would explain it alone.
    unit = at.evidence_unit(remaining)
    threshold = hypothesis.threshold(tested, residual, unit, point.efforts, choices)
    visible = {
        number: max(lowest, float(np.sqrt(threshold * unit / (row**2).sum())))
        for number, row in tested.items()
    }
    sign = _sign(at, hypothesis.name, freedom, remaining, threshold, values, visible)
    yield replace(sign, absorbing=_absorbing(at, changes, values))


def _absorbing(at: Optimum, changes: _Effects, values: Mapping[str, float]) -> tuple[str, ...]:
    """Names of the unknowns that can produce nearly the same effect as these values."""
    if not values:
        return ()
    # Together, as the correction would be applied, not number by number.
    effect = np.sum([value * changes[name] for name, value in values.items()], axis=0)
    if (at.left(effect) ** 2).sum() > SETTINGS.absorbed * (effect**2).sum():
        return ()
    rates = at.rates[: at.unknown]
    parts = along(at.basis, at.rates, effect)[: at.unknown] * np.sqrt((rates**2).sum(axis=1))
    names = [at.model.unknown[i] for i in np.flatnonzero(at.step)[: at.unknown]]
    # Those that take over more than half as much as the one that takes over most.
    largest = np.abs(parts).max()
    return tuple(name for name, part in zip(names, parts, strict=True) if 2 * abs(part) > largest)


def _sign(
    at: Optimum,
    name: str,
    freedom: int,
    remaining: Floats,
    threshold: float,
    values: dict[str, float],
    visible: dict[str, float],
) -> Sign:
    """The test of an alternative beside which so much (M,) of the innovations remains."""
    return Sign(
        name=name,
        chi_square=at.chi_square(remaining),
        freedom=freedom,
        threshold=threshold,
        explained=float((at.before**2).sum() - (remaining**2).sum()),
        values=values,
        visible=visible,
    )


def elastic(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """Of compliance the score test, or the trial of a resonance that explains more."""
    at = point.at
    # A resonance above half of the sampling rate would not show, whatever the innovations are.
    # Nyquist: half of the sampling rate, of the slowest record.
    smallest = (2 * max(record.rig.period for record in at.model.records)) ** 2
    for sign in linear(hypothesis, point):
        visible = {name: max(value, smallest) for name, value in sign.visible.items()}
        sign = replace(sign, visible=visible)
        # The linear estimate is wrong far from rigid, so resonances are tried. They are not tried
        # if neither that estimate nor the size of the innovations suggests a spring.
        untried = at.clean and not sign.suspicious
        trials = [] if untried else compliance(at, SETTINGS.suspicious * sign.threshold)
        best = max(trials, key=lambda trial: trial.chi_square, default=None)
        if best is None or best.chi_square < sign.chi_square:
            yield sign
        else:
            yield replace(
                sign, chi_square=best.chi_square, explained=best.explained, values=best.values
            )


def playing(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """The best trial of backlash; visible is the narrowest detectable width of each joint."""
    at = point.at
    # Teeth touch through springs.
    if not any(number.gives for number in at.model.kinds.values()):
        return
    trials = backlash(at)
    freedom = 2  # the width of one gear, and its compliance
    threshold = hypothesis.threshold_of(freedom)
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


def lengths(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """The sign of the one length that explains most."""
    at = point.at
    # Lengths of the first link place the base: they do not act.
    # One model per length: that is why lengths are tested last.
    names = [name for name in longer(at.model.dynamics) if joint_of(name)]
    # Each needs its own model, so they run on all cores.
    rows = shared_out(lambda name: effect_of_length(at, name), names, at.model.threads)
    acting = {name: row for name, row in zip(names, rows, strict=True) if np.isfinite(row).all()}
    plausible = [
        sign
        for name, row in acting.items()
        for sign in linear(hypothesis, point, {name: row}, len(acting))
        if SETTINGS.shortest <= abs(*sign.values.values()) <= SETTINGS.longest
    ]
    # Lengths are nearly one thing for the log: at most one is reported.
    yield from sorted(plausible, key=lambda sign: -sign.chi_square)[:1]


def effect_of_length(at: Optimum, name: str) -> Floats:
    """Effect (M,) on the innovations of a length, relative."""
    # By a difference, as the model has no length as a number.
    longer_model = at.model.of(longer(at.model.dynamics)[name])
    return (longer_model.innovations(at.values) - at.innovations) / SHARE


def variant(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """The sign of the one variant of the law that explains most, if it does so as a whole."""
    rows = {name: row for name, row in point.testable.items() if hypothesis.has(name)}
    signs = [
        sign
        for name, row in rows.items()
        for sign in linear(hypothesis, point, {name: row}, len(rows))
    ]
    # A share of a variant is something else: a gain, or a delay.
    whole = [
        sign for sign in signs if abs(sum(sign.values.values()) - 1) < SETTINGS.share_of_variant
    ]
    yield from sorted(whole, key=lambda sign: -sign.chi_square)[:1]


def likeliest(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """The likeliest of the signs of single fields, such as all gains, or all integral gains."""
    fields: dict[str, dict[str, Floats]] = {}
    for name, row in point.testable.items():
        if hypothesis.has(name):
            fields.setdefault(name.partition("[")[0], {})[name] = row
    signs = [
        sign for rows in fields.values() for sign in linear(hypothesis, point, rows, len(fields))
    ]
    yield from sorted(signs, key=lambda sign: -sign.log_odds)[:1]


def untested(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """No test: the intervals count the tolerance of its numbers, and results their effects."""
    yield from ()


def reversals(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """Whether the model fails where loads change sign, as with wide backlash; the worst joint."""
    at = point.at
    # With known rounding: without it the ratio would be one of the smallest errors.
    innovations = at.left(at.innovations + at.model.rounding)
    # What another cause explains is no sign of this one.
    if point.testable:
        effects = at.left(np.array([*point.testable.values()]))
        innovations = innovations - along(directions(effects), effects, innovations) @ effects
    # Mean squares, as the samples near a reversal are few.
    ratios = [
        ((crossing**2).mean() / (elsewhere**2).mean(), i, crossing)
        for i, crossing, elsewhere in at_reversals(at, innovations)
        if min(len(crossing), len(elsewhere)) > SETTINGS.reversal_samples and elsewhere.any()
    ]
    if not ratios:
        return
    # One joint: where several gears play, the worst hides the others.
    ratio, i, crossing = max(ratios, key=lambda item: item[0])
    # Beyond what a right model may have there.
    explained = float((crossing**2).sum() * (1 - SETTINGS.reversal_ratio / ratio))
    yield Sign(
        name=hypothesis.name,
        chi_square=explained / at.evidence_unit(at.before),
        freedom=1,
        threshold=hypothesis.threshold_of(1),
        explained=explained,
        values={f"{hypothesis.name}[{i}]": ratio},
        visible={},
    )


def disagreement(hypothesis: ArmHypothesis, point: Point) -> Iterator[Sign]:
    """Whether each record alone would have other values of the unknowns."""
    at = point.at
    records = at.model.runs()
    # A single record agrees with itself.
    if len(records) < 2:
        return
    # Values of their own for every record but one, beside the common values, span them all.
    rows = []
    for record in records[1:]:
        alone = np.zeros((at.unknown, len(at.innovations)))
        alone[:, record] = at.rates[: at.unknown, record]
        rows.append(at.left(alone))
    matrix = np.concatenate(rows)
    basis = directions(matrix)
    remaining = at.before - np.einsum("i,im->m", along(basis, matrix, at.before), matrix)
    threshold = hypothesis.threshold_of(len(basis))
    yield _sign(at, hypothesis.name, len(basis), remaining, threshold, {}, {})

"""Score tests for effects that the rig does not model, at the optimum of the model without them.

The effect of a number that is zero in the model, projected off the effects of the fitted unknowns,
is a direction in which the innovations of a right model lie by chance alone. The sum of squares
along it, in units of their variance (inflated by their autocorrelation), is a chi-square. Effects
that are not linear are tried at several sizes (`identification.replay.optimum`).

Source: R. F. Engle, Wald, likelihood ratio, and Lagrange multiplier tests in econometrics, Handbook
of Econometrics II, 1984, ch. 13.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.equation_error.least_squares import along, directions
from identification.replay.extended import Extended
from identification.replay.optimum import Optimum, Trial, backlash, compliance
from identification.results.along_log import CYCLES, at_reversals
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen, frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict
from plant.simulation.followed_path import is_rounded


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
    resonance : float
        Resonance [Hz] whose effect stands for that of compliance, where gears are rigid.
    lag : float
        Lag of the currents [s] whose effect is taken.
    delay : float
        Delay of the counts [samples] whose effect is taken.
    torque : float
        Friction and offset whose effects are taken, as a share of the motor's torque (rms).
    share : float
        Relative change of gears, motor gains and gains of the law whose effect is taken.
    lead : float
        Samples by which a torque leads, at least, where its law has the rate of the error; a
        smaller lead is an error of timing.
    reversal_samples : int
        Samples at which a load changes sign that the test of reversals needs.
    reversal_ratio : float
        Ratio of the mean squared innovations there to those elsewhere above which the model fails.
    unexplained : float
        Share of an effect that must remain beside those of the unknowns, so that the two can be
        distinguished.
    """

    by_chance: float = 1e-5
    resonance: float = 200.0
    lag: float = 1e-5
    delay: float = 0.05
    torque: float = 0.01
    share: float = 1e-4
    lead: float = 0.5
    reversal_samples: int = 30
    reversal_ratio: float = 3.0
    unexplained: float = 1e-3


SETTINGS = ScoreTestSettings()

# Alternatives whose number may have either sign; of the others only a positive one makes sense.
_SIGNED = ("friction", "delay", "offset", "gear", "cogging", "length")


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
    """

    name: str
    chi_square: float
    freedom: int
    threshold: float
    explained: float
    values: dict[str, float]
    visible: dict[str, float]
    rivals: tuple[str, ...] = ()

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


def signs(at: Optimum, effects: dict[str, Floats]) -> list[Sign]:
    """All tests (of `effects_of`) at an optimum; none of lag or delay along a rounded path."""
    if any(map(is_rounded, at.model.records)):  # straight lines through counts lag by half a pulse
        effects = {name: row for name, row in effects.items() if name not in ("lag", "delay")}
    # A number whose effect diverges cannot be tested.
    finite = {name: row for name, row in effects.items() if np.isfinite(row).all()}
    results: list[Sign] = []
    for name in ("compliance", "lag", "friction", "offset", "gear", "delay", "cogging", "lead"):
        members = {number: row for number, row in finite.items() if family(number) == name}
        results += linear(at, name, members)
    # Compliance and backlash are not linear: the trials decide, where the model has springs.
    if "compliance[0]" in at.model.extra:
        results = [
            _best(sign, compliance(at)) if sign.name == "compliance" else sign for sign in results
        ]
        results.append(_of_backlash(backlash(at)))
    return [*results, *_reversals(at), *_disagreement(at)]


def effects_of(at: Optimum, efforts: Floats) -> dict[str, Floats]:
    """Effect (M,) on the innovations of each number that a rig leaves out and of a delay, per unit.

    Compliance and backlash do not act linearly: of compliance the effect is that from rigid to
    stiff, none of backlash.
    """
    model = at.model
    steps = _steps(model, efforts)
    # One row of values per number, with that number moved away from the optimum.
    moves = np.zeros((len(steps), len(at.values)))
    for row, (name, size) in zip(moves, steps.items(), strict=True):
        row[model.place(name)] = size
    # All at once, so that threads share the runs; the rows are fresh and are changed in place.
    changes = dict(zip(steps, model.all_innovations(at.values + moves), strict=True))
    for name, moved in changes.items():
        moved -= at.innovations
        moved /= steps[name]
    return {**changes, "delay": _effect_of_delay(at)}


def _effect_of_delay(at: Optimum) -> Floats:
    """Effect (M,) of a delay of the counts [samples], by counts that are read later."""
    later = at.model.late(SETTINGS.delay).innovations(at.values)
    return (at.innovations - later) / SETTINGS.delay


def delay_sign(at: Optimum) -> Sign | None:
    """The test of late counts; None where the unknowns take a delay over."""
    effect = _effect_of_delay(at)
    return next(linear(at, "delay", {"delay": effect}), None) if np.isfinite(effect).all() else None


def _steps(model: Extended, efforts: Floats) -> dict[str, float]:
    """Size of each number whose effect is taken, small enough that it acts linearly."""
    torque, speed = efforts
    n = len(torque)
    sizes = {
        "compliance": np.full(n, SETTINGS.resonance**-2),
        "lag": np.array([SETTINGS.lag]),
        "viscous": SETTINGS.torque * torque / speed,
        "coulomb": SETTINGS.torque * torque,
        "offset": SETTINGS.torque * torque,
        "gear": np.full(n, SETTINGS.share),
        "motor_gain": np.full(n, SETTINGS.share),
    }
    steps = {}
    # Backlash, without an entry here, has no effect that is linear.
    for name in model.extra:
        # A name such as ``coulomb[1]``; a lag has no joint.
        kind, _, joint = name.rstrip("]").partition("[")
        # Gains of the law, such as ``law.gain[0]``, change by a share of themselves.
        if kind.startswith("law."):
            steps[name] = SETTINGS.share
        elif kind in sizes:
            steps[name] = float(sizes[kind][int(joint or 0)])
    return steps


def family(name: str) -> str:
    """The alternative that a number belongs to."""
    # Of ``cogging.6cos[0]`` it is cogging; of ``law.gain[0]`` law, which no test has.
    kind = name.partition("[")[0].partition(".")[0]
    return "friction" if kind in ("viscous", "coulomb") else kind


def _threshold(freedom: int, choices: float = 1.0) -> float:
    """Chi-square that a right model exceeds by chance, as the best of so many choices."""
    from scipy.special import chdtri

    # The best of several tests exceeds a threshold as often as all of them together.
    return float(chdtri(freedom, SETTINGS.by_chance / choices))


def linear(
    at: Optimum, name: str, changes: dict[str, Floats], choices: float = 1.0
) -> Iterator[Sign]:
    """The score test of numbers that act linearly, as the best of so many choices.

    Of compliance, lag and lead only positive values count. Yields nothing if the effects
    can hardly be distinguished from those of the unknowns.
    """
    # 1. The part of each effect that the unknowns cannot take over.
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
    if name == "cogging":  # a cosine and a sine each, of the best number of cycles per turn
        choices = CYCLES ** (freedom / 2)
    # 2. The significant sum of squares, and the size of each number that would explain it alone.
    limit = _threshold(freedom, choices) * at.unit(residual)
    lowest = SETTINGS.lead * at.model.records[0].rig.period if name == "lead" else 0.0
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
        if name in _SIGNED or not (size < lowest).any():
            break
        rows = {
            number: row
            for (number, row), value in zip(rows.items(), size, strict=True)
            if value > lowest
        }
        remaining = residual
    # No number is left if none came out positive: then nothing is explained.
    values = dict(zip(rows, size.tolist(), strict=False))
    yield _sign(at, name, freedom, remaining, values, visible, choices)


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


def _best(sign: Sign, trials: Sequence[Trial]) -> Sign:
    """A sign, or the trial that lowers the sum of squares more."""
    # Far from rigid, the effect of a spring is not that of the linear estimate.
    best = max(trials, key=lambda trial: trial.chi_square)
    if best.chi_square < sign.chi_square:
        return sign
    return replace(sign, chi_square=best.chi_square, explained=best.explained, values=best.values)


def _of_backlash(trials: Sequence[Trial]) -> Sign:
    """The best trial of backlash; visible is the narrowest detectable width of each joint."""
    freedom = 2  # the width of one gear, and its compliance
    threshold = _threshold(freedom)
    visible = dict[str, float]()
    for trial in trials:
        for name, value in trial.values.items():
            if name.startswith("backlash") and trial.effect > threshold:
                visible.setdefault(name, value)  # trials come from narrow to wide
    none = Trial(values={}, chi_square=-np.inf, explained=0.0, effect=0.0)
    best = max(trials, key=lambda trial: trial.chi_square, default=none)
    return Sign(
        name="backlash",
        chi_square=best.chi_square,
        freedom=freedom,
        threshold=threshold,
        explained=best.explained,
        values=best.values,
        visible=visible,
    )


def _reversals(at: Optimum) -> Iterator[Sign]:
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
        name="reversals",
        # As if the innovations were independent, with the variance of those elsewhere.
        chi_square=ratio * len(crossing),
        freedom=len(crossing),
        threshold=SETTINGS.reversal_ratio * len(crossing),
        explained=(crossing**2).sum() * (1 - 1 / ratio),
        values={f"reversals[{i}]": ratio},
        visible={},
    )


def _disagreement(at: Optimum) -> Iterator[Sign]:
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
    yield _sign(at, "disagreement", len(basis), remaining, {}, {})


def sampled(sign: Sign, period: float) -> Sign:
    """A sign whose detectable resonances are below half of the sampling rate (`period` [s])."""
    if sign.name != "compliance":
        return sign
    smallest = (2 * period) ** 2  # compliance of a resonance at the Nyquist frequency [1/Hz^2]
    return replace(
        sign, visible={name: max(value, smallest) for name, value in sign.visible.items()}
    )

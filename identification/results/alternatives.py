"""What of that which a rig leaves out explains the innovations of a fit: score tests where the fit
is best without it.

The change of the innovations with a number that is zero in the model, less what the fitted unknowns
can do as well, is a direction in which the innovations of a right model lie by chance alone. The
sum of squares that goes with it, in units of their variance (inflated by their autocorrelation), is
a chi-square. What does not act linearly is tried (`identification.replay.optimum`).

Source: R. F. Engle, Wald, likelihood ratio, and Lagrange multiplier tests in econometrics, Handbook
of Econometrics II, 1984, ch. 13.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from identification.equation_error.least_squares import along, directions
from identification.replay.extended import Extended
from identification.replay.optimum import Optimum, Trial, backlash, compliance
from identification.results.along_log import CYCLES, at_reversals
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict
from plant.simulation.followed_path import is_rounded

_BY_CHANCE = 1e-5  # probability with which a right model reaches a threshold

_HERTZ = 200.0  # resonance by whose effect that of compliance is taken, where gears are rigid [Hz]

# The same of a lag [s], of a delay [samples], of friction and offset, as a share of a motor's
# torque (rms), and of gears, motor gains and gains of the law, relative.
_LAG = 1e-5
_DELAY = 0.05
_FRICTION = 0.01
_SHARE = 1e-4

# samples by which a torque leads, at least, where its law has the rate of the error; less is timing
_LEAD = 0.5

# samples in which a load changes sign, at least, and by how much innovations² are larger there
_FEW = 30
_FAILS = 3.0
# what can be more or less than stated
_SIGNED = ("friction", "delay", "offset", "gear", "cogging", "length")

# an effect of which less than this share is its own cannot be told from those of the unknowns
_OWN = 1e-3


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Sign(Shown, Frozen):
    """What a log says of one thing that its rig may leave out.

    Attributes
    ----------
    name : str
        "compliance", "backlash", "lag", "delay", "friction", "offset" of torques, "gear",
        "cogging", "length" of a link, "lead" of a law's torque, "reversals" of the load, or
        "disagreement": of the records with each other.
    chi_square : float
        By how much it would lower the sum of squared innovations, in units of their (inflated)
        variance.
    freedom : int
        Chi-square, on average, of a log that has nothing of it.
    threshold : float
        Chi-square above which it is significant.
    explained : float
        Decrease of the sum of squared innovations [pulses^2].
    values : dict
        Estimates, in the units of `Extended`.
    visible : dict
        The least of each that this log would show, in the same units.
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
    """All alternatives (of `effects_of`), where the sum of squares is least; no lag or delay of
    a rounded path.
    """
    if any(map(is_rounded, at.model.records)):  # straight lines through counts lag by half a pulse
        effects = {name: row for name, row in effects.items() if name not in ("lag", "delay")}
    changes = {name: row for name, row in effects.items() if np.isfinite(row).all()}
    found: list[Sign] = []
    for name in ("compliance", "lag", "friction", "offset", "gear", "delay", "cogging", "lead"):
        own = {each: row for each, row in changes.items() if family(each) == name}
        found += linear(at, name, own)
    if "compliance[0]" in at.model.extra:
        found = [
            _best(sign, compliance(at)) if sign.name == "compliance" else sign for sign in found
        ]
        found.append(_of_backlash(backlash(at)))
    return [*found, *_reversals(at), *_disagreement(at)]


def effects_of(at: Optimum, efforts: Floats) -> dict[str, Floats]:
    """Change of the innovations (M,) with each of what a rig leaves out and with ``delay``, by
    name; where it is small.

    Compliance and backlash do not act linearly: of compliance the change is that from rigid to
    stiff, none of backlash.
    """
    model = at.model
    steps = _steps(at.model, efforts)
    moves = np.zeros((len(steps), len(at.values)))
    for row, (name, size) in zip(moves, steps.items(), strict=True):
        row[model.place(name)] = size
    changes = dict(zip(steps, model.all_innovations(at.values + moves), strict=True))
    for name, moved in changes.items():
        moved -= at.innovations
        moved /= steps[name]
    return {
        **changes,
        "delay": (at.innovations - model.late(_DELAY).innovations(at.values)) / _DELAY,
    }


def delay_sign(at: Optimum) -> Sign | None:
    """The sign of counts that are read late; None where that cannot be told from the unknowns."""
    later = at.model.late(_DELAY).innovations(at.values)
    change = (at.innovations - later) / _DELAY
    return next(linear(at, "delay", {"delay": change}), None) if np.isfinite(change).all() else None


def _steps(model: Extended, efforts: Floats) -> dict[str, float]:
    """By how much each of what acts linearly is changed."""
    torque, speed = efforts
    sizes = {
        "compliance": np.full(len(torque), _HERTZ**-2),
        "lag": np.array([_LAG]),
        "viscous": _FRICTION * torque / speed,
        "coulomb": _FRICTION * torque,
        "offset": _FRICTION * torque,
        "gear": np.full(len(torque), _SHARE),
        "motor_gain": np.full(len(torque), _SHARE),
    }
    steps = {}
    for name in model.extra:
        kind, _, joint = name.rstrip("]").partition("[")
        if kind.startswith("law."):
            steps[name] = _SHARE
        elif kind in sizes:
            steps[name] = float(sizes[kind][int(joint or 0)])
    return steps


def family(name: str) -> str:
    """The alternative that a number belongs to."""
    kind = name.partition("[")[0].partition(".")[0]
    return "friction" if kind in ("viscous", "coulomb") else kind


def _threshold(freedom: int, choices: float = 1.0) -> float:
    """Chi-square that a right model exceeds by chance; of the best of so many choices."""
    from scipy.special import chdtri

    return float(chdtri(freedom, _BY_CHANCE / choices))


def linear(
    at: Optimum, name: str, changes: dict[str, Floats], choices: float = 1.0
) -> Iterator[Sign]:
    """The sign of what acts linearly, the best of so many choices; of compliance, lag and lead,
    only what is positive.

    None of what is too small.
    """
    own = {each: at.left(change) for each, change in changes.items()}
    own = {
        each: row
        for each, row in own.items()
        if (row**2).sum() > _OWN**2 * (changes[each] ** 2).sum()
    }
    if not own:
        return
    before = at.before
    freedom = len(own)
    choices = CYCLES ** (freedom / 2) if name == "cogging" else choices
    least = _threshold(freedom, choices) * at.unit(before)
    lowest = _LEAD * at.model.records[0].rig.period if name == "lead" else 0.0
    visible = {
        each: max(lowest, float(np.sqrt(least / (row**2).sum()))) for each, row in own.items()
    }
    after = before
    size = np.empty(0)
    while own:
        rows = np.array(list(own.values()))
        size = -along(directions(rows), rows, before)
        after = before + np.einsum("i,im->m", size, rows)
        if name in _SIGNED or not (size < lowest).any():
            break
        own = {each: row for (each, row), x in zip(own.items(), size, strict=True) if x > lowest}
        after = before
    yield _sign(
        at, name, freedom, after, dict(zip(own, size.tolist(), strict=False)), visible, choices
    )


def _sign(
    at: Optimum,
    name: str,
    freedom: int,
    after: Floats,
    values: dict[str, float],
    visible: dict[str, float],
    choices: float = 1.0,
) -> Sign:
    """Of an alternative that leaves so much (M,) of the innovations."""
    return Sign(
        name=name,
        chi_square=at.chi_square(after),
        freedom=freedom,
        threshold=_threshold(freedom, choices),
        explained=float((at.before**2).sum() - (after**2).sum()),
        values=values,
        visible=visible,
    )


def _best(sign: Sign, trials: Sequence[Trial]) -> Sign:
    """A sign, or the trial that lowers the sum of squares more."""
    best = max(trials, key=lambda trial: trial.chi_square)
    if best.chi_square < sign.chi_square:
        return sign
    return dataclasses.replace(
        sign, chi_square=best.chi_square, explained=best.explained, values=best.values
    )


def _of_backlash(trials: Sequence[Trial]) -> Sign:
    """The trial that lowers the sum of squares most; the narrowest of each joint whose effect is
    detectable.
    """
    visible = dict[str, float]()
    threshold = _threshold(2)
    for trial in trials:
        for name, value in trial.values.items():
            if name.startswith("backlash") and trial.effect > threshold:
                visible.setdefault(name, value)
    none = Trial(values={}, chi_square=-np.inf, explained=0.0, effect=0.0)
    best = max(trials, key=lambda trial: trial.chi_square, default=none)
    return Sign(
        name="backlash",
        chi_square=best.chi_square,
        freedom=2,
        threshold=threshold,
        explained=best.explained,
        values=best.values,
        visible=visible,
    )


def _reversals(at: Optimum) -> Iterator[Sign]:
    """Of the joint where it shows most: whether the model fails where the load changes sign, as
    in wide backlash.
    """
    some = [each for each in at_reversals(at) if min(map(len, each[1:])) > _FEW and each[2].any()]
    there = [((near**2).mean() / (elsewhere**2).mean(), i, near) for i, near, elsewhere in some]
    for ratio, i, near in sorted(there, key=lambda each: -each[0])[:1]:
        yield Sign(
            name="reversals",
            chi_square=ratio * len(near),
            freedom=len(near),
            threshold=_FAILS * len(near),
            explained=(near**2).sum() * (1 - 1 / ratio),
            values={f"reversals[{i}]": ratio},
            visible={},
        )


def _disagreement(at: Optimum) -> Iterator[Sign]:
    """Whether each record alone would have other values of the unknowns."""
    records = at.model.runs()
    if len(records) < 2:
        return
    apart: list[Floats] = []
    for record in records[1:]:
        alone = np.zeros((at.unknown, len(at.innovations)))
        alone[:, record] = at.rates[: at.unknown, record]
        apart += [at.left(row) for row in alone]
    before = at.before
    rows = np.array(apart)
    made = directions(rows)
    after = before - np.einsum("i,im->m", along(made, rows, before), rows)
    yield _sign(at, "disagreement", len(made), after, {}, {})


def sampled(sign: Sign, period: float) -> Sign:
    """A sign whose resonances are none that samples every `period` [s] could show."""
    if sign.name != "compliance":
        return sign
    least = (2 * period) ** 2
    return dataclasses.replace(
        sign, visible={name: max(value, least) for name, value in sign.visible.items()}
    )

"""Pass band and least speeds of a torque fit, chosen by cross-validation over segments of the logs.

A narrow band and high speeds hold the equations that can be trusted: rounding of the counts,
elasticity and uncertain signs of friction are outside. These equations alone determine inertias and
offsets poorly. A wide band holds more, until noise in the accelerations makes every value too
small; its own residual does not show that. So a fit is judged by the torques of segments that it
has not seen, in all *narrower* bands: it may use its band as long as it predicts these no worse
than their own fits do. Least speeds likewise, judged at higher speeds. Of those that are no worse
by more than one standard error over the segments, or by ten per cent, the most inclusive is taken.

Sources: O. V. Lepskii, On a problem of adaptive estimation in Gaussian white noise, Theory of
Probability and its Applications 35 (1990) (the widest that agrees with all narrower ones); L.
Breiman et al., Classification and Regression Trees (1984), ch. 3 (one standard error); P. Burman,
E. Chow, D. Nolan, A cross-validatory method for dependent data, Biometrika 81 (1994) (segments left
out, with a gap on both sides).
"""

import contextlib
import functools
import operator
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from identification.equation_error.least_squares import IDENTIFIABLE
from identification.equation_error.regressor import Places, System
from plant.parts import Floats, Integers, Piece, Shown, frozen, frozen_settings, least, product

# Segments of all logs together, at least; and of each log, at most.
SEGMENTS = 10

# Least speeds that are tested, in the usual speed of each joint, the most cautious first.
SHARES = (0.1, 0.05, 0.02, 0.01, 0.0)


@frozen_settings
class BandChoiceSettings:
    """When a band, or a least speed, predicts worse than a more cautious one.

    Parameters
    ----------
    worse : float
        Standard errors over the segments by which the squared errors of prediction may be larger:
        the rule of one standard error (Breiman).
    far : float
        Standard errors from which on nothing more inclusive is tried; chosen by hand.
    small : float
        Relative increase of the squared errors that does not count however regular it is; chosen by
        hand.
    equations : int
        Least equations per unknown of a fit that can judge others; chosen by hand.
    segments : int
        Least segments over which errors are compared; chosen by hand.
    """

    worse: float = 1.0
    far: float = 3.0
    small: float = 0.1
    equations: int = 10
    segments: int = 4


SETTINGS = BandChoiceSettings()


@frozen
class FitTrial(Shown):
    """One pass band, or one least speed, on trial.

    `at`: the band [Hz]; or the share of the usual speeds below which equations are left out.
    `unit`: "Hz", or "of the usual speed". `rows`: equations of its fit. `worse`: by how many
    standard errors this fit predicts the segments left out worse than a more cautious one's own fit
    does, among that one's equations, where it does worst; -inf of the most cautious. `against`:
    that more cautious one. `passed`: whether it may be chosen: the most inclusive that may is.
    """

    at: float
    unit: str
    rows: int
    worse: float
    against: float | None
    passed: bool
    chosen: bool = False

    @property
    def row(self) -> tuple[str, ...]:
        """Its cells in a table of all trials."""
        # The most cautious trial was compared with none: two cells of its row stay empty.
        against = ("", "")
        if self.against is not None:
            against = (f"{self.worse:+.1f}", self._number(self.against))
        return self._number(self.at), f"{self.rows}", *against, self._verdict

    @property
    def _verdict(self) -> str:
        return "chosen" if self.chosen else "" if self.passed else "too much"

    def _number(self, at: float) -> str:
        return f"{at:.3g} Hz" if self.unit == "Hz" else f"{at:.0%}"

    def _short(self) -> str:
        unit = "" if self.unit == "Hz" else f" {self.unit}"
        text = f"{self._number(self.at)}{unit}, {self.rows} equations"
        if self.against is not None:
            text += f", {self.worse:+.1f} standard errors against {self._number(self.against)}"
        return f"{text}, {self._verdict}" if self._verdict else text

    def _shown(self) -> Iterator[Piece]:
        yield self._short()


@frozen
class _Tried:
    """Equations in a band at least speeds, their fit, and the fits without each segment."""

    rows: Floats
    target: Floats
    weight: Floats
    segment: Integers
    without: Floats

    def losses(self, fits: Floats) -> Floats:
        """Mean squared error (S,) of each segment, predicted by the fit without it.

        `fits` (S, k). NaN of a segment without rows.
        """
        losses = np.full(len(fits), np.nan)
        # A segment none of whose equations count has no loss. Each of the others is predicted by
        # the fit that has not seen it.
        for s in np.unique(self.segment):
            unseen = self.segment == s
            predicted = product(self.rows[unseen], fits[s])
            error = (self.target[unseen] - predicted) * self.weight[unseen]
            losses[s] = np.mean(error**2)
        return losses

    def worse(self, less_cautious: "_Tried") -> float:
        """Standard errors by which a less cautious fit predicts these equations worse.

        At most `SETTINGS.worse`, which passes, where the difference is small.
        """
        losses = self.losses(self.without)
        # The same segments, pair by pair: they differ much more from each other than two fits do.
        increase = self.losses(less_cautious.without) - losses
        both = np.isfinite(increase)
        # The standard error of a few differences is no evidence against the less cautious fit.
        if both.sum() < SETTINGS.segments:
            return -np.inf
        mean = increase[both].mean()
        error = increase[both].std(ddof=1) / np.sqrt(both.sum())
        # Segments that all differ alike: the difference is certain, unless there is none.
        certain = float(np.sign(mean) * np.inf) if mean else 0.0
        score = float(mean / error) if error > 0 else certain
        small = not mean > SETTINGS.small * losses[both].mean()
        return min(score, SETTINGS.worse) if small else score


class _Choice:
    """Values that are tested in turn, each against the more cautious ones before it.

    `trials`: the result of each value.
    """

    def __init__(
        self,
        unit: str,
        cautious: Callable[[float, float], bool],
        seconds: Floats,
        weights: Floats | None,
    ) -> None:
        self._unit = unit
        self._cautious = cautious
        self._seconds = seconds
        self._weights = weights
        self._tried = dict[float, _Tried]()
        self.trials = dict[float, FitTrial]()

    def worse(self, at: float, systems: Sequence[System], gap: float) -> float:
        """Standard errors by which a value predicts worse than a more cautious one.

        -inf where there are too few equations yet.
        """
        fit = tried(systems, self._seconds, gap, self._weights)
        if fit is None:
            return -np.inf
        scores = {
            value: cautious.worse(fit)
            for value, cautious in self._tried.items()
            if self._cautious(value, at)
        }
        # The harshest of the more cautious ones judges it; the most cautious has no judge.
        against = max(scores, key=scores.__getitem__, default=None)
        worst = -np.inf if against is None else scores[against]
        # Stored even where it fails: on its own equations it judges everything less cautious.
        self._tried[at] = fit
        self.trials[at] = FitTrial(
            at=at,
            unit=self._unit,
            rows=len(fit.target),
            worse=worst,
            against=against,
            passed=worst <= SETTINGS.worse,
        )
        return worst

    def ordered(self, best: float, order: Iterable[float]) -> tuple[FitTrial, ...]:
        """All trials in this order, with the chosen one marked."""
        return tuple(replace(self.trials[at], chosen=at == best) for at in order)


def choose_band(
    bands: Sequence[float],
    equations: Callable[[float], Sequence[System]],
    seconds: Floats,
    weights: Floats | None,
) -> tuple[float, tuple[FitTrial, ...]]:
    """The widest pass band that no narrower one contradicts.

    Octaves first, until one is too wide, then the bands before it. Of several logs none wider than
    most choose alone: friction that differs between them hides what a wide band does. `bands`:
    increasing, half an octave apart [Hz]. `equations`: band -> the logs' systems, cautious in
    speed. `seconds` (R,): length of each log. `weights` (R, n) or None: of logs and joints, if
    stated.
    """
    if len(seconds) > 1:
        # Each log chooses alone; one that is too short to choose leaves the choice to the others.
        equations = functools.cache(equations)
        alone = [bands[-1]] * len(seconds)
        for i in range(len(seconds)):
            log = slice(i, i + 1)
            of_log_weights = None if weights is None else weights[log]

            def of_log(band: float, log: slice = log) -> Sequence[System]:
                return equations(band)[log]

            with contextlib.suppress(ValueError):
                alone[i] = choose_band(bands, of_log, seconds[log], of_log_weights)[0]
        # The median of the logs: neither one noisy log nor one quiet log decides.
        bands = [band for band in bands if band <= np.median(alone)]
    # Narrower bands are the more cautious ones.
    choice = _Choice("Hz", operator.lt, seconds, weights)

    # 1. Octaves, until one is far too wide. The memory of a filter is one over its band: so wide is
    # the gap around a segment that is left out.
    for octave in bands[::2]:
        if choice.worse(octave, equations(octave), 1 / octave) > SETTINGS.far:
            break
    if not choice.trials:
        raise ValueError(
            "some band must hold enough equations to leave segments out; none does. Log longer, or"
            " state band, cutoff and least_speed."
        )
    best = max(trial.at for trial in choice.trials.values() if trial.passed)

    # 2. The half octave above the best.
    for between in bands[1::2]:
        if not best < between < 2 * best:
            continue
        if choice.worse(between, equations(between), 1 / between) <= SETTINGS.worse:
            best = between
    return best, choice.ordered(best, sorted(choice.trials))


def choose_speed(
    shares: Sequence[float],
    equations: Callable[[float], Sequence[System]],
    seconds: Floats,
    gap: float,
    weights: Floats | None,
) -> tuple[float, tuple[FitTrial, ...]]:
    """The lowest share of the usual speeds that no higher share contradicts.

    Arguments as for `choose_band`.
    """
    # Higher least speeds are the more cautious ones, and come first among the shares.
    choice = _Choice("of the usual speed", operator.gt, seconds, weights)
    for share in shares:
        if choice.worse(share, equations(share), gap) > SETTINGS.far:
            break
    if not choice.trials:
        return 0.0, ()
    best = min(trial.at for trial in choice.trials.values() if trial.passed)
    return best, choice.ordered(best, choice.trials)


def tried(
    systems: Sequence[System],
    seconds: Floats,
    gap: float,
    weights: Floats | None,
    prior: tuple[Floats, Floats] | None = None,
) -> _Tried | None:
    """Fits without each segment, nor the equations within a gap [s] of it.

    `prior`: rows (m, k) and target (m,) of equations of standard deviation 1 that are in all fits.

    None where there are too few equations.
    """
    places = Places.of(systems)
    rows = np.concatenate([system.regressor[system.used] for system in systems])
    target = np.concatenate([system.torque[system.used] for system in systems])
    k = rows.shape[1]
    # With few equations for each unknown the fit follows its noise, and its predictions judge
    # nothing.
    if len(target) < SETTINGS.equations * k:
        return None
    segment, segments = places.segments(seconds, SEGMENTS)
    # One set of weights for all fits: they differ by the segment that is left out, and by nothing
    # else.
    weight = _weight(rows, target, places, weights)
    weighted_rows = rows * weight[:, None]
    weighted_target = target * weight
    without = np.full((segments, k), np.nan)
    for s in np.unique(segment):
        inside = segment == s
        record = places.record[inside][0]
        t = places.t[inside]
        # Filters carry torques of the segment into its neighbourhood: that is left out as well.
        near = (places.record == record) & (places.t > t.min() - gap) & (places.t < t.max() + gap)
        # With fewer equations the fit has no residual, and predicts nothing.
        if (~near).sum() > 2 * k:
            known = weighted_rows[~near], weighted_target[~near]
            if prior is not None:
                known = np.vstack([known[0], prior[0]]), np.append(known[1], prior[1])
            without[s] = _solved(*known)
    return _Tried(rows=rows, target=target, weight=weight, segment=segment, without=without)


def _weight(rows: Floats, target: Floats, places: Places, weights: Floats | None) -> Floats:
    """Of each equation: as stated, or 1 over its joint's residual in an unweighted fit."""
    if weights is not None:
        return weights[places.record, places.joint]
    residual = target - product(rows, _solved(rows, target))
    squares = np.bincount(places.joint, residual**2) / np.maximum(np.bincount(places.joint), 1)
    # A joint that is explained exactly, as in a noiseless log, must not have an infinite weight.
    sigma = np.maximum(np.sqrt(squares), 1e-9 * np.abs(target).max())
    return 1 / sigma[places.joint]


def _solved(rows: Floats, target: Floats) -> Floats:
    """Least squares with columns of one length; directions that the rows do not show stay small.

    Not `least_squares`, which refuses dependent columns: a segment left out may make some so.
    """
    lengths = np.sqrt((rows * rows).sum(axis=0))
    # A column of zeros stays one, and gets the value zero.
    lengths = np.where(lengths > 0, lengths, 1.0)
    return least(rows / lengths, target, IDENTIFIABLE.equations) / lengths

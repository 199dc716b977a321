"""Forward selection of the causes that contradict a model: accept the likeliest, test all again."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from identification.equation_error import still
from identification.replay import Extended, fitted, nearest
from identification.results.along_log import acting, effects_along, efforts
from identification.results.alternatives import Point, Sign, effects_of, linear
from identification.results.detection import Detection
from identification.results.model_error import Doubt, priors
from identification.results.refits import compared
from identification.results.with_arm import BY_NAME, HYPOTHESES, NUMBERS
from identification.search import (
    FIT,
    Fit,
    Outcome,
    Problem,
    as_tested,
    in_parts,
    rows_of_parts,
    start_of_fit,
    torque_fit,
)
from plant.checkup import Candidate, SelectionSettings, beside, select
from plant.parts import Floats
from plant.simulation import is_rounded


@dataclass(frozen=True, kw_only=True)
class StepwiseSettings:
    """Which causes the forward selection fits, and with what step; log odds alone select a cause.

    The values were chosen by hand. Benchmarks check them: ``tests/benchmarks/detection.py`` (which
    cause comes first for each robot), ``second_reading.py causes`` (three laws) and ``healthy.py``
    (none of 200 logs without a fault is accused).

    Parameters
    ----------
    promising : float
        A cause is fitted only if its first estimate explains more than this share of what the best
        first estimate explains, because fits take time.
    contending : float
        A cause whose log odds exceed this share of those of the likeliest cause may overtake it
        once both fits have converged.
    step : float
        Step of the central differences of an unknown, in its standard deviations.
    """

    promising: float = 0.2
    contending: float = 0.5
    step: float = 0.05


SETTINGS = StepwiseSettings()

# No model is exact: an accepted cause leaves a residue of about a twentieth of its own size, which
# looks like another cause. The share was chosen by hand.
SELECTION = SelectionSettings(traces=0.05)


def detect(problem: Problem, fit: Fit, outcome: Outcome, delay: float = 0.0) -> Detection:
    """Test the model of a fit for the causes that contradict it.

    `fit`: the values at which the optimisation starts. The model is fitted again; this fit includes
    the records held out and takes parts of long records. `delay`: a delay of the counts [samples]
    that another test suggests, 0 if none. If a test raises a ValueError, the result holds its text
    as `reason`; an error in the variance between records is raised.
    """
    try:
        search = _Search(problem, fit, outcome.rounding)
        # A delay from another test is taken for real: it needs no check at finer steps.
        detection = search.detection(delay, coarse=not delay)
        if detection is None:
            # An integration error can make a test significant. Under a soft P loop, 4 steps gave
            # compliant gears of 222 Hz with odds of 1e21; 16 steps gave a chi-square of only 7
            # (seed 137 of ``any_rig.py``). So has the finest grid of the fit: 64 steps gave a delay
            # of 0.04 samples with odds of 1e8 in a torque that a controller held, 256 none.
            # Start at the optimum of the coarse steps: it is close.
            finer = problem.in_steps(FIT.refined * problem.steps)
            search = _Search(finer, fit, outcome.rounding, search.at)
            detection = search.detection(delay)
        doubt = search.doubt()
        added = doubt.added(problem.tolerances)
        detection = replace(
            detection,
            assumed=doubt.assumed(),
            doubt=added,
            friction=doubt.friction(problem.tolerances, problem.unknown),
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        return Detection(reason=str(error))
    if fit.covariance is None or fit.finds_gears:
        return detection
    # Outside the try block: if the variance between records cannot be computed, this must raise.
    grouped, between = doubt.grouped(problem.unknown, fit.covariance, added)
    if between is None and outcome.grouped is not None:
        grouped = outcome.grouped
    return replace(detection, grouped=grouped, between=between)


def tested(point: Point) -> list[Sign]:
    """The signs of all hypotheses at a point."""
    # A path that is rounded to counts has an edge at every count, which looks like a delay.
    rounded = any(map(is_rounded, point.at.model.records))
    signs: list[Sign] = []
    for hypothesis in HYPOTHESES:
        if hypothesis.timing and rounded:
            continue
        # Lengths are tested last, and only after a suspicious sign: f absorbs nearly all of them.
        if hypothesis.suspected and not any(sign.suspicious for sign in signs):
            continue
        signs += (hypothesis.test or linear)(hypothesis, point)
    return signs


@dataclass(frozen=True, eq=False)
class _Accepted:
    """A cause beside those of a point, with the model, values and steps of its fit."""

    search: "_Search"
    point: Point
    sign: Sign
    fit: tuple[Extended, Floats, Floats] | None = None

    def __call__(self) -> Point:
        """The point with this cause."""
        if self.fit is None:
            return replace(self.point, causes=(*self.point.causes, self.sign))
        model, values, step = self.fit
        # Trial fits use sensitivities of the previous optimum; this one takes its own.
        optimum = fitted(model, values, step, self.point.bounds)
        hypothesis = BY_NAME[self.sign.name]
        adopted = compared(hypothesis, self.point, self.sign, optimum, step)
        return self.search.point_at(
            optimum, step, self.point.bounds, (*self.point.causes, adopted.sign)
        )

    @property
    def candidate(self) -> Candidate:
        """This cause as a candidate of the selection."""
        hypothesis: Any = BY_NAME[self.sign.name]
        return Candidate(hypothesis, (), 0.0, self.sign.log_odds, self)


def _settled(trials: list[_Accepted]) -> list[_Accepted]:
    """The same causes, each fitted with its own sensitivities, with chi-squares in a common unit.

    Trial fits use the sensitivities of the previous optimum. The errors of these fits exceed the
    differences between causes with nearly the same effect, such as late counts and another
    friction.
    """
    fits = [trial.fit for trial in trials if trial.fit is not None]
    optima = [
        fitted(model, values, step, trial.point.bounds)
        for trial, (model, values, step) in zip(trials, fits, strict=True)
    ]
    closest = min(optima, key=lambda optimum: optimum.squares)
    unit = closest.evidence_unit(closest.innovations)
    settled = []
    for trial, optimum, (_, _, step) in zip(trials, optima, fits, strict=True):
        sign = compared(BY_NAME[trial.sign.name], trial.point, trial.sign, optimum, step).sign
        sign = replace(sign, chi_square=sign.explained / unit)
        settled.append(replace(trial, sign=sign, fit=(optimum.model, optimum.values, step)))
    return settled


class _Search:
    """The optimum of the model with the causes accepted so far.

    `point`: this optimum.
    """

    def __init__(self, problem, fit, rounding, start=None):
        # 1. The model, on parts of long records, and its unknowns with their steps and bounds.
        records, keep = as_tested(problem, fit)
        if fit.covariance is not None:
            values = fit.values
            std = fit.std
        else:  # a method without a covariance: from least squares on the torque equation
            values, std = start_of_fit(problem, torque_fit(problem))
        by_name = dict(zip(problem.unknown, values, strict=True))
        parts = [in_parts(record) for record in records]
        model = Extended(
            problem.dynamics,
            [piece for pieces in parts for piece in pieces],
            [problem.unknown[i] for i in keep],
            np.array([by_name[name] for name in problem.dynamics.names]),
            NUMBERS,
            prior=problem.prior,
            runs=[len(pieces) for pieces in parts],
            **problem.options,
        )
        # The rounding of the counts is part of the innovations, and no error of the model.
        searched = records[: len(problem.records)]
        known = rows_of_parts(rounding, searched, model.prior.count)
        if known is not None:
            # The rounding of the records held out was not simulated.
            model.rounding[: len(known)] = known
        # Numbers that the rig leaves out are zero and, with a step of 0, not varied yet.
        extra = np.zeros(len(model.extra))
        step = np.concatenate([SETTINGS.step * std[keep], model.gain_steps, extra])
        limits = np.column_stack([model.least, np.full(len(extra), np.inf)])
        bounds = np.vstack([problem.bounds[keep], model.gain_bounds, limits])

        # 2. Its optimum. Low observer gains may lose a record that was held out, so the gains of
        # the fit compete with the model's default.
        if start is None:  # otherwise at the optimum of coarse steps
            gains = [model.gains] if fit.gains is None else [fit.gains, model.gains]
            begin = nearest(model, [np.concatenate([values[keep], gain, extra]) for gain in gains])
        else:
            begin = start.values
        optimum = fitted(model, begin, step, bounds, start)
        # The weight of the prior depends on the variance of the innovations.
        if model.prior.settle(optimum.unit(optimum.innovations)):
            optimum = fitted(model, optimum.values, step, bounds)
        model.read_between(optimum.values)
        self._initial = optimum

        # 3. Properties of the records that the tests need.
        self._keep = keep
        self._unknown = len(problem.unknown)
        self._tolerances = problem.tolerances
        # Innovations of records held out come last; they count for no interval.
        self._searched = model.runs()[len(problem.records) - 1].stop
        self._share = sum(len(piece) for pieces in parts for piece in pieces) / sum(
            map(len, records)
        )
        self._efforts = efforts(parts[0])
        chain = problem.dynamics.chain
        self.joints = tuple(chain.joint_labels)
        self.slides = tuple(i for i, link in enumerate(chain.links) if link.prismatic)
        # Friction holds these joints, so no number of theirs follows from the log.
        self._idle = tuple(f"[{i}]" for i in still(records))
        self.point = self.point_at(optimum, step, bounds)

    @property
    def at(self):
        """The present optimum."""
        return self.point.at

    def point_at(self, optimum, step, bounds, causes=()):
        """An optimum with the effects of what the rig leaves out there."""
        along = {}
        for hypothesis in HYPOTHESES:
            if hypothesis.torques is not None:
                along |= hypothesis.torques(optimum)
        torques = acting(along)
        effects = effects_of(optimum, HYPOTHESES, self._efforts) | effects_along(optimum, torques)
        return Point(
            at=optimum,
            step=step,
            bounds=bounds,
            effects=effects,
            testable={
                name: row
                for name, row in effects.items()
                # Friction holds idle joints; a number whose effect diverges cannot be tested.
                if not name.endswith(self._idle) and np.isfinite(row).all()
            },
            torques=torques,
            efforts=self._efforts,
            causes=causes,
        )

    def detection(self, delay, *, coarse=False):
        """Select the causes one after another.

        `delay`: a delay [samples] that the first round tries whatever its score test says, unless a
        path is rounded to counts; 0 if none. `coarse`: return None if a test is significant, since
        an error of integration may be the reason.
        """
        # Read this before any cause is accepted: later models would state their own findings.
        stated = self.at.model.stated()
        # These tests stay in the result: they show how small an effect the log would reveal.
        initial = tested(self.point)
        if coarse and any(sign.significant for sign in initial):
            return None
        named = []

        def candidates(point):
            if point.causes:
                return self._candidates(point, tested(point))
            return self._candidates(point, [_suggested(sign, delay) for sign in initial])

        def accept(ranked):
            self.point = ranked[0].corrected()
            others, near = beside(ranked, SELECTION)
            named.append(
                replace(
                    self.point.causes[-1],
                    rivals=tuple(other.hypothesis.name for other in near),
                    others=tuple((other.hypothesis.name, other.log_odds) for other in others),
                )
            )
            return self.point

        select(self.point, candidates, accept, SELECTION)
        # Values of the final fit, in which all accepted causes are fitted together.
        estimates = [_with_values(sign, self.at) for sign in named]
        return Detection(
            signs=tuple(initial),
            named=tuple(sign for sign in estimates if not self._tolerated(sign)),
            stated=stated,
            joints=self.joints,
            slides=self.slides,
        )

    def _candidates(self, point, signs):
        """Candidates to join the causes of a point. If several contend, `_settled` refits them."""
        trials = [*self._fitted(point, signs)]
        limit = SETTINGS.contending * max((trial.sign.log_odds for trial in trials), default=0.0)
        close = [trial for trial in trials if trial.fit and trial.sign.log_odds > limit > 0]
        if len(close) > 1:
            trials = [trial for trial in trials if trial not in close] + _settled(close)
        return [trial.candidate for trial in trials]

    def _fitted(self, point, signs):
        """Trial fits of these causes beside those of a point."""
        # If the last cause cannot be fitted, its effect cannot be removed, so the selection ends.
        if point.causes and BY_NAME[point.causes[-1].name].refit is None:
            return
        signs = [sign for sign in signs if sign.significant and _may_follow(sign, point.causes)]
        largest = max((sign.explained for sign in signs), default=0.0)
        for sign in signs:
            hypothesis = BY_NAME[sign.name]
            if hypothesis.refit is None:
                yield _Accepted(self, point, sign)
            # A delay that another test suggests has infinite odds: it is always tried.
            elif sign.explained > SETTINGS.promising * largest or np.isinf(sign.chi_square):
                refit = hypothesis.refit(hypothesis, point, sign)
                if refit is not None:
                    # Without its sensitivities, which would fill the memory.
                    fit = refit.at.model, refit.at.values, refit.step
                    yield _Accepted(self, point, refit.sign, fit)

    def _tolerated(self, sign):
        """Whether all values are small against tolerances that the intervals already include."""
        # The usual size of each is the standard deviation that `Tolerances` give it.
        hypothesis = BY_NAME[sign.name]
        share = getattr(self._tolerances, hypothesis.minor, 0.0)
        usual = {name: hypothesis.size(share, name, self._efforts) for name in sign.values}
        usual |= priors(self._tolerances, sign.values, self._efforts)
        return bool(sign.values) and all(
            abs(value) < hypothesis.minor_share * usual[name] for name, value in sign.values.items()
        )

    def doubt(self):
        """The optimum and its effects, from which the bias of the unknowns follows."""
        return Doubt(
            at=self.at,
            initial=self._initial,
            step=self.point.step,
            keep=self._keep,
            unknown=self._unknown,
            searched=self._searched,
            effects=self.point.effects,
            efforts=self._efforts,
            share=self._share,
        )


def _suggested(sign, delay):
    """The sign; that of the delay gets a suggested `delay` as value and an infinite chi-square."""
    if not delay or sign.name != "delay":
        return sign
    return replace(sign, values={"delay": delay}, chi_square=np.inf)


def _with_values(sign, at):
    """A sign with the values of a fit, where the model has them as unknowns."""
    model = at.model
    values = {
        name: float(at.values[model.place(name)]) if name in model.extra else value
        for name, value in sign.values.items()
    }
    return replace(sign, values=values)


def _may_follow(sign, causes):
    """Whether a cause can be told from those reported before it.

    Backlash includes the compliance of its gear, so only further backlash follows it; late counts
    and lagging currents have nearly the same effect.
    """
    before = [BY_NAME[cause.name] for cause in causes]
    hypothesis = BY_NAME[sign.name]
    # A cause is reported once, except one that gear after gear can have.
    if any(cause.gears for cause in before):
        return hypothesis.gears
    timed = hypothesis.timing and any(cause.timing for cause in before)
    return hypothesis not in before and not timed

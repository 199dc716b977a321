"""Forward selection of the causes that contradict a model: fit the strongest, test all again."""

from dataclasses import dataclass, replace

import numpy as np

from identification.equation_error.excitation import still
from identification.replay.extended import Extended
from identification.replay.optimum import fitted, nearest
from identification.results.along_log import acting, effects_along, efforts
from identification.results.alternatives import Sign, effects_of, linear
from identification.results.detection import Detection
from identification.results.model_error import Doubt, priors
from identification.results.refits import Point, compared
from identification.results.with_arm import BY_NAME, HYPOTHESES, NUMBERS
from identification.search.memory import as_tested
from identification.search.outcome import Fit, Outcome
from identification.search.polish import start_of_fit, torque_fit
from identification.search.problem import Problem, in_parts, rows_of_parts
from plant.simulation.followed_path import is_rounded


@dataclass(frozen=True, kw_only=True)
class StepwiseSettings:
    """Thresholds of the forward selection.

    The values were chosen by hand. They are held by ``tests/benchmarks/detection.py`` (the cause
    that comes first, by robot), ``second_reading.py causes`` (three laws) and ``healthy.py`` (0 of
    200 right logs accused).

    Parameters
    ----------
    causes : int
        Causes that are reported of one log, at most.
    explained : float
        Share of the sum of squares beyond rounding that a reported cause must explain.
    faint : float
        Share of the sum of squares below which a cause may be an error of integration: then all is
        tested again with `fine_steps`.
    fine_steps : int
        Steps per sample of that second test.
    following : float
        Factor of the threshold of a cause that is tested beside a reported one, because the
        innovations that remain are not all due to chance.
    fitted : float
        Share of the best first estimate from which on a cause is fitted.
    as_good : float
        Share of the best fit from which on a cause with fewer numbers is preferred.
    step : float
        Step of the central differences of an unknown, in its standard deviations.
    minor : float
        Share of its tolerance below which a cause widens the intervals and gives no warning (see
        ``docs/background/intervals.md``).
    apart : float
        Factor by which the values of each record alone must explain more than any single cause, so
        that the disagreement of the records is all that is reported.
    """

    causes: int = 3
    explained: float = 0.03
    faint: float = 0.02
    fine_steps: int = 16
    following: float = 2.0
    fitted: float = 0.2
    as_good: float = 0.9
    step: float = 0.05
    minor: float = 0.3
    apart: float = 2.0


SETTINGS = StepwiseSettings()


def detect(problem: Problem, fit: Fit, outcome: Outcome, delay: float = 0.0) -> Detection:
    """Test a fit to a problem.

    `fit`: start of the optimum of this outcome; the model is fitted again, to records held out as
    well, and to parts of long ones. `delay`: of the counts [samples], if another test suggests that
    one of this size is worth a trial. A failed test gives its reason, it does not raise.
    """
    try:
        search = _Search(problem, fit)
        # A delay from another test is taken for real: it needs no check at finer steps.
        coarse = not delay and problem.options.get("steps_per_sample", 4) < SETTINGS.fine_steps
        detection = search.detection(delay, coarse=coarse)
        if search.faint:
            # Begin at the optimum of the coarse steps, which is close.
            options = problem.options | {"steps_per_sample": SETTINGS.fine_steps}
            search = _Search(replace(problem, options=options), fit, search.at)
            detection = search.detection(delay)
        doubt = search.doubt()
        # The rounding of the counts is part of the innovations, and no error of the model.
        prior_rows = search.at.model.prior.count
        rounding = rows_of_parts(outcome.rounding, search.searched_records, prior_rows)
        added = doubt.added(problem.tolerances, rounding)
        detection = replace(
            detection,
            assumed=doubt.assumed(),
            doubt=added,
            friction=doubt.friction(problem.tolerances),
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        return Detection(reason=str(error))
    if fit.covariance is None or fit.resonance is not None:
        return detection
    # Outside of the guard: a variance between records that does not follow is an error.
    grouped, between = doubt.grouped(problem.unknown, fit.covariance, added)
    if between is None and outcome.grouped is not None:
        grouped = outcome.grouped
    return replace(detection, grouped=grouped, between=between)


def tested(point: Point, testable: set[str]) -> list[Sign]:
    """The signs of all hypotheses at a point, from the effects of the numbers of these names."""
    rounded = any(map(is_rounded, point.at.model.records))
    # A number whose effect diverges cannot be tested.
    effects = {
        name: row
        for name, row in point.effects.items()
        if name in testable and np.isfinite(row).all()
    }
    signs: list[Sign] = []
    for hypothesis in HYPOTHESES:
        if hypothesis.timing and rounded:
            continue
        # Lengths come last: f takes them over almost completely.
        if hypothesis.suspected and not any(2 * sign.chi_square > sign.threshold for sign in signs):
            continue
        signs += (hypothesis.test or linear)(hypothesis, point.at, effects)
    return signs


class _Search:
    """The optimum of the model with the causes reported so far.

    `point`: this optimum. `least`: sum of squares that a reported cause must explain [pulses^2].
    `faint`: whether the result may be an error of integration.
    """

    faint = False

    def __init__(self, problem, fit, start=None):
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
        self._initial = optimum

        # 3. Properties of the records that the tests need.
        self._keep = keep
        self._unknown = len(problem.unknown)
        self._tolerances = problem.tolerances
        # Innovations of records held out come last; they count for no interval.
        self._searched = model.runs()[len(problem.records) - 1].stop
        self.searched_records = records[: len(problem.records)]
        self._share = sum(len(piece) for pieces in parts for piece in pieces) / sum(
            map(len, records)
        )
        self._efforts = efforts(parts[0])
        self.joints = tuple(problem.dynamics.chain.joint_labels)
        # Friction holds these joints, so no number of theirs follows from the log.
        self._idle = tuple(f"[{i}]" for i in still(records))
        self._move_to(optimum, step, bounds)
        rounding = 0.0
        if not records[0].rig.encoder.smooth:
            variance = 1 / 12  # of a count, uniform within one pulse [pulses^2]
            rounding = variance * float((model.weights**2).sum())
        # The floor: rounding is no error of the model, so a share of the rest must be explained.
        self.least = SETTINGS.explained * max(0.0, optimum.squares - rounding)

    @property
    def at(self):
        """The present optimum."""
        return self.point.at

    def _move_to(self, optimum, step, bounds):
        """Go to an optimum, and take the effects of what the rig leaves out there."""
        along = {}
        for hypothesis in HYPOTHESES:
            if hypothesis.torques is not None:
                along |= hypothesis.torques(optimum)
        torques = acting(along)
        effects = effects_of(optimum, HYPOTHESES, self._efforts) | effects_along(optimum, torques)
        self.point = Point(at=optimum, step=step, bounds=bounds, effects=effects, torques=torques)
        self._testable = {name for name in effects if not name.endswith(self._idle)}

    def detection(self, delay, *, coarse=False):
        """Select the causes one after another.

        `coarse`: end where the first cause is `faint`: coarse steps might explain as little.
        """
        initial = tested(self.point, self._testable)
        signs = initial
        stated = self.at.model.stated()
        causes = []
        if delay:
            signs = [
                replace(sign, values={"delay": delay}, chi_square=np.inf)
                if sign.name == "delay"
                else sign
                for sign in signs
            ]
        while len(causes) < SETTINGS.causes:
            # 1. Signs above the threshold of this round.
            factor = SETTINGS.following if causes else 1.0
            significant = [
                sign
                for sign in signs
                if sign.chi_square > factor * sign.threshold and _may_follow(sign, causes)
            ]
            fittable = [sign for sign in significant if BY_NAME[sign.name].refit]
            largest = max((sign.explained for sign in fittable), default=0.0)

            # 2. Records that no one model has: fits would blame causes that no record has.
            apart = [
                sign
                for sign in significant
                if sign.name == "disagreement" and sign.explained > SETTINGS.apart * largest
            ]
            if apart and not causes:
                causes = [replace(sign, log_odds=self._odds(sign)) for sign in apart]
                break

            # 3. Of the fits, the one with the fewest numbers among those that are about as good.
            refits = self._refits(fittable, largest, factor)
            best = min(
                refits, key=lambda refit: (refit.sign.freedom, -refit.sign.explained), default=None
            )
            if best is None:
                chosen = [sign for sign in significant if not BY_NAME[sign.name].refit]
            else:
                chosen = [self._ranked(best, refits, significant)]
                best = best._replace(sign=chosen[0])
            self.faint = (
                coarse
                and bool(chosen)
                and all(sign.explained < SETTINGS.faint * self.at.squares for sign in chosen)
            )
            coarse = False
            if best is None or self.faint:
                causes += [replace(sign, log_odds=self._odds(sign)) for sign in chosen]
                break

            # 4. Adopt it, and test all again beside it.
            causes.append(self._adopted(best))
            signs = tested(self.point, self._testable)
        if (
            causes
            and causes[-1].name == "disagreement"
            and causes[-1].chi_square > causes[0].chi_square
        ):
            # The causes before explain only a little of the disagreement: it comes first.
            causes = [causes.pop(), *causes]
        estimates = [_with_values(sign, self.at) for sign in causes]
        return Detection(
            signs=tuple(initial),
            named=tuple(sign for sign in estimates if not self._tolerated(sign.values)),
            stated=stated,
            joints=self.joints,
        )

    def _refits(self, signs, largest, factor):
        """Fits of the causes with a promising first estimate, about as good as the best of them."""
        refits = []
        for sign in signs:
            # A delay that another test suggests has an infinite chi-square: it is always tried.
            if not (sign.explained > SETTINGS.fitted * largest or np.isinf(sign.chi_square)):
                continue
            hypothesis = BY_NAME[sign.name]
            refit = hypothesis.refit(hypothesis, self.point, sign)
            if (
                refit is not None
                and refit.sign.explained > self.least
                and refit.sign.chi_square > factor * refit.sign.threshold
            ):
                refits.append(refit)
            # The others are dropped at once, which frees their sensitivities.
            limit = SETTINGS.as_good * max((refit.sign.explained for refit in refits), default=0.0)
            refits = [refit for refit in refits if refit.sign.explained > limit]
        return refits

    def _odds(self, sign):
        """Log odds for the cause of a sign."""
        return BY_NAME[sign.name].log_odds(sign, self._efforts)

    def _ranked(self, best, refits, significant):
        """The sign of the best fit, with its rivals, its odds, and what comes next."""
        # The fit of a cause replaces its first estimate.
        signs = {sign.name: sign for sign in significant}
        signs |= {refit.sign.name: refit.sign for refit in refits}
        odds = {name: self._odds(sign) for name, sign in signs.items()}
        others = sorted(odds.keys() - {best.sign.name}, key=lambda name: -odds[name])
        return replace(
            best.sign,
            rivals=tuple(refit.sign.name for refit in refits if refit.sign.name != best.sign.name),
            log_odds=odds[best.sign.name],
            others=tuple((name, odds[name]) for name in others if odds[name] > 0),
        )

    def _adopted(self, best):
        """Make a fit the optimum of the search; its sign."""
        sign = best.sign
        # The trial fits used sensitivities of the previous optimum; this one takes its own.
        bounds = self.point.bounds
        optimum = fitted(best.at.model, best.at.values, best.step, bounds)
        adopted = compared(BY_NAME[sign.name], self.point, sign, optimum, best.step)
        self._move_to(optimum, best.step, bounds)
        return adopted.sign

    def _tolerated(self, values):
        """Whether all values are small against their tolerances, which the intervals count."""
        # The usual size of each is the standard deviation that `Tolerances` give it.
        usual = priors(self._tolerances, values, self._efforts)
        return bool(values) and all(
            abs(value) < SETTINGS.minor * usual.get(name, 0.0) for name, value in values.items()
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

"""Forward selection of the causes that contradict a model: fit the strongest, test all again.

A change of a length is taken over by f almost completely, and the rest is less than the error of a
torque along a smoothed motion. So each length needs a loop of its own, and lengths are tried only
where another effect contradicts the model.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from identification.equation_error.excitation import still
from identification.replay.extended import Extended
from identification.replay.optimum import Optimum, fitted, nearest
from identification.results.along_log import effects_along, efforts, torques_along
from identification.results.alternatives import Sign, delay_sign, effects_of, linear, sampled, signs
from identification.results.assumed import SHARE, longer
from identification.results.detection import UNFITTED, Detection
from identification.results.model_error import Doubt, priors
from identification.search.memory import as_tested
from identification.search.outcome import Fit, Outcome
from identification.search.polish import start_of_fit, torque_fit
from identification.search.problem import Problem, in_parts, rows_of_parts
from plant.compiler.background import shared_out
from plant.parts.fields import Floats


@dataclass(frozen=True, kw_only=True)
class CorrectionSettings:
    """Limits and iterations of the corrections.

    The values were chosen by hand. They are held by ``tests/benchmarks/silent_mistakes.py``: of a
    length of 0.45 for 0.35 m, an error of -20 to -24 % is reported in 10 of 10 logs (-22 % is
    right).

    Parameters
    ----------
    shortest, longest : float
        Relative errors of a length between which it is tried: a smaller one is rounding, and a
        larger one is beyond a linear estimate.
    steepness : float
        Decrease of the missing length per length that is put in, at least.
    missing : float
        Relative error of a length below which the iteration ends.
    trials : int
        Lengths that are put in, at most.
    delay : float
        Delay [samples] above which counts are not late, but something else is wrong.
    shifts : int
        Estimates of a delay, each beside the previous one.
    """

    shortest: float = 0.05
    longest: float = 0.5
    steepness: float = 0.5
    missing: float = 0.01
    trials: int = 3
    delay: float = 1.0
    shifts: int = 2


CORRECTIONS = CorrectionSettings()


def tested(at: Optimum, effects: dict[str, Floats]) -> list[Sign]:
    """All signs (of `effects_of`) at an optimum; a length's where another is half significant."""
    results = signs(at, effects)
    if any(2 * sign.chi_square > sign.threshold for sign in results):
        return [*results, *_lengths(at)]
    return results


def _lengths(at):
    """The sign of the one length that explains most."""
    # Lengths of the first link place the base: they do not act.
    names = [name for name in longer(at.model.dynamics) if not name.startswith("links[0]")]
    # Each needs its own model, so they run on all cores.
    rows = shared_out(lambda name: _effect(at, name), names, at.model.threads)
    effects = {name: row for name, row in zip(names, rows, strict=True) if np.isfinite(row).all()}
    plausible = [
        sign
        for name, row in effects.items()
        for sign in linear(at, "length", {name: row}, len(effects))
        if CORRECTIONS.shortest <= abs(*sign.values.values()) <= CORRECTIONS.longest
    ]
    # Lengths are nearly one thing for the log: at most one is reported.
    yield from sorted(plausible, key=lambda sign: -sign.chi_square)[:1]


def _effect(at, name):
    """Effect (M,) on the innovations of a length, relative."""
    # By a difference, as the model has no length as a number.
    longer_model = at.model.of(longer(at.model.dynamics)[name])
    return (longer_model.innovations(at.values) - at.innovations) / SHARE


def with_length(at: Optimum, sign: Sign, step: Floats, bounds: Floats) -> tuple[Sign, Optimum]:
    """The model of a chain with that length, fitted.

    `step`, `bounds`: as for `fitted`. A length does not act linearly, so the secant method finds
    where nothing of it is missing: the missing part is estimated beside each trial.
    """
    ((name, share),) = sign.values.items()
    previous = 0.0
    missing = share
    trials: list[tuple[Sign, Optimum]] = []
    optimum = at
    while len(trials) < CORRECTIONS.trials and abs(missing) > CORRECTIONS.missing:
        # A chain with the present estimate of the length.
        model = at.model.of(longer(at.model.dynamics, share)[name])
        optimum = fitted(model, optimum.values, step, bounds)
        trials.append((replace(sign, values={name: share}), optimum))
        still_missing = sum(
            estimate.values[name]
            for estimate in linear(optimum, "length", {name: _effect(optimum, name)})
        )
        # A flat secant would step far away: its slope is limited.
        slope = min((still_missing - missing) / (share - previous), -CORRECTIONS.steepness)
        previous = share
        missing = still_missing
        share = share - still_missing / slope
    # The secant can step away from the best one.
    return min(trials, key=lambda trial: trial[1].squares)


def without_delay(
    at: Optimum, sign: Sign, step: Floats, bounds: Floats
) -> tuple[Sign, Optimum] | None:
    """The model of counts that are in time, fitted; None where it does not follow them.

    `step`, `bounds`: as for `fitted`.
    """
    delay = 0.0
    optimum = at
    # Each estimate is beside the counts that are corrected so far.
    for _ in range(CORRECTIONS.shifts):
        delay += sign.values["delay"]
        if abs(delay) > CORRECTIONS.delay:
            return None
        try:
            optimum = fitted(at.model.late(-delay), optimum.values, step, bounds, at)
        except ValueError:  # the model diverges beside these counts
            return None
        sign = delay_sign(optimum) or sign
    return replace(sign, values={"delay": delay}), optimum


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
    fine_step : float
        Step of the central differences of a cause, relative to its first estimate.
    stiff, soft : float
        Resonances [Hz] between which the first estimate of a compliance is limited.
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
    fine_step: float = 0.03
    stiff: float = 400.0
    soft: float = 15.0
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
        period = max(record.rig.period for record in problem.records)
        detection = replace(
            detection,
            signs=tuple(sampled(sign, period) for sign in detection.signs),
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


class _Refit(NamedTuple):
    """A model with one more cause, fitted: its sign, optimum, and steps (k,) of the unknowns."""

    sign: Sign
    at: Optimum
    step: Floats


class _Search:
    """The optimum of the model with the causes reported so far.

    `at`: the optimum. `step`, `bounds`: of its values. `effects`: change of the innovations (M,)
    with each number that the rig leaves out. `torques`: those that act as a torque along the log.
    `least`: sum of squares that a reported cause must explain [pulses^2]. `faint`: whether the
    result may be an error of integration.
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
            prior=problem.prior,
            runs=[len(pieces) for pieces in parts],
            **problem.options,
        )
        # Numbers that the rig leaves out are zero and, with a step of 0, not varied yet.
        extra = np.zeros(len(model.extra))
        self.step = np.concatenate([SETTINGS.step * std[keep], model.gain_steps, extra])
        limits = np.column_stack([model.least, np.full(len(extra), np.inf)])
        self.bounds = np.vstack([problem.bounds[keep], model.gain_bounds, limits])

        # 2. Its optimum. Low observer gains may lose a record that was held out, so the gains of
        # the fit compete with the model's default.
        if start is None:  # otherwise at the optimum of coarse steps
            gains = [model.gains] if fit.gains is None else [fit.gains, model.gains]
            begin = nearest(model, [np.concatenate([values[keep], gain, extra]) for gain in gains])
        else:
            begin = start.values
        optimum = fitted(model, begin, self.step, self.bounds, start)
        # The weight of the prior depends on the variance of the innovations.
        if model.prior.settle(optimum.unit(optimum.innovations)):
            optimum = fitted(model, optimum.values, self.step, self.bounds)
        self.at = self._initial = optimum

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
        self._weigh()
        rounding = 0.0
        if not records[0].rig.encoder.smooth:
            variance = 1 / 12  # of a count, uniform within one pulse [pulses^2]
            rounding = variance * float((model.weights**2).sum())
        # The floor: rounding is no error of the model, so a share of the rest must be explained.
        self.least = SETTINGS.explained * max(0.0, self.at.squares - rounding)

    def _weigh(self):
        """Take the effects of what the rig leaves out at the present optimum."""
        self.torques = torques_along(self.at)
        self.effects = effects_of(self.at, self._efforts) | effects_along(self.at, self.torques)
        self._testable = {
            name: row for name, row in self.effects.items() if not name.endswith(self._idle)
        }

    def detection(self, delay, *, coarse=False):
        """Select the causes one after another.

        `coarse`: end where the first cause is `faint`: coarse steps might explain as little.
        """
        initial = tested(self.at, self._testable)
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
            fittable = [sign for sign in significant if sign.name not in UNFITTED]
            largest = max((sign.explained for sign in fittable), default=0.0)

            # 2. Records that no one model has: fits would blame causes that no record has.
            apart = [
                sign
                for sign in significant
                if sign.name == "disagreement" and sign.explained > SETTINGS.apart * largest
            ]
            if apart and not causes:
                causes = apart
                break

            # 3. Of the fits, the one with the fewest numbers among those that are about as good.
            refits = self._refits(fittable, largest, factor)
            best = min(
                refits, key=lambda refit: (refit.sign.freedom, -refit.sign.explained), default=None
            )
            if best is None:
                chosen = [sign for sign in significant if sign.name in UNFITTED]
            else:
                chosen = [best.sign]
            self.faint = (
                coarse
                and bool(chosen)
                and all(sign.explained < SETTINGS.faint * self.at.squares for sign in chosen)
            )
            coarse = False
            if best is None or self.faint:
                causes += chosen
                break

            # 4. Adopt it, and test all again beside it.
            causes.append(self._adopted(best, refits))
            signs = tested(self.at, self._testable)
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
            refit = self._refitted(sign)
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

    def _adopted(self, best, refits):
        """Make a fit the optimum of the search; its sign, with its rivals."""
        rivals = tuple(refit.sign.name for refit in refits if refit.sign.name != best.sign.name)
        sign = replace(best.sign, rivals=rivals)
        # The trial fits used sensitivities of the previous optimum; this one takes its own.
        optimum = fitted(best.at.model, best.at.values, best.step, self.bounds)
        adopted = self._compared(sign, optimum, best.step)
        self.at = adopted.at
        self.step = adopted.step
        self._weigh()
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
            step=self.step,
            keep=self._keep,
            unknown=self._unknown,
            searched=self._searched,
            effects=self.effects,
            efforts=self._efforts,
            share=self._share,
        )

    def _refitted(self, sign):
        """The model with a cause, fitted from its first estimate; None where it loses the log."""
        if sign.name == "delay":
            corrected = without_delay(self.at, sign, self.step, self.bounds)
            return None if corrected is None else self._compared(*corrected, self.step)
        if sign.name == "length" or sign.values.keys() <= self.torques.keys():
            return self._pushed(sign)
        if sign.name == "compliance":
            # All gears give at once, each at least a little; failing that, those of the estimate.
            gears = [name for name in self.at.model.extra if name.startswith("compliance")]
            return self._moved(sign, gears) or self._moved(sign, list(sign.values))
        return self._moved(sign, list(sign.values))

    def _moved(self, sign, names):
        """The model with these numbers at the estimates of a sign, fitted; None if it diverges."""
        model = self.at.model
        moves = np.zeros(len(self.at.values))
        step = self.step.copy()
        for name in names:
            i = model.place(name)
            moves[i] = sign.values.get(name, 0.0)
            if sign.name == "compliance":
                # Gears without an estimate begin at the stiff end.
                moves[i] = np.clip(moves[i], SETTINGS.stiff**-2, SETTINGS.soft**-2)
            # Backlash has no derivative: its width stays at the trial.
            step[i] = 0.0 if sign.name == "backlash" else SETTINGS.fine_step * abs(moves[i])
        try:
            refit = self._from(sign, moves, step)
        except ValueError:  # it diverges: rigid gears have made the inertias too small
            return None
        if (
            sign.name in ("compliance", "backlash")
            or refit.sign.explained > SETTINGS.as_good * sign.explained
        ):
            return refit
        # The fit explains less than its linear estimate promises, as where joints stick and the
        # estimate is far too large: begin on the way to it.
        change = np.sum([value * self.effects[name] for name, value in sign.values.items()], axis=0)
        nearer = self._from(sign, self.at.towards(moves, change, self.bounds), step)
        return max(refit, nearer, key=lambda refit: refit.sign.explained)

    def _from(self, sign, moves, step):
        """The model with a cause, fitted from the present values moved by so much (k,)."""
        # Sensitivities of the present optimum can be reused if its varied unknowns come first.
        varied = np.flatnonzero(self.step)
        reusable = np.array_equal(np.flatnonzero(step)[: len(varied)], varied)
        start = self.at if reusable else None
        optimum = fitted(self.at.model, self.at.values + moves, step, self.bounds, start)
        return self._compared(sign, optimum, step)

    def _pushed(self, sign):
        """The model beside the torques of a sign, or of a chain with its length."""
        try:
            if sign.name == "length":
                corrected = with_length(self.at, sign, self.step, self.bounds)
                return self._compared(*corrected, self.step)
            # The torques of a sign add up, record by record.
            scaled = [
                [value * torque for torque in self.torques[name]]
                for name, value in sign.values.items()
            ]
            pushed = self.at.model.pushed([sum(terms) for terms in zip(*scaled, strict=True)])
            optimum = fitted(pushed, self.at.values, self.step, self.bounds, self.at)
            return self._compared(sign, optimum, self.step)
        except ValueError:  # the model diverges beside it
            return None

    def _compared(self, sign, at, step):
        """A fit with the sum of squares that it explains, against the present optimum."""
        explained = self.at.squares - at.squares
        # A gear with backlash moves in and out of contact: the fit may end beside its own trial.
        if sign.name == "backlash":
            explained = max(explained, sign.explained)
        chi_square = explained / at.unit(at.innovations)
        sign = replace(sign, explained=explained, chi_square=chi_square)
        return _Refit(sign, at, step)


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
    # A cause is reported once, except backlash, which gear after gear can have.
    names = {cause.name for cause in causes}
    if "backlash" in names:
        return sign.name == "backlash"
    timing = {"lag", "delay"}
    return sign.name not in names and not (sign.name in timing and names & timing)

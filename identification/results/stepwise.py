"""What contradicts a model, one thing after another: what explains most is fitted, the rest
tested again beside it.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from identification.equation_error.excitation import still
from identification.replay.extended import Extended
from identification.replay.optimum import Optimum, fitted, nearest
from identification.results.along_log import effects_along, efforts, torques_along
from identification.results.alternatives import Sign, effects_of, sampled
from identification.results.corrections import tested, with_length, without_delay
from identification.results.detection import UNFITTED, Detection
from identification.results.model_error import Doubt, priors
from identification.search.memory import as_tested
from identification.search.outcome import Fit, Outcome
from identification.search.polish import start_of_fit, torque_fit
from identification.search.problem import Problem, in_parts, rows_of_parts
from plant.parts.fields import Floats

_NAMED = 3  # alternatives that are named, at most
_EXPLAINED = 0.03  # share of what rounding does not explain that a named alternative must
# Share of the sum of squares below which all is tested once more, in place of what is named; steps
# per sample then.
_FAINT = 0.02
_FINER = 16
_ROUNDING = 1 / 12  # variance of the rounding of counts [pulses^2]
# by how much the threshold of what is named beside others is higher: what they leave is not all by
# chance
_AGAIN = 2.0
# Share of the best first estimate from which on an alternative is fitted, too; and of the best fit,
# from which on it is preferred if it needs fewer numbers.
_WORTH = 0.2
_AS_GOOD = 0.9
# steps of the central differences, in standard deviations, and relative, of what is named
_STEP = 0.05
_FINE = 0.03
# compliances between which a first estimate is taken [1/Hz^2]
_LEAST = 400.0**-2
_MOST = 15.0**-2
_MINOR = 0.3  # of what a rig tolerates, which intervals count: less of it contradicts nothing
# by how much more the values of each record alone explain than anything else, where only that is
# told
_APART = 2.0


def detect(problem: Problem, fit: Fit, outcome: Outcome, delay: float = 0.0) -> Detection:
    """Test a fit to a problem.

    `fit`: of this outcome, where to begin; the model is fitted anew, to those held out, too, and to
    parts of long ones. `delay`: of the counts, if it is known already that one of this size
    [samples] is worth a trial. A variance between records that does not follow is an error.
    """
    try:
        search = _Search(problem, fit)
        coarse = not delay and problem.options.get("steps_per_sample", 4) < _FINER
        detection = search.detection(delay, coarse=coarse)
        if search.faint:  # may be the model's own steps
            fine = dataclasses.replace(
                problem, options=problem.options | {"steps_per_sample": _FINER}
            )
            search = _Search(fine, fit, search.at)
            detection = search.detection(delay)
        doubt = search.doubt()
        rounding = rows_of_parts(outcome.rounding, search.of_search, search.at.model.prior.count)
        added = doubt.added(problem.tolerances, rounding)
        period = max(record.rig.period for record in problem.records)
        detection = dataclasses.replace(
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
    grouped, between = doubt.grouped(problem.unknown, fit.covariance, added)
    grouped = outcome.grouped if between is None and outcome.grouped is not None else grouped
    return dataclasses.replace(detection, grouped=grouped, between=between)


class _Refit(NamedTuple):
    """A model with one alternative more, fitted; the sign, with what it explains then; steps of
    the unknowns.
    """

    sign: Sign
    at: Optimum
    step: Floats


class _Search:
    """The model where it follows the log best, and what has been named so far."""

    faint = False

    def __init__(self, problem: Problem, fit: Fit, near: Optimum | None = None) -> None:
        records, keep = as_tested(problem, fit)
        self._unknown = len(problem.unknown)
        self._keep = keep
        self._tolerances = problem.tolerances
        if fit.covariance is not None:
            values = fit.values
            step = fit.std
        else:
            values, step = start_of_fit(problem, torque_fit(problem))
        given = dict(zip(problem.unknown, values, strict=True))
        f = np.array([given[name] for name in problem.dynamics.names])
        parts = [in_parts(record) for record in records]
        pieces = [part for own in parts for part in own]
        model = Extended(
            problem.dynamics,
            pieces,
            [problem.unknown[i] for i in keep],
            f,
            prior=problem.prior,
            runs=[len(own) for own in parts],
            **problem.options,
        )
        extra = np.zeros(len(model.extra))
        self.step = np.concatenate([_STEP * step[keep], model.gain_steps, extra])
        limits = np.column_stack([model.least, np.full(len(extra), np.inf)])
        self.bounds = np.vstack([problem.bounds[keep], model.gain_bounds, limits])
        # low ones may lose a record held out
        own = [model.gains] if fit.gains is None else [fit.gains, model.gains]
        begin = nearest(model, [np.concatenate([values[keep], gains, extra]) for gains in own])
        begin = begin if near is None else near.values
        first = fitted(model, begin, self.step, self.bounds, near)
        if model.prior.settle(first.unit(first.innovations)):
            first = fitted(model, first.values, self.step, self.bounds)
        self.at = self._first = first
        self._searched = model.runs()[len(problem.records) - 1].stop
        self.of_search, self._share = (
            records[: len(problem.records)],
            sum(map(len, pieces)) / sum(map(len, records)),
        )
        self._efforts, self.joints = efforts(parts[0]), tuple(problem.dynamics.chain.joint_labels)
        # friction holds them, as no number of theirs follows
        self._idle = tuple(f"[{i}]" for i in still(records))
        self._weigh()
        rounding = (
            0.0 if records[0].rig.encoder.smooth else _ROUNDING * float((model.weights**2).sum())
        )
        self.least = _EXPLAINED * max(0.0, self.at.squares - rounding)

    def _weigh(self) -> None:
        """What the innovations change by with what the model may lack, from where it is."""
        self.torques = torques_along(self.at)
        self.effects = effects_of(self.at, self._efforts) | effects_along(self.at, self.torques)
        self._told = {
            name: row for name, row in self.effects.items() if not name.endswith(self._idle)
        }

    def detection(self, delay: float, *, coarse: bool = False) -> Detection:
        """What contradicts the model; ends where what is first is `faint`: coarse steps might
        explain as little.
        """
        first = found = tested(self.at, self._told)
        stated = self.at.model.stated()
        named = list[Sign]()
        if delay:
            known = {"delay": delay}  # by another test
            found = [
                dataclasses.replace(s, values=known, chi_square=np.inf) if s.name == "delay" else s
                for s in found
            ]
        while len(named) < _NAMED:
            again = _AGAIN if named else 1.0
            those = [
                sign
                for sign in found
                if sign.chi_square > again * sign.threshold and _may_follow(sign, named)
            ]
            some = [sign for sign in those if sign.name not in UNFITTED]
            most = max((sign.explained for sign in some), default=0.0)
            apart = [
                sign
                for sign in those
                if sign.name == "disagreement" and sign.explained > _APART * most
            ]
            # of what no one model has, causes would be fitted that nothing has
            if apart and not named:
                named = apart
                break
            worth = [
                sign for sign in some if sign.explained > _WORTH * most or np.isinf(sign.chi_square)
            ]
            good = list[_Refit]()
            for sign in worth:
                good += self._significant(sign, again)
                best = _AS_GOOD * max((each.sign.explained for each in good), default=0.0)
                # the others are let go
                good = [each for each in good if each.sign.explained > best]
            refit = min(
                good, key=lambda each: (each.sign.freedom, -each.sign.explained), default=None
            )
            told = (
                [sign for sign in those if sign.name in UNFITTED] if refit is None else [refit.sign]
            )
            self.faint = (
                coarse
                and bool(told)
                and all(sign.explained < _FAINT * self.at.squares for sign in told)
            )
            coarse = False
            if refit is None or self.faint:
                named += told
                break
            own_rates = fitted(refit.at.model, refit.at.values, refit.step, self.bounds)
            rivals = tuple(each.sign.name for each in good if each.sign.name != refit.sign.name)
            refit = self._compared(
                dataclasses.replace(refit.sign, rivals=rivals), own_rates, refit.step
            )
            self.at = refit.at
            self.step = refit.step
            self._weigh()
            named.append(refit.sign)
            found = tested(self.at, self._told)
        if (
            named
            and named[-1].name == "disagreement"
            and named[-1].chi_square > named[0].chi_square
        ):
            named = [named.pop(), *named]  # what else explains a little of it comes after
        values = tuple(_with_values(sign, self.at) for sign in named)
        values = tuple(sign for sign in values if not self._tolerated(sign.values))
        return Detection(signs=tuple(first), named=values, stated=stated, joints=self.joints)

    def _tolerated(self, values: dict[str, float]) -> bool:
        usual = priors(self._tolerances, values, self._efforts)
        return bool(values) and all(
            abs(value) < _MINOR * usual.get(name, 0.0) for name, value in values.items()
        )

    def doubt(self) -> Doubt:
        """What is to be doubted of the values."""
        return Doubt(
            at=self.at,
            first=self._first,
            step=self.step,
            keep=self._keep,
            unknown=self._unknown,
            searched=self._searched,
            effects=self.effects,
            efforts=self._efforts,
            share=self._share,
        )

    def _significant(self, sign: Sign, again: float) -> list[_Refit]:
        """The model with an alternative, fitted, if that explains enough."""
        refit = self._refitted(sign)
        if refit is None or refit.sign.explained <= self.least:
            return []
        return [refit] if refit.sign.chi_square > again * refit.sign.threshold else []

    def _refitted(self, sign: Sign) -> _Refit | None:
        """The model with an alternative, fitted from its first estimate; None where it does not
        follow the log.
        """
        if sign.name == "delay":
            late = without_delay(self.at, sign, self.step, self.bounds)
            return None if late is None else self._compared(*late, self.step)
        if sign.name == "length" or sign.values.keys() <= self.torques.keys():
            return self._pushed(sign)
        model = self.at.model
        some = list(sign.values)
        every = [
            name
            for name in model.extra
            if sign.name == "compliance" and name.startswith("compliance")
        ]
        for names in (every, some) if every else (some,):
            moves = np.zeros(len(self.at.values))
            step = self.step.copy()
            for name in names:
                place = model.place(name)
                value = sign.values.get(name, 0.0)
                moves[place] = np.clip(value, _LEAST, _MOST) if every else value
                step[place] = 0.0 if sign.name == "backlash" else _FINE * abs(moves[place])
            try:
                refit = self._from(sign, moves, step)
            except ValueError:  # it diverges: inertias that rigid gears have made too small
                continue
            if every or sign.name == "backlash" or refit.sign.explained > _AS_GOOD * sign.explained:
                return refit
            change = np.sum(
                [value * self.effects[name] for name, value in sign.values.items()], axis=0
            )
            other = self._from(sign, self.at.towards(moves, change, self.bounds), step)
            return max(refit, other, key=lambda each: each.sign.explained)
        return None

    def _from(self, sign: Sign, moves: Floats, step: Floats) -> _Refit:
        """The model with an alternative, fitted from where it is, moved by so much (k,)."""
        near = self.at if self._begins(step) else None
        return self._compared(
            sign, fitted(self.at.model, self.at.values + moves, step, self.bounds, near), step
        )

    def _begins(self, step: Floats) -> bool:
        """Whether what is varied now is the first of what steps (k,) vary."""
        now = np.flatnonzero(self.step)
        then = np.flatnonzero(step)
        return np.array_equal(then[: len(now)], now)

    def _pushed(self, sign: Sign) -> _Refit | None:
        """The model beside the torques of a sign, or of a chain of its length."""
        try:
            if sign.name == "length":
                return self._compared(
                    *with_length(self.at, sign, self.step, self.bounds), self.step
                )
            own = [
                [value * torque for torque in self.torques[name]]
                for name, value in sign.values.items()
            ]
            pushed = self.at.model.pushed([sum(of_record) for of_record in zip(*own, strict=True)])
            return self._compared(
                sign, fitted(pushed, self.at.values, self.step, self.bounds, self.at), self.step
            )
        except ValueError:
            return None

    def _compared(self, sign: Sign, at: Optimum, step: Floats) -> _Refit:
        explained = self.at.squares - at.squares
        # it moves in and out of contact: the fit may end beside what was tried
        if sign.name == "backlash":
            explained = max(explained, sign.explained)
        chi_square = explained / at.unit(at.innovations)
        return _Refit(
            dataclasses.replace(sign, explained=explained, chi_square=chi_square), at, step
        )


def _with_values(sign: Sign, at: Optimum) -> Sign:
    """A sign with the values of a fit."""
    model = at.model
    extra = at.model.extra
    values = {
        name: float(at.values[model.place(name)]) if name in extra else x
        for name, x in sign.values.items()
    }
    return dataclasses.replace(sign, values=values)


def _may_follow(sign: Sign, named: list[Sign]) -> bool:
    """Backlash goes with the compliance that its gear has; late counts and lagging currents are
    nearly one thing.
    """
    names = {each.name for each in named}
    if "backlash" in names:
        return sign.name == "backlash"
    return sign.name not in names and not (
        sign.name in ("lag", "delay") and names & {"lag", "delay"}
    )

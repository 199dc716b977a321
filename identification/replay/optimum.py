"""Least-squares optimum of an extended model, and the residual orthogonal to its parameters.

The innovations do not depend linearly on compliance and backlash: several values of each are
simulated, and the parts of the residuals that are orthogonal to the parameters are compared.
"""

import functools
import weakref
from collections.abc import Sequence

import numpy as np

from identification.equation_error import IDENTIFIABLE, along, directions
from identification.replay.extended import Extended
from identification.replay.gauss_newton import (
    Descent,
    GaussNewtonSettings,
    descend,
    slopes,
    variance_inflation,
    within_bounds,
)
from plant.parts import Floats, dot, frozen, frozen_settings, norm, product

# The start is near the optimum: the full step is tried alone, then all shorter ones together.
_SETTINGS = GaussNewtonSettings(rounds=6, tolerance=1e-4, batches=(1, 7), longest=True)

_LENGTHS = 0.5 ** np.arange(8)  # of a step towards an estimate


@frozen
class Optimum:
    """Least sum of squared innovations of an extended model.

    `values` (k,). `step` (k,): of their central differences, 0 for an unknown that is not varied.
    `innovations` (M,): weighted. `rates` (v, M): their changes per step of the varied unknowns.
    `basis` (r, v): combinations of these changes that are orthonormal, without unknowns that would
    leave their bounds. `unknown`: number of varied unknowns that are neither observer gains nor
    extra numbers; they come first.
    """

    model: Extended
    values: Floats
    step: Floats
    innovations: Floats
    rates: Floats
    basis: Floats
    unknown: int

    @property
    def squares(self) -> float:
        """Sum of the squared innovations [pulses^2]."""
        return float((self.innovations**2).sum())

    @functools.cached_property
    def before(self) -> Floats:
        """The part of the innovations that is orthogonal to the varied unknowns."""
        return self.left(self.innovations)

    def left(self, directions: Floats) -> Floats:
        """The part of directions (M,) or (t, M) that is orthogonal to the varied unknowns."""
        # Several directions at once: the rates, the largest array of a test, are read once for all.
        onto_rates = product(self.rates, directions.T)
        coefficients = product(self.basis.T, product(self.basis, onto_rates))
        return np.asarray(directions - product(coefficients.T, self.rates))

    def towards(self, moves: Floats, change: Floats, bounds: Floats) -> Floats:
        """Of shorter and shorter steps (k,) to an estimate, the one that follows the log best.

        The varied unknowns adapt to the estimate.

        `moves` (k,): the full step. It changes the innovations by `change` (M,) if it is small;
        where joints stick, it may be far too large.
        """
        # The varied unknowns take back the part of the change that they can make as well.
        moves = moves.copy()
        varied = np.flatnonzero(self.step)
        moves[varied] -= self.step[varied] * along(self.basis, self.rates, change)
        # Shorter and shorter ways: at the best of them another linearisation can begin.
        vectors = np.clip(self.values + _LENGTHS[:, None] * moves, *bounds.T)
        return nearest(self.model, vectors) - self.values

    def unit(self, residual: Floats) -> float:
        """Variance of a residual (M,) plus known rounding, inflated by their autocorrelation."""
        # Another arm's encoder may round elsewhere: a test must not gain from the known rounding.
        residual = residual + self.model.rounding
        return float((residual**2).sum()) / self._readings * variance_inflation(residual)

    @functools.cached_property
    def _readings(self) -> float:
        """Number of independent readings."""
        return float((self.model.weights**2).sum())

    def evidence_unit(self, residual: Floats) -> float:
        """Unit of the evidence of a cause: `unit`, and more for errors that repeat along a motion.

        What is not rounding counts as `TRIALS.independent` independent errors, however many samples
        a log has. What a torque may be between its samples counts as only `TRIALS.chatter` errors:
        a loop that chatters repeats them.
        """
        repeated = self.beyond_rounding(residual) / TRIALS.independent
        return self.unit(residual) + repeated + self.model.between / TRIALS.chatter

    def beyond_rounding(self, residual: Floats) -> float:
        """Sum of the squares of a residual (M,) that is not rounding [pulses^2]."""
        residual = residual + self.model.rounding
        rounding = 0.0
        if not self.model.records[0].rig.encoder.smooth:
            variance = 1 / 12  # of a count, uniform within one pulse [pulses^2]
            rounding = variance * self._readings
        return max(0.0, float((residual**2).sum()) - rounding)

    @property
    def clean(self) -> bool:
        """Whether the innovations are as small as chance makes those of a right model."""
        # The square of a number that is uniform within one pulse has a variance of 1 / 180.
        deviation = np.sqrt((self.model.weights**4).sum() / 180)
        return self.beyond_rounding(self.innovations) < TRIALS.deviations * deviation

    def chi_square(self, residual: Floats) -> float:
        """Decrease of the sum of squares from here to another residual (M,), in its unit."""
        decrease = float((self.before**2).sum() - (residual**2).sum())
        return decrease / self.evidence_unit(residual)


def nearest(model: Extended, vectors: Sequence[Floats] | Floats) -> Floats:
    """Of several vectors of values (k,), the one that follows the log best."""
    squares = [(innovations**2).sum() for innovations in model.all_innovations(vectors)]
    # Not argmin, which takes NaN, the sum of a vector that diverges, for the least.
    return np.asarray(vectors[int(np.argsort(squares, kind="stable")[0])])


class _Solver:
    """Least squares along slopes, as `descend` asks for; dependent unknowns do not move."""

    def __init__(self, dependent):
        self.dependent = dependent
        self.basis = np.empty((0, 0))
        self._slopes = None

    def of(self, slopes):
        """The directions (r, v) of slopes (M, v), made once for each: that takes time."""
        if self._slopes is None or self._slopes() is not slopes:
            self.basis = directions(slopes.T, self.dependent)
            # A weak reference: the slopes must go before the next ones are made.
            self._slopes = weakref.ref(slopes)
        return self.basis

    def __call__(self, slopes, innovations, moving):
        # With a value on its bound the directions are those of the others alone.
        if moving.all():
            return along(self.of(slopes), slopes.T, innovations)
        rates = slopes.T[moving]
        return along(directions(rates, self.dependent), rates, innovations)


def fitted(
    model: Extended, values: Floats, step: Floats, bounds: Floats, near: Optimum | None = None
) -> Optimum:
    """Gauss-Newton from values (k,), with steps (k,) of the central differences.

    A step of zero leaves an unknown as it is.

    `near`: another optimum, whose varied unknowns are the first of these. Its rates are used
    unchanged; those of the other unknowns are computed once.
    """
    step = step.copy()
    values = np.clip(values, *bounds.T)
    varied = np.flatnonzero(step)
    innovations = model.innovations(values)
    # The unknowns end with the observer gains and the extra numbers.
    unknown = int((varied < len(values) - len(model.extra) - len(model.gains)).sum())
    if not np.isfinite(innovations).all():
        raise ValueError(
            "the extended model must follow the log; it diverges. Test the effects one by one."
        )
    solver = _Solver(model.prior.own(IDENTIFIABLE.optimum))
    point = Descent(values, innovations, np.empty((0, 0)))
    # Rates of the neighbour are in its steps, which may have been shortened.
    if near is not None:
        count = len(near.rates)
        step[varied[:count]] = near.step[varied[:count]]
        additional = slopes(model, values, step, varied[count:], bounds=bounds)
        # Slopes of unknowns that both have are not simulated again: they are the costly part of a
        # fit.
        point.slopes = np.vstack([near.rates, additional.T]).T
    descend(
        model,
        point,
        step,
        bounds,
        solver,
        _SETTINGS,
        # Optima are compared by their rates: one step of an unknown means the same at each.
        shorten_jumps=False,
        fixed_slopes=near is not None,
    )

    # An unknown on its bound that would step outwards is held: the basis leaves it out.
    rates = point.slopes.T
    # An unknown on its bound that would step inwards is free.
    basis = solver.of(point.slopes)
    change = within_bounds(
        lambda moving: solver(point.slopes, point.innovations, moving), point.values, step, bounds
    )
    inside = ((bounds[:, 0] < point.values) & (point.values < bounds[:, 1]))[varied]
    free = inside | (change[varied] != 0)
    if not free.all():
        within = directions(rates[free], solver.dependent)
        basis = np.zeros((len(within), len(rates)))
        basis[:, free] = within
    return Optimum(
        model=model,
        values=point.values,
        step=step,
        innovations=point.innovations,
        rates=rates,
        basis=basis,
        unknown=unknown,
    )


@frozen_settings
class TrialSettings:
    """Values of compliance and backlash that are tried, and their evidence; chosen by hand.

    Parameters
    ----------
    resonances : (float, float)
        Lowest and highest locked-rotor resonance [Hz].
    ratio : float
        Ratio of neighbouring resonances, under a law that follows the counts.
    fine_ratio : float
        The same where torques are repeated: there the effect of a resonance is narrow.
    widths : tuple of int
        Widths of backlash [pulses].
    contact : float
        Resonance of a gear with backlash that is rigid otherwise [Hz].
    at_once : int
        Trials that are simulated together.
    independent : float
        Independent errors that a model has along a log, at most.
    chatter : float
        Independent errors that a torque between its samples makes, at most. It was chosen on about
        twenty logs of right models. There a cause explained up to 0.67 of the squares of such an
        error: a chi-square of 20, where the threshold is 36 or more.
    deviations : float
        Innovations are rounding alone if their sum of squares exceeds that of rounding by less than
        this number of its standard deviations.
    """

    resonances: tuple[float, float] = (15.0, 250.0)
    ratio: float = 1.25
    fine_ratio: float = 1.1
    widths: tuple[int, ...] = (1, 2, 4, 8, 16)
    contact: float = 300.0
    at_once: int = 16
    independent: float = 3000.0
    chatter: float = 30.0
    deviations: float = 4.0


TRIALS = TrialSettings()


@frozen
class Trial:
    """Some numbers that the rig leaves out, and their effect on the innovations.

    `values`: in the units of `Extended`. `chi_square`: decrease of the sum of squared innovations,
    in evidence units; negative where the sum grows. `explained`: this decrease [pulses^2].
    `effect`: sum of squares of the change of the innovations, in evidence units of the optimum: the
    chi-square of a log whose rig has these numbers.
    """

    values: dict[str, float]
    chi_square: float
    explained: float
    effect: float


def compliance(at: Optimum, suspicious: float) -> list[Trial]:
    """Trials of all joints alike, and of each alone.

    Every second resonance first; those between them if a trial has a chi-square of `suspicious`.
    """
    replayed = any(record.law is not None and record.law.replays for record in at.model.records)
    lowest, highest = TRIALS.resonances
    # A resonance shows in a narrower range of frequencies where no loop corrects the motion.
    ratio = TRIALS.fine_ratio if replayed else TRIALS.ratio
    # Neighbouring resonances differ by about this ratio.
    count = int(np.log(highest / lowest) / np.log(ratio)) + 1
    n = len(at.model.gains) // 2
    groups = [[i] for i in range(n)]
    if n > 1:
        # All gears alike first: weak evidence of single gears adds up where all of them give.
        groups.insert(0, list(range(n)))
    # The stiffest first.
    frequencies = np.geomspace(highest, lowest, count).tolist()
    trials: list[Trial] = []
    for spaced in (frequencies[::2], frequencies[1::2]):
        trials += _tried(
            at, [{f"compliance[{i}]": hz**-2 for i in group} for group in groups for hz in spaced]
        )
        # A resonance has an effect at its neighbours, too: a peak between two trials shows at both.
        if not any(trial.chi_square > suspicious for trial in trials):
            break
    return trials


def backlash(at: Optimum) -> list[Trial]:
    """Trials of several widths, joint by joint, where no backlash is in the model yet."""
    n = len(at.model.gains) // 2
    pulse = np.abs(np.diag(at.model.records[0].rig.to_angle(np.eye(n))))
    tried = []
    for i in range(n):
        # Teeth touch through a spring: without one the contact would have no stiffness.
        softness = max(TRIALS.contact**-2, at.values[at.model.place(f"compliance[{i}]")])
        if not at.values[at.model.place(f"backlash[{i}]")]:
            tried += [
                {f"backlash[{i}]": width * pulse[i], f"compliance[{i}]": softness}
                for width in TRIALS.widths
            ]
    return _tried(at, tried)


def _tried(at, tried):
    """The trials that follow the log."""
    vectors = []
    for values in tried:
        vector = at.values.copy()
        for name, value in values.items():
            vector[at.model.place(name)] = value
        vectors.append(vector)
    initial = at.before
    squares = dot(initial, initial)
    unit = at.evidence_unit(initial)
    trials = []
    # In blocks: the innovations of all trials of a long log would not fit into memory.
    for begin in range(0, len(vectors), TRIALS.at_once):
        rows = at.model.all_innovations(vectors[begin : begin + TRIALS.at_once])
        # The rows end with the block, the trials go on.
        followed = [
            (values, innovations)
            for values, innovations in zip(tried[begin:], rows, strict=False)
            if np.isfinite(innovations).all()
        ]
        if not followed:
            continue
        # The varied unknowns are fitted to the trials linearly: no Gauss-Newton for each.
        lefts = at.left(np.array([innovations for _, innovations in followed]))
        for (values, _), remaining in zip(followed, lefts, strict=True):
            explained = squares - dot(remaining, remaining)
            # A trial that explains nothing is no candidate: its own unit, which is slow to compute,
            # decides nothing.
            own_unit = at.evidence_unit(remaining) if explained > 0 else unit
            trials.append(
                Trial(
                    values=values,
                    chi_square=explained / own_unit,
                    explained=explained,
                    effect=norm(remaining - initial) ** 2 / unit,
                )
            )
    return trials

"""Where a model with what its rig leaves out follows a log best, and what its unknowns cannot do
there.

Compliance and backlash do not act linearly there: some of each are tried, and what they leave is
compared.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from identification.replay.extended import Extended
from identification.replay.gauss_newton import slopes, variance_inflation, within_bounds
from plant.parts.fields import Floats
from plant.parts.sums import dot, product, products

# of Gauss-Newton, at most, and the relative decrease below which it ends
_ROUNDS = 6
_SETTLED = 1e-4

_LENGTHS = 0.5 ** np.arange(8)  # of a step

# a direction of which less than this share is its own is taken for a combination of others
_OWN = 1e-3


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Where the sum of squared innovations is least.

    `values` (k,), `step` (k,) of their differences. `innovations` (M,): weighted. `rates` (v, M):
    their changes per step of the varied unknowns. `made` (r, v): what orthonormal directions are of
    these changes, without those of what would leave its bounds. `unknown`: how many of the varied
    unknowns, the first, are not observer gains.
    """

    model: Extended
    values: Floats
    step: Floats
    innovations: Floats
    rates: Floats
    made: Floats
    unknown: int

    @property
    def squares(self) -> float:
        """Sum of the squared innovations [pulses^2]."""
        return float((self.innovations**2).sum())

    @functools.cached_property
    def before(self) -> Floats:
        """What of the innovations the varied unknowns cannot do."""
        return self.left(self.innovations)

    def left(self, direction: Floats) -> Floats:
        """What of a direction (M,) the varied unknowns cannot do as well."""
        return np.asarray(
            direction - np.einsum("v,vm->m", along(self.made, self.rates, direction), self.rates)
        )

    def towards(self, moves: Floats, change: Floats, bounds: Floats) -> Floats:
        """By how much (k,) to move where the log is followed best on the way to an estimate, the
        varied unknowns too.

        `moves` (k,) make this change (M,) where they are small; where joints stick, an estimate may
        be far too large.
        """
        moves = moves.copy()
        varied = np.flatnonzero(self.step)
        moves[varied] -= self.step[varied] * along(self.made, self.rates, change)
        return (
            nearest(self.model, np.clip(self.values + _LENGTHS[:, None] * moves, *bounds.T))
            - self.values
        )

    def unit(self, left: Floats) -> float:
        """Variance of what is left, inflated by its autocorrelation."""
        return float((left**2).sum() / (self.model.weights**2).sum() * variance_inflation(left))

    def chi_square(self, after: Floats) -> float:
        """Decrease of the sum of squares from here to what is left afterwards (M,), in its unit."""
        return float(((self.before**2).sum() - (after**2).sum()) / self.unit(after))


def nearest(model: Extended, some: Sequence[Floats] | Floats) -> Floats:
    """Of some values (k,), those that follow the log best."""
    return np.asarray(
        some[int(np.argmin([(each**2).sum() for each in model.all_innovations(some)]))]
    )


def fitted(
    model: Extended, values: Floats, step: Floats, bounds: Floats, near: Optimum | None = None
) -> Optimum:
    """Gauss-Newton from values (k,), with steps (k,) of the central differences; zero leaves an
    unknown as it is.

    Near another optimum, whose varied unknowns are the first of these, its rates are taken as they
    are; those of the others are made once.
    """
    step = step.copy()
    values = np.clip(values, *bounds.T)
    varied = np.flatnonzero(step)
    innovations = model.innovations(values)
    unknown = int((varied < len(values) - len(model.extra) - len(model.gains)).sum())
    if not np.isfinite(innovations).all():
        raise ValueError("the model with what was found does not follow the log")
    own = model.prior.own(_OWN)
    rates = np.empty((0, 0))
    if near is not None:
        count = len(near.rates)
        step[varied[:count]] = near.step[varied[:count]]
        rates = np.vstack([near.rates, slopes(model, values, step, varied[count:]).T])
        made = directions(rates, own)
    for left in reversed(range(_ROUNDS)):
        if near is None:
            rates = np.empty((0, 0))  # not beside the next ones
            rates = slopes(model, values, step, varied).T
            made = directions(rates, own)
        before = (innovations**2).sum()
        solved = functools.partial(_solved, made, rates, innovations, own)
        change = within_bounds(solved, values, step, bounds)
        for lengths in (_LENGTHS[:1], _LENGTHS[1:]):
            tried = np.clip(values + lengths[:, None] * change, *bounds.T)
            results = zip(tried, model.all_innovations(tried), strict=True)
            better = [
                each
                for each in results
                if np.isfinite(each[1]).all() and (each[1] ** 2).sum() < before
            ]
            if better:
                values, innovations = better[0]
                break
        if not left or not (innovations**2).sum() < (1 - _SETTLED) * before:
            break
    solved = functools.partial(_solved, made, rates, innovations, own)
    inside = ((bounds[:, 0] < values) & (values < bounds[:, 1]))[varied]
    free = inside | (within_bounds(solved, values, step, bounds)[varied] != 0)
    if not free.all():  # what is at its bound, and would leave it, does nothing
        within = directions(rates[free], own)
        made = np.zeros((len(within), len(rates)))
        made[:, free] = within
    return Optimum(
        model=model,
        values=values,
        step=step,
        innovations=innovations,
        rates=rates,
        made=made,
        unknown=unknown,
    )


def _solved(
    made: Floats, rates: Floats, innovations: Floats, own: float, moving: NDArray[np.bool_]
) -> Floats:
    """Coefficients of the rates that move; `made`: directions of all of them."""
    if not moving.all():
        made = directions(rates[moving], own)
        rates = rates[moving]
    return along(made, rates, innovations)


def directions(rates: Floats, share: float = _OWN) -> Floats:
    """What orthonormal directions are of rates (v, M): (r, v), none for a rate that is a
    combination of others.

    `share`: of a rate that must be its own.

    By Gram-Schmidt on the products of the rates.
    """
    together = products(rates.T)
    lengths = np.sqrt(np.diag(together))
    lengths = np.where(lengths > 0, lengths, 1.0)
    together = together / np.outer(lengths, lengths)
    made = np.empty((0, len(rates)))
    for i in range(len(rates)):
        own = (np.arange(len(rates)) == i).astype(float)
        for _ in range(2):
            own = own - product(made.T, product(made, product(together, own)))
        size = np.sqrt(max(dot(own, product(together, own)), 0.0))
        if size > share:
            made = np.vstack([made, own / size])
    return np.asarray(made / lengths)


def along(made: Floats, rates: Floats, target: Floats) -> Floats:
    """Coefficients (v,) of rates (v, M) that make the target; zero of a rate that is a
    combination of others.
    """
    return product(made.T, product(made, np.einsum("vm,m->v", rates, target)))


# resonances between which compliance is tried [Hz]
_LOWEST = 15.0
_HIGHEST = 250.0

# Of one to the next: under a law that follows the counts, and where torques are repeated, whose
# effect is narrow.
_RATIO = 1.25
_FINE = 1.1

# backlash that is tested [pulses], in a gear that else has a resonance at:
_WIDTHS = (1, 2, 4, 8, 16)

CONTACT = 300.0  # [Hz]


_AT_ONCE = 16  # trials that are simulated at once


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Some numbers that the rig leaves out, and what comes of them.

    `values`: in the units of `Extended`. `chi_square`: decrease of the sum of squared innovations,
    in units of their variance; negative where it grows. `explained`: the same [pulses^2]. `effect`:
    sum of squares of what they change, in the same units: chi-square of a log that has them.
    """

    values: dict[str, float]
    chi_square: float
    explained: float
    effect: float


def compliance(at: Optimum) -> list[Trial]:
    """Trials of all joints alike, and of each alone."""
    replayed = any(record.law is not None and record.law.replays for record in at.model.records)
    count = int(np.log(_HIGHEST / _LOWEST) / np.log(_FINE if replayed else _RATIO)) + 1
    joints = range(len(at.model.gains) // 2)
    together = [joints, *([joint] for joint in joints)] if len(joints) > 1 else [joints]
    frequencies = np.geomspace(_HIGHEST, _LOWEST, count).tolist()
    return _tried(
        at, [{f"compliance[{i}]": hz**-2 for i in some} for some in together for hz in frequencies]
    )


def backlash(at: Optimum) -> list[Trial]:
    """Trials of several widths, joint by joint, where none is known yet."""
    n = len(at.model.gains) // 2
    pulse = np.abs(np.diag(at.model.records[0].rig.to_angle(np.eye(n))))
    tried = []
    for i in range(n):
        gives = max(CONTACT**-2, at.values[at.model.place(f"compliance[{i}]")])
        if not at.values[at.model.place(f"backlash[{i}]")]:
            tried += [
                {f"backlash[{i}]": width * pulse[i], f"compliance[{i}]": gives} for width in _WIDTHS
            ]
    return _tried(at, tried)


def _tried(at: Optimum, tried: list[dict[str, float]]) -> list[Trial]:
    """The trials that follow the log."""
    many: list[Floats] = []
    for values in tried:
        many.append(at.values.copy())
        for name, value in values.items():
            many[-1][at.model.place(name)] = value
    before = at.before
    trials = []
    unit = at.unit(before)
    for i in range(0, len(many), _AT_ONCE):
        for values, result in zip(
            tried[i:], at.model.all_innovations(many[i : i + _AT_ONCE]), strict=False
        ):
            if np.isfinite(result).all():
                after = at.left(result)
                effect = float(((after - before) ** 2).sum()) / unit
                explained = float((before**2).sum() - (after**2).sum())
                trials.append(
                    Trial(
                        values=values,
                        chi_square=at.chi_square(after),
                        explained=explained,
                        effect=effect,
                    )
                )
    return trials

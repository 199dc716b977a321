"""One parameter over a fleet: mean, what robots differ by, what logs of one robot differ by, slope
with temperature.

value = mean + robot + slope (temperature - its mean) + week + error, robot and week random, error
of known variance: the variances by restricted maximum likelihood
(`identification.equation_error.random_effects`), that of weeks about the means of the robots, that
of robots on these means; the slope by weighted least squares within robots, in turn with it. Robots
that scatter beyond the others (chi-square), or lie apart from them (Student), count in neither
variance.
"""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.equation_error.least_squares import wider
from identification.equation_error.random_effects import restricted
from plant.parts.fields import Floats

APART = 0.01  # probability, over all robots looked at, with which one is set apart by chance

_ROUNDS = 3  # of variance and slope in turn
_FEWEST = 4  # robots of which one can lie apart from the others


class Values(NamedTuple):
    """One parameter in all logs of a fleet (M,), in the order of time; `robot` is a place in
    `robots`.
    """

    name: str
    label: str
    unit: str
    robots: tuple[str, ...]
    robot: NDArray[np.intp]
    time: Floats
    temperature: Floats
    value: Floats
    std: Floats


class Effect(NamedTuple):
    """Of one parameter: standard deviations between weeks and robots, NaN where not known; of each
    robot (J,) mean, its standard deviation, and the probability that one of all would lie so far
    apart from the others by chance.
    """

    of: Values
    mean: float
    robots: float
    weeks: float
    freedom: int
    slope: float
    slope_std: float
    means: Floats
    std: Floats
    apart: Floats


def values_of(rows: Iterable[Any]) -> Iterator[Values]:
    """Each parameter in all logs that tell it, of rows of a fleet in the order of time."""
    told = dict[str, list[Any]]()
    for row in rows:
        if row.std is not None:
            told.setdefault(row.name, []).append(row)
    for name, own in told.items():
        robots = {robot: i for i, robot in enumerate(dict.fromkeys(row.robot for row in own))}
        at = np.array([robots[row.robot] for row in own], dtype=np.intp)
        columns = np.array(
            [(row.time, row.temperature, row.value, row.std) for row in own], dtype=float
        ).T
        yield Values(name, own[-1].label, own[-1].unit, tuple(robots), at, *columns)


def effect_of(values: Values) -> Effect:
    """The mixed-effects view of one parameter."""
    count = len(values.robots)
    robot = values.robot
    warm = np.isfinite(values.temperature)
    temperature = np.where(warm, values.temperature, 0.0)
    slope = 0.0
    slope_std = np.nan

    def mean(weight: Floats, what: Floats) -> Floats:
        """Weighted mean of each robot (J,)."""
        total = np.bincount(robot, weight, count)
        return np.asarray(
            np.bincount(robot, weight * what, count) / np.where(total > 0, total, 1.0)
        )

    for _ in range(_ROUNDS if warm.any() else 1):
        weeks, freedom = _between_weeks(values, values.value - slope * temperature)
        weight = 1 / (values.std**2 + np.nan_to_num(weeks) ** 2)
        known = weight * warm
        apart = (temperature - mean(known, temperature)[robot]) * warm
        squares = float((known * apart**2).sum())
        if squares > 0 and freedom > 1:
            left = values.value - mean(known, values.value)[robot]
            slope = float((known * apart * left).sum()) / squares
            slope_std = float(wider(freedom - 1)) / np.sqrt(squares)
    level = float((known * temperature).sum()) / max(float(known.sum()), 1e-300)
    own = mean(weight, values.value - slope * (temperature - level) * warm)
    std = 1 / np.sqrt(np.bincount(robot, weight, count))
    middle, robots, chance = _between_robots(values.name, own, std)
    found = float(slope) if np.isfinite(slope_std) else np.nan
    return Effect(values, middle, robots, weeks, freedom, found, slope_std, own, std, chance)


def _between_weeks(values: Values, y: Floats) -> tuple[float, int]:
    """Standard deviation between logs of one robot, and degrees of freedom of it; NaN, 0 where
    no robot has two.
    """
    from scipy.special import chdtri

    logs = np.bincount(values.robot, minlength=len(values.robots))
    order = np.argsort(values.robot, kind="stable")
    place = np.empty(len(y), int)
    place[order] = np.arange(len(y)) - np.repeat(np.cumsum(logs) - logs, logs)
    each, std, share = np.zeros((3, logs.max(), len(logs)))
    std += 1.0
    each[place, values.robot], std[place, values.robot], share[place, values.robot] = (
        y,
        values.std,
        1.0,
    )
    kept = np.flatnonzero(logs > 1)
    limit = chdtri(np.maximum(logs - 1, 1), APART / max(len(kept), 1))
    while len(kept):
        some = each[:, kept], std[:, kept], share[:, kept]
        variance = restricted(values.label, *some)
        weight = some[2] / (some[1] ** 2 + variance)
        middle = (weight * some[0]).sum(axis=0) / weight.sum(axis=0)
        beyond = (weight * (some[0] - middle) ** 2).sum(axis=0) / limit[kept]
        if beyond.max() <= 1 or len(kept) < _FEWEST:
            return float(np.sqrt(variance)), int((logs[kept] - 1).sum())
        kept = np.delete(kept, beyond.argmax())
    return np.nan, 0


def _between_robots(name: str, own: Floats, std: Floats) -> tuple[float, float, Floats]:
    """Mean of a fleet, standard deviation between its robots, and the chance of each of lying so
    far apart.

    The robot that is farthest from the others is tested, and set apart, one after the other.
    """
    from scipy.special import stdtr

    def fitted(some: NDArray[np.intp]) -> tuple[float, float, float]:
        """Mean, its variance, and the variance between these robots."""
        each = own[some, None], std[some, None], np.ones((len(some), 1))
        between = restricted(name, *each) if len(some) > 1 else np.nan
        weight = 1 / (std[some] ** 2 + np.nan_to_num(between))
        return float((weight * own[some]).sum() / weight.sum()), 1 / float(weight.sum()), between

    kept = np.arange(len(own))
    chance = np.ones(len(own))
    found = fitted(np.arange(len(own)))
    while len(kept) >= max(_FEWEST, 3 * len(own) // 4):
        worst = kept[np.argmax(np.abs(own[kept] - found[0]) / np.sqrt(std[kept] ** 2 + found[2]))]
        rest = kept[kept != worst]
        mean, variance, between = fitted(rest)
        apart = abs(own[worst] - mean) / np.sqrt(variance + between + std[worst] ** 2)
        chance[worst] = min(1.0, len(own) * 2 * float(stdtr(len(rest) - 1, -apart)))
        if chance[worst] >= APART:
            break
        kept = rest
        found = (mean, variance, between)
    return found[0], float(np.sqrt(found[2])), chance

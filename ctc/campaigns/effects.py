"""Mixed-effects model of one parameter over a fleet: robots, weeks, slope with temperature.

value = mean + robot + slope (temperature - mean temperature) + week + error. Robot and week are
random, and each log counts as a week of its own; the variance of the error is known. Restricted
maximum likelihood (`identification.equation_error.random_effects`) gives the variance of the weeks
about the means of the robots, then the variance of these means about their common mean. Weighted
least squares within robots gives the slope, in turn with the variance of the weeks. A robot that
scatters more than the rest (chi-square test) does not count in the variance of the weeks. A robot
that lies apart from the rest (Student's test) does not count in the variance of the robots.
"""

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.equation_error import restricted, wider
from plant.parts import Floats, frozen_settings


@frozen_settings
class EffectSettings:
    """How the effects of a fleet are estimated; chosen by hand.

    Parameters
    ----------
    apart : float
        Probability of a false alarm, over all robots that are compared. A robot is set apart where
        chance explains its distance, or its scatter, with a lower probability.
    rounds : int
        Alternations of the variance between weeks and the slope with temperature.
    fewest : int
        Fewest robots among which one can be set apart.
    """

    apart: float = 0.01
    rounds: int = 3
    fewest: int = 4


EFFECTS = EffectSettings()


class Values(NamedTuple):
    """One parameter in M logs of a fleet, in the order of time; `robot` (M,) indexes `robots`."""

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
    """Effects on one parameter.

    `robots` and `weeks` are standard deviations between robots and between weeks; they are NaN
    where the logs do not determine them. `weeks` has `freedom` degrees of freedom. For each of the
    J robots, `means` is its mean, `std` the standard deviation of this mean, and `apart` the
    probability that chance sets any robot so far apart from the rest (1 where it was not tested).
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
    """Group rows of a fleet by parameter.

    The rows must be in the order of time. Rows without a standard deviation hold assumed values and
    are left out.
    """
    by_name = dict[str, list[Any]]()
    for row in rows:
        if row.std is not None:
            by_name.setdefault(row.name, []).append(row)
    for name, logs in by_name.items():
        # Robots are counted in the order in which their first logs come.
        robots = {robot: i for i, robot in enumerate(dict.fromkeys(row.robot for row in logs))}
        robot = np.array([robots[row.robot] for row in logs], dtype=np.intp)
        table = [(row.time, row.temperature, row.value, row.std) for row in logs]
        columns = np.array(table, dtype=float).T
        # Label and unit are those of the newest log.
        yield Values(name, logs[-1].label, logs[-1].unit, tuple(robots), robot, *columns)


def effect_of(values: Values) -> Effect:
    """Fit the mixed-effects model to one parameter."""
    count = len(values.robots)
    robot = values.robot
    # Logs without a temperature get a weight of zero in all that concerns the slope.
    warm = np.isfinite(values.temperature)
    temperature = np.where(warm, values.temperature, 0.0)
    slope = 0.0
    slope_std = np.nan

    def mean(weight: Floats, quantity: Floats) -> Floats:
        """Weighted mean of each robot (J,)."""
        # A robot without weight gets a mean of zero in place of 0 / 0.
        total = np.bincount(robot, weight, count)
        sums = np.bincount(robot, weight * quantity, count)
        return np.asarray(sums / np.where(total > 0, total, 1.0))

    # 1. Variance between weeks and slope depend on each other: estimate them in turn.
    for _ in range(EFFECTS.rounds if warm.any() else 1):
        weeks, freedom, scatter = _between_weeks(values, values.value - slope * temperature)
        weight = 1 / (values.std**2 + scatter[robot])
        slope_weight = weight * warm
        # Only differences within a robot count: robots may differ for other reasons than heat.
        deviation = (temperature - mean(slope_weight, temperature)[robot]) * warm
        squares = float((slope_weight * deviation**2).sum())
        if squares > 0 and freedom > 1:
            residual = values.value - mean(slope_weight, values.value)[robot]
            slope = float((slope_weight * deviation * residual).sum()) / squares
            # The slope takes one degree of freedom; Student's quantile widens its interval.
            slope_std = float(wider(freedom - 1)) / np.sqrt(squares)

    # 2. Means of the robots, all at the mean temperature of the fleet.
    level = float((slope_weight * temperature).sum()) / max(float(slope_weight.sum()), 1e-300)
    means = mean(weight, values.value - slope * (temperature - level) * warm)
    std = 1 / np.sqrt(np.bincount(robot, weight, count))

    # 3. What these means differ by.
    fit, chance = _between_robots(values.name, means, std)
    between = float(np.sqrt(fit.between))
    if not np.isfinite(slope_std):
        slope = np.nan
    return Effect(
        values, fit.mean, between, weeks, freedom, float(slope), slope_std, means, std, chance
    )


def _between_weeks(values: Values, y: Floats) -> tuple[float, int, Floats]:
    """Standard deviation between logs of one robot, its degrees of freedom, and variances (J,).

    The deviation is NaN, and the freedom 0, where no robot has two logs. The variances between the
    logs of each robot are alike, except those of robots that scatter more than the others.
    """
    from scipy.special import chdtri

    # Rank of each log among those of its robot, in the order of time.
    logs = np.bincount(values.robot, minlength=len(values.robots))
    order = np.argsort(values.robot, kind="stable")
    rank = np.empty(len(y), int)
    rank[order] = np.arange(len(y)) - np.repeat(np.cumsum(logs) - logs, logs)
    # One column per robot; `share` is 0 below its last log.
    shape = (logs.max(), len(logs))
    value = np.zeros(shape)
    std = np.ones(shape)
    share = np.zeros(shape)
    value[rank, values.robot] = y
    # Places below the last log keep a deviation of one; `share` gives them a weight of zero.
    std[rank, values.robot] = values.std
    share[rank, values.robot] = 1.0

    # Set the robot that scatters most aside, and fit again, until the rest is of one kind. A robot
    # that is set aside has a variance from its own logs.
    scatter = np.zeros(len(logs))
    robots = np.flatnonzero(logs > 1)
    limit = chdtri(np.maximum(logs - 1, 1), EFFECTS.apart / max(len(robots), 1))
    while len(robots):
        v, s, present = value[:, robots], std[:, robots], share[:, robots]
        variance = restricted(values.label, v, s, present)
        weight = present / (s**2 + variance)
        centre = (weight * v).sum(axis=0) / weight.sum(axis=0)
        beyond = (weight * (v - centre) ** 2).sum(axis=0) / limit[robots]
        if beyond.max() <= 1 or len(robots) < EFFECTS.fewest:
            # A robot with a single log shows no scatter: it has that of the others.
            like_others = np.append(robots, np.flatnonzero(logs <= 1))
            scatter[like_others] = variance
            return float(np.sqrt(variance)), int((logs[robots] - 1).sum()), scatter
        worst = beyond.argmax()
        scatter[robots[worst]] = restricted(
            values.label, v[:, [worst]], s[:, [worst]], present[:, [worst]]
        )
        robots = np.delete(robots, worst)
    return np.nan, 0, scatter


class _Population(NamedTuple):
    """Mean of some robots, the variance of that mean, and the variance between the robots."""

    mean: float
    variance: float
    between: float


def _between_robots(name: str, means: Floats, std: Floats) -> tuple[_Population, Floats]:
    """Fit a population to the means of the robots, and test which robots lie apart from the rest.

    The farthest robot is tested first. If it is set apart, the next farthest is tested. Each tested
    robot gets the probability that chance sets any robot so far apart; all others get 1.
    """
    from scipy.special import stdtr

    def fitted(robots: NDArray[np.intp]) -> _Population:
        # One robot has no variance between robots.
        between = np.nan
        if len(robots) > 1:
            ones = np.ones((len(robots), 1))
            between = restricted(name, means[robots, None], std[robots, None], ones)
        weight = 1 / (std[robots] ** 2 + np.nan_to_num(between))
        mean = float((weight * means[robots]).sum() / weight.sum())
        return _Population(mean, 1 / float(weight.sum()), between)

    count = len(means)
    chance = np.ones(count)
    robots = np.arange(count)
    fit = fitted(robots)
    # At most a quarter of the fleet is set apart: beyond that the rest is no norm.
    while len(robots) >= EFFECTS.fewest and count - len(robots) < count // 4:
        distance = np.abs(means[robots] - fit.mean) / np.sqrt(std[robots] ** 2 + fit.between)
        worst = robots[np.argmax(distance)]
        # The robot must not widen the distribution that it is tested against.
        rest = robots[robots != worst]
        without = fitted(rest)
        spread = np.sqrt(without.variance + without.between + std[worst] ** 2)
        apart = abs(means[worst] - without.mean) / spread
        # Two tails, times the number of robots that could have been the farthest (Bonferroni).
        chance[worst] = min(1.0, count * 2 * float(stdtr(len(rest) - 1, -apart)))
        if chance[worst] >= EFFECTS.apart:
            break
        robots = rest
        fit = without
    return fit, chance

"""Models with corrected counts or chain: counts that are in time, a link of another length.

A change of a length is taken over by f almost completely, and the rest is less than the error of a
torque along a smoothed motion. So each length needs a loop of its own, and lengths are tried only
where another effect contradicts the model.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from identification.replay.optimum import Optimum, fitted
from identification.results.alternatives import Sign, delay_sign, linear, signs
from identification.results.assumed import SHARE, longer
from plant.compiler.background import shared_out
from plant.parts.fields import Floats


@dataclasses.dataclass(frozen=True, kw_only=True)
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


SETTINGS = CorrectionSettings()


def tested(at: Optimum, effects: dict[str, Floats]) -> list[Sign]:
    """All signs (of `effects_of`) at an optimum; a length's where another is half significant."""
    results = signs(at, effects)
    if any(2 * sign.chi_square > sign.threshold for sign in results):
        return [*results, *_lengths(at)]
    return results


def _lengths(at: Optimum) -> Iterator[Sign]:
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
        if SETTINGS.shortest <= abs(*sign.values.values()) <= SETTINGS.longest
    ]
    # Lengths are nearly one thing for the log: at most one is reported.
    yield from sorted(plausible, key=lambda sign: -sign.chi_square)[:1]


def _effect(at: Optimum, name: str) -> Floats:
    """Effect (M,) on the innovations of a length, relative."""
    # By a difference, as the model has no length as a number.
    longer_model = at.model.of(longer(at.model.dynamics)[name])
    return np.asarray((longer_model.innovations(at.values) - at.innovations) / SHARE)


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
    while len(trials) < SETTINGS.trials and abs(missing) > SETTINGS.missing:
        # A chain with the present estimate of the length.
        model = at.model.of(longer(at.model.dynamics, share)[name])
        optimum = fitted(model, optimum.values, step, bounds)
        trials.append((dataclasses.replace(sign, values={name: share}), optimum))
        still_missing = sum(
            estimate.values[name]
            for estimate in linear(optimum, "length", {name: _effect(optimum, name)})
        )
        # A flat secant would step far away: its slope is limited.
        slope = min((still_missing - missing) / (share - previous), -SETTINGS.steepness)
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
    for _ in range(SETTINGS.shifts):
        delay += sign.values["delay"]
        if abs(delay) > SETTINGS.delay:
            return None
        try:
            optimum = fitted(at.model.late(-delay), optimum.values, step, bounds, at)
        except ValueError:  # the model diverges beside these counts
            return None
        sign = delay_sign(optimum) or sign
    return dataclasses.replace(sign, values={"delay": delay}), optimum

"""The loop of another model: of counts that are not late, of a chain that has another length.

Nearly all that a length changes f takes over, and what is left is less than the error of a torque
along a smoothed motion. Each length is a loop of its own, so that they are tried where something
else contradicts the model.
"""

import dataclasses
from collections.abc import Iterator

import numpy as np

from identification.replay.optimum import Optimum, fitted
from identification.results.alternatives import Sign, delay_sign, linear, signs
from identification.results.assumed import SHARE, longer
from plant.compiler.background import shared_out
from plant.parts.fields import Floats

# by which a length may differ: less is rounding, from more nothing is estimated
_LEAST = 0.05
_MOST = 0.5
# By how much less must be missing per length that is put in, at least; what may be missing; lengths
# put in.
_STEEP = 0.5
_NEAR = 0.01
_TRIALS = 3
# Delay [samples] beyond which counts are not late, but something else; and how often it is
# estimated anew.
_LATE = 1.0
_SHIFTS = 2


def tested(at: Optimum, effects: dict[str, Floats]) -> list[Sign]:
    """All signs (of `effects_of`), where the sum of squares is least; a length's where another
    is half significant.
    """
    found = signs(at, effects)
    return (
        [*found, *_lengths(at)]
        if any(2 * sign.chi_square > sign.threshold for sign in found)
        else found
    )


def _lengths(at: Optimum) -> Iterator[Sign]:
    """The sign of the one length that explains most."""
    # of the base, none acts
    names = [name for name in longer(at.model.dynamics) if not name.startswith("links[0]")]
    effects = dict(
        zip(names, shared_out(lambda name: _effect(at, name), names, at.model.threads), strict=True)
    )
    effects = {name: effect for name, effect in effects.items() if np.isfinite(effect).all()}
    every = [
        sign
        for name, effect in effects.items()
        for sign in linear(at, "length", {name: effect}, len(effects))
    ]
    some = [sign for sign in every if _LEAST <= abs(*sign.values.values()) <= _MOST]
    yield from sorted(some, key=lambda sign: -sign.chi_square)[:1]


def _effect(at: Optimum, name: str) -> Floats:
    """Change of the innovations (M,) with a length, relative."""
    other = at.model.of(longer(at.model.dynamics)[name]).innovations(at.values)
    return np.asarray((other - at.innovations) / SHARE)


def with_length(at: Optimum, sign: Sign, step: Floats, bounds: Floats) -> tuple[Sign, Optimum]:
    """The model of a chain with that length, fitted.

    `step`, `bounds`: as for `fitted`. A length does not act linearly: what is missing of it beside
    each is estimated, and the next is where a straight line through the last two has its zero.
    """
    ((name, share),) = sign.values.items()
    before = 0.0
    missing = share
    tried = [(sign, at)]
    while len(tried) <= _TRIALS and abs(missing) > _NEAR:
        model = at.model.of(longer(at.model.dynamics, share)[name])
        tried.append(
            (
                dataclasses.replace(sign, values={name: share}),
                fitted(model, tried[-1][1].values, step, bounds),
            )
        )
        at_it = tried[-1][1]
        more = sum(
            each.values[name] for each in linear(at_it, "length", {name: _effect(at_it, name)})
        )
        slope = min((more - missing) / (share - before), -_STEEP)
        before = share
        missing = more
        share = share - more / slope
    return min(tried[1:], key=lambda each: each[1].squares)


def without_delay(
    at: Optimum, sign: Sign, step: Floats, bounds: Floats
) -> tuple[Sign, Optimum] | None:
    """The model of counts that are not late, fitted; None where it does not follow them. `step`,
    `bounds`: `fitted`.
    """
    delay = 0.0
    found = at
    for _ in range(_SHIFTS):
        delay += sign.values["delay"]
        if abs(delay) > _LATE:
            return None
        try:
            found = fitted(at.model.late(-delay), found.values, step, bounds, at)
        except ValueError:
            return None
        sign = delay_sign(found) or sign
    return dataclasses.replace(sign, values={"delay": delay}), found

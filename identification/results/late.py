"""Counts that are read late, fitted: the model follows a log whose counts are shifted back."""

import dataclasses

from identification.replay.optimum import Optimum, fitted
from identification.results.alternatives import Sign, delay_sign
from plant.parts.fields import Floats

# Delay [samples] beyond which counts are not late, but something else; and how often it is estimated anew.
_LATE, _SHIFTS = 1.0, 2


def without_delay(at: Optimum, sign: Sign, step: Floats, bounds: Floats) -> tuple[Sign, Optimum] | None:
    """The model of counts that are not late, fitted; None where it does not follow them. `step`, `bounds`: `fitted`."""
    delay, found = 0.0, at
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

"""Compliance and backlash as they are, not linearised: some of each are tried, and what they leave is compared."""

import dataclasses

import numpy as np

from identification.replay.optimum import Optimum
from plant.parts.fields import Floats

_LOWEST, _HIGHEST = 15.0, 250.0  # resonances between which compliance is tried [Hz]

_RATIO, _FINE = 1.25, 1.1
"""Of one to the next: under a law that follows the counts, and where torques are repeated, whose effect is narrow."""

_WIDTHS = (1, 2, 4, 8, 16)
"""Backlash that is tested [pulses], in a gear that else has a resonance at:"""

CONTACT = 300.0
"""[Hz]"""


_AT_ONCE = 16  # trials that are simulated at once


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Some numbers that the rig leaves out, and what comes of them.

    `values`: in the units of `Extended`. `chi_square`: decrease of the sum of squared innovations, in units of their
    variance; negative where it grows. `explained`: the same [pulses^2]. `effect`: sum of squares of what they change,
    in the same units: chi-square of a log that has them.
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
    return _tried(at, [{f"compliance[{i}]": hz**-2 for i in some} for some in together for hz in frequencies])


def backlash(at: Optimum) -> list[Trial]:
    """Trials of several widths, joint by joint, where none is known yet."""
    n = len(at.model.gains) // 2
    pulse = np.abs(np.diag(at.model.records[0].rig.to_angle(np.eye(n))))
    tried = []
    for i in range(n):
        gives = max(CONTACT**-2, at.values[at.model.place(f"compliance[{i}]")])
        if not at.values[at.model.place(f"backlash[{i}]")]:
            tried += [{f"backlash[{i}]": width * pulse[i], f"compliance[{i}]": gives} for width in _WIDTHS]
    return _tried(at, tried)


def _tried(at: Optimum, tried: list[dict[str, float]]) -> list[Trial]:
    """The trials that follow the log."""
    many: list[Floats] = []
    for values in tried:
        many.append(at.values.copy())
        for name, value in values.items():
            many[-1][at.model.place(name)] = value
    before, trials = at.before, []
    unit = at.unit(before)
    for i in range(0, len(many), _AT_ONCE):
        for values, result in zip(tried[i:], at.model.all_innovations(many[i : i + _AT_ONCE]), strict=False):
            if np.isfinite(result).all():
                after = at.left(result)
                effect = float(((after - before) ** 2).sum()) / unit
                explained = float((before**2).sum() - (after**2).sum())
                trials.append(Trial(values=values, chi_square=at.chi_square(after), explained=explained, effect=effect))
    return trials

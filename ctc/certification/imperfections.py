"""Imperfections of gears, motors, encoders and sampling that are sampled uniformly from stated
ranges, one row each.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant import FrictionDrift, Jitter, Presliding, QuadratureError, Rig, TorqueRipple
from plant.parts.arguments import array, real

_DRIFTS = 1.0  # time constant of drifting friction [s]
_CYCLES = 6.0  # of torque ripple, per turn of the motor


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """Numbers (P, K) of each plant, and those (P, L) of its loop that follow from them."""

    names: tuple[str, ...]
    values: NDArray[np.float64]
    derived_names: tuple[str, ...]
    derived: NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Imperfection:
    """One that `certify` takes a range for: in words, its place in the rig, and its number in the
    closed loop.

    `made`: value, with `each` that of each joint (n,), sampled on its own -> what stands at the
    place. `signed`: it may be negative. `follows`: (random, plants, joints) -> names and values (P,
    L) of numbers that go with it.
    """

    words: str
    unit: str
    place: str
    number: str
    made: Callable[[Any], Any] = lambda value: value
    each: bool = True
    signed: bool = False
    follows: Callable[[Any, int, int], tuple[list[str], NDArray[np.float64]]] | None = None

    def own(self, rig: Rig) -> Any:
        """What a rig has of it, or None."""
        part: Any = rig
        for name in self.place.split("."):
            part = getattr(part, name, None)
        return part

    def placed(self, rig: Rig, value: float) -> Rig:
        """The rig with it, all joints alike; it is there also where it does not vary."""
        if self.place.startswith("drive.elasticity") and rig.drive.elasticity is None:
            raise ValueError(
                f"{self.words} needs elastic joints; got a rigid rig. State their resonance= too"
                " [Hz]."
            )
        return _replaced(
            rig, self.place.split("."), self.made(np.full(rig.n, value) if self.each else value)
        )


def _replaced(part: Any, path: list[str], value: Any) -> Any:
    """A part with another value at the end of a path of fields."""
    name, *rest = path
    return dataclasses.replace(
        part, **{name: _replaced(getattr(part, name), rest, value) if rest else value}
    )


def _phases(number: str) -> Callable[[Any, int, int], tuple[list[str], NDArray[np.float64]]]:
    """Phases of a periodic error, anywhere in the period."""
    return lambda random, count, n: (
        [f"{number}[{i}]" for i in range(n)],
        random.uniform(0, 2 * np.pi, (count, n)),
    )


IMPERFECTIONS: dict[str, Imperfection] = {
    "backlash": Imperfection(
        words="backlash",
        unit="rad",
        place="drive.elasticity.backlash",
        number="drive.elasticity.backlash",
    ),
    "lag": Imperfection(
        words="current lag",
        unit="s",
        place="drive.current_lag",
        number="drive.current_lag.time",
        each=False,
    ),
    "jitter": Imperfection(
        words="jitter",
        unit="of the period",
        place="jitter",
        number="jitter.share",
        each=False,
        made=lambda value: Jitter(share=value),
        follows=lambda random, count, n: (["jitter.stream"], np.arange(float(count))[:, None]),
    ),
    "friction_drift": Imperfection(
        words="drift of friction",
        unit="of it",
        place="drive.friction_drift",
        number="drive.friction_drift.amount",
        made=lambda value: FrictionDrift(amount=value, time=np.full(len(value), _DRIFTS)),
        signed=True,
    ),
    "presliding": Imperfection(
        words="presliding",
        unit="rad of the motor",
        place="drive.presliding",
        number="drive.presliding.distance",
        made=lambda value: Presliding(distance=value),
    ),
    "load_friction": Imperfection(
        words="load-dependent friction",
        unit="of the load",
        place="drive.load_friction",
        number="drive.load_friction.share",
    ),
    "ripple": Imperfection(
        words="torque ripple",
        unit="N m of the motor",
        place="drive.ripple",
        number="drive.ripple.amplitude",
        made=lambda value: TorqueRipple(
            amplitude=value, cycles=np.full(len(value), _CYCLES), phase=0 * value
        ),
        follows=_phases("drive.ripple.phase"),
    ),
    "quadrature": Imperfection(
        words="error within an encoder's period",
        unit="pulses",
        place="encoder.quadrature",
        number="encoder.quadrature.amplitude",
        made=lambda value: QuadratureError(amplitude=value, phase=0 * value),
        follows=_phases("encoder.quadrature.phase"),
    ),
}


def placed_in(rig: Rig, ranges: Mapping[str, tuple[float, float]]) -> Rig:
    """The rig with each imperfection whose range is not zero, at that end of it which is farther
    from zero.
    """
    for name, ends in ranges.items():
        if any(ends):
            rig = IMPERFECTIONS[name].placed(rig, max(ends, key=abs))
    return rig


def drawn_of(ranges: Mapping[str, tuple[float, float]], random: Any, count: int, n: int) -> Drawn:
    """So many plants of n joints."""
    names: list[str] = []
    derived_names: list[str] = []
    values = [np.empty((count, 0))]
    derived = [np.empty((count, 0))]
    for row, ends in ((IMPERFECTIONS[name], ends) for name, ends in ranges.items() if any(ends)):
        own = [f"{row.number}[{i}]" for i in range(n)] if row.each else [row.number]
        names += own
        values.append(random.uniform(*ends, (count, len(own))))
        if row.follows:
            more, follow = row.follows(random, count, n)
            derived_names += more
            derived.append(follow)
    made = {"values": np.hstack(values), "derived": np.hstack(derived)}
    return Drawn(names=tuple(names), derived_names=tuple(derived_names), **made)


def between(name: str, value: Any, unit: str, signed: bool = False) -> tuple[float, float]:
    """(low, high) of one number, or of two."""
    if np.ndim(value) == 0:
        value = (real(name, value, f"Give {unit}, or the two ends of a range."),) * 2
    low, high = array(
        name, value, (2,), advice=f"Give one number [{unit}], or the two ends of a range."
    ).tolist()
    if not (low <= high and (signed or low >= 0)):
        rule = "two numbers" if signed else "from 0 upwards"
        raise ValueError(
            f"{name} must be {rule}, the lower end first; got ({low:g}, {high:g}). Swap or correct."
        )
    return low, high

"""Table of imperfections of gears, motors, encoders and sampling, sampled from stated ranges."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from plant import FrictionDrift, Jitter, Presliding, QuadratureError, Rig, TorqueRipple
from plant.parts import Floats, array, frozen, real

# Time constant of drifting friction [s], chosen by hand: a run of seconds shows most of the drift.
_DRIFT_TIME = 1.0
# Cycles of torque ripple per turn of the motor, chosen by hand.
_CYCLES = 6.0


@frozen
class Drawn:
    """Sampled numbers of plants, and the numbers of their loops that follow from them.

    `names` (K), `values` (P, K): sampled. `derived_names` (L), `derived` (P, L): of the loops.
    """

    names: tuple[str, ...]
    values: Floats
    derived_names: tuple[str, ...]
    derived: Floats


@frozen
class Imperfection:
    """One imperfection that `certify` takes a range for.

    `words`, `unit`: as printed. `place`: path of fields in the rig. `number`: its name in the
    closed loop. `build`: value -> the part at the place; with `per_joint` the value is (n,),
    sampled for each joint. `signed`: it may be negative. `follows`: (random, plants, joints) ->
    names and values (P, L) of numbers that accompany it.
    """

    words: str
    unit: str
    place: str
    number: str
    build: Callable[[Any], Any] = lambda value: value
    per_joint: bool = True
    signed: bool = False
    follows: Callable[[Any, int, int], tuple[list[str], Floats]] | None = None

    def own(self, rig: Rig) -> Any:
        """The part of a rig at its place, or None."""
        part: Any = rig
        for name in self.place.split("."):
            part = getattr(part, name, None)
        return part

    def applies(self, rig: Rig) -> bool:
        """Whether such a rig can have it; only those above servos have a supply."""
        return not self.place.startswith("inner.") or self.own(rig) is not None

    def placed(self, rig: Rig, value: float) -> Rig:
        """The rig with this value, all joints alike."""
        if not self.applies(rig):
            kind = "none" if rig.inner is None else type(rig.inner).__name__
            raise ValueError(
                f"{self.words} needs a rig with a PositionServo as its inner loop; got {kind}."
                " Leave it out, or state inner=."
            )
        if self.place.startswith("drive.elasticity") and rig.drive.elasticity is None:
            raise ValueError(
                f"{self.words} needs elastic joints; got a rigid rig. State their resonance= too"
                " [Hz]."
            )
        # One value for all joints; a part of the whole rig takes it as it is.
        part = self.build(np.full(rig.n, value) if self.per_joint else value)
        return _replaced(rig, self.place.split("."), part)


def _replaced(part: Any, path: list[str], value: Any) -> Any:
    """A part with another value at the end of a path of fields."""
    # Parts are frozen, so all of them on the path are made anew.
    name = path[0]
    if len(path) > 1:
        value = _replaced(getattr(part, name), path[1:], value)
    return dataclasses.replace(part, **{name: value})


def _phases(number: str) -> Callable[[Any, int, int], tuple[list[str], Floats]]:
    """Phases of a periodic error, uniform over the period, for each joint."""
    return lambda random, count, n: (
        [f"{number}[{i}]" for i in range(n)],
        random.uniform(0, 2 * np.pi, (count, n)),
    )


# A new row needs a field of `Uncertainty`; the shell and all texts read it from here.
IMPERFECTIONS: dict[str, Imperfection] = {
    "backlash": Imperfection(
        words="backlash",
        unit="rad",
        place="drive.elasticity.backlash",
        number="drive.elasticity.backlash",
    ),
    # All amplifiers of a rig are alike: one time constant.
    "lag": Imperfection(
        words="current lag",
        unit="s",
        place="drive.current_lag",
        number="drive.current_lag.time",
        per_joint=False,
    ),
    # One clock samples all joints.
    "jitter": Imperfection(
        words="jitter",
        unit="of the period",
        place="jitter",
        number="jitter.share",
        per_joint=False,
        build=lambda value: Jitter(share=value),
        # Each plant has its own stream of jitter.
        follows=lambda random, count, n: (["jitter.stream"], np.arange(float(count))[:, None]),
    ),
    # Friction falls while gears warm up, and rises as they cool.
    "friction_drift": Imperfection(
        words="drift of friction",
        unit="of it",
        place="drive.friction_drift",
        number="drive.friction_drift.amount",
        build=lambda value: FrictionDrift(amount=value, time=np.full(len(value), _DRIFT_TIME)),
        signed=True,
    ),
    "presliding": Imperfection(
        words="presliding",
        unit="rad of the motor",
        place="drive.presliding",
        number="drive.presliding.distance",
        build=lambda value: Presliding(distance=value),
    ),
    "load_friction": Imperfection(
        words="load-dependent friction",
        unit="of the load",
        place="drive.load_friction",
        number="drive.load_friction.share",
    ),
    # The phase of an error within one turn, or one pitch, is unknown of any machine.
    "ripple": Imperfection(
        words="torque ripple",
        unit="N m of the motor",
        place="drive.ripple",
        number="drive.ripple.amplitude",
        build=lambda value: TorqueRipple(
            amplitude=value, cycles=np.full(len(value), _CYCLES), phase=0 * value
        ),
        follows=_phases("drive.ripple.phase"),
    ),
    "quadrature": Imperfection(
        words="error within an encoder's period",
        unit="pulses",
        place="encoder.quadrature",
        number="encoder.quadrature.amplitude",
        build=lambda value: QuadratureError(amplitude=value, phase=0 * value),
        follows=_phases("encoder.quadrature.phase"),
    ),
    # A servo's voltage, its temperature and another gain register all scale its torque.
    "supply": Imperfection(
        words="supply of the servos",
        unit="of that stated",
        place="inner.supply",
        number="inner.supply",
    ),
}


def placed_in(rig: Rig, ranges: Mapping[str, tuple[float, float]]) -> Rig:
    """The rig with each stated imperfection, at the end of its range that is farther from zero."""
    for name, ends in ranges.items():
        if any(ends):
            rig = IMPERFECTIONS[name].placed(rig, max(ends, key=abs))
    return rig


def drawn_of(ranges: Mapping[str, tuple[float, float]], random: Any, count: int, n: int) -> Drawn:
    """Imperfections of `count` plants of n joints, uniform in their ranges."""
    names: list[str] = []
    derived_names: list[str] = []
    values = [np.empty((count, 0))]
    derived = [np.empty((count, 0))]
    for name, ends in ranges.items():
        # An imperfection that is not stated takes no random number, so stating it later changes
        # none of the draws before it.
        if not any(ends):
            continue
        row = IMPERFECTIONS[name]
        numbers = [f"{row.number}[{i}]" for i in range(n)] if row.per_joint else [row.number]
        names += numbers
        values.append(random.uniform(*ends, (count, len(numbers))))
        # Phases and streams follow their amplitude, in the order of the draws.
        if row.follows:
            follower_names, followers = row.follows(random, count, n)
            derived_names += follower_names
            derived.append(followers)
    return Drawn(
        names=tuple(names),
        values=np.hstack(values),
        derived_names=tuple(derived_names),
        derived=np.hstack(derived),
    )


def between(name: str, value: Any, unit: str, signed: bool = False) -> tuple[float, float]:
    """Ends (low, high) of a range that is given as one number or as two."""
    # One number stands for a range without width. As objects: `array` refuses nested sequences.
    if np.ndim(np.array(value, dtype=object)) == 0:
        value = (real(name, value, f"Give {unit}, or the two ends of a range."),) * 2
    advice = f"Give one number [{unit}], or the two ends of a range."
    low, high = array(name, value, (2,), advice=advice).tolist()
    # Most imperfections have no sign: a negative amplitude would be a mistake.
    if not (low <= high and (signed or low >= 0)):
        rule = "two numbers" if signed else "from 0 upwards"
        raise ValueError(
            f"{name} must be {rule}, the lower end first; got ({low:g}, {high:g}). Swap or correct."
        )
    return low, high

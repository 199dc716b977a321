"""Imperfections of gears, motors, encoders and sampling that are drawn uniformly from stated ranges, one row each."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant import FrictionDrift, Jitter, Presliding, QuadratureError, Rig, TorqueRipple
from plant.parts.arguments import array, real

_DRIFTS = 1.0
"""Time constant of drifting friction [s]."""

_CYCLES = 6.0
"""Of torque ripple, per turn of the motor."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Drawn:
    """Numbers of each plant, and those of its loop that follow from them.

    Attributes
    ----------
    names : tuple of str
    values : (P, K) numpy.ndarray
    derived_names : tuple of str
    derived : (P, L) numpy.ndarray
    """

    names: tuple[str, ...]
    values: NDArray[np.float64]
    derived_names: tuple[str, ...]
    derived: NDArray[np.float64]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Imperfection:
    """One that `certify` takes a range for.

    Attributes
    ----------
    words : str
        What a certificate calls it.
    unit : str
    number : str
        Of the closed loop; of each joint with ``[i]`` behind it.
    own : callable
        Rig -> the part of it that has the number, or None.
    placed : callable
        (rig, value, values of the joints (n,), all alike) -> the rig with it; it is there also where it does not vary.
    each : bool
        Whether each joint has its own, drawn on its own.
    signed : bool
        Whether it may be negative.
    follows : callable, optional
        (random, plants, joints) -> names and values (P, L) of numbers that go with it.
    """

    words: str
    unit: str
    number: str
    own: Callable[[Rig], Any]
    placed: Callable[[Rig, float, Any], Rig]
    each: bool = True
    signed: bool = False
    follows: Callable[[Any, int, int], tuple[list[str], NDArray[np.float64]]] | None = None


def _drive(rig: Rig, **changes: Any) -> Rig:
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **changes))


def _played(rig: Rig, value: float, each: Any) -> Rig:
    if rig.drive.elasticity is None:
        raise ValueError("backlash needs gears that give; got a rigid rig. State their resonance= as well [Hz].")
    return _drive(rig, elasticity=dataclasses.replace(rig.drive.elasticity, backlash=each))


def _phases(number: str) -> Callable[[Any, int, int], tuple[list[str], NDArray[np.float64]]]:
    """Phases of a periodic error, anywhere in the period."""
    return lambda random, count, n: (
        [f"{number}[{i}]" for i in range(n)],
        random.uniform(0, 2 * np.pi, (count, n)),
    )


def _sloppy_encoder(rig: Rig, value: float, each: Any) -> Rig:
    error = QuadratureError(amplitude=each, phase=0 * each)
    return dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, quadrature=error))


IMPERFECTIONS: dict[str, Imperfection] = {
    "backlash": Imperfection(
        words="backlash", unit="rad", number="drive.elasticity.backlash", placed=_played,
        own=lambda rig: None if rig.drive.elasticity is None else rig.drive.elasticity.backlash,
    ),
    "lag": Imperfection(
        words="current lag", unit="s", number="drive.current_lag.time", each=False,
        own=lambda rig: rig.drive.current_lag, placed=lambda rig, value, each: _drive(rig, current_lag=value),
    ),
    "jitter": Imperfection(
        words="jitter", unit="of the period", number="jitter.share", each=False,
        own=lambda rig: rig.jitter,
        placed=lambda rig, value, each: dataclasses.replace(rig, jitter=Jitter(share=value)),
        follows=lambda random, count, n: (["jitter.stream"], np.arange(float(count))[:, None]),
    ),
    "friction_drift": Imperfection(
        words="drift of friction", unit="of it", number="drive.friction_drift.amount", signed=True,
        own=lambda rig: rig.drive.friction_drift,
        placed=lambda rig, value, each: _drive(
            rig, friction_drift=FrictionDrift(amount=each, time=np.full(len(each), _DRIFTS))
        ),
    ),
    "presliding": Imperfection(
        words="presliding", unit="rad of the motor", number="drive.presliding.distance",
        own=lambda rig: rig.drive.presliding,
        placed=lambda rig, value, each: _drive(rig, presliding=Presliding(distance=each)),
    ),
    "load_friction": Imperfection(
        words="load-dependent friction", unit="of the load", number="drive.load_friction.share",
        own=lambda rig: rig.drive.load_friction, placed=lambda rig, value, each: _drive(rig, load_friction=each),
    ),
    "ripple": Imperfection(
        words="torque ripple", unit="N m of the motor", number="drive.ripple.amplitude",
        own=lambda rig: rig.drive.ripple, follows=_phases("drive.ripple.phase"),
        placed=lambda rig, value, each: _drive(
            rig, ripple=TorqueRipple(amplitude=each, cycles=np.full(len(each), _CYCLES), phase=0 * each)
        ),
    ),
    "quadrature": Imperfection(
        words="error within an encoder's period", unit="pulses", number="encoder.quadrature.amplitude",
        own=lambda rig: rig.encoder.quadrature, placed=_sloppy_encoder, follows=_phases("encoder.quadrature.phase"),
    ),
}  # fmt: skip


def placed_in(rig: Rig, ranges: Mapping[str, tuple[float, float]]) -> Rig:
    """The rig with each imperfection whose range is not zero, at that end of it which is farther from zero."""
    for name, ends in ranges.items():
        if any(ends):
            most = max(ends, key=abs)
            rig = IMPERFECTIONS[name].placed(rig, most, np.full(rig.n, most))
    return rig


def drawn_of(ranges: Mapping[str, tuple[float, float]], random: Any, count: int, n: int) -> Drawn:
    """So many plants of n joints."""
    names: list[str] = []
    derived_names: list[str] = []
    values, derived = [np.empty((count, 0))], [np.empty((count, 0))]
    for name, ends in ranges.items():
        if not any(ends):
            continue
        row = IMPERFECTIONS[name]
        names += [f"{row.number}[{i}]" for i in range(n)] if row.each else [row.number]
        values.append(random.uniform(*ends, (count, n if row.each else 1)))
        if row.follows:
            more, follow = row.follows(random, count, n)
            derived_names += more
            derived.append(follow)
    return Drawn(
        names=tuple(names), values=np.hstack(values), derived_names=tuple(derived_names), derived=np.hstack(derived)
    )


def between(name: str, value: Any, unit: str, signed: bool = False) -> tuple[float, float]:
    """(low, high) of one number, or of two."""
    if np.ndim(value) == 0:
        value = (real(name, value, f"Give {unit}, or the two ends of a range."),) * 2
    low, high = array(name, value, (2,), advice=f"Give one number [{unit}], or the two ends of a range.").tolist()
    if not (low <= high and (signed or low >= 0)):
        rule = "two numbers" if signed else "from 0 upwards"
        raise ValueError(f"{name} must be {rule}, the lower end first; got ({low:g}, {high:g}). Swap or correct.")
    return low, high

"""One arm under one controller on elastic gears of many resonances, simulated side by side.

A rigid rig is an assumption. What it costs is one number: the locked-rotor resonance of the gears
above which the nominal arm still stays within the limit. Another is how it begins: a path gives the
simulator its first speed, too; a real arm is at rest until the first sample of its controller
(`from_rest`).
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification import Identification
from plant import Arm, Drive, Elasticity, Law, Reference, Rig
from plant.machine.elasticity import DAMPING_RATIO
from plant.parts.arguments import instance, real
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.simulation.logged_run import DivergenceError
from plant.simulation.loop_kernel import LANES
from plant.simulation.population import Population, Runs
from plant.simulation.simulator import run

# between which resonances are tested [Hz]
LOWEST = 10.0
HIGHEST = 500.0
SETTLED = 0.02  # time before which samples do not count [s]
RIGID = 1e5  # resonance [Hz] of a gear that moves like a rigid one


# Phase [rad] of a locked-rotor resonance in one sub-step up to which the vibration of motor against
# link, which is faster, is right to 1 % in its frequency: of the arms of `plant.puma560`, at 1.1
# rad and to 0.3 %.
_FOLLOWED = 0.6


def require_followed(name: str, hz: ArrayLike, step: float) -> None:
    """Refuse resonances [Hz] that sub-steps of this length [s] cannot follow."""
    highest = float(np.max(hz))
    most = _FOLLOWED / (2 * np.pi * step)
    if highest > most:
        steps = (
            f"which sub-steps of {1e3 * step:.3g} ms can follow; got {highest:g}. Lower it (such a"
            " gear is rigid)"
        )
        raise ValueError(f"{name} must be below {most:.0f} Hz, {steps}, or take shorter sub-steps.")


def require_swinging(damping_ratio: float) -> None:
    """Refuse a damping ratio with which nothing oscillates."""
    if damping_ratio > 1:
        advice = f"Gears have {DAMPING_RATIO:g} to 0.03, no percent."
        raise ValueError(
            f"damping_ratio must be at most 1, critical damping; got {damping_ratio:g}. {advice}"
        )


def damping_of(damping_ratio: Any) -> float:
    """A damping ratio with which elastic joints oscillate, or its refusal."""
    advice = f"Give that of the gears, such as {DAMPING_RATIO:g}."
    ratio = real("damping_ratio", damping_ratio, advice, positive=True)
    require_swinging(ratio)
    return ratio


def arm_of(arm: Any, others: str = "") -> Arm:
    """The arm itself, or that of an identification; what else may be given, for the message."""
    given: Any = arm.arm if isinstance(arm, Identification) else arm
    instance("arm", given, Arm, f"Pass the arm that is controlled, or an identification{others}.")
    return given


def with_gears(rig: Rig, elasticity: Any) -> Rig:
    """A rig with such gears."""
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=elasticity))


def gear_numbers(gears: Any, drive: Drive, hz: ArrayLike) -> tuple[list[str], NDArray[np.float64]]:
    """Names and values (P, 2 n) of what makes gears of these resonances (P,) [Hz], all joints
    alike.
    """
    each = [
        dataclasses.replace(gears, hz=np.full(drive.n, value)).of(drive)
        for value in np.asarray(hz, float)
    ]
    names = [
        f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(drive.n)
    ]
    return names, np.array([np.append(gear.stiffness, gear.damping) for gear in each])


def on_gears(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    damping_ratio: float,
    threads: int,
    **options: Any,
) -> Callable[[ArrayLike], Runs]:
    """What runs an arm of a rigid rig on gears of resonances (P,) [Hz] at its reference's first
    pose, all joints alike.

    Options are those of `Population`. Elastic gears, and motors that weigh more than the arm, are
    refused.
    """
    if rig.drive.elasticity is not None:
        raise ValueError(
            "the rig must have rigid gears; got elastic ones. Evaluate it as it is instead."
        )
    gears: Any = Elasticity.from_resonance(arm, RIGID, damping_ratio, q=reference(np.zeros(1)).q[0])
    loop = (arm, with_gears(rig, gears), law, reference)
    drive = rig.drive
    return lambda hz: Population(*loop, *gear_numbers(gears, drive, hz), **options).run(threads)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LowestResonance(Shown, Frozen):
    """The locked-rotor resonance above which a loop stays within its limit. ``float(...)`` is its
    number.

    Attributes
    ----------
    hz : float
        Above which it stays at every resonance tested, all joints alike [Hz]; below, it exceeds it
        at some, not at all. 10 where the loop stays at every resonance tested, which are 10 to 500
        Hz, and infinite where it exceeds it also at the highest or when rigid; NaN where it cannot
        be told.
    damping_ratio : float
    within : float or None
        Limit [pulses]; None where only stability is meant.
    reason : str
        Why it cannot be told, or that the loop exceeds it when rigid; empty otherwise.
    """

    hz: float
    damping_ratio: float
    within: float | None
    reason: str = ""

    @classmethod
    def none(cls, damping_ratio: float, within: float) -> Self:
        """Of a loop that exceeds the limit also on rigid gears."""
        return cls(
            hz=np.inf, damping_ratio=damping_ratio, within=within, reason="also on rigid gears"
        )

    def __float__(self) -> float:
        return self.hz

    def _short(self) -> str:
        within = "stable" if self.within is None else f"within {self.within:g}"
        return f"{self.hz:.3g} Hz, {within}, damping ratio {self.damping_ratio:g}"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(str(self), None if np.isnan(self.hz) else self.hz <= LOWEST)

    def __str__(self) -> str:
        """On which gears the loop stays within its limit, in one line."""
        damped = f"(damping ratio {self.damping_ratio:g})"
        stays = "stable"
        exceeds = "is unstable"
        if self.within is not None:
            stays = f"stays within ±{self.within:g} pulse"
            exceeds = f"exceeds ±{self.within:g} pulse"
        if np.isnan(self.hz):
            return f"on elastic gears: cannot tell, {self.reason}"
        if self.reason:
            return f"{exceeds} {self.reason}"
        if self.hz <= LOWEST:
            return f"{stays} on elastic gears too, at any resonance above {LOWEST:g} Hz {damped}"
        if self.hz > HIGHEST:
            return (
                f"{stays} on rigid gears only: at some resonances up to {HIGHEST:g} Hz it {exceeds}"
                f" {damped}"
            )
        return f"{stays} on gears that resonate above {self.hz:.3g} Hz {damped}, not just below"


@functools.lru_cache(maxsize=32)
def lowest_resonance(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    within: float,
    duration: float,
    steps_per_sample: int,
    damping_ratio: float,
    after: float,
    threads: int,
    initial: tuple[tuple[float, ...], ...] | None,
) -> LowestResonance:
    """Locked-rotor resonance above which an arm on elastic gears stays within a pulse limit; once
    for the same loop.

    The arm is simulated on gears of 80 resonances from 10 to 500 Hz, 5 % apart, all joints alike,
    and of 40 more in the gap above the highest on which it exceeds the limit. On softer gears it
    may stay again; bands above the number that are narrower than 5 % can be missed.
    """
    options = {
        "within": within,
        "steps_per_sample": steps_per_sample,
        "after": after,
        "duration": duration,
    }
    ratio = damping_of(damping_ratio)
    start = None if initial is None else np.array(initial)
    try:
        runs = on_gears(arm, rig, law, reference, ratio, threads, initial=start, **options)
    except ValueError as error:
        if rig.drive.elasticity is not None:
            raise
        return LowestResonance(hz=np.nan, damping_ratio=ratio, within=within, reason=str(error))

    def leaves(hz: Any) -> Any:
        return runs(hz).outside > 0

    if leaves([RIGID])[0]:
        return LowestResonance.none(ratio, within)
    return LowestResonance(hz=above(leaves, 2 * LANES), damping_ratio=ratio, within=within)


def above(fails: Callable[[Any], Any], count: int) -> float:
    """The lowest frequency [Hz] above which nothing fails, of so many tried and more in the last
    gap between them.

    10 where nothing fails at all, infinite where it does at 500 Hz.
    """
    tried = np.geomspace(LOWEST, HIGHEST, count)
    failed = np.flatnonzero(fails(tried))
    if not len(failed) or failed[-1] == count - 1:
        return np.inf if len(failed) else LOWEST
    gap = np.geomspace(tried[failed[-1]], tried[failed[-1] + 1], count // 2)
    return float(gap[np.flatnonzero(fails(gap[:-1]))[-1] + 1])


_LOOKED = 1.0  # seconds within which an arm that began at rest should be back
_STILL = 1e-9  # share of the largest speed of a path that is none


@dataclasses.dataclass(frozen=True, kw_only=True)
class FromRest:
    """A run from rest on a path that begins in motion: the joint and its speed, the largest encoder
    error [pulses], the time from which on the arm is within the limit [s], NaN where later than was
    simulated, and the limit.
    """

    begins: str
    peak: float
    back: float
    within: float

    def __str__(self) -> str:
        until = f"not within ±{self.within:g} pulse after {_LOOKED:g} s"
        if np.isfinite(self.back):
            until = f"within ±{self.within:g} pulse from {self.back:.2g} s on"
        stands = (
            f"is up to {self.peak:.0f} pulses off, {until}"
            if np.isfinite(self.peak)
            else "diverges"
        )
        moving = f"the path begins in motion ({self.begins}), and so did what was simulated"
        return f"{moving}; an arm at rest there {stands}"


@functools.lru_cache(maxsize=32)
def from_rest(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    within: float,
    duration: float,
    steps_per_sample: int,
) -> FromRest | None:
    """The same loop from rest at the path's first position; None where the path begins at rest, or
    nothing is lost.

    The first second of a run of this `duration` [s] is simulated, once for the same loop.
    """
    qd = reference(np.linspace(0, duration, 101)).qd
    speed = np.where(np.abs(qd[0]) > _STILL * np.abs(qd).max(), qd[0], 0.0)
    if not speed.any():
        return None
    i = int(np.abs(speed / rig.to_angle(np.ones(rig.n))).argmax())
    chain = arm.dynamics.chain
    begins = (
        f"{chain.joint_labels[i]} at {speed[i]:.2g} {'m' if chain.links[i].prismatic else 'rad'}/s"
    )
    start = np.array([reference(np.zeros(1)).q[0], np.zeros(rig.n)])
    settings: dict[str, Any] = {
        "steps_per_sample": steps_per_sample,
        "initial": start,
        "backend": "casadi",
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what it says of rig and path was said of the run itself
        try:
            record = run(arm, rig, law, reference, min(duration, _LOOKED), **settings).record
        except DivergenceError:
            return FromRest(begins=begins, peak=np.inf, back=np.nan, within=within)
    error = np.abs(record.error_pulses).max(axis=1)
    if error.max() <= within:
        return None
    outside = np.flatnonzero(error > within)
    back = np.nan if outside[-1] == len(error) - 1 else float(record.t[outside[-1] + 1])
    return FromRest(begins=begins, peak=float(error.max()), back=back, within=within)

"""Two assumptions of a simulated verdict: rigid gears, and a start in motion.

One number describes the first, the locked-rotor resonance of the gears above which the nominal arm
still stays within the limit (`lowest_resonance`). A path gives the simulator its first speed, too;
a real arm is at rest until the first sample of its controller (`from_rest`).
"""

import dataclasses
import functools
import warnings
from collections.abc import Callable, Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.equation_error import Estimate
from plant import Arm, Drive, Elasticity, Law, Reference, Rig
from plant.machine import DAMPING_RATIO
from plant.parts import Frozen, Piece, Shown, Verdict, frozen, instance, real, whole
from plant.simulation import LANES, DivergenceError, Population, Runs, run

# Range in which resonances are tested [Hz].
LOWEST = 10.0
HIGHEST = 500.0
# Time before which the error on elastic gears does not count [s].
SETTLED = 0.02
# Resonance [Hz] of a gear that moves like a rigid one: a rigid arm is a lane of the same kernel.
RIGID = 1e5

# Phase [rad] of a locked-rotor resonance in one sub-step up to which the integrator has the faster
# vibration of motor against link to 1 % in its frequency: for the arms of `plant.puma560` that
# vibration is at 1.1 rad, and right to 0.3 %.
_FOLLOWED_PHASE = 0.6


def require_followed(name: str, hz: ArrayLike, period: float, steps_per_sample: int) -> None:
    """Refuse resonances [Hz] that so many sub-steps of a sample period [s] cannot follow."""
    step = period / whole("steps_per_sample", steps_per_sample, "Leave it out.")
    highest = float(np.max(hz))
    # The phase 2 pi f h of one sub-step h.
    limit = _FOLLOWED_PHASE / (2 * np.pi * step)
    if highest > limit:
        raise ValueError(
            f"{name} must be below {limit:.0f} Hz, which sub-steps of {1e3 * step:.3g} ms can"
            f" follow; got {highest:g}. Lower it (such a gear is rigid), or take shorter sub-steps."
        )


def require_swinging(damping_ratio: float) -> None:
    """Refuse a damping ratio with which nothing oscillates."""
    if damping_ratio > 1:
        raise ValueError(
            f"damping_ratio must be at most 1, critical damping; got {damping_ratio:g}. Gears have"
            f" {DAMPING_RATIO:g} to 0.03, no percent."
        )


def damping_of(damping_ratio: Any) -> float:
    """A damping ratio with which elastic joints oscillate, or its refusal."""
    advice = f"Give that of the gears, such as {DAMPING_RATIO:g}."
    ratio = real("damping_ratio", damping_ratio, advice, positive=True)
    require_swinging(ratio)
    return ratio


def arm_of(arm: Any, alternatives: str = "") -> Arm:
    """The arm itself, or that of an identification; `alternatives` are for the message."""
    controlled: Any = arm.arm if isinstance(arm, Estimate) else arm
    advice = f"Pass the arm that is controlled, or an identification{alternatives}."
    return instance("arm", controlled, Arm, advice)


def with_gears(rig: Rig, elasticity: Any) -> Rig:
    """The rig with these gears."""
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, elasticity=elasticity))


def gear_numbers(gears: Any, drive: Drive, hz: ArrayLike) -> tuple[list[str], NDArray[np.float64]]:
    """Names and values (P, 2 n) of stiffness and damping for resonances (P,) [Hz].

    All joints have the same resonance.
    """
    names = [
        f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(drive.n)
    ]
    rows = []
    for value in np.asarray(hz, float):
        # The same damping ratio at every resonance.
        elasticity = dataclasses.replace(gears, hz=np.full(drive.n, value)).of(drive)
        rows.append(np.append(elasticity.stiffness, elasticity.damping))
    return names, np.array(rows)


def on_gears(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    damping_ratio: float,
    threads: int,
    **options: Any,
) -> Callable[[ArrayLike], Runs]:
    """A function: resonances (P,) [Hz] -> runs of an arm of a rigid rig on such gears.

    The resonances are those at the reference's first pose, all joints alike; options are those of
    `Population`. Elastic gears, and motors that weigh more than the arm, are refused.
    """
    if rig.drive.elasticity is not None:
        raise ValueError(
            "the rig must have rigid gears; got elastic ones. Evaluate it as it is instead."
        )
    # Any elasticity makes the kernel one of elastic gears; its numbers are those of each lane.
    gears: Any = Elasticity.from_resonance(arm, RIGID, damping_ratio, q=reference(np.zeros(1)).q[0])
    numbers = gear_numbers(gears, rig.drive, [RIGID])
    # Its equations and tables are the costly part, and the same at every resonance.
    population = Population(arm, with_gears(rig, gears), law, reference, *numbers, **options)

    def runs(hz: ArrayLike) -> Runs:
        _, values = gear_numbers(gears, rig.drive, hz)
        return population.with_values(values).run(threads)

    return runs


@frozen
class LowestResonance(Shown, Frozen):
    """Locked-rotor resonance above which a loop stays within its limit; `float` gives the number.

    Attributes
    ----------
    hz : float
        The loop stays within the limit at every tested resonance above it, all joints alike [Hz];
        below, it exceeds the limit at some resonances, not at all. 10 where the loop stays at every
        tested resonance (10 to 500 Hz), infinite where it exceeds the limit also at the highest or
        on rigid gears, NaN where it is unknown.
    damping_ratio : float
    within : float or None
        Limit [pulses]; None for mere stability.
    reason : str
        Why it is unknown, or that the loop exceeds the limit on rigid gears; empty otherwise.
    """

    hz: float
    damping_ratio: float
    within: float | None
    reason: str = ""

    @classmethod
    def none(cls, damping_ratio: float, within: float) -> Self:
        """For a loop that exceeds the limit also on rigid gears."""
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
        """The gears on which the loop stays within its limit, in one line."""
        damped = f"(damping ratio {self.damping_ratio:g})"
        stays = "stable"
        exceeds = "is unstable"
        # The order matters: NaN has no order, and a reason may come with an infinite number.
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
        return (
            f"{stays} on gears that resonate above {self.hz:.3g} Hz {damped}; on softer ones, at"
            f" some resonances, it {exceeds}"
        )


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
    """Locked-rotor resonance above which an arm on elastic gears stays within a pulse limit.

    The arm is simulated on gears of 80 resonances from 10 to 500 Hz, 5 % apart, all joints alike,
    and of 40 more in the gap above the highest on which it exceeds the limit. On softer gears it
    may stay again; bands above the number that are narrower than 5 % can be missed. The result is
    stored, since verdict, table and figure ask for it.
    """
    # By name, as a population takes them.
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
    # Motors that weigh more than the arm have no such gears: unknown, and no error of the user.
    except ValueError as error:
        if rig.drive.elasticity is not None:
            raise
        return LowestResonance(hz=np.nan, damping_ratio=ratio, within=within, reason=str(error))

    def fails(hz: Any) -> Any:
        return runs(hz).outside > 0

    rigid = runs([RIGID])
    # Where no sample counts, none exceeds the limit on any gears.
    if not rigid.samples:
        reason = f"the run ends within the first {after:g} s, which do not count"
        return LowestResonance(hz=np.nan, damping_ratio=ratio, within=within, reason=reason)
    # A loop that fails on rigid gears fails for another reason than elasticity.
    if rigid.outside[0]:
        return LowestResonance.none(ratio, within)
    # A kernel runs LANES loops at once: other numbers of resonances would leave lanes idle.
    return LowestResonance(hz=above(fails, 2 * LANES), damping_ratio=ratio, within=within)


def above(fails: Callable[[Any], Any], count: int) -> float:
    """Lowest frequency [Hz] above which nothing fails, from `count` tests and half as many more.

    10 where nothing fails, infinite where it fails at 500 Hz.
    """
    # Equal ratios: a loop reacts to relative changes of a resonance.
    tested = np.geomspace(LOWEST, HIGHEST, count)
    failed = np.flatnonzero(fails(tested))
    if not len(failed):
        return LOWEST
    highest = failed[-1]
    # No resonance is known to hold.
    if highest == count - 1:
        return np.inf
    # The gap above the highest failure, whose upper end is known to hold.
    gap = np.geomspace(tested[highest], tested[highest + 1], count // 2)
    return float(gap[np.flatnonzero(fails(gap[:-1]))[-1] + 1])


# Time [s] within which an arm that began at rest should be within the limit. Chosen by hand: an arm
# that is not back after a second does not follow.
_RECOVERY = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class FromRest:
    """A run from rest on a path that begins in motion.

    `begins`: the fastest joint and its speed. `peak`: largest encoder error [pulses]. `back`: time
    from which on the arm is within the limit [s]; NaN where it is not within the simulated time.
    `within`: the limit [pulses]. `simulated`: that time [s].
    """

    begins: str
    peak: float
    back: float
    within: float
    simulated: float

    def __str__(self) -> str:
        until = f"not within ±{self.within:g} pulse after {self.simulated:g} s"
        if np.isfinite(self.back):
            until = f"within ±{self.within:g} pulse from {self.back:.2g} s on"
        result = "diverges"
        if np.isfinite(self.peak):
            result = f"is up to {self.peak:.0f} pulses off, {until}"
        start = f"the path begins in motion ({self.begins}), and so did what was simulated"
        return f"{start}; an arm at rest there {result}"


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
    """The same loop from rest at the path's first position, simulated for a second.

    None if the path begins at rest, or if the arm stays within the limit.
    """
    # A speed of 1e-9 of the largest is the rounding error of a path that begins at rest.
    qd = reference(np.linspace(0, duration, 101)).qd
    speed = np.where(np.abs(qd[0]) > 1e-9 * np.abs(qd).max(), qd[0], 0.0)
    if not speed.any():
        return None
    # In pulses per second, so that sliding and rotary joints compare.
    i = int(np.abs(speed / rig.to_angle(np.ones(rig.n))).argmax())
    chain = arm.dynamics.chain
    begins = f"{chain.joint_labels[i]} at {speed[i]:.2g} {chain.joint_units[i].speed}"
    # The first position of the path, without its speed.
    start = np.array([reference(np.zeros(1)).q[0], np.zeros(rig.n)])
    settings: dict[str, Any] = {
        "steps_per_sample": steps_per_sample,
        "initial": start,
        "backend": "casadi",
    }
    # `_RECOVERY` is all the time that a verdict needs.
    simulated = min(duration, _RECOVERY)
    found = functools.partial(FromRest, begins=begins, within=within, simulated=simulated)
    with warnings.catch_warnings():
        # Warnings about rig and path were given with the run itself.
        warnings.simplefilter("ignore")
        try:
            record = run(arm, rig, law, reference, simulated, **settings).record
        except DivergenceError:
            return found(peak=np.inf, back=np.nan)
    # The arm lags behind its reference first; it is back when it stays within the limit.
    error = np.abs(record.error_pulses).max(axis=1)
    # A machine that begins at rest holds as well: nothing to report.
    if error.max() <= within:
        return None
    outside = np.flatnonzero(error > within)
    # An error at the last sample leaves no time from which on it is back.
    back = np.nan if outside[-1] == len(error) - 1 else float(record.t[outside[-1] + 1])
    return found(peak=float(error.max()), back=back)

"""The lowest resonance of gears on which a loop stays within a pulse limit, by simulation.

A rigid rig is an assumption. What it costs where gears give is one number: the locked-rotor resonance above which the
nominal arm still stays within the limit, found by simulating it on gears of many resonances side by side.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ctc.verdict.on_gears import RIGID, HeavyMotorsError, OnGears, arm_of, damping_of
from identification import Identification
from plant import Arm, Law, Reference, Rig
from plant.machine.elasticity import DAMPING_RATIO
from plant.parts.arguments import known_options
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown, Verdict
from plant.simulation.loop_kernel import LANES
from plant.simulation.threads import cores

LOWEST, HIGHEST = 10.0, 500.0
"""Between which resonances are tried [Hz]."""

SETTLED = 0.02
"""Time before which samples do not count [s]."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class LowestResonance(Shown, Frozen):
    """The locked-rotor resonance above which a loop stays within its limit. ``float(...)`` is its number.

    Attributes
    ----------
    hz : float
        Above which it stays at every resonance tried, all joints alike [Hz]; below, it leaves at some, not at all. 10
        where the loop stays at every resonance tried, which are 10 to 500 Hz, and infinite where it leaves also at the
        highest or when rigid; NaN where it cannot be told.
    damping_ratio : float
    within : float or None
        Limit [pulses]; None where only stability is meant.
    reason : str
        Why it cannot be told, or that the loop leaves when rigid; empty otherwise.
    """

    hz: float
    damping_ratio: float
    within: float | None
    reason: str = ""

    @classmethod
    def none(cls, damping_ratio: float, within: float) -> LowestResonance:
        """Of a loop that leaves also on rigid gears."""
        return cls(hz=np.inf, damping_ratio=damping_ratio, within=within, reason="also on rigid gears")

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
        stays, leaves = "stable", "is unstable"
        if self.within is not None:
            stays, leaves = f"stays within ±{self.within:g} pulse", f"leaves ±{self.within:g} pulse"
        if np.isnan(self.hz):
            return f"on elastic gears: cannot tell, {self.reason}"
        if self.reason:
            return f"{leaves} {self.reason}"
        if self.hz <= LOWEST:
            return f"{stays} on elastic gears too, at any resonance above {LOWEST:g} Hz {damped}"
        if self.hz > HIGHEST:
            return f"{stays} on rigid gears only: at some resonances up to {HIGHEST:g} Hz it {leaves} {damped}"
        return f"{stays} on gears that resonate above {self.hz:.3g} Hz {damped}, not just below"


@known_options
def lowest_resonance(
    arm: Arm | Identification, rig: Rig, law: Law, reference: Reference, *, damping_ratio: float = DAMPING_RATIO,
    within: float = 1, after: float = SETTLED, duration: float | None = None, steps_per_sample: int = 16,
    initial: ArrayLike | None = None, threads: int | None = None,
) -> LowestResonance:  # fmt: skip
    """Locked-rotor resonance above which an arm on elastic gears stays within a pulse limit under a law.

    The arm is simulated as it is on gears of 80 resonances from 10 to 500 Hz, 5 % apart, all joints alike, side by
    side, and of 40 more in the gap above the highest on which it leaves. That is what the number says: at every
    resonance tried above it the loop stays, and just below it leaves. On softer gears it may stay again. Bands above
    the number that are narrower than 5 % can be missed.

    Parameters
    ----------
    arm : Arm or Identification
        The arm that is controlled.
    rig : Rig
        With rigid gears; lag, delay and friction stay as they are.
    law : Law
    reference : Reference
        A gear's resonance is that at its first pose.
    damping_ratio : float
        Of each gear against its locked motor.
    within : float
        Limit of the counted error of the motors [pulses].
    after : float
        Samples before this time do not count [s].
    duration : float, optional
        [s]; by default one period of the reference.
    steps_per_sample : int
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] of the motors at t = 0; by default those of the reference.
    threads : int, optional
        By default one per core.

    Returns
    -------
    LowestResonance

    Raises
    ------
    ValueError
        A rig whose gears are elastic, a damping ratio that is not from above 0 to 1.
    """
    options = {
        "within": within, "steps_per_sample": steps_per_sample, "after": after, "initial": initial,
        "duration": reference.duration if duration is None else duration,
    }  # fmt: skip
    ratio = damping_of(damping_ratio)
    try:
        sweep = OnGears(arm_of(arm), rig, law, reference, ratio, **options)
    except HeavyMotorsError as error:
        return LowestResonance(hz=np.nan, damping_ratio=ratio, within=within, reason=str(error))
    threads = int(threads or cores())

    def leaves(hz: Any) -> Any:
        return sweep.runs(hz, threads).outside > 0

    if leaves([RIGID])[0]:
        return LowestResonance.none(ratio, within)
    return LowestResonance(hz=above(leaves, 2 * LANES), damping_ratio=ratio, within=within)


def above(fails: Callable[[Any], Any], count: int) -> float:
    """The lowest frequency [Hz] above which nothing fails, of so many tried and more in the last gap between them.

    10 where nothing fails at all, infinite where it does at 500 Hz.
    """
    tried = np.geomspace(LOWEST, HIGHEST, count)
    failed = np.flatnonzero(fails(tried))
    if not len(failed) or failed[-1] == count - 1:
        return np.inf if len(failed) else LOWEST
    gap = np.geomspace(tried[failed[-1]], tried[failed[-1] + 1], count // 2)
    return float(gap[np.flatnonzero(fails(gap[:-1]))[-1] + 1])

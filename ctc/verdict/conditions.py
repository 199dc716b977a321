"""What a verdict by simulation does not state: an arm at rest on a moving path.

A path gives the simulator its first speed, too; a real arm is at rest until the first sample of its controller.
"""

import dataclasses
import functools
import warnings
from typing import Any

import numpy as np

from plant import Arm, Law, Reference, Rig
from plant.simulation.logged_run import DivergenceError
from plant.simulation.simulator import run

_LOOKED = 1.0  # seconds within which an arm that began at rest should be back
_STILL = 1e-9  # share of the largest speed of a path that is none


@dataclasses.dataclass(frozen=True, kw_only=True)
class FromRest:
    """A run from rest on a path that begins in motion: the joint and its speed, the largest encoder error [pulses], the
    time from which on the arm is within the limit [s], NaN where later than was simulated, and the limit.
    """

    begins: str
    peak: float
    back: float
    within: float

    def __str__(self) -> str:
        until = f"not within ±{self.within:g} pulse after {_LOOKED:g} s"
        if np.isfinite(self.back):
            until = f"within ±{self.within:g} pulse from {self.back:.2g} s on"
        stands = f"is up to {self.peak:.0f} pulses off, {until}" if np.isfinite(self.peak) else "diverges"
        moving = f"the path begins in motion ({self.begins}), and so did what was simulated"
        return f"{moving}; an arm at rest there {stands}"


@functools.lru_cache(maxsize=32)
def from_rest(
    arm: Arm, rig: Rig, law: Law, reference: Reference, within: float, duration: float, steps_per_sample: int
) -> FromRest | None:
    """The same loop from rest at the path's first position; None where the path begins at rest, or nothing is lost.

    The first second of a run of this `duration` [s] is simulated, once for the same loop.
    """
    qd = reference(np.linspace(0, duration, 101)).qd
    speed = np.where(np.abs(qd[0]) > _STILL * np.abs(qd).max(), qd[0], 0.0)
    if not speed.any():
        return None
    i = int(np.abs(speed / rig.to_angle(np.ones(rig.n))).argmax())
    chain = arm.dynamics.chain
    begins = f"{chain.joint_labels[i]} at {speed[i]:.2g} {'m' if chain.links[i].prismatic else 'rad'}/s"
    start = np.array([reference(np.zeros(1)).q[0], np.zeros(rig.n)])
    settings: dict[str, Any] = {"steps_per_sample": steps_per_sample, "initial": start, "backend": "casadi"}
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

"""The plant under which a law does worst, ready to be run again."""

from __future__ import annotations

import dataclasses

from plant import Arm, Rig

__all__ = ["Worst"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Worst:
    """The plant with the largest error: ``evaluate(worst.arm, worst.rig, law, reference)`` runs it again.

    Attributes
    ----------
    arm, rig : Arm, Rig
        The rig with its friction, phase, delay and lost samples; the arm with its load.
    peak : float
        Largest counted error [pulses]; inf if the loop diverged.
    index : int
        Which of the plants it is.
    values : dict
        Of the numbers drawn for it, by name.
    """

    arm: Arm
    rig: Rig
    peak: float
    index: int
    values: dict[str, float]

"""The plant under which a law does worst, ready to be run again."""

import dataclasses
from collections.abc import Iterator

from plant import Arm, Rig
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Worst(Shown):
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

    def _short(self) -> str:
        return f"plant {self.index}, peak {self.peak:.0f} pulses"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short())
        yield Table(("drawn", ""), [(name, f"{value:.5g}") for name, value in self.values.items()])

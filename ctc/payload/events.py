"""What happened to the load of a running controller."""

import dataclasses
from collections.abc import Iterator

from plant.parts.shown import Piece, Shown


@dataclasses.dataclass(frozen=True, kw_only=True, repr=False)
class PayloadEvent(Shown):
    """A change of the load, as it was detected and as it was identified.

    Attributes
    ----------
    time : float
        When it was detected [s], counted in periods from the start; 0 for the load at the start.
    kind : str
        "start", "taken", "dropped" or "changed".
    before : float
        Mass in the model before [kg].
    after : float
        Mass that was identified [kg]; NaN until then.
    swapped : float
        When the model was swapped to it [s]; NaN until then.
    windows : int
        That were looked at; of those before the last the message said why they were not used.
    message : str
        Of the last window.
    """

    time: float
    kind: str
    before: float
    after: float = float("nan")
    swapped: float = float("nan")
    windows: int = 0
    message: str = "collecting"

    def _short(self) -> str:
        return f"{self.time:.3f} s, {self.kind}, {self.before:.3g} -> {self.after:.3g} kg"

    def _shown(self) -> Iterator[Piece]:
        yield self._short()
        yield f"{self.windows} windows; the last: {self.message}"

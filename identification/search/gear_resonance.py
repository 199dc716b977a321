"""What an identification says of elastic gears: the resonance of each, or the bound that a rigid log gives."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict, Warned
from plant.parts.tables import Table


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GearResonance(Shown, Frozen):
    """Locked-rotor resonances, sqrt(k / (D_ii - Jm_i k_i^2)) / 2 pi, at the pose where the reference begins.

    `joints`: what to call each joint. `pose` (n,): [rad]. `hz` (n,): [Hz]; infinite where the log does not tell the
    gear from a rigid one. `low`, `high` (n,): 95 % interval [Hz], from the profile likelihood. Without an upper end,
    low is a bound: the gear is stiffer. `damping_ratio`, `damping_low`, `damping_high` (n,): of the resonance, and its
    95 % interval; where the log says little, it is what was expected, 0.005 to 0.05. `searched` (n,): whether the
    stiffness was unknown; the other resonances are those of the rig. `played`: joints whose gear has backlash that the
    rig does not state. A search takes it for compliance, in all gears that it looks for, so that low is a bound there:
    the gear is stiffer.
    """

    joints: tuple[str, ...]
    pose: Floats
    hz: Floats
    low: Floats
    high: Floats
    damping_ratio: Floats
    damping_low: Floats
    damping_high: Floats
    searched: NDArray[np.bool_]
    played: tuple[str, ...] = ()

    def beside_backlash(self, joints: tuple[str, ...]) -> GearResonance:
        """What remains of it where the log shows backlash at these joints: bounds."""
        return dataclasses.replace(self, high=np.where(self.searched, np.inf, self.high), played=joints)

    def bounds(self, name: str) -> bool:
        """Whether an unknown is stiffness or damping of a gear of which the log gives a bound alone."""
        stiffer = np.flatnonzero(self.searched & np.isinf(self.high)).tolist()
        return name in [f"drive.elasticity.{what}[{i}]" for what in ("stiffness", "damping") for i in stiffer]

    def _short(self) -> str:
        found = [f"{hz:.1f}" if np.isfinite(top) else f">{low:.0f}" for hz, low, top in
                 zip(self.hz, self.low, np.where(self.searched, self.high, 0), strict=True)]  # fmt: skip
        return f"{', '.join(found)} Hz"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict("resonance of each link against its locked motor, with 95 % intervals")
        rows = []
        for i, label in enumerate(self.joints):
            hz = f"{self.hz[i]:.1f}"
            ratio = f"{self.damping_ratio[i]:.3f} [{self.damping_low[i]:.3f}, {self.damping_high[i]:.3f}]"
            if not self.searched[i]:
                rows.append((label, hz, "as the rig says", ""))
            elif np.isinf(self.high[i]):
                rows.append((label, "", f"stiffer than {self.low[i]:.0f}", ""))
            else:
                rows.append((label, hz, f"[{self.low[i]:.1f}, {self.high[i]:.1f}]", ratio))
        yield Table(("", "[Hz]", "interval", "damping ratio"), rows, words=(2, 3))
        if self.played and self.searched.any():
            yield Warned([
                f"bounds alone: backlash was found at {', '.join(self.played)} that the rig does not state, and "
                "the search takes it for compliance. State it in the Elasticity, and identify again."
            ])  # fmt: skip

"""What a rig states is right within tolerances: what an identification cannot see, its intervals count."""

from __future__ import annotations

import dataclasses

from plant.parts.arguments import real
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Tolerances(Frozen):
    """Standard deviations of what a rig states; zero takes a number for exact.

    Parameters
    ----------
    gear : float
        Of the gears, with counts per turn and lengths, relative.
    offset : float
        Of a constant torque of each motor beside its friction, as a share of its torque in the log (rms).
    friction : float
        Of viscous and Coulomb numbers that are not unknowns, as a share of the motor's torque in the log (rms).
    lag : float
        Of currents behind commands [s].
    delay : float
        Of the counts [samples].

    Raises
    ------
    ValueError
        A negative number.

    See Also
    --------
    identification.identify

    Examples
    --------
    >>> from identification import Tolerances
    >>> Tolerances(gear=0.0).gear
    0.0
    """

    gear: float = 0.008
    offset: float = 0.01
    friction: float = 0.01
    lag: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if real(field.name, getattr(self, field.name), "Give a standard deviation; 0 takes it for exact.") < 0:
                raise ValueError(
                    f"{field.name} must not be negative; got {getattr(self, field.name):g}. 0 takes it for exact."
                )

    def __str__(self) -> str:
        torque, said = "of the motor's torque (rms)", []
        said += [f"gears {100 * self.gear:g} %"] * bool(self.gear)
        said += [f"offsets of the torque {100 * self.offset:g} % {torque}"] * bool(self.offset)
        said += [f"friction that is not unknown {100 * self.friction:g} % {torque}"] * bool(self.friction)
        said += [f"lag {1e3 * self.lag:g} ms"] * bool(self.lag) + [f"delay {self.delay:g} samples"] * bool(self.delay)
        if not said:
            return "take the rig for exact, and the lengths of links"
        return f"a rig that is right within {', '.join(said)}, and links of exactly the stated lengths"

    @classmethod
    def none(cls) -> Tolerances:
        """All that the rig states taken for exact."""
        return cls(**dict.fromkeys((field.name for field in dataclasses.fields(cls)), 0.0))

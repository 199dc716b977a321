"""Old names of this package: they work for one release, say so, and go together with this file."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from plant.analysis.control_systems import to_control, to_timeresponse
from plant.checkup.finding import Checkup
from plant.laws.law import Law, StatelessLaw
from plant.logs.record import Record
from plant.machine.encoder import Encoder
from plant.machine.rig import Rig
from plant.mechanics.arm import Arm
from plant.parts.deprecation import install, warn_renamed

__all__: list[str] = []

_CROSSINGS = {"read": "true_counts", "position": "position_in_pulses", "turned": "to_angle", "angle": "cell_centre"}
install(Rig, pulses="counts", **_CROSSINGS)
install(Encoder, pulses="counts", count="quantised", **_CROSSINGS)
install(Checkup, troubles="problems")


def _function(owner: type, old: str, function: Callable[..., Any], new: str) -> None:
    def method(self: Any, *arguments: Any, **options: Any) -> Any:
        warn_renamed(f"{owner.__name__}.{old}", new)
        return function(self, *arguments, **options)

    method.__doc__ = f"Use ``{new}``."
    setattr(owner, old, method)


_function(Arm, "to_control", to_control, "plant.to_control(arm, rig)")
_function(Rig, "to_control", to_control, "plant.to_control(rig)")
_function(Law, "to_control", to_control, "plant.to_control(law, rig)")
_function(Record, "to_timeresponse", to_timeresponse, "plant.to_timeresponse(record)")
_function(
    Rig,
    "counted",
    lambda rig, counts: rig.encoder.position_in_pulses(rig.encoder.cell_centre(counts)),
    "rig.encoder.position_in_pulses(rig.encoder.cell_centre(counts))",
)


def _complete(cls: type) -> None:
    """A law that gives its equations alone, as laws could: it has no state, and no period."""
    for name in ("period", "initial_state"):
        if "equations" in vars(cls) and getattr(getattr(cls, name), "__isabstractmethod__", False):
            warnings.warn(
                f"{cls.__name__} must give {name}: laws without will be refused in the next release. "
                "Derive it from StatelessLaw, or define it.",
                DeprecationWarning,
                stacklevel=2,
            )
            setattr(cls, name, getattr(StatelessLaw, name))


Law.__init_subclass__ = classmethod(_complete)  # type: ignore[method-assign, assignment]  # goes with this file

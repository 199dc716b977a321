"""Functions of law and rig that the compiled step calls by their address.

`plant.realtime.pieces` generates their instructions for one law and one rig. Here each has a
definition that all controllers share, so that the guards are compiled once. In C they are functions
of the same names.
"""

from typing import Any

from plant.compiler import call_by_number

# Names in the order of their numbers, by which the generated code knows them.
PIECES: list[str] = []


def _piece(name: str) -> Any:
    """Function of a `Memory` that reads and writes its vector."""
    PIECES.append(name)
    return call_by_number(len(PIECES) - 1)


# The reference, extrapolated over one sample.
ahead = _piece("ahead")

# Speed of the counts: that of the reference before the first sample, then the smoothed difference.
moving = _piece("moving")
measured = _piece("measured")

# Counts of the reference, and the position of the counts.
counted = _piece("counted")

# Motion where a stop begins, and the reference of the braking.
standing = _piece("standing")
slowing = _piece("slowing")

# Torque of the law with its limit and the state that follows.
law = _piece("law")

# Saturation and chatter of the torque, and the next slot of the window.
monitored = _piece("monitored")
shifted = _piece("shifted")

# Torque of a stop without feedback.
ramp = _piece("ramp")

# Change of the model's torque since a joint came to rest.
needed = _piece("needed")

# Whether joints exceed their limits of position and speed.
bounds = _piece("bounds")

# Speed of the reference in pulses, also of the reference of a stop.
planned = _piece("planned")

# Direction in which a torque at its limit pushes the counts.
limited = _piece("limited")

# Torque that the firmware adds.
left_out = _piece("left_out")

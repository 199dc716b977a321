"""A control law, or an arm with its drives, as a functional mock-up unit (FMI).

Reading order: `model` (what is exchanged, as the model description lists it; the C of an arm) ->
`export` (`to_fmu`). The interface itself is in the templates ``c/``.
"""

from plant.fmu.model import named_joints

__all__ = ["named_joints"]

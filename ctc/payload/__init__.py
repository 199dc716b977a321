"""A load in the gripper: detected, identified and swapped into the model of a running controller.

Read `payload_law` (the stage in the loop), `controller` (collect, identify, swap) and `estimator`
(what a user states).
"""

from ctc.payload.controller import PayloadEvent
from ctc.payload.payload_law import PayloadLaw

__all__ = ["PayloadEvent", "PayloadLaw"]

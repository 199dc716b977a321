"""Torque that was missing along a path, learnt from repetitions of it.

Read `path_plant` (the plant linearised along the path, and the torque that a log misses),
`learnt_torque` (the law that adds it), then `learning` (the part of it that is f and friction) and
`learn`; `settings` has their numbers.
"""

from ctc.learning.learning import Learning
from ctc.learning.path_plant import exponentials, path_plant, standing

__all__ = ["Learning", "exponentials", "path_plant", "standing"]

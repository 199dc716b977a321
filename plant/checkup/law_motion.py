"""The motion of a log, driven by the torque of its law: what shows a law where no torque is logged.

The torque of the right law accelerates inertia and overcomes friction that a motor can have. The
law is run along the beginning of the log.
"""

from typing import Any

import numpy as np

from plant.checkup.along_log import driven, sample_times
from plant.checkup.law_parts import law_torque
from plant.checkup.score import Experiment
from plant.parts import Floats


def driven_by_law(experiment: Experiment) -> Experiment | None:
    """The log with the torque of its law as the logged one; None where it cannot be run."""
    along = experiment.torque_along
    if along is None:
        return None
    return _driven(experiment, experiment.record.rig.drive.motor_torque(along))


def driven_without_limit(experiment: Experiment) -> Experiment | None:
    """The same with amplifiers that limit nothing; None of a law that is not examined, too."""
    along = experiment.once(law_torque)
    return None if along is None else _driven(experiment, along.torque)


def _driven(experiment: Experiment, torque: Floats) -> Experiment | None:
    """The beginning of the log with this motor torque (K, n) as the logged one."""
    signals = experiment.signals
    times = sample_times(signals, len(torque))
    # A filter of the law begins at rest: its first samples are another motion's.
    record = experiment.record.cut(times[signals.window], times[-1])
    by_law = Experiment(driven(record, signals, torque))
    return by_law if by_law.long_enough and by_law.motions is not None else None


def unexplained(experiment: Experiment) -> Floats:
    """Share (n,) of the torque that the motion leaves unexplained."""
    return np.array([motion.unexplained for motion in experiment.motions or ()])


def likelier_motion(experiment: Experiment, record: Any) -> float:
    """How much likelier the motion of a log is with a changed law, rig or reference: log odds."""
    changed = experiment.changed(record)
    if not experiment.has_memory:
        return changed.score - experiment.score
    stated, corrected = (each.once(driven_by_law) for each in (experiment, changed))
    if stated is None or corrected is None:
        return -np.inf
    return corrected.score - stated.score

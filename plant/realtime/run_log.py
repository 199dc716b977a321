"""What a running controller does, appended to an MCAP file sample by sample."""

import time
from pathlib import Path
from typing import Any

from plant.parts.files import require_new
from plant.parts.mcap_file import STATUS, McapFile, joint_topics
from plant.realtime import memory as layout

_FAR = 1e17
"""Difference [ns] from the time of the day at which the clock of the calls is not believed: three years."""


class RunLog(McapFile):
    """Log of a controller; closed, it takes no more.

    ``/joint_states`` and ``/reference`` are messages of `sensor_msgs/msg/JointState`, ``/sample`` has counts and torque
    under a record's names, ``/status`` a `std_msgs/msg/String` whenever that changes.
    """

    def __init__(self, path: str | Path, controller: Any) -> None:
        n, self._controller = controller.n, controller
        columns = dict.fromkeys(("reference_pulses", "error_pulses", "torque"), n)
        topics = {**joint_topics(n, columns), **STATUS}
        super().__init__(require_new(path, False), controller.rig.drive.joints, n, topics)
        end = layout.SCALARS + layout.ROWS * n
        self._rows = controller.core.memory[layout.SCALARS : end].reshape(layout.ROWS, n)
        self._offset: float | None = None
        self._changed: tuple[float, ...] = ()

    def sample(self) -> None:
        """Append the sample of the last call, at the time of the day; by the clock of the calls, if they have one."""
        if self._file.closed:
            return
        clock, rows, own = time.time_ns(), self._rows, self._controller.core.memory
        if (now := 1e9 * float(own[layout.NOW])) == now:
            self._offset = clock - now if self._offset is None else self._offset
            clock = int(self._offset + now) if abs(self._offset + now - clock) < _FAR else clock
        clock, torque = max(clock, self._last), rows[layout.TORQUE]
        self.append("/joint_states", clock, (rows[layout.ANGLE], (), torque))
        self.append("/reference", clock, (rows[layout.Q], (), ()))
        asked = rows[layout.REFERENCE]
        self.append("/sample", clock, (asked, asked - rows[layout.COUNTS], torque))
        changed = own[layout.CAUSE], own[layout.RELEASED], own[layout.BRIDGED]
        if changed != self._changed:
            self._changed = changed
            self.append("/status", clock, self._controller.status)

"""The exported controller of ros2_control over all everyday motions: ``python
tests/benchmarks/ros2_control.py``.

Compiled against the stand-in of the interfaces (`tests/oracles/ros2`), fed with what the running
controller in Python reads on the simulated arm; the time of `update` includes the call through
ctypes.
"""

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]

from ros_controller import Controller, array  # noqa: E402

from ctc import ComputedTorque  # noqa: E402
from plant import SteppedArm, everyday_motions, puma560, to_ros2_control  # noqa: E402


def over(controller, law, path):
    """Largest difference of the torque as a share of the largest torque, samples, allocations,
    times of update [s].
    """
    rig = law.rig
    arm = SteppedArm(law.arm, rig, path([0.0]).q[0])
    running, period = law.start(rig, arm.pulses), round(1e9 * rig.period)
    controller.begin(rig.to_angle(arm.pulses.astype(float)), chained=True)
    before, now, worst, largest, times = controller.c.allocations(), 0.0, 0.0, 0.0, []
    steps = round(path.duration / rig.period)
    for motion in zip(*path(rig.period * np.arange(steps))[:3], strict=True):
        now += period / 1e9
        at = rig.to_angle(arm.pulses.astype(float))
        ours = running.step(arm.pulses, *motion, now=now)
        controller.c.give_reference(array(np.concatenate(motion)))
        begun = time.perf_counter()
        _, theirs = controller.update(at, period)
        times.append(time.perf_counter() - begun)
        worst, largest = max(worst, np.abs(ours - theirs).max()), max(largest, np.abs(ours).max())
        arm.step(ours)
    return worst / largest, steps, controller.c.allocations() - before, times


def main():
    law = ComputedTorque(puma560.arm(), puma560.rig())
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        to_ros2_control(law, folder)
        controller = Controller(folder)
        print(
            f"{'motion':28}{'samples':>9}{'difference':>12}{'allocations':>13}{'us per update':>15}"
        )
        for name, path in everyday_motions(law.arm, law.rig).items():
            share, steps, allocations, times = over(controller, law, path)
            print(
                f"{name:28}{steps:9}{share:12.1e}{allocations:13}{1e6 * statistics.median(times):15.1f}",
                flush=True,
            )
        command = [shutil.which("size"), folder / "c.o", folder / "plugin.o"]
        sizes = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603
        print(sizes.stdout)


if __name__ == "__main__":
    main()

"""A running controller that logs to MCAP until it is killed: ``python logged_run.py PATH [BYTES]``.

BYTES is what a file may have at most, in the place of a disk that is full.
"""

import itertools
import resource
import sys
import warnings

from ctc import ComputedTorque
from plant import SteppedArm, puma560


def main():
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law, start = ComputedTorque(arm, rig), path([0.0])
    robot = SteppedArm(arm, rig, start.q[0], start.qd[0])
    controller = law.start(rig, rig.counts(start.q[0]))
    if len(sys.argv) > 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
        warnings.showwarning = lambda message, *_: (print(message, flush=True), sys.exit())
    counts = rig.counts(start.q[0])
    controller.log_to(sys.argv[1])
    print("running", flush=True)
    for k in itertools.count():
        motion = path([k * rig.period % path.duration])
        torque = controller.step(
            counts, motion.q[0], motion.qd[0], motion.qdd[0], now=k * rig.period
        )
        counts = robot.step(torque)


if __name__ == "__main__":
    main()

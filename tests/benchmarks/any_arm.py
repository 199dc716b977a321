"""From the description of an arm to its first second of motion: 2 to 7 joints, and 6 with a coupled
wrist.

Under P and under computed torque.

    python tests/benchmarks/any_arm.py

Each line is a process of its own, first with an empty cache of kernels and then with the one it has
filled.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent

PROGRAM = """
import dataclasses, sys, time
started = time.perf_counter()
import numpy as np
from plant import Chain, Coupling, Drive, Dynamics, Encoder, Harmonics, Link, P, Rig, read_robot, simulate
from ctc import ComputedTorque
imported = time.perf_counter()
n, law, coupled = int(sys.argv[1]), sys.argv[2], sys.argv[3] == "coupled"
robot = read_robot("puma560")
chain, rig = robot.dynamics.chain, robot.rig
if n < 6:
    chain = Chain(links=chain.links[:n], bodies=chain.bodies[:n])
if n > 6:  # another wrist joint, between the fifth and the sixth
    extra = Link(name="5b", alpha=-np.pi / 2, d=0.1, frame=chain.links[4].frame)
    chain = Chain(links=(*chain.links[:5], extra, chain.links[5]), bodies=(*chain.bodies[:5], *chain.bodies[4:]))
pick = [min(i, 5) for i in range(n)]
drive = Drive(**{name: getattr(rig.drive, name)[pick] for name in
                 ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")})
if coupled:  # the last motor turns with the joint before it as well
    wrist = np.eye(n)
    wrist[-1, -2] = 1.0
    chain, drive = chain.coupled(Coupling(matrix=wrist)), dataclasses.replace(drive, coupling=Coupling(matrix=wrist))
rig = Rig(drive=drive, encoder=Encoder(resolution=rig.encoder.resolution[pick]), period=rig.period)
dynamics = Dynamics.from_chain(chain)
arm = dynamics.arm(dynamics.f())
path = Harmonics(period=4.0, offset=(0.0,) * n, cosine=((0.3,),) * n, sine=((0.2,),) * n)
gain = np.array((0.11, 0.07, 0.04, 0.004, 0.004, 0.004))[pick]
law = P(gain=gain) if law == "P" else ComputedTorque(arm, rig)
record = simulate(arm, rig, law, path, duration=1.0)
first = time.perf_counter()
simulate(arm, rig, law, path, duration=1.0)
print(imported - started, first - imported, time.perf_counter() - first, np.abs(record.error_pulses).max())
"""


def run(joints, law, coupling, cache):
    """Seconds of the import, of everything up to the first record, of the second one; and the
    largest error.
    """
    environment = {**os.environ, "ONEPULSE_CACHE": cache, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM, str(joints), law, coupling]
    said = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)  # noqa: S603
    return [float(word) for word in said.stdout.split()]


def table():
    """The lines of the table."""
    yield (
        "| joints | law | empty cache [s] | filled [s] | one more second of motion [s] | largest"
        " error [pulses] |"
    )
    yield "|---|---|---|---|---|---|"
    for joints, coupling in (*((n, "") for n in range(2, 8)), (6, "coupled")):
        for law in ("P", "computed torque"):
            with tempfile.TemporaryDirectory() as cache:
                _, cold, _, error = run(joints, law, coupling, cache)
                _, warm, again, _ = run(joints, law, coupling, cache)
            arm = f"{joints}, wrist coupled" if coupling else f"{joints}"
            yield f"| {arm} | {law} | {cold:.2f} | {warm:.2f} | {again:.3f} | {error:.0f} |"


if __name__ == "__main__":
    for line in table():
        print(line, flush=True)

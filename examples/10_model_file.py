"""A UR5e from its URDF to a verdict, and back: identified from pulses, and its inertials written
into the file.
"""

import tempfile

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import identify, write_model
from plant import Body, Chain, Harmonics, read_robot, simulate

# published lengths and masses; the drives are partly assumed, as noted in the file
robot = read_robot("ur5e")
rig, law, drawn = robot.rig, robot.law, robot.dynamics
random, n = np.random.default_rng(1), 6
waves = random.uniform(-0.4, 0.4, (2, n, 4)) / np.arange(1, 5)
path = Harmonics(period=4.0, offset=(0, -1.2, 1.0, -0.5, 0.8, 0), cosine=waves[0], sine=waves[1])

# The true arm, known to the simulation alone: it carries a tool that is not in the URDF.
tool = Body(mass=1.5, com=(0.02, 0, 0.08), inertia=(2e-3, 0, 0, 2e-3, 0, 1e-3))
truth = drawn.arm(drawn.f(drawn.chain.carrying(tool).bodies))
measured = simulate(truth, rig, law, path)
found = identify(drawn, measured, seed=1, method="equation_error", progress=False)
report = evaluate(truth, rig, ComputedTorque(found), path, backend="numba")
print(report)
assert report.fraction_within(1) > 0.99

with (
    tempfile.TemporaryDirectory() as folder
):  # noise leaves an f that no bodies have exactly, so the nearest is written
    written = write_model(found, robot.model, f"{folder}/ur5e_found.urdf", nearest=True)
    again = Chain.from_urdf(written.path)
mass = (
    sum(body.mass for body in drawn.chain.bodies[1:]),
    sum(body.mass for body in again.bodies[1:]),
)
print(
    f"mass behind the shoulder: {mass[0]:.2f} kg in the file, {mass[1]:.2f} kg written, 1.5 kg of"
    " them the tool's"
)

"""An SO-101 on position servos: from a log of its goals to goals that it follows within counts.

The arm that is simulated has other masses, friction and servos than its robot file says. Twenty
seconds of goals and counts tell which. The figure ``so101.png`` in the folder where this runs shows
the errors of plain goals, and of computed torque through goals, on one motion.
"""

import dataclasses
import sys
import tempfile
from pathlib import Path

import numpy as np

from ctc import ComputedTorque
from identification import identify
from plant import PD, Harmonics, Record, SteppedArm, read_robot

HOME = np.array([0.0, -0.6, 0.5, 0.3, 0.0])
"""Pose around which the arm moves [rad]."""


class Bus:
    """Servos and arm, as a control script sees them: counts are read, goals are sent."""

    def __init__(self, robot, q):
        drive = dataclasses.replace(
            robot.rig.drive,
            viscous=1.1 * robot.rig.drive.viscous,
            coulomb=np.array([0.06, 0.065, 0.05, 0.045, 0.05]),
        )
        self.gain = 0.97 * robot.rig.inner.gain
        # The servos' own loop runs at 1 kHz, ten times in each period of the goals.
        fast = dataclasses.replace(robot.rig, drive=drive, inner=None, period=1e-3)
        self.arm = SteppedArm(robot.dynamics.arm(1.06 * robot.arm.f), fast, q)
        self.steps = round(robot.rig.period / fast.period)

    def read(self):
        return self.arm.pulses

    def write(self, goal):
        for _ in range(self.steps):
            self.arm.step(self.gain * (goal - self.arm.pulses))


def waves(lines, seed):
    """A motion of all joints; `lines`: multiples of 0.05 Hz, and their amplitudes [rad]."""
    shapes = np.random.default_rng(seed).normal(size=(2, len(HOME), max(lines)))
    share = np.zeros(max(lines))
    share[np.array(list(lines)) - 1] = list(lines.values())
    return Harmonics(period=20.0, offset=HOME, cosine=shapes[0] * share, sine=shapes[1] * share)


def follow(robot, law, path, seconds):
    """Times, and goals, counts and errors (N, n), of a control loop over the bus."""
    times = np.arange(0, seconds, robot.rig.period)
    motion = path(times)
    bus = Bus(robot, motion.q[0])
    # Plain goals are far behind: the guards of a start would stop them.
    running = law.start(robot.rig, bus.read(), guards=None)
    goals, counts = np.empty((2, *motion.q.shape))
    for k, state in enumerate(zip(*motion, strict=True)):
        counts[k] = bus.read()
        running.step(counts[k], *state)
        goals[k] = running.goal
        bus.write(goals[k])
    return times, goals, counts, robot.rig.counts(motion.q) - counts


def drawn(times, errors):
    """Errors over time, for each way to send goals."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    for axis, (name, values) in zip(
        figure.subplots(2, 1, sharex=True), errors.items(), strict=True
    ):
        axis.axhspan(-1, 1, color="0.9", zorder=0)
        axis.plot(times, values, lw=0.7)
        axis.set_ylabel("error [counts]")
        axis.set_title(f"{name}: {np.abs(values[100:]).max():.0f} counts at most", loc="left")
    axis.set_xlabel("time [s]")
    return figure


def main(folder="."):
    robot = read_robot("so101")
    nothing = PD(gain=[0] * 5, derivative=[0] * 5, filter=100.0, period=robot.rig.period)

    # 1. Log plain goals for 20 s, and read the file as that of any other program.
    excitation = waves({1: 0.2, 3: 0.15, 6: 0.12, 10: 0.12, 15: 0.1}, seed=1)
    times, goals, counts, _ = follow(robot, nothing, excitation, 20.0)
    with tempfile.TemporaryDirectory() as temporary:
        log = Path(temporary) / "log.csv"
        columns = np.column_stack([times, goals, goals - counts])
        np.savetxt(log, columns, delimiter=",", fmt="%.10g")
        below = dataclasses.replace(robot.rig, inner=None)
        record = Record.from_csv(log, rig=below, law=robot.rig.inner, held=True)

    # 2. Identify what the servos and the links really are, in units of the stated gain.
    found = identify(robot.dynamics, record, unknown="friction", progress=False)
    print("Coulomb friction", found.rig.drive.coulomb.round(3), "N m, stated 0.052")

    # 3. Follow another motion.
    path = waves({2: 0.25, 8: 0.15, 12: 0.1}, seed=3)
    errors = {}
    for name, law in (("plain goals", nothing), ("computed torque", ComputedTorque(found))):
        times, *_, errors[name] = follow(robot, law, path, 10.0)
        largest, rms = np.abs(errors[name][100:]).max(), np.std(errors[name][100:])
        print(f"{name:16} largest error {largest:3.0f} counts, {rms:.2f} rms")
    drawn(times, errors).savefig(Path(folder) / "so101.png", dpi=120)
    assert np.abs(errors["plain goals"]).max() > 25
    assert np.abs(errors["computed torque"][100:]).max() <= 3


if __name__ == "__main__":
    main(*sys.argv[1:])

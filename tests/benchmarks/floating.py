"""Float in the hand: an SO-101 and a YAM in MuJoCo, guided at the tool, released, and left alone.

    python tests/benchmarks/floating.py [--only so101,yam] [--seconds 8]

Arms, friction and truths are those of `servos.py`. The hand is a spring and a damper between the
tool and a point that moves on a line, +-6 cm at up to 0.15 m/s (YAM: +-10 cm, 0.2 m/s), along x, y
and z, all within the reach of the arm. It lets go where it turns back: at once, while the arm still
moves, and after it has stopped for half a second. Columns: RMS and peak of its force [N], over the
three lines and along each; counts that a joint moves in the 1.5 s after the hand lets go, of an arm
at rest and of one in motion; its speed in the last half second [counts/s].

What the law knows of gravity and friction is stated as an identification leaves it (`KNOWN`); of a
bare arm it assumes 5 % and 30 %.

SO-101: limp is a servo whose torque is switched off, without back-EMF. The law sends duties (100 Hz)
or goals at P = 8. YAM: torques in frames with kp = kd = 0, at 500 Hz.
"""

import argparse
import dataclasses
import warnings

import mujoco
import numpy as np
from servos import (
    SERVO_GAIN,
    SO101,
    YAM,
    YAM_GEARS,
    YAM_POSE,
    Machine,
    believed,
    so101,
    table,
    yam,
)

from ctc import Float, FloatSettings
from plant import PositionServo

# Of the hand [N/m], [N s/m].
SPRING, DAMPER = 150.0, 10.0
RELEASE = 1.5  # time after it that is simulated [s]
PAUSE = 0.5  # time for which the hand holds the arm before it lets go [s]

KNOWN = FloatSettings(gravity=0.005, friction=0.1)

# The wrist is bent: a stretched arm cannot follow a line along x.
HAND_POSE = np.array([0.0, -0.3, 0.0, 1.2, 0.0])


@dataclasses.dataclass
class Hand:
    """A hand at a point of the last body, that moves it along an axis of the world."""

    machine: Machine
    point: np.ndarray
    axis: int
    reach: float
    speed: float

    def __post_init__(self):
        data = self.machine.data
        mujoco.mj_forward(self.machine.model, data)
        self.body = self.machine.model.nbody - 1
        self.start = self.tool()

    def tool(self):
        data = self.machine.data
        return data.xpos[self.body] + data.xmat[self.body].reshape(3, 3) @ self.point

    def hold(self, time):
        """Apply the force of the hand at this time [s]."""
        model, data = self.machine.model, self.machine.data
        place, pace = self.start.copy(), np.zeros(3)
        # The first second grows from rest.
        share = min(time, 1.0)
        angle = time * self.speed / self.reach
        place[self.axis] += share * self.reach * np.sin(angle)
        pace[self.axis] = share * self.speed * np.cos(angle)
        jacobian = np.zeros((3, model.nv))
        tool = self.tool()
        mujoco.mj_jac(model, data, jacobian, None, tool, self.body)
        force = SPRING * (place - tool) + DAMPER * (pace - jacobian @ data.qvel)
        data.xfrc_applied[self.body, :3] = force
        data.xfrc_applied[self.body, 3:] = np.cross(tool - data.xipos[self.body], force)
        return np.linalg.norm(force)

    def release(self):
        self.machine.data.xfrc_applied[:] = 0


def guided(make, law, hand_of, pose, seconds, gain=None, pause=0.0):
    """Forces (K,) [N], counts moved after the release (n,), and speed [counts/s] at the end (n,)."""
    forces = []
    machine = make()
    machine.place(pose, np.zeros(len(pose)))
    hand = hand_of(machine)
    running = None if law is None else law.start(law.rig, machine.counts, guards=None)
    period = 0.01 if law is None else law.rig.period
    steps = max(1, round(1e-3 / machine.step))
    counts = [machine.counts]
    # It lets go where it turns back, at either end of its line.
    half = np.pi * hand.reach / hand.speed
    end = half * (0.5 + max(2, int(seconds / half)))
    for k in range(round((end + pause + RELEASE) / period)):
        read = machine.counts
        counts.append(read)
        goal = torque = np.zeros(len(pose))
        if running is not None:
            motion = law.rig.cell_centre(read)
            torque = running.step(read, motion, np.zeros(len(pose)), np.zeros(len(pose)))
            goal = read if gain is None else running.goal
        for j in range(round(period / (steps * machine.step))):
            time = k * period + j * steps * machine.step
            if time < end:
                forces.append(hand.hold(time))
            elif time < end + pause:
                hand.hold(end)
            else:
                hand.release()
            applied = torque if gain is None else gain * (goal - machine.counts)
            for _ in range(steps):
                machine.advance(applied)
    counts = np.array(counts)
    released = round((end + pause) / period)
    late = round(0.5 / period)
    return (
        np.array(forces[len(forces) // 8 :]),
        counts[-1] - counts[released],
        np.abs(counts[-1] - counts[-late]) / 0.5,
    )


def rms(forces):
    return np.sqrt(np.mean(forces**2))


def cell(moving, resting):
    """Cells of a row: results of the three lines, released in motion and at rest."""
    forces = [forces for forces, _, _ in moving]
    of_all = np.concatenate(forces)
    return [
        f"{rms(of_all):.2f} / {of_all.max():.1f}",
        ", ".join(f"{rms(force):.2f}" for force in forces),
        *(
            f"{max(np.abs(way).max() for _, way, _ in results):.0f}"
            for results in (resting, moving)
        ),
        f"{max(speed.max() for _, _, speed in (*moving, *resting)):.0f}",
    ]


def rows_of(make, cases, hand_of, pose, seconds):
    """Rows of the table: name, law, gain of the servos (None: torques), mass and Coulomb factors."""
    rows = []
    for name, law, gain, mass, coulomb in cases:

        def machine(mass=mass, coulomb=coulomb, limp=law is None):
            return make((mass, coulomb, 1.0, 1.0, 0.0, 0.0), limp)

        moving, resting = (
            [guided(machine, law, hand_of(axis), pose, seconds, gain, pause) for axis in range(3)]
            for pause in (0.0, PAUSE)
        )
        rows.append((name, cell(moving, resting)))
        print(rows[-1], flush=True)
    return rows


COLUMNS = [
    "hand force, RMS / peak [N]",
    "RMS along x, y, z",
    "moved after release at rest",
    "in motion [counts]",
    "at the end [counts/s]",
]


def bare(arm, rig):
    """What `Float` says of an arm without identification."""
    try:
        Float(arm, rig)
    except ValueError as refusal:
        return str(refusal)
    return "accepted"


def run_so101(seconds):
    def make(truth, limp):
        machine = so101("S0")
        fields = {"viscous": np.full(5, 0.059)} if limp else {"viscous": machine.viscous}
        return dataclasses.replace(machine, truth=truth, **fields)

    arm, rig = believed(so101("S0"), SO101, 0.01, None)
    gain = 8 * SERVO_GAIN
    goals = dataclasses.replace(rig, inner=PositionServo(gain=gain))
    cases = [
        ("limp", None, None, 1.0, 1.0),
        ("duties, gravity alone", Float(arm, rig, assist=0.0, settings=KNOWN), None, 1.0, 1.0),
        ("duties, assist 0.7", Float(arm, rig, settings=KNOWN), None, 1.0, 1.0),
        ("goals at P = 8, assist 0.7", Float(arm, goals, settings=KNOWN), gain, 1.0, 1.0),
        ("duties, assist 0.7, 5 % heavier", Float(arm, rig, settings=KNOWN), None, 1.05, 1.0),
        ("goals, assist 0.7, 5 % heavier", Float(arm, goals, settings=KNOWN), gain, 1.05, 1.0),
        # What a bare arm may have at most.
        ("duties, assist 0.18, 5 % heavier", Float(arm, rig, assist=0.18), None, 1.05, 1.0),
        ("duties, assist 0.7, friction x 0.7", Float(arm, rig, settings=KNOWN), None, 1.0, 0.7),
        ("goals, assist 0.7, friction x 0.7", Float(arm, goals, settings=KNOWN), gain, 1.0, 0.7),
    ]

    def hand_of(axis):
        return lambda machine: Hand(machine, np.array([-0.0079, 0, -0.098]), axis, 0.06, 0.15)

    table("SO-101 in the hand, 100 Hz", COLUMNS, rows_of(make, cases, hand_of, HAND_POSE, seconds))
    print("\nA bare SO-101:", bare(arm, rig))


def run_yam(seconds):
    def make(truth, limp):
        return dataclasses.replace(yam("S0"), truth=truth)

    arm, rig = believed(yam("S0"), YAM, 0.002, None, gear=YAM_GEARS)
    cases = [
        ("limp", None, None, 1.0, 1.0),
        ("gravity alone", Float(arm, rig, assist=0.0, settings=KNOWN), None, 1.0, 1.0),
        ("assist 0.7", Float(arm, rig, settings=KNOWN), None, 1.0, 1.0),
        ("assist 0.7, 5 % heavier", Float(arm, rig, settings=KNOWN), None, 1.05, 1.0),
        ("assist 0.7, friction x 0.7", Float(arm, rig, settings=KNOWN), None, 1.0, 0.7),
    ]

    def hand_of(axis):
        return lambda machine: Hand(machine, np.array([0, 0, 0.1347]), axis, 0.1, 0.2)

    table("YAM in the hand, 500 Hz", COLUMNS, rows_of(make, cases, hand_of, YAM_POSE, seconds))
    print("\nA bare YAM:", bare(arm, rig))


PARTS = {"so101": run_so101, "yam": run_yam}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="parts, separated by commas")
    parser.add_argument("--seconds", type=float, default=8.0, help="longest guidance [s]")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for name in options.only.split(","):
        PARTS[name](options.seconds)


if __name__ == "__main__":
    main()

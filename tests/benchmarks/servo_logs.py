"""Identification of an SO-101 from 20 s of goals and counts, at the rates of its bus.

    python tests/benchmarks/servo_logs.py [--only 100,50,30,30in90,gain]

The arm of `servos.py` runs in MuJoCo (truth S0) with its loops at 1 kHz; only goals and counts
are logged. The servo's gain is stated. The torque that is found is held against the true one on
another motion (0.4 rad, 0.5 to 0.7 Hz, five joints), the worst joint, in counts of goal: RMS of the
whole, of gravity alone, and the ratios of viscous and Coulomb friction to the true ones.
"""

import argparse
import dataclasses
import time
import warnings

import numpy as np
from servos import POSE, SERVO_GAIN, SO101, Servos, believed, motions, so101

from identification import identify
from plant import Harmonics, Held, PositionServo, Record

GAIN = 32 * SERVO_GAIN
SECONDS = 20.0


def wide_motion(n, seed=1):
    """Goals that excite all joints: five harmonics of 0.05 Hz up to 0.75 Hz."""
    random = np.random.default_rng(seed)
    lines = np.zeros((2, n, 15))
    chosen = [0, 2, 5, 9, 14]
    lines[:, :, chosen] = random.normal(size=(2, n, 5)) * np.array([0.2, 0.15, 0.12, 0.12, 0.1])
    return Harmonics(period=20.0, offset=POSE, cosine=lines[0], sine=lines[1])


def servo_log(period, goals_every=1, seconds=SECONDS, machine=None):
    """Times, goals and counts (N, n) of a motion, read before each goal is sent."""
    machine = so101("S0") if machine is None else machine
    path = wide_motion(len(SO101))
    servos = Servos(machine, GAIN)
    times = np.arange(round(seconds / period)) * period
    machine.place(path(np.zeros(1)).q[0], np.zeros(len(SO101)))
    wanted = np.floor(path(times).q * machine.counts_per_radian)
    goals = np.empty_like(wanted)
    counts = np.empty_like(wanted)
    goal = wanted[0]
    for k in range(len(times)):
        counts[k] = machine.counts
        if k % goals_every == 0:
            goal = wanted[k]
        goals[k] = goal
        servos.run(goal, period)
    return times, goals, counts


def record_of(rig, servo, times, goals, counts):
    return Record(
        t=times,
        reference_pulses=goals,
        error_pulses=goals - counts,
        rig=rig,
        law=servo,
        reference=Held(times=times, points=rig.cell_centre(goals)),
    )


def torques(arm, rig, motion):
    """Torque and gravity (N, n) of a motion [N m], of the motors, back-EMF as friction."""
    moving = np.array([arm.inverse(*row) for row in zip(*motion, strict=True)])
    gravity = np.array([arm.inverse(q, 0 * q, 0 * q) for q in motion.q])
    return moving + np.array([rig.drive.friction(qd) for qd in motion.qd]), gravity


def judged(found, arm, rig, scale=1.0):
    """Errors of an identification in counts of goal, and ratios of friction, of all joints.

    `scale`: what the stated gain is too high by, and all torques with it.
    """
    path = motions(POSE, 0.0, (5, 6, 7))["fast"][0]
    motion = path(np.linspace(0, 10, 400))
    truth = torques(arm, rig, motion)
    model = torques(found.arm, found.rig, motion)
    counts = [
        np.sqrt(((scale * right - guess) ** 2).mean(axis=0)) / (scale * GAIN)
        for right, guess in zip(truth, model, strict=True)
    ]
    shares = [
        getattr(found.rig.drive, name) / getattr(rig.drive, name) / scale
        for name in ("viscous", "coulomb")
    ]
    return [*counts, *shares]


def shown(values):
    return f"{values.min():.2f} to {values.max():.2f}"


# Row of the table: period of the reads [ms], a whole number of the servo's; reads per goal; gain stated over the true one, fields of
# the machine.
CASES = {
    "100": (10, 1, 1.0, {}),
    "50": (20, 1, 1.0, {}),
    "30": (33, 1, 1.0, {}),
    "30in90": (11, 3, 1.0, {}),
    "gain": (10, 1, 1.3, {}),
}


def run(name):
    milliseconds, every, scale, fields = CASES[name]
    period = milliseconds / 1e3
    servo = PositionServo(gain=scale * GAIN)
    arm, rig = believed(so101("S0"), SO101, period, None)
    open_drive = dataclasses.replace(rig.drive, viscous=None, coulomb=None)
    rig_open = dataclasses.replace(rig, drive=open_drive)
    times, goals, counts = servo_log(period, every, machine=so101("S0", **fields))
    record = record_of(rig_open, servo, times, goals, counts)
    begin = time.perf_counter()
    try:
        found = identify(arm.dynamics, record, unknown="friction", progress=False)
    except ValueError as error:
        return [f"refused: {error}"[:160]] + [""] * 4
    seconds = time.perf_counter() - begin
    return [shown(values) for values in judged(found, arm, rig, scale)] + [
        f"{seconds:.0f} s; {found.warnings}"[:700]
    ]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(CASES), help="rows, separated by commas")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| log | torque [counts] | gravity [counts] | viscous | Coulomb | remarks |")
    print("|---|---|---|---|---|---|")
    for name in options.only.split(","):
        print(f"| {name} | {' | '.join(run(name))} |", flush=True)


if __name__ == "__main__":
    main()

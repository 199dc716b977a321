"""From the description of an arm to its first second of motion, and from a log to its controller.

    python tests/benchmarks/any_arm.py                # 2 to 7 joints, and 6 with a coupled wrist
    python tests/benchmarks/any_arm.py lift stand     # machines of other engines: ten minutes

Without arguments, each line is a process of its own, under P and under computed torque, first with
an empty cache of kernels and then with the one it has filled.

`lift`: a vertical slide and two joints in MuJoCo, a cascade at 1 kHz, currents with 20 mA of noise.
`stand`: three joints, one with a spring that carries its weight, by `own_engine` with Runge and
Kutta's method at 1/80 of a sample; its cascade runs at 4 kHz, and every fourth sample is logged.
Both go from a CSV and a robot file to the controller. Printed: causes that `record.check()` names,
doubts of `identify`, each value in its deviations, and the share of samples of everyday motions in
which computed torque, started with the identification, keeps the machine within a count.
"""

import dataclasses
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import mujoco
import numpy as np
from numba import njit

from ctc import ComputedTorque
from identification import identify
from plant import Body, Record, everyday_motions, read_robot

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))

import own_engine as engine
from machine_plans import LIFT, STAND, gains
from random_rigs import bodies_of

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


SECONDS = 5.0


class MujocoArm:
    """A plan in MuJoCo; friction is its own constraint."""

    def __init__(self, plan, start):
        hard = "solreffriction='0.0002 1' solimpfriction='0.9999 0.9999 0.001'"
        text = ""
        for i, (link, body) in enumerate(zip(plan.chain.links, plan.chain.bodies, strict=True)):
            xx, xy, xz, yy, yz, zz = body.inertia
            text += (
                f"<body pos='{link.a} 0 0' euler='{link.alpha} 0 0'>"
                f"<joint type='{'slide' if link.prismatic else 'hinge'}' axis='0 0 1'"
                f" armature='{plan.rotor[i]}' damping='{plan.viscous[i]}'"
                f" frictionloss='{plan.coulomb[i]}' {hard}/>"
                f"<inertial pos='{' '.join(map(str, body.com))}' mass='{body.mass}'"
                f" fullinertia='{xx} {yy} {zz} {xy} {xz} {yz}'/>"
            )
        self.step_size = plan.speed_period / 40
        self.model = mujoco.MjModel.from_xml_string(
            "<mujoco><compiler angle='radian'/>"
            f"<option timestep='{self.step_size}' gravity='0 0 -9.81' integrator='implicitfast'"
            f" tolerance='1e-12'/><worldbody>{text}{'</body>' * plan.chain.n}"
            "</worldbody></mujoco>"
        )
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:], self.data.qvel[:] = start

    @property
    def q(self):
        """Positions (n,)."""
        return self.data.qpos.copy()

    def step(self, torque, seconds):
        """Hold a torque (n,) for some seconds."""
        self.data.qfrc_applied[:] = torque
        mujoco.mj_step(self.model, self.data, nstep=round(seconds / self.step_size))


@njit(cache=True)
def _rates(bodies, machine, q, v, torque):
    held = engine.inverse(bodies, q, v, np.zeros(len(q)), bodies.gravity)
    held += machine.spring * (q - machine.rest) + machine.viscous * v
    # Dry friction over a creep of 1e-4 rad/s, a hundredth of a count per sample.
    held += machine.coulomb * np.tanh(v / 1e-4)
    return np.linalg.solve(engine.inertia(bodies, machine.rotor, q), torque - held)


@njit(cache=True)
def _runge_kutta(bodies, machine, q, v, torque, h, steps):
    for _ in range(steps):
        a1 = _rates(bodies, machine, q, v, torque)
        v2 = v + h / 2 * a1
        a2 = _rates(bodies, machine, q + h / 2 * v, v2, torque)
        v3 = v + h / 2 * a2
        a3 = _rates(bodies, machine, q + h / 2 * v2, v3, torque)
        v4 = v + h * a3
        a4 = _rates(bodies, machine, q + h * v3, v4, torque)
        q = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return q, v


class RungeKuttaArm:
    """A plan by the equations of `own_engine`."""

    def __init__(self, plan, start):
        zero = np.zeros(plan.chain.n)
        self.bodies = bodies_of(plan.chain)
        self.machine = engine.Machine(
            rotor=plan.rotor,
            viscous=plan.viscous,
            coulomb=plan.coulomb,
            spring=plan.stiffness,
            rest=plan.rest,
            limit=zero,
            counts=plan.counts,
            shift=zero,
        )
        self.q, self.v = (np.array(each, float) for each in start)

    def step(self, torque, seconds):
        """Hold a torque (n,) for some seconds."""
        steps = round(80 * seconds / 1e-3)
        self.q, self.v = _runge_kutta(
            self.bodies, self.machine, self.q, self.v, torque, seconds / steps, steps
        )


def csv_of(plan, machine, file):
    """Write the log of a machine under its cascade; see `Cascade` for the order of its steps."""
    position, speed, integral = gains(plan)
    period = plan.speed_period
    every = round(1e-3 / period)
    random = np.random.default_rng(5)
    arm = machine(plan, [signal[0] for signal in plan.path([0.0])[:2]])
    total = np.zeros(plan.chain.n)
    counts = np.floor(arm.q * plan.counts)
    before = [counts, counts]
    rows = []
    for k in range(round(SECONDS / period)):
        t = k * period
        q = plan.path([t]).q[0]
        counts = np.floor(arm.q * plan.counts)
        # The speed is a difference over two samples.
        slow = position * (q * plan.counts - counts) - (counts - before[0]) / (2 * period)
        before = [before[1], counts]
        total += period * integral * slow
        motor = speed * slow + total
        if k % every == 0:
            current = motor / plan.motor_gain + plan.noise * random.normal(size=plan.chain.n)
            rows.append([1e3 * t, *counts, *q, *current.round(4)])
        arm.step(plan.gear * motor, period)
    names = [link.name for link in plan.chain.links]
    header = ",".join(
        ["time", *names, *(f"{name}_ref" for name in names), *(f"{name}_i" for name in names)]
    )
    np.savetxt(file, rows, delimiter=",", header=header, comments="", fmt="%.10g")
    return np.array(rows)


def robot_file(plan):
    """The data sheet as a robot file: friction is guessed."""
    names = [link.name for link in plan.chain.links]
    position, speed, integral = (list(map(float, gain)) for gain in gains(plan))
    links = "".join(
        f'[[arm.links]]\nname = "{link.name}"\nalpha = {link.alpha}\na = {link.a}\nd = {link.d}\n'
        f"prismatic = {str(link.prismatic).lower()}\n"
        for link in plan.chain.links
    )
    springs = ""
    if plan.stiffness.any():
        springs = (
            '[rig.springs]\nkind = "plant.JointSpring"\n'
            f"stiffness = {(plan.stiffness).tolist()}\nangle = {plan.rest.tolist()}\n"
        )
    return f"""
[rig]
period = 1e-3
{springs}
[drive]
gear = {(plan.gear).tolist()}
motor_inertia = {(plan.rotor / plan.gear**2).tolist()}
motor_gain = {(plan.motor_gain).tolist()}
current_limit = [40.0, 40.0, 40.0]
viscous = {(1.4 * plan.viscous / plan.gear**2).tolist()}
coulomb = {(0.7 * plan.coulomb / np.abs(plan.gear)).tolist()}

[encoder]
resolution = {(plan.resolution).tolist()}

{links}
[law]
kind = "plant.Cascade"
position = {position}
speed = {speed}
integral = {integral}
difference = 2
period = {plan.speed_period}

[columns]
t = "time"
counts = {names}
reference_position = {[f"{name}_ref" for name in names]}
current = {[f"{name}_i" for name in names]}

[units]
t = "ms"
reference_position = {["m" if link.prismatic else "rad" for link in plan.chain.links]}
current = "A"
""".replace("'", '"')


def truth_of(plan, dynamics):
    """True values of f, then of friction, motor side."""
    bodies = [
        Body(mass=body.mass, com=body.com, inertia=body.inertia, rotor=rotor)
        for body, rotor in zip(plan.chain.bodies, plan.rotor, strict=True)
    ]
    return np.concatenate(
        [dynamics.f(bodies), plan.viscous / plan.gear**2, plan.coulomb / np.abs(plan.gear)]
    )


def followed(plan, machine, found, motion):
    """Errors (N, n) [counts] of the machine under computed torque on a motion."""
    period = found.rig.period
    path = motion(np.arange(0, motion.duration, period))
    arm = machine(plan, [path.q[0], 0 * path.q[0]])
    counts = np.floor(arm.q * plan.counts)
    controller = ComputedTorque(found).start(found.rig, counts)
    errors = []
    for q, qd, qdd in zip(path.q, path.qd, path.qdd, strict=True):
        counts = np.floor(arm.q * plan.counts)
        errors.append(found.rig.counts(q) - counts)
        arm.step(controller.step(counts, q, qd, qdd), period)
    return np.array(errors)


def one(name, plan, machine):
    """Print what a user sees of a machine."""
    with tempfile.TemporaryDirectory() as folder:
        csv_of(plan, machine, f"{folder}/log.csv")
        Path(f"{folder}/arm.toml").write_text(robot_file(plan))
        robot = read_robot(f"{folder}/arm.toml")
        record = Record.from_csv(
            f"{folder}/log.csv",
            rig=robot.rig,
            law=robot.law,
            columns=robot.columns,
            units=robot.units,
        )
    # Its controller subtracts the counts from a reference that it does not round.
    reference = record.rig.position_in_pulses(record.reference(record.t - record.t[0]).q)
    record = dataclasses.replace(
        record, reference_pulses=reference, error_pulses=reference - record.counts
    )
    print(f"{name}: largest error {np.abs(record.error_pulses).max(axis=0)} counts")
    print("  check:", [str(cause) for cause in record.check().causes])
    joints = range(plan.chain.n)
    friction = [f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in joints]
    begun = time.perf_counter()
    found = identify(
        robot.dynamics, record, unknown=(*robot.dynamics.names, *friction), progress=False
    )
    z = (found.fit.values - truth_of(plan, robot.dynamics)) / found.fit.std
    print(
        f"  identify: {time.perf_counter() - begun:.0f} s, innovation"
        f" {found.fit.rms_innovation:.3f}, z rms {np.sqrt(np.mean(z**2)):.2f},"
        f" largest {np.abs(z).max():.1f} of {found.fit.unknown[int(np.abs(z).argmax())]}"
    )
    print("  z:", z.round(1).tolist())
    for line in found.warnings:
        print("  warning:", line)
    print("  doubts:", found.doubts, flush=True)
    within, samples = 0, 0
    for label, motion in everyday_motions(found.arm, found.rig).items():
        errors = np.abs(followed(plan, machine, found, motion))
        within += (errors <= 1).all(axis=1).sum()
        samples += len(errors)
        print(
            f"  {label}: {len(errors)} samples, largest {errors.max(axis=0)},"
            f" {(errors <= 1).all(axis=1).mean():.3%} within one",
            flush=True,
        )
    print(f"  everyday: {within / samples:.3%} of {samples} samples within one count", flush=True)


def main():
    """The machines that are named, or the table."""
    machines = {"lift": (LIFT, MujocoArm), "stand": (STAND, RungeKuttaArm)}
    for name in sys.argv[1:]:
        one(name, *machines[name])
    if not sys.argv[1:]:
        for line in table():
            print(line, flush=True)


if __name__ == "__main__":
    main()

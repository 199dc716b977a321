"""Arms whose torque is not ours: an SO-101 on position servos and a YAM on MIT frames, in MuJoCo.

    python tests/benchmarks/servos.py [--only so101,sides,yam,elastic,openarm,late,bandwidths] [--seconds 10]

The arm is MuJoCo's, the inner loops run at their own rates in this file, and only counts, goals and
frames cross between both and the running controller of the library. A cell is the peak and the RMS
of the true joint error of the worst joint, in counts, and the share of samples within one count.

Truth beside what the law believes, of SO-101 and YAM alike; friction and gain of the law are those
of S0:

* S0: nothing differs;
* S1, as after an identification: masses +2 %, Coulomb -10 %, servo gain -2 %, viscous +5 %, and
  unknown to the law load friction 0.05 and a Stribeck excess of 0.15;
* S2, as of a data sheet: masses -5 %, Coulomb +25 %, gain +5 %, viscous +10 %, load friction 0.10,
  Stribeck excess 0.3.

Nothing is random but the zeros of the encoders (seed 0). SO-101: inertia of the public model
(TheRobotStudio/SO-ARM100, Apache-2.0); STS3215 at 7.4 V, output side: kt 1.212 N m/A, 2.676 ohm,
Coulomb 0.052 N m, viscous 0.059 N m s/rad beside kt^2/R, rotor 0.0284 kg m^2 (Rhoban/bam), P = 32.
YAM: inertia of the public model (i2rt-robotics/i2rt, MIT), DM4340 and DM4310, rotors 0.032 and
0.006 kg m^2, Coulomb 0.3 and 0.06 N m; one count is 25/65535 rad.
"""

import argparse
import dataclasses
import tempfile
import warnings
from pathlib import Path

import mujoco
import numpy as np

from ctc import ComputedTorque, FeedForward, PDGravity
from plant import (
    PD,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    MitDrive,
    PointToPoint,
    PositionServo,
    Rig,
    Transport,
    read_robot,
)

# Body of each joint: position, orientation, mass, centre, inertia (full), all as MJCF has them.
SO101 = (
    ("pan", "0.0388353 0 0.0624", "0 0 -1 0", 0.100006, "-0.0307604 -1.7e-05 -0.0252713",
     (8.3759e-05, 8.10403e-05, 2.39783e-05, 7.55525e-08, -1.16342e-06, 1.54663e-07)),
    ("lift", "-0.0303992 -0.0182778 -0.0542", "1 -1 -1 -1", 0.103, "-0.089847 -0.008382 0.018409",
     (4.08002e-05, 0.000147318, 0.000142487, -1.97819e-05, -4.03016e-08, 8.97326e-09)),
    ("elbow", "-0.11257 -0.028 0", "1 0 0 1", 0.104, "-0.098070 0.0032438 0.018283",
     (2.87438e-05, 0.000159844, 0.00014529, 7.41152e-06, 1.26409e-06, -4.90188e-08)),
    ("wrist", "-0.1349 0.0052 0", "1 0 0 -1", 0.079, "-0.000103312 -0.0386143 0.0281156",
     (3.68263e-05, 2.5391e-05, 2.1e-05, 1.7893e-08, -5.28128e-08, 3.6412e-06)),
    # The gripper with its moving jaw.
    ("roll", "0 -0.0611 0.0181", "0.0172091 -0.0172091 0.706897 0.706897", 0.099,
     "0.00244 -0.00095 -0.0244", (4.1e-05, 4.9e-05, 4.3e-05, 0.0, -5.7e-06, 0.0)),
)  # fmt: skip
YAM = (
    ("joint1", "0 0 0.0631", "1 0 0 1", 0.12415, "-0.00192861 -0.00795735 0.0208176",
     (1.2e-4, 1.2e-4, 1.4e-4, 0.0, 0.0, 0.0)),
    ("joint2", "0 -0.02 0.0409", "1 1 1 1", 1.24434, "0.132008 0 0.000293",
     (6.83e-4, 0.01219, 0.01213, 0.0, 0.0, 0.0)),
    ("joint3", "0.264 0 0", "0 1 0 0", 0.853698, "-0.121816 -0.054846 -0.000111",
     (7.88e-4, 0.006997, 0.006961, 0.0, 0.0, 0.0)),
    ("joint4", "-0.245 -0.06 0", "1 0 0 0", 0.463511, "-0.0769778 -0.0527104 0.000155",
     (2.82e-4, 7.92e-4, 7.45e-4, 0.0, 0.0, 0.0)),
    ("joint5", "-0.074 -0.0395 0", "1 -1 1 1", 0.350962, "0 0.00025665 0.0353526",
     (1.98e-4, 1.78e-4, 1.47e-4, 0.0, 0.0, 0.0)),
    # The gripper with its fingers.
    ("joint6", "0 0.0353 0.0395", "1 -1 0 0", 0.695, "0 0 0.045",
     (7e-4, 7e-4, 4e-4, 0.0, 0.0, 0.0)),
)  # fmt: skip

MASS, COULOMB, GAIN, VISCOUS, LOAD, STRIBECK = range(6)
TRUTHS = {
    "S0": (1.0, 1.0, 1.0, 1.0, 0.0, 0.0),
    "S1": (1.02, 0.9, 0.98, 1.05, 0.05, 0.15),
    "S2": (0.95, 1.25, 1.05, 1.10, 0.10, 0.3),
}

# Speed at which the Stribeck excess has fallen to 1/e [rad/s].
STRIBECK_SPEED = 0.1


def mjcf(rows, rotors, mass=1.0, stiffness=None, step=1e-4):
    """The arm as MJCF; with a stiffness each joint is a motor and a spring behind it."""
    text = ""
    for i, (name, place, turn, weight, centre, inertia) in enumerate(rows):
        full = " ".join(str(mass * value) for value in inertia)
        text += (
            f"<body name='{name}' pos='{place}' quat='{turn}'>"
            f"<joint name='{name}' axis='0 0 1' armature='{rotors[i]}'/>"
        )
        if stiffness is not None:
            # A damping ratio of about 0.02 with the rotor.
            damping = 0.04 * np.sqrt(stiffness[i] * rotors[i])
            text += (
                f"<joint name='{name}_gear' axis='0 0 1' stiffness='{stiffness[i]}'"
                f" damping='{damping}'/>"
            )
        text += f"<inertial pos='{centre}' mass='{mass * weight}' fullinertia='{full}'/>"
    option = (
        f"<option timestep='{step}' integrator='implicitfast'><flag refsafe='disable'/></option>"
    )
    ends = "</body>" * len(rows)
    return f"<mujoco><compiler angle='radian'/>{option}<worldbody>{text}{ends}</worldbody></mujoco>"


@dataclasses.dataclass
class Machine:
    """An arm in MuJoCo with its inner loops; friction, gain and masses are those of a truth."""

    rows: tuple
    rotors: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    torque_limit: np.ndarray
    counts_per_radian: np.ndarray
    truth: tuple
    stiffness: np.ndarray | None = None
    step: float = 2.5e-4

    def __post_init__(self):
        text = mjcf(self.rows, self.rotors, self.truth[MASS], self.stiffness, self.step)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        every = 1 if self.stiffness is None else 2
        self.motors = np.arange(len(self.rows)) * every
        self.viscous = self.truth[VISCOUS] * self.viscous
        self.model.dof_damping[self.motors] += self.viscous
        # Dry friction as hard as the step allows.
        self.model.dof_solref[:] = (2 * self.step, 1)
        self.model.dof_solimp[:, :2] = 0.9999
        self.zero = np.random.default_rng(0).uniform(0, 1, len(self.rows))

    def place(self, q, qd):
        """Put the arm at q, qd (n,), with its gears bent by the weight at rest."""
        self.data.qpos[self.motors] = q
        mujoco.mj_forward(self.model, self.data)
        if self.stiffness is not None:
            gears = self.motors + 1
            self.data.qpos[gears] = -self.data.qfrc_bias[gears] / self.stiffness
        self.data.qvel[self.motors] = qd

    @property
    def q(self):
        return self.data.qpos[self.motors]

    @property
    def counts(self):
        """Counts as the host reads them; their zeros are the law's, to a share of a count."""
        return np.floor(self.q * self.counts_per_radian)

    def advance(self, torque):
        """One step of MuJoCo under a motor torque (n,)."""
        torque = np.clip(torque, -self.torque_limit, self.torque_limit)
        speed = self.data.qvel[self.motors]
        level = self.coulomb * self.truth[COULOMB]
        excess = self.truth[STRIBECK] * level * np.exp(-((speed / STRIBECK_SPEED) ** 2))
        self.model.dof_frictionloss[self.motors] = level + excess + self.truth[LOAD] * abs(torque)
        self.data.qfrc_applied[self.motors] = torque
        mujoco.mj_step(self.model, self.data)


class Servos:
    """Goals, at 1 kHz: gain times goal minus count."""

    period = 1e-3

    def __init__(self, machine, gain):
        self.machine, self.gain = machine, gain * machine.truth[GAIN]

    def run(self, goal, duration):
        machine = self.machine
        for _ in range(round(duration / self.period)):
            torque = self.gain * (goal - machine.counts)
            for _ in range(round(self.period / machine.step)):
                machine.advance(torque)


class Frames:
    """MIT frames, at 10 kHz: the drive's own 14 bit per turn of the motor, and its own speed."""

    def __init__(self, machine, gears, pole=2000.0):
        self.machine, self.pole = machine, pole
        self.per_radian = 2**14 * gears / (2 * np.pi)
        self.slow = None

    def run(self, frame, duration):
        q_d, qd_d, kp, kd, tau = frame
        machine = self.machine
        for _ in range(round(duration / machine.step)):
            q = (np.floor(machine.q * self.per_radian) + 0.5) / self.per_radian
            if self.slow is None:
                self.slow = q
            change = (1 - np.exp(-self.pole * machine.step)) * (q - self.slow)
            self.slow = self.slow + change
            speed = change / machine.step
            ideal = kp * (q_d - q) + kd * (qd_d - speed) + tau
            machine.advance(machine.truth[GAIN] * ideal)


def follow(running, machine, inner, path, seconds, late=0.0):
    """True errors (N, n) [counts] at the samples, and integer ones; goals come `late` [s]."""
    period = running.period
    times = np.arange(0, seconds, period)
    motion = path(times)
    errors = np.empty((len(times), len(machine.rows)))
    whole = np.empty_like(errors)
    sends = running.rig.inner.sends
    sent = None
    for k in range(len(times)):
        counts = machine.counts
        errors[k] = (motion.q[k] - machine.q) * machine.counts_per_radian
        whole[k] = np.floor(motion.q[k] * machine.counts_per_radian) - counts
        running.step(counts, motion.q[k], motion.qd[k], motion.qdd[k])
        before, sent = sent, getattr(running, sends)
        inner.run(sent if before is None else before, late)
        inner.run(sent, period - late)
    return errors, whole


def cell(errors, whole):
    """Peak, RMS, and share of samples within one count, of the worst joint."""
    rms = np.sqrt((errors**2).mean(axis=0)).max()
    return f"{np.abs(errors).max():.1f} / {rms:.2f} / {(np.abs(whole) <= 1).mean(axis=0).min():.4f}"


def table(title, columns, rows):
    print(f"\n## {title}\n\n| | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}")
    for name, cells in rows:
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


# -- SO-101 ----------------------------------------------------------------------------------------
SERVO_COUNTS = 4096
SERVO_GAIN = 0.0273 / 32  # motor torque per count and unit of P [N m]
POSE = np.array([0.0, -0.6, 0.5, 0.3, 0.0])


def so101(truth, **fields):
    n = len(SO101)
    return Machine(
        rows=SO101,
        rotors=np.full(n, 0.0284),
        viscous=np.full(n, 0.059 + 1.212**2 / 2.676),
        coulomb=np.full(n, 0.052),
        torque_limit=np.full(n, 1.212 / 2.676 * 7.4),
        counts_per_radian=np.full(n, SERVO_COUNTS / (2 * np.pi)),
        truth=TRUTHS[truth],
        **fields,
    )


def believed(machine, rows, period, inner, gear=1.0, transport=None):
    """Arm and rig as the law believes them: those of S0."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "arm.xml")
        path.write_text(mjcf(rows, machine.rotors))
        dynamics = Dynamics.from_chain(Chain.from_mjcf(path))
    gear = np.broadcast_to(gear, len(rows))
    drive = Drive(
        gear=gear,
        motor_inertia=machine.rotors / gear**2,
        viscous=machine.viscous / machine.truth[VISCOUS] / gear**2,
        coulomb=machine.coulomb / gear,
        motor_gain=np.ones(len(rows)),
        current_limit=machine.torque_limit / gear,
        joints=tuple(row[0] for row in rows),
    )
    encoder = Encoder(resolution=machine.counts_per_radian * 2 * np.pi / gear)
    rig = Rig(drive=drive, encoder=encoder, period=period, inner=inner, transport=transport)
    return dynamics.arm(dynamics.f()), rig


def laws(arm, rig, **options):
    """Running laws by name, for what is sent today and for computed torque."""
    none = PD(gain=np.zeros(rig.n), derivative=np.zeros(rig.n), filter=100.0, period=rig.period)
    made = {
        "plain": none,
        "gravity": PDGravity(arm, rig, feedback=none),
        "feed-forward": FeedForward(arm, rig, feedback=none),
        "computed torque": ComputedTorque(arm, rig, **options),
    }
    return {
        name: (lambda counts, law=law, name=name: law.start(
            rig, counts, **({} if name == "computed torque" else {"guards": None})
        ))
        for name, law in made.items()
    }  # fmt: skip


def motions(pose, reach, frequencies):
    """Slow and fast sinusoids of all joints at once, and a move with a hold."""
    n = len(pose)
    fast = np.zeros((n, 10))
    fast[np.arange(n), np.resize(frequencies, n) - 1] = 0.4
    return {
        "slow": (
            Harmonics(period=10.0, offset=pose, cosine=np.zeros((n, 1)), sine=np.full((n, 1), 0.4)),
            10.0,
        ),
        "fast": (Harmonics(period=10.0, offset=pose, cosine=np.zeros((n, 10)), sine=fast), 10.0),
        "moves": (PointToPoint(start=pose, goal=pose + reach, duration=1.2), 2.2),
    }


def compare(make_machine, make_inner, start, paths, seconds, late=0.0):
    """Cells of all paths, for one law."""
    cells = []
    for path, duration in paths.values():
        machine = make_machine()
        begin = path(np.zeros(1))
        machine.place(begin.q[0], begin.qd[0])
        running = start(machine.counts)
        errors, whole = follow(
            running, machine, make_inner(machine), path, min(duration, seconds), late
        )
        stop = "" if running.status == "running" else f" ({str(running.status)[:40]})"
        cells.append(cell(errors, whole) + stop)
    return cells


def run_so101(seconds):
    paths = motions(POSE, np.array([1.1, 0.9, -1.1, 1.1, 1.1]), (5, 6, 7))
    for frequency in (30, 50, 100, 200):
        rows = []
        for truth in TRUTHS:
            arm, rig = believed(
                so101(truth), SO101, 1 / frequency, PositionServo(gain=32 * SERVO_GAIN)
            )
            for name, start in laws(arm, rig).items():
                if truth == "S0" and name != "computed torque":
                    continue
                inner = lambda machine: Servos(machine, 32 * SERVO_GAIN)  # noqa: E731
                make = lambda truth=truth: so101(truth)  # noqa: E731
                rows.append((f"{truth} {name}", compare(make, inner, start, paths, seconds)))
        table(f"SO-101, P = 32, {frequency} Hz", list(paths), rows)


def run_bandwidths(seconds):
    """Bandwidths of the law, as shares of the sample rate, under a servo's gain that is off."""
    paths = motions(POSE, np.array([1.1, 0.9, -1.1, 1.1, 1.1]), (5, 6, 7))
    for frequency in (50, 100):
        rows = []
        for gain in (0.8, 1.25):
            for share in (0.3, 0.45, 0.6):
                inner = PositionServo(gain=32 * SERVO_GAIN)
                arm, rig = believed(so101("S0"), SO101, 1 / frequency, inner)
                start = laws(arm, rig, bandwidth=share * frequency)["computed torque"]
                cells = compare(
                    lambda: so101("S0"),
                    lambda machine, gain=gain: Servos(machine, gain * 32 * SERVO_GAIN),
                    start, paths, seconds,
                )  # fmt: skip
                rows.append((f"gain x {gain:g}, bandwidth {share:g} / period", cells))
        table(f"SO-101, S0, {frequency} Hz, other bandwidths", list(paths), rows)


def run_late(seconds):
    """Goals that come late, unknown to the law and stated as its rig's transport."""
    paths = motions(POSE, np.array([1.1, 0.9, -1.1, 1.1, 1.1]), (5, 6, 7))
    for frequency in (50, 100, 200):
        rows = []
        for late in (0.001, 0.002, 0.004, 1 / frequency):
            for known in (False, True):
                transport = Transport(delay=late) if known else None
                arm, rig = believed(
                    so101("S1"),
                    SO101,
                    1 / frequency,
                    PositionServo(gain=32 * SERVO_GAIN),
                    transport=transport,
                )
                start = laws(arm, rig)["computed torque"]
                cells = compare(
                    lambda: so101("S1"), lambda machine: Servos(machine, 32 * SERVO_GAIN),
                    start, paths, seconds, late,
                )  # fmt: skip
                rows.append((f"{1e3 * late:g} ms {'stated' if known else 'unknown'}", cells))
        table(f"SO-101, S1, {frequency} Hz, late goals", list(paths), rows)


def run_sides(seconds):
    """The same goal approached from both sides: difference of the two rests, joint by joint."""
    for gain in (16, 32):
        rows = []
        arm, rig = believed(so101("S1"), SO101, 0.01, PositionServo(gain=gain * SERVO_GAIN))
        for name, start in laws(arm, rig).items():
            rests = []
            for side in (-0.3, 0.3):
                machine = so101("S1")
                path = PointToPoint(start=POSE + side, goal=POSE, duration=1.0)
                machine.place(POSE + side, 0.0)
                errors, _ = follow(
                    start(machine.counts), machine, Servos(machine, gain * SERVO_GAIN), path, 3.0
                )
                rests.append(errors[-50:].mean(axis=0))
            apart = np.abs(rests[0] - rests[1])
            sag = np.abs(np.mean(rests, axis=0)).max()
            rows.append((name, [f"{x:.1f}" for x in apart] + [f"{sag:.1f}"]))
        table(
            f"SO-101 from both sides, P = {gain}, 100 Hz, S1 [counts]",
            [r[0] for r in SO101] + ["sag"],
            rows,
        )


# -- YAM -------------------------------------------------------------------------------------------
YAM_POSE = np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
YAM_GEARS = np.array([40, 40, 40, 10, 10, 10.0])
YAM_LIMITS = ((12.5,) * 6, (10, 10, 10, 30, 30, 30), (500,) * 6, (5,) * 6, (28, 28, 28, 10, 10, 10))


def yam(truth, **fields):
    return Machine(
        rows=YAM,
        rotors=np.array([0.032] * 3 + [0.006] * 3),
        viscous=np.array([0.1] * 3 + [0.02] * 3),
        coulomb=np.array([0.3] * 3 + [0.06] * 3),
        torque_limit=np.array([28.0] * 3 + [10.0] * 3),
        counts_per_radian=np.full(6, 65535 / 25),
        truth=TRUTHS[truth],
        step=1e-4,
        **fields,
    )


def run_yam(seconds):
    paths = motions(YAM_POSE, np.array([1.1, 0.5, 0.5, 0.8, 0.8, 1.1]), (5, 6, 7))
    machine = yam("S0")
    stock = MitDrive(kp=(80, 80, 80, 10, 10, 10), kd=(5, 5, 5, 1.5, 1.5, 1.5), limits=YAM_LIMITS)
    for frequency in (500, 1000):
        rows = []
        for stiffness in ("stock", 40, 80):
            arm, rig = believed(machine, YAM, 1 / frequency, stock, gear=YAM_GEARS)
            if stiffness != "stock":
                drive = MitDrive.for_arm(
                    arm, rig, stiffness=stiffness, pose=YAM_POSE, limits=YAM_LIMITS
                )
                rig = dataclasses.replace(rig, inner=drive)
            for truth in ("S1", "S2"):
                for name, start in laws(arm, rig).items():
                    if name != "computed torque" and (stiffness != "stock" or frequency != 500):
                        continue
                    cells = compare(
                        lambda truth=truth: yam(truth),
                        lambda machine: Frames(machine, YAM_GEARS),
                        start, paths, seconds,
                    )  # fmt: skip
                    rows.append((f"{truth} {name}, drive {stiffness}", cells))
        table(f"YAM, {frequency} Hz [counts of 25/65535 rad]", list(paths), rows)


def run_elastic(seconds):
    """Gears of 28 and 15 Hz that nobody states, motor side; the drive's own stiffness in rad/s."""
    paths = motions(YAM_POSE, np.array([1.1, 0.5, 0.5, 0.8, 0.8, 1.1]), (5, 6, 7))
    rows = []
    for share in (1.0, 0.3):
        gears = share * np.array([800.0] * 3 + [200.0] * 3)
        for stiffness in (40, 80):
            arm, rig = believed(yam("S0"), YAM, 0.002, None, gear=YAM_GEARS)
            drive = MitDrive.for_arm(
                arm, rig, stiffness=stiffness, pose=YAM_POSE, limits=YAM_LIMITS
            )
            rig = dataclasses.replace(rig, inner=drive)
            for bandwidth in (None, 60.0, 80.0):
                start = laws(arm, rig, bandwidth=bandwidth)["computed torque"]
                cells = compare(
                    lambda gears=gears: yam("S1", stiffness=gears),
                    lambda machine: Frames(machine, YAM_GEARS),
                    start, paths, seconds,
                )  # fmt: skip
                name = "default" if bandwidth is None else f"{bandwidth:g} rad/s"
                rows.append((f"{800 * share:g} N m/rad, drive {stiffness}, law {name}", cells))
    table("YAM, 500 Hz, elastic gears, S1", list(paths), rows)


# -- OpenArm ---------------------------------------------------------------------------------------
OPENARM_POSE = np.array([0.3, 0.4, 0.2, 1.2, 0.1, 0.2, 0.1])


def openarm(truth):
    """The packaged robot; nobody has measured its friction, so it is that of the YAM's drives."""
    robot = read_robot("openarm")
    drive = robot.rig.drive
    rows = []
    for link, body in zip(robot.dynamics.chain.links, robot.dynamics.chain.bodies, strict=True):
        # MJCF has the inertia in the frame of the joint.
        turn = np.array(link.frame.rotation)
        xx, xy, xz, yy, yz, zz = body.inertia
        full = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, np.array(link.before.rotation).ravel())
        centre = turn @ body.com + np.array(link.frame.position)
        places = (link.before.position, quaternion, centre)
        place, pose, com = (" ".join(f"{x:.17g}" for x in vector) for vector in places)
        inertia = (*np.diag(full), full[0, 1], full[0, 2], full[1, 2])
        rows.append((link.name, place, pose, body.mass, com, inertia))
    large = np.array([1, 1, 1, 1, 0, 0, 0], bool)
    machine = Machine(
        rows=tuple(rows),
        rotors=drive.motor_inertia * drive.gear**2,
        viscous=np.where(large, 0.1, 0.02),
        coulomb=np.where(large, 0.3, 0.06),
        torque_limit=np.array(robot.rig.inner.limits[4]),
        counts_per_radian=np.full(7, 65535 / 25),
        truth=TRUTHS[truth],
        step=1e-4,
    )
    return machine, robot.rig.inner


def run_openarm(seconds):
    n = len(OPENARM_POSE)
    paths = motions(OPENARM_POSE, np.full(n, 0.6), (5, 6, 7))
    machine, stock = openarm("S0")
    gears = np.array(read_robot("openarm").rig.drive.gear)
    rows = []
    for stiffness in ("stock", 40, 80):
        arm, rig = believed(machine, machine.rows, 0.002, stock, gear=gears)
        if stiffness != "stock":
            drive = MitDrive.for_arm(
                arm, rig, stiffness=stiffness, pose=OPENARM_POSE, limits=stock.limits
            )
            rig = dataclasses.replace(rig, inner=drive)
        for truth in ("S1", "S2"):
            for name, start in laws(arm, rig).items():
                if name != "computed torque" and (stiffness != "stock" or name == "plain"):
                    continue
                cells = compare(
                    lambda truth=truth: openarm(truth)[0],
                    lambda machine: Frames(machine, gears),
                    start, paths, seconds,
                )  # fmt: skip
                rows.append((f"{truth} {name}, drive {stiffness}", cells))
    table("OpenArm, 500 Hz [counts of 25/65535 rad]", list(paths), rows)


PARTS = {
    "so101": run_so101,
    "sides": run_sides,
    "yam": run_yam,
    "elastic": run_elastic,
    "openarm": run_openarm,
    "late": run_late,
    "bandwidths": run_bandwidths,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default=",".join(PARTS), help="parts, separated by commas")
    parser.add_argument("--seconds", type=float, default=10.0, help="longest run [s]")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for name in options.only.split(","):
        PARTS[name](options.seconds)


if __name__ == "__main__":
    main()

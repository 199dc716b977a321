"""Arms whose controller is lied to: every fault at rest, in motion and during a hold, on rigid and
elastic gears.

Beside each, the same arm without torque from the instant of the stop: what it does is not the
controller's doing.
"""

import dataclasses
from collections.abc import Callable

import numpy as np
from faults import SimulatedArm
from guarded_loops import LIMIT, RIG, elastic
from mujoco_elastic import MujocoArm

from ctc import ComputedTorque
from plant import PointToPoint, puma560

PATH = puma560.reference()
DT = RIG.period
BEGIN, END = 600, 2000
FEASIBLE = 0.7  # of the amplifier's limit, for a path that a sound loop can follow
"""Samples at which faults begin, and runs end."""

BRAKED = 70
"""Samples before the fault at which the hold begins."""


@dataclasses.dataclass
class Spoilt:
    """One call: counts, the sample whose reference it gets, its clock [s], whether it takes
    place, and how often.
    """

    counts: np.ndarray
    sample: float
    now: float | None = None
    calls: int = 1
    limit: np.ndarray = dataclasses.field(default_factory=lambda: LIMIT)


def _frozen(call, k, seen):
    call.counts[0] = seen[0][0]


def _dead(call, k, seen):
    call.counts[0] = 0


def _sign(call, k, seen):
    call.counts[0] = 2 * seen[0][0] - call.counts[0]


def _swap(call, k, seen):
    call.counts[:] = seen[0] + (call.counts - seen[0])[::-1]


def _scale(call, k, seen):
    call.counts[0] = seen[0][0] + (call.counts[0] - seen[0][0]) // 2


def _drift(call, k, seen):
    call.counts[0] += k // 5


def _glitch(call, k, seen):
    call.counts[0] += 800 * (k % 7 == 0)


def _wrap(call, k, seen):
    call.counts[0] = (call.counts[0] - seen[0][0] + 8) % 4096 + seen[0][0] - 8


def _nan(call, k, seen):
    call.counts = np.array([np.nan, call.counts[1]])


def _leaps(call, k, seen):
    call.now = (BEGIN + k) * DT + 3600 * (k >= 0)


def _stands(call, k, seen):
    call.now = BEGIN * DT


def _double(call, k, seen):
    call.sample, call.calls = k / 2, 1


def _lost(call, k, seen):
    call.calls = k % 2


def _weak(call, k, seen):
    call.limit = 0.3 * LIMIT


@dataclasses.dataclass(frozen=True)
class Lie:
    """What is wrong from sample BEGIN on or, save in a hold, always; gears of an elastic arm
    [Hz], bandwidth, load.
    """

    says: str
    spoil: Callable | None = None
    always: bool = False
    load: float = 1.5
    bandwidth: float | None = None
    hz: float = 150.0


LIES = {
    "frozen": Lie("encoder of joint 2 freezes", _frozen),
    "dead": Lie("encoder of joint 2 reads 0", _dead),
    "sign": Lie("encoder of joint 2 reversed", _sign, always=True),
    "swap": Lie("encoders swapped", _swap, always=True),
    "scale": Lie("encoder of joint 2 counts half", _scale, always=True),
    "drift": Lie("encoder of joint 2 drifts by 0.2 pulses a sample", _drift),
    "glitch": Lie("every 7th count of joint 2 wrong by 800", _glitch),
    "wrap": Lie("counts of joint 2 wrap at 4096", _wrap),
    "nan": Lie("counts of joint 2 are NaN", _nan),
    "clock leaps": Lie("clock ahead by 3600 s", _leaps),
    "clock stands": Lie("clock constant", _stands),
    "double": Lie("called twice per period, no clock", _double),
    "lost": Lie("every second call lost, no clock", _lost),
    "saturation": Lie("amplifiers give 30 %, unknown to the controller", _weak),
    "chatter": Lie("bandwidth of 250 rad/s", bandwidth=250.0),
    "load": Lie("three times the load", load=4.5),
    "none": Lie("nothing"),
}
WHEN = ("rest", "motion", "hold")


@dataclasses.dataclass(frozen=True)
class Told:
    """What came of it: status, brake, sample of the stop or None, speeds (N, 2) of the joints,
    torques (N, 2).

    The fault began at sample `begun`. `alone` are speeds and torques of the same arm without torque
    from the stop on, None without a stop.
    """

    status: str
    brake: bool
    begun: int
    stop: int | None
    speed: np.ndarray
    energy: np.ndarray
    torque: np.ndarray
    alone: np.ndarray | None
    energy_alone: np.ndarray | None

    @property
    def at_limit(self):
        """Longest time [s] of a joint at its limit, in all, from the stop on."""
        if self.stop is None:
            return 0.0
        return float(
            (np.abs(self.torque[self.stop :]) >= LIMIT * (1 - 1e-9)).sum(axis=0).max() * DT
        )


STIFF = 400.0
"""Resonance [Hz] of gears in MuJoCo that stand for rigid ones."""


def told(lie, when, gears="rigid", *, end=END, make=None, mujoco=False):
    """Run one lie; in MuJoCo, if asked for."""
    model = puma560.literature_arm(1.5)
    arm = puma560.literature_arm(lie.load)
    rig = elastic(arm, None if gears == "rigid" else lie.hz)
    law = ComputedTorque(
        model, RIG, bandwidth=lie.bandwidth or (145.0 if gears == "rigid" else 60.0)
    )
    law = law if make is None else make(model)
    start = np.array([0.3, -0.4]) if when == "rest" else PATH(np.zeros(1)).q[0]
    speed = np.zeros(2) if when == "rest" else PATH(np.zeros(1)).qd[0]
    if mujoco:
        stiff = elastic(arm, STIFF if gears == "rigid" else lie.hz).drive.elasticity
        robot = MujocoArm(arm, stiff, start, speed, steps=50)
    else:
        robot = SimulatedArm(arm, rig, start, speed)
    running, seen = law.start(RIG, robot.counts()), [robot.counts()]
    speed, torque, energy = np.zeros((end, 2)), np.zeros((end, 2)), np.zeros(end)
    stop = kept = None
    always = lie.always and when != "hold"
    for k in range(end):
        call = Spoilt(robot.counts().astype(float), float(k - BEGIN))
        if k == BEGIN and not always:
            seen = [robot.counts()]
        if lie.spoil is not None and (always or k >= BEGIN):
            lie.spoil(call, k - BEGIN, seen)
        if when == "rest":
            motion = start, np.zeros(2), np.zeros(2)
        else:
            motion = tuple(x[0] for x in PATH(np.array([(BEGIN + call.sample) * DT])))
        if when == "hold" and k >= BEGIN - BRAKED:
            motion = (np.full(2, np.nan),) * 3
        clock = {} if call.now is None else {"now": call.now}
        for _ in range(call.calls):
            held = running.step(call.counts, *motion, **clock)
        stopped = running.stopped if when != "hold" else running._run.released > 0
        if stopped and stop is None:
            stop, kept = k, robot.state.copy()
        speed[k], energy[k], torque[k] = (
            robot.qd,
            _kinetic(arm, robot),
            np.clip(held, -call.limit, call.limit),
        )
        robot.push(torque[k])
    alone = energy_alone = None
    if kept is not None:
        robot.state, alone, energy_alone = kept, np.zeros((end - stop, 2)), np.zeros(end - stop)
        for k in range(end - stop):
            alone[k], energy_alone[k] = robot.qd, _kinetic(arm, robot)
            robot.push(np.zeros(2))
    return Told(
        str(running.status),
        running.status.brake,
        0 if always or lie.spoil is None else BEGIN,
        stop,
        speed,
        energy,
        torque,
        alone,
        energy_alone,
    )


def _kinetic(arm, robot):
    return 0.5 * robot.qd @ arm.D(robot.q) @ robot.qd


def healthy(seed, samples=1500):
    """Status after a random smooth path of 1 s, with a load of 0 to 5 kg, on rigid or elastic
    gears, seldom at rest.
    """
    draw = np.random.default_rng(seed)
    load, hz = draw.uniform(0, 5), draw.choice([0, 40, 60, 100])
    arm, model = puma560.literature_arm(load), puma560.literature_arm(load * draw.uniform(0.7, 1.3))
    rig = elastic(arm, hz or None)
    law = ComputedTorque(
        model, RIG, bandwidth=(250.0 if draw.random() < 0.5 else 100.0) if not hz else 0.12 * hz * 2
    )
    start, goal = draw.uniform(-1, 1, (2, 2))
    goal = np.where(draw.random(2) < 0.25, start, goal)
    path = PointToPoint(start=start, goal=goal, duration=draw.uniform(0.5, 1.0))
    while path.torque_share(arm, RIG).max() > FEASIBLE:
        path = dataclasses.replace(path, duration=1.2 * path.duration)
    motion, robot = path(np.arange(samples) * DT), SimulatedArm(arm, rig, start, np.zeros(2))
    running = law.start(RIG, robot.counts())
    clocked = draw.random() < 0.5
    for k in range(samples):
        late = {"now": k * DT + draw.uniform(0, 0.3) * DT} if clocked else {}
        robot.push(running.step(robot.counts(), motion.q[k], motion.qd[k], motion.qdd[k], **late))
        if running.stopped:
            break
    return str(running.status) if running.stopped else "running"

"""Faults of a control loop, each injected into the paper's arm under a running controller.

The arm is the simulator's own sub-step, called sample by sample, so that something can go wrong
between them.
"""

import dataclasses
from collections.abc import Callable

import casadi as ca
import numpy as np
from closed_loops import SampledP

from plant import Guards, puma560
from plant.simulation import ClosedLoop

RIG, PATH = puma560.rig(), puma560.reference()
BEGIN, END = 1000, 2000
"""Samples at which faults begin (0.7 s, both joints in full motion), and experiments end."""


class SimulatedArm:
    """An arm to which a torque is applied for a while, and whose encoders are read."""

    def __init__(self, arm, rig, q, qd, steps=8):
        idle = SampledP(gain=np.zeros(rig.n), period=rig.period)
        loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=idle, steps_per_sample=steps)
        state, numbers = ca.SX.sym("state", len(loop.state_names)), loop.number_values(arm.f)
        time = np.append(np.zeros(len(loop.time_names) - 1), loop.h)
        self._sample = ca.Function("step", [state], [loop.substep(state, time, numbers)[0]]).fold(
            steps
        )
        self.rig, self.state = (
            rig,
            loop.initial_state(q, qd, None if rig.drive.elasticity is None else numbers),
        )

    @property
    def q(self):
        """Of the joints, or, on elastic gears, of their motors as joints on rigid gears would
        have them.
        """
        return self.state[: self.rig.n]

    @property
    def qd(self):
        return self.state[self.rig.n : 2 * self.rig.n]

    @property
    def link_speed(self):
        """Of the links behind elastic gears [rad/s]."""
        return self.state[-2 - self.rig.n : -2]

    def counts(self):
        return self.rig.counts(self.q)

    def push(self, torque):
        """Hold a joint torque [N m] for one sample."""
        n = self.rig.n
        self.state[3 * n : 4 * n] = torque
        self.state = self._sample(self.state).full().ravel()


@dataclasses.dataclass
class Call:
    """One call of a controller, to be spoilt: the counts and the reference it gets, and samples
    it comes late by.
    """

    pulses: np.ndarray
    q_r: np.ndarray
    qd_r: np.ndarray
    qdd_r: np.ndarray
    late: int = 0
    blocked: bool = False


@dataclasses.dataclass(frozen=True)
class Fault:
    """What is injected: `spoil(call, k)` changes the call of sample BEGIN + k, for k from 0 on."""

    says: str
    spoil: Callable
    guards: Guards = Guards()  # noqa: RUF009 - frozen


def add(joint, pulses, samples=END):
    """Counts of a joint that are wrong by so much, for so many samples."""

    def spoil(call, k):
        call.pulses[joint] += pulses * (k < samples)

    return spoil


def noise(call, k):
    call.pulses[0] += np.random.default_rng(k).integers(-5000, 5000)


def stuck(call, k):
    call.pulses[1] = RIG.counts(PATH(np.array([BEGIN * RIG.period])).q[0])[1]


def late(samples):
    """One call that comes late."""

    def spoil(call, k):
        call.late = samples * (k == 0)

    return spoil


def no_reference(samples):
    """NaN in the reference, for so many samples."""

    def spoil(call, k):
        call.qd_r[:] = np.nan if k < samples else call.qd_r

    return spoil


def leap(call, k):
    call.q_r[0] += 0.1


def blocked(call, k):
    call.blocked = True


FAULTS = {
    "none": Fault("nothing", lambda call, k: None),
    "jump": Fault("counts of joint 2 wrong by 800 for one sample", add(0, 800, 1)),
    "slip": Fault("counts of joint 2 wrong by 800 from now on", add(0, 800)),
    "noise": Fault("counts of joint 2 wrong by up to 5,000, anew in every sample", noise),
    "stuck": Fault("counts of joint 3 stand still", stuck),
    "late": Fault("one call two samples late, the torque held meanwhile", late(2)),
    "too late": Fault("one call 15 samples (10.5 ms) late", late(15)),
    "gap": Fault("NaN in the reference for two samples", no_reference(2)),
    "no reference": Fault("NaN in the reference from now on", no_reference(END)),
    "no reference, gravity": Fault(
        "the same, with `stop='gravity'`", no_reference(END), Guards(stop="gravity")
    ),
    "leap": Fault("reference of joint 2 off by 0.1 rad from now on", leap),
    "blocked": Fault("joint 2 runs against a stop", blocked),
    "blocked, zero": Fault("the same, with `stop='zero'`", blocked, Guards(stop="zero")),
}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a controller did: status at the end; torques (N, n) [N m]; errors (N, n) [pulses] of the
    joints themselves.

    The error is that from what the controller follows: the reference, and in a stop its own.
    """

    status: str
    stopped: bool
    bridged: int
    torque: np.ndarray
    error: np.ndarray

    @property
    def peak_torque(self):
        """After the fault."""
        return np.abs(self.torque[BEGIN:]).max(axis=0)

    @property
    def peak_error(self):
        """After the fault."""
        return np.abs(self.error[BEGIN:]).max(axis=0)


def experiment(law, arm, fault, *, guards=True, end=END):
    """Follow trajectory (6) with the fault from sample BEGIN on; without guards if they are
    turned down.
    """
    motion = PATH(np.arange(end) * RIG.period)
    robot = SimulatedArm(arm, RIG, motion.q[0], motion.qd[0])
    running = law.start(RIG, robot.counts(), guards=fault.guards if guards else None)
    torque, error, now, held = np.zeros((end, 2)), np.zeros((end, 2)), 0.0, np.zeros(2)
    for k in range(end):
        call = Call(robot.counts(), motion.q[k].copy(), motion.qd[k].copy(), motion.qdd[k].copy())
        if k >= BEGIN:
            fault.spoil(call, k - BEGIN)
        for _ in range(call.late):
            robot.push(held)
            now += RIG.period
        # the path is one of time: the call gets the counts and the reference of its own time
        if call.late:
            motion = PATH(now + np.arange(-k, end - k) * RIG.period)
            call = Call(robot.counts(), *(x[k].copy() for x in motion))
        held = running.step(call.pulses, call.q_r, call.qd_r, call.qdd_r, now=now)
        torque[k], error[k] = held, RIG.position_in_pulses(running.reference - robot.q)
        robot.push(held)
        if call.blocked:
            robot.state[0], robot.state[2] = motion.q[BEGIN, 0], 0.0
        now += RIG.period
    return Outcome(running.status, running.stopped, running.bridged, torque, error)

"""The arm of the paper on elastic gears in MuJoCo: two masses and a spring per joint.

MuJoCo integrates at a hundredth of the sample (7 us), unless said, with its own rigid bodies; every
motor is a rotor of its own, joined to its joint by a tendon that is a spring and a damper. The law
is stepped by `.step` with whole counts.
"""

import math

import mujoco
import numpy as np
import pytest

from plant import Record, puma560

__all__ = ["DURATION", "PATH", "RIG", "MujocoArm", "p_loop", "run"]

STEPS, DURATION = 100, 0.6
RIG, PATH = puma560.rig(), puma560.reference()


def planar_bodies(arm):
    """Masses, centres of mass and inertias (planar) that have the arm's f: link 3 of 7 kg, link
    2 of 17 kg.
    """
    f = dict(zip(arm.dynamics.names, arm.f, strict=True))
    m3, m2, a3 = 7.0, 17.0, puma560.LINK_LENGTH
    x3, y3 = f["f5"] / m3, f["f6"] / m3
    izz3 = f["f2"] - m3 * (x3**2 + y3**2)
    x2, y2 = (f["f9"] - m3 * a3) / m2, f["f8"] / m2
    rotor2, rotor3 = RIG.drive.reflected_inertia()
    izz2 = f["f7"] - rotor2 - m3 * a3**2 - f["f2"] - m2 * (x2**2 + y2**2)
    assert f["f1"] - f["f2"] == pytest.approx(rotor3)
    return ((m2, (x2, y2), izz2), (m3, (x3, y3), izz3))


def model(arm, elasticity, steps=STEPS, friction=(1.0, 1.0)):
    """The arm on its springs; frame 2 is the world at q = 0, and positive q2 lowers the arm.

    `friction` multiplies that of each motor.
    """
    (m2, (x2, y2), i2), (m3, (x3, y3), i3) = planar_bodies(arm)
    rotors = RIG.drive.reflected_inertia()
    viscous, coulomb = (
        np.asarray(friction) * each
        for each in (RIG.drive.joint_viscous(), RIG.drive.joint_coulomb([0.0, 0.0]))
    )
    hard = "solreffriction='0.0001 1' solimpfriction='0.9999 0.9999 0.001'"
    motors = "".join(
        f"<body name='m{i}' pos='{i} 5 0'><joint name='motor{i}' axis='0 0 1'"
        f" damping='{viscous[i]}' frictionloss='{coulomb[i]}' {hard}/><inertial pos='0 0 0'"
        f" mass='1' diaginertia='5 5 {rotors[i]}'/></body>"
        for i in range(2)
    )
    tendons = "".join(
        f"<fixed name='gear{i}' stiffness='{elasticity.stiffness[i]}'"
        f" damping='{elasticity.damping[i]}' springlength='0'><joint joint='motor{i}'"
        f" coef='1'/><joint joint='link{i}' coef='-1'/></fixed>"
        for i in range(2)
    )
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='{RIG.period / steps}' gravity='0 9.81 0'"
        f" integrator='implicitfast' tolerance='1e-12'/><worldbody>{motors}<body><joint"
        f" name='link0' axis='0 0 1'/><inertial pos='{x2} {y2} 0' mass='{m2}' diaginertia='5 5"
        f" {i2}'/><body pos='{puma560.LINK_LENGTH} 0 0'><joint name='link1' axis='0 0 1'/><inertial"
        f" pos='{x3} {y3} 0' mass='{m3}' diaginertia='5 5"
        f" {i3}'/></body></body></worldbody><tendon>{tendons}</tendon></mujoco>"
    )


def p_loop(arm, elasticity, gain, link, duration, steps):
    """A record of the arm under P as fast hardware, which reads its counts at every step of the
    engine.
    """
    engine = model(arm, elasticity, steps)
    data = mujoco.MjData(engine)
    t = RIG.period / steps * np.arange(math.ceil(duration / RIG.period) * steps)
    motion = PATH(t)
    commanded, k = RIG.counts(motion.q), RIG.drive.gear
    per_radian = RIG.position_in_pulses(np.ones(2))
    data.qpos[:], data.qvel[:] = [*motion.q[0], *link], [*motion.qd[0], *motion.qd[0]]
    errors = np.empty_like(commanded)
    for i, counts in enumerate(commanded):
        errors[i] = counts - np.trunc(data.qpos[:2] * per_radian)
        data.qfrc_applied[:2] = k * gain * errors[i]
        mujoco.mj_step(engine, data)
    rows = slice(0, None, steps)
    return Record(
        t=t[rows],
        reference_pulses=commanded[rows],
        error_pulses=errors[rows],
        rig=RIG,
        law=puma560.p_law(gain),
        reference=PATH,
    )


class MujocoArm:
    """The arm as `faults.SimulatedArm` is one: torques are pushed, the encoders of its motors
    are read.
    """

    def __init__(self, arm, elasticity, q, qd, steps=STEPS):
        self.engine, self._steps = model(arm, elasticity, steps), steps
        self._data = mujoco.MjData(self.engine)
        self._data.qpos[:], self._data.qvel[:] = [*q, *q], [*qd, *qd]

    @property
    def state(self):
        return np.append(self._data.qpos, self._data.qvel)

    @state.setter
    def state(self, state):
        mujoco.mj_resetData(self.engine, self._data)
        self._data.qpos[:], self._data.qvel[:] = state[:4], state[4:]

    @property
    def q(self):
        return self._data.qpos[:2].copy()

    @property
    def qd(self):
        return self._data.qvel[:2].copy()

    def counts(self):
        return RIG.counts(self.q)

    def push(self, torque):
        """Hold a joint torque [N m] for one sample."""
        self._data.qfrc_applied[:2] = torque
        mujoco.mj_step(self.engine, self._data, nstep=self._steps)


def run(
    arm,
    elasticity,
    law,
    link,
    path=PATH,
    duration=DURATION,
    steps=STEPS,
    friction=(1.0, 1.0),
    shift=(0.0, 0.0),
):
    """Counted errors (N, 2) of the motors, angles (N, 2) of the links, which start at `link`, and
    torques (N, 2).

    `shift` is where the encoders' zeros are between two pulses.
    """
    engine = model(arm, elasticity, steps, friction)
    data = mujoco.MjData(engine)
    samples = math.ceil(duration / RIG.period)
    t = RIG.period * np.arange(samples)
    motion = path(t)
    data.qpos[:] = [*motion.q[0], *link]
    data.qvel[:] = [*motion.qd[0], *motion.qd[0]]
    controller = law.start(RIG, RIG.counts(motion.q[0]), guards=None)
    errors, links, torques = np.empty((3, samples, 2))
    for k in range(samples):
        counts = RIG.counts(data.qpos[:2] + RIG.to_angle(shift))
        errors[k], links[k] = RIG.counts(motion.q[k]) - counts, data.qpos[2:]
        torques[k] = controller.step(counts, motion.q[k], motion.qd[k], motion.qdd[k])
        data.qfrc_applied[:2] = torques[k]
        mujoco.mj_step(engine, data, nstep=steps)
    return errors, links, torques

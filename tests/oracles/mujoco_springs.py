"""The arm of the paper on rigid gears in MuJoCo, with springs: joints that have one, and tendons
between two points.

MuJoCo knows a joint's stiffness and the angle where it rests, and works out length and pull of a
tendon by itself.
"""

import math

import mujoco
import numpy as np
from mujoco_elastic import planar_bodies

from plant import Record, puma560

__all__ = ["BASE", "ON_LINK", "engine", "p_loop", "swing"]

RIG, PATH = puma560.rig(), puma560.reference()
BASE, ON_LINK = (0.4, -2.0), (0.25, 1.1)
"""Directions from each axis, seen from the link before and from the link after, in which coils
end [rad].
"""


def _spring(spring, i):
    return (
        "" if spring is None else f"stiffness='{spring.stiffness[i]}' springref='{spring.angle[i]}'"
    )


def _site(name, centre, arm, angle):
    return f"<site name='{name}' pos='{centre + arm * math.cos(angle)} {arm * math.sin(angle)} 0'/>"


def engine(arm, spring=None, coil=None, *, friction=False, step=1e-5, integrator="RK4"):
    """The arm; frame 2 is the world at q = 0, and positive q2 lowers the arm.

    `spring` is a `JointSpring`; `coil` a `Counterbalance` whose angle is BASE - ON_LINK, without
    tension.
    """
    (m2, (x2, y2), i2), (m3, (x3, y3), i3) = planar_bodies(arm)
    rotors, drive, length = RIG.drive.reflected_inertia(), RIG.drive, puma560.LINK_LENGTH
    hard = "solreffriction='0.0001 1' solimpfriction='0.9999 0.9999 0.001'"
    viscous, coulomb = drive.joint_viscous(), drive.joint_coulomb(np.zeros(2))
    joints = [
        f"<joint name='q{i}' axis='0 0 1' armature='{rotors[i]}' {_spring(spring, i)} "
        + (f"damping='{viscous[i]}' frictionloss='{coulomb[i]}' {hard}/>" if friction else "/>")
        for i in range(2)
    ]
    sites, tendons = ["", "", ""], ""
    if coil is not None:
        np.testing.assert_allclose(coil.angle, np.subtract(BASE, ON_LINK))
        for i in range(2):
            sites[i] += _site(f"base{i}", length * i, coil.base_arm[i], BASE[i])
            sites[i + 1] += _site(f"link{i}", 0.0, coil.link_arm[i], ON_LINK[i])
            tendons += (
                f"<spatial stiffness='{coil.stiffness[i]}' springlength='{coil.free_length[i]}'>"
                f"<site site='base{i}'/><site site='link{i}'/></spatial>"
            )
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='radian'/><option timestep='{step}' gravity='0 9.81 0'"
        f" integrator='{integrator}'"
        f" tolerance='1e-12'/><worldbody>{sites[0]}<body>{joints[0]}<inertial pos='{x2} {y2} 0'"
        f" mass='{m2}' diaginertia='5 5 {i2}'/>{sites[1]}<body pos='{length} 0"
        f" 0'>{joints[1]}<inertial pos='{x3} {y3} 0' mass='{m3}' diaginertia='5 5"
        f" {i3}'/>{sites[2]}</body></body></worldbody><tendon>{tendons}</tendon></mujoco>"
    )


def swing(model, start, period, samples):
    """Positions (N, 2) [rad] of the arm left to itself, from start (2, 2)."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start
    steps, q = round(period / model.opt.timestep), np.empty((samples, 2))
    for row in q:
        row[:] = data.qpos
        mujoco.mj_step(model, data, nstep=steps)
    return q


def p_loop(arm, law, spring=None, *, injected=None, path=PATH, duration=None, steps=40):
    """A record of the arm under P as fast hardware, with dry friction; `injected` (N, 2) [N m]
    is held and logged.
    """
    model = engine(arm, spring, friction=True, step=RIG.period / steps, integrator="implicitfast")
    data, samples = mujoco.MjData(model), math.ceil((duration or path.duration) / RIG.period - 1e-9)
    t = RIG.period / steps * np.arange(samples * steps)
    motion = path(t)
    commanded, k, gain = RIG.counts(motion.q), RIG.drive.gear, np.asarray(law.gain)
    per_radian, limit = RIG.position_in_pulses(np.ones(2)), RIG.drive.torque_limit()
    added = np.zeros((samples, 2)) if injected is None else injected
    data.qpos[:], data.qvel[:] = motion.q[0], motion.qd[0]
    errors, torque = np.empty_like(commanded), np.empty_like(commanded)
    for i, counts in enumerate(commanded):
        errors[i] = counts - np.trunc(data.qpos * per_radian)
        torque[i] = np.clip(
            np.clip(k * gain * errors[i], -limit, limit) + added[i // steps], -limit, limit
        )
        data.qfrc_applied[:] = torque[i]
        mujoco.mj_step(model, data)
    rows = slice(0, None, steps)
    return Record(
        t=t[rows],
        reference_pulses=commanded[rows],
        error_pulses=errors[rows],
        torque=torque[rows],
        rig=RIG,
        law=law,
        reference=path,
        injected=injected,
    )

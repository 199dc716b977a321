"""Arms of two joints in a vertical plane in MuJoCo, under any law, with one thing odd of the
machine.

A law without a period is P as fast hardware; others are sampled, and hold their torque.

The plant is built from D(q) and gravity of an `Arm`. Gears that give or play are rotors of their
own, joined to their joints by tendons that are springs; other friction, cogging, delay and
saturation act from step to step of the engine.
"""

import collections
import dataclasses

import mujoco
import numpy as np

from plant import Record

__all__ = ["run"]

STEPS, DURATION = 64, 3.0  # 16 steps shift a loop that hunts by counts enough to be doubted


def bodies(arm, rig):
    """Vector from axis to axis; mass, first moment and inertia about its axis of each link, from
    D and gravity.
    """
    rotors, zero, up = rig.drive.reflected_inertia(), np.zeros(2), np.array([np.pi / 2, 0])
    level, high = (arm.inverse(q, zero, zero) / 9.81 for q in (zero, up))
    far = np.array([-level[1], high[1]])
    near = np.array([level[1] - level[0], high[0] - high[1]])
    D, turned = arm.D(zero), arm.D(np.array([0, np.pi / 2]))
    own = D[1, 1] - rotors[1]
    across = np.array([far, [-far[1], far[0]]])
    a = np.linalg.solve(across, [D[0, 1] - own, turned[0, 1] - own])
    m = np.array((17.0, 7.0))
    first = D[0, 0] - rotors[0] - own - 2 * a @ far - m[1] * a @ a
    return a, ((m[0], near - m[1] * a, first), (m[1], far, own))


def engine(arm, rig, load=0.0, hertz=None, damping=0.03, play=0.0):
    """The arm in MuJoCo, rotors on its joints; or, with the resonance of its gears [Hz], behind
    springs, with play.
    """
    a, links = bodies(arm, rig)
    drive, texts, motors, tendons = rig.drive, [], "", ""
    for i, (m, moment, inertia) in enumerate(links):
        extra = load if i else 0.0
        (x, y), mass = (moment + extra * a) / (m + extra), m + extra
        about = inertia + extra * a @ a - mass * (x**2 + y**2)
        rotor, rubs = (
            drive.reflected_inertia()[i],
            "solreffriction='0.0001 1' solimpfriction='0.9999 0.9999 0.001'",
        )
        rubs = (
            f"damping='{drive.joint_viscous()[i]}' frictionloss='{drive.joint_coulomb()[i]}' {rubs}"
        )
        held = f"armature='{rotor}' {rubs}" if hertz is None else ""
        texts.append(
            f"<joint name='q{i}' axis='0 0 1' {held}/>"
            f"<inertial pos='{x} {y} 0' mass='{mass}' diaginertia='5 5 {about}'/>"
        )
        if hertz is not None:
            stiff = (2 * np.pi * hertz) ** 2 * (arm.D(np.zeros(2))[i, i] - rotor)
            motors += (
                f"<body pos='{i} 5 0'><joint name='m{i}' axis='0 0 1' {rubs}/>"
                f"<inertial pos='0 0 0' mass='1' diaginertia='5 5 {rotor}'/></body>"
            )
            tendons += (
                f"<fixed stiffness='{stiff}' damping='{2 * damping * stiff / (2 * np.pi * hertz)}' "
                f"springlength='{-play / 2} {play / 2}'>"
                f"<joint joint='m{i}' coef='1'/><joint joint='q{i}' coef='-1'/></fixed>"
            )
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><compiler angle='radian'/><option timestep='{rig.period / STEPS}' gravity='0 9.81"
        f" 0' integrator='implicitfast' tolerance='1e-12'/><worldbody>{motors}<body>{texts[0]}<body"
        f" pos='{a[0]} {a[1]}"
        f" 0'>{texts[1]}</body></body></worldbody><tendon>{tendons}</tendon></mujoco>"
    )


def run(
    arm,
    rig,
    law,
    path,
    *,
    rounding=None,
    delay=0.0,
    offset=0.0,
    stribeck=0.0,
    cogging=0.0,
    drift=0.0,
    share=None,
    derivative=0.0,
    **gears,
):
    """A record of the arm under a law; what is odd of it is in the key words, none in the record.

    `delay` of the torque [samples]; `offset`, `stribeck`, `cogging` and `drift` as shares of dry
    friction; `share` of the torque that is reached; `derivative`: gain of the error's rate [s],
    relative, under P.
    """
    model = engine(arm, rig, **gears)
    data, behind = mujoco.MjData(model), model.nv == 4
    motors, damped = slice(0, 2), model.tendon_damping.copy()
    dt, k = rig.period / STEPS, rig.drive.gear
    count = round(DURATION / rig.period)
    true = dataclasses.replace(
        rig, encoder=dataclasses.replace(rig.encoder, rounding=rounding or rig.encoder.rounding)
    )
    scale, cut = (
        true.position_in_pulses(np.ones(2)),
        {"fix": np.trunc, "floor": np.floor}[true.encoder.rounding],
    )
    now, middle = path(np.arange(count) * rig.period), path((np.arange(count * STEPS) + 0.5) * dt)
    asked, wanted, rates = true.counts(now.q), true.counts(middle.q), middle.qd * scale
    dry, limit = rig.drive.joint_coulomb().copy(), rig.drive.torque_limit()
    control, gain = (
        (law.start(rig, asked[0], guards=None), None) if law.period else (None, k * law.gain)
    )
    data.qpos[:] = np.tile(now.q[0], 2 if behind else 1)
    data.qvel[:] = np.tile(now.qd[0], 2 if behind else 1)
    if share is not None:
        limit = share
    errors, torques, waiting = np.empty((count, 2)), np.empty((count, 2)), collections.deque()
    for step in range(count * STEPS):
        q, qd, row = data.qpos[motors], data.qvel[motors], step // STEPS
        if step % STEPS == 0:
            # angles of this engine are half a step ahead
            counts = cut((q - 0.5 * dt * qd * bool(control)) * scale)
            errors[row] = asked[row] - counts
            if control:
                torques[row] = held = np.clip(
                    control.step(counts, now.q[row], now.qd[row], now.qdd[row]), -limit, limit
                )
        if not control:
            error = wanted[step] - cut((q + 0.5 * dt * qd) * scale)
            if derivative:
                error = error + derivative * (rates[step] - qd * scale)
            held = np.clip(gain * error, -limit, limit)
        waiting.append(held)
        torque = waiting.popleft() if len(waiting) > round(delay * STEPS) else waiting[0]
        if step % STEPS == 0 and not control:
            at_once = not (delay or derivative)
            torques[row] = np.clip(gain * errors[row], -limit, limit) if at_once else torque
        added = -offset * dry
        if cogging:
            added = added + cogging * dry * np.sin(6 * k * q)
        if stribeck or drift:
            slow = np.exp(-((qd / 0.1) ** 2))
            model.dof_frictionloss[motors] = (
                dry * (1 + stribeck * slow) * (1 + drift * step / (count * STEPS))
            )
        if behind and gears.get("play"):  # teeth that do not touch do not damp
            model.tendon_damping[:] = damped * (
                np.abs(data.qpos[:2] - data.qpos[2:]) > gears["play"] / 2
            )
        data.qfrc_applied[motors] = torque + added
        mujoco.mj_step(model, data)
    return Record(
        t=np.arange(count) * rig.period,
        reference_pulses=asked,
        error_pulses=errors,
        torque=torques,
        rig=rig,
        law=law,
        reference=path,
    )

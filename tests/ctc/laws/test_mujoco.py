"""Computed torque and P on an arm that another engine simulates: the same verdict, through `.step`
and whole counts.

MuJoCo integrates the physical arm at a fourteenth of the sample (50 us), with its own rigid bodies,
its own rotors (armature) and its own dry friction, a constraint that it solves anew at every step.
"""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque, evaluate
from plant import Body, puma560
from plant.motion import Motion

mujoco = pytest.importorskip(
    "mujoco", reason="MuJoCo, an optional engine for this test alone, is not installed"
)

RIG, PATH, STEPS = puma560.rig(), puma560.reference(), 14
SAMPLES = round(3.65 / RIG.period)
ROTORS = RIG.drive.reflected_inertia()
BODIES = (
    Body(mass=17.4, com=(0.068, 0.006, 0.0), inertia=(0.1, 0, 0, 0.54, 0, 0.539), rotor=ROTORS[0]),
    Body(mass=6.05, com=(-0.0039, -0.144, 0.0), inertia=(0.2, 0, 0, 0.02, 0, 0.2), rotor=ROTORS[1]),
)
"""Links 2 and 3 with the wrist lumped into link 3, near `puma560.literature_arm`."""


def model():
    """The arm as a MuJoCo model: one body per row of the modified DH table, RotX(alpha)
    TransX(a), joint about z.
    """
    chain = puma560.dynamics().chain
    text = "<body name='{name}' pos='{a} 0 0' quat='{w} {x} 0 0'>"
    text += (
        "<joint axis='0 0 1' armature='{rotor}' damping='{viscous}' frictionloss='{coulomb}'"
        " {stiff}/>"
    )
    text += "<inertial pos='{com}' mass='{mass}' fullinertia='{inertia}'/>"
    bodies = ""
    for i, (link, body) in enumerate(zip(chain.links, BODIES, strict=True)):
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz = body.inertia
        bodies += text.format(
            name=link.name,
            a=link.a,
            w=np.cos(link.alpha / 2),
            x=np.sin(link.alpha / 2),
            rotor=body.rotor,
            viscous=RIG.drive.joint_viscous()[i],
            coulomb=RIG.drive.joint_coulomb()[i],
            # as hard as the step allows
            stiff="solreffriction='0.0002 1' solimpfriction='0.9999 0.9999 0.001'",
            com=" ".join(map(str, body.com)),
            mass=body.mass,
            inertia=f"{Ixx} {Iyy} {Izz} {Ixy} {Ixz} {Iyz}",
        )
    gravity = " ".join(map(str, chain.gravity))
    option = (
        f"<option timestep='{RIG.period / STEPS}' gravity='{gravity}' integrator='implicitfast'"
        " tolerance='1e-12'/>"
    )
    closed = "</body>" * len(BODIES)
    return mujoco.MjModel.from_xml_string(
        f"<mujoco>{option}<worldbody>{bodies}{closed}</worldbody></mujoco>"
    )


def errors(law, rig, every):
    """Errors (N, 2) in whole pulses at the samples, under a law that is asked at so many steps'
    distance.
    """
    arm = model()
    data, h = mujoco.MjData(arm), RIG.period / STEPS
    motion = Motion(*(x for x in PATH(np.arange(SAMPLES * STEPS) * h)))
    data.qpos, data.qvel = motion.q[0], motion.qd[0]
    running = law.start(rig, rig.counts(data.qpos))
    wanted, found = rig.counts(motion.q), np.empty((SAMPLES, 2))
    for k in range(0, SAMPLES * STEPS, every):
        counts = rig.counts(data.qpos)
        if k % STEPS == 0:
            found[k // STEPS] = wanted[k] - counts
        data.qfrc_applied = running.step(counts, motion.q[k], motion.qd[k], motion.qdd[k])
        mujoco.mj_step(arm, data, every)
    assert running.status == "running"
    return found


def test_the_models_agree():
    """Inertia matrix, weight and Coriolis torque of the two engines, to rounding."""
    ours, theirs = true_arm(), model()
    data, random = mujoco.MjData(theirs), np.random.default_rng(0)
    for _ in range(5):
        q, qd = random.uniform(-2, 2, (2, 2))
        data.qpos, data.qvel = q, qd
        mujoco.mj_forward(theirs, data)
        D = np.empty((2, 2))
        for column, unit in zip(D, np.eye(2), strict=True):
            mujoco.mj_mulM(theirs, data, column, unit)
        np.testing.assert_allclose(D, ours.D(q), rtol=1e-9)
        np.testing.assert_allclose(data.qfrc_bias, ours.h(q, qd), rtol=1e-9, atol=1e-9)


def true_arm():
    dynamics = puma560.dynamics()
    return dynamics.arm(dynamics.f(BODIES))


def test_computed_torque_stays_within_one_pulse_on_the_other_engine_too():
    law = ComputedTorque(true_arm(), RIG)
    found = errors(law, RIG, STEPS)
    verdict = evaluate(true_arm(), RIG, law, PATH, backend="numba")
    assert verdict.within(1)
    assert (np.abs(found) <= 1).all()
    # The share of samples on which the two agree is no accident: the errors are of one kind.
    assert np.abs(found).mean() == pytest.approx(
        np.abs(verdict.record.error_pulses).mean(), rel=0.25
    )


def test_p_does_not_on_either():
    """P is fast hardware: asked at every step."""
    fast = dataclasses.replace(RIG, period=RIG.period / STEPS)
    found = np.abs(errors(puma560.p_law(), fast, 1))
    verdict = evaluate(true_arm(), RIG, puma560.p_law(), PATH, backend="numba")
    assert not verdict.within(1)
    assert (found <= 1).all(axis=1).mean() < 0.5
    assert verdict.fraction_within(1) < 0.5
    np.testing.assert_allclose(found.max(axis=0), verdict.max_error_pulses, atol=2)

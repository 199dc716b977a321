"""Gears that give, on an arm that another engine simulates: two masses and a spring per joint in MuJoCo.

MuJoCo integrates at a hundredth of the sample (7 us) with its own rigid bodies; every motor is a rotor of its own,
joined to its joint by a tendon that is a spring and a damper. The law is stepped by `.step` with whole counts.
"""

import dataclasses
import math

import numpy as np
import pytest

from ctc import ComputedTorque, ComputedTorquePID, FeedForward, FlexibleJointComputedTorque
from identification import identify
from plant import PD, Elasticity, LinkReference, Record, puma560, simulate

mujoco = pytest.importorskip("mujoco", reason="MuJoCo, an optional engine, is not installed")

STEPS, DURATION = 100, 0.6
RIG, PATH = puma560.rig(), puma560.reference()


def planar_bodies(arm):
    """Masses, centres of mass and inertias (planar) that have the arm's f: link 3 of 7 kg, link 2 of 17 kg."""
    f = dict(zip(arm.dynamics.names, arm.f, strict=True))
    m3, m2, a3 = 7.0, 17.0, puma560.LINK_LENGTH
    x3, y3 = f["f5"] / m3, f["f6"] / m3
    izz3 = f["f2"] - m3 * (x3**2 + y3**2)
    x2, y2 = (f["f9"] - m3 * a3) / m2, f["f8"] / m2
    rotor2, rotor3 = RIG.drive.reflected_inertia()
    izz2 = f["f7"] - rotor2 - m3 * a3**2 - f["f2"] - m2 * (x2**2 + y2**2)
    assert f["f1"] - f["f2"] == pytest.approx(rotor3)
    return ((m2, (x2, y2), izz2), (m3, (x3, y3), izz3))


def model(arm, elasticity, steps=STEPS):
    """The arm on its springs; frame 2 is the world at q = 0, and positive q2 lowers the arm."""
    (m2, (x2, y2), i2), (m3, (x3, y3), i3) = planar_bodies(arm)
    rotors = RIG.drive.reflected_inertia()
    viscous, coulomb = RIG.drive.joint_viscous(), RIG.drive.joint_coulomb([0.0, 0.0])
    hard = "solreffriction='0.0001 1' solimpfriction='0.9999 0.9999 0.001'"
    motors = "".join(
        f"<body name='m{i}' pos='{i} 5 0'><joint name='motor{i}' axis='0 0 1' damping='{viscous[i]}' "
        f"frictionloss='{coulomb[i]}' {hard}/><inertial pos='0 0 0' mass='1' diaginertia='5 5 {rotors[i]}'/></body>"
        for i in range(2)
    )
    tendons = "".join(
        f"<fixed name='gear{i}' stiffness='{elasticity.stiffness[i]}' damping='{elasticity.damping[i]}' "
        f"springlength='0'><joint joint='motor{i}' coef='1'/><joint joint='link{i}' coef='-1'/></fixed>"
        for i in range(2)
    )
    return mujoco.MjModel.from_xml_string(
        f"<mujoco><option timestep='{RIG.period / steps}' gravity='0 9.81 0' "
        f"integrator='implicitfast' tolerance='1e-12'/><worldbody>{motors}"
        f"<body><joint name='link0' axis='0 0 1'/><inertial pos='{x2} {y2} 0' mass='{m2}' diaginertia='5 5 {i2}'/>"
        f"<body pos='{puma560.LINK_LENGTH} 0 0'><joint name='link1' axis='0 0 1'/>"
        f"<inertial pos='{x3} {y3} 0' mass='{m3}' diaginertia='5 5 {i3}'/></body></body></worldbody>"
        f"<tendon>{tendons}</tendon></mujoco>"
    )


def p_loop(arm, elasticity, gain, link, duration, steps):
    """A record of the arm under P as fast hardware, which reads its counts at every step of the engine."""
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
        t=t[rows], reference_pulses=commanded[rows], error_pulses=errors[rows], rig=RIG, law=puma560.p_law(gain),
        reference=PATH,
    )  # fmt: skip


def run(arm, elasticity, law, link, path=PATH, duration=DURATION, steps=STEPS):
    """Counted errors (N, 2) of the motors, angles (N, 2) of the links, which start at `link`."""
    engine = model(arm, elasticity, steps)
    data = mujoco.MjData(engine)
    samples = math.ceil(duration / RIG.period)
    t = RIG.period * np.arange(samples)
    motion = path(t)
    given = path.links(t) if law.of_links else motion
    data.qpos[:] = [*motion.q[0], *link]
    data.qvel[:] = [*motion.qd[0], *motion.qd[0]]
    controller = law.start(RIG, RIG.counts(motion.q[0]), guards=None)
    errors, links = np.empty((samples, 2)), np.empty((samples, 2))
    for k in range(samples):
        counts = RIG.counts(data.qpos[:2].copy())
        errors[k], links[k] = RIG.counts(motion.q[k]) - counts, data.qpos[2:]
        torque = controller.step(counts, given.q[k], given.qd[k], given.qdd[k])
        data.qfrc_applied[:2] = torque
        mujoco.mj_step(engine, data, nstep=steps)
    return errors, links


@pytest.mark.parametrize("hz", [25, 60, 150])
def test_links_and_motors_move_as_in_another_engine(hz):
    """Friction is another's constraint here: motors agree to a pulse, links to 0.15 mrad of some mrad of deflection."""
    arm = puma560.literature_arm(1.5)
    elasticity = Elasticity.from_resonance(arm, hz, 0.02, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))
    law = FeedForward(arm, RIG, feedback=PD(
        gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period))  # fmt: skip
    ours = simulate(arm, rig, law, PATH, duration=DURATION, steps_per_sample=16)
    errors, links = run(arm, elasticity, law, ours.true_q[0])
    assert np.abs(errors).max() <= 2
    assert np.abs(ours.error_pulses).max() <= 2
    deflection = np.abs(RIG.cell_centre(ours.counts) - ours.true_q).max()
    assert np.abs(links - ours.true_q).max() < 0.04 * deflection + 7.3e-5


def test_a_verdict_that_is_true_on_a_rigid_arm_fails_in_both_engines():
    """Computed torque with its observer at bandwidth 150 on a resonance of 100 Hz: negative damping, full torque."""
    arm = puma560.literature_arm(1.5)
    elasticity = Elasticity.from_resonance(arm, 100, 0.02, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))
    law = ComputedTorque(arm, RIG, bandwidth=150)
    ours = simulate(arm, rig, law, PATH, duration=DURATION, steps_per_sample=16)
    errors, _ = run(arm, elasticity, law, ours.true_q[0])
    for each in (errors, ours.error_pulses):
        assert (np.abs(each).max(axis=1) <= 1).mean() < 0.2
    assert (np.abs(simulate(arm, RIG, law, PATH, duration=DURATION).error_pulses) <= 1).all()


SOFT = PD(gain=(0.06, 0.045), derivative=(2.4e-4, 1.8e-4), filter=4000.0, period=RIG.period)
LAWS = {
    "flexible joint": lambda arm, rig: FlexibleJointComputedTorque(arm, rig, feedback=SOFT),
    "feed-forward": lambda arm, rig: FeedForward(arm, rig, feedback=SOFT),
    "PID": lambda arm, rig: ComputedTorquePID(
        arm, rig, bandwidth=120.0, ratio=2.0, integral=24.0, roll_off=3000.0, roll_off_damping=0.96
    ),
}


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
@pytest.mark.parametrize("share", [1.0, 0.8])
def test_links_of_another_engine_follow(law, share):
    """All of (6) at 25 Hz, every joint: within 0.03 mrad plus 0.9 mrad times what the known stiffness is off by.

    Without `LinkReference` 0.8 mrad. MuJoCo at a twentieth of a sample gives the same as at a hundredth, to 5 %.
    """
    arm = puma560.literature_arm(1.5)
    true = Elasticity.from_resonance(arm, 25, 0.02, drive=RIG.drive)
    known = dataclasses.replace(true, stiffness=share * true.stiffness)
    rig, real = (dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=e)) for e in (known, true))
    motors, controller = LinkReference(arm, rig, PATH), law(arm, rig)
    hanging = simulate(arm, real, controller, motors, duration=2 * RIG.period).true_q[0]
    errors, links = run(arm, true, controller, hanging, motors, PATH.duration, 20)
    t = RIG.period * np.arange(len(links))
    rms = 1e3 * np.sqrt(((PATH(t).q - links) ** 2).mean(axis=0))
    assert (rms < 0.03 + 0.9 * abs(1 / share - 1)).all()
    assert np.abs(errors[t > 0.02]).max() <= 1
    if share != 1:
        assert rms.max() > 0.1  # as it must


def test_the_resonance_of_another_engine_is_identified_from_counts_alone():
    """60 and 45 Hz, from 2 s of a P loop; the rig of the log knows of no gears."""
    arm, gain = puma560.literature_arm(1.5), np.array([0.1, 0.08])
    elasticity = Elasticity.from_resonance(arm, (60, 45), 0.02, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))
    link = simulate(arm, rig, puma560.p_law(gain), PATH, duration=0.01).true_q[0]  # where links hang
    record = p_loop(arm, elasticity, gain, link, 2.0, 16)
    resonance = identify(arm.dynamics, record, elasticity=True, progress=False).resonance
    np.testing.assert_allclose(resonance.hz, [60, 45], rtol=0.1)
    assert ((resonance.low < [60, 45]) & (resonance.high > [60, 45])).all()

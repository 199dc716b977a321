"""Laws that know the springs of their rig carry them, as they carry friction; certificates and
stops do too.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import without_friction
from uncertain import with_uncertainty

from ctc import (
    Adaptive,
    ComputedTorque,
    ComputedTorquePID,
    FeedForward,
    PDGravity,
    SlidingMode,
    certify,
    evaluate,
)
from identification import identify
from plant import PD, Elasticity, Guards, JointSpring, LinkReference, SteppedArm, puma560, simulate

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
K, REST = np.array([80.0, 30.0]), np.array([0.3, -0.5])
SPRINGS = JointSpring(stiffness=K, angle=REST)
SPRUNG = dataclasses.replace(RIG, springs=SPRINGS)
# As without them, in the kernel of those that have them.
SLACK = dataclasses.replace(RIG, springs=dataclasses.replace(SPRINGS, stiffness=0 * K))
FEEDBACK = PD(gain=(0.2, 0.15), derivative=(4e-4, 2e-4), filter=2000.0, period=RIG.period)
LAWS = {
    "computed torque": lambda rig: ComputedTorque(ARM, rig, bandwidth=150.0),
    "measured": lambda rig: ComputedTorque(ARM, rig, bandwidth=150.0, measured=True),
    "PID": lambda rig: ComputedTorquePID(
        ARM, rig, bandwidth=179.0, ratio=1.44, integral=66.4, roll_off=1085.0, roll_off_damping=0.99
    ),
    "feed-forward": lambda rig: FeedForward(ARM, rig, feedback=FEEDBACK),
    "gravity": lambda rig: PDGravity(ARM, rig, feedback=FEEDBACK),
    "sliding mode": lambda rig: SlidingMode(
        ARM, rig, bandwidth=60.0, reach=5.0, layer=0.05, filter=600.0
    ),
    "adaptive": lambda rig: Adaptive(
        ARM, rig, bandwidth=60.0, gain=(300.0, 80.0), adaptation=np.full(9, 0.01), filter=600.0
    ),
}


def asked(law, pulses, motion):
    """Commanded torque of a first step, by casadi."""
    block = law.block(RIG)
    return (
        block.step(
            block.initial, *motion, RIG.counts(motion[0]), pulses, 0, law.period, block.values
        )[0]
        .full()
        .ravel()
    )


@pytest.mark.parametrize("name", LAWS)
def test_on_the_reference_the_torque_is_less_by_that_of_the_springs(name):
    random = np.random.default_rng(5)
    for _ in range(5):
        pulses = random.integers(-5000, 5000, 2)
        motion = RIG.cell_centre(pulses), random.normal(0, 0.5, 2), random.normal(0, 1, 2)
        plain, sprung = (asked(LAWS[name](rig), pulses, motion) for rig in (RIG, SPRUNG))
        np.testing.assert_allclose(sprung - plain, K * (motion[0] - REST), rtol=0, atol=1e-10)


@pytest.mark.parametrize("name", LAWS)
def test_an_arm_with_springs_is_tracked_as_well_as_one_without(name):
    """Loops differ by single counts, whose rounding is chaos."""
    plain, sprung, unknown = (
        evaluate(
            ARM, rig, LAWS[name](known), PATH, duration=1.0, backend="numba", steps_per_sample=4
        )
        for rig, known in ((SLACK, SLACK), (SPRUNG, SPRUNG), (SPRUNG, SLACK))
    )
    after = plain.record.t > 0.1
    rms = [
        np.sqrt((each.record.error_pulses[after] ** 2).mean()) for each in (plain, sprung, unknown)
    ]
    assert rms[1] < 1.2 * rms[0] + 0.1
    if name in ("feed-forward", "gravity", "sliding mode", "adaptive"):
        # the others have an observer or an integral that is fast enough to hide it
        assert rms[2] > 1.5 * rms[1]


def test_a_law_that_knows_no_rig_does_not_know_them():
    """P needs the error that its torque needs: on average, that of the springs in pulses."""
    law, rig = puma560.p_law(), dataclasses.replace(SPRUNG, springs=SPRINGS)
    plain, sprung = (simulate(ARM, each, law, PATH) for each in (RIG, rig))
    more = (sprung.error_pulses - plain.error_pulses).mean(axis=0) * law.gain * RIG.drive.gear
    np.testing.assert_allclose(more, K * (sprung.true_q.mean(axis=0) - REST), rtol=0.02)


def test_links_behind_elastic_gears_follow_with_springs_on_them():
    gears = Elasticity.from_resonance(ARM, 25, 0.02, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    rig, rms = without_friction(rig, viscous=True), []
    for known in (SPRINGS, None):
        own = dataclasses.replace(rig, springs=known)
        law = ComputedTorque(ARM, own, bandwidth=80, dead_zone=0.4)
        report = evaluate(
            ARM,
            dataclasses.replace(rig, springs=SPRINGS),
            law,
            LinkReference(ARM, own, PATH),
            duration=1.0,
            backend="numba",
            steps_per_sample=4,
        )
        rms.append(np.sqrt((report.link_error[200:] ** 2).mean()))
    assert rms[0] < 1e-4  # [rad]
    assert rms[1] > 10 * rms[0]


def test_a_ramp_to_gravity_ends_where_the_arm_is_held():
    q, still = np.array([0.3, -0.4]), np.zeros(2)
    robot = SteppedArm(ARM, SPRUNG, q)
    running = LAWS["computed torque"](SPRUNG).start(
        SPRUNG, robot.pulses, guards=Guards(stop="gravity", patience=0)
    )
    robot.step(running.step(robot.pulses, q, still, still))
    for _ in range(100):
        counts = robot.pulses
        torque = running.step(counts, np.full(2, np.nan), still, still)
        robot.step(torque)
    here = RIG.cell_centre(counts)
    np.testing.assert_allclose(torque, ARM.h(here, still) + K * (here - REST), rtol=1e-9)


@pytest.mark.slow
def test_a_certificate_has_the_springs_and_draws_those_that_were_identified():
    law = LAWS["feed-forward"](SPRUNG)
    stiffer = dataclasses.replace(SPRUNG, springs=dataclasses.replace(SPRINGS, stiffness=3 * K))
    options = {"duration": 0.5, "backend": "numba"}
    peaks = [
        evaluate(ARM, rig, law, PATH, **options).max_error_pulses.max() for rig in (SPRUNG, stiffer)
    ]
    assert peaks[1] > peaks[0] + 1
    options = {
        "samples": 40,
        "friction": 0.0,
        "phase": False,
        "duration": 0.5,
        "within": peaks[0],
        "progress": False,
    }
    tight = 1e-12 * np.diag(ARM.f**2)
    assert (
        certify(ARM, SPRUNG, law, PATH, **with_uncertainty(covariance=tight, **options)).failures
        == 0
    )
    assert (
        certify(ARM, stiffer, law, PATH, **with_uncertainty(covariance=tight, **options)).failures
        == 40
    )

    record = simulate(ARM, SPRUNG, puma560.p_law(), PATH)
    unknown = (*ARM.dynamics.names, "springs.stiffness[0]")
    found = identify(
        ARM.dynamics, record, unknown=unknown, method="prediction_error", progress=False
    )
    certificate = certify(found, found.rig, law, PATH, **with_uncertainty(**options))
    drawn = certificate.plants.values[:, certificate.plants.names.index("springs.stiffness[0]")]
    np.testing.assert_allclose(drawn.mean(), found.rig.springs.stiffness[0], rtol=0.02)
    assert 0.5 < drawn.std() / np.sqrt(found.covariance[-1, -1]) < 2  # of 40


def test_the_torque_of_a_law_with_springs_is_one_expression():
    """The law's springs are numbers of the law: they can be unknown, and C has them as
    constants.
    """
    law = LAWS["computed torque"](SPRUNG)
    block = law.block(RIG)
    assert "law.rig.springs.stiffness[0]" in block.names
    place, numbers = (
        block.names.index("law.rig.springs.stiffness[0]"),
        ca.SX.sym("numbers", len(block.names)),
    )
    motion, still = np.array([0.1, 0.2]), np.zeros(2)
    out = block.step(
        block.initial,
        motion,
        still,
        still,
        RIG.counts(motion),
        RIG.counts(motion),
        0,
        law.period,
        numbers,
    )
    slope = ca.Function("slope", [numbers], [ca.jacobian(out[0], numbers[place])])(block.values)
    np.testing.assert_allclose(slope.full().ravel(), [0.1 - 0.3, 0.0], atol=1e-12)

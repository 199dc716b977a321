"""Float: the arm carries its weight, rests when released, and refuses to drive itself."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque, Float, FloatSettings, evaluate_float
from identification import identify
from plant import Harmonics, puma560, simulate

ARM = puma560.literature_arm(1.5)
RIG = puma560.rig()
POSE = np.array([0.3, 0.4])
ZERO = np.zeros((2, 1))
HERE = Harmonics(period=4.0, offset=POSE, cosine=ZERO, sine=ZERO)
# As after an identification.
KNOWN = FloatSettings(gravity=0.005)
COULOMB = RIG.drive.joint_coulomb(np.zeros(2))


def released(law, *, speed=0.5, gravity=1.0, friction=1.0, duration=3.0):
    """Counts of an arm that a hand lets go of at this speed."""
    arm = ARM.dynamics.arm(gravity * ARM.f)
    drive = dataclasses.replace(RIG.drive, coulomb=friction * RIG.drive.coulomb)
    rig = dataclasses.replace(RIG, drive=drive)
    return simulate(arm, rig, law, HERE, duration=duration, initial=(POSE, np.full(2, speed)))


def test_an_arm_at_rest_stays_where_it_is():
    record = released(Float(ARM, RIG, settings=KNOWN), speed=0.0)
    assert (record.counts == record.counts[0]).all()


@pytest.mark.parametrize(("assist", "gravity"), [(0.0, 1.02), (0.5, 1.02), (0.65, 1.0)])
def test_a_released_arm_comes_to_rest(assist, gravity):
    """Friction is 30 % below that of the model, and gravity is off."""
    record = released(Float(ARM, RIG, assist=assist, settings=KNOWN), gravity=gravity, friction=0.7)
    assert (record.counts[-500:] == record.counts[-1]).all()


def torques(law, speed, moving, resting):
    """Torque less gravity (N, n) of a law that reads counts of this motion, then of rest."""
    controller = law.start(RIG, RIG.counts(POSE), guards=None)
    rows = []
    for k in range(moving + resting):
        q = POSE + speed * RIG.period * min(k, moving)
        torque = controller.step(RIG.counts(q), q, np.zeros(2), np.zeros(2))
        rows.append(torque - ARM.dynamics.gravity(q, ARM.f).full().ravel())
    return np.array(rows)


def test_the_assistance_is_that_share_of_friction_and_ends_with_the_motion():
    speed = np.array([0.4, -0.3])
    law = Float(ARM, RIG, assist=0.6, settings=KNOWN)
    samples = round(3 * law.leak / RIG.period)
    rows = torques(law, speed, samples, 2 * samples)
    friction = COULOMB * np.sign(speed) + RIG.drive.joint_viscous() * speed
    assert rows[samples - 1] == pytest.approx(0.6 * friction, rel=0.1)
    assert np.abs(rows[-1]).max() < 0.05 * np.abs(friction).max()


def test_beyond_its_speed_the_law_brakes():
    speed = np.array([1.0, 1.0])
    law = Float(ARM, RIG, assist=0.7, speed=0.5, settings=KNOWN)
    rows = torques(law, speed, 300, 0)
    assert (rows[-1] < 0).all()


@pytest.mark.parametrize("assist", [0.8, 1.1])
def test_an_assistance_that_could_drive_the_arm_is_refused(assist):
    with pytest.raises(ValueError, match=r"assist must be at most 0\.7[56]"):
        Float(ARM, RIG, assist=assist, settings=KNOWN)


def test_a_bare_arm_may_be_five_percent_heavier():
    """The bound (1 - dg / F) / (1 + s) with dg of the heaviest pose: both sides of it."""
    weight = np.array([ARM.dynamics.gravity(q, ARM.f).full()[:, 0] for q in Float(
        ARM, RIG, assist=0.1
    ).poses()])  # fmt: skip
    bound = ((1 - 0.05 * np.abs(weight).max(axis=0) / COULOMB) / 1.3).min()
    assert Float(ARM, RIG, assist=bound - 1e-6).assist > 0.5
    with pytest.raises(ValueError, match="assist must be at most"):
        Float(ARM, RIG, assist=bound + 1e-6)


@pytest.mark.parametrize("assist", [0.0, 0.5])
def test_an_arm_that_its_friction_may_not_hold_is_refused(assist):
    """Of a joint whose weight is 5 % wrong by more than its friction nothing is accepted."""
    drive = dataclasses.replace(RIG.drive, coulomb=0.1 * RIG.drive.coulomb)
    light = dataclasses.replace(RIG, drive=drive)
    with pytest.raises(ValueError, match=r"must be known within its dry friction, 1\.3 N m"):
        Float(ARM, light, assist=assist)
    assert Float(ARM, light, assist=assist, settings=KNOWN).assist == assist


@pytest.mark.parametrize("share", [0.7, 1.0])
def test_with_less_friction_than_the_model_nothing_runs_away(share):
    """A thousand samples after a push: the speed never grows."""
    law = Float(ARM, RIG, assist=0.7, settings=KNOWN)
    record = released(law, friction=share, duration=1000 * RIG.period)
    ways = np.abs(np.diff(record.counts[::100], axis=0))
    assert (np.diff(ways, axis=0) <= 1).all()
    assert len(record.counts) >= 1000


@pytest.mark.slow
def test_what_an_identification_leaves_open_lowers_the_bound():
    """With deviations twice as large the same assistance could drive a joint."""
    record = simulate(ARM, RIG, puma560.p_law(), puma560.reference())
    names = (*ARM.dynamics.names, "drive.coulomb[0]", "drive.coulomb[1]")
    estimate = identify(ARM.dynamics, record, unknown=names, progress=False)
    assert Float(estimate, assist=0.7).assist == 0.7
    wide = dataclasses.replace(estimate.fit, covariance=4 * estimate.fit.covariance)
    vague = dataclasses.replace(estimate, fit=wide)
    with pytest.raises(ValueError, match="assist must be at most"):
        Float(vague, assist=0.7)
    # What nobody states is what the joint allows, and a warning names it.
    assert Float(estimate).assist == 0.7
    with pytest.warns(UserWarning, match=r"joint \d \(q\[\d\]\) could drive itself"):
        law = Float(vague)
    assert 0.3 < law.assist < 0.7
    assert Float(vague, assist=law.assist).assist == law.assist


def test_the_verdict_shows_the_force_of_the_hand_before_and_after():
    verdict = evaluate_float(ARM, Float(ARM, RIG, assist=0.5), tip=(0.3, 0.0, 0.0))
    rms = [np.sqrt(np.mean(force**2)) for force in (verdict.limp, verdict.floating)]
    assert rms[1] < 0.5 * rms[0]
    # Exactly known arms: the hand gives the share of Coulomb friction that is left.
    with pytest.raises(ValueError, match="law must be"):
        evaluate_float(ARM, ComputedTorque(ARM, RIG))

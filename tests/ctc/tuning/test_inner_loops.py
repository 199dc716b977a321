"""The inner loop that `tune` proposes, and what verdicts say of servos."""

import dataclasses
import functools
import importlib

import numpy as np
import pytest
from servos import GAIN, arm, dynamics, rig

from ctc import ComputedTorque, Uncertainty, certify, evaluate, tune
from ctc.tuning import SearchSettings, families
from plant import Elasticity, Encoder, Harmonics, MitDrive, PositionServo

TUNE = importlib.import_module("ctc.tuning.tune")
ARM = arm()
ZERO = ((0,), (0,))
PATH = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=ZERO, sine=((0.2,), (-0.2,)))
STATED = Uncertainty(plants=[ARM.f], friction=0.1)


def servo(P, **fields):
    return PositionServo(gain=P * GAIN / 32, **fields)


@functools.cache
def tuning():
    """A servo with a dead zone of 200 counts holds nothing within 2."""
    inner = {2: servo(16, dead_zone=200), 16: servo(16), 64: servo(64)}
    return tune(
        ARM, rig(), PATH, STATED, within=2, inner=inner, samples=8, duration=0.6, progress=False
    )


@pytest.mark.slow
def test_the_quietest_register_that_holds_is_proposed():
    trials = tuning().inner
    assert trials[-1].register == 2
    assert trials[-1].left == trials[-1].of
    assert [trial.left for trial in trials[:2]] == [0, 0]
    assert trials[0].noise <= trials[1].noise
    # The search goes on above it.
    np.testing.assert_array_equal(tuning().law.rig.inner.gain, trials[0].inner.gain)
    assert f"chosen: {trials[0].register}" in str(tuning())


def test_a_weak_joint_counts_like_a_strong_one(monkeypatch):
    """Chatter in shares of the torques: those of the elbow are a fraction of those of the lift."""
    few = SearchSettings(
        inner_samples=4, validation_samples=4, rounds=((1, np.inf),), quieter_searches=0
    )
    monkeypatch.setattr(TUNE, "SETTINGS", few)
    monkeypatch.setattr(TUNE, "families", lambda *some: families(*some)[:1])
    options = {"within": 200, "samples": 4, "duration": 0.6, "progress": False}
    inner = {"soft": servo(16), "stiff": servo(64)}
    trials = tune(ARM, rig(), PATH, STATED, inner=inner, **options).inner
    states = PATH(np.linspace(0, 0.6, 200))
    torques = [ARM.inverse(*state) for state in zip(*states, strict=True)]
    scale = np.sqrt(np.mean(np.square(torques), axis=0))
    assert scale[0] > 2 * scale[1]
    for trial in trials:
        assert trial.rank == (0, pytest.approx((trial.chatter / scale).mean()))


def test_the_integers_of_frames_stand_for_their_gains():
    loop = rig(0.002, None)
    drive = MitDrive.for_arm(ARM, loop, stiffness=40)
    kp, kd = drive.whole_gains
    # Of 12 bits that begin at 0 and end at 500 and 5.
    assert np.array(kp) * 500 / 4095 == pytest.approx(drive.kp, rel=1e-12)
    assert np.array(kd) * 5 / 4095 == pytest.approx(drive.kd, rel=1e-12)


@pytest.mark.parametrize("inner", [{}, [16, 32], {16: 0.02}])
def test_what_is_no_loop_by_its_register_is_refused(inner):
    with pytest.raises(ValueError, match=r"^inner.*Give \{P: PositionServo"):
        tune(ARM, rig(), PATH, STATED, inner=inner, samples=8, duration=0.2, progress=False)


def test_a_certificate_names_the_joints_within_their_play():
    equations = dynamics(gravity=(0, 0, 0))
    weightless = equations.arm(equations.f())
    loop = rig()
    gears = Elasticity(stiffness=(500, 500), damping=(1, 1), backlash=np.deg2rad((1.0, 1.0)))
    loose = dataclasses.replace(
        loop,
        drive=dataclasses.replace(loop.drive, elasticity=gears),
        encoder=Encoder(resolution=4096, side="link"),
    )
    law = ComputedTorque(weightless, loop)
    slow = Harmonics(period=10.0, offset=(0.3, -0.2), cosine=ZERO, sine=((0.4,), (-0.4,)))
    stated = Uncertainty(plants=[weightless.f], friction=0.1)
    certificate = certify(weightless, loose, law, slow, stated, samples=8, progress=False)
    assert certificate.failures == 8
    for joint in ("lift", "elbow"):
        assert f"joint {joint}" in str(certificate)
    assert str(certificate).count("within the play, 11.4 pulses") == 2


@pytest.mark.parametrize(("speed", "slow"), [(300.0, 2), (600.0, 0), (np.inf, 0)])
def test_a_profile_slower_than_the_path_is_named(speed, slow):
    """The path has 0.2 rad at 1/2 Hz: 410 counts per second."""
    loop = rig(inner=servo(32, speed=speed))
    report = evaluate(ARM, loop, ComputedTorque(ARM, rig()), PATH, duration=1.0)
    assert len(report.slow_profiles) == slow
    assert (
        sum("the servo's own profile, 300 pulses/s" in line for line in report.conditions) == slow
    )

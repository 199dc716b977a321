"""P gain from currents, friction from a motor test: known truths under noise."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import motor_test
from plant import PointToPoint, puma560, simulate

RIG = puma560.rig()


@pytest.fixture(scope="module")
def record():
    made = simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference())
    noise = np.random.default_rng(0).normal(size=made.current.shape)
    return dataclasses.replace(made, current=made.current + 0.3 * noise, torque=None)


def test_gain_is_found_within_two_per_cent_and_three_deviations(record):
    found = motor_test(record)
    assert found.names == ("law.gain[0]", "law.gain[1]")
    np.testing.assert_allclose(found.values, (0.20, 0.15), rtol=0.02)
    assert (np.abs(found.values - (0.20, 0.15)) < 3 * found.std).all()
    assert (found.std < 0.005 * found.values).all()
    assert "law.gain[0]" in str(found)


def test_a_wrong_motor_constant_makes_a_wrong_gain_by_the_same_factor(record):
    drive = dataclasses.replace(RIG.drive, motor_gain=2 * RIG.drive.motor_gain)
    twice = dataclasses.replace(record, rig=dataclasses.replace(RIG, drive=drive))
    np.testing.assert_allclose(motor_test(twice).values, 2 * motor_test(record).values, rtol=1e-12)


def test_samples_at_the_limit_say_nothing_of_the_gain(record):
    drive = dataclasses.replace(RIG.drive, current_limit=(5.0, 12.0))
    rig = dataclasses.replace(RIG, drive=drive)
    cut = simulate(puma560.arm(), rig, puma560.p_law(), puma560.reference())
    assert (np.abs(cut.current[:, 0]) >= 5.0 - 1e-9).mean() > 0.02
    np.testing.assert_allclose(motor_test(cut).values, (0.20, 0.15), rtol=1e-9)


def test_rows_without_weight_say_nothing_of_the_gain(record):
    wrong = slice(100, 160)
    current = record.current.copy()
    current[wrong] = 7.0
    valid = np.ones(len(record))
    valid[wrong] = 0.0
    kept = motor_test(dataclasses.replace(record, valid=valid))
    found = motor_test(dataclasses.replace(record, current=current, valid=valid))
    np.testing.assert_array_equal(found.values, kept.values)
    np.testing.assert_array_equal(found.std, kept.std)


def test_an_injected_torque_is_no_part_of_the_gain():
    made = simulate(
        puma560.arm(),
        RIG,
        puma560.p_law(),
        puma560.reference(),
        duration=1.0,
        injected=lambda t: np.sin(2 * np.pi * 3 * t)[:, None] * (20.0, 15.0),
    )
    np.testing.assert_allclose(motor_test(made).values, (0.20, 0.15), rtol=1e-9)


def test_friction_is_found_within_five_per_cent():
    random = np.random.default_rng(1)
    speed = np.concatenate([np.linspace(20, 200, 15), -np.linspace(20, 200, 15)])
    torque = 0.817e-3 * speed + 0.124 * np.sign(speed) + 0.01
    current = torque / 0.228 * (1 + 0.03 * random.normal(size=30))
    found = motor_test(speed=speed, current=current, motor_gain=0.228)
    np.testing.assert_allclose(found.values[:2], (0.817e-3, 0.124), rtol=0.05)
    assert (np.abs(found.values - (0.817e-3, 0.124, 0.01)) < 3 * found.std).all()


def friction(speed, current, motor_gain):
    return motor_test(speed=speed, current=current, motor_gain=motor_gain)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda r: motor_test(dataclasses.replace(r, current=None)), "must hold currents"),
        (
            lambda r: motor_test(
                simulate(
                    puma560.arm(), RIG, puma560.p_law((5, 5)),
                    PointToPoint(start=(0, 0), goal=(0, 0), duration=0.01),
                )
            ),
            r"motor of joint q\[0\] must have errors",
        ),
        (lambda r: motor_test(RIG), "must be of type Record"),
        (lambda r: motor_test(r, motor_gain=0.2), "a record must come alone"),
        (lambda r: motor_test(speed=[1, -1], motor_gain=0.2), "must come together"),
        (
            lambda r: motor_test(dataclasses.replace(r, law=ComputedTorque(puma560.arm(), RIG))),
            "must be one under P control; got ComputedTorque",
        ),
        (lambda r: friction([9, 5, -5, -9], [-3, -2, 2.1, 3], 0.2), "friction must be positive"),
        (
            lambda r: motor_test(dataclasses.replace(r, current=-r.current)),
            r"gain of joint q\[0\] must be positive; found -0\.2",
        ),
        (lambda r: motor_test(), "got none"),
        (lambda r: friction([1, 2, 3, 4], [1, 2, 3, 4], 0.2), "both signs"),
        (lambda r: friction([], [], 0.2), "both signs; got none"),
        (lambda r: friction([9, 5, 0, -5, -9], [3, 2, 1, -2, -3], 0.2), "got 0 at index 2"),
        (lambda r: friction([9, 9, -5, -5], [3, 3, -2, -2], 0.2), "three values .* got 2"),
        (lambda r: friction([1, -2, 3], [1, 2, 3], 0.2), "needs more readings"),
        (lambda r: friction([1, -2], [1], 0.2), "current must have shape"),
        (lambda r: friction([1, -2, 3, 4], [1, 2, 3, np.nan], 0.2), "current must be finite"),
        (lambda r: friction([1, -2, 3, 4], [1, 2, 3, 4], -1), "positive"),
    ],
)  # fmt: skip
def test_bad_input_is_refused(record, call, says):
    with pytest.raises(ValueError, match=says):
        call(record)

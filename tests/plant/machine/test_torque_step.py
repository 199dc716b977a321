"""Torques rounded by the drive: multiples of its step everywhere, to the nearest, in Python, C
and the verdict.
"""

import ctypes
import dataclasses
import shutil
import subprocess

import casadi as ca
import numpy as np
import pytest

from ctc import ComputedTorque, evaluate
from plant import Robot, SteppedArm, puma560, read_robot, simulate, write_robot

ARM, PLAIN = puma560.arm(), puma560.rig()
RATED = PLAIN.drive.motor_gain * PLAIN.drive.current_limit / 3  # of the motors [N m]
STEP = RATED / 1000  # per mille, as CiA 402 has it


def stepped(step):
    return dataclasses.replace(PLAIN, drive=dataclasses.replace(PLAIN.drive, torque_step=step))


RIG, DT = stepped(STEP), PLAIN.period
PATH = puma560.reference()


def test_a_running_controller_gives_the_nearest_multiple_up_to_the_limit():
    plain, controller = (
        ComputedTorque(ARM, PLAIN).start(rig, PLAIN.counts(PATH([0.0]).q[0]))
        for rig in (PLAIN, RIG)
    )
    robot = SteppedArm(ARM, PLAIN, PATH([0.0]).q[0])
    for k in range(300):
        motion = [each[0] for each in PATH([k * DT])]
        torque = controller.step(robot.pulses, *motion)
        steps = RIG.drive.motor_torque(torque) / STEP
        np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-9)
        if k == 0:  # from then on the laws have other memories
            half = np.abs(RIG.drive.gear) * STEP / 2
            assert (np.abs(torque - plain.step(robot.pulses, *motion)) <= half * (1 + 1e-9)).all()
        robot.step(torque)
    limit = RIG.drive.torque_limit()
    np.testing.assert_array_equal(RIG.drive.limited(3 * limit), limit)


def test_the_logged_torque_of_a_simulation_has_steps_and_a_robot_file_keeps_them(tmp_path):
    record = simulate(ARM, RIG, ComputedTorque(ARM, RIG), PATH, duration=0.3)
    steps = RIG.drive.motor_torque(record.torque) / STEP
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=1e-9)
    assert np.ptp(steps, axis=0).min() > 10
    write_robot(
        Robot(name="stepped", dynamics=ARM.dynamics, rig=RIG, arm=ARM), tmp_path / "robot.toml"
    )
    assert read_robot(tmp_path / "robot.toml").rig == RIG


def test_it_is_the_nearest_multiple_for_numbers_and_for_symbols():
    asked = np.random.default_rng(3).uniform(-50, 50, (200, 2))
    symbols = ca.SX.sym("tau", 2)
    function = ca.Function("limited", [symbols], [RIG.drive.limited(symbols)])
    half = np.abs(RIG.drive.gear) * STEP / 2
    for torque in asked:
        given = RIG.drive.limited(torque)
        assert (np.abs(given - torque) <= half * (1 + 1e-9)).all()
        np.testing.assert_allclose(function(torque).full().ravel(), given, rtol=0, atol=1e-12)


@pytest.mark.parametrize("share", [1, 30])
def test_the_verdict_has_it_by_both_backends_and_more_for_larger_steps(share):
    rig = stepped(share * STEP)
    law = ComputedTorque(ARM, rig)
    casadi, numba = (
        evaluate(ARM, rig, law, PATH, duration=1.0, backend=each) for each in ("casadi", "numba")
    )
    np.testing.assert_allclose(casadi.max_true_error_pulses, numba.max_true_error_pulses, rtol=1e-6)
    without = evaluate(ARM, PLAIN, ComputedTorque(ARM, PLAIN), PATH, duration=1.0)
    assert (casadi.max_true_error_pulses != without.max_true_error_pulses).all()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) here")
def test_c_gives_per_mille_of_the_rated_torque(tmp_path):
    law, pulses = ComputedTorque(ARM, RIG), RIG.counts((0.3, -0.4)).astype(np.int32)
    per_ampere = 1000 * RIG.drive.motor_gain / RATED
    law.start(RIG, pulses).to_c(tmp_path, name="arm", output="dac", counts_per_ampere=per_ampere)
    library, flags = (
        tmp_path / "arm.so",
        ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off"],
    )
    subprocess.run(  # noqa: S603
        ["cc", *flags, "-shared", "-fPIC", "-o", library, tmp_path / "arm.c", "-lm"],  # noqa: S607
        check=True,
    )
    c, state, given = ctypes.CDLL(str(library)), np.zeros(4000), np.zeros(2, np.int32)

    def at(values):
        return values.ctypes.data_as(ctypes.c_void_p)

    c.arm_init(at(state), at(pulses))
    python = law.start(RIG, pulses)
    for k in range(15):  # then a guard stops it: the counts stand still
        motion = [np.array(each) for each in ((0.3 + 1e-4 * k, -0.4), (0.1, 0.0), (0.5, -0.5))]
        assert (
            c.arm_step(at(state), at(pulses), *map(at, motion), ctypes.c_double(np.nan), at(given))
            == 0
        )
        np.testing.assert_allclose(
            given, RIG.drive.motor_torque(python.step(pulses, *motion)) / STEP, rtol=0, atol=1e-9
        )
        assert k == 0 or np.abs(given).min() > 0


@pytest.mark.parametrize("step", [0.0, -1e-3, (1e-3, 1e-3, 1e-3), np.nan, True, "1"])
def test_bad_input_is_refused_in_one_line(step):
    with pytest.raises(ValueError, match="torque_step") as error:
        stepped(step)
    assert "\n" not in str(error.value)

"""Torque ripple: its potential, its work, its stiffness."""

import dataclasses

import numpy as np
import pytest
from closed_loops import NoTorque, joint

from plant import Drive, Encoder, PointToPoint, Rig, TorqueRipple, linearise, puma560, simulate

GEAR, AMPLITUDE, CYCLES, INERTIA = -20.0, 0.05, 6.0, 2.0


def rig(phase=None, **friction):
    given = TorqueRipple(amplitude=(AMPLITUDE,), cycles=(CYCLES,), phase=phase)
    drive = Drive(
        gear=(GEAR,),
        motor_inertia=(1e-4,),
        motor_gain=(0.2,),
        current_limit=(np.inf,),
        ripple=given,
        **{"viscous": (0.0,), "coulomb": (0.0,)} | friction,
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=0.7e-3)


@pytest.mark.parametrize("phase", [None, (0.8,)])
def test_a_joint_that_coasts_over_it_keeps_its_energy(phase):
    """J v^2 / 2 + (amplitude / cycles) cos(cycles k q + phase) stays; so it does no work over a
    turn.
    """
    still = PointToPoint(start=(0.0,), goal=(0.0,), duration=1.0)
    record = simulate(
        joint(0.0, 0.3, INERTIA), rig(phase), NoTorque(), still, initial=[[0.0], [0.7]]
    )
    q, qd = record.true_q[:, 0], record.true_qd[:, 0]
    angle = CYCLES * GEAR * q + (0.0 if phase is None else phase[0])
    energy = INERTIA * qd**2 / 2 + AMPLITUDE / CYCLES * np.cos(angle)
    swing = AMPLITUDE / CYCLES
    # so there is something to keep
    assert np.ptp(INERTIA * qd**2 / 2) == pytest.approx(2 * swing, rel=0.1)
    assert np.ptp(energy) < 0.01 * swing
    assert np.ptp(q) > 2 * np.pi / abs(GEAR)  # more than a turn of the motor


def test_it_repeats_so_many_times_per_turn_and_has_no_mean():
    ripple = TorqueRipple(amplitude=(0.3, 0.2), cycles=(6.0, 4.0), phase=(0.1, 1.0))
    turn = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    torque = np.array([ripple.torque(np.array([a, a])) for a in turn])
    assert np.abs(torque.sum(axis=0)).max() < 1e-12
    spectrum = np.abs(np.fft.rfft(torque, axis=0)) / 120
    np.testing.assert_allclose(spectrum[[6, 4], [0, 1]], [0.3, 0.2], rtol=1e-12)
    np.testing.assert_allclose(
        ripple.torque(np.zeros(2)), [0.3 * np.sin(0.1), 0.2 * np.sin(1.0)], rtol=1e-14
    )


def test_its_work_on_the_joint_is_that_on_the_motor():
    plain = puma560.rig().drive
    drive = dataclasses.replace(plain, ripple=TorqueRipple(amplitude=(0.02, 0.03), cycles=(6, 8)))
    q = np.array([0.1, -0.2])
    motor = drive.ripple.torque(drive.motor_angle(q))
    np.testing.assert_allclose(drive.ripple_torque(q), drive.gear * motor, rtol=1e-14)


def test_a_drive_without_it_has_no_torque_of_it():
    assert puma560.rig().drive.ripple_torque(np.zeros(2)) == 0.0


def test_the_linear_model_has_its_stiffness():
    """At angle 0 the torque rises with amplitude cycles k^2 per rad: a spring that pushes away."""
    law = puma560.p_law((0.2, 0.15))
    arm, plain = puma560.arm(), puma560.rig()
    given = TorqueRipple(amplitude=(0.02, 0.03), cycles=(6.0, 8.0))
    rippled = dataclasses.replace(plain, drive=dataclasses.replace(plain.drive, ripple=given))
    one, other = (linearise(arm, each, law, [0.0, 0.0]).A for each in (plain, rippled))
    expected = np.linalg.solve(
        arm.D([0.0, 0.0]), np.diag(np.array([0.12, 0.24]) * plain.drive.gear**2)
    )
    np.testing.assert_allclose((other - one)[2:, :2], expected, rtol=1e-4)


def test_phases_that_stand_for_other_signs():
    """As the message on a wrong sign advises: phase + pi for -amplitude, pi - phase for -cycles."""
    angle, phase = np.linspace(-3, 3, 13), 0.4
    for sign, other in (
        (-np.sin(6 * angle + phase), phase + np.pi),
        (np.sin(-6 * angle + phase), np.pi - phase),
    ):
        ripple = TorqueRipple(amplitude=(1.0,), cycles=(6.0,), phase=(other,))
        np.testing.assert_allclose(ripple.torque(angle), sign, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: TorqueRipple(amplitude=(-0.1,), cycles=(6,)), "amplitude must not be negative"),
        (lambda: TorqueRipple(amplitude=(0.1,), cycles=(0,)), "cycles must be positive"),
        (lambda: TorqueRipple(amplitude=(0.1,), cycles=(-6,)), "for -cycles pi - phase"),
        (
            lambda: TorqueRipple(amplitude=(0.1,), cycles=(6, 6)),
            "cycles of TorqueRipple must have shape",
        ),
        (lambda: TorqueRipple(amplitude=(0.1,)), "missing a required argument: 'cycles'"),
        (
            lambda: dataclasses.replace(puma560.rig().drive, ripple=0.03),
            "ripple of Drive must be of type TorqueRipple",
        ),
        (
            lambda: dataclasses.replace(
                puma560.rig().drive, ripple=TorqueRipple(amplitude=(0.1,), cycles=(6,))
            ),
            "ripple.amplitude must have 2 joints; got 1",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)

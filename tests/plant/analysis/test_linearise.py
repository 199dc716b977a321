"""The linear model against the simulated loop: a transient, the spectrum's peak, stable poles."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from closed_loops import SampledP, without_friction
from scipy.linalg import expm

from plant import P, PointToPoint, linearise, modes, puma560, simulate

ARM, RIG, LAW = puma560.arm(), puma560.rig(), puma560.p_law()
POSES = [(0.0, 0.0), (-0.8, 1.2), (0.5, -1.5)]


def held_at(rig, law, pose, duration):
    """The reference at which the law's torque just carries the arm at this pose."""
    stiffness = law.gain * rig.drive.gear * rig.position_in_pulses(np.ones(2))
    goal = tuple(np.asarray(pose) + ARM.h(pose, np.zeros(2)) / stiffness)
    return PointToPoint(start=goal, goal=goal, duration=duration)


@pytest.mark.parametrize("pose", POSES)
def test_small_deviation_dies_out_as_the_linear_model_says(pose):
    """Gravity and viscous friction on, no Coulomb friction, no rounding; the deviation is 1e-4
    rad, about a pulse.
    """
    rig = without_friction(RIG, viscous=True, smooth=True)
    start = np.add([*pose, 0, 0], [1e-4, -0.5e-4, 0, 0])
    record = simulate(ARM, rig, LAW, held_at(rig, LAW, pose, 0.25), initial=start.reshape(2, 2))
    once = expm(linearise(ARM, rig, LAW, pose).A * rig.period)
    deviation = [start - [*pose, 0, 0]]
    for _ in range(len(record) - 1):
        deviation.append(once @ deviation[-1])
    got = np.hstack([record.true_q - pose, record.true_qd])
    # Terms of second order in the deviation are 1e-4 of it; the step of 0.175 ms shifts a mode of
    # 30 Hz (w h = 0.03) by (w h)^2 / 24 of its frequency: 4e-5 of 8 turns, so 0.2 % in the phase.
    size = np.abs(deviation).max(axis=0)
    assert (np.abs(got - deviation).max(axis=0) < 0.01 * size).all()


@pytest.mark.parametrize("gain", [(0.2, 0.15), (0.1, 0.08)])
@pytest.mark.parametrize("pose", POSES)
def test_spectrum_of_the_simulated_error_peaks_at_a_mode(pose, gain):
    law, rig = P(gain=gain), without_friction(RIG, viscous=True)  # with the real, rounding encoder
    # 50 pulses would saturate the amplifiers
    drive = dataclasses.replace(rig.drive, current_limit=(np.inf, np.inf))
    rig = dataclasses.replace(rig, drive=drive)
    start = np.array([np.add(pose, 4e-3), (0, 0)])
    record = simulate(ARM, rig, law, held_at(rig, law, pose, 2.0), initial=start)
    frequency = np.fft.rfftfreq(8 * len(record), rig.period)
    spectrum = sum(
        np.abs(np.fft.rfft(e - e[-500:].mean(), 8 * len(e))) ** 2 for e in record.error_pulses.T
    )
    spectrum[frequency < 5] = 0
    peak = frequency[spectrum.argmax()]
    found = modes(linearise(ARM, rig, law, pose))
    nearest = found[np.abs(found[:, 0] - peak).argmin()]
    # A rounding encoder is a spring with a dead zone: softer by a few per cent at amplitudes of
    # 10-50 pulses.
    np.testing.assert_allclose(peak, nearest[0], rtol=0.05)


@pytest.mark.parametrize("pose", POSES)
def test_poles_are_stable_and_lightly_damped(pose):
    system = linearise(ARM, RIG, LAW, pose)
    assert (system.poles().real < 0).all()
    found = modes(system)
    assert found.shape == (2, 2)
    assert (np.diff(found[:, 0]) > 0).all()
    # FINDINGS 2: a lightly damped mode near 20-30 Hz
    assert ((found[:, 1] > 0) & (found[:, 1] < 0.1)).all()
    assert ((found[:, 0] > 15) & (found[:, 0] < 60)).any()


def test_model_is_mechanics_with_a_spring():
    """A = [[0, 1], [-D^-1 (K + dG/dq), -D^-1 B]], written down by hand."""
    pose = np.array([-0.8, 1.2])
    system = linearise(ARM, RIG, LAW, pose)
    factor = RIG.position_in_pulses(np.ones(2))
    K = np.diag(LAW.gain * RIG.drive.gear * factor)
    step = 1e-6
    gravity = np.column_stack(
        [
            (ARM.h(pose + d, np.zeros(2)) - ARM.h(pose - d, np.zeros(2))) / (2 * step)
            for d in step * np.eye(2)
        ]
    )
    # At a pose held by a torque, tau - G = 0, so the change of D with q does not enter.
    inverse = np.linalg.inv(ARM.D(pose))
    lower = np.hstack([-inverse @ (K + gravity), -inverse @ np.diag(RIG.drive.joint_viscous())])
    np.testing.assert_allclose(system.A[:2], np.hstack([np.zeros((2, 2)), np.eye(2)]), atol=1e-2)
    np.testing.assert_allclose(system.A[2:], lower, rtol=1e-4, atol=1e-4 * np.abs(lower).max())
    np.testing.assert_allclose(
        system.B[2:], inverse @ np.diag(LAW.gain * RIG.drive.gear), rtol=1e-4
    )
    np.testing.assert_array_equal(system.C, np.hstack([-np.diag(factor), np.zeros((2, 2))]))
    # Gain 1 from reference to counts at rest, but for the weight: error = -S (gravity) with the
    # loop's stiffness.
    static = system.D - system.C @ np.linalg.solve(system.A, system.B)
    np.testing.assert_allclose(
        static,
        np.diag(factor) @ np.linalg.solve(K + gravity, gravity) @ np.diag(1 / factor),
        rtol=1e-3,
        atol=1e-5,
    )


def test_law_with_a_period_or_a_bad_pose_is_refused():
    with pytest.raises(
        ValueError, match="law must be fast and without state, like P; got SampledP"
    ):
        linearise(ARM, RIG, SampledP(gain=LAW.gain, period=RIG.period), (0.0, 0.0))
    with pytest.raises(ValueError, match=r"pose must have shape \(2,\); got shape \(1,\)"):
        linearise(ARM, RIG, LAW, (0.0,))
    with pytest.raises(ValueError, match="pose must be finite"):
        linearise(ARM, RIG, LAW, (0.0, np.nan))


def test_importing_plant_does_not_import_control_or_matplotlib():
    code = (
        "import sys, plant; sys.exit(str(sorted({'control', 'matplotlib'} & set(sys.modules)) or"
        " ''))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)  # noqa: S603
    assert (done.returncode, done.stderr.strip()) in ((0, ""), (1, ""))

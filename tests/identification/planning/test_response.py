"""Measured frequency responses against the linear arm at the pose, sampled by scipy: its own
discretisation.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from scipy.signal import cont2discrete

from identification import design_motion, frequency_response
from identification.planning import FrequencyResponse
from plant import PD, Coupling, Drive, Elasticity, Harmonics, puma560, simulate
from plant.machine import sliding_rig

ARM, POSE, DT = puma560.arm(), np.array([0.3, -0.4]), 0.0007
SMOOTH = sliding_rig(puma560.rig())
RIG = dataclasses.replace(
    SMOOTH, drive=dataclasses.replace(SMOOTH.drive, viscous=4 * SMOOTH.drive.viscous)
)
LAW = PD(gain=(0.02, 0.01), derivative=(1e-12, 1e-12), filter=600, period=DT)
SAMPLES, PERIODS = 1000, 6
LINES = np.unique(np.geomspace(1, 60, 15).astype(int))


def multisine(amplitude):
    """A sum of sines at `LINES`, its phases after Schroeder: (SAMPLES,)."""
    phases = -np.pi * np.arange(len(LINES)) ** 2 / len(LINES)
    return amplitude * np.cos(
        2 * np.pi * np.outer(np.arange(SAMPLES) / SAMPLES, LINES) + phases
    ).sum(axis=1)


@cache
def injected_records():
    still, records = (
        Harmonics(period=DT * SAMPLES, offset=POSE, cosine=np.zeros((2, 1)), sine=np.zeros((2, 1))),
        [],
    )
    for joint, amplitude in ((0, 8.0), (1, 2.0)):
        torque = np.zeros((SAMPLES * PERIODS, 2))
        torque[:, joint] = np.tile(multisine(amplitude), PERIODS)
        run = {"duration": DT * SAMPLES * PERIODS, "steps_per_sample": 32}
        records.append(simulate(ARM, RIG, LAW, still, injected=torque, **run))
    return records


@cache
def moved_records():
    lines, near = LINES / (DT * SAMPLES), np.array([[-0.02, 0.02]])
    motions = design_motion(
        ARM,
        RIG,
        kind="multisine",
        period=DT * SAMPLES,
        frequencies=lines,
        position=POSE[:, None] + near,
    )
    return [
        simulate(ARM, RIG, LAW, each, duration=DT * SAMPLES * 14, steps_per_sample=32)
        for each in motions
    ]


def truth(frequency, record=None):
    """Plant (F, 2, 2) of held torques, at the pose where the arm hangs on its feedback."""
    step, drive, rest = 1e-5, RIG.drive, np.zeros(2)
    record = record or injected_records()[0]
    counted = record.reference_pulses - record.error_pulses
    q = np.asarray(RIG.to_angle(counted[-SAMPLES:].mean(axis=0))).ravel()
    stiffness = np.stack(
        [
            (ARM.inverse(q + step * e, rest, rest) - ARM.inverse(q - step * e, rest, rest))
            / 2
            / step
            for e in np.eye(2)
        ],
        axis=1,
    )
    inverse, damping = np.linalg.inv(ARM.D(q)), np.diag(drive.gear**2 * drive.viscous)
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ stiffness, -inverse @ damping]])
    B = np.vstack([np.zeros((2, 2)), inverse])
    A, B, C, *_ = cont2discrete((A, B, np.eye(2, 4), np.zeros((2, 2))), DT)
    z = np.exp(2j * np.pi * frequency * DT)
    return np.stack([C @ np.linalg.solve(each * np.eye(4) - A, B) for each in z])


def test_the_plant_is_the_linear_arm_within_its_standard_deviations():
    measured = frequency_response(injected_records())
    np.testing.assert_allclose(measured.frequency, LINES / (DT * SAMPLES))
    exact = np.moveaxis(truth(measured.frequency), 0, -1)
    off = np.abs(measured.plant - exact) / measured.plant_std
    assert 0.6 < np.sqrt((off**2).mean()) < 1.2  # 52 complex numbers: 0.86
    assert off.max() < 3
    # and they are small
    assert np.median(measured.plant_std / np.abs(exact).max(axis=1, keepdims=True)) < 0.05


def test_the_loop_is_its_input_sensitivity_where_torque_is_injected():
    measured = frequency_response(injected_records())
    G = truth(measured.frequency)
    feedback = np.diag(
        np.abs(RIG.drive.gear) * LAW.gain * np.abs(RIG.position_in_pulses(np.ones(2)))
    )
    exact = np.moveaxis(np.linalg.inv(np.eye(2) + feedback @ G), 0, -1)
    assert (
        np.abs(measured.loop - exact)
        < 3 * measured.loop_std + 0.01 * np.abs(exact).max(axis=(0, 1))
    ).mean() > 0.95


def test_the_loop_is_the_complementary_sensitivity_where_the_reference_moves():
    lines, records = np.zeros((2, 2, 12)), []
    lines[0, 0, [2, 5, 11]] = lines[1, 1, [2, 5, 11]] = 0.002
    for each in lines:
        path = Harmonics(period=DT * SAMPLES, offset=POSE, cosine=each, sine=0 * each)
        records.append(
            simulate(ARM, RIG, LAW, path, duration=DT * SAMPLES * 9, steps_per_sample=32)
        )
    measured = frequency_response(records, skip=6)
    np.testing.assert_allclose(measured.frequency, np.array([3, 6, 12]) / (DT * SAMPLES))
    G = truth(measured.frequency)
    feedback = np.diag(
        np.abs(RIG.drive.gear) * LAW.gain * np.abs(RIG.position_in_pulses(np.ones(2)))
    )
    exact = np.moveaxis(np.linalg.inv(np.eye(2) + G @ feedback) @ G @ feedback, 0, -1)
    np.testing.assert_allclose(measured.loop, exact, rtol=0, atol=0.02 * np.abs(exact).max())
    system = measured.to_control("loop")
    assert (system.ninputs, system.noutputs, system.dt) == (2, 2, DT)
    np.testing.assert_allclose(system(2j * np.pi * measured.frequency[1]), measured.loop[:, :, 1])
    assert "Hz" in str(measured)


@pytest.mark.slow
def test_a_designed_multisine_gives_the_plant_within_its_standard_deviations():
    measured = frequency_response(moved_records(), skip=8)
    exact = np.moveaxis(truth(measured.frequency, moved_records()[0]), 0, -1)
    off = np.abs(measured.plant - exact) / measured.plant_std
    assert 0.5 < np.sqrt((off**2).mean()) < 1.2  # 44 complex numbers: 0.68
    assert off.max() < 3
    assert np.median(measured.plant_std / np.abs(exact).max(axis=1, keepdims=True)) < 0.03  # 0.011


@pytest.mark.slow
def test_the_resonance_of_each_gear_is_found_within_its_standard_deviation_and_makes_the_gears():
    hz, ratio, pose = np.array([25.0, 30.0]), (0.02, 0.03), {"q": POSE, "drive": RIG.drive}
    gears = Elasticity.from_resonance(ARM, hz, ratio, **pose)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    motions = design_motion(
        ARM, rig, kind="multisine", period=2 * DT * SAMPLES, frequencies=np.geomspace(2, 110, 25),
        position=POSE[:, None] + np.array([[-0.02, 0.02]]),
    )  # fmt: skip
    run = {"duration": 2 * DT * SAMPLES * 8, "steps_per_sample": 16}
    found = frequency_response(
        [simulate(ARM, rig, LAW, each, **run) for each in motions], skip=4
    ).resonances(RIG.drive)
    assert (np.abs(found.hz - hz) < 3 * found.hz_std).all()
    assert (np.abs(found.damping_ratio - ratio) < 3 * found.damping_ratio_std).all()
    assert (found.hz_std < 0.03 * hz).all()
    again = Elasticity.from_resonance(ARM, found.hz, found.damping_ratio, **pose)
    np.testing.assert_allclose(again.stiffness, gears.stiffness, rtol=0.08)


def test_rigid_gears_have_no_resonance():
    found = frequency_response(moved_records(), skip=8).resonances(RIG.drive)
    assert np.isinf(found.hz).all()
    assert np.isnan(found.hz_std).all()
    with pytest.raises(
        ValueError,
        match=r"hz must be finite; .*q\[0\].* has inf\. Give it one above all that matters",
    ):
        Elasticity.from_resonance(ARM, found.hz, 0.02)


def test_motors_that_move_several_joints_are_refused():
    drive = dataclasses.replace(RIG.drive, coupling=Coupling(matrix=((1, 0), (1, 1))))
    with pytest.raises(ValueError, match="one motor per joint"):
        frequency_response(moved_records(), skip=8).resonances(drive)


# A joint whose motor takes no torque: its response is that of link and gear alone.
BARE = Drive(
    gear=(1.0,),
    motor_inertia=(0.0,),
    motor_gain=(1.0,),
    current_limit=(1.0,),
    viscous=(0.0,),
    coulomb=(0.0,),
)
COMPLIANCE = 1 / (2 * np.pi * 20) ** 2  # 20 Hz with an inertia of 1 kg m^2


def series(frequency, inertia=1.0, damping_ratio=0.2):
    """Response (F,) of link and gear as the module states it, to the first order of damping."""
    omega = 2 * np.pi * frequency
    lag = damping_ratio * COMPLIANCE / (np.pi * 20)
    return -1 / (inertia * omega**2) + COMPLIANCE - 1j * omega * lag


def measured_response(frequency, plant, std, held=0.0):
    frequency = np.asarray(frequency, float)
    plant = np.asarray(plant)[None, None]
    std = np.broadcast_to(std, plant.shape)
    rest = {"loop": plant, "loop_std": std, "period": 1e-3, "joints": ("q[0]",)}
    return FrequencyResponse(frequency=frequency, plant=plant, plant_std=std, held=held, **rest)


@pytest.mark.parametrize(
    ("frequency", "held", "limit"),
    [
        ((5.0, 10.0), 1e-3, " from 0 to 200 Hz; got 2"),
        ((5.0, 10.0), 0.0, "; got 2"),
        ((500.0, 600.0, 700.0), 1e-3, " from 0 to 200 Hz; got 0"),
        ((0.0, 5.0, 10.0), 1e-3, " from 0 to 200 Hz; got 2"),
    ],
)
def test_fewer_lines_than_unknowns_give_no_resonance(frequency, held, limit):
    """Two lines have a rigid gear among their solutions, and that was the answer."""
    line = np.array(frequency)
    few = measured_response(line, series(np.maximum(line, 1)), 1e-3 * COMPLIANCE, held)
    with pytest.raises(ValueError, match=f"the response must have 3 lines at least{limit}"):
        few.resonances(BARE)


def test_three_lines_give_the_resonance():
    line = np.array([5.0, 10.0, 15.0])
    gears = measured_response(line, series(line), 1e-3 * COMPLIANCE).resonances(BARE)
    np.testing.assert_allclose(gears.hz, 20, rtol=1e-6)
    np.testing.assert_allclose(gears.damping_ratio, 0.2, rtol=1e-6)


def test_a_torque_of_zero_gives_no_resonance():
    """Its response, and the standard deviation of that, are 0."""
    records = [
        dataclasses.replace(record, torque=np.zeros_like(record.torque), current=None)
        for record in injected_records()
    ]
    still = frequency_response(records)
    assert (still.plant_std == 0).all()
    with pytest.raises(ValueError, match=r"plant_std must be positive; got 0 at 1\.43 Hz"):
        still.resonances(RIG.drive)


def test_the_damping_ratio_has_the_error_of_the_compliance_too():
    """The scatter over many measurements is the standard deviation of each."""
    line = np.linspace(5, 60, 20)
    std = 0.05 * COMPLIANCE
    random = np.random.default_rng(0)
    noise = random.standard_normal((2, 300, len(line))) * std / np.sqrt(2)
    runs = [
        measured_response(line, series(line) + real + 1j * imaginary, std).resonances(BARE)
        for real, imaginary in zip(*noise, strict=True)
    ]
    for name in ("hz", "damping_ratio"):
        scatter = np.std([getattr(run, name)[0] for run in runs])
        stated = np.median([getattr(run, f"{name}_std")[0] for run in runs])
        assert scatter / stated == pytest.approx(1, abs=0.15), name


def test_a_gear_without_a_positive_inertia_behind_it_is_unknown():
    """Lines above the resonance show the gear; of the inertia they show noise, of either sign."""
    line = np.linspace(5, 60, 20)
    unknown = measured_response(line, series(line, inertia=-1.0), 1e-3 * COMPLIANCE)
    assert np.isnan(unknown.resonances(BARE)).all()


def test_it_draws_both_beside_a_model():
    import control
    import matplotlib.pyplot as plt

    measured = frequency_response(injected_records())
    model = control.ss(np.zeros((1, 1)), np.zeros((1, 2)), np.zeros((2, 1)), np.eye(2), DT)
    axes = measured.plot(model=model)
    assert len(axes[1].lines) == 4
    plt.close(axes[0].figure)


def test_two_periods_are_enough():
    """Their difference shows the noise."""
    response = frequency_response(injected_records(), skip=PERIODS - 2)
    assert (response.plant_std > 0).all()
    assert np.isfinite(response.plant_std).all()


def without(**fields):
    return [dataclasses.replace(each, **fields) for each in injected_records()]


@pytest.mark.parametrize(
    ("records", "options", "why"),
    [
        (lambda: injected_records()[0], {}, "records must be as many as joints, 2; got 1"),
        (lambda: [injected_records()[0]] * 2, {}, "must excite all joints, each differently"),
        (lambda: injected_records(), {"period": 0.70001}, "whole number of samples"),
        (lambda: injected_records(), {"skip": PERIODS - 1}, "two periods at least"),
        (lambda: without(torque=None, current=None), {}, "torques or currents"),
        (lambda: without(valid=np.zeros(SAMPLES * PERIODS)), {}, "every sample"),
        (lambda: without(reference=None), {}, "period must be given"),
        (
            lambda: [injected_records()[0], without(injected=None)[1]],
            {},
            "all have an injected torque, or none",
        ),
        (lambda: [7], {}, "each record must be"),
        (list, {}, "got 0"),
    ],
)
def test_bad_input_is_refused_in_one_line(records, options, why):
    with pytest.raises(ValueError, match=why) as error:
        frequency_response(records(), **options)
    assert "\n" not in str(error.value)

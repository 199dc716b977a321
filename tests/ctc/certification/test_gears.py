"""Certificates of elastic gears: what is drawn is what is simulated, and what is said holds for
the worst of it.
"""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
from uncertain import with_uncertainty

from ctc import ComputedTorque, Uncertainty, certify, evaluate, margins, sweep_resonance
from ctc.certification import cells, clopper_pearson
from ctc.verdict import lowest_resonance
from plant import Elasticity, puma560, simulate
from plant.analysis import SampledLoops

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH([0.0]).q[0]
# what is unstable is so from one resonance on
LAW = ComputedTorque(ARM, RIG, bandwidth=150, start_boost=1.0)
SHORT = {
    "duration": 0.2,
    "steps_per_sample": 8,
    "samples": 60,
    "covariance": np.diag((0.01 * ARM.f) ** 2),
}


def lowest(*loop, **options):
    usual = {
        "damping_ratio": 0.01,
        "within": 1,
        "after": 0.02,
        "steps_per_sample": 16,
        "duration": 0.1,
        "threads": 2,
    }
    return lowest_resonance(*loop, **usual | options, initial=None)


def on_gears(hz, damping_ratio):
    elasticity = Elasticity.from_resonance(ARM, hz, damping_ratio, drive=RIG.drive, q=START)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))


@pytest.mark.parametrize("options", [
    {"resonance": (60, 90)},
    {"resonance": [(60, 70), (110, 120)], "damping_ratio": 0.02, "backlash": (0, 2e-4), "lag": (1e-4, 5e-4)},
    {"resonance": (60, 90), "jitter": (0, 0.2), "friction_drift": (-0.2, 0.2), "presliding": (0, 0.1),
     "load_friction": 0.1, "ripple": (0, 0.02), "quadrature": (0, 0.3)},
], ids=["alike", "each", "the rest"])  # fmt: skip
def test_each_lane_is_a_simulation_of_gears_with_their_resonance(options):
    found = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, **options))
    for i in (0, 17, 59):
        plant, runs = found.plant(i), found.runs
        drive, values = plant.rig.drive, plant.values
        # The stated resonance is that of this arm: the plain formula, by its own D.
        hz = (
            np.sqrt(
                drive.elasticity.stiffness
                / (np.diag(plant.arm.D(START)) - drive.reflected_inertia())
            )
            / 2
            / np.pi
        )
        stated = [values[name] for name in values if name.startswith("resonance")]
        np.testing.assert_allclose(hz, np.broadcast_to(stated, 2), rtol=1e-9)
        low, high = np.atleast_2d(options["resonance"]).T
        assert ((low <= hz) & (hz <= high)).all()
        record = simulate(plant.arm, plant.rig, LAW, PATH, duration=0.2, steps_per_sample=8)
        counts = record.t >= 0.02
        np.testing.assert_array_equal(runs.peak[i], np.abs(record.error_pulses[counts]).max(axis=0))
        np.testing.assert_allclose(runs.current[i], np.abs(record.current).max(axis=0), rtol=1e-9)
        if "lag" in options:
            assert 1e-4 <= drive.current_lag.time <= 5e-4
            assert ((drive.elasticity.backlash >= 0) & (drive.elasticity.backlash <= 2e-4)).all()
        if "jitter" in options:
            assert plant.rig.jitter.stream == i
            assert (np.abs(drive.friction_drift.amount) <= 0.2).all()
            assert 0 < drive.ripple.amplitude[0] <= 0.02
            assert drive.ripple.phase[0] > 0
            assert "jitter 0 to 0.2 of the period" in str(found)
            np.testing.assert_array_equal(drive.load_friction.share, 0.1)
    assert found.settings["after"] == 0.02
    assert ("resonance 60 to 90 Hz" in str(found)) == (options["resonance"] == (60, 90))
    assert found.on_gears is found.lowest_resonance is None


def test_the_bound_is_that_of_the_worst_part_of_the_range():
    """From 60 Hz, where the law is unstable, to 400 Hz, where it holds: 'most of them hold'
    would be no verdict.
    """
    law = dataclasses.replace(LAW, bandwidth=250.0)
    found = certify(
        ARM,
        RIG,
        law,
        PATH,
        **with_uncertainty(**SHORT | {"samples": 400, "duration": 0.4}, resonance=(60, 400)),
    )
    left, hz = found.runs.outside > 0, found.plants.values[:, found.plants.names.index("resonance")]
    assert left[hz < 100].all()
    assert not left[hz > 300].any()
    assert found.probability < 0.6
    assert found.upper > 0.95
    assert sum(cell.count for cell in found.cells) == 400
    assert sum(cell.failures for cell in found.cells) == left.sum()
    assert found.upper == max(
        clopper_pearson(c.failures, c.count, 0.9)[1] for c in found.cells if c.count
    )
    assert found.worst_cell.hz[1] < 200
    assert str(found.worst_cell) in found.verdict

    axis = found.plot()[-1]
    plt.close(axis.figure)
    lines = {line.get_label(): line for line in axis.lines}
    worst = 100 * max(cell.failures / cell.count for cell in found.cells if cell.count)
    np.testing.assert_allclose(lines["share outside the limit"].get_xdata()[0], 60)
    np.testing.assert_allclose(lines["share outside the limit"].get_ydata(), worst)
    np.testing.assert_allclose(
        axis.lines[-1].get_ydata(), 100 * max(cell.upper(0.95) for cell in found.cells[-3:])
    )


def test_no_bound_is_not_called_one():
    left = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, resonance=(60, 62)))
    assert left.upper == 1
    cell = left.worst_cell
    assert cell.failures == cell.count > 0
    assert (
        f"at some sampling instant; at the worst resonance ({cell}) {cell.count} of"
        f" {cell.count} do." in left.verdict
    )
    assert "at most" not in left.verdict
    few = certify(
        ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT | {"samples": 2}, resonance=(300, 400))
    )
    assert few.verdict.startswith(
        "None of 2 Monte Carlo samples exceeds ±1 pulse; at the worst resonance ("
    )
    assert few.verdict.endswith("there is no sample, so nothing is said of it.")


def test_cells_are_narrow_and_hold_what_is_in_them():
    ranges = Uncertainty(resonance=(50, 100), damping_ratio=(0.01, 0.04))
    values = np.array([[50.0, 0.01], [99.9, 0.039], [100.0, 0.04], [70.0, 0.02]])
    found = cells(
        ranges, ("resonance", "damping_ratio"), values, np.array([True, False, True, False])
    )
    assert all(cell.hz[1] / cell.hz[0] <= 1.1 + 1e-9 for cell in found)
    assert found[0].hz[0] == pytest.approx(50)
    assert found[-1].hz[1] == pytest.approx(100)
    assert [(c.count, c.failures) for c in (found[0], found[-1])] == [(1, 1), (2, 1)]
    assert sum(c.count for c in found) == 4
    assert "np." not in repr(found)
    assert found[1].upper(0.95) == 1.0  # without plants nothing is known


def test_no_verdict_on_rigid_gears_stands_without_the_gears_on_which_it_holds():
    found = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT))
    assert f"above {found.lowest_resonance:.3g} Hz (damping ratio 0.01)" in found.verdict
    assert "the nominal arm stays" in found.verdict
    late = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, lag=1e-4))
    assert "the nominal arm, with current lag 0.0001 s, stays" in late.verdict
    lagging = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_lag=1e-4))
    options = {"duration": SHORT["duration"], "steps_per_sample": SHORT.get("steps_per_sample", 16)}
    assert (
        late.lowest_resonance
        == lowest(ARM, lagging, LAW, PATH, **options).hz
        > found.lowest_resonance
    )
    slow = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, lag=(0, 5e-3)))
    assert slow.probability > 0.5
    assert slow.verdict.endswith("Rigid gears assumed.")
    stated = certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, damping_ratio=0.03))
    assert stated.lowest_resonance < found.lowest_resonance
    assert "not sampled: elasticity, " in str(found)
    assert "backlash" in str(found).split("not sampled:")[1]


@pytest.mark.parametrize("ratio", [0.01, pytest.param(0.02, marks=pytest.mark.slow)])
def test_above_the_lowest_resonance_the_arm_stays_and_just_below_it_leaves(ratio):
    options = {"duration": 0.5, "steps_per_sample": 16}
    found = lowest(ARM, RIG, LAW, PATH, damping_ratio=ratio, **options)
    for hz, stays in ((found.hz, True), (1.1 * found.hz, True), (found.hz / 1.06, False)):
        record = simulate(ARM, on_gears(hz, ratio), LAW, PATH, **options)
        assert (np.abs(record.error_pulses[record.t >= 0.02]) <= 1).all() == stays, hz
    report = evaluate(ARM, RIG, LAW, PATH, backend="numba", duration=0.5)
    if ratio == 0.01:
        certificate = certify(
            ARM,
            RIG,
            LAW,
            PATH,
            **with_uncertainty(**SHORT | {"steps_per_sample": 16, "duration": 0.5}),
        )
        assert certificate.on_gears is report.on_gears  # of the same loop, simulated once
        assert report.lowest_resonance == found.hz
        assert " ".join(str(report).split()).endswith(f"rigid gears assumed; {found}")


def test_ends_of_the_scale(monkeypatch):
    options = {"duration": 0.1, "steps_per_sample": 8}
    slow = lowest(ARM, RIG, ComputedTorque(ARM, RIG, bandwidth=1.0), PATH, within=1000, **options)
    assert float(slow) == 10
    assert "any resonance above 10 Hz" in str(slow)
    weak = lowest(ARM, RIG, ComputedTorque(ARM, RIG, bandwidth=1.0), PATH, within=0, **options)
    assert float(weak) == np.inf
    assert "exceeds ±0 pulse also on rigid gears" in str(weak)
    heavy = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, motor_inertia=(1.0, 1.0)))
    unknown = lowest(ARM, heavy, LAW, PATH, **options)
    assert np.isnan(float(unknown))
    assert "cannot tell" in str(unknown)
    assert (
        evaluate(ARM, on_gears(60, 0.02), LAW, PATH, backend="numba", duration=0.1).lowest_resonance
        is None
    )


@pytest.mark.parametrize(
    ("bandwidth", "ratio"), [(60, 0.02), (150, 0.01), (150, 0.02), (150, 0.03), (250, 0.02)]
)
def test_the_linear_loop_is_unstable_just_below_its_lowest_resonance(bandwidth, ratio):
    """And near what two masses on a spring predict: bandwidth [rad/s] below 1.3, 1.7, 2.0 times
    the resonance [Hz].
    """
    law = ComputedTorque(ARM, RIG, bandwidth=bandwidth)
    lowest = margins(ARM, RIG, law, pose=START, damping_ratio=ratio).lowest_resonance
    radius = [
        np.abs(np.linalg.eigvals(A + B @ C)).max()
        for A, B, C in (
            SampledLoops(ARM, on_gears(hz, ratio), law, START).matrices()
            for hz in (lowest, lowest / 1.05)
        )
    ]
    assert radius[0] < 1 < radius[1]
    if bandwidth > 60:  # below 100 Hz viscous friction of the motors damps too
        assert bandwidth / lowest == pytest.approx(
            {0.01: 1.33, 0.02: 1.7, 0.03: 2.0}[ratio], rel=0.05
        )


def test_margins_of_elastic_gears_are_those_of_the_stiff_limit():
    law = ComputedTorque(ARM, RIG)
    rigid, stiff = (
        margins(ARM, RIG, law, pose=START),
        margins(ARM, on_gears(5e3, 0.02), law, pose=START),
    )
    np.testing.assert_allclose(stiff.gain_up, rigid.gain_up, rtol=0.02)
    np.testing.assert_allclose(stiff.phase, rigid.phase, rtol=0.02)
    assert stiff.lowest_resonance is None
    assert not margins(ARM, on_gears(100, 0.02), law, pose=START).stable


@pytest.mark.parametrize(("options", "message"), [
    ({"resonance": (90, 60)}, r"resonance must be \(lowest, highest\), above 0 Hz; got \(90, 60\)"),
    ({"resonance": (0, 60)}, "above 0 Hz"),
    ({"resonance": (60, 5000)}, "resonance must be below 1091 Hz, which sub-steps of 0.0875 ms can follow; got 5000"),
    ({"resonance": 60}, r"resonance must be \(lowest, highest\) \[Hz\]; got 60"),
    ({"resonance": [(1, 2), (1, 2), (1, 2)]}, "resonance must be one pair, or 2; got 3"),
    ({"resonance": (60, 90), "damping_ratio": (0.03, 0.01)}, "damping_ratio must be from 0 upwards"),
    ({"backlash": 1e-4}, "backlash needs elastic joints; got a rigid rig"),
    ({"resonance": (60, 90), "backlash": 7.0}, "backlash must be within one turn"),
    ({"resonance": (60, 90), "backlash": (0, 0.1)}, "backlash must be within one turn of the motor, 0.0583 rad"),
    ({"friction_drift": (-1.5, 0.0)}, "amount must be above -1"),
    ({"lag": 0.3}, "current_lag must be at most 0.02 s; got 0.3"),
    ({"damping_ratio": 2}, "damping_ratio must be at most 1, critical damping; got 2"),
    ({"resonance": (60, 90), "damping_ratio": (0.01, 2)}, "damping_ratio must be at most 1, critical damping; got 2"),
    ({"lag": -1e-4}, "lag must be from 0 upwards"),
    ({"friction_drift": (0.2, -0.2)}, "friction_drift must be two numbers, the lower end first"),
    ({"jitter": 0.7}, "share must be from 0 to 0.5 of the period; got 0.7"),
])  # fmt: skip
def test_wrong_calls_are_refused_in_one_line(options, message):
    with pytest.raises(ValueError, match=message) as refusal:
        certify(ARM, RIG, LAW, PATH, **with_uncertainty(**SHORT, **options))
    assert "\n" not in str(refusal.value)


def test_elastic_gears_are_no_rigid_ones():
    with pytest.raises(ValueError, match="must have rigid gears"):
        lowest(ARM, on_gears(60, 0.02), LAW, PATH)


def test_a_damping_ratio_that_nothing_uses_is_refused():
    """Rigid gears use it for the lowest resonance; elastic gears of the rig have their own."""
    assert with_uncertainty(**SHORT, damping_ratio=0.03)["uncertainty"].damping_ratio == (
        0.03,
        0.03,
    )
    with pytest.raises(ValueError, match="damping_ratio must be given with a resonance"):
        certify(ARM, on_gears(60, 0.02), LAW, PATH, **with_uncertainty(**SHORT, damping_ratio=0.03))


@pytest.mark.parametrize(("call", "message"), [
    (lambda: lowest(ARM, RIG, LAW, PATH, damping_ratio=2), "damping_ratio must be at most 1"),
    (lambda: margins(ARM, RIG, LAW, damping_ratio=2), "damping_ratio must be at most 1, critical damping"),
    (lambda: sweep_resonance(ARM, RIG, {"a": LAW}, PATH, damping_ratio=2), "damping_ratio must be at most 1"),
    (lambda: sweep_resonance(ARM, RIG, {"a": LAW}, PATH, hz=[50, 5000]),
     "hz must be below 2183 Hz, which sub-steps of 0.0437 ms can follow; got 5000"),
    (lambda: sweep_resonance(ARM, RIG, {"a": LAW}, PATH, hz=[30, np.nan]), "hz must be finite; got nan"),
    (lambda: sweep_resonance(ARM, RIG, {"a": LAW}, PATH, steps_per_sample=0),
     "steps_per_sample must be a whole number of at least 1; got 0"),
    (lambda: sweep_resonance(ARM, RIG, {"a": LAW}, PATH, threads=0),
     "threads must be a whole number of at least 1; got 0"),
])  # fmt: skip
def test_gears_that_no_loop_can_have_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)

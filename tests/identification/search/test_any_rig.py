"""Machines drawn at random and run by another engine: no value is off under a clean verdict.

`tests/benchmarks/any_rig.py` draws hundreds of them; here are a few.
"""

import numpy as np
import own_engine as engine
import pytest
from random_arms import random_chain
from random_rigs import bodies_of, drawn

from identification import identify
from identification.equation_error import begun
from plant import Dynamics, replay


@pytest.mark.parametrize("seed", range(3))
def test_the_engine_and_the_library_agree_about_the_torque(seed):
    chain = random_chain(3, seed, frames=False)
    dynamics = Dynamics.from_chain(chain)
    q, qd, qdd = np.random.default_rng(seed).normal(size=(3, 3))
    bodies = bodies_of(chain)
    torque = engine.inverse(bodies, q, qd, qdd, bodies.gravity)
    torque += np.array([body.rotor for body in chain.bodies]) * qdd
    expected = dynamics.arm(dynamics.f()).inverse(q, qd, qdd)
    np.testing.assert_allclose(torque, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("seed", [4, pytest.param(0, marks=pytest.mark.slow)])
def test_no_value_is_off_by_five_deviations_unless_something_is_said(seed):
    case = drawn(seed)
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 5


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (14, 7, 11))]
)
def test_a_right_log_of_5_ms_is_accused_of_nothing(seed):
    """14, 7: a fast joint began at rest. 11: a filter had followed a straight line. 0: its fit of
    a controller at work ended early, and stood for the fit of the one that had begun.
    """
    case = drawn(seed, period=5e-3)
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 5


@pytest.mark.slow
def test_a_weight_and_its_integral_go_on_together_in_finer_steps():
    """Without the integral the finer fit left the log; with rough slopes it knew the weight."""
    case = drawn(13, period=5e-3)
    with pytest.warns(UserWarning, match="not separately identifiable"):
        estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.fit.rms_innovation < 0.31
    assert estimate.fit.undetermined == (("m_j0", "J_j0"),)
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 5


@pytest.mark.slow
@pytest.mark.parametrize("seed", [96, 106])
def test_counts_that_fast_hardware_felt_are_no_lag_of_its_torques(seed):
    """What rounding adds to the torque within a sample explained the log with odds of 100."""
    case = drawn(seed)
    assert case.record.law.period is None
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    (lag,) = (sign for sign in estimate.diagnostics.detection.signs if sign.name == "lag")
    assert lag.chi_square < 0.2 * lag.threshold
    assert estimate.diagnostics.detection.names == ()


@pytest.mark.slow
def test_a_log_cut_out_of_a_motion_is_repeated_from_where_it_began():
    """A soft loop swings on for a second from a speed that is not the reference's.

    Started with that of the reference, the fit did not repeat the log: 950 pulses apart.
    """
    case = drawn(7)
    assert np.abs(case.record.error_pulses[0]).max() > 1
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert estimate.diagnostics.difference < 1.0
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 3


@pytest.mark.parametrize("seed", [6, pytest.param(53, marks=pytest.mark.slow)])
def test_the_integral_of_fast_hardware_is_unknown_where_a_log_was_cut(seed):
    """Taken as begun with the log, its torque accused the right rig of offsets and backlash."""
    case = drawn(seed)
    assert case.record.law.period is None
    assert case.record.law.integral.all()
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 5


@pytest.mark.slow
def test_a_narrow_valley_of_weight_and_integral_is_followed_to_its_end():
    """Differences wider than the valley ended 31 deviations from the values, with nothing said."""
    case = drawn(66)
    with pytest.warns(UserWarning, match="move in step"):
        estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 4


@pytest.mark.slow
def test_an_arm_in_motion_has_a_controller_that_was_at_work():
    """An integral of zero fits the log, too: J came out 143 % high, 4,200 of its deviations."""
    case = drawn(114)
    assert case.record.error_pulses[0] == 74
    with pytest.warns(UserWarning, match="not separately identifiable"):
        estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.fit.undetermined == (case.unknown,)
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 5
    assert estimate.fit.values.sum() == pytest.approx(case.truth.sum(), rel=1e-3)


@pytest.mark.slow
def test_coarse_steps_of_an_integration_are_no_elastic_gear():
    """At 4 steps per sample a fast, soft loop looked like gears of 222 Hz, with odds of 1e21."""
    case = drawn(137)
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    (sign,) = (sign for sign in estimate.diagnostics.detection.signs if sign.name == "compliance")
    assert not sign.significant
    assert estimate.doubts == []


@pytest.mark.slow
def test_values_are_those_of_a_fine_integration():
    """Under a soft cascade 4 steps per sample moved Ixz by 7.6 deviations of its noise."""
    case = drawn(146)
    estimate = identify(
        case.dynamics, case.record, unknown=case.unknown, method="prediction_error", progress=False
    )
    # The log correlates some values of f, which is no fault of the steps.
    assert all("separately identifiable" in line for line in estimate.doubts)
    noise = np.sqrt(np.diag(estimate.fit.noise_covariance))
    assert np.abs((estimate.fit.values - case.truth) / noise).max() < 2.5


@pytest.mark.slow
def test_runs_of_the_model_begin_as_uncertain_as_the_start_of_a_log_is():
    """From one start they differed by 0.6 pulses, and the right log by 1.35: it was doubted."""
    case = drawn(103)
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    (resumption,) = estimate.fit.resumptions
    pulses = case.record.rig.position_in_pulses(resumption.deviations[1]) * case.record.rig.period
    assert (np.abs(pulses) < 0.2).all()
    # The run from the estimated start repeats the log, so that no other run is needed.
    assert estimate.diagnostics.difference < 1.0
    assert estimate.doubts == []


@pytest.mark.slow
def test_a_log_without_a_path_begins_as_fast_as_its_counts_roughly_show():
    """A speed by the first counts was 2 of 45 pulses per sample off, and 3 pulses for a second."""
    case = drawn(34)
    assert case.record.reference is None
    estimate = identify(case.dynamics, case.record, unknown=case.unknown, progress=False)
    assert estimate.doubts == []
    assert estimate.diagnostics.difference < 0.5


def test_a_cut_log_repeats_the_first_torque_that_a_filter_remembers():
    """From a filter on straight lines the arm left 3 pulses per sample too fast: 3.81 apart."""
    case = drawn(160)
    record = begun(case.record)
    values = dict(zip(case.unknown, case.truth, strict=True))
    rig = case.record.rig.filled(values)
    arm = case.dynamics.arm([values[name] for name in case.dynamics.names])
    run = replay(arm, record, rig=rig)
    np.testing.assert_allclose(run.torque[0], case.record.torque[0], rtol=1e-6)
    assert np.sqrt(np.mean((run.error_pulses - case.record.error_pulses) ** 2)) < 0.5

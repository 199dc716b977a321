"""The verdict in pulses: its numbers by numpy, by both backends, and what the paper promises, ±1
encoder pulse.

The quick tests run the published arm with the true f, with f 5 % off, one cold identification and P
control; the studies over ten seeds are marked slow (``pytest -m slow``).
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from ctc import ComputedTorque, Evaluation, evaluate
from ctc.figures import plot_comparison
from identification import identify
from plant import puma560, simulate

RIG = puma560.rig()
PERIODS = (3.65, 2.5, 2.0)
FIELDS = (
    "max_error_pulses",
    "max_true_error_pulses",
    "rms_error_pulses",
    "peak_torque",
    "chatter",
    "saturation",
)
PEAK = 300.0  # N m; an amplifier of 12 A allows 295 on joint 2


@cache
def arm():
    return puma560.arm()


@cache
def noisy(seed):
    """The published f, each off by 5 % (standard deviation)."""
    return puma560.dynamics().arm(
        puma560.PUBLISHED * (1 + 0.05 * np.random.default_rng(seed).normal(size=9))
    )


@cache
def verdict(name="law", period=3.65, backend="numba"):
    law = puma560.p_law() if name == "P" else ComputedTorque(arm(), RIG, bandwidth=145)
    return evaluate(arm(), RIG, law, puma560.reference(period), backend=backend)


# -- the numbers ---------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["P", "law"])
def test_the_numbers_by_numpy(name):
    got = verdict(name)
    record, limit = got.record, 12 * np.array([0.228 * 107.8, 0.238 * 53.7])
    assert isinstance(got, Evaluation)
    assert record.error_pulses.shape == (5215, 2)
    np.testing.assert_array_equal(record.error_pulses, np.trunc(record.error_pulses))
    np.testing.assert_array_equal(got.max_error_pulses, abs(record.error_pulses).max(axis=0))
    np.testing.assert_allclose(
        got.rms_error_pulses, np.linalg.norm(record.error_pulses, axis=0) / np.sqrt(5215)
    )
    np.testing.assert_array_equal(got.max_true_error_pulses, abs(got.true_error_pulses).max(axis=0))
    np.testing.assert_array_equal(got.peak_torque, abs(record.torque).max(axis=0))
    changes = np.array(
        [abs(b - a) for a, b in zip(record.torque[:-1], record.torque[1:], strict=True)]
    )
    np.testing.assert_allclose(got.chatter, changes.mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(
        got.saturation, (abs(record.torque) > 0.999999 * limit).mean(axis=0)
    )
    for k in (0, 1, 4, 10):
        share = np.mean([max(abs(row)) <= k for row in record.error_pulses])
        assert got.fraction_within(k) == share
        assert got.within(k) is bool(share == 1)


def test_saturation_is_counted():
    """A law at the limit for a known share of the time: 3 A are not enough to hold the arm."""
    low = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_limit=(3.0, 12.0)))
    got = evaluate(
        arm(), low, ComputedTorque(arm(), low), puma560.reference(), duration=0.1, backend="numba"
    )
    np.testing.assert_allclose(got.peak_torque[0], 3 * 0.228 * 107.8, rtol=1e-12)
    assert got.saturation[0] > 0.9


@pytest.mark.parametrize("name", ["P", "law"])
def test_the_true_error_is_that_of_the_joint(name):
    """Against q of the record, at the samples, which lie between two middles of sub-steps.

    The mean of the two differs by acceleration (h/2)^2 / 2 = 100 rad/s^2 (22 us)^2 / 2 = 2.4e-8 rad
    = 3e-4 pulse.
    """
    got = verdict(name)
    t = got.record.t
    expected = RIG.position_in_pulses(got.record.reference(t).q) - RIG.position_in_pulses(
        got.record.true_q
    )
    around = (got.true_error_pulses[15:-1:16] + got.true_error_pulses[16::16]) / 2
    np.testing.assert_allclose(around, expected[1:], rtol=0, atol=1e-3)
    # Both counts are rounded toward zero, so the integer error is less than a pulse away from the
    # true one.
    assert (abs(got.max_true_error_pulses - got.max_error_pulses) <= 1).all()


@pytest.mark.parametrize("name", ["P", "law"])
def test_casadi_and_numba_give_the_same_verdict(name):
    """Encoder errors exactly; what is not rounded nearly: the kernel rounds a product and its sum
    once, casadi twice.

    A step differs by some 1e-12 pulses, and both loops are stable; 83,440 such steps stay below
    1e-6 (measured: 3e-7).
    """
    numba, casadi = verdict(name), verdict(name, backend="casadi")
    np.testing.assert_array_equal(casadi.record.error_pulses, numba.record.error_pulses)
    np.testing.assert_allclose(casadi.record.torque, numba.record.torque, rtol=0, atol=1e-9 * PEAK)
    np.testing.assert_allclose(casadi.true_error_pulses, numba.true_error_pulses, rtol=0, atol=1e-6)
    for field in FIELDS:
        np.testing.assert_allclose(
            getattr(casadi, field), getattr(numba, field), rtol=1e-6, err_msg=field
        )
    for k in (0, 1, 5):
        assert casadi.fraction_within(k) == numba.fraction_within(k)


def test_sixteen_sub_steps_are_enough():
    """The verdict is the joint's and not the integrator's: 32 sub-steps change the true peak by
    less than 0.3 pulse.

    (The loop is a limit cycle of the encoder's last bit; its peak is a random number of which two
    are compared.)
    """
    law = ComputedTorque(arm(), RIG, bandwidth=145)
    usual, finer = (
        evaluate(arm(), RIG, law, puma560.reference(), steps_per_sample=steps) for steps in (16, 32)
    )
    assert finer.within(1)
    np.testing.assert_allclose(
        finer.max_true_error_pulses, usual.max_true_error_pulses, rtol=0, atol=0.3
    )


def test_the_table_has_the_numbers():
    got = verdict()
    table = str(got)
    assert table.splitlines()[0].startswith("ComputedTorque: 100.00% of 5215 samples")
    for values, form in (
        (got.max_error_pulses, ".0f"),
        (got.rms_error_pulses, ".2f"),
        (got.max_true_error_pulses, ".2f"),
        (got.peak_torque, ".0f"),
        (got.chatter, ".2g"),
        (got.saturation, ".2%"),
    ):
        written = [f"{value:{form}}" for value in values]
        assert any(line.split()[-2:] == written for line in table.splitlines()), written


def test_plot_draws_the_record():
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    got = verdict()
    drawn = [line for axis in got.plot().flat for line in axis.get_lines()]
    for joint in range(2):
        assert any(
            np.array_equal(line.get_ydata(), got.record.error_pulses[:, joint]) for line in drawn
        )
        assert any(np.array_equal(line.get_ydata(), got.record.torque[:, joint]) for line in drawn)
    matplotlib.pyplot.close("all")


# -- the promise ---------------------------------------------------------------------------------
def promised(robot, model, period, **options):
    got = evaluate(robot, RIG, ComputedTorque(model, RIG), puma560.reference(period), **options)
    assert got.within(1), got
    assert got.max_true_error_pulses.max() < 2  # an encoder error of 1 may hide 2 at most
    assert got.peak_torque.max() < PEAK
    return got


@pytest.mark.parametrize("period", PERIODS)
def test_the_true_f_tracks_within_one_pulse(period):
    promised(arm(), arm(), period, backend="casadi" if period == 2.0 else "numba")


@pytest.mark.parametrize("period", PERIODS)
def test_f_off_by_five_per_cent_tracks_within_one_pulse(period):
    for seed in range(10):
        promised(arm(), noisy(seed), period, backend="numba")


@pytest.mark.parametrize("period", PERIODS)
def test_p_control_is_off_by_seven_to_fifteen_pulses(period):
    """FINDINGS: 7-10 at the gains (0.20, 0.15), up to 15 at T = 2.0 s; computed torque is the
    quieter one, too.
    """
    p, law = verdict("P", period), verdict("law", period)
    assert (p.max_error_pulses >= 7).all()
    assert (p.max_error_pulses <= 15).all()
    assert p.fraction_within(1) < 0.2 < law.fraction_within(1)
    assert (law.chatter < p.chatter).all()
    assert (law.peak_torque < PEAK).all()


@pytest.mark.parametrize("period", PERIODS)
def test_a_robot_that_is_not_the_model(period):
    """The literature's PUMA 560 with 1.5 kg at (0, -0.55) m in frame 3, under computed torque
    from its own f.
    """
    other = puma560.literature_arm(1.5)
    assert abs(other.f / puma560.PUBLISHED - 1).max() > 0.5
    promised(other, other, period, backend="numba")


def test_a_cold_identification_keeps_the_arm_within_two_pulses():
    """README's six lines. One seed of ten: seven of ten must reach 100 %, and none stays below
    98.5 %.
    """
    measured = simulate(arm(), RIG, puma560.p_law(), puma560.reference(), steps_per_sample=16)
    found = identify(puma560.dynamics(), measured, seed=1, progress=False)
    got = evaluate(
        arm(), RIG, ComputedTorque(found.arm, found.rig), puma560.reference(), backend="numba"
    )
    assert got.fraction_within(1) >= 0.985
    assert got.peak_torque.max() < PEAK


@pytest.mark.slow
def test_ten_cold_identifications():
    """What the issue asks of the paper's algorithm: seven of ten at 100 %, none below 98.5 % at
    any period.
    """
    measured = simulate(arm(), RIG, puma560.p_law(), puma560.reference(), steps_per_sample=16)
    perfect = 0
    for seed in range(10):
        found = identify(puma560.dynamics(), measured, seed=seed, progress=False)
        law = ComputedTorque(found.arm, found.rig)
        runs = {
            T: evaluate(arm(), RIG, law, puma560.reference(T), backend="numba") for T in PERIODS
        }
        assert min(run.fraction_within(1) for run in runs.values()) >= 0.985, (seed, runs)
        assert max(run.peak_torque.max() for run in runs.values()) < PEAK, seed
        perfect += runs[3.65].within(1)
    assert perfect >= 7


@pytest.mark.slow
def test_a_robot_that_is_not_the_model_identified_from_its_own_log():
    other = puma560.literature_arm(1.5)
    measured = simulate(other, RIG, puma560.p_law(), puma560.reference(), steps_per_sample=16)
    shares = []
    for seed in range(5):
        found = identify(puma560.dynamics(), measured, seed=seed, progress=False)
        got = evaluate(
            other, RIG, ComputedTorque(found.arm, found.rig), puma560.reference(), backend="numba"
        )
        shares.append(got.fraction_within(1))
    assert min(shares) >= 0.985
    assert np.median(shares) >= 0.999


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: verdict().fraction_within(-1), "k must be a number of pulses, 0 or more; got -1"),
        (lambda: verdict().within(-0.5), "k must be"),
        (lambda: plot_comparison(verdict()), "evaluations must be a dict, one per controller"),
        (lambda: plot_comparison({"P": 3}), "evaluation 'P' must be an Evaluation; got int"),
        (lambda: verdict().within(np.nan), "k must be"),
        (lambda: verdict().within((1, 1)), "k must be"),
        (lambda: verdict().within("one"), "k must be"),
        (lambda: run(backend="casady"), "'casady'.*'casadi'"),
        (lambda: run(step_per_sample=4), "Did you mean 'steps_per_sample'"),
        (lambda: run(steps_per_sample=0), "steps_per_sample"),
        (lambda: run(duration=-1.0), "duration"),
        (lambda: run(duration=np.nan), "duration"),
        (lambda: run(initial=np.zeros((2, 3))), r"initial must have shape \(2, 2\)"),
        (lambda: run(initial=[[0.0, np.nan], [0.0, 0.0]]), "0, 1"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def run(**options):
    return evaluate(arm(), RIG, puma560.p_law(), puma560.reference(), **options)


def test_a_loop_that_diverges_says_when_and_where():
    """Gains beyond what a sub-step can follow, without limit: no verdict, but a time and a
    joint.
    """
    limitless = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, current_limit=(np.inf, np.inf))
    )
    with pytest.raises(
        ValueError, match=r"diverges after t = 0\.\d* s, joint [23] \(q\[[01]\]\) first"
    ) as refusal:
        evaluate(arm(), limitless, puma560.p_law((1e5, 1e5)), puma560.reference(), duration=0.5)
    assert "\n" not in str(refusal.value)


def test_from_a_sag_the_arm_is_within_one_pulse_after_17_ms():
    """A joint that hangs 5 pulses below its reference, as a P loop leaves it; design.md quotes
    the 24 samples.
    """
    pulse = RIG.drive.joint_angle(2 * np.pi / RIG.encoder.resolution)
    initial = (puma560.reference()([0.0]).q[0] + pulse * (5, 0), (0, 0))
    path = puma560.reference()
    got = evaluate(
        arm(), RIG, ComputedTorque(arm(), RIG), path, backend="numba", duration=1.0, initial=initial
    )
    outside = np.flatnonzero((np.abs(got.record.error_pulses) > 1).any(axis=1))
    assert outside[0] == 0
    assert outside[-1] < 24

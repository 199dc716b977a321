"""Identification from logged torques: a planar arm driven in open loop, at uneven times, from
zeros nobody knows.
"""

import dataclasses
import functools

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import Objective, identify
from identification.replay import DEPENDENT, FollowedSettings, Prediction, gauss_newton, reweighed
from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Link,
    LoggedTorque,
    Record,
    Rig,
    puma560,
    replay,
    simulate,
)

LINKS = (Link(name="1", alpha=np.pi / 2, theta=-np.pi / 2), Link(name="2", a=0.3))
DYNAMICS = Dynamics.from_chain(Chain(links=LINKS))
F = np.array([0.35, 0.0, 0.11, 0.12, 0.0, 0.026, 0.004])
"""mx1 + a2 m2, my1, J1 + Izz1 + a2^2 m2, mx2, my2, Izz2, J2: an arm of two symmetric links that
hangs at q = 0.
"""
SHOWN = [0, 2, 3, 5]
FRICTION = ("drive.viscous[0]", "drive.viscous[1]", "drive.coulomb[0]", "drive.coulomb[1]")
TRUE = np.array([2e-4, 1e-4, 0.02, 0.01])
UNKNOWN = (*DYNAMICS.names, *FRICTION)


def rig(viscous=TRUE[:2], coulomb=TRUE[2:]):
    drive = Drive(
        gear=(6, -6),
        motor_inertia=(6e-5, 6e-5),
        viscous=viscous,
        coulomb=coulomb,
        motor_gain=(0.1, 0.1),
        current_limit=(30, 30),
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(2700, 2700)), period=0.002)


@functools.lru_cache
def log(seed, zero=(0.0, 0.0), seconds=4.0, friction=1.0):
    """What a logger would hold of the true arm: its counters begin at zero, wherever the arm
    hangs.
    """
    rng = np.random.default_rng(seed)
    t = np.cumsum(0.002 * rng.uniform(0.93, 1.07, int(seconds / 0.002)))
    t[len(t) // 2 :] += 0.006
    t -= t[0]
    w = 2 * np.pi * np.array([0.7, 1.3, 2.1])
    torque = np.stack(
        [
            (rng.normal(size=3) * np.sin(w * t[:, None] + 6 * rng.random(3))).sum(axis=1)
            for _ in "12"
        ],
        1,
    )
    torque *= np.minimum(1, t / 0.3)[:, None] * (0.9, 0.35)
    true = rig(TRUE[:2] * friction, TRUE[2:] * friction)
    bare = Record(
        t=t, error_pulses=np.zeros((len(t), 2)), torque=torque, rig=true, law=LoggedTorque()
    )
    start = np.array([zero, (0.0, 0.0)])
    made = replay(DYNAMICS.arm(F), dataclasses.replace(bare, initial=start), steps_per_sample=16)
    counts = made.counts - np.round(true.position_in_pulses(np.array(zero)))
    guess = rig(TRUE[:2] * 2, TRUE[2:] * 0.7)
    return dataclasses.replace(bare, error_pulses=-counts, rig=guess)


def ranges():
    about = np.append(F, TRUE)
    return np.column_stack([about / 5, about * 5])


@functools.lru_cache
def found(zeros=True):
    records = [log(1, (0.05, -0.1)), log(2, (-0.03, 0.04))]
    return identify(
        DYNAMICS,
        records,
        unknown=UNKNOWN,
        ranges=ranges(),
        zeros=zeros,
        held_out=(),
        progress=False,
    )


@pytest.mark.slow
def test_the_arm_its_friction_and_the_zeros_are_found():
    """Within three of its own standard deviations (values kept at zero stay), and f within 3 %."""
    true = np.append(F, TRUE)
    free = true != 0
    off = (found().fit.values - true)[free]
    assert (np.abs(off) < 4 * found().fit.std[free]).all(), off / found().fit.std[free]
    assert (np.abs(off / true[free])[:5] < 0.03).all()
    np.testing.assert_allclose(found().fit.zeros, [(0.05, -0.1), (-0.03, 0.04)], atol=3e-3)
    assert (found().fit.values[~free] == 0).all()
    assert found().fit.rms_innovation < 0.6


@pytest.mark.slow
def test_the_simulated_runs_begin_where_the_zeros_are():
    """Free runs are compared with the records moved to where they began: far closer than
    without.
    """
    assert found().diagnostics.difference < 0.5 * found(zeros=False).diagnostics.difference


@pytest.mark.slow
def test_the_torque_equation_begins_near_the_truth():
    """In the band where it holds best; what is known is not searched but taken into account."""
    equal = ranges()
    for name in ("J2", "mx2"):
        equal[UNKNOWN.index(name)] = np.append(F, TRUE)[UNKNOWN.index(name)]
    for limits in (ranges(), equal):
        fit = identify(
            DYNAMICS,
            [log(1), log(2)],
            unknown=UNKNOWN,
            ranges=limits,
            method="equation_error",
            held_out=(),
            progress=False,
        )
        assert (np.abs(fit.f[SHOWN] / F[SHOWN] - 1) < 0.05).all()


def test_weights_by_scatter_bring_the_values_nearer():
    """One of two runs has two and a half times the friction, which no model of both can have.

    Asserted of the common fit: `identify` takes the mean of the fits of each record where records
    contradict each other, and these do not depend on the weights.
    """
    prediction = Prediction(DYNAMICS, [log(1), log(4, friction=2.5)], UNKNOWN)
    true = np.append(F, TRUE)
    bounds = np.vstack([ranges(), prediction.nuisance_bounds])
    steps = np.append(1e-3 * true, prediction.nuisance_steps)
    equal = gauss_newton(prediction, np.append(true, prediction.nuisances), steps, bounds)
    weighted = reweighed(prediction, equal, steps, bounds)
    off = [np.abs(fit.values[SHOWN] / F[SHOWN] - 1).max() for fit in (weighted, equal)]
    assert off[0] < 0.9 * off[1]


def test_it_repeats_a_run_that_it_has_not_seen():
    other = log(3)
    seen = replay(found().arm, other, rig=found().rig)
    off = np.sqrt(np.mean((seen.counts - other.counts) ** 2, axis=0))
    assert (off < 0.02 * np.ptp(other.counts, axis=0)).all(), off / np.ptp(other.counts, axis=0)


@pytest.mark.slow
def test_zeros_that_are_there_and_not_looked_for_do_harm():
    """The point of `zeros`: without them the same logs give worse values, and a worse fit."""
    off = [
        np.abs(each.fit.values[[0, 2, 3, 5]] / F[[0, 2, 3, 5]] - 1).max()
        for each in (found(), found(zeros=False))
    ]
    assert off[1] > 3 * off[0]
    assert found(zeros=False).fit.rms_innovation > 2 * found().fit.rms_innovation


def test_least_squares_is_compared_band_by_band():
    """In some band it is nearly right, far above the motion it finds less, and the warning says
    so.
    """
    bands = found().diagnostics.bands
    assert max(bands.values()) > 0.97
    assert bands[max(bands)] < 0.9
    assert any(
        "least squares on these torques is biased in bands above" in text
        for text in found().warnings
    )


@pytest.mark.parametrize("missing", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_a_gap_costs_its_samples_and_no_more(missing):
    """Across it the torque goes straight; after it the model finds the log again before it is
    compared.
    """
    base = log(1)
    kept = np.r_[0:700, 700 + missing : len(base)]
    gap = dataclasses.replace(
        base, t=base.t[kept], error_pulses=base.error_pulses[kept], torque=base.torque[kept],
        reference_pulses=None, valid=None,
    )  # fmt: skip
    fit = identify(DYNAMICS, gap, unknown=UNKNOWN, ranges=ranges(), progress=False).fit
    true = np.append(F, TRUE)
    assert (np.abs(fit.values - true) <= 4.5 * fit.std).all(), (fit.values - true) / fit.std


def test_a_start_in_motion_is_not_compared_until_it_is_found():
    """Nobody knows the speed there; from a log that begins later the same values come."""
    base = log(1)
    later = dataclasses.replace(
        base, t=base.t[500:], error_pulses=base.error_pulses[500:], torque=base.torque[500:],
        reference_pulses=None, valid=None,
    )  # fmt: skip
    fit = identify(DYNAMICS, later, unknown=UNKNOWN, ranges=ranges(), progress=False).fit
    true = np.append(F, TRUE)
    assert (np.abs(fit.values - true) <= 4.5 * fit.std).all(), (fit.values - true) / fit.std


def test_rows_without_weight_at_the_start_are_a_gap():
    """The replay goes through them without correction, and has drifted where they end."""
    base = log(1)
    valid = np.r_[np.zeros(100), np.ones(len(base) - 100)]
    settled = 100 + FollowedSettings().settling
    late = dataclasses.replace(base, valid=valid)
    (followed,) = Prediction(DYNAMICS, [late], UNKNOWN)._followed
    assert not followed.weight[:settled].any()
    assert followed.weight[settled:].any()


def test_a_record_that_the_model_cannot_follow_counts_less():
    prediction = Prediction(DYNAMICS, [log(1), log(4, friction=2.5)], UNKNOWN)
    values = np.concatenate([F, TRUE, prediction.nuisances])
    before = prediction.innovations(values)
    assert prediction.reweigh(values)
    after, half = prediction.innovations(values), len(log(1)) * 2
    for joint in (0, 1):
        assert before[half + joint :: 2].std() > 1.5 * before[joint:half:2].std()
        np.testing.assert_allclose(
            [
                np.sqrt((part[joint::2] ** 2).sum() / (weight[joint::2] ** 2).sum())
                for part, weight in (
                    (after[:half], prediction.weights[:half]),
                    (after[half:], prediction.weights[half:]),
                )
            ],
            1,
            rtol=1e-9,
        )
    same = Prediction(DYNAMICS, [log(1)], UNKNOWN)
    values = np.concatenate([F, TRUE, same.nuisances])
    assert not Prediction(DYNAMICS, [log(1), log(2)], UNKNOWN).reweigh(values)


def test_samples_without_weight_are_as_good_as_none():
    """Whatever stands in them: neither objective nor prediction may read it."""
    base = log(1)
    valid = np.ones(len(base))
    valid[300:320] = 0
    spoilt = base.error_pulses.copy()
    spoilt[300:320] = 12345
    records = [
        dataclasses.replace(base, valid=valid, error_pulses=e) for e in (base.error_pulses, spoilt)
    ]
    values = np.append(F, TRUE)
    costs = [Objective(DYNAMICS, record, UNKNOWN)(values[None])[0] for record in records]
    assert costs[0] == costs[1]
    innovations = []
    for record in records:
        prediction = Prediction(DYNAMICS, record, UNKNOWN)
        innovations.append(
            prediction.innovations(np.append(values, prediction.nuisances)).reshape(-1, 2)
        )
    # how fast counts move is taken over some samples around
    far = np.abs(np.arange(len(base)) - 310) > 25
    np.testing.assert_array_equal(innovations[0][far], innovations[1][far])
    assert (innovations[0][300:320] == 0).all()


@pytest.mark.slow
def test_a_log_of_computed_torque_tells_f_by_its_torques():
    """The law's own state is in no log, but what it asked for is."""
    arm, robot_rig = puma560.arm(), puma560.rig()
    made = simulate(
        arm, robot_rig, ComputedTorque(arm, robot_rig), puma560.reference(), steps_per_sample=16
    )
    bare = dataclasses.replace(made, law=LoggedTorque(), true_q=None, true_qd=None)
    fit = identify(puma560.dynamics(), bare, progress=False)
    # The motion determines one combination of f4, f7, f8 and f9 to some per cent, the rest far better.
    assert (np.abs(fit.f - arm.f) < 3 * fit.fit.std).all()
    width = np.ptp(puma560.dynamics().ranges, axis=1)
    assert np.median(np.abs(fit.f - arm.f) / width) < 0.01
    assert fit.fit.rms_innovation < 0.3


class Line:
    """y = a + b t, as if it were a prediction."""

    unknown, dependent = ("a", "b"), DEPENDENT

    def __init__(self):
        self.t = np.linspace(0, 1, 50)
        self.weights, self.scales = np.ones(50), np.ones(50)

    def innovations(self, x):
        return (-1.0 + 3.0 * self.t) - x[0] - x[1] * self.t

    def all_innovations(self, many):
        return [self.innovations(x) for x in many]


def test_a_value_at_its_bound_stays_and_the_others_make_up_for_it():
    """The best line with a >= 0 has a = 0 and the slope of least squares through the origin."""
    line = Line()
    fit = gauss_newton(line, (0.5, 0.0), (1e-3, 1e-3), np.array([(0, np.inf), (-np.inf, np.inf)]))
    slope = line.t @ (3 * line.t - 1) / (line.t @ line.t)
    np.testing.assert_allclose(fit.values, (0, slope), atol=1e-9)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: identify(puma560.dynamics(), pulses(), zeros=True, progress=False),
            "only of logs that replay",
        ),
        (lambda: identify(DYNAMICS, log(1), zeros="yes", progress=False), "zeros must be"),
        (
            lambda: identify(DYNAMICS, log(1), zeros=True, method="equation_error", progress=False),
            "zeros must be found",
        ),
        (lambda: identify(DYNAMICS, still(), progress=False), "every motor must move"),
        (
            lambda: Prediction(DYNAMICS, dataclasses.replace(log(1), law=None), UNKNOWN),
            "Pass law= when loading it",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def pulses():
    return simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5
    )


def still():
    return dataclasses.replace(log(1), error_pulses=np.zeros_like(log(1).error_pulses))

"""Torque that was injected beside the law's: simulated, logged, replayed, and kept by every
operation on a record.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import Constant, NoTorque, direct_rig, joint

from ctc import ComputedTorque, evaluate
from identification.equation_error import torque_of
from plant import (
    Elasticity,
    LoggedCurrent,
    LoggedTorque,
    PointToPoint,
    Record,
    Transport,
    puma560,
    replay,
    simulate,
    to_control,
)
from plant.checkup import Signals
from plant.machine import CurrentLag
from plant.simulation import ClosedLoop, Structure

ARM, RIG, PATH, LAW = puma560.arm(), puma560.rig(), puma560.reference(), puma560.p_law()
STILL = PointToPoint(start=(0.0,), goal=(0.0,), duration=0.5)


def pushes(t):
    """Two tones [N m]."""
    return np.column_stack([25 * np.sin(2 * np.pi * 3 * t), 12 * np.cos(2 * np.pi * 5 * t)])


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, RIG, LAW, PATH, duration=0.7, injected=pushes)


# -- truths --------------------------------------------------------------------------------------
def test_a_free_mass_moves_as_the_held_torque_says():
    """Constant acceleration from each sample to the next, without gravity, friction and law:
    exact sums.
    """
    inertia, rig = 2.0, direct_rig((0.0,), (0.0,))
    torque = np.random.default_rng(0).normal(size=(715, 1))
    record = simulate(joint(0.0, 0.0, inertia), rig, NoTorque(), STILL, injected=torque)
    h = rig.period
    qd = np.append(0, np.cumsum(torque[:-1] * h / inertia))
    q = np.append(0, np.cumsum(qd[:-1] * h + torque[:-1, 0] * h * h / inertia / 2))
    np.testing.assert_allclose(record.true_q[:, 0], q, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(record.torque, torque)
    np.testing.assert_array_equal(record.injected, torque)


def test_the_amplifiers_limit_holds_for_the_law_and_for_the_sum():
    rig = direct_rig((0.0,), (0.0,))
    rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_limit=(5.0,)))
    for asked, added, driven in (
        (3.0, 1.0, 4.0),
        (3.0, 4.0, 5.0),
        (9.0, -2.0, 3.0),
        (-9.0, -1.0, -5.0),
    ):
        law = Constant(torque=asked, period=rig.period)
        record = simulate(joint(0.0, 0.0, 2.0), rig, law, STILL, injected=np.full((715, 1), added))
        np.testing.assert_allclose(record.torque, driven)
        np.testing.assert_allclose(record.current, driven)
        np.testing.assert_allclose(record.true_qd[-1], driven / 2.0 * 714 * rig.period, rtol=1e-10)


def test_a_sampled_law_does_not_know_of_it():
    """The observer of computed torque is told its own torque alone, so that it sees a
    disturbance and rejects it.
    """
    law = ComputedTorque(ARM, RIG)
    report = evaluate(
        ARM, RIG, law, PATH, duration=0.7, injected=lambda t: np.full((len(t), 2), (20.0, -8.0))
    )
    plain = evaluate(ARM, RIG, law, PATH, duration=0.7)
    assert report.within(1)
    assert report.on_gears is None
    after = slice(500, None)
    own = (report.record.torque - report.record.injected)[after]
    np.testing.assert_allclose(own + np.array([20.0, -8.0]), report.record.torque[after])
    # The arm needs what it needs: the law gives so much less. Its chatter is some N m.
    assert np.abs((report.record.torque - plain.record.torque)[after].mean(axis=0)).max() < 0.5


def test_an_elastic_gear_and_a_lag_of_the_current_are_behind_it():
    """A torque on a motor held by nothing, against a rigid one: through the lag, half a time
    constant late at first.
    """
    inertia, lag = 2.0, 0.02
    rig = direct_rig((0.0,), (0.0,))
    rig = dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, current_lag=lag))
    record = simulate(joint(0.0, 0.0, inertia), rig, NoTorque(), STILL, injected=np.ones((715, 1)))
    t = record.t
    np.testing.assert_allclose(
        record.true_qd[:, 0], (t - lag * (1 - np.exp(-t / lag))) / inertia, atol=1e-6
    )
    gears = Elasticity(stiffness=(1e4,), damping=(30.0,))
    drive = dataclasses.replace(rig.drive, current_lag=None, elasticity=gears, motor_inertia=(0.5,))
    record = simulate(
        joint(0.0, 0.0, inertia),
        dataclasses.replace(rig, drive=drive),
        NoTorque(),
        STILL,
        injected=np.ones((715, 1)),
    )
    np.testing.assert_allclose(record.true_qd[-1], t[-1] / inertia, rtol=0.01)
    motors = record.counts[400:, 0] / rig.position_in_pulses(np.ones(1))
    links = record.true_q[400:, 0]
    # of 1 N m three quarters pass
    np.testing.assert_allclose((motors - links).mean(), 0.75 / 1e4, rtol=0.05)


# -- invariants ----------------------------------------------------------------------------------
def test_without_it_the_loop_is_the_same_graph_and_with_it_a_time_input_more():
    options = {"dynamics": ARM.dynamics, "rig": RIG, "law": LAW, "steps_per_sample": 4}
    plain, other = ClosedLoop(**options), ClosedLoop(injected=True, **options)
    assert Structure(ClosedLoop(injected=False, **options)) == Structure(plain) != Structure(other)
    assert (other.state_names, other.number_names) == (plain.state_names, plain.number_names)
    assert [name for name in other.time_names if name not in plain.time_names] == [
        "injected[0]",
        "injected[1]",
    ]
    runs = [
        simulate(ARM, RIG, LAW, PATH, duration=0.1, injected=given)
        for given in (None, np.zeros((143, 2)))
    ]
    np.testing.assert_array_equal(runs[0].error_pulses, runs[1].error_pulses)
    assert runs[0].injected is None


def test_a_function_is_asked_once_for_all_samples(record):
    given = simulate(ARM, RIG, LAW, PATH, duration=0.7, injected=pushes(record.t))
    assert given == record
    plain = simulate(ARM, RIG, LAW, PATH, duration=0.7)
    assert np.abs(given.error_pulses - plain.error_pulses).max() > 2


def test_both_backends_agree_with_all_that_may_be_between():
    law = ComputedTorque(ARM, RIG)
    drive = dataclasses.replace(RIG.drive, current_lag=CurrentLag(time=3e-4))
    rig = dataclasses.replace(RIG, drive=drive, transport=Transport(delay=2e-4, lost=(3, 17)))
    runs = [
        simulate(ARM, rig, law, PATH, duration=0.1, injected=pushes, backend=each)
        for each in ("numba", "casadi")
    ]
    np.testing.assert_allclose(runs[0].true_q, runs[1].true_q, rtol=0, atol=1e-11)


def test_replays_repeat_it_whatever_they_replay(record):
    again = replay(ARM, record)
    np.testing.assert_array_equal(again.error_pulses, record.error_pulses)
    np.testing.assert_array_equal(again.torque, record.torque)
    missing = replay(ARM, dataclasses.replace(record, injected=None))
    assert np.abs(missing.error_pulses - record.error_pulses).max() > 2
    sampled = simulate(ARM, RIG, ComputedTorque(ARM, RIG), PATH, duration=0.3, injected=pushes)
    for law in (LoggedTorque(), LoggedCurrent()):  # what the motors gave holds it already
        repeated = replay(ARM, sampled, law=law)
        np.testing.assert_allclose(repeated.true_q, sampled.true_q, rtol=0, atol=1e-9)


def test_the_torque_equation_has_the_sum(record):
    """Of the law's counts now, and of a torque that is held: half of each sample's."""
    held = (record.injected[1:] + record.injected[:-1]) / 2
    own = record.torque - record.injected
    np.testing.assert_allclose(torque_of(record)[1:], own[1:] + held, rtol=0, atol=1e-9)
    sampled = simulate(ARM, RIG, ComputedTorque(ARM, RIG), PATH, duration=0.1, injected=pushes)
    logged = (sampled.torque[1:] + sampled.torque[:-1]) / 2
    np.testing.assert_allclose(torque_of(sampled)[1:], logged, rtol=0, atol=1e-12)


# -- records -------------------------------------------------------------------------------------
def test_files_cuts_and_resampled_records_keep_it(record, tmp_path):
    record.to_csv(tmp_path / "log.csv")
    again = Record.from_csv(tmp_path / "log.csv")
    assert again == record
    np.testing.assert_array_equal(
        record.cut(0.1, 0.5).injected, record.injected[(record.t >= 0.1) & (record.t < 0.5)]
    )
    coarse = record.resampled(2 * RIG.period)
    np.testing.assert_allclose(
        coarse.injected[:-1],
        (record.injected[:-1:2] + record.injected[1::2])[: len(coarse) - 1] / 2,
    )
    assert "injected[1]" in to_control(record).output_labels


@pytest.mark.parametrize(
    ("unit", "side"), [("N m", None), ("motor N m", "motor"), (("N m", "N"), None)]
)
def test_a_table_has_it_in_its_units(record, unit, side):
    given = record.injected if side is None else RIG.drive.motor_torque(record.injected)
    table = {"t": record.t, "e": record.error_pulses, "r": record.reference_pulses, "push": given}
    columns = {"t": "t", "error_pulses": "e", "reference_pulses": "r", "injected": "push"}
    read = Record.from_table(
        table, rig=RIG, law=LAW, columns=columns, units={"t": "s", "injected": unit}
    )
    np.testing.assert_allclose(read.injected, record.injected, rtol=1e-12)
    assert read.torque is None
    with pytest.raises(ValueError, match="units must state that of 'injected'"):
        Record.from_table(table, rig=RIG, law=LAW, columns=columns, units={"t": "s"})


def test_the_checkup_counts_it_as_commanded(record):
    """The commanded torque against the logged one: else they differ, and the record is said not
    to be its law's.
    """
    longer = simulate(ARM, RIG, LAW, PATH, duration=2.0, injected=pushes)
    assert longer.check().ok, str(longer.check())
    signals = Signals(longer)
    np.testing.assert_allclose(signals.commanded, signals.torque, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (np.zeros((5, 2)), r"injected must have shape \(143, 2\); got shape \(5, 2\)"),
        (np.zeros(143), r"injected must have shape \(143, 2\); got shape \(143,\)"),
        (np.full((143, 2), np.nan), "injected must be finite; got nan"),
        (lambda t: np.zeros((len(t), 3)), r"injected\(t\) must have shape \(143, 2\)"),
        (lambda t: "much", r"injected\(t\) must be numbers"),
    ],
)
def test_bad_torques_are_refused_in_one_line(given, message):
    with pytest.raises(ValueError, match=message) as error:
        simulate(ARM, RIG, LAW, PATH, duration=0.1, injected=given)
    assert "\n" not in str(error.value)


def test_a_record_refuses_other_rows(record):
    with pytest.raises(
        ValueError, match=r"injected must have shape \(1000, 2\); got shape \(999, 2\)"
    ):
        dataclasses.replace(record, injected=record.injected[1:])

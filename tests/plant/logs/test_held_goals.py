"""Goals that a servo holds from row to row: as a reference, read from files, and identified."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servos import GAIN, VISCOUS, arm, dynamics, rig

from identification import identify
from plant import (
    Elasticity,
    Encoder,
    Harmonics,
    Held,
    PointToPoint,
    PositionServo,
    Record,
    Spline,
    simulate,
)
from plant.checkup import lost_rows
from plant.simulation import path_of

SERVO = PositionServo(gain=GAIN)
WIDE = Harmonics(
    period=10.0,
    offset=(0.3, -0.2),
    cosine=((0.2, -0.1, 0.1, 0, 0.1), (0.1, 0.2, -0.2, 0.1, 0)),
    sine=((0.3, 0.2, -0.2, 0.1, 0.1), (-0.3, 0.2, 0.2, 0, 0.1)),
)  # fmt: skip


def held_log(period, every=1, seconds=20.0, true=None):
    """A servo's log whose goals change at every so many rows, with the counts alone."""
    below = rig(period, None)
    times = period * np.arange(round(seconds / period))
    sent = times[::every]
    goals = Held(times=sent, points=below.cell_centre(below.counts(WIDE(sent).q)))
    # A gear vibrates between samples: a tenth of them is short enough.
    steps = {"steps_per_sample": 10} if true else {}
    log = simulate(arm(), true or below, SERVO, goals, duration=seconds, **steps)
    return dataclasses.replace(log, torque=None, current=None, true_q=None, true_qd=None)


@given(
    steps=st.lists(st.floats(1e-3, 1.0), min_size=2, max_size=8),
    place=st.floats(0, 1, exclude_max=True),
)
def test_a_goal_holds_until_the_next_is_sent(steps, place):
    times = np.cumsum(steps)
    goals = Held(times=times, points=np.arange(len(times))[:, None])
    # The clock takes times up to a hundredth of an interval early as even.
    row = min(int(place * len(times)), len(times) - 2)
    inside = times[row] + place * 0.95 * (times[row + 1] - times[row])
    margin = 0.02 * np.diff(times).min()
    motion = goals([times[0] - 1, times[row], inside, times[-1] + 1])
    before_next = inside < times[row + 1] - margin
    assert motion.q[:, 0].tolist() == [0, row, row if before_next else row + 1, len(times) - 1]
    assert not motion.qd.any()
    assert not motion.qdd.any()


def test_goals_of_a_file_hold_by_one_word(tmp_path):
    log = held_log(0.02, seconds=2.0)
    plain = np.column_stack([log.t, log.reference_pulses, log.error_pulses])
    path = tmp_path / "log.csv"
    np.savetxt(path, plain, delimiter=",", header="t,r1,r2,e1,e2", comments="")
    record = Record.from_csv(path, rig=log.rig, law=SERVO, held=True)
    assert isinstance(record.reference, Held)
    np.testing.assert_array_equal(log.rig.counts(record.reference(log.t).q), log.reference_pulses)
    # Its own file keeps it.
    record.to_csv(tmp_path / "own.csv")
    assert Record.from_csv(tmp_path / "own.csv") == record


def test_action_and_observation_of_a_data_set_are_goals_and_counts():
    log = held_log(0.02, seconds=2.0)
    # Fractions of a degree, as a data set has them: without `held` they would be a smooth path.
    table = {
        "action": np.rad2deg(WIDE(log.t).q),
        "observation.state": np.rad2deg(log.rig.cell_centre(log.counts)),
    }
    columns = {"position": "observation.state", "reference_position": "action"}
    units = {"position": "deg", "reference_position": "deg"}
    options = {"rig": log.rig, "law": SERVO, "columns": columns, "units": units}
    record = Record.from_table(table, held=True, **options)
    assert record.reference.held
    np.testing.assert_array_equal(record.counts, log.counts)
    np.testing.assert_array_equal(record.reference_pulses, log.reference_pulses)
    assert isinstance(Record.from_table(table, **options).reference, Spline)


def test_a_cut_of_held_goals_still_holds_them():
    cut = held_log(0.02, seconds=2.0).cut(1.0)
    assert cut.reference.held
    np.testing.assert_array_equal(cut.rig.counts(cut.reference(cut.t).q), cut.reference_pulses)


@pytest.mark.parametrize(("every", "factor"), [(1, 0.5), (1, 0.7), (3, 0.7), (2, 1.5)])
def test_resampled_goals_are_still_those_that_were_held(every, factor):
    log = held_log(0.02, every, seconds=2.0)
    again = log.resampled(0.02 * factor)
    # The reference in place of a column of its own: goals may be sent between two samples.
    goals = again.rig.counts(log.reference(again.t).q)
    np.testing.assert_array_equal(again.reference_pulses, goals)
    path_of(again)
    # What the reference does not explain is still seen.
    wrong = dataclasses.replace(log, reference_pulses=log.reference_pulses + 20)
    with pytest.raises(ValueError, match="reference_pulses must be the reference's own"):
        path_of(wrong.resampled(0.02 * factor))


@pytest.mark.parametrize("every", [1, 3])
def test_goals_slower_than_reads_are_no_lost_rows(every):
    log = held_log(0.01, every)
    assert not lost_rows(log).any.any()
    repeats = np.diff(log.reference_pulses, axis=0).any(axis=1)
    assert (repeats.mean() < 0.4) == (every == 3)


def test_a_lost_packet_of_a_servo_is_still_seen():
    log = held_log(0.01)
    counts = log.counts
    moving = np.abs(np.diff(counts, axis=0)).min(axis=1)
    row = int(np.argmax(moving)) + 1
    counts[row] = counts[row - 1]
    spoilt = dataclasses.replace(log, error_pulses=log.reference_pulses - counts)
    assert lost_rows(spoilt).any[row]


@pytest.mark.parametrize(("period", "every"), [(0.033, 1), (0.01, 3)])
def test_slow_goals_give_the_friction_of_the_arm(period, every):
    # The loop of a servo is damped: no oscillation has to be seen.
    found = identify(dynamics(), held_log(period, every), unknown="friction", progress=False)
    np.testing.assert_allclose(found.rig.drive.viscous, VISCOUS, rtol=0.05)
    np.testing.assert_allclose(found.rig.drive.coulomb, 0.052, rtol=0.05)
    # The timing of such a log is not told apart from its friction; nothing else is in doubt.
    assert not [text for text in found.warnings if "not separately identifiable" not in text]


@pytest.mark.slow
def test_a_quarter_of_a_degree_of_unstated_play_biases_little():
    below = rig(0.02, None)
    gears = Elasticity(stiffness=(500, 500), damping=(1, 1), backlash=np.deg2rad((0.25, 0.25)))
    worn = dataclasses.replace(
        below,
        drive=dataclasses.replace(below.drive, elasticity=gears),
        encoder=Encoder(resolution=4096, side="link"),
    )
    log = held_log(0.02, true=worn)
    record = Record(
        t=log.t,
        reference_pulses=log.reference_pulses,
        error_pulses=log.error_pulses,
        rig=below,
        law=SERVO,
        reference=log.reference,
    )
    found = identify(dynamics(), record, unknown="friction", progress=False)
    np.testing.assert_allclose(found.rig.drive.viscous, VISCOUS, rtol=0.1)
    np.testing.assert_allclose(found.rig.drive.coulomb, 0.052, rtol=0.1)


def test_held_refuses_another_reference_and_goals_at_rest():
    log = held_log(0.02, seconds=2.0)
    counts = {"c": log.counts, "g": log.reference_pulses}
    columns = {"counts": "c", "reference_pulses": "g"}
    still = PointToPoint(start=(0, 0), goal=(0, 0), duration=1.0)
    with pytest.raises(ValueError, match="reference, PointToPoint"):
        Record.from_table(counts, rig=log.rig, columns=columns, reference=still, held=True)
    counts["g"] = np.zeros_like(log.counts)
    with pytest.raises(ValueError, match="held goals must move"):
        Record.from_table(counts, rig=log.rig, columns=columns, held=True)
    with pytest.raises(ValueError, match="times must increase"):
        Held(times=(0, 0), points=((0,), (1,)))

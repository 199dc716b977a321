"""Conventions of counters, rows that are no measurement, advice that is tried: each seen in logs
spoiled on purpose.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest

from identification import Objective
from plant import Encoder, Harmonics, Phase, PointToPoint, Record, puma560, simulate
from plant.checkup import Signals, bridged, fix_seen, lost_rows, renumbered, short_gaps
from plant.simulation import path_of

PATH = Harmonics(
    period=3.0,
    offset=(0.1, -0.05),
    cosine=((0.2, 0.1, 0.1), (0.1, 0.2, -0.1)),
    sine=((0.3, -0.2, 0.1), (-0.3, 0.1, 0.1)),
)


def rig(rounding, shift=(0.0, 0.0)):
    encoder = Encoder(resolution=(800, 1000), rounding=rounding, phase=Phase(shift=shift))
    return dataclasses.replace(puma560.rig(), encoder=encoder)


@cache
def log(rounding="floor"):
    record = simulate(
        puma560.arm(), rig(rounding, (0.3, -0.4)), puma560.p_law((0.1, 0.08)), PATH, duration=6.0
    )
    return dataclasses.replace(record, rig=rig(rounding))


def rows(record, row):
    names = ("error_pulses", "reference_pulses", "torque", "current")
    return dataclasses.replace(record, **{name: getattr(record, name)[row] for name in names})


def counting(record, counts):
    return dataclasses.replace(record, error_pulses=record.reference_pulses - counts)


def packets_lost(record, seed=0):
    row = np.arange(len(record))
    lost = np.flatnonzero(np.random.default_rng(seed).random(len(row)) < 0.01)
    for k in lost:
        row[k] = row[k - 1]
    return rows(record, row), lost


def finding(record, check):
    return next(f for f in record.check().findings if f.check == check)


# -- which way counters round --------------------------------------------------------------------
@pytest.mark.parametrize("rounding", ["floor", "fix", "round"])
def test_the_wide_cell_of_fix_is_seen_where_joints_pass_zero(rounding):
    seen = fix_seen(Signals(log(rounding)))
    assert seen > 0.95 if rounding == "fix" else seen < 0.05


@pytest.mark.parametrize(("made", "stated"), [("floor", "fix"), ("fix", "floor")])
def test_another_convention_than_stated_is_said_with_its_probability_and_corrected(made, stated):
    wrong = dataclasses.replace(log(made), rig=rig(stated))
    checkup = wrong.check()
    found = next(f for f in checkup.findings if f.check == "rounding")
    assert found.verdict == "wrong"
    assert f'rounding="{made}"' in found.advice
    assert "(probability 9" in found.advice
    assert checkup.corrected.rig.encoder.rounding == made


def test_where_no_joint_passes_zero_the_convention_is_undecidable():
    path = dataclasses.replace(PATH, offset=(2.0, -2.0))
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), path, duration=1.5)
    assert (
        finding(record, "rounding").verdict
        == "cannot tell: no joint passes zero clearly; fix is stated"
    )


# -- rows that are no measurement ----------------------------------------------------------------
def test_lost_packets_are_found_and_bridged_near_what_was_there():
    spoiled, lost = packets_lost(log())
    found = lost_rows(spoiled)
    others = found.stuck | found.glitches | found.late | found.turns.any(axis=1)
    assert not others.any()
    assert set(np.flatnonzero(found.packets)) <= set(lost)
    mended = bridged(spoiled)
    assert np.abs(mended.counts - log().counts).max() <= 3
    assert (mended.valid == ~found.packets).all()
    assert bridged(mended) is not None
    assert bridged(log()) is log()


def test_a_lost_packet_in_a_log_whose_reference_is_stated_is_no_error():
    spoiled, _ = packets_lost(log())
    assert np.abs(path_of(spoiled)(spoiled.t)[1] - spoiled.reference_pulses).max() > 4
    other = dataclasses.replace(spoiled, reference=dataclasses.replace(PATH, period=3.1))
    with pytest.raises(ValueError, match="pulses off"):
        path_of(other)


def test_a_joint_at_rest_repeats_counts_and_is_no_lost_row():
    move = PointToPoint(start=(0, 0), goal=(1.0, -0.7), duration=0.5)
    record = simulate(puma560.arm(), rig("floor"), puma560.p_law(), move, duration=1.5)
    assert (np.diff(record.counts, axis=0) == 0).all(axis=1).mean() > 0.3
    assert not lost_rows(record).any.any()


def test_stuck_samples_late_stamps_and_turns_are_told_apart():
    record, counts = log(), np.array(log().counts)
    fast = np.flatnonzero(np.abs(np.gradient(counts[:, 0])) > 12)[[50, 500, 1000]]
    for k in fast:
        counts[k : k + 3, 0] = counts[k - 1, 0]
    found = lost_rows(counting(record, counts))
    assert set(np.flatnonzero(found.stuck)) == {k + i for k in fast for i in range(3)}
    assert not found.packets.any()

    t = np.array(record.t)
    t[fast] += 0.45 * record.rig.period
    found = lost_rows(dataclasses.replace(record, t=t))
    assert set(fast) <= set(np.flatnonzero(found.late)) <= {*fast, *(fast + 1), *(fast - 1)}
    assert not (found.packets | found.stuck).any()

    turned = np.array(record.counts)
    turned[3000:, 1] -= 1000
    np.testing.assert_array_equal(bridged(counting(record, turned)).counts, record.counts)


@pytest.mark.parametrize("hole", [True, False])
def test_rows_that_a_log_lacks_unseen_in_its_stamps_are_named_with_their_times(hole):
    """Stamps that were numbered anew: counts of all joints jump by speed times gap. With their
    own, none is named.
    """
    record = log()
    kept = np.delete(
        np.arange(len(record)), np.arange(2000, 2030) if hole else np.arange(1000, 8000, 37)
    )
    names = ("error_pulses", "reference_pulses", "torque", "current")
    some = {name: getattr(record, name)[kept] for name in names}
    lacking = Record(t=record.t[: len(kept)], rig=record.rig, law=record.law, **some)
    first, *others = lacking.check().problems
    assert (first.check, first.verdict) == ("rows left out", "wrong")
    assert f"lost, or repeated, at t = {record.t[2000 if hole else 1000]:.6g}" in first.advice
    assert "jumps" not in [f.check for f in others]
    assert first.value == 1 if hole else first.value > 50
    stamped = dataclasses.replace(lacking, t=record.t[kept])
    assert "rows left out" not in [
        f.check for f in (*stamped.check().problems, *log().check().problems)
    ]


@pytest.mark.parametrize("hz", [60, 150])
def test_a_loop_that_swings_wildly_lacks_no_rows(hz):
    record = log()
    swing = np.round(np.exp(record.t) * np.sin(2 * np.pi * hz * record.t))[:, None] * (300, 200)
    swinging = dataclasses.replace(
        record, error_pulses=record.error_pulses + swing, torque=None, current=None
    )
    assert "rows left out" not in [f.check for f in swinging.check().problems]


@pytest.mark.parametrize("hz", [200, 230, 290])
def test_a_loop_that_oscillates_from_row_to_row_has_no_stuck_samples(hz):
    """Two counts in a row are equal where it turns, and the next ones catch up."""
    record = log()
    swing = np.outer(np.sin(2 * np.pi * hz * record.t), (30, 20))
    swinging = counting(record, np.round(record.counts + swing))
    assert (np.diff(swinging.counts, axis=0) == 0).any()
    assert not lost_rows(swinging).stuck.any()


@pytest.mark.parametrize("samples", [1.2, 1.9])
def test_counts_that_begin_late_lack_no_rows(samples):
    """A late logger repeats its first count; nothing before it tells where the arm was."""
    fine = dataclasses.replace(rig("floor"), encoder=Encoder(resolution=4096, rounding="floor"))
    law = puma560.p_law(np.array((80, 80)) / 4096)
    record = simulate(puma560.arm(), fine, law, PATH, duration=2.0).cut(0.28)
    row = np.arange(len(record))
    late = np.column_stack([np.interp(row - samples, row, column) for column in record.counts.T])
    assert not renumbered(Signals(counting(record, np.floor(late)))).size


def test_a_log_of_repeated_rows_alone_is_refused_in_one_line():
    row = np.arange(len(log())) // 3 * 3
    with pytest.raises(
        ValueError, match=r"most rows must be measurements; .* Log every sample once"
    ):
        bridged(rows(log(), row))
    said = [
        each.advice for each in rows(log(), row).check().problems if each.check == "lost packets"
    ]
    assert all("too many for any fit; log every sample, and anew" in line for line in said)
    assert len(said) == 1


def test_lost_packets_hardly_change_the_objective():
    """Objective (4) counts errors of rows with weight alone: without the lost ones it is that of
    the clean log.
    """
    spoiled, _ = packets_lost(log())
    dynamics, f = puma560.dynamics(), puma560.arm().f[None]
    clean, mended = (Objective(dynamics, record)(f)[0] for record in (log(), bridged(spoiled)))
    assert 0.97 * clean < mended < 1.02 * clean


def test_short_gaps():
    missing = np.array([1, 0, 1, 1, 1, 0, 0, 1, 1], bool)
    np.testing.assert_array_equal(short_gaps(missing, 2), [1, 0, 0, 0, 0, 0, 0, 1, 1])


# -- advice --------------------------------------------------------------------------------------
@pytest.mark.slow
def test_a_torque_that_is_turned_back_is_the_logs_own():
    record = dataclasses.replace(log(), torque=log().torque * (-1, 1), current=None)
    checkup = record.check()
    (cause,) = checkup.causes
    assert (cause.name, cause.joints) == ("turned torque", (0,))
    assert "odds over 1e99" in checkup.problems[0].advice.lower()
    np.testing.assert_array_equal(checkup.corrected.torque, log().torque)
    assert checkup.corrected.check().ok


@pytest.mark.parametrize("angles", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_exchanged_counts_are_exchanged_and_no_sign_is_changed(angles):
    """As counts, or as angles that the reader has converted by each other's gear."""
    own = log().rig
    counts = own.counts(own.cell_centre(log().counts)[:, ::-1]) if angles else log().counts[:, ::-1]
    checkup = counting(log(), counts).check()
    coarser = ["quantisation step"] * angles  # pulses of 800 per turn, in those of 1000
    assert [f.check for f in checkup.problems] == ["swapped joints"] * 2 + coarser
    assert [(cause.name, cause.joints) for cause in checkup.causes] == [
        ("exchanged counts", (0, 1))
    ]
    assert np.abs(checkup.corrected.counts - log().counts).max() <= angles
    assert [f.check for f in checkup.corrected.check().problems] == coarser


def test_a_healthy_log_is_left_as_it_is():
    checkup = log().check()
    assert checkup.ok
    assert checkup.corrected is log()


@pytest.mark.parametrize("samples", [0.6, 1.2])
def test_late_counts_are_corrected_without_a_logged_torque(samples):
    """The law's torque is then that of its counts, and no more explained by them when they are
    shifted.
    """
    row, position = np.arange(len(log())) - samples, log().rig.position_in_pulses(log().true_q)
    moved = np.column_stack([np.interp(row, np.arange(len(row)), column) for column in position.T])
    record = dataclasses.replace(log(), torque=None, current=None)
    checkup = counting(record, np.floor(moved + np.array((0.3, -0.4)))).check()
    (cause,) = checkup.causes
    assert cause.name == "late counts"
    assert cause.size == pytest.approx(samples, abs=0.1)
    assert checkup.corrected.check().ok
    assert np.abs(checkup.corrected.counts - log().counts).mean() < 0.5


def test_more_friction_is_not_taken_for_late_counts():
    """Viscous friction above the stated one looks like late counts, but for the jerk that they
    add.
    """
    drive = dataclasses.replace(puma560.rig().drive, viscous=(5e-3, 5e-3))
    made = simulate(
        puma560.arm(),
        dataclasses.replace(rig("floor"), drive=drive),
        puma560.p_law((0.1, 0.08)),
        PATH,
    )
    record: Record = dataclasses.replace(made, rig=rig("floor"), torque=None, current=None)
    checkup = record.check()
    assert [f.check for f in checkup.problems] == ["viscous friction"] * 2
    assert [f.value for f in checkup.problems] == pytest.approx((5e-3, 5e-3), rel=0.1)
    assert checkup.corrected is record


# -- causes are told before what they do ---------------------------------------------------------
def test_degrees_are_told_before_lost_rows():
    turn = 180 / np.pi
    wrong = dataclasses.replace(
        log(),
        reference=None,
        reference_pulses=turn * log().reference_pulses,
        error_pulses=turn * log().error_pulses,
    )
    assert not lost_rows(wrong).any.any()
    first, *_ = wrong.check().problems
    assert first.check == "units of counts"
    assert "in steps of 57.2958 = 180/pi" in first.advice


def test_a_torque_that_is_cut_off_is_told_before_counts_that_do_not_follow():
    own = rig("floor")
    weak = dataclasses.replace(
        own, drive=dataclasses.replace(own.drive, current_limit=0.35 * own.drive.current_limit)
    )
    record = simulate(
        puma560.literature_arm(1.5), weak, puma560.p_law((0.2, 0.15)), PATH, duration=3.0
    )
    first, *_ = dataclasses.replace(record, rig=own).check().problems
    assert first.check == "clipped torque"

"""Correction of the loop by a log: observer gains, poles, and nothing at all where the gains are
zero.
"""

import dataclasses

import numpy as np
import pytest

from plant import P, puma560, simulate
from plant.machine import smooth_rig
from plant.simulation import (
    Clock,
    ClosedLoop,
    Correction,
    Structure,
    loop_kernel,
    path_of,
    start_of,
    time_tables,
)

ARM, RIG, LAW = puma560.arm(), smooth_rig(puma560.rig()), puma560.p_law()
GAINS = Correction(position=(0.3, 0.2), speed=(0.05, 0.04), zero=(0, 0))


def corrected(correction, record):
    """Log and final state of the loop that follows a record."""
    loop = ClosedLoop(
        dynamics=ARM.dynamics, rig=RIG, law=LAW, steps_per_sample=4, correction=correction
    )
    kernel = loop_kernel(loop)
    counted = np.column_stack(
        [
            record.rig.encoder.position_in_pulses(record.rig.encoder.cell_centre(record.counts)),
            np.ones(len(record)),
        ]
    )
    tables = kernel.prepared(
        (*time_tables(loop, path_of(record, smooth=True), Clock.of(record)), counted), logged=True
    )
    log, errors = np.empty((len(record), 8)), np.empty((4 * len(record), 2))
    state = loop.initial_state(*start_of(record, path_of(record)))
    kernel.run(tables, state[:, None], np.empty((0, 1)), loop.number_values(ARM.f), (log, errors))
    return loop, log, counted


@pytest.fixture(scope="module")
def record():
    return simulate(ARM, puma560.rig(), LAW, puma560.reference(), duration=0.3)


def test_without_gains_the_loop_runs_free(record):
    free = simulate(ARM, RIG, LAW, puma560.reference(), duration=0.3)
    _, log, counted = corrected(Correction(position=(0, 0), speed=(0, 0), zero=(0, 0)), record)
    np.testing.assert_allclose(log[:, 4:6], free.true_q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        log[:, :2], counted[:, :2] - RIG.position_in_pulses(free.true_q), rtol=0, atol=1e-6
    )


def test_with_gains_it_stays_closer_to_the_log(record):
    rms = [
        np.sqrt(np.mean(corrected(Correction.with_memory(2, m), record)[1][:, :2] ** 2))
        for m in (10, 1e6)
    ]
    assert rms[0] < 0.36
    assert rms[1] > 1.2 * rms[0]


@pytest.mark.parametrize("memory", [1.0, 7.0, 100.0])
def test_its_poles_forget_over_the_memory(memory):
    made = Correction.with_memory(3, memory)
    share = np.array([made.position[1], made.speed[1]])
    filtered = np.array([[1.0, 1.0], [0.0, 1.0]]) @ (np.eye(2) - np.outer(share, (1.0, 0.0)))
    np.testing.assert_allclose(np.linalg.eigvals(filtered), np.exp(-1 / memory), atol=1e-7)


def test_a_sample_moves_position_and_speed_by_their_gains():
    loop = ClosedLoop(dynamics=ARM.dynamics, rig=RIG, law=LAW, steps_per_sample=4, correction=GAINS)
    q, qd, counted = np.array([0.3, -0.2]), np.array([1.0, 2.0]), np.array([5000.0, -3000.0])
    row = np.concatenate([q, 0 * q, 0 * q, RIG.position_in_pulses(q), [loop.h]])
    after, log = loop.sample(
        loop.initial_state(q, qd), row, loop.number_values(ARM.f), [*counted, 1.0]
    )
    after, log, innovation = (
        after.full().ravel(),
        log.full().ravel(),
        counted - RIG.position_in_pulses(q),
    )
    np.testing.assert_allclose(log[:2], innovation, rtol=1e-13)
    np.testing.assert_allclose(log[4:], [*q, *qd])  # the log has the prediction
    np.testing.assert_allclose(after[:2], q + RIG.to_angle((0.3, 0.2) * innovation), rtol=1e-13)
    np.testing.assert_allclose(
        after[2:4], qd + RIG.to_angle((0.05, 0.04) * innovation) / RIG.period, rtol=1e-13
    )
    all_in = dataclasses.replace(
        loop, correction=Correction(position=(1, 1), speed=(0, 0), zero=(0, 0))
    )
    after = (
        all_in.sample(loop.initial_state(q, qd), row, all_in.number_values(ARM.f), [*counted, 1.0])[
            0
        ]
        .full()
        .ravel()
    )
    np.testing.assert_allclose(RIG.position_in_pulses(after[:2]), counted, rtol=1e-12)


def test_a_sample_that_counts_nothing_changes_nothing_and_a_zero_moves_what_was_counted():
    zero = np.array([0.02, -0.03])
    made = dataclasses.replace(GAINS, zero=zero)
    loop = ClosedLoop(dynamics=ARM.dynamics, rig=RIG, law=LAW, steps_per_sample=4, correction=made)
    q, qd, counted = np.array([0.3, -0.2]), np.array([1.0, 2.0]), np.array([5000.0, -3000.0])
    row = np.concatenate([q, 0 * q, 0 * q, RIG.position_in_pulses(q), [loop.h]])
    numbers = loop.number_values(ARM.f)
    after, log = (
        x.full().ravel()
        for x in loop.sample(loop.initial_state(q, qd), row, numbers, [*counted, 0.0])
    )
    np.testing.assert_allclose(after[:4], [*q, *qd], rtol=1e-15)
    np.testing.assert_allclose(log[:2], counted - RIG.position_in_pulses(q - zero), rtol=1e-12)


def test_gains_are_numbers_of_the_loop_and_share_its_kernel():
    loops = [
        ClosedLoop(dynamics=ARM.dynamics, rig=RIG, law=LAW, steps_per_sample=4, correction=c)
        for c in (GAINS, Correction.with_memory(2, 5), None)
    ]
    own = [f"correction.{k}[{i}]" for k in ("position", "speed", "zero") for i in (0, 1)]
    assert loops[0].number_names[-6:] == own
    np.testing.assert_array_equal(loops[0].number_values(ARM.f)[-6:], (0.3, 0.2, 0.05, 0.04, 0, 0))
    assert Structure(loops[0]) == Structure(loops[1])
    assert Structure(loops[0]) != Structure(loops[2])


def test_counts_without_a_reference_stand_for_the_middle_of_their_cells(record):
    counted = dataclasses.replace(record, reference=None)
    motion, pulses = path_of(counted, smooth=True)(record.t)
    np.testing.assert_allclose(
        pulses, record.reference_pulses + 0.5 * np.sign(record.reference_pulses), atol=1e-9
    )
    np.testing.assert_allclose(RIG.position_in_pulses(motion.q), pulses, atol=1e-8)


def test_a_law_of_another_size_is_still_refused():
    with pytest.raises(ValueError, match="2 joints"):
        ClosedLoop(
            dynamics=ARM.dynamics, rig=RIG, law=P(gain=(1.0,)), steps_per_sample=4, correction=GAINS
        )

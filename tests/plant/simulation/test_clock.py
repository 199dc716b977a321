"""When a loop is sampled, and what drives it then: even and uneven time stamps, and gaps."""

import dataclasses
import importlib
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import PID, P, Record, puma560
from plant.simulation import Clock, ClosedLoop, Path, in_blocks, time_tables

RIG = puma560.rig()
GAINS = {"gain": (0.1, 0.075), "integral": (0.5, 0.4), "derivative": (4e-4, 3e-4), "filter": 2000.0}


def record(t, rig=RIG):
    return Record(t=t, error_pulses=np.zeros((len(t), 2)), rig=rig, law=P(gain=(0.1, 0.1)))


def test_time_stamps_next_to_the_period_are_even():
    t = np.arange(50) * RIG.period
    clock = Clock.of(record(3.0 + t + 1e-3 * RIG.period * np.sin(t * 1e4)))
    assert clock.even == RIG.period
    np.testing.assert_array_equal(clock.t, t)
    places = np.arange(200)
    np.testing.assert_array_equal(clock.starts(4, places), places * (RIG.period / 4))
    np.testing.assert_array_equal(
        clock.starts(4, places[::8], 8), np.arange(25) * (RIG.period / 4 * 8)
    )


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.floats(0.92, 1.08), min_size=5, max_size=30),
    st.integers(1, 5),
    st.floats(1.0, 20.0),
)
def test_steps_fill_the_time_between_the_samples(parts, steps, gap):
    """Each sub-step begins where the last one ended, samples keep their own times, no interval
    exceeds 1.5 periods.
    """
    lengths = np.array([0.5, *parts, gap, *parts]) * RIG.period
    t = np.append(0, np.cumsum(lengths))
    clock = Clock.of(record(t))
    assert clock.even is None
    np.testing.assert_allclose(clock.t[clock.rows], t, atol=1e-15)
    assert clock.lengths.max() <= 1.5 * RIG.period * (1 + 1e-9)
    assert len(clock) - len(t) == np.ceil(lengths / (1.5 * RIG.period) - 1e-9).sum() - len(lengths)
    places = np.arange(len(clock) * steps)
    starts, h = clock.starts(steps, places), clock.step_lengths(steps, places)
    np.testing.assert_allclose(starts[1:], (starts + h)[:-1], atol=1e-15)
    np.testing.assert_allclose(clock.middles(steps, places), starts + h / 2, atol=1e-15)
    np.testing.assert_allclose(starts[::steps], clock.t, atol=1e-15)
    np.testing.assert_allclose(starts[-1] + h[-1], t[-1] + RIG.period)


def test_what_was_logged_goes_straight_across_a_gap_and_nothing_is_measured_in_it():
    t = np.array([0.0, 1.0, 4.2, 5.2, 6.2, 7.2, 8.2]) * RIG.period
    clock = Clock.of(record(t))
    np.testing.assert_array_equal(clock.rows, [0, 1, 4, 5, 6, 7, 8])
    values = np.arange(7.0)[:, None] + 1
    np.testing.assert_allclose(
        clock.bridged(values)[:, 0], [1, 2, 2 + 1 / 3, 2 + 2 / 3, 3, 4, 5, 6, 7]
    )
    np.testing.assert_array_equal(clock.measured(values)[:, 0], [1, 2, 0, 0, 3, 4, 5, 6, 7])


def test_stamps_that_have_nothing_to_do_with_the_period_are_refused():
    slower = dataclasses.replace(RIG, period=1e-3)
    with pytest.raises(
        ValueError,
        match=r"t must advance by the rig's period 0\.001 s, or nearly; sample 1 is -0\.0003",
    ):
        Clock.of(record(np.arange(9) * RIG.period, slower))


def test_the_usual_interval_is_one_of_the_log():
    """The period for which the last sample is held is none of them."""
    for t, usual in (([0, 1.15], "0.000805"), ([0, 1.06, 2.22], "0.000777")):
        with pytest.raises(ValueError, match=f"the usual interval is {usual} s"):
            Clock.of(record(np.array(t) * RIG.period))


@pytest.mark.parametrize("gap", [1e9, 1e300])
def test_a_gap_that_no_memory_holds_is_refused(gap):
    t = np.append(np.arange(3) * RIG.period, gap)
    with pytest.raises(ValueError, match=rf"{re.escape(f'{gap:.6g}')} s pass after sample 2\."):
        Clock.of(record(t))


@pytest.mark.parametrize("place", [1, 2, 4])
def test_the_shortest_interval_has_one_part(place):
    t = np.insert(np.arange(5) * RIG.period, place, (place - 1) * RIG.period + 1e-13)
    clock = Clock.of(record(t))
    np.testing.assert_array_equal(clock.rows, np.arange(6))
    np.testing.assert_array_equal(clock.t, t)
    np.testing.assert_allclose(clock.lengths, np.append(np.diff(t), RIG.period), rtol=1e-15)


@pytest.mark.parametrize("period", [None, 2e-3])
def test_tables_in_blocks_are_those_of_the_whole(period, monkeypatch):
    """Each block begins with a step of the law; chosen columns are those of the whole table.

    A long log's whole is put together of blocks.
    """
    rig = puma560.rig()
    law = P(gain=(0.1, 0.1)) if period is None else PID(**GAINS, period=3 * rig.period)
    loop = ClosedLoop(dynamics=puma560.dynamics(), rig=rig, law=law, steps_per_sample=4)
    path, clock = Path(puma560.reference(), rig), Clock.regular(100, rig.period)
    whole, blocks = time_tables(loop, path, clock), list(in_blocks(loop, path, clock, samples=17))
    for i, table in enumerate(whole):
        np.testing.assert_array_equal(np.vstack([block[i] for block in blocks]), table)
    assert len(blocks) > 5
    every = loop.steps_per_law or 1
    assert all(4 * len(block[1]) % every == 0 for block in blocks[:-1])
    some = time_tables(loop, path, clock, columns=[[0], [1, 2], [6]])
    np.testing.assert_array_equal(some[1], whole[1][:, [1, 2, -1]])
    np.testing.assert_array_equal(some[2], whole[2][:, [6, -1]])
    monkeypatch.setattr(importlib.import_module("plant.simulation.time_tables"), "_ROWS", 4 * 17)
    for joined, table in zip(time_tables(loop, path, clock), whole, strict=True):
        np.testing.assert_array_equal(joined, table)

"""Gears between two encoders on three of six joints of a heavy arm: f known, uncertain, unknown;
truth by pinocchio.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from heavy_arm import DAMPING, RIG, SEEN, STIFFNESS, arm_of, bodies, other, run

from identification import find_gears, identify
from identification.equation_error import Deflections, fit_wound
from plant import Elasticity, LoggedTorque, Record, puma560, simulate

ARM = arm_of(bodies())


@cache
def logs(drift=0.0, spread=0.0, runs=2):
    random = np.random.default_rng(5)
    some = other(bodies(), spread, random) if spread else bodies()
    return [
        run(some, STIFFNESS * (1 + drift * (-1) ** i), DAMPING, random, noise=0.01)
        for i in range(runs)
    ]


@cache
def found_gears():
    return find_gears(ARM, logs())


def without(record, **fields):
    return dataclasses.replace(record, **fields)


def turned():
    short = logs()[0].cut(0.0, 3.0)
    return without(short, link_counts=2 * short.counts - short.link_counts)


def holds(low, high, truth):
    return ((low <= truth) & (truth <= high))[SEEN].all()


def test_stiffness_and_damping_of_the_joints_that_have_two_encoders_run_by_run_and_together():
    """The others wind up, too, unstated; zeros of the link encoders are 0.01 rad off."""
    found = found_gears()
    assert len(found.runs) == 2
    for each in (found, *found.runs):
        np.testing.assert_allclose(each.stiffness[SEEN], STIFFNESS[SEEN], rtol=0.005)
        np.testing.assert_allclose(each.damping[SEEN], DAMPING[SEEN], rtol=0.25)
        assert holds(each.low, each.high, STIFFNESS)
        assert holds(each.damping_low, each.damping_high, DAMPING)
        assert (each.high / each.low)[SEEN].max() < 1.02
        for values in (each.stiffness, each.low, each.high, each.damping):
            assert np.isnan(values[~SEEN]).all()
    assert "stiffness of 3 of 6 gears" in str(found)
    assert "intervals agree between runs" in str(found)
    single = find_gears(ARM, logs()[0])
    assert single.between is None
    np.testing.assert_array_equal(single.runs[0].high, single.high)


def test_gears_that_the_rig_states_are_no_part_of_the_error():
    """Of the wrist's gears: what they wind up by is off the motors' counts."""
    gears = Elasticity(stiffness=STIFFNESS * np.where(SEEN, 3.0, 1.0), damping=DAMPING)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    found, rigid = find_gears(ARM, [without(each, rig=rig) for each in logs()]), found_gears()
    off, beside = (np.abs(each.stiffness / STIFFNESS - 1)[SEEN] for each in (found, rigid))
    assert off.max() < 5e-4 < beside.max()
    np.testing.assert_array_equal(found.elasticity.stiffness[~SEEN], STIFFNESS[~SEEN])
    np.testing.assert_array_equal(found.elasticity.stiffness[SEEN], found.stiffness[SEEN])
    with pytest.raises(
        ValueError, match=r"every gear must be known; that of .*4.* is not. State it"
    ):
        _ = rigid.elasticity


@pytest.mark.slow
def test_the_spread_of_a_data_sheet_is_in_the_interval():
    """A common scale of f is one of stiffness: of 5 %, half of the interval is 1.96 times that."""
    records = [Deflections.of(record, 4.0) for record in logs()]
    inner = fit_wound(ARM.dynamics, records, ARM.f)[0]
    links = (
        ARM.f
        - arm_of([dataclasses.replace(body, mass=0.0, inertia=(0,) * 6) for body in bodies()]).f
    )
    whole = fit_wound(ARM.dynamics, records, ARM.f, 0.05**2 * np.outer(links, links))[0]
    added = np.sqrt(whole.half[0] ** 2 - inner.half[0] ** 2) / whole.values[0]
    np.testing.assert_allclose(added[SEEN], 1.96 * 0.05, rtol=0.01)

    doubtful = logs(spread=0.05)
    found, exact = (find_gears(ARM.dynamics, doubtful, prior=0.05), find_gears(ARM, doubtful))
    assert holds(found.low, found.high, STIFFNESS)
    assert not holds(exact.low, exact.high, STIFFNESS)
    np.testing.assert_allclose(found.stiffness[SEEN], STIFFNESS[SEEN], rtol=0.1)


def test_f_that_is_unknown_is_found_from_the_torques():
    found = find_gears(ARM.dynamics, logs())
    np.testing.assert_allclose(found.stiffness[SEEN], STIFFNESS[SEEN], rtol=0.01)
    assert holds(found.low, found.high, STIFFNESS)


def test_runs_that_differ_widen_the_interval_and_are_told():
    found, alike = find_gears(ARM, logs(drift=0.05)), found_gears()
    assert holds(found.low, found.high, STIFFNESS)
    assert ((found.high - found.low) > 5 * (alike.high - alike.low))[SEEN].all()
    assert not found.between.agree[:3].any()
    np.testing.assert_allclose(
        found.runs[0].stiffness[SEEN] / found.runs[1].stiffness[SEEN], 1.05 / 0.95, rtol=0.01
    )


@pytest.mark.parametrize("off", [1e4, 1e7])
def test_counts_without_weight_move_no_gear(off):
    """Three tenths of a second of any counts: too long a gap for `bridged`."""
    record = logs()[0]
    valid = np.where((record.t > 2.0) & (record.t < 2.3), 0.0, 1.0)
    spoilt = record.link_counts + off * (valid == 0)[:, None]
    found, kept = (
        find_gears(ARM, without(record, valid=valid, link_counts=counts))
        for counts in (spoilt, record.link_counts)
    )
    np.testing.assert_array_equal(found.stiffness, kept.stiffness)
    np.testing.assert_allclose(found.stiffness[SEEN], STIFFNESS[SEEN], rtol=0.005)


def test_a_log_without_any_weight_is_refused_for_what_it_lacks():
    with pytest.raises(ValueError, match="needs more equations"):
        find_gears(ARM, without(logs()[0], valid=np.zeros(len(logs()[0]))))


def test_a_log_at_rest_tells_nothing_and_takes_nothing_from_the_others():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    gears = Elasticity.from_resonance(arm, 25, 0.02, drive=rig.drive)
    rig = dataclasses.replace(
        rig,
        drive=dataclasses.replace(rig.drive, elasticity=gears),
        encoder=dataclasses.replace(rig.encoder, side=("both", "motor")),
    )
    moving = simulate(arm, rig, puma560.p_law((0.1, 0.08)), puma560.reference())
    first = np.zeros(len(moving), int)
    q, rest = rig.cell_centre(moving.counts[0]), np.zeros(2)
    still = Record(
        t=moving.t,
        error_pulses=-moving.counts[first],
        link_counts=moving.link_counts[first],
        torque=np.tile(arm.inverse(q, rest, rest), (len(moving), 1)),
        rig=rig,
        law=LoggedTorque(),
    )
    found = find_gears(arm, [moving, still], band=10.0)
    alone = find_gears(arm, moving, band=10.0)
    np.testing.assert_allclose(found.stiffness[0], alone.stiffness[0], rtol=1e-6)
    assert np.isnan(found.runs[1].stiffness).all()
    assert np.isnan(found.runs[1].high).all()


@pytest.mark.parametrize(
    ("arm", "records", "options", "text"),
    [
        (ARM, list, {}, "records must be at least one Record; got none"),
        (ARM, lambda: without(logs()[0], link_counts=None), {}, "the record must hold link_counts; it has none"),
        (ARM, lambda: [logs()[0], without(logs()[1], link_counts=logs()[1].counts)], {}, r"records\[1\]: link_counts"),
        (ARM, turned, {}, "must give way to its torque"),
        (ARM, lambda: logs()[0], {"band": 0}, "band must be a positive number"),
        (ARM, lambda: logs()[0], {"unknown": ARM.dynamics.names}, "unknown must be left out where f is known"),
        (ARM.dynamics, lambda: logs()[0], {"prior": ([1.0, 2.0], 0.05)}, r"f of the prior must have shape \(\d+,\)"),
        (ARM.f, lambda: logs()[0], {}, "arm must be of type Arm; .* Pass an arm, an identification"),
        (puma560.arm(), lambda: logs()[0], {}, "rig must have 2 joints like the arm; got 6"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(arm, records, options, text):
    with pytest.raises(ValueError, match=text) as caught:
        find_gears(arm, records(), **options)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_an_arm_that_does_not_give_the_logged_torques_is_told():
    heavier = ARM.dynamics.arm(1.6 * ARM.f)
    with pytest.warns(UserWarning, match=r"f and friction leave [3-7]\d% of the logged torques"):
        found = find_gears(heavier, [each.cut(0.0, 3.0) for each in logs()])
    assert (found.stiffness[SEEN] > 1.3 * STIFFNESS[SEEN]).all()


def test_an_identification_brings_its_covariance():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    gears = Elasticity.from_resonance(arm, 25, 0.02, drive=rig.drive)
    encoder = dataclasses.replace(rig.encoder, side=("both", "motor"))
    elastic = dataclasses.replace(
        rig, drive=dataclasses.replace(rig.drive, elasticity=gears), encoder=encoder
    )
    law, path = puma560.p_law((0.1, 0.08)), puma560.reference()
    record = simulate(arm, elastic, law, path, steps_per_sample=8)
    rigid = identify(
        arm.dynamics, simulate(arm, rig, law, path), method="prediction_error", progress=False
    )
    found, exact = find_gears(rigid, record), find_gears(rigid.arm, record)
    assert found.stiffness[0] == pytest.approx(gears.stiffness[0], rel=0.02)
    assert found.low[0] < gears.stiffness[0] < found.high[0]
    assert found.high[0] - found.low[0] > exact.high[0] - exact.low[0]
    with pytest.raises(ValueError, match="prior must be left out beside an identification"):
        find_gears(rigid, record, prior=0.05)

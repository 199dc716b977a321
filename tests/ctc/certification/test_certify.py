"""Probability of exceeding a pulse limit: what is sampled, how its loops run, and what is said
about them.

Short runs of (6), of 0.05 s, with f uncertain by 2 %: computed torque of 62 rad/s, slower than any
default, exceeds ±1 pulse in about 10 of 100 loops, which makes them a case for counting.
"""

import contextlib
import dataclasses
import itertools
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import beta, binom
from uncertain import with_uncertainty

import ctc.certification.reserves
from ctc import ComputedTorque, Uncertainty, certify, evaluate
from ctc.certification import cells, clopper_pearson, draw, influences, percent
from identification import identify
from plant import (
    PD,
    Body,
    Chain,
    Drive,
    Dynamics,
    Elasticity,
    Encoder,
    FrictionCurve,
    Harmonics,
    Link,
    P,
    Phase,
    PointToPoint,
    Presliding,
    Rig,
    SteppedArm,
    Transport,
    puma560,
    simulate,
)
from plant.machine import least_inertia_margin
from plant.simulation import LANES, population

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
DYNAMICS, LAW = ARM.dynamics, ComputedTorque(puma560.arm(), puma560.rig(), bandwidth=62)
COVARIANCE = np.diag((0.02 * puma560.PUBLISHED) ** 2)
EVERYTHING = {
    "load": (0.0, 0.5), "load_position": (0.0, -0.55, 0.0), "delay": (0.0, 3e-4), "dropped": 0.02,
}  # fmt: skip


def certified(**options):
    arguments = ARM, options.pop("rig", RIG), options.pop("law", LAW), options.pop("path", PATH)
    usual = {"covariance": COVARIANCE, "duration": 0.05, "samples": 200, "steps_per_sample": 4}
    return certify(*arguments, **with_uncertainty(**usual | options))


@pytest.fixture(scope="module")
def found():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=1.0)
    return identify(DYNAMICS, record, seed=1, progress=False)


# -- each loop is the one that simulate runs -----------------------------------------------------
@pytest.mark.parametrize("options", [{}, EVERYTHING], ids=["default", "everything"])
def test_each_lane_is_a_simulation(options):
    certificate = certified(samples=90, duration=0.2, **options)
    limit = RIG.drive.current_limit
    for i in (0, 1, LANES - 1, LANES, 89):
        plant, runs = certificate.plant(i), certificate.runs
        record = simulate(plant.arm, plant.rig, LAW, PATH, duration=0.2)
        error = np.abs(record.error_pulses)
        np.testing.assert_array_equal(runs.peak[i], error.max(axis=0))
        assert runs.outside[i] == (error > 1).any(axis=1).sum()
        np.testing.assert_array_equal(runs.current[i], np.abs(record.current).max(axis=0))
        np.testing.assert_allclose(
            runs.chatter[i], np.abs(np.diff(record.torque, axis=0)).mean(axis=0), rtol=1e-9
        )
        assert (runs.current[i] <= limit * (1 + 1e-12)).all()
        shift = plant.rig.encoder.phase.shift
        unrounded = (
            RIG.position_in_pulses(PATH(record.t).q) - RIG.position_in_pulses(record.true_q) - shift
        )
        np.testing.assert_allclose(runs.unrounded[i], np.abs(unrounded).max(axis=0), atol=1e-8)
        left = np.flatnonzero((error > 1).any(axis=1))
        np.testing.assert_allclose(
            runs.first[i], record.t[left[0]] if len(left) else np.nan, atol=1e-12
        )
        if options:
            assert runs.lost[i] == len(plant.rig.transport.lost)
    assert certificate.runs.samples == len(record)
    if options:
        assert 0.01 < certificate.runs.lost.mean() / len(record) < 0.03
        assert (certificate.runs.outside > 0).any()


def test_the_worst_runs_again():
    certificate = certified(steps_per_sample=16)
    worst = certificate.worst
    again = evaluate(worst.arm, worst.rig, LAW, PATH, duration=0.05)
    assert again.max_error_pulses.max() == worst.peak == certificate.runs.peak.max() == 2
    peak, unrounded = certificate.runs.peak.max(axis=1), certificate.runs.unrounded.max(axis=1)
    assert unrounded[worst.index] == unrounded[peak == 2].max()
    runs = dataclasses.replace(
        certificate.runs, unrounded=np.where(peak < 2, 9, unrounded)[:, None]
    )
    # what is counted comes first
    assert dataclasses.replace(certificate, runs=runs).worst.index == worst.index


@pytest.mark.slow
def test_what_rounding_adds_is_the_error_of_samples_that_do_not_differ():
    same = certified(
        covariance=1e-24 * COVARIANCE, friction=0.0, phase=False, samples=2, duration=0.3
    )
    # between the samples, too
    assert same.by_counts == pytest.approx(same.runs.unrounded[0], rel=0.01)
    assert 0.1 < same.by_counts.max() < 1.0
    assert "by rounding alone, f exact, peak [pulses]" in str(same)
    wrong = certified(covariance=COVARIANCE, friction=0.0, samples=2, duration=0.3)
    assert wrong.by_counts == pytest.approx(same.by_counts)
    assert (wrong.runs.unrounded.max(axis=0) > same.by_counts).any()


def test_one_bound_is_said_and_no_part_larger_than_its_whole():
    text = " ".join(str(certified(friction=0.0, samples=40, duration=0.3)).split())
    assert "of it" not in text
    assert text.count("95 %") == 1


def test_a_loop_that_diverges_leaves_and_is_the_worst():
    law = PD(gain=(5, 5), derivative=(0.05, 0.05), filter=3000.0, period=RIG.period)
    drive = dataclasses.replace(RIG.drive, current_limit=(np.inf, np.inf))
    certificate = certified(
        law=law, rig=dataclasses.replace(RIG, drive=drive), samples=50, duration=0.4
    )
    assert certificate.probability == 1 == certificate.share_outside
    assert np.isinf(certificate.worst.peak)
    assert "diverges" in str(certificate)
    assert (certificate.saturation == 0).all()


def test_samples_before_do_not_count():
    law = dataclasses.replace(LAW, bandwidth=70)
    every, later = certified(law=law), certified(law=law, after=0.03)
    assert every.failures > 0 == later.failures
    assert later.runs.samples == 72 - 43  # t = 0.0301 s is the first that counts
    assert np.isnan(later.runs.first).all()
    assert every.failures_before == 0
    outside, looked_at = [], np.union1d(np.arange(40), np.flatnonzero(later.runs.before))
    for i in looked_at:
        worst = every.plant(i)
        record = evaluate(
            worst.arm, worst.rig, law, PATH, duration=0.05, steps_per_sample=4, backend="numba"
        ).record
        outside.append((np.abs(record.error_pulses[record.t < 0.03 - 1e-9]) > 1).any(axis=1).sum())
    np.testing.assert_array_equal(later.runs.before[looked_at], outside)
    assert later.failures_before == every.failures
    assert later.failures_with_start == every.failures
    share = percent(every.failures / 200)
    assert (
        f"In the first 0.03 s, which do not count, {share} exceed it; then or later, {share}."
        in later.verdict
    )
    assert f"samples that exceed it at any time {every.failures} of 200" in " ".join(
        str(later).split()
    )


# -- what is counted -----------------------------------------------------------------------------
def test_a_probability_known_beforehand():
    """A limp arm without weight, 0.7 pulses up: it counts one pulse where its encoder's zero
    lies 0.3 or more down.
    """
    still = DYNAMICS.arm([1.6, 1.4, 0, 0, 0, 0, 6.6, 0, 0])
    rest = Harmonics(
        period=1.0,
        offset=RIG.to_angle(np.array([0.7, 0.7])),
        cosine=((0,), (0,)),
        sine=((0,), (0,)),
    )
    certificate = certify(
        still,
        RIG,
        P(gain=(0, 0)),
        rest,
        Uncertainty(covariance=np.zeros((9, 9))),
        duration=0.01,
        samples=4000,
        within=0,
        steps_per_sample=4,
    )
    known = 1 - 0.8**2  # of two joints
    low, high = clopper_pearson(certificate.failures, 4000, 0.9999)
    assert low < known < high
    shifts = certificate.plants.values[
        :, [n.startswith("encoder") for n in certificate.plants.names]
    ]
    assert certificate.failures == (shifts >= 0.3).any(axis=1).sum()


@pytest.mark.slow
def test_brute_force_agrees_on_a_case_that_fails_one_time_in_ten():
    """Drawn by hand, with another seed, one `simulate` at a time."""
    certificate = certified(samples=4000)
    random, count, failures = np.random.default_rng(77), 150, 0
    for _ in range(count):
        f = random.multivariate_normal(puma560.PUBLISHED, COVARIANCE)
        factor = 1 + 0.1 * random.normal(size=(2, 2))
        drive = dataclasses.replace(
            RIG.drive, viscous=RIG.drive.viscous * factor[0], coulomb=RIG.drive.coulomb * factor[1]
        )
        encoder = dataclasses.replace(RIG.encoder, phase=Phase(shift=random.uniform(-0.5, 0.5, 2)))
        rig = dataclasses.replace(RIG, drive=drive, encoder=encoder)
        record = simulate(DYNAMICS.arm(f), rig, LAW, PATH, duration=0.05)
        failures += np.abs(record.error_pulses).max() > 1
    low, high = clopper_pearson(failures, count, 0.999)  # one seed in a thousand would fail
    assert 0.05 < certificate.probability < 0.15
    assert low < certificate.probability < high


def test_lost_counts_of_loops_side_by_side_are_independent():
    plants = draw(Uncertainty(covariance=COVARIANCE, dropped=0.1), ARM, RIG, 80, 0)
    lost = np.hstack([plants.lost(block, LANES, 2000) for block in range(2)])
    assert not lost[0].any()
    np.testing.assert_allclose(lost.mean(axis=0), 0.1, atol=5 * np.sqrt(0.09 / 2000))
    pairs = np.corrcoef(lost[1:].T) - np.eye(80)
    assert np.abs(pairs).max() < 6 / np.sqrt(2000)
    assert plants.plant(41, LANES, 2000)[1].transport.lost == tuple(np.flatnonzero(lost[:, 41]))


# -- seeds and threads ---------------------------------------------------------------------------
def test_the_same_bits_for_any_number_of_threads_and_the_same_seed():
    one, two, other = (
        certified(threads=threads, seed=seed, **EVERYTHING)
        for threads, seed in ((1, 3), (3, 3), (1, 4))
    )
    for name in ("peak", "unrounded", "outside", "current", "first", "lost"):
        np.testing.assert_array_equal(getattr(one.runs, name), getattr(two.runs, name))
    np.testing.assert_array_equal(one.plants.values, two.plants.values)
    assert not np.array_equal(one.runs.unrounded, other.runs.unrounded)


# -- what is drawn -------------------------------------------------------------------------------
@pytest.mark.parametrize("wanted", [True, False])
def test_a_bar_counts_the_loops_where_it_is_wanted(monkeypatch, wanted):
    asked, counted = [], []

    @contextlib.contextmanager
    def bar(*given):
        asked.append(given)
        yield SimpleNamespace(update=counted.append)

    monkeypatch.setattr(population, "progress_bar", bar)
    certified(samples=50, threads=1, progress=wanted)
    assert asked == [(50, "closed loops", "loop", wanted)]
    assert sorted(counted) == [10, 40]


def test_draws_have_the_covariance_that_was_given():
    mixed = np.random.default_rng(0).normal(size=(9, 9)) * 0.01
    mixed[:, 8] = 0  # one direction in which nothing is uncertain
    plants = draw(
        Uncertainty(covariance=mixed @ mixed.T, phase=False, friction=0.0), ARM, RIG, 20_000, 0
    )
    assert plants.names == DYNAMICS.names
    assert plants.redrawn == 0
    np.testing.assert_allclose(plants.f.mean(axis=0), ARM.f, atol=6 * 0.03 / np.sqrt(20_000))
    scale = np.abs(mixed @ mixed.T).max()
    np.testing.assert_allclose(
        np.cov(plants.f.T), mixed @ mixed.T, atol=6 * scale * np.sqrt(2 / 20_000)
    )
    # roots of 0
    np.testing.assert_allclose((plants.f - ARM.f) @ np.linalg.svd(mixed)[0][:, 8], 0, atol=1e-8)


def test_what_was_identified_is_drawn_from_its_own_covariance(found):
    plants = draw(Uncertainty(), found, RIG, 3000, 0)
    own = plants.values[:, [plants.names.index(name) for name in found.fit.unknown]]
    np.testing.assert_allclose(own.std(axis=0) / found.fit.std, 1, atol=6 / np.sqrt(2 * 3000))
    friction = plants.values[:, plants.names.index("drive.coulomb[1]")] / RIG.drive.coulomb[1]
    assert abs(friction.std() - 0.1) < 6 * 0.1 / np.sqrt(2 * 3000)
    more = dataclasses.replace(
        found.fit, unknown=(*found.fit.unknown, "drive.coulomb[1]", "law.gain[0]"),
        values=np.append(found.fit.values, (0.2, 9.0)),
        covariance=np.pad(found.covariance, (0, 2)) + np.diag([0.0] * 9 + [0.01**2, 1.0]),
    )  # fmt: skip
    plants = draw(Uncertainty(), dataclasses.replace(found, fit=more), RIG, 3000, 0)
    level = plants.values[:, plants.names.index("drive.coulomb[1]")]
    assert abs(level.mean() - 0.2) < 6 * 0.01 / np.sqrt(3000)
    assert abs(level.std() - 0.01) < 6 * 0.01 / np.sqrt(2 * 3000)
    assert "law.gain[0]" not in plants.names


def test_gears_that_were_identified_are_drawn_and_none_has_negative_damping(found):
    """A log says little of damping: half of its value is one standard deviation."""
    gears = Elasticity.from_resonance(ARM, 60, 0.015, drive=RIG.drive)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    names = [f"drive.elasticity.{name}[{i}]" for name in ("stiffness", "damping") for i in range(2)]
    values = np.concatenate([gears.stiffness, gears.damping])
    spread = values * (0.05, 0.05, 0.5, 0.5)
    more = dataclasses.replace(
        found.fit, unknown=(*found.fit.unknown, *names), values=np.append(found.fit.values, values),
        covariance=np.pad(found.covariance, (0, 4)) + np.diag([0.0] * 9 + [*spread**2]),
    )  # fmt: skip
    plants = draw(Uncertainty(), dataclasses.replace(found, fit=more), rig, 500, 0)
    drawn = plants.values[:, [plants.names.index(name) for name in names]]
    assert (drawn >= 0).all()
    assert plants.redrawn > 10
    assert drawn[:, 0].std() / values[0] == pytest.approx(0.05, rel=0.2)


def test_draws_that_can_be_no_arm_are_drawn_again():
    wide = np.diag((0.5 * puma560.PUBLISHED) ** 2)
    plants = draw(Uncertainty(covariance=wide, friction=0.6), ARM, RIG, 500, 0)
    assert plants.redrawn > 100
    assert (least_inertia_margin(DYNAMICS, RIG, plants.f) >= 0).all()
    friction = [name.startswith("drive.") for name in plants.names]
    assert sum(friction) == 4
    assert (plants.values[:, friction] >= 0).all()


def test_draws_of_which_hardly_one_is_an_arm_are_moved_until_they_are():
    """Towards the arm that was identified, on a straight line; the share is printed."""
    wide = np.zeros((9, 9))
    wide[3, 3] = 100.0**2  # f4 couples the joints: D is indefinite on either side
    certificate = certified(covariance=wide, samples=20)
    plants = certificate.plants
    assert plants.projected > 0
    assert (least_inertia_margin(DYNAMICS, RIG, plants.f) >= 0).all()
    assert len(np.unique(plants.f, axis=0)) == 20
    said = " ".join(str(certificate).split())
    assert (
        f"{percent(plants.projected / 20)} of the samples were moved towards the identified arm"
        in said
    )


def test_the_first_plants_have_the_counts_of_their_own_draws():
    """A certificate from a hold, of 8 of 40 plants, said that 362 % of them were moved."""
    wide = np.zeros((9, 9))
    wide[3, 3] = 100.0**2
    plants = draw(Uncertainty(covariance=wide, friction=0.0), ARM, RIG, 40, 0)
    assert plants.redraws.sum() == plants.redrawn
    assert plants.moved.sum() == plants.projected > 8
    first = plants.first(np.int64(8))
    assert len(first) == 8
    assert first.redrawn == plants.redraws[:8].sum() < plants.redrawn
    assert first.projected == plants.moved[:8].sum() <= 8
    # Plants that are moved were rejected in every round.
    assert (plants.redraws[plants.moved] == plants.redraws.max()).all()
    assert (plants.redraws[~plants.moved] < plants.redraws.max()).all()
    # A file of an earlier version has the counts of all of them alone.
    earlier = dataclasses.replace(plants, redraws=None, moved=None)
    assert earlier == plants
    assert earlier.first(8).redrawn == plants.redrawn


def test_a_load_is_a_body_in_the_hand():
    position = (0.1, -0.5, 0.0)
    plants = draw(
        Uncertainty(covariance=COVARIANCE, load=(0.2, 0.4), load_position=position), ARM, RIG, 50, 0
    )
    nothing = Body(mass=0.0, com=(0, 0, 0))
    for f, values in zip(plants.f, plants.values, strict=True):
        mass = values[plants.names.index("load")]
        assert 0.2 <= mass <= 0.4
        added = DYNAMICS.f([nothing, Body(mass=mass, com=position)])
        np.testing.assert_allclose(f, values[:9] + added, atol=1e-12)
    fixed = draw(
        Uncertainty(covariance=COVARIANCE, load=0.3, load_position=position), ARM, RIG, 50, 0
    )
    assert "load" not in fixed.names
    np.testing.assert_allclose(
        fixed.f - fixed.values[:, :9], np.tile(added / mass * 0.3, (50, 1)), atol=1e-12
    )


def test_given_arms_are_taken_in_turn():
    arms = puma560.PUBLISHED * (1 + 0.01 * np.arange(3))[:, None]
    certificate = certified(covariance=None, plants=arms, samples=7)
    np.testing.assert_array_equal(certificate.plants.f, arms[[0, 1, 2, 0, 1, 2, 0]])


def test_other_imperfections_are_left_as_the_rig_has_them():
    rig = dataclasses.replace(RIG, transport=Transport(delay=1e-4))
    plants = draw(Uncertainty(covariance=COVARIANCE, phase=False), ARM, rig, 5, 0)
    assert plants.rig == rig
    assert plants.plant(3, LANES, 10)[1].transport == rig.transport


@pytest.mark.parametrize(
    ("stated", "delay"),
    [({"dropped": 0.02}, {1e-4}), ({"delay": 2e-4}, {2e-4}), ({"phase": False}, {1e-4})],
)
def test_a_delay_of_the_rig_stays_until_another_is_stated(stated, delay):
    """Stated losses of counts once took the rig's own delay away."""
    rig = dataclasses.replace(RIG, transport=Transport(delay=1e-4, lost=(3,)))
    plants = draw(Uncertainty(covariance=COVARIANCE, **stated), ARM, rig, 5, 0)
    assert {plants.plant(i, LANES, 10)[1].transport.delay for i in range(5)} == delay
    assert plants.rig.transport.lost == (3,)
    assert ("delay (as the rig has it)" in plants.said[1]) == ("delay" not in stated)


def test_backlash_of_the_rig_stays_on_gears_of_a_stated_resonance():
    gears = Elasticity.from_resonance(ARM, 60, 0.02, drive=RIG.drive, backlash=1e-4)
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))
    stated = {"covariance": COVARIANCE, "resonance": (40, 80)}
    plants = draw(Uncertainty(**stated), ARM, rig, 5, 0)
    assert (plants.plant(3, LANES, 10)[1].drive.elasticity.backlash == 1e-4).all()
    other = draw(Uncertainty(**stated, backlash=2e-4), ARM, rig, 5, 0)
    assert (other.plant(3, LANES, 10)[1].drive.elasticity.backlash == 2e-4).all()


def test_a_single_sample_differs_from_the_nominal_plant():
    """Numbers of one sample do not vary among the samples, and once were those of the rig."""
    stated = Uncertainty(covariance=COVARIANCE, resonance=(60, 400), **EVERYTHING)
    one, two = (draw(stated, ARM, RIG, count, 0) for count in (1, 2))
    assert one.names == two.names
    rig = one.plant(0, LANES, 10)[1]
    assert (rig.drive.coulomb != RIG.drive.coulomb).all()
    assert all(rig.encoder.phase.shift)
    hz = one.values[0, one.names.index("resonance")]
    (cell,) = (x for x in cells(stated, one.names, one.values, np.ones(1, bool)) if x.count)
    assert cell.hz[0] <= hz <= cell.hz[1]


@pytest.mark.parametrize(
    ("viscous", "friction", "sampled"),
    [((0, 0), 0.1, False), ((0, 0.001), 0.1, True), ((0, 0.001), 0.0, False)],
)
def test_friction_of_zero_is_not_said_to_be_sampled(viscous, friction, sampled):
    drive = dataclasses.replace(RIG.drive, viscous=viscous, coulomb=(0, 0))
    rig = dataclasses.replace(RIG, drive=drive)
    plants = draw(Uncertainty(covariance=COVARIANCE, friction=friction), ARM, rig, 5, 0)
    assert ("drive.viscous[1]" in plants.names) == sampled
    assert ("friction" in plants.said[1]) == (not sampled)
    assert ("friction ±10 % (standard deviation)" in plants.said[0]) == sampled


def beside(found, names, values, spreads):
    """The identification as if it had found these numbers of the rig besides."""
    covariance = np.pad(found.covariance, (0, len(names)))
    covariance[-len(names) :, -len(names) :] = np.diag(np.square(spreads))
    fit = dataclasses.replace(
        found.fit,
        unknown=(*found.fit.unknown, *names),
        values=np.append(found.fit.values, values),
        covariance=covariance,
    )
    return dataclasses.replace(found, fit=fit)


def test_given_arms_have_the_rig_that_was_identified(found):
    more = beside(found, ("drive.coulomb[1]", "law.gain[0]"), (0.3, 9.0), (0.01, 1.0))
    plants = draw(Uncertainty(plants=[ARM.f], friction=0.0), more, RIG, 5, 0)
    np.testing.assert_array_equal(plants.rig.drive.coulomb, (RIG.drive.coulomb[0], 0.3))


@pytest.mark.parametrize(
    "name",
    [
        "drive.motor_inertia[0]",
        "drive.load_friction.share[1]",
        "drive.presliding.distance[0]",
        "drive.current_lag.time",
        "drive.curve.speed[1]",
    ],
)
def test_no_sample_has_a_number_that_no_machine_has(found, name):
    """Each drawn rig can be built: `Certificate.worst` once failed at a negative number."""
    drive = dataclasses.replace(
        RIG.drive,
        load_friction=(0.02, 0.02),
        current_lag=2e-4,
        presliding=Presliding(distance=(0.02, 0.02)),
        curve=FrictionCurve(offset=(0, 0), breakaway=(0.2, 0.2), speed=(5.0, 5.0)),
    )
    rig = dataclasses.replace(RIG, drive=drive)
    level = rig.numbers()[name]
    plants = draw(Uncertainty(), beside(found, (name,), level, (0.5 * level,)), rig, 200, 0)
    column = plants.values[:, plants.names.index(name)]
    assert (column >= 0).all()
    assert plants.plant(int(column.argmin()), LANES, 10)[1].numbers()[name] == column.min()


def test_gears_of_each_sample_carry_links_with_inertia():
    """Of a wrist the motor is most of the inertia: D of the motor alone has no such gears."""
    drive = Drive(
        gear=(100,),
        motor_inertia=(2e-4,),
        viscous=(1e-3,),
        coulomb=(0.1,),
        motor_gain=(0.2,),
        current_limit=(20,),
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=1e-3)
    body = Body(mass=1.0, com=(0.2, 0, 0), inertia=(0.02, 0, 0, 0.02, 0, 0.02), rotor=2.0)
    dynamics = Dynamics.from_chain(Chain(links=(Link(name="one", alpha=np.pi / 2),), bodies=[body]))
    arm = dynamics.arm(dynamics.f())
    covariance = np.diag((0.03 * arm.f) ** 2)
    plants = draw(Uncertainty(covariance=covariance, resonance=(40, 80)), arm, rig, 200, 0)
    stiffness = plants.derived[:, plants.derived_names.index("drive.elasticity.stiffness[0]")]
    assert (stiffness > 0).all()
    assert plants.redrawn > 20
    assert plants.plant(int(stiffness.argmin()), LANES, 10)[1].drive.elasticity is not None


# -- what is said about it -----------------------------------------------------------------------
def test_known_intervals():
    """Of ten trials: none and all by the closed form, five as tabulated; one-sided, none of n: 1
    - 0.05^(1/n).
    """
    np.testing.assert_allclose(clopper_pearson(0, 10), (0, 1 - 0.025**0.1), rtol=1e-12)
    np.testing.assert_allclose(clopper_pearson(10, 10), (0.025**0.1, 1), rtol=1e-12)
    np.testing.assert_allclose(clopper_pearson(5, 10), (0.1871, 0.8129), atol=5e-5)
    certificate = certified(after=0.045, samples=100)
    assert certificate.failures == 0
    assert certificate.interval[0] == 0
    np.testing.assert_allclose(certificate.upper, 1 - 0.05 ** (1 / 100), rtol=1e-9)


@given(st.integers(1, 60), st.data())
@settings(max_examples=50, deadline=None)
def test_intervals_end_where_the_tails_are_half_of_what_is_left(samples, data):
    failures, confidence = (
        data.draw(st.integers(0, samples)),
        data.draw(st.sampled_from((0.8, 0.95, 0.99))),
    )
    low, high = clopper_pearson(failures, samples, confidence)
    if failures:
        np.testing.assert_allclose(
            binom.sf(failures - 1, samples, low), (1 - confidence) / 2, rtol=1e-6
        )
    if failures < samples:
        np.testing.assert_allclose(
            binom.cdf(failures, samples, high), (1 - confidence) / 2, rtol=1e-6
        )


def test_the_certificate_adds_up():
    certificate = certified(samples=400)
    runs = certificate.runs
    assert (
        certificate.failures == (runs.peak.max(axis=1) > 1).sum() == np.isfinite(runs.first).sum()
    )
    assert certificate.probability == certificate.failures / 400
    low, high = certificate.interval
    assert low < certificate.probability < certificate.upper < high
    np.testing.assert_allclose(
        certificate.upper, beta.ppf(0.95, certificate.failures + 1, 400 - certificate.failures)
    )
    assert certificate.share_outside == pytest.approx(runs.outside.sum() / (400 * 72), rel=1e-12)
    text = str(certificate)
    assert certificate.verdict in " ".join(text.split())
    assert "Monte Carlo samples exceed ±1 pulse at some sampling instant" in " ".join(text.split())
    first = certificate.sensitivities[0]
    assert first.name == "f9"  # gravity of the joint that carries the other one
    assert first.sense == "either way"
    assert "fewer than 0.75 % of all would" in certified(samples=400, after=0.045).verdict


def test_a_sensitivity_is_found_whatever_its_shape():
    random = np.random.default_rng(0)
    values = random.normal(size=(3000, 4))
    noise = 0.1 * random.normal(size=3000)
    rows = {
        each.name: each
        for each in influences("abcd", values, np.abs(values[:, 1]) + 0.5 * values[:, 2] + noise)
    }
    either, more, none = rows["b"], rows["c"], rows["d"]
    assert list(rows)[:2] in (["b", "c"], ["c", "b"])
    assert either.share > 0.3
    assert either.sense == "either way"
    assert more.share > 0.2
    assert more.sense == "increasing"
    assert none.share < 0.01
    assert none.sense == ""
    infinite = np.where(values[:, 0] > 1, np.inf, 0.0)
    assert influences("abcd", values, infinite)[0].name == "a"
    assert all(each.share == 0 for each in influences("abcd", values, np.ones(3000)))
    assert all(each.share == 0 for each in influences("abcd", values[:30], noise[:30]))


def test_a_number_of_two_values_has_two_groups_and_a_constant_no_direction():
    random = np.random.default_rng(0)
    values = np.column_stack([random.integers(0, 2, 200), np.ones(200)])
    # A dependence that the chance of ten groups would hide.
    peaks = values[:, 0] + 2.2 * random.normal(size=200)
    rows = {row.name: row for row in influences("ab", values, peaks)}
    variance = np.corrcoef(values[:, 0], np.argsort(np.argsort(peaks)))[0, 1] ** 2
    assert rows["a"].share == pytest.approx(variance, abs=0.01)
    assert (rows["b"].share, rows["b"].direction) == (0, 0)


def test_reserves(monkeypatch):
    """Bandwidth and period at which the same plants, run by hand, begin to leave."""
    module = ctc.certification.reserves
    settings = module.ReserveSettings(bandwidths=(0.5, 0.1, 0.05), periods=(8.0,))
    monkeypatch.setattr(module, "SETTINGS", settings)
    law = ComputedTorque(ARM, RIG)
    certificate = certified(law=law, samples=40, after=0.05, duration=0.3)
    found = certificate.reserves(samples=40)
    left = {
        share: (
            certified(
                law=dataclasses.replace(law, bandwidth=law.bandwidth * share),
                samples=40,
                after=0.05,
                duration=0.3,
            ).failures
        )
        for share in (1.0, 0.5, 0.1)
    }
    assert left[1.0] == 0 < left[0.1]
    bandwidths = [(value, count) for kind, value, count in found.tried if kind == "bandwidth"]
    expected = [(law.bandwidth * share, count) for share, count in left.items()]
    until = [bool(count) for _, count in expected].index(True) + 1
    assert bandwidths == expected[:until]
    assert found.bandwidth == bandwidths[-2][0]
    slow = dataclasses.replace(RIG, period=8 * RIG.period)
    late = certified(
        law=ComputedTorque(ARM, slow, bandwidth=law.bandwidth),
        rig=slow,
        samples=40,
        after=0.05,
        duration=0.3,
    ).failures
    assert found.tried[-1] == ("period", slow.period, late)
    assert found.period == (RIG.period if late else slow.period)
    assert f"holds down to {found.bandwidth:.4g} rad/s" in str(found)
    continuous = dataclasses.replace(found, bandwidth=None, period=None)
    assert str(continuous).startswith("It holds as it is.")


def test_a_share_of_plants_is_counted_without_the_rounding_of_its_product():
    """0.29 of 100 is 28.999999999999996 in floating point."""
    numbers = {"holds": True, "bandwidth": None, "period": None, "tried": []}
    found = ctc.certification.reserves.Reserves(samples=100, allowed=0.29, **numbers)
    assert "at most 29 of 100 plants" in str(found)
    failing = certified(samples=40).reserves(samples=40)
    assert not failing.holds
    assert failing.bandwidth is failing.period is None
    assert "does not hold as it is" in str(failing)


def test_figure():
    certificate = certified(samples=200)
    axes = certificate.plot()
    figure = axes[0].figure
    assert figure.get_suptitle().replace("\n", " ") == certificate.verdict
    bars = [patch.get_height() for patch in axes[0].patches][:6]
    shares = [[(column == k).mean() * 100 for k in range(3)] for column in certificate.runs.peak.T]
    np.testing.assert_allclose(bars, list(itertools.chain(*shares)))
    import matplotlib.pyplot as plt

    plt.close(figure)


# -- bad input -----------------------------------------------------------------------------------
SWAPPED = np.diag([1.0] * 8 + [-1.0])
WRONG = {
    "swapped law and arm": (lambda: certify(ARM, LAW, RIG, PATH), "rig must be of type Rig"),
    "no uncertainty": (lambda: certify(ARM, RIG, LAW, PATH), r"Pass Uncertainty\(covariance="),
    "neither": (lambda: certify(DYNAMICS, RIG, LAW, PATH), "found must be of type Arm"),
    "both": (lambda: certified(plants=[puma560.PUBLISHED]), "got both"),
    "misspelt": (lambda: Uncertainty(frictoin=0.1), "Did you mean 'friction'"),
    "a covariance too small": (
        lambda: certified(covariance=np.eye(3)),
        r"must have shape \(9, 9\)",
    ),
    "a factor of one": (
        lambda: certified(covariance=np.tril(np.ones((9, 9)))),
        "must be symmetric",
    ),
    "no covariance": (lambda: certified(covariance=SWAPPED), "positive semidefinite"),
    "hardly an arm": (
        lambda: certify(
            DYNAMICS.arm(-puma560.PUBLISHED), RIG, LAW, PATH, Uncertainty(covariance=COVARIANCE)
        ),
        "Give a smaller covariance",
    ),
    "no arm": (lambda: certified(covariance=None, plants=-puma560.PUBLISHED[None]), "row 0 has D"),
    "no samples": (lambda: certified(samples=0), "samples must be a whole number of at least 1"),
    "no thread": (lambda: certified(threads=0), "threads must be a whole number of at least 1"),
    "half a thread": (lambda: certified(threads=0.5), "threads must be a whole number"),
    "a negative seed": (lambda: certified(seed=-1), "seed must be a whole number"),
    "surely": (lambda: certified(confidence=1.0), "confidence between 0.5 and 1"),
    "a load nowhere": (lambda: certified(load=1.0), "load_position must be given"),
    "a range upside down": (lambda: certified(delay=(2e-4, 1e-4)), "the lower end first"),
    "too late": (lambda: certified(delay=1e-3), "at least its delay"),
    "all lost": (lambda: certified(dropped=1.0), "from 0 to below 1"),
    "fast and lost": (lambda: certified(law=puma560.p_law(), dropped=0.1), "Use a sampled law"),
    "nothing left": (lambda: certified(after=0.05), "after must be from 0 to 0.0497 s"),
    "no sample left": (lambda: certified(after=0.0499), "the last sample; got 0.0499"),
    "text for a flag": (
        lambda: certified(phase="yes"),
        "phase of Uncertainty must be of type bool",
    ),
    "more reserves than plants": (
        lambda: certified(samples=20).reserves(samples=21),
        "from 1 to 20",
    ),
    "no such plant": (lambda: certified(samples=20).plant(20), "from 0 to 19"),
    "a flag for a plant": (lambda: certified(samples=20).plant(True), "from 0 to 19; got True"),
    "a plant from the end": (
        lambda: certified(samples=20).plants.plant(-1, LANES, 10),
        "from 0 to 19; got -1",
    ),
    "no plant to reserve for": (
        lambda: certified(samples=20).reserves(samples=0),
        r"from 1 to 20; got 0\. Leave it out",
    ),
    "no sub-step": (
        lambda: certified(resonance=(60, 90), steps_per_sample=0),
        "steps_per_sample must be a whole number of at least 1; got 0",
    ),
}


@pytest.mark.parametrize(("call", "message"), WRONG.values(), ids=WRONG)
def test_wrong_calls_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def test_a_gear_cannot_be_drawn(found):
    gear = dataclasses.replace(
        found.fit,
        unknown=(*found.fit.unknown, "drive.gear[0]"),
        values=np.append(found.fit.values, 107.8),
        covariance=np.pad(found.covariance, (0, 1)) + np.diag([0.0] * 9 + [1.0]),
        noise_covariance=None,
    )
    with_gear = dataclasses.replace(found, fit=gear)
    with pytest.raises(ValueError, match="controllers read their counts by it"):
        certify(with_gear, RIG, LAW, PATH)
    curve = dataclasses.replace(
        found.fit,
        unknown=(*found.fit.unknown, "drive.curve.offset[0]"),
        values=np.append(found.fit.values, 0.01),
        covariance=np.pad(found.covariance, (0, 1)),
        noise_covariance=None,
    )
    with_curve = dataclasses.replace(found, fit=curve)
    with pytest.raises(ValueError, match=r"Pass found\.rig"):
        certify(with_curve, RIG, LAW, PATH)


# -- starts --------------------------------------------------------------------------------------
def rested(rig, spread, duration):
    """A certificate of a gentle move from rest, by a controller that is too weak for weights
    that are off.
    """
    move = PointToPoint(start=(0.2, -0.3), goal=(0.25, -0.25), duration=duration)
    law = ComputedTorque(ARM, rig, bandwidth=60, start_boost=1.0)
    stated = Uncertainty(covariance=np.diag((spread * puma560.PUBLISHED) ** 2), friction=0.0)
    return certify(ARM, rig, law, move, stated, samples=64, progress=False)


def test_a_hold_knows_the_weight():
    """Without friction the disturbance torque is all that the model lacks at rest: the start
    shows nothing of it.
    """
    smooth = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, coulomb=(0.0, 0.0)))
    let_go = rested(smooth, 0.05, 2.0)
    held = let_go.from_hold(samples=32)
    assert len(held.plants) == len(held.runs.outside) == 32
    assert len(let_go.from_hold().plants) == len(let_go.plants) < 400
    assert let_go.failures > 40
    assert held.failures < 4
    said = "from a hold, static friction anywhere inside its cone"
    assert said in held.verdict
    assert said not in let_go.verdict


def test_a_hold_may_hide_as_much_as_static_friction_carries():
    """The same sample step by step, by a running controller that begins with that torque."""
    held = rested(RIG, 0.01, 0.3).from_hold(samples=8)
    share = np.random.default_rng((0, 3)).uniform(-1, 1, (8, 2))[3]
    arm, rig = held.plants.plant(3, 1, 0)
    begun = np.array([0.2, -0.3])
    robot, running = (
        SteppedArm(arm, rig, begun, np.zeros(2)),
        held.law.start(RIG, rig.counts(begun)),
    )
    known, peak = np.zeros(len(running.state)), np.zeros(2)
    known[4:6] = arm.h(begun, (0, 0)) - ARM.h(begun, (0, 0)) + share * RIG.drive.joint_coulomb()
    running.begin(running.state + known)
    for k in range(round(0.3 / RIG.period)):
        motion = held.reference([k * RIG.period])
        peak = np.maximum(peak, np.abs(RIG.counts(motion.q[0]) - robot.pulses))
        robot.step(running.step(robot.pulses, *(each[0] for each in motion)))
    np.testing.assert_array_equal(held.runs.peak[3], peak)


SWING = Harmonics(period=2.0, offset=(0, 0), cosine=((0,), (0,)), sine=((0.1,), (0.1,)))


@pytest.mark.parametrize(
    ("law", "path", "samples", "says"),
    [
        (LAW, PATH, 33, "samples must be a whole number from 1 to 32; got 33"),
        (LAW, SWING, 8, "the path must begin at rest; this one begins with"),
        (P(gain=(0.2, 0.15)), PATH, 8, r"must learn a disturbance torque; P does not\. Use ComputedTorque"),
    ],
)  # fmt: skip
def test_other_holds_are_refused(law, path, samples, says):
    certificate = certify(
        ARM,
        RIG,
        law,
        path,
        Uncertainty(covariance=COVARIANCE),
        samples=32,
        duration=0.05,
        progress=False,
    )
    with pytest.raises(ValueError, match=says):
        certificate.from_hold(samples=samples)


# -- what else to do -----------------------------------------------------------------------------
def test_a_path_beyond_the_motors_is_named():
    fast = PATH.slowed(0.2)
    certificate = certify(
        ARM, RIG, LAW, fast, Uncertainty(covariance=COVARIANCE), samples=32, progress=False
    )
    assert certificate.failures == 32
    factor = float(re.search(r"Slow it down by \.slowed\(([\d.]+)\)", str(certificate))[1])
    assert 1 < factor < 5
    slower = certify(
        ARM,
        RIG,
        LAW,
        fast.slowed(factor),
        Uncertainty(covariance=COVARIANCE),
        samples=8,
        progress=False,
    )
    assert "no controller can hold it" not in str(slower)


def test_options_of_a_part_are_told_from_others():
    with pytest.raises(
        ValueError, match=r"certify takes resonance by .* Give uncertainty=Uncertainty\(resonance="
    ):
        certify(ARM, RIG, LAW, PATH, resonance=(20, 40))
    with pytest.raises(ValueError, match="Did you mean 'samples'"):
        certify(ARM, RIG, LAW, PATH, sample=3)

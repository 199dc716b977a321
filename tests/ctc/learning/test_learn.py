"""Learning from repetitions: what a model lacks is found, added along the path, and mended."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from ctc import ComputedTorque, LearnSettings, LearntTorque, certify, evaluate, learn
from ctc.learning import exponentials, path_plant, standing
from plant import (
    PID,
    Coupling,
    Elasticity,
    FrictionCurve,
    Harmonics,
    P,
    PointToPoint,
    puma560,
    simulate,
)
from plant.machine import LoadFriction

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()


def with_drive(rig, **changes):
    """The rig with another drive."""
    return dataclasses.replace(rig, drive=dataclasses.replace(rig.drive, **changes))


def off(rig, factor):
    """A rig whose friction is off."""
    return with_drive(rig, coulomb=factor * rig.drive.coulomb, viscous=factor * rig.drive.viscous)


MODEL = ARM.dynamics.arm(ARM.f * (1 + 0.03 * np.random.default_rng(0).choice([-1, 1], 9)))
BELIEVED = off(RIG, np.array([1.1, 0.9]))
LAW = ComputedTorque(MODEL, BELIEVED, bandwidth=60)


@pytest.fixture(scope="module")
def log():
    return simulate(ARM, RIG, LAW, PATH)


@pytest.fixture(scope="module")
def learnt(log):
    return learn(LAW, BELIEVED, PATH, log)


def missing():
    """Torque (N, 2) that the model lacks along the path, from the arms themselves."""
    motion = PATH(RIG.period * np.arange(5215))
    return (
        np.array(
            [
                ARM.dynamics.Y(q, qd, qdd).full() @ (ARM.f - MODEL.f)
                for q, qd, qdd in zip(*motion, strict=True)
            ]
        )
        + RIG.drive.friction(motion.qd)
        - BELIEVED.drive.friction(motion.qd)
    )


def test_what_the_model_lacks_is_found(learnt):
    """Of the torque itself, known from both arms, 0.7 is added; the rest is steps of friction
    that 40 Hz round off.
    """
    expected = missing()
    added = learnt.law.torque(RIG.period * np.arange(5215)) / 0.7
    moving = np.abs(PATH(RIG.period * np.arange(5215)).qd) > 0.05  # [rad/s]
    assert np.sqrt(np.mean(expected[moving] ** 2)) > 1.5
    assert np.sqrt(np.mean((added - expected)[moving] ** 2)) < 0.3


def test_repetitions_become_exact(learnt, log):
    again = simulate(ARM, RIG, learnt.law, PATH)
    second = learn(learnt, BELIEVED, PATH, again)
    squares = [np.mean(record.error_pulses**2) for record in (log, again)]
    assert squares[1] < 0.8 * squares[0]
    assert np.abs(again.error_pulses).max() <= 1
    assert np.linalg.norm(second.missing[1]) < 0.4 * np.linalg.norm(second.missing[0])
    assert not second.diverged
    assert second.left_out == ()


def test_f_and_friction_are_mended(learnt):
    """Better than it was, and no path is needed for it."""
    motion = PATH.slowed(1 / 1.2)(np.linspace(0, 3, 200))

    def wrong(arm, rig):
        lacking = [
            ARM.dynamics.Y(q, qd, qdd).full() @ (ARM.f - arm.f)
            + RIG.drive.friction(qd)
            - rig.drive.friction(qd)
            for q, qd, qdd in zip(*motion, strict=True)
        ]
        return np.sqrt(np.mean(np.square(lacking)))

    assert wrong(learnt.arm, learnt.rig) < 0.15 * wrong(MODEL, BELIEVED)


def test_certify_takes_what_was_learnt(learnt):
    certificate = certify(
        learnt.arm,
        learnt.rig,
        learnt.law,
        PATH,
        learnt.uncertainty,
        samples=8,
        duration=0.2,
        progress=False,
    )
    assert len(certificate.runs.peak) == 8


def test_friction_is_uncertain_by_no_more_than_itself(learnt):
    """Friction of a sample that was less than zero would push."""
    levels = np.array([learnt.rig.drive.joint_viscous(), learnt.rig.drive.joint_coulomb()])
    for factor, share in ((0.3, 0.3), (5.0, 1.0)):
        unsure = dataclasses.replace(learnt, friction_std=factor * levels)
        assert unsure.uncertainty.friction == pytest.approx(share)


def test_friction_of_zero_that_is_uncertain_is_so_by_itself(learnt):
    """Noise can hide a level, whose share would otherwise seem to be known."""
    zero = with_drive(learnt.rig, coulomb=(0.0, 0.1))
    known = np.array([zero.drive.joint_viscous(), zero.drive.joint_coulomb()]) * 0.1
    hidden = np.add(known, [[0, 0], [0.01, 0]])
    for std, share in ((known, 0.1), (hidden, 1.0)):
        result = dataclasses.replace(learnt, rig=zero, friction_std=std)
        assert result.uncertainty.friction == pytest.approx(share)


def test_breakaway_is_no_part_of_the_level_that_is_uncertain(learnt):
    """Samples of certify scale the drive's Coulomb level alone."""
    excess = FrictionCurve(offset=(0, 0), breakaway=(0.1, 0.1), speed=(1.0, 1.0))
    std = np.array([(0, 0), 0.3 * learnt.rig.drive.joint_coulomb()])
    rig = with_drive(learnt.rig, curve=excess)
    result = dataclasses.replace(learnt, rig=rig, friction_std=std)
    assert result.uncertainty.friction == pytest.approx(0.3)


@pytest.mark.parametrize(("matrix", "converged"), [((), True), (((1, 1), (0, 1)), False)])
def test_torques_of_two_joints_add_up_on_a_shaft(learnt, matrix, converged):
    """Torques of opposite phase have equal rms, whose difference on the shaft would be zero."""
    limit = np.abs(learnt.rig.drive.torque_limit()).min()
    rig = with_drive(learnt.rig, coupling=Coupling(matrix=matrix))
    result = dataclasses.replace(learnt, rig=rig, missing=(np.full(2, 0.9e-3 * limit),))
    assert result.converged == converged


def test_the_running_law_adds_the_torque(learnt):
    """Sample by sample as in the simulator."""
    record = simulate(ARM, RIG, learnt.law, PATH, duration=0.05)
    controller = learnt.law.start(RIG, record.counts[0], guards=None)
    motion = PATH(record.t)
    torque = [
        controller.step(counts, *row) for counts, *row in zip(record.counts, *motion, strict=True)
    ]
    assert np.allclose(torque, record.torque, atol=1e-9)


def test_a_disturbed_repetition_is_left_out(learnt):
    again = simulate(ARM, RIG, learnt.law, PATH)
    kicked = np.array(again.error_pulses)
    kicked[2000:2200] += 40 * np.sin(np.linspace(0, np.pi, 200))[:, None].round(1)
    kicked = dataclasses.replace(again, error_pulses=np.round(kicked), name="kicked")
    result = learn(learnt, BELIEVED, PATH, kicked)
    assert len(result.left_out) == 1
    assert result.left_out[0].startswith("kicked")
    assert np.array_equal(result.law.terms, learnt.law.terms)
    both = learn(learnt, BELIEVED, PATH, [kicked, again])
    assert np.allclose(both.law.terms, learn(learnt, BELIEVED, PATH, again).law.terms)


def test_a_correction_that_does_not_help_is_taken_back(learnt, log):
    # as if nothing had become better: 0.7 more is missing
    again = dataclasses.replace(log, law=None)
    result = learn(learnt, BELIEVED, PATH, again)
    assert not result.diverged  # without the torque that was added, less is missing
    worse = dataclasses.replace(again, torque=log.torque + 2 * learnt.law.torque(log.t))
    result = learn(learnt, BELIEVED, PATH, worse)
    assert result.diverged
    assert result.gain == pytest.approx(0.35)
    assert np.allclose(result.law.terms, 0.5 * learnt.law.terms)
    assert "taken back" in str(result)
    assert_prior(result)


def assert_prior(result):
    """Nothing is learnt: the arm and its uncertainty are those before."""
    drive = BELIEVED.drive
    np.testing.assert_array_equal(result.arm.f, MODEL.f)
    assert result.rig == BELIEVED
    np.testing.assert_allclose(np.diag(result.covariance), (0.05 * MODEL.f) ** 2)
    levels = [drive.joint_viscous(), drive.joint_coulomb()]
    np.testing.assert_allclose(result.friction_std, 0.2 * np.array(levels))
    assert result.rest == 0
    assert result.uncertainty.friction == pytest.approx(0.2)


def test_where_all_is_left_out_nothing_is_mended(learnt, log):
    rough = np.array(log.error_pulses) + 5 * np.sign(np.sin(np.arange(len(log))))[:, None]
    result = learn(
        P(gain=(0.2, 0.15)),
        BELIEVED,
        PATH,
        dataclasses.replace(log, error_pulses=rough, law=None),
        found=MODEL,
    )
    assert not result.missing
    assert_prior(result)
    assert "fast hardware" in result.left_out[0]
    assert "mended" not in str(result)
    assert "mended" in str(learnt)


def test_it_is_saved_and_read_back(learnt, log, tmp_path):
    learnt.save(tmp_path / "learnt.json")
    again = type(learnt).load(tmp_path / "learnt.json")
    assert str(again) == str(learnt)
    assert np.array_equal(
        learn(again, BELIEVED, PATH, dataclasses.replace(log, law=None)).law.terms,
        learn(learnt, BELIEVED, PATH, dataclasses.replace(log, law=None)).law.terms,
    )


def test_any_law_is_learnt_from(learnt):
    """A PID knows no arm; what is missing is the same."""
    pid = PID(
        gain=(0.1, 0.08),
        integral=(1.0, 1.0),
        derivative=(4e-4, 3e-4),
        filter=2000.0,
        period=RIG.period,
    )
    record = simulate(ARM, RIG, pid, PATH)
    found = learn(pid, BELIEVED, PATH, record, found=MODEL)
    lacking = found.law.torque(RIG.period * np.arange(5215)) - learnt.law.torque(
        RIG.period * np.arange(5215)
    )
    assert np.sqrt(np.mean(lacking**2)) < 0.3


def geared(hz):
    """The rig on gears of this resonance."""
    gears = Elasticity.from_resonance(ARM, hz, 0.02, drive=RIG.drive)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=gears))


def test_gears_wind_up_as_they_are_stiff():
    """The torque that elastic gears need beside rigid ones falls as 1 / k; those too stiff for
    the period are rigid.
    """
    rigid = path_plant(ARM, RIG, PATH, 1000)
    apart = [
        np.std((path_plant(ARM, geared(hz), PATH, 1000).torque - rigid.torque)[200:])
        for hz in (100, 200)
    ]
    assert apart[1] < 0.5 * apart[0] < 0.05 * np.std(rigid.torque)
    stiffest = path_plant(ARM, geared(2000), PATH, 1000)
    assert np.array_equal(stiffest.torque, rigid.torque)


@pytest.mark.parametrize("rig", [RIG, geared(200)], ids=["rigid", "elastic"])
def test_friction_rises_with_the_load(rig):
    """By a tenth of the torque through the gears, in the direction of motion, as in the law."""
    count = 1000
    plain = path_plant(ARM, rig, PATH, count)
    loaded = path_plant(
        ARM, with_drive(rig, load_friction=LoadFriction(share=(0.1, 0.1))), PATH, count
    )
    motion = PATH(RIG.period * (np.arange(count) + 0.5))
    through = np.array(
        [ARM.D(q) @ qdd + ARM.h(q, qd) for q, qd, qdd in zip(*motion, strict=True)]
    ) - RIG.drive.rotor_torque(motion.qdd)
    # Below full sliding speed friction is in proportion. Links swing at first, by 3 % afterwards.
    fast = np.abs(RIG.position_in_pulses(motion.qd)) > 60
    fast[:200] = False
    rise = 0.1 * np.abs(through) * np.sign(motion.qd)
    assert fast.mean() > 0.5
    np.testing.assert_allclose(
        (loaded.torque - plain.torque)[fast], rise[fast], atol=0.03 * np.abs(rise).max()
    )


def test_it_learns_on_elastic_gears():
    """With links that swing at 40 Hz, under a slow law: the squared error falls to a quarter."""
    law = ComputedTorque(MODEL, BELIEVED, bandwidth=30)
    rig, gears = geared(40), geared(40).drive.elasticity
    model = dataclasses.replace(
        BELIEVED, drive=dataclasses.replace(BELIEVED.drive, elasticity=gears)
    )
    records, result = [simulate(ARM, rig, law, PATH)], law
    for _ in range(2):
        result = learn(result, model, PATH, dataclasses.replace(records[-1], law=None))
        records.append(simulate(ARM, rig, result.law, PATH))
    squares = [np.mean(record.error_pulses**2) for record in records]
    assert squares[2] < 0.25 * squares[0]
    assert np.abs(records[2].error_pulses).max() <= 2


def test_it_is_exported_as_c(learnt, tmp_path):
    learnt.law.to_c(tmp_path, RIG)
    assert (tmp_path / "controller.c").read_text().count("cos(") >= 1


def test_standing():
    counts = np.array([[0], [0], [0], [1], [1], [2], [2], [2], [2]])
    assert standing(counts, 3).ravel().tolist() == [1, 1, 1, 0, 0, 1, 1, 1, 1]


@pytest.mark.parametrize("samples", [0, 1])
def test_a_count_that_changes_at_every_sample_does_not_stand(samples):
    """Even where `standing_time` is shorter than a long period of the rig."""
    assert standing(np.array([[0], [1], [2], [2]]), samples).ravel().tolist() == [0, 0, 1, 1]


def test_bad_input(learnt, log):
    def refused(match, *arguments, **options):
        with pytest.raises(ValueError, match=match) as caught:
            learn(*arguments, **options)
        assert "\n" not in str(caught.value)

    refused("must be the path; got another", LAW, BELIEVED, PATH.slowed(1.2), log)
    refused("reference must be the path", learnt, BELIEVED, PATH.slowed(1.2), log)
    refused("must be made by", learnt, BELIEVED, PATH, log)
    refused(
        "torque or current",
        LAW,
        BELIEVED,
        PATH,
        dataclasses.replace(log, torque=None, current=None),
    )
    refused("5215 samples", LAW, BELIEVED, PATH, log.cut(0, 1.0))
    refused("amplifier's", LAW, BELIEVED, PATH, dataclasses.replace(log, torque=10 * log.torque))
    refused("holds no arm", puma560.p_law(), BELIEVED, PATH, log)
    refused("got none", LAW, BELIEVED, PATH, [])
    refused("Identification or its arm", LAW, BELIEVED, PATH, log, found="x")
    short = Harmonics(period=RIG.period, offset=(0, 0), cosine=((0,), (0,)), sine=((0,), (0,)))
    refused("last longer than the period", LAW, BELIEVED, short, log)
    begin = PATH([0.0]).q[0]
    still = PointToPoint(start=begin, goal=begin, duration=0.05)
    refused("reference must move", LAW, BELIEVED, still, simulate(ARM, RIG, LAW, still))
    refused("The order is law, rig", LAW, PATH, BELIEVED, log)
    refused("reference must be", LAW, BELIEVED, 3, log)
    other = dataclasses.replace(
        RIG, encoder=dataclasses.replace(RIG.encoder, resolution=(500, 500))
    )
    refused("rig must be that on which", learnt, other, PATH, log)
    with pytest.raises(ValueError, match="got another"):
        evaluate(ARM, RIG, learnt.law, PATH.slowed(1.2), duration=0.1)
    with pytest.raises(ValueError, match="must be that on which"):
        evaluate(ARM, other, learnt.law, PATH, duration=0.1)
    with pytest.raises(ValueError, match="where the learnt path begins"):
        learnt.law.start(RIG, (500, 0))
    with pytest.raises(ValueError, match="as many for each"):
        LearntTorque(law=LAW, rig=RIG, reference=PATH, terms=(1.0,))


def test_another_rig_is_refused_for_itself_wherever_its_arm_stands():
    """Its counts at the start of the path are others: the arm need not move."""
    sine = ((0.2,), (-0.2,))
    path = Harmonics(period=2.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=sine)
    law = LearntTorque(law=puma560.p_law(), rig=RIG, reference=path, terms=(1.0, 0.5))
    other = dataclasses.replace(
        RIG, encoder=dataclasses.replace(RIG.encoder, resolution=(500, 500))
    )
    for rig in (other, RIG):
        pulses = rig.counts(path([0.0]).q[0])
        with pytest.raises(ValueError, match="rig must be that on which"):
            law.start(other, pulses)


def test_it_says_itself_on_one_screen(learnt):
    said = str(learnt)
    assert len(said.splitlines()) < 30
    assert max(map(len, said.splitlines())) <= 80
    assert "learn from another repetition" in said
    assert "Coulomb" in said


def test_exponentials_are_scipy_s():
    matrices = np.random.default_rng(0).normal(size=(3, 6, 6)) * 0.2
    np.testing.assert_allclose(exponentials(matrices, 3), expm(matrices), rtol=1e-6, atol=1e-6)


def test_settings_shape_what_is_learnt_and_stay(log, learnt):
    """Half of the gain adds half of the torque; the next call keeps the settings."""
    settings = LearnSettings(gain=0.35, start_distance=50)
    half = learn(LAW, BELIEVED, PATH, log, settings=settings)
    np.testing.assert_allclose(half.law.terms, 0.5 * learnt.law.terms, rtol=1e-12)
    assert half.law.start_distance == 50
    assert learn(half, BELIEVED, PATH, log_of(half)).settings == settings
    with pytest.raises(ValueError, match="settings must be of type LearnSettings"):
        learn(LAW, BELIEVED, PATH, log, settings=0.35)


def log_of(learnt):
    """A repetition under the law that was learnt."""
    return simulate(ARM, RIG, learnt.law, PATH)


@pytest.mark.parametrize("hertz", [10.0, 60.0])
def test_another_highest_frequency_neither_repeats_nor_forgets_a_torque(learnt, hertz):
    """The torque that was applied explains its log; new frequencies begin at zero."""
    again = log_of(learnt)
    usual = learn(learnt, BELIEVED, PATH, again)
    settings = LearnSettings(highest_frequency=hertz)
    result = learn(learnt, BELIEVED, PATH, again, settings=settings)
    np.testing.assert_allclose(result.missing[-1], usual.missing[-1], rtol=1e-12)
    size = min(len(result.law.terms), len(usual.law.terms))
    np.testing.assert_allclose(result.law.terms[:size], usual.law.terms[:size], atol=1e-12)
    assert np.abs(result.before[len(learnt.law.terms) :]).max(initial=0) == 0
    # A correction of other frequencies can be taken back, too.
    worse = dataclasses.replace(
        again, law=None, torque=again.torque + 2 * learnt.law.torque(again.t)
    )
    taken_back = learn(result, BELIEVED, PATH, worse, settings=usual.settings)
    assert taken_back.diverged
    np.testing.assert_array_equal(taken_back.before[:size], result.before[:size])


def test_a_correction_is_taken_back_after_a_disturbed_repetition(learnt, log):
    again = log_of(learnt)
    rough = np.array(again.error_pulses) + 5 * np.sign(np.sin(np.arange(len(again))))[:, None]
    disturbed = learn(learnt, BELIEVED, PATH, dataclasses.replace(again, error_pulses=rough))
    assert len(disturbed.left_out) == 1
    assert disturbed.law == learnt.law
    np.testing.assert_array_equal(disturbed.arm.f, learnt.arm.f)
    worse = dataclasses.replace(log, law=None, torque=log.torque + 2 * learnt.law.torque(log.t))
    result = learn(disturbed, BELIEVED, PATH, worse)
    assert result.diverged
    np.testing.assert_allclose(result.law.terms, 0.5 * learnt.law.terms)


@pytest.mark.parametrize("factor", [1.4, 0.999])
def test_a_log_of_another_period_is_refused(log, factor):
    """Its steps are within half a period each, but not their sum."""
    t = factor * log.t
    pulses = RIG.counts(PATH(t).q)
    other = dataclasses.replace(log, t=t, reference_pulses=pulses, law=None, reference=None)
    with pytest.raises(ValueError, match="sampled every"):
        learn(LAW, BELIEVED, PATH, other)
    t = log.t + 0.2 * RIG.period * np.random.default_rng(0).uniform(-1, 1, len(log))
    jittered = dataclasses.replace(log, t=t, reference_pulses=RIG.counts(PATH(t).q))
    assert len(learn(LAW, BELIEVED, PATH, jittered).innovations) == 1


def test_a_smoothing_longer_than_the_path_stays_centred():
    """A Gaussian of one path as standard deviation keeps some 0.38 of what lies on the path."""
    sine = ((0.004,), (0.004,))
    path = Harmonics(period=1.0, offset=(0.3, -0.2), cosine=((0,), (0,)), sine=sine)
    law = P(gain=(0.2, 0.15))
    record = simulate(ARM, RIG, law, path)

    def total(**options):
        settings = LearnSettings(largest_innovation=1e3, innovation_ratio=1e3, **options)
        result = learn(law, BELIEVED, path, record, found=MODEL, settings=settings)
        return result.law.torque(record.t).sum(axis=0)

    none = total(stuck_bandwidth=0)
    share = (total(stuck_smoothing=1.0) - none) / (total() - none)
    assert (share > 0.3).all()
    assert (share < 0.45).all()

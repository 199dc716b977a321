"""The table of what can be wrong: each mistake is the first cause, with its joints and size, and
is undone.
"""

import dataclasses

import numpy as np
import pytest

from plant import (
    PD,
    PID,
    Body,
    Chain,
    Coupling,
    Dynamics,
    Elasticity,
    Harmonics,
    Hypothesis,
    Link,
    LoggedTorque,
    Phase,
    puma560,
    read_robot,
    simulate,
)
from plant.checkup import Cause, Rival, each_joint, score, undo

RIG = puma560.rig()
PATH = Harmonics(
    period=3.1,
    offset=(0.1, -0.15),
    cosine=((0.3, -0.1, 0.1), (0.25, 0.15, -0.1)),
    sine=((-0.2, 0.2, 0.05), (0.3, -0.1, 0.1)),
)


@pytest.fixture(scope="module")
def record():
    encoder = dataclasses.replace(
        RIG.encoder, rounding="floor", phase=Phase(shift=np.array((0.2, -0.3)))
    )
    rig = dataclasses.replace(RIG, encoder=encoder)
    law = puma560.p_law((0.13, 0.09))
    made = simulate(puma560.literature_arm(0.7), rig, law, PATH, steps_per_sample=8)
    # What a user states knows nothing of the counter's phase.
    stated = dataclasses.replace(rig, encoder=dataclasses.replace(encoder, phase=None))
    return dataclasses.replace(made, rig=stated, current=None, reference=None)


def with_reference(record, pulses):
    return dataclasses.replace(record, reference_pulses=pulses, error_pulses=pulses - record.counts)


def with_counts(record, counts):
    return dataclasses.replace(record, error_pulses=record.reference_pulses - counts)


def with_torque(record, torque):
    return dataclasses.replace(record, torque=torque)


def later(table, samples):
    rows = np.arange(len(table))
    return np.column_stack([np.interp(rows - samples, rows, column) for column in table.T])


def clipped(torque):
    """Torques, those of the first joint cut off at six tenths of the largest."""
    top = 0.6 * np.abs(torque[:, 0]).max()
    return np.clip(torque, (-top, -np.inf), (top, np.inf))


def in_pulses_per_radian(record):
    encoder = record.rig.encoder
    encoder = dataclasses.replace(encoder, resolution=encoder.resolution / (2 * np.pi))
    return dataclasses.replace(record, rig=dataclasses.replace(record.rig, encoder=encoder))


def in_lines(record, *joints):
    """Lines stated in place of counts; the rig makes its reference of angles."""
    factors = np.ones(record.n)
    factors[list(joints) or slice(None)] = 0.25
    encoder = record.rig.encoder
    encoder = dataclasses.replace(encoder, resolution=factors * encoder.resolution)
    rig = dataclasses.replace(record.rig, encoder=encoder)
    pulses = np.rint(factors * record.reference_pulses)
    return dataclasses.replace(with_reference(record, pulses), rig=rig)


DRIVE = RIG.drive
MISTAKES = {
    # name of the cause: (mistake, joints, size; None: a switch)
    "exchanged references": (
        lambda r: with_reference(r, r.reference_pulses[:, ::-1]),
        (0, 1),
        None,
    ),
    "exchanged counts": (lambda r: with_counts(r, r.counts[:, ::-1]), (0, 1), None),
    "exchanged torques": (lambda r: with_torque(r, r.torque[:, ::-1]), (0, 1), None),
    "turned reference": (
        lambda r: with_reference(r, r.reference_pulses * (-1, 1)),
        (0,),
        None,
    ),
    "turned torque of all joints": (lambda r: with_torque(r, -r.torque), (), None),
    "torque a motor current in A": (
        lambda r: with_torque(r, DRIVE.current(r.torque)),
        (),
        None,
    ),
    "torque per mille of the amplifier's limit": (
        lambda r: with_torque(r, 1e3 * r.torque / DRIVE.torque_limit()),
        (),
        None,
    ),
    "torque per cent of the amplifier's limit": (
        lambda r: with_torque(r, 1e2 * r.torque / DRIVE.torque_limit()),
        (),
        None,
    ),
    "lines of the encoder": (in_lines, (), 4.0),
    "resolution per radian": (in_pulses_per_radian, (), None),
    "torque scale": (lambda r: with_torque(r, 1.96 * r.torque), (), 1.96),
    "late counts": (
        lambda r: with_counts(r, np.floor(later(r.counts + 0.5, 1.5))),
        (),
        1.5,
    ),
    "late torques": (lambda r: with_torque(r, later(r.torque, 6.0)), (), 6.0),
    "current limit": (lambda r: with_torque(r, clipped(r.torque)), (0,), None),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_each_mistake_is_the_first_cause(record, name):
    mistake, joints, size = MISTAKES[name]
    checkup = mistake(record).check()
    cause = checkup.causes[0]
    assert (cause.name, cause.joints) == (name, joints)
    if size is not None:
        assert cause.size == pytest.approx(size, rel=0.05)


@pytest.mark.parametrize("name", ["exchanged references", "exchanged torques", "exchanged counts"])
def test_exchanged_columns_are_exchanged_back(record, name):
    corrected = MISTAKES[name][0](record).check().corrected
    np.testing.assert_array_equal(corrected.reference_pulses, record.reference_pulses)
    np.testing.assert_array_equal(corrected.counts, record.counts)
    np.testing.assert_allclose(corrected.torque, record.torque)


def test_gravity_that_a_driver_takes_out_is_named(record):
    q = record.rig.cell_centre(record.counts)
    arm = puma560.literature_arm(0.7)
    gravity = np.array([np.ravel(arm.h(row, np.zeros(2))) for row in q[::20]])
    rows = np.arange(len(q))
    gravity = np.column_stack([np.interp(rows, rows[::20], column) for column in gravity.T])
    cause = with_torque(record, record.torque - gravity).check().causes[0]
    assert cause.name == "torque without gravity"


def test_inverse_dynamics_in_place_of_a_measured_torque_is_named(record):
    motion = PATH(record.t[::20])
    arm = puma560.literature_arm(0.8)
    torque = np.array([np.ravel(arm.inverse(*state)) for state in zip(*motion[:3], strict=True)])
    rows = np.arange(len(record.t))
    torque = np.column_stack([np.interp(rows, rows[::20], column) for column in torque.T])
    cause = with_torque(record, torque).check().causes[0]
    assert cause.name == "torque of a model"


@pytest.mark.slow
def test_a_law_that_lacks_the_rate_of_its_error_is_named():
    gain = np.array((0.13, 0.09))
    law = PD(gain=gain, derivative=0.008 * gain, filter=800.0, period=RIG.period)
    made = simulate(puma560.literature_arm(0.7), RIG, law, PATH, steps_per_sample=8)
    stated = dataclasses.replace(made, law=puma560.p_law(gain), reference=None, current=None)
    cause = stated.check().causes[0]
    assert cause.name == "rate of the error"
    assert cause.size == pytest.approx(0.008, rel=0.2)
    assert made.check().causes == ()


def test_a_right_log_has_no_cause_and_stays_as_it_is(record):
    checkup = record.check()
    assert checkup.causes == ()
    assert checkup.corrected is record
    assert checkup.first_corrected is record


@pytest.mark.parametrize("joint", [0, 1])
def test_exchanged_encoders_of_motor_and_link_are_exchanged_back(joint):
    arm = puma560.literature_arm(1.5)
    gears = Elasticity.from_resonance(arm, 40, 0.02, drive=DRIVE)
    rig = dataclasses.replace(
        RIG,
        drive=dataclasses.replace(DRIVE, elasticity=gears),
        encoder=dataclasses.replace(RIG.encoder, side="both"),
    )
    made = simulate(arm, rig, puma560.p_law((0.1, 0.08)), puma560.reference(), duration=2.0)
    made = dataclasses.replace(made, reference=None)
    chosen = np.arange(2) == joint
    exchanged = dataclasses.replace(
        with_counts(made, np.where(chosen, made.link_counts, made.counts)),
        link_counts=np.where(chosen, made.counts, made.link_counts),
    )
    assert made.check().causes == ()
    checkup = exchanged.check()
    cause = checkup.causes[0]
    assert (cause.name, cause.joints) == ("exchanged encoders", (joint,))
    np.testing.assert_array_equal(checkup.corrected.counts, made.counts)
    np.testing.assert_array_equal(checkup.corrected.link_counts, made.link_counts)


@pytest.mark.parametrize("seed", [7003, 7007])
def test_a_right_log_of_six_joints_without_a_reference_has_no_cause(seed):
    """Forty unknown coefficients of each motor leave little of a short log to judge by."""
    robot, random = read_robot("ur5e"), np.random.default_rng(seed)
    size = random.uniform(0.15, 0.4)
    cosine, sine = (random.normal(size=(6, 3)) * size / np.arange(1, 4) for _ in range(2))
    period, offset = random.uniform(3, 5), random.uniform(-1, 1, 6)
    path = Harmonics(period=period, offset=offset, cosine=cosine, sine=sine)
    dynamics = robot.dynamics
    made = simulate(dynamics.arm(dynamics.f()), robot.rig, robot.law, path)
    bare = dataclasses.replace(
        made, law=LoggedTorque(), reference=None, reference_pulses=None, error_pulses=-made.counts
    )
    assert bare.check().causes == ()


def test_two_mistakes_at_once_are_both_named(record):
    both = with_torque(with_reference(record, record.reference_pulses[:, ::-1]), 4 * record.torque)
    checkup = both.check()
    assert {"exchanged references", "torque scale"} <= {cause.name for cause in checkup.causes}
    np.testing.assert_array_equal(checkup.corrected.reference_pulses, record.reference_pulses)


def test_a_hypothesis_of_a_users_own_is_ranked_beside_the_others(record):
    limit = record.rig.drive.torque_limit()
    share = Hypothesis(
        name="share of the limit",
        sentence="The torque is a share of the limit",
        remedy="Multiply it.",
        undo=lambda record, joints, size: with_torque(record, limit * record.torque),
    )
    checkup = with_torque(record, record.torque / limit).check(hypotheses=[share])
    assert checkup.causes[0].name == "share of the limit"
    np.testing.assert_allclose(checkup.corrected.torque, record.torque)


@pytest.mark.parametrize("size", [1.0, 2**0.5])
def test_a_magnitude_without_sign_gets_the_sign_of_the_law(record, size):
    """The RMS of a phase current has no sign, and is the smaller by the peak of a sine."""
    rig = record.rig
    current = rig.drive.motor_torque(record.torque) / rig.drive.motor_gain
    logged = dataclasses.replace(record, torque=None, current=np.abs(current) / size)
    checkup = logged.check()
    assert (checkup.causes[0].name, checkup.causes[0].size) == ("torque without sign", size)
    assert checkup.problems[0].check == "units of torque"
    np.testing.assert_allclose(
        checkup.first_corrected.current, current, atol=1e-3 * np.ptp(current)
    )


def test_per_mille_of_the_rated_torque_is_one_cause_of_all_joints(record):
    """One share of different limits explains other factors at each joint."""
    share = 0.3
    rated = share * record.rig.drive.torque_limit()
    checkup = with_torque(record, 1e3 * record.torque / rated).check()
    cause = checkup.causes[0]
    assert (cause.name, cause.joints) == ("torque per mille of the rated one", ())
    assert cause.size == pytest.approx(share, rel=0.02)
    assert len(checkup.causes) == 1


def test_one_factor_of_all_torques_is_a_scale(record):
    """It leaves no share of the limits that is alike."""
    cause = with_torque(record, 7.0 * record.torque).check().causes[0]
    assert cause.name == "torque scale"


def test_hypotheses_that_fail_or_change_nothing_are_named_and_the_others_go_on(record):
    def refuse(record, joints, size):
        raise ValueError("this log has no such column.")

    def broken(record, joints, size):
        return record.no_such_field

    def without_return(record, joints, size):
        record.torque.copy()

    words = {"sentence": "Something is wrong", "remedy": "Look.", "scope": each_joint}
    own = [
        Hypothesis(name="nothing", undo=lambda record, joints, size: record, **words),
        Hypothesis(name="refused", undo=refuse, **words),
        Hypothesis(name="broken", undo=broken, **words),
        Hypothesis(name="forgetful", undo=without_return, **words),
    ]
    checkup = with_torque(record, -record.torque).check(hypotheses=own)
    assert checkup.causes[0].name == "turned torque of all joints"
    assert [line.partition(":")[0] for line in checkup.failed] == [
        "nothing",
        "refused",
        "broken",
        "forgetful",
    ]
    assert "undo" in checkup.failed[-1]


WORDS = {"name": "mine", "sentence": "Something is wrong", "remedy": "Look."}


@pytest.mark.parametrize(
    ("field", "value"), [("undo", None), ("undo", "negate"), ("scope", "each_joint")]
)
def test_what_must_be_a_function_is_refused_by_its_field(field, value):
    with pytest.raises(ValueError, match="mine") as error:
        Hypothesis(**({"undo": lambda record, joints, size: record} | WORDS | {field: value}))
    assert field in str(error.value)
    assert repr(value) in str(error.value)


@pytest.mark.parametrize("several", [False, True])
def test_hypotheses_that_are_no_list_of_them_are_refused(record, several):
    mine = Hypothesis(undo=lambda record, joints, size: record, **WORDS)
    with pytest.raises(ValueError, match="hypotheses"):
        record.check(hypotheses=["delay", mine] if several else mine)


@pytest.mark.parametrize("field", ["{size:g}", "{value:d}", "{value", "{}", "{joint.name}"])
def test_a_field_that_no_sentence_has_is_named_where_it_is_written(field):
    sentence = f"The torque is {field} times too large"
    with pytest.raises(ValueError, match="misspelt") as error:
        Hypothesis(
            name="misspelt",
            undo=lambda record, joints, size: record,
            sentence=sentence,
            remedy="Halve it.",
        )
    assert all(name in str(error.value) for name in (sentence, "joint", "value"))


@pytest.mark.parametrize("rate", [0.0, pytest.param(0.004, marks=pytest.mark.slow)])
def test_a_pid_that_is_stated_without_its_derivative_lacks_the_rate(rate):
    gain = np.array((0.1, 0.08))
    law = PID(
        gain=gain, integral=5 * gain, derivative=rate * gain, filter=2000.0, period=RIG.period
    )
    arm = puma560.literature_arm(0.7)
    made = simulate(arm, RIG, law, PATH, duration=2.0, steps_per_sample=8)
    stated = dataclasses.replace(law, derivative=(0.0, 0.0))
    causes = dataclasses.replace(made, law=stated, current=None).check().causes
    sizes = [(cause.name, cause.joints, pytest.approx(cause.size, rel=0.1)) for cause in causes]
    assert sizes == ([("rate of the error", (), rate)] if rate else [])


@pytest.mark.parametrize("logged", [True, False])
def test_a_path_in_degrees_is_no_unit_of_the_counts(record, logged):
    """Its amplifier is at its limit, so the counts follow no multiple of the reference."""
    degrees = dataclasses.replace(
        PATH,
        offset=np.rad2deg(PATH.offset),
        cosine=np.rad2deg(PATH.cosine),
        sine=np.rad2deg(PATH.sine),
    )
    arm, law = puma560.literature_arm(0.7), puma560.p_law((0.13, 0.09))
    with pytest.warns(UserWarning, match="turns"):
        made = simulate(arm, RIG, law, degrees, duration=2.0)
    torque = made.torque if logged else None
    checkup = dataclasses.replace(made, torque=torque, current=None).check()
    assert checkup.causes == ()
    slopes = [finding for finding in checkup.problems if finding.check == "gear sign"]
    assert [slope.joint for slope in slopes] == [0, 1]
    assert all("limit in 99" in slope.advice and "degrees" in slope.advice for slope in slopes)


def test_whole_pulses_per_turn_tell_radians_from_lines(record):
    """No other measurement does: 4 and 2 pi times the stated resolution explain a motion alike."""
    mistaken = in_pulses_per_radian(dataclasses.replace(record, torque=None))
    cause = mistaken.check().causes[0]
    assert (cause.name, cause.rivals) == ("resolution per radian", ())
    assert cause.runner_up.name == "lines of the encoder"


@pytest.mark.slow
def test_lines_of_one_encoder_are_put_right(record):
    checkup = in_lines(record, 1).check()
    cause = checkup.causes[0]
    assert (cause.name, cause.joints, cause.size) == ("lines of the encoder", (1,), 4.0)
    stated, right = (each.rig.encoder.resolution for each in (checkup.corrected, record))
    np.testing.assert_allclose(stated, right)


def test_a_changed_torque_is_compared_with_its_own_motion_alone(record, monkeypatch):
    """What a hypothesis leaves as it is costs no second regression, and no second run of the
    law.
    """
    calls = []
    for place, name in ((score.Motion, "of"), (score, "_following"), (score, "commanded_torque")):
        made = getattr(place, name)
        monkeypatch.setattr(
            place, name, lambda *a, name=name, made=made, **b: calls.append(name) or made(*a, **b)
        )
    experiment = score.Experiment(record)
    before = experiment.score
    assert sorted(calls) == ["_following"] * 2 + ["commanded_torque"] + ["of"] * 2
    calls.clear()
    changed = experiment.changed(with_torque(record, record.torque * (1.0, 2.0)))
    assert changed.score < before
    assert calls == ["of"]


@pytest.mark.filterwarnings("ignore:joint q")
def test_counts_that_rest_beside_their_reference_do_not_turn_the_error():
    """A path in degrees takes the amplifier to its limit: turned, the counts move twice as far."""
    scale = 180 / np.pi
    path = dataclasses.replace(
        PATH,
        **{name: scale * np.array(getattr(PATH, name)) for name in ("offset", "cosine", "sine")},
    )
    log = simulate(puma560.literature_arm(0.7), RIG, puma560.p_law(), path, duration=3.1)
    log = dataclasses.replace(log, torque=None, current=None, true_q=None, true_qd=None)
    names = [cause.name for cause in log.check().causes]
    assert "turned error of all joints" not in names
    turned = undo.turned_error(log, (0, 1), 1.0)
    np.testing.assert_array_equal(score.Experiment(turned).tracking, 1.0)


@pytest.mark.filterwarnings("error")
def test_a_drive_without_a_limit_has_no_share_of_it(record):
    """Its per cent were an infinite torque, and zero times that no number."""
    drive = dataclasses.replace(record.rig.drive, current_limit=(np.inf, np.inf))
    endless = dataclasses.replace(record, rig=dataclasses.replace(record.rig, drive=drive))
    assert endless.check().causes == ()


@pytest.mark.parametrize(
    "fields",
    [
        {"sizes": 2.0},
        {"sizes": ()},
        {"sizes": "a"},
        {"sizes": (1.0, np.nan)},
        {"tolerance": 0.0},
        {"tolerance": "a"},
        {"against": -3},
        {"against": np.nan},
        {"against": "a"},
        {"sentence": "{value[0]} times"},
    ],
)
def test_numbers_of_a_hypothesis_are_tried_where_it_is_written(fields):
    with pytest.raises(ValueError, match="mine"):
        Hypothesis(**({"undo": lambda record, joints, size: record} | WORDS | fields))


def test_sizes_may_be_a_list_or_a_grid():
    for sizes in ([1.0, 2.0], np.linspace(1, 2, 2)):
        row = Hypothesis(undo=lambda record, joints, size: record, sizes=sizes, **WORDS)
        assert row.sizes == (1.0, 2.0)


def test_evidence_that_is_no_number_hides_no_other_cause(record):
    odd = Hypothesis(
        undo=lambda record, joints, size: with_torque(record, 2 * record.torque),
        evidence=lambda experiment, joints: [(1.0, np.nan)],
        **WORDS,
    )
    checkup = with_torque(record, -record.torque).check(hypotheses=[odd])
    assert checkup.causes[0].name == "turned torque of all joints"


@pytest.mark.parametrize("field", ["gain", "variant", "gravity"])
def test_a_field_that_only_an_arm_fills_is_empty_without_one(record, field):
    words = WORDS | {"sentence": f"It is turned{{{field}}}", "against": 0.0}
    mine = Hypothesis(
        undo=lambda record, joints, size: with_torque(record, -record.torque), **words
    )
    checkup = with_torque(record, -record.torque).check(hypotheses=[mine])
    assert "It is turned" in [cause.sentence for cause in checkup.causes]


def test_a_sentence_with_a_full_stop_gets_no_second_one():
    words = {"name": "x", "joints": (), "size": 1.0, "unit": "", "log_odds": 9.0}
    rival = Rival("y", (), 1.0, 8.0, "Weigh it.")
    other = Rival("z", (), 1.0, 8.0, "Log slowly")
    cause = Cause(sentence="It is odd.", remedy="Mend it.", rivals=(rival, other), **words)
    assert cause.line == (
        "It is odd (odds 1e4). The log cannot distinguish this from: y, z. Weigh it. Log slowly."
        " Mend it."
    )


@pytest.mark.parametrize(
    ("own", "following", "said"),
    [
        (9.0, 3.0, "1e4; next: y, 1e1"),
        (9.0, 8.5, "1e4; next: y, nearly as likely"),
        (9.0, 9.0, "1e4; next: y, nearly as likely"),
        (2000.0, 1994.0, "over 1e99; next: y, less likely by 1e3"),
        (2000.0, 1000.0, "over 1e99; next: y, less likely by over 1e99"),
    ],
)
def test_odds_and_those_of_the_next_cause_differ(own, following, said):
    words = {"name": "x", "joints": (), "size": 1.0, "unit": "", "sentence": "", "remedy": ""}
    cause = Cause(log_odds=own, runner_up=Rival("y", (), 1.0, following), **words)
    assert cause.odds == said


@pytest.mark.parametrize(
    ("turned", "subject"),
    [
        ("counts", "The counts of joint q[1] have "),
        ("error", "The error of joint q[1] has "),
        ("both", "The errors of all joints have "),
    ],
)
def test_the_sentence_of_a_turned_column_has_the_number_of_its_subject(record, turned, subject):
    error = record.error_pulses * ((-1, -1) if turned == "both" else (1, -1))
    if turned == "counts":
        counts = record.counts * (1, -1)
        error = record.reference_pulses - counts
    cause, *_ = dataclasses.replace(record, error_pulses=error).check().causes
    assert cause.sentence.startswith(subject)


@pytest.mark.parametrize(("ratio", "factors"), [(40, []), (100, []), (1e3, [1e3])])
def test_a_unit_of_time_is_near_a_power_of_a_thousand(record, ratio, factors):
    """A log of every fortieth row is in seconds."""
    causes = dataclasses.replace(record, t=record.t * ratio).check().causes
    assert [cause.size for cause in causes if cause.name == "unit of time"] == factors


def test_currents_of_coupled_motors_become_torques_of_the_joints():
    coupling = Coupling(matrix=((1, 0), (1, 1)))
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(DRIVE, coupling=coupling))
    links = tuple(
        Link(name=name, alpha=alpha, a=a, d=0.0)
        for name, alpha, a in (("2", -np.pi / 2, 0.0), ("3", 0.0, 0.4318))
    )
    bodies = tuple(
        Body(mass=mass, com=com, inertia=(0, 0, 0, 0, 0, izz))
        for mass, com, izz in ((17.4, (0.068, 0.006, 0), 0.539), (6.0, (0, -0.14, 0), 0.3))
    )
    chain = Chain(links=links, bodies=bodies, coupling=coupling).with_rotors(rig.drive)
    dynamics = Dynamics.from_chain(chain)
    law = puma560.p_law((0.12, 0.09))
    made = simulate(dynamics.arm(dynamics.f()), rig, law, puma560.reference(), duration=2.0)
    checkup = dataclasses.replace(made, torque=rig.drive.current(made.torque), current=None).check()
    assert [cause.name for cause in checkup.causes] == ["torque a motor current in A"]
    np.testing.assert_allclose(checkup.corrected.torque, made.torque, atol=1e-9)

"""A statement of the chain or of the log that the torques contradict is named; right logs are not."""

import dataclasses
import re
from functools import cache

import numpy as np
import pytest
from packaged_arms import elbow_of_a_ur5e
from random_rigs import drawn

from ctc import ComputedTorque
from identification.equation_error import (
    HYPOTHESES,
    TorqueEquation,
    contradictions,
    mistakes_of,
    regressor_along,
    restated,
    restatements,
)
from identification.results import Detection, Sign
from plant import (
    PID,
    Body,
    Cascade,
    Chain,
    Dynamics,
    Harmonics,
    Link,
    P,
    Placement,
    Spline,
    puma560,
    simulate,
)
from plant.checkup import counts_in_time
from plant.motion import Motion

CHAIN = Chain(links=(Link(name="2", alpha=-np.pi / 2), Link(name="3", a=puma560.LINK_LENGTH)))
DYNAMICS = Dynamics.from_chain(CHAIN)


@cache
def log():
    return simulate(
        puma560.literature_arm(1.5), puma560.rig(), puma560.p_law(), puma560.reference()
    )


def test_a_right_log_is_not_restated():
    assert restated(DYNAMICS, log()) == ()
    assert restated(DYNAMICS, dataclasses.replace(log(), torque=None, current=None)) == ()


@pytest.mark.parametrize(("begin", "end"), [(0.9, 1.5), (2.5, 2.88)])
def test_a_log_too_short_for_friction_turns_no_torque(begin, end):
    """Friction of many times the power of the torques neither drives nor brakes the motion."""
    dynamics = puma560.dynamics()
    law = PID(
        gain=(0.1, 0.08), derivative=(4e-4, 3e-4), integral=(0.5, 0.4), filter=2000.0, period=7e-4
    )
    record = simulate(
        puma560.literature_arm(1.5),
        puma560.rig(),
        law,
        puma560.reference(),
        duration=3.5,
        steps_per_sample=16,
    )
    record = dataclasses.replace(record.cut(begin, end), torque=None, current=None)
    fitted = TorqueEquation.of(dynamics, record).fitted
    # Its value alone would drive; its deviation is as large.
    assert fitted.power < -5
    assert restated(dynamics, record) == ()


def held():
    """A log in which joint 3 is asked for 20 pulses, and friction holds it beside them."""
    path = puma560.reference()(np.linspace(0, 3.65, 200)).q
    little = Harmonics(
        period=3.65,
        offset=path.mean(axis=0),
        cosine=((-0.6, 0.1), (1e-3, 0.0)),
        sine=((0.3, 0.1), (0.0, 5e-4)),
    )
    return simulate(puma560.literature_arm(1.5), puma560.rig(), puma560.p_law((0.1, 0.03)), little)


def test_what_friction_holds_tells_no_sign():
    """Its torque may be any that friction can carry."""
    record = held()
    other = dataclasses.replace(record, torque=record.torque * (1.0, -3.0), current=None)
    left = [TorqueEquation.of(DYNAMICS, held).left for held in (record, other)]
    assert left[0] == pytest.approx(left[1], rel=1e-6)
    (sign,) = (
        each for each in record.check().findings if each.check == "gear sign" and each.joint == 1
    )
    assert sign.verdict == "cannot tell: the reference hardly moves"


def test_gravity_the_other_way_is_named():
    wrong = dataclasses.replace(CHAIN, gravity=(0.0, 0.0, 9.81))
    (said,) = restated(Dynamics.from_chain(wrong), log())
    assert said.line.startswith(
        "gravity acts the other way. So stated, the equation of motion leaves "
    )


def test_a_joint_that_turns_the_other_way_is_named():
    turned = np.array((1.0, -1.0))
    columns = {
        name: turned * getattr(log(), name)
        for name in ("error_pulses", "reference_pulses", "torque")
    }
    wrong = dataclasses.replace(
        log(), current=None, reference=None, true_q=None, true_qd=None, **columns
    )
    (said,) = restated(DYNAMICS, wrong)
    assert said.line.startswith(
        "joint 3 (q[1]) turns the other way: its axis, or the signs of all its columns, are wrong."
    )


def test_a_zero_by_a_right_angle_is_named():
    """Along a fast motion: of a slow one f takes the turn of gravity over."""
    path = Harmonics(
        period=2.5,
        offset=(0.3, -0.5),
        cosine=((0.6, 0.1), (0.2, 0.6)),
        sine=((0.1, -0.6), (0.6, 0.1)),
    )
    fast = simulate(puma560.literature_arm(1.5), puma560.rig(), puma560.p_law((0.1, 0.08)), path)
    equation = TorqueEquation.of(DYNAMICS, fast)
    q = equation.motion.q + np.array([np.pi / 2, 0.0])
    wrong = dataclasses.replace(equation, motion=equation.motion._replace(q=q))
    cause, *_ = contradictions(wrong)
    assert (cause.name, cause.joints, cause.size) == ("joint zero", (0,), 90.0)


def waist():
    """A run of a waist, which turns about the vertical, and a shoulder."""
    inertia = (0.5, 0.5, 0.5, 0.0, 0.0, 0.0)
    bodies = (
        Body(mass=10.0, com=(0.1, 0.0, 0.0), inertia=inertia, rotor=0.0),
        Body(mass=12.0, com=(0.3, 0.05, 0.0), inertia=inertia, rotor=0.0),
    )
    chain = Chain(links=(Link(name="1"), Link(name="2", alpha=-np.pi / 2)), bodies=bodies)
    path = Harmonics(
        period=3.0,
        offset=(0.2, -0.3),
        cosine=((0.5, 0.1), (0.2, 0.4)),
        sine=((0.1, -0.3), (0.5, 0.1)),
    )
    rig = puma560.rig()
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    return chain, simulate(dynamics.arm(dynamics.f()), rig, puma560.p_law((0.1, 0.08)), path)


def test_a_base_that_is_tilted_is_named_with_its_angle():
    """By 45 degrees: gravity acts on the waist too. It is no zero of a joint."""
    chain, record = waist()
    assert restated(Dynamics.from_chain(chain.with_rotors(record.rig.drive)), record) == ()
    angle = np.deg2rad(45)
    leaning = dataclasses.replace(chain, gravity=(9.81 * np.sin(angle), 0, -9.81 * np.cos(angle)))
    cause, *_ = restated(Dynamics.from_chain(leaning.with_rotors(record.rig.drive)), record)
    assert (cause.name, cause.joints) == ("tilted base", ())
    assert cause.size == pytest.approx(45, abs=5)
    # The record was made under gravity along z.
    said = re.search(r"gravity=\((.*), (.*), (.*)\)", cause.remedy)
    np.testing.assert_allclose([float(x) for x in said.groups()], (0, 0, -9.81), atol=0.9)
    assert "-0.00" not in cause.remedy


def elbow():
    """Shoulder lift and elbow of a UR5e, and a run of them; f of any value takes gravity over."""
    chain, rig = elbow_of_a_ur5e("fix")
    dynamics = Dynamics.from_chain(chain.with_rotors(rig.drive))
    path = Harmonics(
        period=2.7,
        offset=(0.1, -0.1),
        cosine=((0.3, 0.1), (0.2, -0.15)),
        sine=((-0.2, 0.1), (0.3, 0.1)),
    )
    record = simulate(dynamics.arm(dynamics.f()), rig, P(gain=(0.042, 0.0153)), path)
    return chain, dynamics, record


def test_what_f_takes_over_contradicts_the_stated_bodies():
    """A tilt of the base by 15 degrees, and a zero by a right angle: little is left of either."""
    chain, dynamics, record = elbow()
    assert restated(dynamics, record) == ()
    angle = np.deg2rad(15)
    gravity = (9.81 * np.sin(angle), 0, -9.81 * np.cos(angle))
    leaning = dataclasses.replace(chain, gravity=gravity).with_rotors(record.rig.drive)
    equation = TorqueEquation.of(dynamics, record)
    q = equation.motion.q + np.array([0.0, np.pi / 2])
    turned = dataclasses.replace(equation, motion=equation.motion._replace(q=q))
    tilted = TorqueEquation.of(Dynamics.from_chain(leaning), record)
    assert max(tilted.left, turned.left) < 0.02
    cause, *_ = contradictions(tilted)
    assert (cause.name, cause.size) == ("tilted base", pytest.approx(15, abs=3))
    cause, *_ = contradictions(turned)
    assert (cause.name, cause.joints, cause.size) == ("joint zero", (1,), 90.0)


def test_friction_of_the_other_side_of_the_gears_is_named_beside_the_torque_of_a_law():
    """It is the rig that is wrong: what a law commands drives the motors, friction and all."""
    drive = log().rig.drive
    joint_side = dataclasses.replace(drive, viscous=drive.viscous * drive.gear**2)
    rig = dataclasses.replace(log().rig, drive=joint_side)
    record = dataclasses.replace(log(), rig=rig, torque=None, current=None)
    (cause,) = restated(DYNAMICS, record)
    assert cause.name == "overstated friction"
    logged = dataclasses.replace(log(), rig=rig)
    assert restated(DYNAMICS, logged)[0].name == "torques without friction"


def test_a_torque_without_friction_is_named():
    chain, record = waist()
    equation = TorqueEquation.of(Dynamics.from_chain(chain.with_rotors(record.rig.drive)), record)
    drive = equation.rig.drive
    speed = equation.motion.qd
    dry = np.abs(equation.dry) * np.sign(speed)
    friction = drive.joint_viscous() * speed + drive.joint_coulomb() * dry
    (cause,) = contradictions(equation.with_torque(equation.torque - friction))
    assert cause.name == "torques without friction"
    # half of it is within what drives differ by
    assert contradictions(equation.with_torque(equation.torque - friction / 2)) == ()


@cache
def bodied():
    """The run of the waist as an equation, of a chain that states its bodies."""
    chain, record = waist()
    return TorqueEquation.of(Dynamics.from_chain(chain.with_rotors(record.rig.drive)), record)


@pytest.mark.parametrize("factor", [0.2, 1.96, 4.0])
def test_a_torque_in_another_unit_is_named_by_what_the_bodies_need(factor):
    equation = bodied()
    assert equation.scale == pytest.approx(1, abs=0.02)
    (cause,) = contradictions(equation.with_torque(factor * equation.torque))
    assert (cause.name, cause.joints) == ("torque scale", ())
    assert cause.size == pytest.approx(factor, rel=0.02)
    # A fifth is within what bodies are wrong by.
    assert contradictions(equation.with_torque(1.2 * equation.torque)) == ()


def test_gravity_of_other_bodies_that_was_taken_out_is_named():
    """A driver that takes out too much: with f of any value the rest is gravity of its own."""
    equation = bodied()
    dynamics = equation.dynamics
    resting = Motion(equation.motion.q, *2 * [0 * equation.motion.q])
    Y = regressor_along(dynamics, equation.rig, dynamics.names, resting)[0]
    without = equation.with_torque(equation.torque - 1.1 * Y @ dynamics.f())
    cause, *_ = contradictions(without)
    assert cause.name == "gravity removed"


@pytest.mark.parametrize("factor", [180 / np.pi, 0.5 / np.pi])
def test_positions_in_another_unit_are_named(factor):
    chain, record = waist()
    equation = bodied()
    scaled = Motion(*(factor * signal for signal in equation.motion))
    cause, *_ = contradictions(dataclasses.replace(equation, motion=scaled))
    assert cause.name == "unit of positions"
    assert cause.size == pytest.approx(factor)


@pytest.mark.slow
def test_no_unit_leaves_a_motion_of_a_degree():
    """A motion along one line is the more linear, the smaller it is stated."""
    case = drawn(20)
    equation = TorqueEquation.of(case.dynamics, case.record)
    smaller = restatements.in_unit(equation, (), 180 / np.pi)
    assert smaller.evidence - equation.evidence > 10.0
    assert contradictions(equation) == ()


@pytest.mark.parametrize(
    ("name", "sign", "commanded"),
    [
        ("late torques", 1, False),
        ("late counts", -1, False),
        # No column of torques can be late that was not logged: the law lags.
        ("law without rate", 1, True),
        ("late counts", -1, True),
    ],
)
def test_columns_that_are_late_by_some_samples_are_named(name, sign, commanded):
    equation = dataclasses.replace(bodied(), commanded=commanded)
    period = equation.rig.period
    late = np.roll(equation.torque, sign * round(0.02 / period), axis=0)
    cause, *_ = contradictions(equation.with_torque(late))
    assert (cause.name, cause.size) == (name, 20.0)
    # One sample is the logger's.
    later = np.roll(equation.torque, 1, axis=0)
    assert contradictions(equation.with_torque(later)) == ()


def test_a_joint_at_rest_says_nothing_about_signs():
    """Friction carries any torque there: another one changes nothing that is compared."""
    path = Spline(times=(0.0, 0.4, 0.8), points=((0.0, 0.0), (0.5, -0.4), (0.2, 0.3)))
    record = simulate(
        puma560.literature_arm(1.5), puma560.rig(), puma560.p_law(), path, duration=2.0
    )
    equation = TorqueEquation.of(DYNAMICS, record)
    resting = np.abs(equation.dry) < 1e-3
    assert resting.mean() > 0.3
    other = equation.with_torque(np.where(resting, -30.0, equation.torque))
    assert other.left == pytest.approx(equation.left, rel=1e-9)
    assert contradictions(other) == ()


def test_a_friction_that_the_log_does_not_determine_accuses_no_sign():
    """In a short log the friction of a joint comes out negative by chance."""

    def evidence(power, std):
        equation = TorqueEquation.of(DYNAMICS, log())
        by_joint = np.array([power, equation.fitted.power_by_joint[1]])
        fitted = equation.fitted._replace(power_by_joint=by_joint, power_std=np.array([std, 0.01]))
        equation.__dict__["fitted"] = fitted
        return equation.evidence

    assert evidence(-0.8, 0.5) == evidence(0.2, 0.5)
    assert evidence(-0.8, 0.05) < evidence(0.2, 0.05) - 10


def test_two_mistakes_at_once_are_named_one_after_the_other():
    torque = log().torque[:, ::-1]
    wrong = dataclasses.replace(log(), current=None, torque=torque)
    upward = Dynamics.from_chain(dataclasses.replace(CHAIN, gravity=(0.0, 0.0, 9.81)))
    causes = contradictions(TorqueEquation.of(upward, wrong))
    assert [cause.name for cause in causes] == ["exchanged torques", "gravity direction"]


def test_signs_are_named_where_a_sampled_law_tells_the_torque():
    """Nothing is logged of it, and what the law has integrated before is unknown."""
    law = PID(
        gain=(0.1, 0.075),
        integral=(0.5, 0.4),
        derivative=(4e-4, 3e-4),
        filter=2000.0,
        period=0.7e-3,
    )
    made = simulate(puma560.literature_arm(1.5), puma560.rig(), law, puma560.reference())
    record = dataclasses.replace(made, torque=None, current=None)
    assert restated(DYNAMICS, record) == ()
    wrong = dataclasses.replace(CHAIN, gravity=(0.0, 0.0, 9.81))
    assert [said.line[:15] for said in restated(Dynamics.from_chain(wrong), record.cut(0.4))] == [
        "gravity acts th"
    ]
    turned = {
        name: np.array((1.0, -1.0)) * getattr(record, name)
        for name in ("error_pulses", "reference_pulses")
    }
    log = dataclasses.replace(record, reference=None, true_q=None, true_qd=None, **turned)
    assert [said.line[:30] for said in restated(DYNAMICS, log)] == [
        "joint 3 (q[1]) turns the other"
    ]


def test_a_cause_that_explains_nearly_as_much_is_told():
    values = {"offset[0]": 0.02, "offset[1]": 0.0}
    sign = Sign(
        name="offset",
        chi_square=99.0,
        freedom=2,
        threshold=23.0,
        explained=9.0,
        values=values,
        visible={},
    )
    alone, beside = (dataclasses.replace(sign, rivals=rivals) for rivals in ((), ("gear",)))
    assert "Another cause" not in next(Detection(named=(alone,), joints=("a", "b")).warnings())
    said = next(Detection(named=(beside,), joints=("a", "b")).warnings())
    assert "The log cannot distinguish this from: gear." in said
    assert said.endswith("To tell causes apart, log the same motion in both directions.")


def test_a_place_in_millimetres_is_refused():
    with pytest.raises(
        ValueError, match=r"before.position of link 3 .* got 425. Divide by 1000 what is in mm"
    ):
        Link(name="3", before=Placement(position=(-425.0, 0.0, 0.0)))


@pytest.mark.slow
def test_a_spring_that_the_rig_states_tilts_no_base():
    """Its torque is none of gravity's, and its stiffness is seldom exact."""
    case = drawn(63, torque=True)
    springs = case.record.rig.springs
    assert springs.stiffness > 0
    for factor in (1.0, 0.8):
        stated = dataclasses.replace(springs, stiffness=factor * springs.stiffness)
        rig = dataclasses.replace(case.record.rig, springs=stated)
        assert not restated(case.dynamics, dataclasses.replace(case.record, rig=rig))


PID_LAW = PID(
    gain=(0.1, 0.08), derivative=(4e-4, 3e-4), integral=(0.5, 0.4), filter=2000.0, period=7e-4
)


@pytest.mark.parametrize("samples", [0.8, 1.9])
def test_late_counts_of_a_law_with_memory_are_named_with_their_time(samples):
    """Its torque follows from the counts: late ones were taken for a joint that turns."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    right = simulate(arm, rig, PID_LAW, puma560.reference(), duration=2.0)
    late = counts_in_time(right, (), -samples)
    counts_alone = dataclasses.replace(late, torque=None, current=None)
    cause, *_ = restated(arm.dynamics, counts_alone)
    assert cause.name == "late counts of a law"
    assert cause.size == pytest.approx(samples, abs=0.5)


def test_a_right_log_of_a_law_with_memory_is_not_restated():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    right = simulate(arm, rig, PID_LAW, puma560.reference(), duration=2.0)
    assert restated(arm.dynamics, dataclasses.replace(right, torque=None, current=None)) == ()


CASCADE = Cascade(
    position=(60.0, 60.0), speed=(1e-3, 8e-4), integral=(0.05, 0.04), difference=2, period=7e-4
)


@pytest.mark.parametrize("law", [PID_LAW, CASCADE], ids=["PID", "cascade"])
@pytest.mark.parametrize("end", [1.5, 2.2])
def test_a_short_right_log_that_begins_within_a_motion_is_not_restated(law, end):
    """The state of the law before the log is unknown, and so is its torque where it saturates."""
    arm = puma560.literature_arm(1.5)
    whole = simulate(arm, puma560.rig(), law, puma560.reference(), duration=end)
    cut = dataclasses.replace(whole, torque=None, current=None).cut(0.437)
    assert restated(arm.dynamics, cut) == ()


def turned(record, sign=(1.0, -1.0)):
    """The record whose counts and references have other signs; nothing else is logged."""
    columns = {
        name: np.array(sign) * getattr(record, name)
        for name in ("error_pulses", "reference_pulses")
    }
    rest = dict.fromkeys(("reference", "true_q", "true_qd", "torque", "current"))
    return dataclasses.replace(record, **rest, **columns)


def stated(record, **numbers):
    return dataclasses.replace(record, law=dataclasses.replace(record.law, **numbers))


def test_a_joint_that_turns_is_named_beside_gains_that_are_not_stated():
    """Alone the turn explains less than is against it."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    random = np.random.default_rng(3)
    cosine, sine = (random.normal(size=(2, 3)) * 0.35 / np.arange(1, 4) for _ in range(2))
    path = Harmonics(period=2.7, offset=(0.1, -0.1), cosine=cosine, sine=sine)
    right = simulate(arm, rig, PID_LAW, path, duration=3.0)
    equation = TorqueEquation.of(DYNAMICS, stated(turned(right), gain=0.6 * PID_LAW.gain))
    row = next(row for row in HYPOTHESES if row.name == "joint sign")
    alone = restatements.turned(equation, (1,), 1.0).evidence - equation.evidence
    assert alone < row.against
    cause, *_ = contradictions(equation)
    assert (cause.name, cause.joints) == ("joint sign", (1,))


def ur5e_log(law):
    """Dynamics and log of the elbow of a UR5e under a law; the counts alone are logged."""
    _, dynamics, made = elbow()
    arm = dynamics.arm(dynamics.f())
    record = simulate(arm, made.rig, law(arm, made.rig), made.reference, duration=2.7)
    return dynamics, dataclasses.replace(record, torque=None, current=None)


def elbow_pid(arm, rig):
    gain = np.array((0.04, 0.015))
    return PID(gain=gain, integral=5 * gain, derivative=0.004 * gain, filter=2000.0, period=1e-3)


def test_gains_of_a_pid_that_are_not_stated_are_named_with_their_size():
    dynamics, right = ur5e_log(elbow_pid)
    assert restated(dynamics, right) == ()
    wrong = stated(right, gain=right.law.gain / 1.4)
    cause, *_ = restated(dynamics, wrong)
    assert cause.name == "law gain"
    assert cause.size == pytest.approx(40, abs=4)
    corrected = mistakes_of(dynamics, wrong).corrected
    np.testing.assert_allclose(corrected.law.gain, right.law.gain, rtol=0.03)


def test_a_law_that_winds_up_along_late_counts_explains_nothing():
    """Its torque stays at the limit: a constant, which any f and offset explain."""
    dynamics, right = ur5e_log(elbow_pid)
    late = counts_in_time(right, (), -1.2)
    equation = TorqueEquation.of(dynamics, late)
    named = {
        restatements.words_of(equation, place)["variant"]
        for place, _ in restatements.other_variants(equation, ())
    }
    assert not any("anti_windup='none'" in words for words in named)
    assert restated(dynamics, late)[0].name == "late counts of a law"


def test_a_computed_torque_that_lacks_the_friction_of_the_stated_one_is_named():
    dynamics, right = ur5e_log(model_off(0.2))
    assert restated(dynamics, right) == ()
    wrong = stated(right, friction=False)
    cause, *_ = restated(dynamics, wrong)
    assert cause.name == "law variant"
    assert "that with friction=True" in cause.sentence
    assert mistakes_of(dynamics, wrong).corrected.law == right.law


@pytest.mark.slow
def test_the_bandwidth_of_a_computed_torque_and_a_zero_are_told_apart():
    """The law of a log with another zero is run anew: it knows gravity."""
    dynamics, right = ur5e_log(model_off(0.4))
    assert restated(dynamics, right) == ()
    cause, *_ = restated(dynamics, stated(right, bandwidth=60.0 / 0.75))
    assert (cause.name, cause.size) == ("law gain", pytest.approx(-25, abs=3))
    dynamics, right = ur5e_log(model_off(0.2))
    zero = np.round(right.rig.position_in_pulses((0.0, np.pi / 2)))
    moved = right.reference_pulses + zero
    wrong = dataclasses.replace(right, reference=None, reference_pulses=moved)
    cause, *_ = restated(dynamics, wrong)
    assert (cause.name, cause.joints, cause.size) == ("joint zero", (1,), 90.0)


def model_off(share):
    """A computed torque whose model is off by a share, so that it has errors to act on."""

    def law(arm, rig):
        signs = (-1.0) ** np.arange(len(arm.f))
        return ComputedTorque(arm.dynamics.arm(arm.f * (1 + share * signs)), rig, bandwidth=60.0)

    return law


@pytest.mark.parametrize(
    ("name", "joints", "size", "spoil"),
    [
        (
            "joint sign",
            (1,),
            1.0,
            lambda r: signed(r, "error_pulses", "reference_pulses", "torque"),
        ),
        ("torque sign", (1,), 1.0, lambda r: signed(r, "torque")),
        (
            "exchanged torques",
            (0, 1),
            1.0,
            lambda r: dataclasses.replace(r, torque=r.torque[:, ::-1]),
        ),
        ("law gain", (), 25.0, lambda r: stated(r, gain=r.law.gain / 1.25)),
    ],
)
def test_rows_undo_their_mistake_in_a_record(name, joints, size, spoil):
    arm = puma560.literature_arm(1.5)
    made = simulate(arm, puma560.rig(), PID_LAW, puma560.reference(), duration=0.3)
    bare = dict.fromkeys(("reference", "true_q", "true_qd", "current"))
    right = dataclasses.replace(made, **bare)
    row = next(row for row in HYPOTHESES if row.name == name)
    undone = row.of_record(spoil(right), joints, size)
    for column in ("error_pulses", "reference_pulses", "torque"):
        np.testing.assert_array_equal(getattr(undone, column), getattr(right, column))
    np.testing.assert_allclose(undone.law.gain, right.law.gain, rtol=1e-15)


def test_the_path_of_a_reference_is_corrected_with_its_counts():
    """A law that reads the path between its counts needs it."""
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    right = simulate(arm, rig, PID_LAW, path, duration=0.3)
    wrong = signed(right, "error_pulses", "reference_pulses", "torque")
    wrong = dataclasses.replace(wrong, reference=path.moved((1.0, -1.0), (0.0, 0.0)))
    rows = {row.name: row for row in HYPOTHESES}
    undone = rows["joint sign"].of_record(wrong, (1,), 1.0)
    np.testing.assert_allclose(undone.reference(right.t).q, path(right.t).q, atol=1e-15)
    shifted = rows["joint zero"].of_record(right, (0,), 90.0)
    pulses = rig.position_in_pulses(shifted.reference(right.t).q)
    assert np.abs(pulses - shifted.reference_pulses).max() < 1


def signed(record, *columns):
    sign = np.array((1.0, -1.0))
    return dataclasses.replace(record, **{name: sign * getattr(record, name) for name in columns})

"""A delay that an unknown can produce as well: both are named, and the correction is not advised."""

import dataclasses

import numpy as np
import pytest

from identification import identify, without_delay
from identification.results import Detection, Sign
from plant import Chain, Drive, Dynamics, Encoder, Harmonics, Link, P, Rig, puma560, simulate

GEAR = 2 * np.pi / 0.01  # motor angle per travel of the slide [rad/m]
DYNAMICS = Dynamics.from_chain(
    Chain(links=(Link(name="slide", prismatic=True),), gravity=(0.0, 0.0, 0.0))
)
RIG = Rig(
    drive=Drive(
        gear=(GEAR,),
        motor_inertia=(0.0,),
        motor_gain=(1.0,),
        current_limit=(50.0,),
        viscous=(900.0 / GEAR**2,),
        coulomb=(9.0 / GEAR,),
    ),
    encoder=Encoder(resolution=(20_000.0,)),
    period=1e-3,
)
PATH = Harmonics(period=3.0, offset=(0.1,), cosine=((-0.06, 0.01),), sine=((0.02, 0.02),))


def slide(delay):
    """A slide of 40 kg whose counts are late by so many samples."""
    # A loop of 8 Hz, in N m of the motor per pulse.
    gain = 40.0 * (16 * np.pi) ** 2 * (0.01 / 20_000) / GEAR
    law = P(gain=(gain,))
    record = simulate(DYNAMICS.arm([40.0]), RIG, law, PATH, duration=4.0, steps_per_sample=16)
    record = dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)
    return without_delay(record, -delay)


@pytest.mark.slow
def test_a_delay_that_viscous_friction_can_produce_is_not_corrected():
    unknown = ("drive.viscous[0]", "drive.coulomb[0]", *DYNAMICS.names)
    found = identify(
        DYNAMICS, slide(0.6), unknown=unknown, method="prediction_error", progress=False
    )
    delay = next(sign for sign in found.diagnostics.detection.signs if sign.name == "delay")
    assert delay.absorbing == ("drive.viscous[0]",)
    (cause,) = Detection(named=(delay,), joints=("slide",)).causes
    assert "another drive.viscous[0]" in cause.remedy
    assert "without_delay" not in cause.remedy
    told = Detection(named=(dataclasses.replace(delay, absorbing=()),), joints=("slide",)).causes
    assert "without_delay" in told[0].remedy
    assert not any("Identify without_delay" in text for text in found.warnings)


@pytest.mark.slow
def test_a_delay_is_corrected_where_no_unknown_can_produce_it():
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law((0.1, 0.08)), puma560.reference())
    record = dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)
    late = without_delay(record, -0.2)
    found = identify(puma560.dynamics(), late, method="prediction_error", progress=False)
    assert any("Identify without_delay(record, 0." in text for text in found.warnings), (
        found.warnings
    )
    assert not any(sign.absorbing for sign in found.diagnostics.detection.named)


def significant(name, values, visible):
    """A test that accepts an effect with these estimates."""
    return Sign(
        name=name,
        chi_square=99.0,
        freedom=len(values),
        threshold=25.0,
        explained=9.0,
        values=values,
        visible=visible,
    )


def test_cogging_of_which_the_log_tells_one_phase_alone_has_the_amplitude_of_that():
    sign = significant(
        "cogging",
        values={"cogging.1cos[0]": 0.3, "cogging.1sin[0]": 0.4, "cogging.1sin[1]": -0.2},
        visible={"cogging.1cos[0]": 0.1, "cogging.1sin[0]": 0.1, "cogging.1sin[1]": 0.1},
    )
    (cause,) = Detection(named=(sign,), joints=("slide", "swing")).causes
    assert cause.size == pytest.approx(0.5)
    assert cause.joints == (0, 1)


def test_a_cause_names_the_joints_that_the_log_shows():
    """Friction of all joints is estimated together; a value that is noise accuses no joint."""
    sign = significant(
        "gear",
        values={"gear[0]": 1e-5, "gear[1]": -0.05, "gear[2]": 2e-4},
        visible={"gear[0]": 1e-3, "gear[1]": 1e-3, "gear[2]": 1e-3},
    )
    joints = ("waist", "shoulder", "elbow")
    (cause,) = Detection(named=(sign,), joints=joints).causes
    assert (cause.joints, cause.size) == ((1,), pytest.approx(-5.0))
    assert "shoulder" in cause.sentence
    assert "waist" not in cause.sentence
    # Where no value alone is beyond its limit, all of them together are the finding.
    unclear = dataclasses.replace(sign, visible=dict.fromkeys(sign.values, 1.0))
    assert Detection(named=(unclear,), joints=joints).causes[0].joints == (0, 1, 2)


@pytest.mark.parametrize(("stated", "size", "unit"), [(0.2, 50.0, "%"), (0.0, 0.1, "N m")])
def test_friction_has_the_size_of_a_share_of_what_is_stated(stated, size, unit):
    sign = significant(
        "friction",
        values={"coulomb[0]": 0.1},
        visible={"coulomb[0]": 0.01},
    )
    detection = Detection(named=(sign,), joints=("waist",), stated={"coulomb[0]": stated})
    (cause,) = detection.causes
    assert (cause.size, cause.unit) == (pytest.approx(size), unit)


def sign_of(name, visible, chi_square=1.0, **fields):
    """The test of a cause, significant above a chi-square of 25."""
    return Sign(
        name=name,
        chi_square=chi_square,
        freedom=1,
        threshold=25.0,
        explained=9.0,
        values=dict.fromkeys(visible, 1.0),
        visible=visible,
        **fields,
    )


def shown(name, visible, **fields):
    """What a log without a sign of a cause says of it."""
    joints = ("waist", "shoulder", "elbow")
    detection = Detection(signs=(sign_of(name, visible),), joints=joints, **fields)
    return str(detection).removeprefix("no sign of ").split(". ")[0]


def test_friction_that_the_rig_states_as_zero_is_visible_in_its_own_unit():
    """No share of zero tells how small a friction the log would show."""
    visible = {"viscous[0]": 0.01, "coulomb[0]": 0.02, "coulomb[1]": 0.03, "coulomb[2]": 9.0}
    motor = "0.01 N m s/rad of the motor"
    assert shown("friction", {"viscous[0]": 0.01}) == f"other friction (detectable from {motor})"
    stated = {"viscous[0]": 0.0, "coulomb[0]": 0.2, "coulomb[1]": 0.0, "coulomb[2]": 3.0}
    spans = f"{motor} and 10 % and 0.03 N m of the motor"
    text = shown("friction", visible, stated=stated)
    assert text == f"other friction (detectable from {spans}, not at elbow)"


def test_a_hypothesis_without_a_visible_size_says_so():
    for name, title in (("compliance", "compliance"), ("offset", "an offset of the torque")):
        assert shown(name, {}) == f"{title} (none is detectable)"


@pytest.mark.parametrize(
    ("sizes", "span"),
    [
        ((0.996, 0.99), "99 to 100 %"),
        ((0.125, 0.0126), "1.3 to 12 %"),
        ((1e-7, 0.004), "less than 0.001 to 0.4 %"),
        ((1e-7, 1e-8), "less than 0.001 %"),
    ],
)
def test_both_ends_of_a_span_are_numbers_that_a_reader_needs(sizes, span):
    visible = {f"gear[{i}]": size for i, size in enumerate(sizes)}
    assert shown("gear", visible) == f"another gear (detectable from {span})"


def test_the_short_text_names_what_is_significant_without_a_cause():
    """As the long one does: the tolerances allow it, or its fit explains next to nothing."""
    unclear = sign_of("gear", {"gear[0]": 0.1}, 99.0)
    detection = Detection(signs=(unclear, sign_of("lag", {"lag": 1e-3})), joints=("waist",))
    assert "significant, but explaining next to nothing: gear" in str(detection)
    assert detection._short() == "2 tests, significant without a cause: gear"
    assert Detection(signs=detection.signs[1:])._short() == "1 tests, none significant"


def test_the_measurement_that_tells_apart_is_advised_once():
    visible = {"offset[0]": 0.1}
    telling = "log the same motion in both directions"
    for fields in ({"absorbing": ("f1",)}, {"rivals": ("gear",)}):
        both = {"absorbing": ("f1",), "rivals": ("gear",)}
        for given in (fields, both):
            sign = sign_of("offset", visible, 99.0, **given)
            (cause,) = Detection(named=(sign,), joints=("waist",)).causes
            assert cause.remedy.count(telling) == 1
    # A cause that knows no such measurement has that of every other one.
    cogging = sign_of("cogging", {"cogging.1cos[0]": 0.1}, 99.0, absorbing=("f1",))
    (cause,) = Detection(named=(cogging,), joints=("waist",)).causes
    assert cause.remedy.endswith("from another f1: log another motion")

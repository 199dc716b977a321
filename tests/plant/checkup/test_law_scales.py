"""Scales of torques and of single gains under laws with memory, whose torque is compared by steps."""

import dataclasses

import numpy as np
import pytest

from plant import PD, PID, Cascade, puma560, simulate

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
GAIN = puma560.p_law().gain
LAWS = {
    "PD": PD(gain=GAIN, derivative=4e-3 * GAIN, filter=2000.0, period=RIG.period),
    "PID": PID(
        gain=GAIN, derivative=4e-3 * GAIN, integral=5 * GAIN, filter=2000.0, period=RIG.period
    ),
    "cascade": Cascade(
        position=(60.0, 60.0),
        speed=4e-3 * GAIN,
        integral=0.05 * GAIN,
        filter=2000.0,
        period=RIG.period,
    ),
    "fast PID": PID(gain=GAIN, derivative=4e-3 * GAIN, integral=5 * GAIN, filter=2000.0),
}


@pytest.fixture(scope="module")
def logs():
    return {name: simulate(ARM, RIG, law, PATH, duration=1.5) for name, law in LAWS.items()}


def with_torque(record, torque):
    return dataclasses.replace(record, torque=torque, current=None)


@pytest.mark.parametrize("scale", [4.0, 0.3, 20.0])
def test_a_torque_in_another_scale_is_one_cause_with_its_value(logs, scale):
    """It would be beyond the amplifier's limit where the command is not."""
    record = logs["PID"]
    causes = with_torque(record, scale * record.torque).check().causes
    assert [(cause.name, cause.joints) for cause in causes] == [("torque scale", ())]
    assert causes[0].size == pytest.approx(scale, rel=1e-3)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_per_mille_of_a_rated_torque_is_one_cause(logs, share):
    record = logs["PID"]
    rated = share * RIG.drive.torque_limit()
    causes = with_torque(record, 1e3 * record.torque / rated).check().causes
    assert [cause.name for cause in causes] == ["torque per mille of the rated one"]
    assert causes[0].size == pytest.approx(share, rel=1e-3)


WRONG = [
    ("PD", "gain", 0.8, "gain alone"),
    ("PD", "derivative", 1.25, "derivative gain alone"),
    ("PID", "gain", 0.8, "gain alone"),
    ("PID", "gain", 1.25, "gain alone"),
    ("PID", "derivative", 0.8, "derivative gain alone"),
    ("PID", "integral", 2.0, "integral gain alone"),
    ("cascade", "position", 1.25, "position gain alone"),
    ("cascade", "speed", 0.8, "speed gain alone"),
]


@pytest.mark.parametrize(("law", "name", "factor", "cause_name"), WRONG)
@pytest.mark.parametrize("joints", [(), (0,)])
def test_one_gain_of_several_is_named_with_its_value(logs, law, name, factor, cause_name, joints):
    record = logs[law]
    factors = np.ones(record.n)
    factors[list(joints) or slice(None)] = factor
    wrong = dataclasses.replace(record.law, **{name: factors * getattr(record.law, name)})
    checkup = dataclasses.replace(record, law=wrong).check()
    causes = checkup.causes
    assert [(cause.name, cause.joints) for cause in causes] == [(cause_name, joints)]
    # The level of a torque that was at its limit shows an integral less exactly than steps do.
    within = 0.03 if name == "integral" else 0.01
    assert causes[0].size == pytest.approx(factor, rel=within)
    corrected = getattr(checkup.first_corrected.law, name)
    np.testing.assert_allclose(corrected, getattr(record.law, name), rtol=within)


def test_an_integral_that_the_stated_law_lacks_is_named_with_its_size(logs):
    stated = dataclasses.replace(logs["PID"], law=LAWS["PD"])
    causes = stated.check().causes
    assert [cause.name for cause in causes] == ["lacking integral"]
    assert causes[0].size == pytest.approx(5.0, rel=0.05)


def test_an_integral_that_made_no_log_is_in_no_other_unit(logs):
    stated = dataclasses.replace(logs["PD"], law=LAWS["PID"])
    assert stated.check().causes[0].name == "no integral"


@pytest.mark.parametrize("law", ["PD", "cascade"])
def test_a_clock_that_is_a_little_off_is_one_cause(logs, law):
    """Steps of the law at its own period would drift away from the rows of the log."""
    record = logs[law]
    problems = dataclasses.replace(record, t=1.0015 * record.t).check().problems
    assert {finding.check for finding in problems} == {"period"}


@pytest.mark.parametrize("law", ["PD", "PID"])
def test_a_torque_of_a_model_lacks_the_friction_of_the_law_s(logs, law):
    record = logs[law]
    motion = PATH(record.t)
    torque = [ARM.inverse(*state) for state in zip(*motion, strict=True)]
    checkup = with_torque(record, np.array(torque)).check()
    assert [cause.name for cause in checkup.causes] == ["torque of a model"]
    assert checkup.corrected.torque is None


def test_a_turned_torque_is_no_model_s(logs):
    causes = with_torque(logs["PID"], -logs["PID"].torque).check().causes
    assert causes[0].name == "turned torque of all joints"


def test_a_torque_of_zeros_is_left_out(logs):
    checkup = with_torque(logs["PD"], 0 * logs["PD"].torque).check()
    assert [cause.name for cause in checkup.causes] == ["torque of zeros"]
    assert checkup.corrected.torque is None


def test_a_torque_beyond_the_stated_limit_shows_another_limit(logs):
    record = logs["PD"]
    used = np.abs(RIG.drive.current(record.torque)).max(axis=0)
    drive = dataclasses.replace(RIG.drive, current_limit=used / 2)
    stated = dataclasses.replace(record, rig=dataclasses.replace(RIG, drive=drive))
    found = [finding for finding in stated.check().problems if finding.check == "saturation"]
    assert [finding.verdict for finding in found] == ["wrong", "wrong"]
    assert all("current_limit" in finding.advice for finding in found)


@pytest.mark.parametrize("law", LAWS)
def test_a_right_law_has_no_other_gains(logs, law):
    """A law without a period responds to counts between the rows, so its parts are not the log's."""
    assert logs[law].check().causes == ()


@pytest.fixture(scope="module")
def limited():
    """Logs whose amplifiers are at their limit for a seventh of the samples, or more."""
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_limit=(7.0, 3.5)))
    laws = {"P": puma560.p_law(), "PID": LAWS["PID"]}
    return {name: simulate(ARM, rig, law, PATH, duration=2.0) for name, law in laws.items()}


@pytest.mark.parametrize(
    ("law", "mistake", "factor"), [("P", "torque scale", 2.0), ("PID", "gain alone", 0.5)]
)
def test_an_amplifier_at_its_limit_shows_no_scale(limited, law, mistake, factor):
    record = limited[law]
    stated = dataclasses.replace(record.law, gain=factor * record.law.gain)
    wrong = {
        "torque scale": with_torque(record, factor * record.torque),
        "gain alone": dataclasses.replace(record, law=stated),
    }
    causes = wrong[mistake].check().causes
    assert [(cause.name, cause.joints) for cause in causes] == [(mistake, ())]
    assert causes[0].size == pytest.approx(factor, rel=1e-2)


@pytest.mark.parametrize("quantity", ["torque", "current"])
def test_per_mille_of_a_rated_torque_or_current_is_one_share_of_unequal_limits(quantity):
    drive = dataclasses.replace(RIG.drive, current_limit=(12.0, 8.0))
    rig = dataclasses.replace(RIG, drive=drive)
    made = simulate(ARM, rig, LAWS["PID"], PATH, duration=2.0)
    limit = {"torque": drive.torque_limit(), "current": drive.current_limit}[quantity]
    logged = {"torque": None, "current": None} | {
        quantity: 1e3 * getattr(made, quantity) / (0.3 * limit)
    }
    checkup = dataclasses.replace(made, **logged).check()
    (cause,) = checkup.causes
    assert cause.name == "torque per mille of the rated one"
    assert cause.size == pytest.approx(0.3, rel=1e-3)
    np.testing.assert_allclose(
        getattr(checkup.corrected, quantity), getattr(made, quantity), atol=1e-2
    )


@pytest.mark.filterwarnings("error")
def test_a_drive_without_a_limit_has_no_rated_share(logs):
    record = logs["PID"]
    drive = dataclasses.replace(RIG.drive, current_limit=(np.inf, 12.0))
    endless = dataclasses.replace(record, rig=dataclasses.replace(RIG, drive=drive))
    causes = with_torque(endless, 7.0 * record.torque).check().causes
    assert [cause.name for cause in causes] == ["torque scale"]

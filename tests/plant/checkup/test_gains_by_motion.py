"""Gains, limits and delays of a law in a log without a torque, by the motion that it drives."""

import dataclasses
import warnings

import numpy as np
import pytest
from random_rigs import drawn

from plant import PD, PID, Cascade, puma560, simulate

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
GAIN = puma560.p_law().gain
TORQUES = ("gain", "derivative", "speed", "integral")
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
}


@pytest.fixture(scope="module")
def logs():
    laws = {"P": puma560.p_law(), **LAWS}
    return {name: simulate(ARM, RIG, law, PATH, duration=1.5) for name, law in laws.items()}


def of_counts(record):
    return dataclasses.replace(record, torque=None, current=None)


def with_law(record, factor, names):
    """The record with these gains of its law multiplied."""
    law = record.law
    gains = {name: factor * np.array(getattr(law, name)) for name in names if hasattr(law, name)}
    return dataclasses.replace(record, law=dataclasses.replace(law, **gains))


def moved(record, counts=0, reference=0):
    """The record with counts and references that are so many rows late."""

    def late(table, rows):
        return table[np.clip(np.arange(len(table)) - rows, 0, None)]

    pulses = late(record.reference_pulses, reference)
    error = pulses - late(record.counts, counts)
    return dataclasses.replace(record, reference=None, reference_pulses=pulses, error_pulses=error)


@pytest.mark.parametrize("law", LAWS)
def test_a_right_log_without_a_torque_is_not_accused(logs, law):
    assert of_counts(logs[law]).check().causes == ()


@pytest.mark.parametrize("factor", [10.0, 0.1])
@pytest.mark.parametrize("law", LAWS)
def test_gains_that_are_all_wrong_are_named_by_the_stated_friction(logs, law, factor):
    record = of_counts(logs[law])
    checkup = with_law(record, factor, TORQUES).check()
    assert [(cause.name, cause.joints) for cause in checkup.causes] == [("all gains", ())]
    assert checkup.causes[0].size == pytest.approx(factor, rel=0.1)
    for name in TORQUES:
        if hasattr(record.law, name):
            corrected = getattr(checkup.corrected.law, name)
            np.testing.assert_allclose(corrected, getattr(record.law, name), rtol=0.1)


def test_friction_that_is_guessed_shows_no_gains(logs):
    record = of_counts(logs["PD"])
    drive = record.rig.drive
    guess = dataclasses.replace(drive, coulomb=10 * drive.coulomb, viscous=0.1 * drive.viscous)
    guessed = dataclasses.replace(record, rig=dataclasses.replace(record.rig, drive=guess))
    assert "all gains" not in {cause.name for cause in guessed.check().causes}


@pytest.mark.parametrize(("seed", "gain"), [(4, "derivative"), (17, "gain")])
def test_one_gain_that_is_ten_times_too_large_leaves_a_torque_that_no_motion_needs(seed, gain):
    record = of_counts(drawn(seed, torque=True).record)
    first = with_law(record, 10.0, [gain]).check().causes[0]
    assert first.name == ("gain alone" if gain == "gain" else f"{gain} gain alone")
    assert first.size == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize(
    ("law", "column"),
    [(law, "counts") for law in ("P", *LAWS)] + [("PID", "reference"), ("cascade", "reference")],
)
def test_counts_and_references_that_are_late_are_one_for_a_log_without_a_torque(logs, law, column):
    causes = moved(of_counts(logs[law]), **{column: 3}).check().causes
    assert causes[0].name == "late counts"
    assert causes[0].size == pytest.approx(3 if column == "counts" else -3, abs=0.2)
    assert "late references" in {rival.name for rival in causes[0].rivals}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("rows", [1, 3])
def test_a_reference_that_is_late_is_named_by_the_logged_torque(logs, law, rows):
    record = logs[law]
    checkup = moved(record, reference=rows).check()
    causes = checkup.causes
    assert [(cause.name, cause.joints, cause.size) for cause in causes] == [
        ("late references", (), rows)
    ]
    within = slice(rows, -rows)
    np.testing.assert_array_equal(
        checkup.corrected.reference_pulses[within], record.reference_pulses[within]
    )


@pytest.mark.parametrize("law", LAWS)
def test_the_period_of_a_law_is_named_by_the_logged_torque(logs, law):
    record = logs[law]
    slower = dataclasses.replace(record.law, period=2 * record.law.period)
    causes = dataclasses.replace(record, law=slower).check().causes
    assert [(cause.name, cause.size) for cause in causes] == [
        ("period of the law", pytest.approx(2.0))
    ]


def test_a_limit_below_the_torque_is_named_at_its_joint(logs):
    record = of_counts(logs["PD"])
    used = np.abs(logs["PD"].current).max(axis=0)
    drive = dataclasses.replace(record.rig.drive, current_limit=used * (0.4, 1.2))
    stated = dataclasses.replace(record, rig=dataclasses.replace(record.rig, drive=drive))
    first = stated.check().causes[0]
    assert (first.name, first.joints) == ("limit below the torque", (0,))


def test_a_law_without_the_integral_that_made_the_log_shows_no_delay(logs):
    stated = dataclasses.replace(of_counts(logs["PID"]), law=LAWS["PD"])
    assert "late counts" not in {cause.name for cause in stated.check().causes}


def test_a_joint_without_a_position_gain_shows_no_share_of_it(logs):
    record = with_law(of_counts(logs["cascade"]), (1.0, 0.0), ["position"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert record.check().causes == ()


def test_a_position_gain_that_is_nearly_right_is_right(logs):
    record = of_counts(logs["cascade"])
    begins_late = dataclasses.replace(record, valid=np.arange(len(record)) >= 100)
    assert begins_late.check().causes == ()

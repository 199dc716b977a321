"""Gains in another unit, and a reference that was not mapped, are named."""

import dataclasses

import numpy as np
import pytest

from identification import identify
from plant import PID, P, puma560, simulate

RIG = puma560.rig()
GAIN = RIG.drive.motor_gain


@pytest.fixture(scope="module")
def record():
    return simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference(), duration=3.65)


def said(record, check):
    return [finding.advice for finding in record.check().problems if finding.check == check]


def causes(record):
    return [cause.name for cause in record.check().causes]


def test_gains_in_amperes_are_named_by_the_logged_torque(record):
    law = puma560.p_law()
    assert not causes(record)
    amperes = dataclasses.replace(record, law=P(gain=law.gain / GAIN))
    assert causes(amperes)[0] == "gains in A"
    np.testing.assert_allclose(amperes.check().corrected.law.gain, law.gain)
    assert causes(dataclasses.replace(record, law=P(gain=law.gain * 10)))[0] == "gain"


@pytest.mark.parametrize("factor", [2.0, pytest.param(1 / 3, marks=pytest.mark.slow)])
def test_gains_of_a_law_with_memory_are_named_by_steps_of_the_logged_torque(factor):
    """Whatever an integral holds, the step of a torque is that of the error times the gain."""
    gain = 0.5 * puma560.p_law().gain
    law = PID(gain=gain, integral=5 * gain, derivative=4e-3 * gain, filter=2e3, period=RIG.period)
    log = simulate(puma560.arm(), RIG, law, puma560.reference(), duration=2.0)
    assert not causes(log)
    gains = ("gain", "integral", "derivative")
    scaled = {name: factor * getattr(law, name) for name in gains}
    (cause,) = dataclasses.replace(log, law=dataclasses.replace(law, **scaled)).check().causes
    assert cause.name == "gain"
    assert cause.runner_up.name == "torque scale"
    assert cause.size == pytest.approx(factor, rel=0.05)
    wrong = dataclasses.replace(log, law=dataclasses.replace(law, gain=factor * gain))
    cause, *_ = wrong.check().causes
    assert cause.name == "gain alone"
    assert cause.size == pytest.approx(factor, rel=0.05)


def test_a_torque_that_the_law_does_not_give_is_not_called_fine():
    """Its inertia is plausible, which alone does not show that the columns belong together."""
    gain = np.array((0.1, 0.08))
    law = PID(gain=gain, integral=5 * gain, derivative=4e-3 * gain, filter=2e3, period=RIG.period)
    log = simulate(puma560.literature_arm(0.7), RIG, law, puma560.reference(), duration=2.0)
    noise = np.random.default_rng(1).normal(size=log.torque.shape)
    torque = log.torque + 0.1 * np.ptp(log.torque, axis=0) * noise
    noisy = dataclasses.replace(log, torque=torque, current=None)
    for record, verdict in ((log, "fine"), (noisy, "cannot tell")):
        units = [one for one in record.check().findings if one.check == "units of torque"]
        assert {one.verdict.partition(":")[0] for one in units} == {verdict}


def test_they_are_named_by_friction_where_no_torque_is_logged(record):
    alone = dataclasses.replace(
        record, torque=None, current=None, law=P(gain=puma560.p_law().gain / GAIN)
    )
    assert causes(alone)[0] == "gains in A"


def test_a_reference_that_was_not_mapped_is_named(record):
    without = dataclasses.replace(
        record,
        reference=None,
        reference_pulses=np.zeros_like(record.counts),
        error_pulses=-record.counts,
        torque=None,
        current=None,
    )
    with pytest.raises(
        ValueError, match=r"no reference came with it, so its law is taken to hold 0\. Map ref"
    ):
        identify(puma560.dynamics(), without, progress=False)


def test_a_turned_current_may_be_a_turned_gear(record):
    turned = dataclasses.replace(record, torque=None, current=record.current * (1, -1))
    (cause,) = turned.check().causes
    assert (cause.name, cause.joints) == ("turned torque", (1,))
    assert "the current, or of the gear" in cause.remedy


def test_a_torque_that_is_off_as_the_resolution_is(record):
    """Four times the resolution: the law commands from errors in quarters of a pulse."""
    finer = dataclasses.replace(
        RIG, encoder=dataclasses.replace(RIG.encoder, resolution=RIG.encoder.resolution * 4)
    )
    counts = {name: getattr(record, name) * 4 for name in ("reference_pulses", "error_pulses")}
    (cause,) = dataclasses.replace(record, rig=finer, reference=None, **counts).check().causes
    assert (cause.name, cause.joints, cause.size) == ("steps of counts", (), 4.0)
    corrected = dataclasses.replace(record, rig=finer, reference=None, **counts).check().corrected
    np.testing.assert_array_equal(corrected.counts, record.counts)
    np.testing.assert_array_equal(corrected.rig.encoder.resolution, RIG.encoder.resolution)


@pytest.mark.parametrize("turned", [1, -1])
def test_swapped_angles_are_named_through_gears_that_differ(record, turned):
    """Positions of the joints in each other's columns, turned into counts by each other's gears."""
    drive = dataclasses.replace(RIG.drive, gear=RIG.drive.gear * (1, turned))
    rig = dataclasses.replace(RIG, drive=drive)
    asked = rig.counts(record.reference(record.t).q)
    counts = rig.counts(record.rig.to_angle(record.counts)[:, ::-1])
    swapped = dataclasses.replace(
        record,
        rig=rig,
        reference=None,
        reference_pulses=asked,
        error_pulses=asked - counts,
        torque=None,
        current=None,
    )
    checkup = swapped.check()
    cause = checkup.causes[0]
    assert (cause.name, cause.joints, cause.size) == ("exchanged counts", (0, 1), 1.0)
    assert {rival.name for rival in cause.rivals} <= {"exchanged references"}
    wrong = {(f.check, f.joint) for f in checkup.findings if f.verdict == "wrong"}
    assert {("swapped joints", 0), ("swapped joints", 1)} <= wrong
    right = dataclasses.replace(
        swapped, error_pulses=asked - rig.counts(record.rig.to_angle(record.counts))
    )
    assert not said(right, "swapped joints")


def test_a_reference_in_degrees_that_was_read_in_radians_is_named(record):
    reference = np.rint(record.reference_pulses * 180 / np.pi)
    wrong = dataclasses.replace(
        record,
        reference=None,
        reference_pulses=reference,
        error_pulses=reference - record.counts,
        torque=None,
        current=None,
        law=None,
    )
    (cause,) = wrong.check().causes
    assert (cause.name, cause.joints) == ("reference alone in degrees", ())
    wrong = [f.joint for f in wrong.check().findings if f.check == "gear sign" and not f.ok]
    assert wrong == [0, 1]

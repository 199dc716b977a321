"""Counts that are late under laws with memory: their run along the log tells by how many
samples, of which joints.
"""

import dataclasses
from functools import cache
from itertools import product

import numpy as np
import pytest

from ctc import ComputedTorque, ComputedTorquePID
from plant import PD, PID, Cascade, Elasticity, Harmonics, Hypothesis, Resumed, puma560, simulate
from plant.checkup import Experiment, Trials

ARM, RIG = puma560.arm(), puma560.rig()
PATH = Harmonics(
    period=3.0,
    offset=(0.1, -0.05),
    cosine=((0.2, 0.1, 0.1), (0.1, 0.2, -0.1)),
    sine=((0.3, -0.2, 0.1), (-0.3, 0.1, 0.1)),
)
LAGS = PID(
    gain=(0.1, 0.07), integral=(0.5, 0.4), derivative=(4e-4, 3e-4), filter=2000.0, period=RIG.period
)
LAWS = {
    "PID": LAGS,
    "fast PID": dataclasses.replace(LAGS, period=None),
    "PD": PD(gain=(0.1, 0.07), derivative=(4e-4, 3e-4), filter=600.0, period=RIG.period),
    "cascade": Cascade(
        position=(20, 20),
        speed=(1e-3, 7e-4),
        integral=(1e-2, 7e-3),
        filter=600.0,
        period=RIG.period,
    ),
    "fast cascade": Cascade(
        position=(20, 20), speed=(1e-3, 7e-4), integral=(1e-2, 7e-3), filter=600.0
    ),
    "computed torque": ComputedTorque(ARM, RIG),
    "computed torque PID": ComputedTorquePID(
        ARM, RIG, bandwidth=60, ratio=1.0, integral=10, roll_off=600, roll_off_damping=0.7
    ),
}


def drive(**changes):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **changes))


@cache
def log(name, rig=RIG):
    """A log that begins in the middle of the motion: what the law remembers there is not in it."""
    record = simulate(ARM, rig, LAWS[name], PATH, duration=2.4, steps_per_sample=8).cut(0.6)
    return dataclasses.replace(record, true_q=None, true_qd=None, link_counts=None, current=None)


def late(record, *samples):
    """The same log with the counts of each joint late by so many samples; rows without them left
    out.
    """
    inner = slice(2, len(record) - 2)
    counts = np.column_stack([np.roll(x, k) for x, k in zip(record.counts.T, samples, strict=True)])
    reference = None if record.reference is None else record.reference.later(record.t[2])
    return dataclasses.replace(
        record,
        t=record.t[inner] - record.t[2],
        error_pulses=(record.reference_pulses - counts)[inner],
        reference=reference,
        **{name: getattr(record, name)[inner] for name in ("reference_pulses", "torque", "valid")},
    )


def told(record):
    """Whole samples by which the counts are late; those of the other rounding are whole, too."""
    delays = np.zeros(record.n)
    for cause in record.check().causes:
        if cause.name == "late counts":
            # A cause is the size beyond the causes before it; one without joints is of all.
            delays[list(cause.joints) or slice(None)] += cause.size
    return np.round(delays, 1).tolist()


SLOW = ("PD", "fast PID", "cascade", "fast cascade", "computed torque")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if name in SLOW else []) for name in LAWS],
)
def test_the_law_tells_which_counts_are_late(name):
    record = log(name)
    assert told(record) == [0, 0]
    assert told(late(record, 1, 1)) == [1, 1]
    assert told(late(record, 0, 1)) == [0, 1]


@pytest.mark.parametrize(
    "name",
    [
        "PID",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("cascade", "computed torque PID")
        ),
    ],
)
def test_counts_in_time_are_given_back(name):
    checkup = late(log(name), 0, 1).check()
    (cause,) = checkup.causes
    assert (cause.name, cause.joints) == ("late counts", (1,))
    assert cause.size == pytest.approx(1.0, abs=0.05)
    np.testing.assert_array_equal(checkup.corrected.counts[:-1], log(name).counts[2:-3])
    assert checkup.corrected.check().ok


@pytest.mark.parametrize(
    "samples",
    [0.6, pytest.param(1.5, marks=pytest.mark.slow), pytest.param(1.8, marks=pytest.mark.slow)],
)
def test_counts_that_are_late_by_a_part_of_a_sample_are_named(samples):
    """The derivative of a PID enlarges the noise of counts between two rows."""
    record = simulate(ARM, RIG, LAGS, PATH, duration=2.4, steps_per_sample=8)
    # The motion itself, read later; its rounding is that of no row.
    q = np.column_stack(
        [np.interp(record.t - samples * RIG.period, record.t, x) for x in record.true_q.T]
    )
    late = dataclasses.replace(
        record,
        error_pulses=record.reference_pulses - RIG.counts(q),
        true_q=None,
        true_qd=None,
        link_counts=None,
        current=None,
    )
    cause, *_ = late.check().causes
    assert (cause.name, cause.joints) == ("late counts", ())
    assert cause.size == pytest.approx(samples, abs=0.1)


@pytest.mark.parametrize(
    "rounding",
    ["floor", *(pytest.param(name, marks=pytest.mark.slow) for name in ("fix", "round"))],
)
def test_any_counter_and_drive_will_do(rounding):
    rig = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, rounding=rounding))
    assert told(log("PID", rig)) == [0, 0]
    assert told(late(log("PID", rig), 1, 1)) == [1, 1]


@pytest.mark.slow
def test_saturated_currents_and_elastic_gears_that_are_not_stated_do_not_matter():
    small = drive(current_limit=0.7 * np.abs(RIG.drive.current(log("PID").torque)).max(axis=0))
    gears = drive(elasticity=Elasticity(stiffness=(2e4, 8e3), damping=(20, 8)))
    for rig in (small, gears):
        record = log("PID", rig)
        stated = RIG if rig is gears else rig
        assert told(dataclasses.replace(record, rig=stated)) == [0, 0]
        assert told(dataclasses.replace(late(record, 1, 0), rig=stated)) == [1, 0]
    assert (
        np.abs(RIG.drive.current(log("PID", small).torque)) > 0.999 * small.drive.current_limit
    ).mean() > 0.05


@pytest.mark.slow
def test_torques_in_other_units_or_of_commands_and_a_state_that_is_known_will_do():
    record = late(log("PID"), 1, 1)
    assert told(dataclasses.replace(record, torque=1.3 * record.torque + 2)) == [1, 1]
    assert told(
        dataclasses.replace(record, torque=None, current=RIG.drive.current(record.torque))
    ) == [1, 1]
    assert told(
        dataclasses.replace(record, law=Resumed(law=LAGS, state=LAGS.initial_state(2)))
    ) == [1, 1]


QUICK = {("PID", 0.95), ("cascade", 1.05)}
OTHERS = set(product(("PID", "fast PID", "cascade", "fast cascade"), (0.5, 0.95, 1.05, 2.0)))


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        *sorted(QUICK),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in sorted(OTHERS - QUICK)),
    ],
)
def test_a_law_with_other_gains_is_no_delay(name, factor):
    """The gain of a cascade's position loop acts as a delay does, but for the steps of its
    torque.
    """
    law = LAWS[name]
    for field in ("gain", "derivative", "integral", "position", "speed"):
        if hasattr(law, field):
            other = dataclasses.replace(law, **{field: factor * np.array(getattr(law, field))})
            assert told(dataclasses.replace(log(name), law=other)) == [0, 0], field


@pytest.mark.parametrize(
    ("rest", "samples", "delayed"), [(0.8, 0.5, False), (0.2, 0.5, True), (0.8, 2.0, True)]
)
def test_a_small_delay_explains_most_of_what_the_law_does_not(rest, samples, delayed):
    """Under a law that cannot have made the log, as where its counts have another zero, small
    delays make the log likelier, too, and leave most of the difference.
    """
    record = log("PID")
    strange = 0.7 * record.torque[::-1]
    experiment = Experiment(dataclasses.replace(record, torque=record.torque + strange))

    def undo(spoiled, joints, size):
        return dataclasses.replace(spoiled, torque=record.torque + rest * strange)

    changed = experiment.changed(undo(experiment.record, (), samples))
    row = Hypothesis(
        name="late", sentence="", remedy="", check="delay", undo=undo, sizes=(samples,)
    )
    assert changed.score - experiment.score > row.against
    assert bool([*Trials([row])(experiment)]) is delayed


def test_a_joint_that_is_later_than_the_others_has_both_delays():
    """A delay of all joints is found first, and that of one joint beside it."""
    record = simulate(ARM, RIG, puma560.p_law(), puma560.reference())
    counts = np.array(record.counts)
    for joint, samples in enumerate((2, 5)):
        counts[samples:, joint] = record.counts[:-samples, joint]
        counts[:samples, joint] = record.counts[0, joint]
    shifted = dataclasses.replace(record, error_pulses=record.reference_pulses - counts)
    assert told(shifted) == [2, 5]


@pytest.mark.parametrize("name", ["PID", "computed torque"])
@pytest.mark.parametrize("samples", [7, 57])
def test_torques_that_a_driver_sends_late_are_named_with_their_delay(name, samples):
    """Beyond a few rows, torques of a law with memory are unlike those of any shorter delay."""
    record = log(name)
    late_torque = np.roll(record.torque, samples, axis=0)
    late_torque[:samples] = record.torque[0]
    found = dataclasses.replace(record, torque=late_torque).check().causes[0]
    assert found.name == "late torques"
    assert found.size == samples
    assert found.joints == ()


def test_a_torque_without_gravity_is_told_by_its_slow_steps():
    """Its quick steps are those of the law."""
    record = log("PID")
    still = np.zeros(2)
    gravity = np.array([ARM.inverse(q, still, still) for q in RIG.cell_centre(record.counts)])
    lacking = dataclasses.replace(record, torque=record.torque - gravity)
    checkup = lacking.check()
    assert [cause.name for cause in checkup.causes] == ["torque without gravity"]
    left = checkup.corrected.torque - record.torque
    assert np.sqrt(np.mean(left**2)) < 0.01 * np.sqrt(np.mean(gravity**2))


def test_gravity_that_a_torque_lacks_is_that_of_the_arm_which_its_law_knows():
    """What depends on the pose may come from a joint that turns the other way."""
    record = simulate(ARM, RIG, ComputedTorque(ARM, RIG), puma560.reference(), duration=1.2)
    still = np.zeros(2)
    gravity = np.array([ARM.inverse(q, still, still) for q in RIG.cell_centre(record.counts)])
    lacking = dataclasses.replace(record, torque=record.torque - gravity, current=None)
    checkup = lacking.check()
    assert [cause.name for cause in checkup.causes] == ["torque without gravity"]
    np.testing.assert_allclose(checkup.corrected.torque, record.torque, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "pulses", "torque"),
    [
        ("PID", -200, True),
        ("PID", 13425, True),
        ("computed torque", -200, True),
        ("computed torque", -50, True),
        ("PID", -50, False),
        ("PID", 13425, False),
        ("computed torque", -5, False),
        ("computed torque", 13425, False),
    ],
)
def test_a_reference_with_another_zero_is_named_with_its_distance(name, pulses, torque):
    """A constant error takes the torque of the law to its limit, and the motion needs another."""
    record = log(name)
    if not torque:
        record = dataclasses.replace(record, torque=None, current=None)
    shifted = dataclasses.replace(
        record, reference=None, error_pulses=record.error_pulses + np.array([0, pulses])
    )
    found, *_ = shifted.check().causes
    assert (found.name, found.joints) == ("zero of reference", (1,))
    assert found.size == pytest.approx(pulses, abs=2)

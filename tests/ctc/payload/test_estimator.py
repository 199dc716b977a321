"""A load found at work: pick, carry, drop; windows that say too little; loads and changes that
were not foreseen.
"""

import dataclasses
import re
import time

import numpy as np
import pytest

from ctc import Adaptive, ComputedTorque, FeedForward, PayloadEstimator
from identification.payload import KERNEL
from plant import PD, Body, Guards, Harmonics, SteppedArm, puma560, read_robot

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW, PLACE = ComputedTorque(ARM, RIG, bandwidth=150), (0.0, -0.4, 0.0)
TAKE, DROP = 1500, 3500


def load(mass):
    return Body(mass=mass, com=PLACE) if mass else None


def worked(estimator, changes, samples, path=PATH, rig=RIG, **options):
    """A controller after so many samples with changes of the load {sample: mass}, and its errors
    (samples, n).
    """
    motion = path(np.arange(samples) * RIG.period)
    stepped = SteppedArm(ARM, rig, motion.q[0], motion.qd[0])
    controller, pulses, errors = estimator.start(rig, stepped.pulses, **options), stepped.pulses, []
    for k in range(samples):
        if k in changes:
            stepped.carry(load(changes[k]))
        errors.append(RIG.counts(motion.q[k]) - pulses)
        pulses = stepped.step(controller.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k]))
    return controller, np.array(errors)


def test_pick_carry_drop():
    controller, errors = worked(
        PayloadEstimator(LAW, position=PLACE, beside=False), {TAKE: 2.5, DROP: 0.0}, 4200
    )
    assert [event.kind for event in controller.events] == ["start", "taken", "dropped"]
    start, taken, dropped = controller.events
    assert start.before == 2.5  # half the heaviest
    assert [start.after, taken.after, dropped.after] == pytest.approx([0.0, 2.5, 0.0], abs=0.03)
    assert taken.before == start.after
    for event, change in ((taken, TAKE), (dropped, DROP)):
        late = event.time - change * RIG.period
        assert 0 <= late <= 0.06
        assert event.swapped - change * RIG.period <= 0.28
        # what is left of the error goes
        after = slice(round((event.swapped + 0.05) / RIG.period), change + 1900)
        assert np.abs(errors[after]).max() <= 1
    assert controller.load.sufficient
    assert controller.load.interval[0] <= 0.03
    assert controller.stage == "holding"
    assert controller.status == "running"


def test_the_place_may_be_unknown():
    controller, _ = worked(PayloadEstimator(LAW, beside=False), {TAKE: 3.0}, 2000)
    assert controller.events[-1].after == pytest.approx(3.0, abs=0.3)
    np.testing.assert_allclose(controller.load.position, PLACE, atol=0.06)


def test_beside_the_controller_the_same_is_found():
    """In a process of its own; a loop that runs ahead of the clock waits, and gets the same
    answer a little later.
    """
    here, there = (
        worked(PayloadEstimator(LAW, position=PLACE, beside=beside), {TAKE: 2.5}, 1900)[0]
        for beside in (False, True)
    )
    assert [event.kind for event in there.events] == ["start", "taken"]
    assert there.events[0].after == here.events[0].after
    assert there.events[1].after == pytest.approx(here.events[1].after, abs=0.02)
    assert there.events[1].swapped - there.events[1].time < 0.23


def test_a_loop_paced_by_the_clock_does_not_wait():
    """While the genetic algorithm works (some 50 ms), steps go on."""
    estimator = PayloadEstimator(LAW, position=PLACE, method="genetic")
    motion = PATH(np.arange(1200) * RIG.period)
    stepped = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
    controller, pulses, meanwhile = estimator.start(RIG, stepped.pulses), stepped.pulses, 0
    for k in range(1200):
        if controller.stage == "identifying":
            meanwhile += 1
            time.sleep(RIG.period)
        pulses = stepped.step(controller.step(pulses, motion.q[k], motion.qd[k], motion.qdd[k]))
    assert meanwhile > 10
    assert controller.events[0].after == pytest.approx(0.0, abs=0.06)


def test_a_loop_goes_on_with_the_prior_where_the_process_of_its_estimator_ends():
    """Paced by the clock; each window says that there is no answer."""
    motion = PATH(np.arange(1200) * RIG.period)
    controller = PayloadEstimator(LAW, position=PLACE).start(RIG, RIG.counts(motion.q[0]))
    process = controller._worker._process
    process.kill()
    process.wait()
    for k in range(1200):
        if controller.stage == "identifying":
            time.sleep(0.02)
        controller.step(RIG.counts(motion.q[k]), motion.q[k], motion.qd[k], motion.qdd[k])
    (event,) = controller.events
    assert event.windows > 2
    for message in (event.message, controller.load.message):
        assert message.startswith("the process of the estimator must run; it has ended")
    assert controller.load.mass == controller.estimator.prior.mass
    assert not controller.load.sufficient
    assert controller.status == "running"


def test_an_arm_at_rest_keeps_the_prior():
    still = Harmonics(
        period=1.0, offset=(-0.5, 0.8), cosine=np.zeros((2, 1)), sine=np.zeros((2, 1))
    )
    controller, _ = worked(
        PayloadEstimator(LAW, position=PLACE, prior=1.0, beside=False), {0: 3.0}, 1000, still
    )
    (event,) = controller.events
    assert np.isnan(event.after)
    assert "rests" in event.message
    assert event.windows > 2
    assert controller.load.mass == pytest.approx(1.0)
    assert not controller.load.sufficient


def test_a_load_outside_its_range_says_so():
    controller, _ = worked(
        PayloadEstimator(LAW, mass=(0, 2), position=PLACE, beside=False), {TAKE: 4.0}, 2000
    )
    assert (
        "outside its range: 4.0" in controller.events[1].message
        or "3.9" in controller.events[1].message
    )
    assert controller.events[1].after == pytest.approx(2.0, abs=0.02)
    assert all(event.after <= 2.0 for event in controller.events[1:] if np.isfinite(event.after))


@pytest.mark.parametrize("change", [{TAKE: 3.0, TAKE + 150: 0.0}, {TAKE: 4.0, TAKE + 130: 1.0}])
def test_two_changes_within_one_window(change):
    """No mass between the two is taken for one; what is there in the end is found."""
    controller, _ = worked(PayloadEstimator(LAW, position=PLACE, beside=False), change, 2600)
    last = list(change.values())[-1]
    found = [event.after for event in controller.events[1:] if np.isfinite(event.after)]
    assert found
    assert found[-1] == pytest.approx(last, abs=0.05)
    assert all(min(abs(mass - each) for each in change.values()) < 0.1 for mass in found)
    assert controller.events[1].windows > 1


def test_saturation_does_no_harm():
    """The applied torque is what counts. The limit is that of the amplifier, which the law keeps
    to.
    """
    limit = np.array([155.0, 36.0])
    estimator = PayloadEstimator(LAW, position=PLACE, beside=False)
    controller, _ = worked(estimator, {TAKE: 2.5}, 1900, torque_limit=limit, guards=None)
    # of the last 200 ms
    assert (np.abs(controller._torque) >= limit - 1e-9).any(axis=1).mean() > 0.3
    assert controller.events[1].after == pytest.approx(2.5, abs=0.1)


def test_a_lost_count_begins_the_window_anew():
    estimator = PayloadEstimator(LAW, position=PLACE, beside=False)
    motion = PATH(np.arange(1200) * RIG.period)
    stepped = SteppedArm(ARM, RIG, motion.q[0], motion.qd[0])
    controller, pulses = estimator.start(RIG, stepped.pulses, guards=Guards()), stepped.pulses
    for k in range(1200):
        seen = pulses + (5000 if k == 300 else 0)
        pulses = stepped.step(controller.step(seen, motion.q[k], motion.qd[k], motion.qdd[k]))
    assert controller.running.bridged == 1
    assert controller.events[0].swapped == pytest.approx((301 + 286) * RIG.period, abs=0.01)
    assert controller.events[0].after == pytest.approx(0.0, abs=0.03)


def test_a_reset_begins_with_the_prior():
    controller, _ = worked(PayloadEstimator(LAW, position=PLACE, beside=False), {}, 600)
    assert controller.events
    controller.reset([0, 0])
    assert controller.events == []
    assert controller.load.mass == 2.5
    assert controller.stage == "settling"


@pytest.mark.parametrize(("prior", "mass"), [(None, 4.5), (4.0, 4.0), (4.8, 4.8)])
def test_the_prior_has_the_mass_that_is_stated_in_a_range_that_does_not_begin_at_zero(prior, mass):
    estimator = PayloadEstimator(LAW, mass=(4, 5), position=PLACE, prior=prior, beside=False)
    assert estimator.prior.mass == pytest.approx(mass)


def test_the_shortest_window_that_a_refusal_names_is_taken():
    rig = dataclasses.replace(RIG, period=3 * KERNEL / 100.25)
    law = ComputedTorque(ARM, rig, bandwidth=60)
    with pytest.raises(ValueError, match="window") as refusal:
        PayloadEstimator(law, position=PLACE, window=0.9 * 3 * KERNEL, beside=False)
    least = float(re.search(r"at least (\S+) s", str(refusal.value)).group(1))
    PayloadEstimator(law, position=PLACE, window=least, beside=False)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"mass": (5, 0)}, "mass must be a range"),
        ({"window": 0.05}, "window must be at least"),
        ({"prior": 7.0}, "prior must be within"),
        ({"method": "neural"}, "method must be one of"),
        ({"position": (0, 1)}, "position must have shape"),
        ({"tolerated": 0.0}, "tolerated"),
        ({"friction": -1.0}, "friction must not be negative"),
        ({"found": ARM}, "found"),
        ({"windw": 0.2}, "window"),
        ({"alarm": -1.0}, "alarm"),
    ],
)
def test_bad_input_is_refused_in_one_line(options, said):
    with pytest.raises(ValueError, match=re.escape(said)) as caught:
        PayloadEstimator(LAW, **options)
    assert "\n" not in str(caught.value)


def test_laws_that_cannot():
    pd = PD(gain=(0.1, 0.1), derivative=(0.004, 0.004), filter=3000.0, period=RIG.period)
    with pytest.raises(ValueError, match="law must be of type ModelLaw"):
        PayloadEstimator(pd)
    with pytest.raises(ValueError, match="law must be of type ModelLaw"):
        PayloadEstimator(ARM)
    adaptive = Adaptive(ARM, RIG, bandwidth=40, gain=(10, 10), adaptation=(0.1,) * 9, filter=600)
    with pytest.raises(ValueError, match="changes it by itself"):
        PayloadEstimator(adaptive)
    fast = FeedForward(ARM, RIG, feedback=puma560.p_law())
    with pytest.raises(ValueError, match="period"):
        PayloadEstimator(fast)
    with pytest.raises(ValueError, match="sampled as the law's own"):
        PayloadEstimator(LAW, beside=False).start(dataclasses.replace(RIG, period=1e-3), [0, 0])
    with pytest.raises(ValueError, match="rig"):
        PayloadEstimator(LAW, beside=False).start(ARM, [0, 0])


@pytest.mark.slow
def test_the_whole_arm():
    """All six joints of the PUMA 560, with 2.5 kg in front of the flange, on a motion of all of
    them.
    """
    robot = read_robot("puma560")
    arm, rig = robot.arm, robot.rig
    waves = np.array([0.5, 0.4, 0.5, 0.6, 0.5, 0.8])[:, None] * [[0.7, 0.3]]
    path = Harmonics(period=4.0, offset=(0, -0.4, 2.4, 0, 0.3, 0), cosine=-waves, sine=0.4 * waves)
    body = Body(mass=2.5, com=(0.0, 0.0, 0.2))
    estimator = PayloadEstimator(
        ComputedTorque(arm, rig, bandwidth=100), position=body.com, beside=False
    )
    motion = path(np.arange(1800) * rig.period)
    stepped = SteppedArm(arm, rig, motion.q[0], motion.qd[0])
    controller, pulses = estimator.start(rig, stepped.pulses), stepped.pulses
    for k, state in enumerate(zip(*motion, strict=True)):
        if k == 1280:
            stepped.carry(body)
        pulses = stepped.step(controller.step(pulses, *state))
    assert [event.kind for event in controller.events] == ["start", "taken"]
    assert [event.after for event in controller.events] == pytest.approx([0.0, 2.5], abs=0.1)
    with pytest.raises(ValueError, match="along must be given"):
        PayloadEstimator(ComputedTorque(arm, rig, bandwidth=100))

"""Of a right log no change is likelier, where a faster loop makes the torques noisy."""

import dataclasses

import numpy as np
import pytest
from machine_plans import STAND, gains
from random_rigs import drawn

from plant import (
    Cascade,
    Drive,
    Dynamics,
    Encoder,
    Hypothesis,
    Record,
    Rig,
    simulate,
)
from plant.checkup import (
    Candidate,
    Experiment,
    Trials,
    counts_in_time,
    each_joint,
    exchanged_torques,
    ranking,
    turned_reference,
    turned_torque,
)


def machine(resolution, period, **options):
    """The stand without its spring, and its cascade."""
    drive = Drive(
        gear=STAND.gear,
        motor_inertia=STAND.rotor / STAND.gear**2,
        viscous=STAND.viscous / STAND.gear**2,
        coulomb=STAND.coulomb / np.abs(STAND.gear),
        motor_gain=STAND.motor_gain,
        current_limit=(40.0, 40.0, 40.0),
    )
    encoder = Encoder(resolution=resolution, rounding="floor")
    rig = Rig(drive=drive, encoder=encoder, period=period)
    dynamics = Dynamics.from_chain(STAND.chain.with_rotors(drive))
    position, speed, integral = gains(STAND._replace(resolution=resolution))
    law = Cascade(position=position, speed=speed, integral=integral, period=period, **options)
    return dynamics.arm(dynamics.f()), rig, law


@pytest.fixture(scope="module")
def experiment():
    """Every fourth sample of a cascade at 4 kHz; the loop answers its counts in between, too."""
    arm, rig, law = machine(STAND.resolution, STAND.speed_period, difference=2)
    made = simulate(arm, rig, law, STAND.path, duration=5.0)
    record = Record(
        t=made.t[::4],
        error_pulses=made.error_pulses[::4],
        reference_pulses=made.reference_pulses[::4],
        torque=made.torque[::4],
        rig=dataclasses.replace(rig, period=1e-3),
        law=None,
    )
    return Experiment(record)


@pytest.mark.parametrize("joints", [(0, 1), (0, 2), (1, 2)])
def test_what_a_speed_explains_of_its_own_torque_tells_the_joint(experiment, joints):
    """Beside noise the other terms of a motion explain any joint's torque."""
    changed = experiment.changed(exchanged_torques(experiment.record, joints, 1.0))
    assert experiment.score > changed.score


@pytest.mark.parametrize("delay", [3.0, 5.0, 8.0])
def test_a_loop_of_the_second_order_has_no_late_counts(experiment, delay):
    """It lags by its position loop, and by the speed loop inside."""
    changed = experiment.changed(counts_in_time(experiment.record, (), delay))
    assert experiment.score > changed.score


@pytest.fixture(scope="module")
def cascaded():
    """A log of a cascade, its torque without noise."""
    arm, rig, law = machine(8 * STAND.resolution, 1e-3, filter=1200.0)
    made = simulate(arm, rig, law, STAND.path, duration=5.0)
    return dataclasses.replace(made, true_q=None, true_qd=None, link_counts=None)


@pytest.fixture(scope="module")
def noisy(cascaded):
    """The same with currents; 20 mA of noise hide the steps of its torque from row to row."""
    noise = 0.02 * np.random.default_rng(0).normal(size=cascaded.torque.shape)
    current = cascaded.rig.drive.current(cascaded.torque) + noise
    return dataclasses.replace(cascaded, torque=None, current=current)


@pytest.mark.parametrize(
    "cause", ["", pytest.param("late counts", marks=pytest.mark.slow), "late torques"]
)
def test_delays_are_seen_behind_the_noise_of_a_current(noisy, cause):
    inner = slice(1, -1)
    counts = noisy.counts[:-2] if cause == "late counts" else noisy.counts[inner]
    late = noisy.current[:-2] if cause == "late torques" else noisy.current[inner]
    record = dataclasses.replace(
        noisy,
        t=noisy.t[inner] - noisy.t[1],
        reference=noisy.reference.later(noisy.t[1]),
        reference_pulses=noisy.reference_pulses[inner],
        error_pulses=noisy.reference_pulses[inner] - counts,
        current=late,
        valid=noisy.valid[inner],
    )
    causes = record.check().causes
    # Whole rows: to read between two of them makes the noise smaller, and is no evidence.
    assert [(found.name, found.joints, found.size) for found in causes] == (
        [(cause, (), 1.0)] if cause else []
    )


@pytest.mark.slow
def test_a_filter_that_is_stated_in_hertz_is_named(noisy):
    hertz = dataclasses.replace(noisy.law, filter=noisy.law.filter / (2 * np.pi))
    checkup = dataclasses.replace(noisy, law=hertz).check()
    assert [found.name for found in checkup.causes] == ["filter in Hz"]
    assert checkup.corrected.law.filter == pytest.approx(noisy.law.filter)


def test_a_mistake_of_a_joint_shows_in_that_joint(noisy):
    """What makes the log of another joint likelier, and that of this one less so, is no evidence."""
    turned = turned_torque(noisy, (1,), 1.0)

    def undo(record, joints, size):
        changed = turned_torque(record, (1,), size)
        if joints == (1,):
            return changed
        scale = np.where(np.isin(range(record.n), joints), 1.2, 1.0)
        return dataclasses.replace(changed, current=scale * changed.current)

    row = Hypothesis(name="turned", sentence="", remedy="", undo=undo, scope=each_joint)
    assert [found.joints for found in Trials([row])(Experiment(turned))] == [(1,)]


@pytest.mark.slow
def test_a_joint_at_rest_has_no_motion_that_explains_a_torque():
    """Its derivatives were rounding errors, and explained the constant torque of any trial."""
    record = drawn(104).record
    assert np.ptp(record.counts[:, 1]) == 0
    experiment = Experiment(record)
    turned = experiment.changed(turned_reference(record, (1,), 1.0))
    assert turned.torque[0, 1] != 0
    for trial in (experiment, turned):
        assert trial.motions[1].unexplained == 1
        assert trial.terms["motion"][1] == 0
    assert record.check().causes == ()


def test_a_law_is_run_again_only_where_its_counts_change(noisy):
    """No change of a logged torque changes what the law commands."""
    experiment = Experiment(noisy)
    turned = experiment.changed(turned_torque(noisy, (0,), 1.0))
    late = experiment.changed(counts_in_time(noisy, (0,), 1.0))
    assert experiment.torque_along is not None
    assert turned.torque_along is experiment.torque_along
    assert not np.array_equal(late.torque_along, experiment.torque_along)
    assert turned.command == pytest.approx(Experiment(turned.record).command, rel=0, abs=0)


def test_a_trial_that_no_torque_can_save_runs_no_law(cascaded):
    """A bound of its score is beyond the score, and is given where it is already too small."""
    experiment = Experiment(cascaded)
    turned = experiment.changed(turned_reference(cascaded, (0,), 1.0))
    assert experiment.largest_score >= experiment.score
    assert experiment.gain(turned, 5.0) == turned.largest_score - experiment.score < 5
    assert "torque_along" not in vars(turned)
    assert turned.largest_score >= turned.score

    mistaken = Experiment(turned.record)
    right = mistaken.changed(cascaded)
    assert mistaken.gain(right, 5.0) == right.score - mistaken.score > 5


@pytest.mark.parametrize(("tolerance", "size", "count"), [(0.3, 2, 1), (None, 2, 1), (None, 0, 3)])
def test_a_mistake_of_one_size_is_accepted_once(tolerance, size, count):
    """Where undoing it is not exact, the rest looks like the same mistake again."""
    row = Hypothesis(
        name="scale",
        sentence="The torque is {value:.3g} times too large",
        remedy="Divide it.",
        undo=lambda experiment, joints, size: experiment + 1,
        tolerance=tolerance,
    )

    def candidates(experiment):
        # Without a size of its own, each step has another one.
        yield Candidate(row, (), size or experiment + 2.0, 50.0, lambda: experiment + 1)

    causes = ranking(0, candidates, ("1", "2")).causes
    assert [cause.name for cause in causes] == ["scale"] * count

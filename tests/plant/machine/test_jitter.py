"""Jitter: what a law reads of an arm at constant speed, and the statistics of its instants."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from scipy import stats

from ctc import ComputedTorque
from plant import (
    Elasticity,
    Jitter,
    LoggedTorque,
    Rig,
    StatelessLaw,
    number,
    part,
    puma560,
    replay,
    simulate,
    structure,
)

RIG, PERIOD, PATH = puma560.rig(), puma560.rig().period, puma560.reference()
FREE = dataclasses.replace(
    RIG.drive, viscous=(0, 0), coulomb=(0, 0), current_limit=(np.inf, np.inf)
)
# so heavy that no torque moves it, and no gravity
STILL = puma560.dynamics().arm([1e6, 1e6, 0, 0, 0, 0, 3e6, 0, 0])


@part
class Reading(StatelessLaw):
    """A torque that tells the counts that were read."""

    scale: float = number(())
    period: float = structure(float, default=PERIOD)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return self.scale * pulses, state


def shaken(rig=RIG, **options):
    return dataclasses.replace(rig, jitter=Jitter(**options))


def lateness(jitter, *, every=1, drive=FREE, side="motor", arm=STILL, duration=0.7):
    """How late each step of the law read the encoders [s], from what it read of a moving arm."""
    encoder = dataclasses.replace(RIG.encoder, smooth=True, side=side)
    rig = Rig(drive=drive, encoder=encoder, period=PERIOD, jitter=jitter)
    law = Reading(scale=1e-3, period=every * PERIOD)
    record = simulate(arm, rig, law, PATH, duration=duration, initial=[[0.0, 0.0], [1.0, -0.5]])
    read, q, qd = record.torque[::every] / 1e-3, record.true_q[::every], record.true_qd[::every]
    late = (read - rig.position_in_pulses(q)) / rig.position_in_pulses(qd)
    moving = np.abs(qd).min(axis=1) > 1e-2
    # one instant for all joints
    np.testing.assert_allclose(late[moving, 0], late[moving, 1], atol=1e-9)
    return late[:, 0]


def drawn(jitter, steps, period=PERIOD):
    """Lateness [s] of each step, by the part itself."""
    draw = ca.SX.sym("draw", 1, steps)
    return ca.Function("late", [draw], [jitter.late(draw, period)])(
        jitter.draws(steps)[None]
    ).full()[0]


@pytest.mark.parametrize("every", [1, 2])
def test_the_law_reads_up_to_its_share_early_or_late(every):
    late = lateness(Jitter(share=0.2), every=every, duration=1.4)
    np.testing.assert_allclose(late, drawn(Jitter(share=0.2), len(late), every * PERIOD), atol=1e-9)
    late = late / (0.2 * every * PERIOD)
    assert np.abs(late).max() <= 1 + 1e-9
    assert stats.kstest(late, stats.uniform(-1, 2).cdf).pvalue > 0.01


def test_the_draws_are_the_seed_s_and_the_stream_s():
    first = lateness(Jitter(share=0.2))
    np.testing.assert_array_equal(first, lateness(Jitter(share=0.2)))
    np.testing.assert_allclose(lateness(Jitter(share=0.1)), first / 2, atol=1e-12)
    for other in (Jitter(share=0.2, seed=1), Jitter(share=0.2, stream=1.0)):
        assert abs(np.corrcoef(first, lateness(other))[0, 1]) < 4 / np.sqrt(len(first))


def test_an_encoder_on_the_link_moves_with_the_link():
    """Motors that friction stops at once, links that swing on: what is read lies on the motion
    of the links.
    """
    arm, jitter = puma560.literature_arm(1.5), Jitter(share=0.3, seed=2)
    elasticity = Elasticity.from_resonance(arm, 20, 0.005, drive=RIG.drive)
    drive = dataclasses.replace(
        RIG.drive, coulomb=(5.0, 5.0), current_limit=(100, 100), elasticity=elasticity
    )
    late = lateness(jitter, drive=drive, side="link", arm=arm, duration=0.05)
    np.testing.assert_allclose(late[1:12], drawn(jitter, 12)[1:], atol=1e-9)


def test_streams_are_uniform_and_independent_of_each_other():
    """Loops side by side have one table of draws; forty of them, each with each."""
    steps = 5000
    instants = np.array([drawn(Jitter(share=0.5, stream=s), steps, 1.0) for s in range(40)]) + 0.5
    # forty tests
    assert min(stats.kstest(row, stats.uniform.cdf).pvalue for row in instants) > 1e-4
    correlation = np.corrcoef(instants)[np.triu_indices(40, 1)]
    assert np.abs(correlation).max() < 4.5 / np.sqrt(steps)  # 780 pairs
    serial = [np.corrcoef(row[:-1], row[1:])[0, 1] for row in instants]
    assert np.abs(serial).max() < 4.5 / np.sqrt(steps)


def test_no_jitter_changes_no_bit():
    arm, law = puma560.arm(), ComputedTorque(puma560.arm(), RIG)
    one, other = (simulate(arm, rig, law, PATH, duration=0.1) for rig in (RIG, shaken(share=0.0)))
    np.testing.assert_array_equal(one.true_q, other.true_q)
    np.testing.assert_array_equal(one.torque, other.torque)
    assert not np.array_equal(
        one.torque, simulate(arm, shaken(share=0.1), law, PATH, duration=0.1).torque
    )


def test_a_repeated_log_reads_nothing():
    """The torque of a record with jitter moves the arm as in the record, with jitter in the rig
    or without.
    """
    arm, law = puma560.arm(), ComputedTorque(puma560.arm(), RIG)
    record = simulate(arm, shaken(share=0.2), law, PATH, duration=0.1)
    given = dataclasses.replace(record, law=LoggedTorque())
    again = replay(arm, given)
    np.testing.assert_array_equal(again.error_pulses, record.error_pulses)
    np.testing.assert_array_equal(replay(arm, given, rig=RIG).true_q, again.true_q)


def test_casadi_gives_the_same():
    arm, law = puma560.arm(), ComputedTorque(puma560.arm(), RIG)
    one, other = (
        simulate(arm, shaken(share=0.2), law, PATH, duration=0.2, backend=b)
        for b in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, atol=1e-10)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Jitter(share=-0.1), "share must be from 0 to 0.5"),
        (lambda: Jitter(share=0.6), "share must be from 0 to 0.5"),
        (lambda: Jitter(share=0.1, seed=-1), "seed must be a whole number"),
        (lambda: Jitter(share=0.1, seed=0.5), "seed must be a whole number"),
        (lambda: Jitter(share=0.1, stream=0.5), "stream must be a whole number"),
        (lambda: Jitter(share=0.1, stream=2**20), "stream must be a whole number"),
        (lambda: dataclasses.replace(RIG, jitter=0.1), "jitter of Rig must be of type Jitter"),
        (
            lambda: simulate(puma560.arm(), shaken(share=0.1), puma560.p_law(), PATH),
            "a rig with jitter needs a law with a period; got none",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(make, said):
    with pytest.raises(ValueError, match=said) as error:
        make()
    assert "\n" not in str(error.value)

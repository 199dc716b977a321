"""Late torque, lost counts and the encoder's phase: against pencil and paper, and the same done
by hand.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest

from ctc import ComputedTorque
from plant import (
    PD,
    Encoder,
    Law,
    P,
    Phase,
    Record,
    Rig,
    StatelessLaw,
    Transport,
    number,
    part,
    puma560,
    replay,
    simulate,
    structure,
    to_control,
)
from plant.parts import from_plain

RIG, PERIOD = puma560.rig(), puma560.rig().period
SMOOTH = dataclasses.replace(RIG.drive, viscous=(0, 0), coulomb=(0, 0))
STILL = puma560.dynamics().arm([1.6, 1.4, 0, 0, 0, 0, 6.6, 0, 0])  # constant D, no gravity
PATH = puma560.reference()


def carrying(rig=RIG, **options):
    return dataclasses.replace(rig, transport=Transport(**options))


@part
class Push(StatelessLaw):
    """A constant torque."""

    torque: np.ndarray = number(("n",))
    period: float = structure(float, default=PERIOD)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return ca.SX(self.torque), state


@part
class Spring(StatelessLaw):
    """A torque that tells the counts that were read."""

    stiffness: float = number(())
    period: float = structure(float, default=PERIOD)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return -self.stiffness * pulses, state


@part
class Late(Law):
    """Another sampled law, what it asks for held back for one sample."""

    law: Law = structure(Law)

    @property
    def period(self):
        return self.law.period

    def initial_state(self, n):
        return np.append(self.law.initial_state(n), np.zeros(n))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        asked, following = self.law.equations(rig, state[: -rig.n], setpoint, pulses, torque, dt)
        return state[-rig.n :], ca.vertcat(following, asked)


# -- delay ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("delay", [0.0, 1e-4, 1.75e-4, 3.3e-4, PERIOD])
def test_the_impulse_of_a_late_torque(delay):
    """No friction, no gravity: D qd = torque (t - delay), for any delay, also a part of a
    sub-step (0.175 ms).
    """
    rig = carrying(dataclasses.replace(RIG, drive=SMOOTH), delay=delay)
    record = simulate(
        STILL, rig, Push(torque=(3.0, 2.0)), PATH, duration=0.02, initial=np.zeros((2, 2))
    )
    expected = np.maximum(record.t - delay, 0)[:, None] * np.linalg.solve(
        STILL.D(np.zeros(2)), (3.0, 2.0)
    )
    np.testing.assert_allclose(record.true_qd, expected, atol=1e-13)  # rounding


def test_a_delay_of_one_sample_is_a_law_that_waits_for_one():
    arm, law = (
        puma560.arm(),
        PD(gain=(0.3, 0.2), derivative=(3e-4, 2e-4), filter=1000.0, period=PERIOD),
    )
    late = simulate(arm, carrying(delay=PERIOD), law, PATH, duration=0.1)
    waits = simulate(arm, RIG, Late(law=law), PATH, duration=0.1)
    np.testing.assert_array_equal(late.true_q, waits.true_q)
    np.testing.assert_array_equal(late.torque[:-1], waits.torque[1:])
    assert not np.array_equal(late.true_q, simulate(arm, RIG, law, PATH, duration=0.1).true_q)


def test_no_delay_and_no_loss_change_no_bit():
    arm, law = puma560.arm(), ComputedTorque(puma560.arm(), RIG)
    one, other = (simulate(arm, rig, law, PATH, duration=0.1) for rig in (RIG, carrying()))
    np.testing.assert_array_equal(one.true_q, other.true_q)
    np.testing.assert_array_equal(one.torque, other.torque)


# -- lost counts ---------------------------------------------------------------------------------
def test_the_law_reads_the_counts_before_where_they_are_lost():
    rig = carrying(dataclasses.replace(RIG, drive=SMOOTH), lost=(5, 6, 20))
    start = [[0.003, -0.004], [2.0, 3.0]]
    record = simulate(STILL, rig, Spring(stiffness=0.1), PATH, duration=0.03, initial=start)
    seen = record.counts.copy()
    seen[[5, 6]], seen[20] = seen[4], seen[19]
    assert (record.counts[[5, 6, 20]] != seen[[5, 6, 20]]).all()
    np.testing.assert_allclose(record.torque, -0.1 * seen, rtol=1e-14)


@pytest.mark.parametrize("samples", [1, 2])
def test_a_cut_counts_the_lost_steps_from_its_own_start(samples):
    """In steps of the law, which may be longer than a sample."""
    rig = carrying(lost=(5, 20, 30))
    law = Push(torque=(0.1, 0.1), period=samples * PERIOD)
    record = simulate(STILL, rig, law, PATH, duration=80 * PERIOD)
    for begin, lost in ((0, (5, 20, 30)), (4, (1, 16, 26)), (5, (15, 25)), (20, (10,)), (35, ())):
        cut = record.cut((begin * samples - 0.5) * PERIOD)
        assert cut.rig.transport.lost == lost
    assert dataclasses.replace(record, law=None).cut(9.5 * PERIOD).rig.transport.lost == (10, 20)


def test_a_cut_is_replayed_with_the_losses_of_its_record():
    rig = carrying(lost=range(25, 40))
    law = PD(gain=(0.3, 0.2), derivative=(3e-4, 2e-4), filter=1000.0, period=PERIOD)
    record = simulate(puma560.arm(), rig, law, PATH, duration=0.06)
    cut = record.cut(14.5 * PERIOD)
    again = replay(
        puma560.arm(), dataclasses.replace(cut, initial=[record.true_q[15], record.true_qd[15]])
    )
    assert np.abs(again.error_pulses - cut.error_pulses).max() < 3


def test_casadi_gives_the_same():
    arm, law = puma560.arm(), ComputedTorque(puma560.arm(), RIG)
    rig = carrying(delay=2e-4, lost=(40, 41, 90))
    one, other = (
        simulate(arm, rig, law, PATH, duration=0.1, backend=name) for name in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, atol=1e-10)


# -- the encoder's phase -------------------------------------------------------------------------
def test_a_shifted_encoder_is_a_shifted_arm():
    """Where no equation knows the position, a shift of the counters' zero is one of the arm, by
    so many pulses.
    """
    shift = np.array([0.375, -0.25])
    encoder = Encoder(resolution=RIG.encoder.resolution, rounding="fix", phase=Phase(shift=shift))
    law, q, qd = ComputedTorque(STILL, RIG), *(x[0] for x in PATH(np.zeros(1))[:2])
    shifted = simulate(STILL, dataclasses.replace(RIG, encoder=encoder), law, PATH, duration=0.3)
    by_hand = simulate(STILL, RIG, law, PATH, duration=0.3, initial=[q + RIG.to_angle(shift), qd])
    np.testing.assert_array_equal(shifted.error_pulses, by_hand.error_pulses)
    np.testing.assert_allclose(shifted.true_q + RIG.to_angle(shift), by_hand.true_q, atol=1e-10)
    plain = simulate(STILL, RIG, law, PATH, duration=0.3)
    assert not np.array_equal(shifted.error_pulses, plain.error_pulses)


def test_a_controller_does_not_know_the_phase():
    encoder = Encoder(
        resolution=RIG.encoder.resolution, rounding="fix", phase=Phase(shift=(0.5, 0.5))
    )
    rig, q = dataclasses.replace(RIG, encoder=encoder), RIG.to_angle(np.array([7.75, -7.75]))
    np.testing.assert_array_equal(rig.counts(q), [7, -7])
    np.testing.assert_array_equal(rig.true_counts(q), [8, -7])
    np.testing.assert_array_equal(RIG.true_counts(q), RIG.counts(q))
    np.testing.assert_array_equal(
        rig.cell_centre(np.array([7.0, -7.0])), RIG.cell_centre(np.array([7.0, -7.0]))
    )


# -- descriptions and refusals -------------------------------------------------------------------
def test_a_record_keeps_them(tmp_path):
    rig = carrying(delay=2e-4, lost=(3, 5))
    rig = dataclasses.replace(
        rig, encoder=dataclasses.replace(rig.encoder, phase=Phase(shift=(0.1, 0.2)))
    )
    law = ComputedTorque(puma560.arm(), RIG)
    record = simulate(puma560.arm(), rig, law, PATH, duration=0.02)
    record.to_csv(tmp_path / "log.csv")
    assert Record.from_csv(tmp_path / "log.csv").rig == from_plain(rig.describe()) == rig
    assert {"encoder.phase.shift[1]", "transport.delay"} < set(rig.number_names())
    assert to_control(rig).name == "rig"
    # torque comes from outside: no way to be late
    assert to_control(puma560.arm(), rig, sampled=True).name == "arm"


WRONG = {
    "a delay before the sample": (lambda: Transport(delay=-1e-4), "delay must not be negative"),
    "the first sample": (lambda: Transport(lost=(0,)), "The first counts arrive"),
    "a number, not steps": (lambda: Transport(lost=5), "must be a sequence of steps"),
    "half a step": (lambda: Transport(lost=(1.5,)), "whole numbers of at least 1"),
    "a truth, not a step": (lambda: Transport(lost=[True]), "whole numbers of at least 1"),
    "no power of two": (lambda: Transport(bit=0.3), "bit must be 1, or"),
    "no bit": (lambda: Transport(bit=0), "bit must be 1, or"),
    "a bit behind the point": (lambda: Transport(bit=2), "bit must be 1, or"),
    "a number, not a transport": (
        lambda: Rig(drive=RIG.drive, encoder=RIG.encoder, period=PERIOD, transport=1e-4),
        "transport of Rig must be of type Transport",
    ),
    "a number, not a phase": (
        lambda: Encoder(resolution=(1, 1), phase=0.5),
        "phase of Encoder must be of type Phase",
    ),
    "a phase too few": (
        lambda: Encoder(resolution=(1, 1), phase=Phase(shift=(0.5,))),
        "phase.shift must have 2 joints",
    ),
    "fast hardware": (
        lambda: simulate(puma560.arm(), carrying(), P(gain=(0.2, 0.15)), PATH),
        "needs a law whose period is at least its delay",
    ),
    "two samples late": (
        lambda: simulate(puma560.arm(), carrying(delay=2 * PERIOD), Push(torque=(1, 1)), PATH),
        "needs a law whose period is at least its delay",
    ),
}


def test_the_lost_steps_may_come_from_an_iterator():
    assert Transport(lost=iter((100, 101))).lost == (100, 101)


@pytest.mark.parametrize(("call", "message"), WRONG.values(), ids=WRONG)
def test_wrong_calls_are_refused_in_one_line(call, message):
    with pytest.raises(ValueError, match=message) as refusal:
        call()
    assert "\n" not in str(refusal.value)

"""The linearised error loop against one written down by hand, its margins against what brute
force finds.
"""

import dataclasses
from functools import cache

import casadi as ca
import numpy as np
import pytest
from error_loops import error_loops

from ctc import ComputedTorque, ComputedTorqueSettings, error_loop, margins
from ctc.stability import opened
from identification import identify
from plant import PointToPoint, StatelessLaw, number, part, puma560, read_robot, simulate, structure
from plant.analysis import SampledLoops

RIG, ARM, POSE = puma560.rig(), puma560.arm(), (0.3, -0.4)
DT = RIG.period
SETTINGS = ComputedTorqueSettings()
OPTIONS = [{}, {"delay": 1}, {"measured": True, "bandwidth": 150.0}]


def rig_with(**changes):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **changes))


@cache
def found(index):
    return margins(None, RIG, ComputedTorque(ARM, RIG, **OPTIONS[index]), pose=POSE)


def by_hand(law, joint, z):
    """L of a joint at points z, the loop of the other closed."""
    A, B, C = error_loops(
        np.linalg.inv(law.arm.D(POSE)),
        law.bandwidth,
        law.bandwidth * law.observer_ratio,
        DT,
        law.delay,
    )
    a, b, c = opened(A, B, C, joint)
    return np.array([-(c @ np.linalg.solve(each * np.eye(len(a)) - a, b)).item() for each in z])


@pytest.mark.parametrize(
    "options", [{}, {"delay": 1}, {"measured": True}, {"bandwidth": 120.0, "observer_ratio": 4.0}]
)
def test_the_loop_of_a_joint_is_the_one_written_down_by_hand(options):
    """An arm without weight and friction. Every entry agrees to 1e-8 of L: the simulator's
    sub-steps are exact for a torque that is held (the solve loses three digits at the lowest
    point).
    """
    weightless = puma560.dynamics().arm(
        np.where(np.isin(np.arange(9), (4, 5, 7, 8)), 0.0, puma560.PUBLISHED)
    )
    rig = rig_with(viscous=(0.0, 0.0))
    law = ComputedTorque(weightless, rig, **options)
    z = np.exp(1j * np.geomspace(10, 4000, 25) * DT)
    for joint in range(2):
        system = error_loop(None, rig, law, joint=joint, pose=POSE)
        assert system.dt == DT
        np.testing.assert_allclose(system(z), by_hand(law, joint, z), rtol=1e-8)


def radius_of(matrix):
    """Largest magnitude of its eigenvalues."""
    return np.abs(np.linalg.eigvals(matrix)).max()


@pytest.mark.parametrize("index", range(len(OPTIONS)))
def test_margins_are_where_the_closed_loop_becomes_unstable(index):
    """The largest eigenvalue of the closed loop crosses 1 between 0.5 % below and above each
    margin: the grid of the frequencies is far finer (4,000 points over four decades: 0.2 %).
    """
    law, result = ComputedTorque(ARM, RIG, **OPTIONS[index]), found(index)
    A, B, C = SampledLoops(law.arm, RIG, law, POSE).matrices()
    assert result.stable
    for joint in range(2):
        a, b, c = opened(A, B, C, joint)

        def radius(factor, a=a, b=b, c=c):
            return radius_of(a + factor * b @ c)

        up, down, phase = (
            result.gain_up[joint],
            result.gain_down[joint],
            np.deg2rad(result.phase[joint]),
        )
        assert radius(0.995 * up) < 1 < radius(1.005 * up)
        assert radius(1.005 * down) < 1 < radius(0.995 * down)
        assert radius(np.exp(-0.995j * phase)) < 1 < radius(np.exp(-1.005j * phase))
        samples = result.delay[joint] / DT
        for count, stable in ((int(np.floor(samples)), True), (int(np.ceil(samples)), False)):
            late = np.eye(count, k=-1)
            size = len(a)
            delayed = np.zeros((size + count, size + count))
            delayed[:size, :size], delayed[:size, -1:] = a, b
            delayed[size:, size:], delayed[size : size + 1, :size] = late, c
            assert (radius_of(delayed) < 1) == stable


@pytest.mark.parametrize(("factor", "grows"), [(0.9, False), (1.07, True)])
def test_the_simulation_agrees_on_the_gain_margin(factor, grows):
    """The model too heavy by the margin, both joints at once: their loops are nearly one. No limit,
    no rounding.

    At 10 % below the margin of one joint alone the mode at 89 Hz decays with 9 1/s, at 7 % above it
    grows with 19 1/s, as its pole says within 2 1/s: the peaks of 50 samples hold five periods of
    it, and some of the other joint's mode, which decays 16 1/s sooner.
    """
    rig = rig_with(viscous=(0.0, 0.0), coulomb=(0.0, 0.0), current_limit=(np.inf, np.inf))
    rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
    poles = {"bandwidth": 250.0, "observer_ratio": 1.5}
    up = margins(ARM, rig, ComputedTorque(ARM, rig, **poles), pose=POSE).gain_up.mean()
    law = ComputedTorque(puma560.dynamics().arm(factor * up * ARM.f), rig, **poles)
    assert margins(ARM, rig, law, pose=POSE).stable != grows
    A, B, C = SampledLoops(ARM, rig, law, POSE).matrices()
    poles = np.abs(np.linalg.eigvals(A + B @ C))
    expected = (
        np.log(
            poles[~np.isclose(poles, np.exp(-DT / SETTINGS.swing_memory), rtol=0, atol=1e-9)].max()
        )
        / DT
    )
    assert (expected > 5) if grows else (expected < -5)
    hold = PointToPoint(start=POSE, goal=POSE, duration=0.4)
    error = simulate(ARM, rig, law, hold, initial=[np.add(POSE, 1e-6), (0, 0)]).error_pulses
    early, late = (np.abs(error[a:b]).max() for a, b in ((300, 350), (500, 550)))
    assert np.log(late / early) / (200 * DT) == pytest.approx(expected, abs=2)


def test_delay_and_bandwidth_cost_margin():
    plain, delayed, slow = (found(i) for i in range(3))
    assert (delayed.phase < plain.phase).all()
    assert (delayed.sensitivity > plain.sensitivity).all()
    assert (slow.delay > plain.delay).all()
    peak = np.abs(1 / (1 + plain.response)).max(axis=1)
    np.testing.assert_array_equal(plain.sensitivity, peak)
    # With its peak known, margins cannot be below what it promises.
    assert (plain.gain_up >= peak / (peak - 1) * (1 - 1e-3)).all()
    assert (np.deg2rad(plain.phase) >= 2 * np.arcsin(0.5 / peak) * (1 - 1e-3)).all()


def test_a_model_much_too_heavy_is_said_to_be_unstable():
    law = ComputedTorque(puma560.dynamics().arm(4.5 * ARM.f), RIG)
    assert not margins(ARM, RIG, law).stable
    assert str(margins(ARM, RIG, law)).startswith("The closed loop is not stable.")


@pytest.mark.slow
def test_the_arm_may_be_an_identification_or_that_of_the_law():
    record = simulate(ARM, RIG, puma560.p_law(), puma560.reference(), duration=0.5)
    known, law = identify(ARM.dynamics, record, seed=1, progress=False), ComputedTorque(ARM, RIG)
    for arm, same in ((known, known.arm), (None, ARM)):
        np.testing.assert_array_equal(
            margins(arm, RIG, law).response, margins(same, RIG, law).response
        )
        z = np.exp(1j * np.geomspace(0.01, 1, 5))
        np.testing.assert_array_equal(error_loop(arm, RIG, law)(z), error_loop(same, RIG, law)(z))


def test_table_and_figure_show_each_joint():
    said, _, *text, gears, _ = str(found(0)).splitlines()
    assert said == "The closed loop is stable."
    assert gears.startswith("rigid gears assumed; stable on gears that resonate above")
    assert f"{found(0).phase[1]:.1f}" in text[2]
    assert text[1].startswith("joint 2 (q[0])  ")
    assert len(set(map(len, text))) == 1
    assert [axis.get_ylabel() for axis in found(0).plot()] == [
        "loop gain [dB]",
        "phase [°]",
        "sensitivity [dB]",
    ]


@part
class Remembering(ComputedTorque):
    """Computed torque that keeps a number for ever, as an adaptive law at rest keeps its
    parameters.
    """

    def initial_state(self, n):
        return np.append(0.7, super().initial_state(n))

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        asked, following = super().equations(rig, state[1:], setpoint, pulses, torque, dt)
        return asked, ca.vertcat(state[0], following)


def test_what_a_law_keeps_is_no_instability():
    result = margins(None, RIG, Remembering(ARM, RIG), pose=POSE)
    assert result.stable
    np.testing.assert_allclose(result.phase, found(0).phase, rtol=1e-6)


@part
class Sagging(StatelessLaw):
    """A sampled spring without a model: the arm hangs below its reference."""

    stiffness: np.ndarray = number(("n",))
    period: float = structure(float)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return self.stiffness * (setpoint.q - rig.cell_centre(pulses)), state


def test_an_arm_is_linearised_where_it_hangs():
    """At rest the spring carries the weight; the stiffness of gravity there is in the loop: L(1)
    = stiffness / it.
    """
    law = Sagging(stiffness=(4e3, 3e3), period=DT)
    from plant.analysis import held
    from plant.machine import smooth_rig

    rig = smooth_rig(RIG)
    q, _, torque, _ = held(ARM, rig, law, law.block(rig), np.array(POSE))
    np.testing.assert_allclose(law.stiffness * (POSE - q), ARM.h(q, np.zeros(2)), rtol=1e-9)
    np.testing.assert_allclose(torque, ARM.h(q, np.zeros(2)), rtol=1e-9)
    assert np.abs(POSE - q).max() > 1e-3


@pytest.mark.parametrize(
    ("stiffness", "limit"), [((400.0, 300.0), "gain_down"), ((4e7, 2e6), "gain_up")]
)
def test_a_loop_may_become_unstable_without_a_phase_crossing(stiffness, limit):
    """Where its response is real: at rest, by the weight alone, or from one sample to the next.
    Joint 3 hangs upwards, and viscous friction ends the motion within a sample.
    """
    rig, law = rig_with(viscous=(3.0, 3.0)), Sagging(stiffness=stiffness, period=DT)
    result = margins(ARM, rig, law, pose=POSE)
    assert result.stable
    margin = getattr(result, limit)[1]
    a, b, c = opened(*SampledLoops(ARM, rig, law, POSE).matrices(), 1)
    inside, outside = (radius_of(a + margin**power * b @ c) for power in (0.995, 1.005))
    assert 0 < margin < np.inf
    assert inside < 1 < outside


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda law: margins(ARM, RIG, puma560.p_law()), "law must have a period; P has none"),
        (
            lambda law: margins(None, RIG, Sagging(stiffness=(1, 1), period=DT)),
            "arm must be of type Arm",
        ),
        (lambda law: margins(ARM, ARM, law), "rig must be of type Rig"),
        (lambda law: margins(ARM, RIG, law, pose=(0,)), "pose must have shape"),
        (lambda law: margins(ARM, RIG, law, posee=(0, 0)), "Did you mean 'pose'"),
        (lambda law: error_loop(None, RIG, law, joints=1), "Did you mean 'joint'"),
        (lambda law: margins(RIG, RIG, law), "arm must be of type Arm; got a value of type Rig"),
        (
            lambda law: error_loop(None, RIG, law, joint=2),
            "joint must be a whole number from 0 to 1; got 2",
        ),
        (
            lambda law: error_loop(None, RIG, law, joint=True),
            "joint must be a whole number from 0 to 1; got True",
        ),
        (
            lambda law: margins(read_robot("ur5e").arm, RIG, law),
            "rig must have 6 joints like the arm; got 2",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call(ComputedTorque(ARM, RIG))
    assert "\n" not in str(refusal.value)

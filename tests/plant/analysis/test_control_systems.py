"""Arm, rig and law under python-control's own solvers, against the simulator."""

import dataclasses
import warnings

import numpy as np
import pytest
from closed_loops import NoTorque, SampledP, without_friction
from demands import one_joint

from ctc import ComputedTorque
from plant import Law, StatelessLaw, number, part, puma560, simulate, to_control

control = pytest.importorskip("control")

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
N = 2


def labels(*names):
    return [f"{name}[{i}]" for name in names for i in range(N)]


def joined(law, rig, arm_system):
    systems = [to_control(law, rig), to_control(rig), arm_system]
    return control.interconnect(
        systems, inputs=labels("q_r", "qd_r", "qdd_r"), outputs=labels("q", "qd", "tau")
    )


def motion(t):
    return np.hstack(PATH(t)).T


def test_the_p_loop_by_an_ode_solver_is_the_simulation():
    """Smooth encoder, viscous friction alone, 0.05 s, in which the modes of 29 and 42 Hz swing once
    and twice.

    Tolerance: the simulator's midpoint step (16 per sample) shifts that mode by (w h)^2 / 24 = 6e-6
    of its phase of 13, so by 8e-5 of an amplitude of some pulses; the reference between two points
    of the solver is a straight line, off by 7 rad/s^2 (88e-6 s)^2 / 8 = 7e-9 rad. A pulse of joint
    2 is 7e-5 rad.
    """
    rig = without_friction(RIG, viscous=True, smooth=True)
    record = simulate(ARM, rig, LAW, PATH, duration=0.05, steps_per_sample=16)
    t = np.arange(8 * (len(record) - 1) + 1) * rig.period / 8
    loop = joined(LAW, rig, to_control(ARM, rig))
    start = PATH(np.zeros(1))
    given = control.input_output_response(
        loop,
        t,
        motion(t),
        [start.q[0], start.qd[0]],
        solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-10},
    )
    assert np.abs(record.error_pulses).max() > 1
    np.testing.assert_allclose(given.outputs[:N, ::8].T, record.true_q, rtol=0, atol=1e-3 * 7e-5)


def test_an_arm_without_a_rig_moves_as_inverse_dynamics_says():
    """forward(inverse) is the identity: to some hundred roundings."""
    random = np.random.default_rng(0)
    q, qd, qdd = random.normal(size=(3, N))
    rate = to_control(ARM).dynamics(0, np.concatenate([q, qd]), ARM.inverse(q, qd, qdd))
    np.testing.assert_allclose(rate, np.concatenate([qd, qdd]), rtol=0, atol=1e-11)


def test_friction_acts_against_the_motion_of_a_continuous_arm():
    """Far above the speed of regularisation: exactly the friction torque of the drive."""
    q, qd = np.array([0.3, -0.2]), np.array([0.5, -0.8])
    with_rig, without = (system.dynamics(0, np.concatenate([q, qd]), [50.0, 20.0])[N:]
                         for system in (to_control(ARM, RIG), to_control(ARM)))  # fmt: skip
    np.testing.assert_allclose(ARM.D(q) @ (without - with_rig), RIG.drive.friction(qd), rtol=1e-9)


@pytest.mark.parametrize(
    "law",
    [
        ComputedTorque(ARM, RIG),
        ComputedTorque(ARM, RIG, measured=True, delay=1),
        SampledP(gain=LAW.gain / 10, period=RIG.period),
    ],
    ids=["computed torque", "measured and delayed", "P"],
)
def test_a_sampled_law_with_a_sampled_arm_is_the_simulation(law):
    """Sample by sample, set-valued friction and counting encoder, saturating at the start; casadi
    evaluates both.

    Tolerance: the two functions order their sums in other ways; 100 samples amplify such roundings
    by little, as long as no count differs (none does).
    """
    start = np.array([[0.005, -0.005], [0, 0]])
    record = simulate(ARM, RIG, law, PATH, duration=0.07, initial=start, backend="casadi")
    loop = joined(law, RIG, to_control(ARM, RIG, sampled=True))
    assert loop.dt == RIG.period
    at_rest = [law.block(RIG).initial, np.zeros(N), *start, np.zeros(N)]
    given = control.input_output_response(loop, record.t, motion(record.t), at_rest)
    np.testing.assert_allclose(given.outputs[:N].T, record.true_q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(given.outputs[2 * N :].T, record.torque, rtol=0, atol=1e-9)
    if isinstance(law, ComputedTorque):
        assert (np.abs(record.torque) >= RIG.drive.torque_limit() * (1 - 1e-12)).any()


@part
class Integrating(Law):
    """A fast law with a state: PI, in joint torque per radian."""

    period = None

    gain: np.ndarray = number(("n",))
    integral: np.ndarray = number(("n",))

    def initial_state(self, n):
        return np.zeros(n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        error = setpoint.q - rig.cell_centre(pulses)
        return self.gain * error + state, state + dt * self.integral * error


def test_a_fast_law_with_state_is_continuous():
    law, rig = Integrating(gain=(3e3, 2e3), integral=(5e3, 4e3)), without_friction(RIG, smooth=True)
    system = to_control(law, rig)
    assert (system.dt, system.nstates) == (0, N)
    error, state = np.array([1e-3, -2e-3]), np.array([0.7, 0.9])
    u = np.concatenate([error, np.zeros(3 * N)])
    np.testing.assert_allclose(system.dynamics(0, state, u), law.integral * error, rtol=1e-12)
    np.testing.assert_allclose(system.output(0, state, u), law.gain * error + state, rtol=1e-12)


def test_the_rig_counts_and_the_drives_limit():
    system = to_control(RIG)
    assert system.dt is None
    np.testing.assert_array_equal(
        system.output(0, [], [0.1, -0.2]), RIG.counts(np.array([0.1, -0.2]))
    )
    for arm_system in (to_control(ARM, RIG), to_control(ARM, RIG, sampled=True)):
        given = arm_system.output(0, np.zeros(arm_system.nstates), [1e4, -1e4])
        np.testing.assert_allclose(given[2 * N :], RIG.drive.torque_limit() * (1, -1), rtol=1e-15)


def test_a_record_becomes_a_time_response(tmp_path):
    record = simulate(ARM, RIG, LAW, PATH, duration=0.07)
    response = to_control(record)
    np.testing.assert_array_equal(response.time, record.t)
    for name in ("error_pulses", "torque", "current", "true_q", "true_qd"):
        for i in range(N):
            np.testing.assert_array_equal(
                response.outputs[f"{name}[{i}]"], getattr(record, name)[:, i]
            )
    np.testing.assert_array_equal(
        response.inputs["reference_pulses[1]"], record.reference_pulses[:, 1]
    )
    bare = to_control(
        dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)
    )
    assert bare.output_labels == labels("error_pulses")


@part
class Remembering(StatelessLaw):
    """Asks for what was applied last."""

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return torque, state


@part
class Differencing(Law):
    """A rate from a difference, which has no limit for a short step."""

    period = None

    def initial_state(self, n):
        return np.zeros(n)

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return (pulses - state) / dt, pulses


@part
class LastPulses(Differencing):
    """A state that jumps in a step of no length."""

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return pulses - state, pulses


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: to_control(LastPulses(), RIG), "hold for dt = 0; those of LastPulses do not"),
        (lambda: to_control(RIG, RIG), "rig is for arms and laws"),
        (lambda: to_control(ARM, sampled=True), "rig must be given for a sampled arm"),
        (lambda: to_control(ARM, PATH), "rig must be of type Rig"),
        (lambda: to_control(ARM, RIG, samled=True), "Did you mean 'sampled'"),
        (
            lambda: to_control(ARM, RIG, sampled=True, steps_per_sample=0),
            "steps_per_sample must be a whole number",
        ),
        (lambda: to_control(LAW, ARM), "rig must be of type Rig"),
        (lambda: to_control(Remembering(), RIG), "Remembering does, and there is no last torque"),
        (lambda: to_control(Differencing(), RIG), "hold for dt = 0; those of Differencing do not"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)


def test_a_sampled_law_with_a_continuous_arm_is_refused_by_python_control():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ValueError, match=r"(?i)time ?base"):
            joined(ComputedTorque(ARM, RIG), RIG, to_control(ARM, RIG))
    assert to_control(NoTorque(), RIG).dt is None


@pytest.mark.parametrize("with_rig", [False, True])
def test_the_states_of_a_single_joint_have_its_number(with_rig):
    arm, _, rig = one_joint()
    system = to_control(arm, rig if with_rig else None)
    assert system.state_labels == ["q[0]", "qd[0]"]

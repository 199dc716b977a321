"""Gains against the poles that they should give, closed forms, and the observer of the law."""

import casadi as ca
import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ctc import motor_gain, observer_gains, pid_gains
from ctc.laws import predict, triple_pole
from plant import P, linearise, modes, puma560, read_robot

RIG, ARM = puma560.rig(), puma560.arm()


@given(st.floats(1, 500), st.floats(0.1, 2), st.floats(0, 500))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_pid_gains_give_the_poles_that_were_asked_for(bandwidth, damping, integral):
    """A double integrator under -(kp e + ki int e + kd edot): its polynomial is the product of
    the two factors.
    """
    kp, ki, kd = pid_gains(bandwidth, damping, integral)
    expected = np.polymul([1, 2 * damping * bandwidth, bandwidth**2], [1, integral])
    np.testing.assert_allclose([1, kd, kp, ki], expected, rtol=1e-12)


def test_a_damping_of_one_by_root_two_is_the_linear_quadratic_regulator():
    """Of a double integrator with weights 1 / e^2 and 1 / a^2, by Riccati's equation, at a
    bandwidth of sqrt(a / e).
    """
    error, acceleration = 2e-4, 8.0
    best, *_ = control.lqr(
        [[0, 1], [0, 0]], [[0], [1]], np.diag([error**-2, 0]), [[acceleration**-2]]
    )
    kp, _, kd = pid_gains(np.sqrt(acceleration / error), damping=np.sqrt(0.5))
    np.testing.assert_allclose([[kp, kd]], best, rtol=1e-6)


def test_a_motor_gain_puts_the_mode_of_a_p_loop_where_it_was_asked_for():
    """One joint held by much stiffer gains than the other's is a spring and a mass: sqrt(kp) / (2
    pi), within the few per cent by which gravity and the other joint move it.
    """
    pose, kp = (0.0, 0.0), (2 * np.pi * 30) ** 2
    gain = motor_gain(RIG, np.diag(ARM.D(pose)), kp)
    assert (gain > 0).all()
    law = P(gain=gain * (1e-3, 1.0))
    fast = modes(linearise(ARM, RIG, law, pose))[-1, 0]
    # The other joint is nearly free: what joint 3 feels is its inertia less what joint 2 gives way.
    D = ARM.D(pose)
    felt = D[1, 1] - D[0, 1] ** 2 / D[0, 0]
    assert fast == pytest.approx(30 * np.sqrt(D[1, 1] / felt), rel=0.03)


@pytest.mark.parametrize("omega", [50.0, 375.0])
def test_a_triple_pole_gives_the_gains_of_the_closed_form(omega):
    """Against the closed form in ctc.laws.observer; Ackermann's formula loses some digits near z
    = 1.
    """
    dt = RIG.period
    law = np.array(
        [float(ca.evalf(x)) for x in triple_pole(ca.SX(omega), ca.SX(dt))]
    ) / dt ** np.arange(3)
    np.testing.assert_allclose(observer_gains(RIG, poles=[-omega] * 3), [law, law], rtol=1e-6)


def test_a_motor_gain_of_one_number_is_that_of_each_joint():
    alike, single = motor_gain(RIG, (3, 1), (400, 400)), motor_gain(RIG, (3, 1), 400)
    np.testing.assert_array_equal(single, alike)
    np.testing.assert_allclose(motor_gain(RIG, (3, 1), (400, 800)), alike * (1, 2), rtol=1e-15)


def poles_of(gains, dt):
    """Continuous-time poles of the estimation error: predict, then correct by the measured one."""
    x = ca.SX.sym("x", 3)
    predicted = ca.vertcat(*predict(x[0], x[1], x[2], 0, dt))
    step = ca.Function("step", [x], [ca.jacobian(predicted - ca.DM(gains) * predicted[0], x)])
    return np.log(np.linalg.eigvals(step(np.zeros(3)).full()) + 0j) / dt


@pytest.mark.parametrize(
    "asked",
    [
        [-100, -200 + 150j, -200 - 150j],
        # Just below the Nyquist frequency, and a pair with the rounding of a computation.
        [-100, -200 + 4400j, -200 - 4400j],
        [-100, -200 + 150j, -200.0000001 - 150j],
        np.roots([1, 500, 9e4, 7e6]),
    ],
)
def test_observer_poles_are_where_they_were_asked_for(asked):
    got = poles_of(observer_gains(RIG, poles=asked)[1], RIG.period)
    np.testing.assert_allclose(np.sort_complex(got), np.sort_complex(asked), rtol=1e-6)


def test_kalman_gains_beat_all_other_gains_on_the_noise_that_they_were_made_for():
    """The variances of all three estimates, by Lyapunov's equation, are least at the Kalman
    gains; time in samples.
    """
    from scipy.linalg import solve_discrete_lyapunov

    dt, walk = RIG.period, 2000.0
    step = np.array([[1, 1, 1 / 2], [0, 1, 1], [0, 0, 1]])
    for joint, best in enumerate(observer_gains(RIG, disturbance=walk)):
        assert (poles_of(best, dt).real < 0).all()
        best = best * (1, dt, dt**2)
        ratio = walk**2 * dt**5 / (RIG.to_angle(np.ones(2))[joint] ** 2 / 12)

        def variances(gains, ratio=ratio):
            left = np.eye(3) - np.outer(gains, [1, 0, 0])
            drive = left @ np.diag([0, 0, ratio]) @ left.T + np.outer(gains, gains)
            return np.diag(solve_discrete_lyapunov(left @ step, drive))

        for place in range(3):
            for change in (0.9, 1.1):
                other = best.copy()
                other[place] *= change
                assert (variances(other) > variances(best)).all()


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: pid_gains(-1), "bandwidth must be a positive number"),
        (lambda: pid_gains(100, 0), "damping must be a positive number"),
        (lambda: pid_gains(100, 1, -5), "integral must not be negative"),
        (lambda: motor_gain(ARM, (1, 1), 1), "rig must be of type Rig"),
        (lambda: motor_gain(RIG, (1,), 1), "inertia must have shape"),
        (
            lambda: motor_gain(read_robot("tx40").rig, np.ones(6), 1),
            "motors that turn one joint each",
        ),
        (lambda: observer_gains(RIG, poles=[-1, -2]), "poles must be three"),
        (lambda: observer_gains(RIG, poles=[-1, -2, 3]), "poles must be three, stable"),
        (lambda: observer_gains(RIG, poles=[-1, -2, -3 + 1j]), "in pairs"),
        # Each has a partner, yet only two of them are a pair.
        (lambda: observer_gains(RIG, poles=[-1 + 1j, -1 + 1j, -1 - 1j]), "in pairs"),
        # The rounding of a fast pole is not that of a slow one.
        (lambda: observer_gains(RIG, poles=[-1, -2 + 1j, -1e5]), "in pairs"),
        (lambda: observer_gains(RIG, poles=[-1, -2, -np.inf]), "poles must be three"),
        (
            lambda: observer_gains(RIG, poles=[-1, -2 + 4488j, -2 - 4488j]),
            "imaginary parts below 4488 rad/s, pi divided by the rig's period",
        ),
        (lambda: motor_gain(RIG, (1, 1), np.nan), "gain must be finite"),
        (lambda: motor_gain(RIG, (1, 1), [[1], [1]]), "gain must have shape"),
        (lambda: observer_gains(RIG), "one of poles and disturbance must be given; got none"),
        (lambda: observer_gains(RIG, disturbance=-1), "disturbance must be positive"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)

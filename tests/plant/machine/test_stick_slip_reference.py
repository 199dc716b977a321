"""The event-accurate friction solver against motions known in closed form.

Unless a test says otherwise, the tolerance is 1e-9 relative: DOP853 at 1e-12 per step, times a few
hundred steps.
"""

import equation2
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from stick_slip import GearedJoint, simulate_events


def mass(m, force, C, B=0.0):
    """One mass m under force(t, x, v), as keyword arguments of `simulate_events`."""
    return {
        "D": lambda q: np.array([[m]]),
        "h": lambda q, qd: np.zeros(1),
        "C": (C,),
        "B": (B,),
        "torque": force,
    }


def kinds(events):
    return [event.kind for event in events]


def test_sliding_mass_comes_to_rest_after_v_squared_over_two_mu_g():
    m, mu, g, v = 2.0, 0.3, 9.81, 3.0
    q, events = simulate_events(
        **mass(m, lambda t, x, v: np.zeros(1), mu * m * g),
        t_end=2.0,
        q0=[0.1],
        qd0=[v],
        t_eval=[0, 0.5, 2.0],
    )
    assert kinds(events) == ["stick"]
    # A parabola is integrated exactly: rounding over some 500 steps.
    np.testing.assert_allclose(events[0].t, v / (mu * g), rtol=1e-12)
    exact = [0.1, 0.1 + v * 0.5 - mu * g * 0.5**2 / 2, 0.1 + v**2 / (2 * mu * g)]
    np.testing.assert_allclose(q[:, 0], exact, rtol=1e-12)


def test_viscous_and_coulomb_friction_stop_a_mass_in_logarithmic_time():
    m, b, C, v = 1.5, 0.7, 0.9, -4.0
    rest = m / b * np.log1p(b * abs(v) / C)
    q, events = simulate_events(
        **mass(m, lambda t, x, v: np.zeros(1), C, b), t_end=9.0, q0=[0], qd0=[v], t_eval=[9.0]
    )
    assert kinds(events) == ["stick"]
    np.testing.assert_allclose(events[0].t, rest, rtol=1e-9)
    np.testing.assert_allclose(q[0, 0], m * v / b + C / b * rest, rtol=1e-9)


def test_force_above_the_friction_turns_the_mass_round_without_a_pause():
    m, C, F, v, t_end = 2.0, 1.0, 5.0, 3.0, 2.0
    q, events = simulate_events(
        **mass(m, lambda t, x, v: np.array([-F]), C), t_end=t_end, q0=[0], qd0=[v], t_eval=[t_end]
    )
    turn = m * v / (F + C)
    assert kinds(events) == ["slip-"]
    np.testing.assert_allclose(events[0].t, turn, rtol=1e-12)
    np.testing.assert_allclose(
        q[0, 0], v * turn / 2 - (F - C) / m * (t_end - turn) ** 2 / 2, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("force", "moves"), [(0.999, False), (-0.999, False), (1.001, True), (-1.001, True)]
)
def test_resting_mass_moves_only_if_the_force_exceeds_the_friction(force, moves):
    m, C = 2.0, 3.0
    q, events = simulate_events(
        **mass(m, lambda t, x, v: np.array([force * C]), C),
        t_end=1.0,
        q0=[0],
        qd0=[0],
        t_eval=[1.0],
    )
    assert events == []
    exact = np.sign(force) * (abs(force) - 1) * C / m / 2 if moves else 0.0
    np.testing.assert_allclose(q[0, 0], exact, rtol=1e-9)


def test_free_vibration_loses_the_same_amplitude_each_half_cycle_and_stops():
    m, K, C = 0.7, 50.0, 2.0
    omega, unit = np.sqrt(K / m), C / K
    turns = np.pi / omega * np.arange(1, 6)
    q, events = simulate_events(
        **mass(m, lambda t, x, v: -K * x, C),
        t_end=1.2 * turns[-1],
        q0=[10.3 * unit],
        qd0=[0],
        t_eval=turns,
    )
    assert kinds(events) == ["slip+", "slip-", "slip+", "slip-", "stick"]
    np.testing.assert_allclose([event.t for event in events], turns, rtol=1e-9)
    np.testing.assert_allclose(q[:, 0] / unit, [-8.3, 6.3, -4.3, 2.3, -0.3], rtol=1e-9)


def test_mass_pulled_by_a_spring_sticks_and_slips_at_the_closed_form_times():
    """m x'' + C sign x' = K (r - x), r = A (1 - cos w t): sticks, slips forwards, sticks, slips
    back.
    """
    m, K, C, A, w = 0.5, 80.0, 4.0, 0.2, 2.0
    omega = np.sqrt(K / m)
    kappa = omega**2 / (omega**2 - w**2)

    def forward(t):  # position and velocity after the break-away at t1
        s, c = np.sin(omega * (t - t1)), np.cos(omega * (t - t1))
        x = A - C / K - A * kappa * np.cos(w * t) + a * c + b * s
        return x, A * kappa * w * np.sin(w * t) - omega * (a * s - b * c)

    t1 = np.arccos(1 - C / (K * A)) / w  # K r = C
    a = -(A - C / K - A * kappa * np.cos(w * t1))
    b = -A * kappa * w * np.sin(w * t1) / omega
    grid = np.linspace(t1 + 1e-3, np.pi / w + 1, 2000)
    after = np.flatnonzero(forward(grid)[1] < 0)[0]
    t2 = brentq(lambda t: forward(t)[1], grid[after - 1], grid[after], xtol=1e-15)
    x2 = forward(t2)[0]
    # Friction up to C both ways: the spring lets go where K (r - x2) first is +-C, on the way up or
    # on the way back.
    up, back = 1 - (x2 + C / K) / A, 1 - (x2 - C / K) / A
    t3 = (
        np.arccos(up) / w
        if up >= -1 and np.arccos(up) / w > t2
        else (2 * np.pi - np.arccos(back)) / w
    )
    third = "slip+" if up >= -1 and np.arccos(up) / w > t2 else "slip-"

    q, events = simulate_events(
        **mass(m, lambda t, x, v: K * (A * (1 - np.cos(w * t)) - x), C),
        t_end=t3 + 0.05,
        q0=[0],
        qd0=[0],
        t_eval=[t1, (t1 + t2) / 2, t2, (t2 + t3) / 2],
    )
    assert kinds(events)[:3] == ["slip+", "stick", third]
    np.testing.assert_allclose([event.t for event in events[:3]], [t1, t2, t3], rtol=1e-9)
    np.testing.assert_allclose(
        q[:, 0], [0, forward((t1 + t2) / 2)[0], x2, x2], rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize(("C2", "torn_loose"), [(0.6, False), (0.4, True)])
def test_sliding_joint_tears_a_resting_one_loose_only_beyond_its_friction(C2, torn_loose):
    """Constant D = [[2, 1], [1, 3]], no torque: joint 1 slides to rest, its deceleration pulls
    joint 2 with 1/2 C1.
    """
    inertia, C1, v = np.array([[2.0, 1.0], [1.0, 3.0]]), 1.0, 1.5
    zero = np.zeros(2)
    q, events = simulate_events(
        D=lambda q: inertia,
        h=lambda q, qd: zero,
        C=(C1, C2),
        B=(0, 0),
        torque=lambda t, q, qd: zero,
        t_end=6.0,
        q0=zero,
        qd0=[v, 0],
        t_eval=[6.0],
    )
    if not torn_loose:
        rest = v * inertia[0, 0] / C1
        exact = [(rest, 0, "stick")], [v * rest / 2, 0]
    else:
        # Together until joint 1 rests; then D21 qdd2 = -1/3 C2 holds joint 1, and joint 2 stops
        # alone.
        a1, a2 = np.linalg.solve(inertia, [-C1, -C2])
        t1 = v / -a1
        t2 = t1 + a2 * t1 * inertia[1, 1] / C2
        exact = [(t1, 0, "stick"), (t2, 1, "stick")], [v * t1 / 2, a2 * t1 * t2 / 2]
    assert [event[1:] for event in events] == [event[1:] for event in exact[0]]
    np.testing.assert_allclose(
        [event.t for event in events], [event[0] for event in exact[0]], rtol=1e-12
    )
    np.testing.assert_allclose(q[0], exact[1], rtol=1e-12, atol=1e-15)


def test_two_equal_uncoupled_joints_change_mode_at_the_same_instant():
    joint = GearedJoint()
    one, two = joint.equations(), {}
    two["D"] = lambda q: joint.inertia * np.eye(2)
    two["C"], two["B"] = 2 * one["C"], 2 * one["B"]
    two["h"], two["torque"] = one["h"], one["torque"]
    t = np.linspace(0, 2, 41)
    alone, events = simulate_events(**one, t_end=2.0, q0=[0], qd0=[0], t_eval=t)
    both, pairs = simulate_events(**two, t_end=2.0, q0=[0, 0], qd0=[0, 0], t_eval=t)
    np.testing.assert_allclose(both, np.hstack([alone, alone]), rtol=1e-9, atol=1e-12)
    assert kinds(pairs) == [kind for kind in kinds(events) for _ in range(2)]


def test_geared_joint_stick_slips_where_its_reference_is_slow():
    joint = GearedJoint()
    t = np.linspace(0, 4, 4001)
    q, events = simulate_events(**joint.equations(), t_end=4.0, q0=[0], qd0=[0], t_eval=t)
    # Sticks where the reference slows down, catches up once more, rests through the reversal, then
    # the same downwards.
    up, down = ["slip+", "stick", "slip+", "stick"], ["slip-", "stick", "slip-"]
    assert kinds(events)[:7] == up + down
    stuck = [event.t for event in events if event.kind == "stick"]
    let_go = [next(e.t for e in events if e.t > begin) for begin in stuck if begin < events[-1].t]
    for begin, end in zip(stuck, let_go, strict=False):
        resting = q[(t > begin) & (t < end), 0]
        assert np.ptp(resting) == 0  # stuck is exactly stuck, not creeping
        # It lets go where the P loop's torque, less gravity, is C: the definition, checked at the
        # event itself.
        gravity = joint.mass * 9.81 * joint.radius * np.cos(resting[0])
        needed = joint.stiffness * (joint.reference(end) - resting[0]) - gravity
        np.testing.assert_allclose(abs(needed), joint.coulomb, rtol=1e-9)


def test_smoothed_friction_converges_to_the_set_valued_solution():
    """Two coupled links (the paper's arm, softer gains): C tanh(qd / eps) must approach this
    solver like eps.
    """
    f = np.array([1.68, 1.39, -0.29, -1.4, -0.08, -1.94, 6.67, 0.06, 10.2])
    C, B, K = np.array([13.4, 7.8]), np.array([9.5, 4.0]), np.array([4000.0, 1500.0])

    def inertia(q):
        return equation2.D(q, f)

    def bias(q, qd):
        return equation2.C(q, qd, f) + equation2.G(q, f)

    def torque(t, q, qd):
        return K * (np.array([-0.1, 0.13]) * np.sin(4 * t) ** 2 - q)

    t = np.linspace(0, 0.5, 101)
    q, events = simulate_events(inertia, bias, C, B, torque, 0.5, [0.025, 0.0], [0, 0], t)
    assert {(joint, kind) for _, joint, kind in events} >= {
        (0, "stick"),
        (1, "stick"),
        (0, "slip+"),
        (1, "slip-"),
    }

    def distance(eps):
        def rate(t, state):
            x, v = state[:2], state[2:]
            friction = B * v + C * np.tanh(v / eps)
            return np.concatenate(
                [v, np.linalg.solve(inertia(x), torque(t, x, v) - bias(x, v) - friction)]
            )

        smooth = solve_ivp(
            rate, (0, 0.5), [0.025, 0, 0, 0], "Radau", t, rtol=1e-9, atol=1e-11, max_step=5e-3
        )
        return abs(smooth.y[:2].T - q).max()

    coarse, fine = distance(1e-3), distance(1e-4)
    assert coarse < 5e-4  # eps times the 0.5 s of possible creep
    assert fine < coarse / 5  # order 1 gives 10; half of it allows for the next order

"""The simulator against what is known from elsewhere: energy, a fine integrator, exact stick-slip,
the paper's figures.

Kernels are few: where only the step length changes, the period changes and the number of sub-steps
stays, so that one compilation serves all.
"""

import dataclasses

import equation2
import numpy as np
import pytest
from closed_loops import (
    PULSE,
    Filtered,
    NoTorque,
    SampledP,
    direct_rig,
    joint,
    stiff,
    without_friction,
)
from scipy.integrate import solve_ivp
from stick_slip import GearedJoint, simulate_events

from plant import Harmonics, P, PointToPoint, Record, puma560, simulate
from plant.machine import fix
from plant.simulation import path_of, run, start_of

ARM, RIG, LAW, PATH = puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference()
F = puma560.PUBLISHED
PERIOD = 0.7e-3
COUNT = np.abs(np.diag(RIG.to_angle(np.eye(2))))  # [rad]


def equation_6(t):
    w = 2 * np.pi / 3.65
    return np.array(
        [-np.pi / 4 + np.pi / 4 * np.cos(w * t), np.pi / 4 - np.pi / 4 * np.cos(2 * w * t)]
    )


def h(q, qd):
    return equation2.C(q, qd, F) + equation2.G(q, F)


@pytest.fixture(scope="module")
def paper():
    """The experiment of the paper: P = (0.2, 0.15) on trajectory (6)."""
    return simulate(ARM, RIG, LAW, PATH)


# -- the step ------------------------------------------------------------------------------------
def energy(q, qd):
    """Of the published arm [J]; the potential is the integral of the gravity torques of (2)."""
    q2, q23 = q[:, 0], q.sum(axis=1)
    potential = -9.81 * (
        F[4] * np.sin(q23) + F[5] * np.cos(q23) + F[7] * np.cos(q2) + F[8] * np.sin(q2)
    )
    return potential + [v @ equation2.D(x, F) @ v / 2 for x, v in zip(q, qd, strict=True)]


def test_potential_is_the_integral_of_the_gravity_torques():
    q, step = np.array([0.3, -0.7]), 1e-6
    for i in range(2):
        ends = np.array([q - step * np.eye(2)[i], q + step * np.eye(2)[i]])
        slope = np.diff(energy(ends, np.zeros((2, 2))))[0] / (2 * step)
        # rounding 1e-15 * 100 / 1e-6
        np.testing.assert_allclose(slope, equation2.G(q, F)[i], rtol=1e-8)


def test_energy_of_a_free_arm_drifts_with_the_square_of_the_step():
    """4 s of free swing through more than 2 rad at up to 14 rad/s, without friction and torque,
    gravity on.
    """
    hold = PointToPoint(start=(0.0, 0.0), goal=(0.0, 0.0), duration=4.0)
    drift = []
    for period in (4 * PERIOD, 2 * PERIOD, PERIOD):
        rig = without_friction(RIG, period=period)
        record = simulate(ARM, rig, NoTorque(), hold, initial=((0.3, -0.4), (0.5, 1.0)))
        E = energy(record.true_q, record.true_qd)
        drift.append(np.abs(E - E[0]).max())
    assert np.ptp(record.true_q[:, 0]) > 2
    assert drift[-1] < 1e-4  # of kinetic energies near 100 J
    # 4 in the limit of short steps; the next term of the error is h^2 smaller.
    np.testing.assert_allclose([drift[0] / drift[1], drift[1] / drift[2]], 4, rtol=0.05)


def test_smooth_loop_converges_with_order_two_to_a_fine_integration():
    """P loop with viscous friction, an encoder that does not round, and no Coulomb friction."""
    rig = without_friction(RIG, viscous=True, smooth=True)
    stiffness, viscous = (
        LAW.gain * rig.drive.gear * rig.position_in_pulses(np.ones(2)),
        rig.drive.joint_viscous(),
    )

    def rate(t, y):
        q, qd = y[:2], y[2:]
        tau = stiffness * (equation_6(t) - q)
        return np.concatenate(
            [qd, np.linalg.solve(equation2.D(q, F), tau - h(q, qd) - viscous * qd)]
        )

    exact = solve_ivp(
        rate, (0, 0.7), np.zeros(4), method="DOP853", rtol=1e-11, atol=1e-13, dense_output=True
    ).sol
    errors = []
    for period in (4 * PERIOD, 2 * PERIOD, PERIOD):
        record = simulate(ARM, dataclasses.replace(rig, period=period), LAW, PATH, duration=0.7)
        # All are compared at the coarsest samples.
        every = round(4 * PERIOD / period)
        errors.append(np.abs(record.true_q - exact(record.t)[:2].T)[::every].max())
    assert errors[-1] < PULSE / 10
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.1)


def test_one_joint_sticks_and_slips_like_the_event_accurate_reference():
    """An encoder that does not round, since the reference has none: what is left is friction and
    the step.
    """
    case = GearedJoint()
    arm = joint(case.mass, case.radius, case.inertia)
    rig = direct_rig((case.coulomb,), (case.viscous,))
    motion = Harmonics(
        period=2.0, offset=(case.amplitude,), cosine=((-case.amplitude,),), sine=((0.0,),)
    )
    law, errors = stiff(rig, [case.stiffness]), []
    t = np.arange(643) * 4 * PERIOD  # up, a reversal, and down to the next
    exact, events = simulate_events(
        **case.equations(), t_end=1.8, q0=[0.0], qd0=[0.0], t_eval=t, max_step=4e-3
    )
    assert sum(event.kind == "stick" for event in events) >= 2
    # 16 sub-steps of 0.175 ms, and of a quarter of it as in a sample of 0.7 ms
    for every in (1, 4):
        fine = dataclasses.replace(rig, period=4 * PERIOD / every)
        record = simulate(
            arm, fine, law, motion, duration=1.8, steps_per_sample=16, initial=((0,), (0,))
        )
        errors.append(np.abs(record.true_q[::every][: len(t)] - exact).max() / PULSE)
    assert errors[1] < 0.01  # pulses; 1e-4 measured
    # Steps 4 times shorter: 16 for a smooth motion, 4 for a first-order treatment of the events.
    assert errors[1] < errors[0] / 4


def test_two_joints_stick_and_slip_like_the_event_accurate_reference():
    """The paper's arm, drives and gains on (6), an encoder that does not round; equation (2) is
    the independent arm.
    """
    encoder = dataclasses.replace(RIG.encoder, smooth=True)
    # with 4 sub-steps: 16 in 0.7 ms
    rig = dataclasses.replace(RIG, encoder=encoder, period=PERIOD / 4)
    stiffness = LAW.gain * rig.drive.gear * rig.position_in_pulses(np.ones(2))
    limit = rig.drive.torque_limit()
    record = simulate(ARM, rig, LAW, PATH, duration=1.0)
    exact, events = simulate_events(
        D=lambda q: equation2.D(q, F),
        h=h,
        C=rig.drive.joint_coulomb(),
        B=rig.drive.joint_viscous(),
        torque=lambda t, q, qd: np.clip(stiffness * (equation_6(t) - q), -limit, limit),
        t_end=1.0,
        q0=[0.0, 0.0],
        qd0=[0.0, 0.0],
        t_eval=record.t,
        max_step=4e-3,
    )
    assert {event.joint for event in events} == {0, 1}
    assert "stick" in {event.kind for event in events}
    # pulses; 4e-3 measured
    assert np.abs(rig.position_in_pulses(record.true_q - exact)).max() < 0.05


def test_arm_held_by_a_p_law_comes_to_rest():
    """Gravity on; friction, once it holds, holds: no limit cycle, no creep."""
    pose = (-0.4, 0.6)
    record = simulate(ARM, RIG, LAW, PointToPoint(start=pose, goal=pose, duration=1.5))
    tail = record.t > 1.0
    assert np.abs(record.true_qd[:50]).max() > 1e-2  # it sags first
    assert np.abs(record.true_qd[tail]).max() < 1e-3
    assert np.ptp(record.true_q[tail], axis=0).max() < PULSE
    needed = record.torque[-1] - h(record.true_q[-1], np.zeros(2))
    assert (np.abs(needed) <= RIG.drive.joint_coulomb()).all()


# -- the paper's experiment ----------------------------------------------------------------------
def test_samples_are_at_multiples_of_the_period_from_zero(paper):
    np.testing.assert_array_equal(paper.t, np.arange(5215) * 0.7e-3)
    np.testing.assert_array_equal(paper.reference_pulses, RIG.counts(PATH(paper.t).q))
    for duration, samples in ((0.7e-3, 1), (0.71e-3, 2), (1.4e-3, 2), (0.07, 100)):
        assert len(simulate(ARM, RIG, LAW, PATH, duration=duration)) == samples


def test_errors_are_as_large_as_in_the_paper(paper):
    worst = np.abs(paper.error_pulses).max(axis=0)
    # "within about +-10 pulses as in Figs. 6-7" (ERRATA)
    assert ((worst >= 7) & (worst <= 15)).all()
    np.testing.assert_array_equal(paper.error_pulses, np.trunc(paper.error_pulses))


def test_errors_oscillate_at_20_to_30_hz(paper):
    """ERRATA: the oscillation peaks near 24-27 Hz (the paper saw 27-32), with no flexible joint."""
    frequency = np.fft.rfftfreq(len(paper), PERIOD)
    for error in paper.error_pulses.T:
        spectrum = np.abs(np.fft.rfft((error - error.mean()) * np.hanning(len(error))))
        spectrum[frequency < 5] = 0  # the motion itself
        assert 20 < frequency[spectrum.argmax()] < 30


def test_errors_are_reference_minus_the_counts_of_the_true_joint(paper):
    np.testing.assert_array_equal(
        paper.error_pulses, paper.reference_pulses - RIG.counts(paper.true_q)
    )


def test_torque_and_current_of_the_p_law_are_exactly_p_times_the_error(paper):
    limit = RIG.drive.torque_limit()
    expected = np.clip(RIG.drive.gear * LAW.gain * paper.error_pulses, -limit, limit)
    np.testing.assert_array_equal(paper.torque, expected)
    np.testing.assert_array_equal(paper.current, RIG.drive.current(paper.torque))
    assert np.abs(paper.current).max() <= 12 * (1 + 1e-15)


def test_joint_velocity_of_the_record_is_the_slope_of_its_position(paper):
    slope = np.gradient(paper.true_q, PERIOD, axis=0)[1:-1]
    # Friction changes the acceleration by jumps of some 20 rad/s^2: 20 * 0.7e-3 / 2.
    assert np.abs(slope - paper.true_qd[1:-1]).max() < 0.03


def test_true_error_between_the_samples_joins_the_errors_at_them():
    trace = run(ARM, RIG, LAW, PATH, 0.35, 4, None, "numba")
    N = len(trace.record)
    assert trace.true_error_pulses.shape == (4 * N, 2)
    t = (np.arange(4 * N) + 0.5) * PERIOD / 4
    position = RIG.position_in_pulses(PATH(t).q) - trace.true_error_pulses
    # the sample lies half-way between two middles
    between = (position[3:-4:4] + position[4:-1:4]) / 2
    # Parabola between the two: 40 rad/s^2 * (0.7e-3 / 4)^2 / 8 is 0.002 pulses.
    assert np.abs(between - RIG.position_in_pulses(trace.record.true_q[1:])).max() < 0.02


def test_digital_p_loop_is_unstable_at_the_sample_period():
    """FINDINGS 1: 0.7 ms is how often the experiment logs, not how often the P loop acts; held
    so long, it grows.
    """
    held = SampledP(gain=LAW.gain, period=PERIOD)
    limited = simulate(ARM, RIG, held, PATH)
    assert np.abs(limited.error_pulses).max() > 100  # the amplifiers bound it, no more
    drive = dataclasses.replace(RIG.drive, current_limit=(np.inf, np.inf))
    for backend in ("numba", "casadi"):
        with pytest.raises(
            ValueError,
            match=(
                r"it diverges after t = [0-3]\.\d{4} s, joint (2 \(q\[0\]\)|3 \(q\[1\]\)) first\. "
            ),
        ) as error:
            simulate(ARM, dataclasses.replace(RIG, drive=drive), held, PATH, backend=backend)
        assert "\n" not in str(error.value)


# -- backends ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "law",
    [
        LAW,
        P(gain=(0.1, 0.08)),
        *(Filtered(gain=(8.0, 6.0), rate=40.0, period=p) for p in (PERIOD, PERIOD / 2, 3 * PERIOD)),
    ],
    ids=["P", "soft P", "one sample", "two sub-steps", "three samples"],
)
def test_backends_count_the_same_pulses(law):
    """Both round each step differently, so they may part where a joint stands within 1e-9 pulse
    of a cell's edge.
    """
    kernel, casadi = (
        run(ARM, RIG, law, PATH, 1.0, 4, None, backend) for backend in ("numba", "casadi")
    )
    same = (kernel.record.error_pulses == casadi.record.error_pulses).all(axis=1)
    if same.all():
        # Rounding of 4,000 steps of a bounded motion; and the same between the samples.
        np.testing.assert_allclose(
            kernel.true_error_pulses, casadi.true_error_pulses, rtol=0, atol=1e-6
        )
        return
    reference = RIG.position_in_pulses(
        PATH((np.arange(len(kernel.true_error_pulses)) + 0.5) * PERIOD / 4).q
    )
    ours, theirs = (reference - trace.true_error_pulses for trace in (kernel, casadi))
    first = int(np.flatnonzero((fix(ours) != fix(theirs)).any(axis=1))[0])
    to_edge = np.abs(ours[first] - np.round(ours[first]))
    print(f"backends part at sub-step {first}: {to_edge} pulses from an edge")
    assert to_edge.min() < 1e-9
    assert same[: first // 4].all()


def test_casadi_takes_a_duration_that_ends_inside_a_chunk():
    """3 samples per step of the law, 100 samples: 33 chunks and a rest."""
    law = Filtered(gain=(8.0, 6.0), rate=40.0, period=3 * PERIOD)
    records = [
        simulate(ARM, RIG, law, PATH, duration=0.07, backend=backend)
        for backend in ("numba", "casadi")
    ]
    assert [len(record) for record in records] == [100, 100]
    np.testing.assert_array_equal(records[0].error_pulses, records[1].error_pulses)
    # After the law's limit and at every third sample only.
    torque = records[0].torque
    np.testing.assert_array_equal(torque[0::3][: len(torque[1::3])], torque[1::3])
    assert (np.abs(np.diff(torque[::3], axis=0)).max(axis=1) > 0).all()


# -- start, duration, records --------------------------------------------------------------------
def test_motion_starts_where_it_is_told_or_on_the_reference():
    motion = Harmonics(
        period=2.0, offset=(0.1, 0.2), cosine=((0.0,), (0.0,)), sine=((0.1,), (-0.1,))
    )
    start = simulate(ARM, RIG, LAW, motion, duration=0.07)
    np.testing.assert_allclose(start.true_q[0], [0.1, 0.2], rtol=1e-15)
    np.testing.assert_allclose(start.true_qd[0], [0.1 * np.pi, -0.1 * np.pi], rtol=1e-14)
    assert start.initial is None
    moved = simulate(ARM, RIG, LAW, motion, duration=0.07, initial=((0.11, 0.19), (0.0, 0.3)))
    np.testing.assert_array_equal([moved.true_q[0], moved.true_qd[0]], [[0.11, 0.19], [0.0, 0.3]])
    np.testing.assert_array_equal(moved.initial, [[0.11, 0.19], [0.0, 0.3]])


def test_record_can_be_simulated_again_from_its_file(paper, tmp_path):
    paper.to_csv(tmp_path / "paper.csv")
    again = Record.from_csv(tmp_path / "paper.csv")
    assert (again.law, again.rig, again.reference) == (LAW, RIG, PATH)
    replayed = simulate(ARM, again.rig, again.law, again.reference)
    np.testing.assert_array_equal(replayed.error_pulses, paper.error_pulses)
    np.testing.assert_array_equal(replayed.true_q, paper.true_q)


def test_path_of_a_record_is_its_reference_or_its_counts(paper):
    t = np.array([0.0, 0.35e-3, 1.0])
    whole = path_of(paper)(t)
    counts = path_of(dataclasses.replace(paper, reference=None))(t)
    assert np.abs(whole[1] - counts[1]).max() <= 1  # the same to a pulse between samples,
    np.testing.assert_array_equal(whole[1][0], counts[1][0])  # and the same at one
    np.testing.assert_array_equal(
        start_of(paper, path_of(paper)), [PATH([0.0]).q[0], PATH([0.0]).qd[0]]
    )
    given = dataclasses.replace(paper, initial=((1, 2), (3, 4)))
    np.testing.assert_array_equal(start_of(given, path_of(given)), [[1, 2], [3, 4]])


def test_a_log_that_starts_off_its_reference_is_replayed_from_its_first_count(paper):
    """An arm that hangs in its P loop before it moves: first error -5 on joint 2, none on joint
    3.
    """
    error = paper.error_pulses.copy()
    error[0] = (-5, 0)
    hanging = dataclasses.replace(paper, error_pulses=error, reference=None)
    q, qd = start_of(hanging, path_of(hanging))
    assert RIG.counts(q)[0] == 5  # reference 0 minus error -5
    assert q[1] == 0
    np.testing.assert_array_equal(qd, 0)


def test_a_reference_that_is_not_the_one_of_the_log_is_refused(paper):
    shifted = dataclasses.replace(
        paper, reference_pulses=paper.reference_pulses + 2 * (paper.t[:, None] > 1)
    )
    with pytest.raises(ValueError, match=r"sample 1429 is 2 pulses off. Correct.*leave it out"):
        path_of(shifted)


@pytest.mark.parametrize("factor", [1.1, -1.0])
@pytest.mark.parametrize(
    "path", [PATH, PointToPoint(start=(0.1, 0.0), goal=(0.1, 1.0), duration=0.5)]
)
def test_a_gear_that_the_reference_contradicts_is_named(path, factor):
    """Of joints that move; of one that stands still nothing is said."""
    log = simulate(ARM, RIG, LAW, path, duration=0.5)
    drive = dataclasses.replace(RIG.drive, gear=np.multiply(RIG.drive.gear, (1.0, factor)))
    stated = dataclasses.replace(log, rig=dataclasses.replace(RIG, drive=drive))
    with pytest.raises(
        ValueError,
        match=rf"gears .*not the rig's. At joint q\[1\] they are {1 / factor:.4g} times the"
        " reference's: check gear",
    ) as refusal:
        path_of(stated)
    # as the logged counts show it, too, replaying them would hide it
    assert "leave it out" not in str(refusal.value)


ONE = PointToPoint(start=(0.0,), goal=(1.0,), duration=1.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"reference": ONE}, "reference must have 2 joints like the rig; got 1"),
        ({"rig": direct_rig((0.0,), (0.0,))}, "rig must have 2 joints like the arm; got 1"),
        ({"law": P(gain=(1.0,))}, "P.gain must have 2 joints"),
        ({"law": SampledP(gain=(0.1, 0.1), period=PERIOD / 3)}, "whole multiple of the sub-step"),
        ({"duration": 0}, "duration must be a positive number"),
        ({"duration": -1.0}, "duration must be a positive number"),
        ({"duration": np.nan}, "duration must be a positive number"),
        ({"duration": (1.0, 2.0)}, "duration must be a positive number"),
        ({"duration": "long"}, "duration must be a positive number"),
        ({"initial": ((0.0,), (0.0,))}, r"initial must have shape \(2, 2\); got shape \(2, 1\)"),
        (
            {"initial": ((0.0, np.nan), (0.0, 0.0))},
            r"initial must be finite; got nan at index \(0, 1\)",
        ),
        ({"steps_per_sample": 0}, "steps_per_sample must be a whole number of at least 1; got 0"),
        (
            {"backend": "numbra"},
            "backend must be one of 'numba', 'casadi'; got 'numbra'. Did you mean 'numba'",
        ),
        ({"arm": ARM.dynamics.arm(-F)}, "D must be positive definite; its smallest eigenvalue is"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_bad_input_is_refused_in_one_line(changes, message):
    values = {"arm": ARM, "rig": RIG, "law": LAW, "reference": PATH} | changes
    with pytest.raises(ValueError, match=message) as error:
        simulate(**values)
    assert "\n" not in str(error.value)


def test_a_record_without_a_law_begins_at_the_speed_of_its_counts():
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    moving = record.cut(1.0, 1.5)
    cut = dataclasses.replace(moving, reference=None, law=None)
    q, qd = start_of(cut, path_of(cut))
    # The counts are whole pulses: within a tenth of the speed that the joints really had.
    np.testing.assert_allclose(qd, moving.true_qd[0], rtol=0.1, atol=0.02)
    assert np.abs(q - moving.true_q[0]).max() < 1e-3


def a_log_of(q, period):
    """Of a controller that holds zero while its joints move along q (N, 2)."""
    counts = RIG.counts(q)
    rig = dataclasses.replace(RIG, period=period)
    t = period * np.arange(len(q))
    return Record(
        t=t, reference_pulses=np.zeros_like(counts), error_pulses=-counts, rig=rig, law=LAW
    )


@pytest.mark.parametrize("rate", [10.0, 25.0, 40.0])
def test_a_fast_joint_that_is_sampled_slowly_starts_at_its_speed(rate):
    """It bends within 10 samples of 5 ms by more than a parabola does; the truth is a sine."""
    t = 5e-3 * np.arange(100)
    q = np.column_stack([0.1 * np.sin(rate * t + 0.5), 0.2 * np.cos(rate * t + 0.5)])
    qd = np.array([0.1 * rate * np.cos(0.5), -0.2 * rate * np.sin(0.5)])
    log = a_log_of(q, 5e-3)
    _, speed = start_of(log, path_of(log))
    assert (np.abs(speed - qd) < 5 * COUNT / 5e-3).all()


@pytest.mark.parametrize("rate", [60.0, 300.0, 400.0])
def test_a_joint_that_a_controller_sets_in_motion_starts_at_rest(rate):
    """Fast oscillations that begin at a turning point are on no long polynomial either."""
    t = 1e-3 * np.arange(100)
    q = np.column_stack([0.02 * np.cos(rate * t), 0.01 * np.cos(rate * t)])
    log = a_log_of(q, 1e-3)
    _, speed = start_of(log, path_of(log))
    assert (np.abs(speed) < 0.5 * COUNT / 1e-3).all()

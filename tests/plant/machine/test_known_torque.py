"""Springs on the links, against an engine that knows them, energy, and geometry; absent, they
are in no graph.
"""

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
from closed_loops import NoTorque, SampledP, direct_rig, joint, stiff, without_friction
from mujoco_springs import BASE, ON_LINK, engine, swing
from scipy.integrate import solve_ivp

from plant import (
    CosineTorque,
    Counterbalance,
    Elasticity,
    JointSpring,
    KnownTorque,
    PointToPoint,
    linearise,
    number,
    p_gains,
    part,
    puma560,
    replay,
    simulate,
    to_control,
)
from plant.analysis import SampledLoops, held
from plant.parts import from_plain
from plant.simulation import ClosedLoop, Structure

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
PERIOD = 0.7e-3
SPRING = JointSpring(stiffness=(120.0, 45.0), angle=(0.3, -0.5))
COIL = Counterbalance(
    stiffness=(4000.0, 1500.0), base_arm=(0.3, 0.2), link_arm=(0.1, 0.08), free_length=(0.15, 0.1),
    angle=np.subtract(BASE, ON_LINK),
)  # fmt: skip
COSINE = CosineTorque(amplitude=(60.0, 10.0), phase=(0.2, -1.0))


@part
class Parallelogram(KnownTorque):
    """A spring between the frame and the second link, which a parallelogram keeps from turning
    with the first.
    """

    stiffness: float = number(())
    at: np.ndarray = number(("n",))

    def torque(self, q):
        pull = -self.stiffness * (q[0] + q[1] - self.at[0] - self.at[1])
        return ca.vertcat(pull, pull)


OWN = Parallelogram(stiffness=70.0, at=(0.1, 0.2))
ALL = (SPRING, COIL, COSINE, OWN)


def with_springs(springs, rig=RIG):
    return dataclasses.replace(rig, springs=springs)


def potential(q):
    """Of all of them [J], at q (N, 2): the coils by their end points."""
    ends = [
        a[:, None] * np.exp(1j * angle)
        for a, angle in (
            (COIL.base_arm, np.array(BASE)[:, None]),
            (COIL.link_arm, np.array(ON_LINK)[:, None] + q.T),
        )
    ]
    stretched = np.abs(ends[0] - ends[1]).T - COIL.free_length
    coils = 0.5 * (COIL.stiffness * stretched**2).sum(axis=1)
    linear = 0.5 * (SPRING.stiffness * (q - SPRING.angle) ** 2).sum(axis=1)
    cosine = -(COSINE.amplitude * np.sin(q - COSINE.phase)).sum(axis=1)
    return coils + linear + cosine + 0.5 * OWN.stiffness * (q.sum(axis=1) - 0.3) ** 2


# -- truths --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "springs", [pytest.param(SPRING, marks=pytest.mark.slow), COIL], ids=["joint springs", "coils"]
)
def test_free_swing_with_springs_converges_to_another_engine(springs):
    """MuJoCo's joint stiffness and its tendons, by RK4 at 10 us; gravity on, no friction, no
    law.
    """
    start = np.array([(0.3, -0.4), (0.5, 1.0)])
    hold = PointToPoint(start=start[0], goal=start[0], duration=0.7)
    given = {"spring": springs} if springs is SPRING else {"coil": springs}
    truth = swing(engine(ARM, **given), start, 4 * PERIOD, 250)
    left = swing(engine(ARM), start, 4 * PERIOD, 250)
    assert np.abs(left - truth).max() > 0.3  # [rad]: they matter
    errors = []
    for every in (1, 2, 4):
        rig = without_friction(with_springs(springs), smooth=True, period=4 * PERIOD / every)
        record = simulate(ARM, rig, NoTorque(), hold, initial=start)
        errors.append(np.abs(record.true_q[::every][:250] - truth).max())
    assert errors[-1] < 1e-5  # [rad], of 0.2 ms steps
    # second order
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.1)


def test_a_pendulum_with_a_preloaded_spring_converges_to_a_fine_integration():
    mass, radius, inertia, k, angle, preload = 3.0, 0.4, 0.9, 35.0, 0.6, 4.0
    springs = JointSpring(stiffness=(k,), angle=(angle,), preload=(preload,))

    def rate(t, y):
        return [
            y[1],
            (preload - k * (y[0] - angle) - mass * 9.81 * radius * np.cos(y[0])) / inertia,
        ]

    exact = solve_ivp(
        rate, (0, 2), [0.2, 1.0], method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True
    ).sol
    errors, hold = [], PointToPoint(start=(0.0,), goal=(0.0,), duration=2.0)
    for period in (4 * PERIOD, 2 * PERIOD, PERIOD):
        rig = with_springs(springs, direct_rig((0.0,), (0.0,), period=period))
        record = simulate(
            joint(mass, radius, inertia), rig, NoTorque(), hold, initial=((0.2,), (1.0,))
        )
        errors.append(
            np.abs(record.true_q[:, 0] - exact(record.t)[0])[:: round(4 * PERIOD / period)].max()
        )
    np.testing.assert_allclose([errors[0] / errors[1], errors[1] / errors[2]], 4, rtol=0.05)
    assert errors[-1] < 2e-7


def test_torques_are_the_slope_of_the_potential():
    q, step = np.random.default_rng(0).uniform(-3, 3, (20, 2)), 1e-6
    for i in range(2):
        shift = step * np.eye(2)[i]
        slope = (potential(q + shift) - potential(q - shift)) / (2 * step)
        # 1e-16 * 1e3 / 1e-6
        np.testing.assert_allclose(with_springs(ALL).spring_torque(q)[:, i], -slope, atol=1e-6)


def test_energy_drifts_with_the_square_of_the_step():
    """4 s of free swing, gravity and all springs on; the links' energy is the arm's own."""
    q = ca.SX.sym("q", 2)
    hold, drift = PointToPoint(start=(0.0, 0.0), goal=(0.0, 0.0), duration=4.0), []
    weight = ca.Function("weight", [q], [ARM.dynamics.gravity(q, ARM.f)])
    nodes, weights = np.polynomial.legendre.leggauss(30)
    for period in (4 * PERIOD, 2 * PERIOD, PERIOD):
        rig = without_friction(with_springs(ALL), smooth=True, period=period)
        record = simulate(ARM, rig, NoTorque(), hold, initial=((0.3, -0.4), (0.5, 1.0)))
        rows = slice(None, None, round(40 * PERIOD / period))
        at, speed = record.true_q[rows], record.true_qd[rows]
        lifted = sum(  # the work of gravity along a straight way from 0
            w / 2 * (at * weight.map(len(at))((at * (1 + s) / 2).T).full().T).sum(axis=1)
            for s, w in zip(nodes, weights, strict=True)
        )
        kinetic = np.array([v @ ARM.D(x) @ v / 2 for x, v in zip(at, speed, strict=True)])
        total = kinetic + lifted + potential(at)
        drift.append(np.ptp(total))
    assert np.ptp(kinetic) > 20
    assert drift[-1] < 1e-3
    np.testing.assert_allclose([drift[0] / drift[1], drift[1] / drift[2]], 4, rtol=0.1)


def test_a_counterbalance_with_its_force_alone_is_a_gas_spring():
    """A force of 200 N along the line between both ends: lever arm times force."""
    gas = Counterbalance(
        stiffness=(0.0,),
        base_arm=(0.3,),
        link_arm=(0.4,),
        free_length=(0.0,),
        angle=(0.0,),
        tension=(-200.0,),
    )
    q = ca.SX.sym("q", 1)
    torque = ca.Function("torque", [q], [gas.torque(q)])
    # At a right angle between the arms the line is 0.5 m long and passes the axis at 0.3 0.4 / 0.5
    # m.
    assert float(torque(np.pi / 2)) == pytest.approx(200 * 0.24)
    assert float(torque(-np.pi / 2)) == pytest.approx(-200 * 0.24)  # it pushes its ends apart


def test_behind_an_elastic_gear_the_spring_is_on_the_link():
    """A motor that is held: the link hangs where gear and spring carry it, and swings about
    there.
    """
    mass, radius, inertia, k, gear = 3.0, 0.4, 0.9, 300.0, 900.0
    rig = direct_rig((0.0,), (0.0,))
    drive = dataclasses.replace(
        rig.drive,
        motor_inertia=(50.0,),
        viscous=(2e3,),
        elasticity=Elasticity(stiffness=(gear,), damping=(0.0,)),
    )
    rig = dataclasses.replace(rig, drive=drive, springs=JointSpring(stiffness=(k,), angle=(0.5,)))
    arm = joint(mass, radius, inertia + 50.0)  # f holds the rotor
    hold = PointToPoint(start=(0.2,), goal=(0.2,), duration=1.0)
    record = simulate(arm, rig, stiff(rig, (1e6,)), hold, steps_per_sample=8)
    q = record.true_q[0, 0]
    left = gear * (0.2 - q) - k * (q - 0.5) - mass * 9.81 * radius * np.cos(q)
    assert abs(left) < 1e-3 * gear  # the motor gives by what its P law needs
    assert np.ptp(record.true_q) < 2e-4  # at rest from the first sample on
    moved = simulate(
        arm, rig, stiff(rig, (1e6,)), hold, steps_per_sample=8, initial=((0.2,), (0.4,))
    )
    crossing = np.flatnonzero(np.diff(np.sign(moved.true_q[:, 0] - q)))[2:]
    found = 0.5 / np.diff(moved.t[crossing]).mean()
    stiffness = gear + k - mass * 9.81 * radius * np.sin(q)
    assert found == pytest.approx(np.sqrt(stiffness / inertia) / (2 * np.pi), rel=0.01)


# -- linear analysis, planning -------------------------------------------------------------------
def test_the_linear_loop_has_the_springs_stiffness():
    inertia, gain, k = 0.9, 2000.0, 700.0
    rig = with_springs(JointSpring(stiffness=(k,), angle=(0.3,)), direct_rig((0.0,), (0.0,)))
    arm = joint(0.0, 0.0, inertia)
    system = linearise(arm, rig, stiff(rig, (gain,)), (0.1,))
    np.testing.assert_allclose(np.abs(system.poles()), np.sqrt((gain + k) / inertia), rtol=1e-5)
    moving = to_control(arm, rig)
    slope = [moving.dynamics(0.0, [q, 0.0], [0.0])[1] for q in (0.0, 0.1)]
    np.testing.assert_allclose(np.diff(slope), -0.1 * k / inertia, rtol=1e-9)


def test_a_sampled_loop_has_the_springs_stiffness_and_rests_where_they_pull_it():
    """A P law of 0.1 ms on a mass without friction: its hold makes it swing up, at the frequency
    of both springs.
    """
    inertia, gain, k, rest, pose = 0.9, 2000.0, 700.0, 0.3, np.array([0.1])
    rig = with_springs(
        JointSpring(stiffness=(k,), angle=(rest,)), direct_rig((0.0,), (0.0,), period=1e-4)
    )
    arm = joint(0.0, 0.0, inertia)
    law = SampledP(gain=stiff(rig, (gain,)).gain, period=rig.period)
    q, _, torque, _ = held(arm, rig, law, law.block(rig), pose)
    np.testing.assert_allclose(q, (gain * pose + k * rest) / (gain + k), rtol=1e-9)
    np.testing.assert_allclose(torque, k * (q - rest), rtol=1e-9)
    pole = SampledLoops(arm, rig, law, pose).unstable_pole()
    assert abs(pole) == pytest.approx(np.sqrt((gain + k) / inertia), rel=1e-3)


def test_a_motion_needs_less_torque_by_what_the_springs_give():
    """Springs that carry the arm's weight, to first order in q: at rest there, no torque is
    left.
    """
    q = np.array([0.1, -0.2])
    step, eye = 1e-6, np.eye(2)
    slope = np.array(
        [(ARM.h(q + step * e, 0 * q) - ARM.h(q - step * e, 0 * q)) / (2 * step) for e in eye]
    )
    k = np.diag(slope)
    carried = JointSpring(stiffness=np.maximum(k, 0), angle=q, preload=ARM.h(q, 0 * q))
    still = PointToPoint(start=q, goal=q, duration=1.0)
    rig = without_friction(RIG)
    assert still.torque_share(ARM, rig).max() > 0.1
    assert still.torque_share(ARM, with_springs(carried, rig)).max() < 1e-12


def test_amplifiers_too_weak_for_the_arm_alone_are_strong_enough_with_springs():
    """P gains are found, and the loop that is linearised where the springs carry the weight is
    not at its limit.
    """
    mass, radius, inertia, gain = 3.0, 0.4, 0.9, 2000.0
    arm, weight = joint(mass, radius, inertia), mass * 9.81 * radius
    carried = JointSpring(stiffness=(0.0,), angle=(0.0,), preload=(weight,))
    rig = direct_rig((0.0,), (2.0,))
    weak = dataclasses.replace(rig, drive=rig.drive.limited_to((0.7 * weight,)))
    path = PointToPoint(start=(-0.2,), goal=(0.2,), duration=2.0)
    with pytest.raises(ValueError, match="the amplifier must be able to drive the motion"):
        p_gains(arm, weak, path, 20)
    reached = np.abs(
        simulate(arm, weak, p_gains(arm, with_springs(carried, weak), path, 20), path).error_pulses
    ).max()
    assert reached > 20  # without the springs these gains do not hold the arm
    poles = linearise(arm, with_springs(carried, weak), stiff(rig, (gain,)), (0.0,)).poles()
    np.testing.assert_allclose(np.abs(poles), np.sqrt(gain / inertia), rtol=1e-5)


# -- the part ------------------------------------------------------------------------------------
def test_without_springs_the_loop_is_the_same_graph():
    """And with them nothing but the sub-step changes, and no vector but the numbers."""
    options = {"dynamics": ARM.dynamics, "law": puma560.p_law(), "steps_per_sample": 4}
    plain, other = (ClosedLoop(rig=rig, **options) for rig in (RIG, with_springs(ALL)))
    assert (
        Structure(ClosedLoop(rig=with_springs(()), **options))
        == Structure(plain)
        != Structure(other)
    )
    assert (other.state_names, other.time_names) == (plain.state_names, plain.time_names)
    assert len(other.number_names) - len(plain.number_names) == 4 + 10 + 4 + 3
    assert with_springs(()) == RIG
    assert RIG.spring_torque(np.zeros(2)) == 0.0
    nothing = JointSpring(stiffness=(0.0, 0.0), angle=(1.0, 1.0))
    runs = [
        simulate(ARM, rig, puma560.p_law(), PATH, duration=0.1)
        for rig in (RIG, with_springs(nothing))
    ]
    np.testing.assert_array_equal(runs[0].error_pulses, runs[1].error_pulses)


def test_their_numbers_have_names_and_they_are_restored_copied_and_filled():
    rig = with_springs(ALL)
    names = rig.number_names()
    assert names[-21:-19] == ["springs[0].stiffness[0]", "springs[0].stiffness[1]"]
    assert names[-3:] == ["springs[3].stiffness", "springs[3].at[0]", "springs[3].at[1]"]
    assert with_springs(SPRING).number_names()[-4:-2] == [
        "springs.stiffness[0]",
        "springs.stiffness[1]",
    ]
    # our own bytes
    assert from_plain(rig.describe()) == rig == pickle.loads(pickle.dumps(rig)) != RIG  # noqa: S301
    other = rig.filled({"springs[3].at[1]": 0.9, "springs[0].angle[0]": 0.0})
    assert (other.springs[3].at[1], other.springs[0].angle[0]) == (0.9, 0.0)
    assert other.springs[1:3] == rig.springs[1:3]


def test_a_record_keeps_them_and_both_backends_agree(tmp_path):
    record = simulate(ARM, with_springs(ALL), puma560.p_law(), PATH, duration=0.1)
    slow = simulate(ARM, with_springs(ALL), puma560.p_law(), PATH, duration=0.1, backend="casadi")
    np.testing.assert_allclose(record.true_q, slow.true_q, rtol=0, atol=1e-12)
    record.to_csv(tmp_path / "log.csv")
    again = type(record).from_csv(tmp_path / "log.csv")
    assert again.rig == record.rig
    np.testing.assert_array_equal(replay(ARM, again).error_pulses, record.error_pulses)


@part
class Wrong(KnownTorque):
    """A torque that is none."""

    kind: str = "flat"

    def torque(self, q):
        if self.kind == "fails":
            return q @ q
        return {
            "flat": np.zeros(2),
            "long": ca.SX.zeros(3),
            "free": q * ca.SX.sym("other"),
            "alike": ca.SX.sym("q", 2),
            "none": None,
        }[self.kind]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: JointSpring(stiffness=(1.0, -2.0), angle=(0, 0)), "stiffness must not be negative"),
        (lambda: with_springs(JointSpring(stiffness=(1.0,), angle=(0,))), "JointSpring.stiffness must have 2 joints"),
        (lambda: with_springs(OWN.stiffness), "springs must be of type KnownTorque; got .* float"),
        (lambda: with_springs((SPRING, "coil")), "springs must be of type KnownTorque; got .* str"),
        (lambda: with_springs(JointSpring), "springs must be of type KnownTorque; got the class JointSpring"),
        (lambda: with_springs(Wrong()), r"of shape \(2, 1\), one torque per joint; got \(2,\)"),
        (lambda: with_springs(Wrong(kind="long")), r"of shape \(2, 1\), one torque per joint; got \(3, 1\)"),
        (lambda: with_springs(Wrong(kind="free")), "must depend on q and the part's numbers alone; got 'other'"),
        (lambda: with_springs(Wrong(kind="alike")), "must depend on q and the part's numbers alone; got 'q_0'"),
        (lambda: with_springs(Wrong(kind="fails")), "torque of Wrong must be a casadi expression of q"),
        (lambda: with_springs(Wrong(kind="none")), "got NoneType"),
        (lambda: dataclasses.replace(COIL, base_arm=(0.1, 0.2)), r"base_arm and link_arm must differ; joint q\[0\]"),
        (lambda: dataclasses.replace(COIL, free_length=(0.1, -0.2)), "free_length must not be negative"),
        (lambda: dataclasses.replace(COSINE, phase=(0.0,)), "phase of CosineTorque must have shape"),
        (lambda: CosineTorque(amplitude=(np.nan, 1.0), phase=(0, 0)), "must be finite"),
    ],
)  # fmt: skip
def test_bad_springs_are_refused_in_one_line(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("q", [0.1, np.zeros(3), np.zeros(1), np.zeros((4, 1)), np.zeros((0, 3))])
def test_positions_of_other_joints_are_refused(q):
    with pytest.raises(ValueError, match=r"q must have shape .*2,?\); got (shape|0\.1)") as error:
        with_springs(SPRING).spring_torque(q)
    assert "\n" not in str(error.value)


def test_equal_arms_are_refused_where_the_coil_pulls_at_their_meeting():
    """A free length of 0 may also be made of tension: the coil then pulls by its length alone."""
    arms = {"stiffness": (2000.0,), "base_arm": (0.2,), "link_arm": (0.2,), "angle": (0.0,)}
    q, torques = ca.SX.sym("q", 1), []
    for free, tension in ((0.0, None), (0.05, (100.0,))):
        coil = Counterbalance(free_length=(free,), tension=tension, **arms)
        torques.append(ca.Function("torque", [q], [coil.torque(q)])(0.7))
    np.testing.assert_allclose(torques, -2000 * 0.2**2 * np.sin(0.7))
    for arm in (0.2, 0.2 + 1e-10):
        with pytest.raises(ValueError, match="base_arm and link_arm must differ"):
            Counterbalance(free_length=(0.05,), tension=(99.0,), **arms | {"link_arm": (arm,)})


def test_a_spring_must_give_its_torque():
    with pytest.raises(
        ValueError, match="must give all that KnownTorque declares; it lacks torque"
    ):

        @part
        class Nothing(KnownTorque):
            """Forgot."""

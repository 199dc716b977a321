"""What drives, encoders and clocks add to a loop: nothing where it is absent or zero, and all of
it together.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import NoTorque
from scipy.integrate import solve_ivp

from ctc import ComputedTorque, FeedForward, margins
from plant import (
    PD,
    Body,
    Chain,
    Coupling,
    Dynamics,
    Elasticity,
    FrictionDrift,
    Harmonics,
    Jitter,
    Link,
    Presliding,
    QuadratureError,
    Record,
    TorqueRipple,
    Transport,
    linearise,
    puma560,
    simulate,
    to_control,
)
from plant.parts import from_plain
from plant.simulation import LANES, Clock, ClosedLoop, Path, Structure, loop_kernel, time_tables

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
PULSES = RIG.encoder.to_angle(np.array([5.0, 5.0]))
DRIVE = {
    "presliding": Presliding(distance=PULSES, damping=(1e-3, 2e-3)),
    "load_friction": (0.1, 0.15),
    "friction_drift": FrictionDrift(amount=(-0.3, 0.2), time=(0.3, 0.5)),
    "ripple": TorqueRipple(amplitude=(0.03, 0.02), cycles=(6.0, 8.0), phase=(0.3, 1.0)),
}
QUADRATURE, JITTER = (
    QuadratureError(amplitude=(0.3, 0.2), phase=(0.1, 1.0)),
    Jitter(share=0.1, seed=3),
)
EFFECTS = [*DRIVE, "quadrature", "jitter"]
SPRING = Elasticity.from_resonance(ARM, 80, 0.02, drive=RIG.drive)
LAW = FeedForward(
    ARM,
    RIG,
    feedback=PD(gain=(0.05, 0.04), derivative=(2e-4, 1.5e-4), filter=3000.0, period=RIG.period),
)


def with_effects(*names, rig=RIG, **drive):
    """The rig with some of the effects, and with other changes of its drive."""
    drive = {name: DRIVE[name] for name in names if name in DRIVE} | drive
    encoder = dataclasses.replace(
        rig.encoder, quadrature=QUADRATURE if "quadrature" in names else None
    )
    return dataclasses.replace(
        rig,
        drive=dataclasses.replace(rig.drive, **drive),
        encoder=encoder,
        jitter=JITTER if "jitter" in names else None,
    )


def loop_of(rig, law=LAW, **options):
    return ClosedLoop(dynamics=ARM.dynamics, rig=rig, law=law, steps_per_sample=4, **options)


def operations(function):
    """How many instructions of a function work something out."""
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    return sum(code not in (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST) for code in codes)


# -- absent --------------------------------------------------------------------------------------
def test_what_is_absent_is_in_no_vector():
    per_joint = ("q", "qd", "impulse", "torque")
    loop = loop_of(RIG, puma560.p_law())
    assert loop.state_names == [
        *(f"{name}[{i}]" for name in per_joint for i in range(2)),
        "score",
        "ok",
    ]
    assert loop.time_names == [
        *(f"{name}[{i}]" for name in ("q_r", "qd_r", "qdd_r", "pulses_r") for i in range(2)),
        "h",
    ]
    assert len(RIG.number_names()) == 7 * 2


@pytest.mark.parametrize(
    ("name", "states", "times", "numbers"),
    [
        ("presliding", ["bristle[0]", "bristle[1]"], [], 4),
        ("load_friction", [], [], 2),
        ("friction_drift", ["drifted[0]", "drifted[1]"], [], 4),
        ("ripple", [], [], 6),
        ("quadrature", [], [], 4),
        ("jitter", [], ["draw"], 2),
    ],
)
def test_each_adds_what_it_needs_and_no_more(name, states, times, numbers):
    plain, other = loop_of(RIG), loop_of(with_effects(name))
    assert [each for each in other.state_names if each not in plain.state_names] == states
    assert [each for each in other.time_names if each not in plain.time_names] == times
    assert len(other.number_names) - len(plain.number_names) == numbers
    # what the law reads costs nothing elsewhere, and the other way round
    for step in ("law_step", "substep"):
        counts = [operations(getattr(loop, step)) for loop in (plain, other)]
        assert (counts[0] == counts[1]) == (
            (step == "substep") == (name in ("quadrature", "jitter"))
        )
    assert Structure(loop_of(with_effects(name))) == Structure(other) != Structure(plain)


# -- zero ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("elasticity", [None, SPRING], ids=["rigid", "elastic"])
def test_lanes_of_zero_are_loops_without_and_others_are_loops_with(elasticity):
    """One population of loops that differ in their effects alone; the single runs of rigs that
    have them, or not.
    """
    names = ("presliding", "load_friction", "friction_drift", "ripple", "quadrature", "jitter")
    rig = with_effects(*names, elasticity=elasticity)
    loop = loop_of(rig)
    varied = ("distance", "presliding.damping", "share", "amount", "amplitude")
    own = [name for name in rig.number_names() if name.split("[")[0].endswith(varied)]
    assert len(own) == 2 * 6 + 1
    lanes = [loop.number_names.index(name) for name in own]
    clock, path = Clock.regular(300, rig.period), Path(PATH, rig)
    kernel = loop_kernel(loop, lanes)
    tables = kernel.prepared((*time_tables(loop, path, clock), np.empty((300, 0))))
    numbers = loop.number_values(ARM.f)
    shares = np.zeros(LANES)
    shares[1:4] = 1.0, 0.5, 0.1
    columns = np.repeat(numbers[:, None], LANES, axis=1)
    columns[lanes] *= shares
    state = np.ascontiguousarray(loop.initial_state(*path.start(), columns))
    final, _ = kernel.run(
        tables, state, np.ascontiguousarray(columns[lanes]), numbers[list(kernel.uniform)]
    )
    assert (final[-1] == 1).all()

    def single(rig):
        """q and qd at the end of a run on its own."""
        record = simulate(ARM, rig, LAW, PATH, duration=301 * rig.period)
        return np.concatenate([record.true_q[-1], record.true_qd[-1]])

    places = [loop.state_names.index(f"{name}[{i}]") for name in ("q", "qd") for i in range(2)]
    if elasticity is not None:
        places = [
            loop.state_names.index(f"{name}[{i}]")
            for name in ("link", "link_speed")
            for i in range(2)
        ]
    spread = np.ptp(final[places], axis=1)
    none = single(with_effects(elasticity=elasticity))
    np.testing.assert_allclose(final[places, 0], none, rtol=0, atol=1e-9)
    for lane in (1, 2, 3):
        values = {
            name: shares[lane] * value for name, value in zip(own, numbers[lanes], strict=True)
        }
        np.testing.assert_allclose(
            final[places, lane], single(rig.filled(values)), rtol=0, atol=1e-9
        )
    assert (spread > 1e-6).all()


# -- together ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("names", "elasticity"),
    [*(((name,), None) for name in EFFECTS), (tuple(EFFECTS), None), (tuple(EFFECTS), SPRING)],
    ids=[*EFFECTS, "all, rigid", "all, elastic"],
)
def test_the_kernel_and_casadi_agree(names, elasticity):
    rig = with_effects(*names, elasticity=elasticity)
    if len(names) > 1:
        rig = dataclasses.replace(rig, transport=Transport(delay=2e-4, lost=(30, 31)))
    one, other = (
        simulate(ARM, rig, LAW, PATH, duration=0.2, backend=backend)
        for backend in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, rtol=0, atol=1e-10)
    plain = simulate(ARM, with_effects(elasticity=elasticity), LAW, PATH, duration=0.2)
    assert np.abs(one.true_q - plain.true_q).max() > 1e-6


@pytest.mark.filterwarnings("ignore:the gear of.*as good as rigid:UserWarning")
def test_a_stiff_gear_ends_in_the_rigid_loop_with_all_of_them():
    stiff = Elasticity.from_resonance(ARM, 1e5, 0.02, drive=RIG.drive)
    # a faster one makes more of a count that flips in one of them alone
    law = ComputedTorque(ARM, RIG, bandwidth=120)
    one, other = (
        simulate(ARM, with_effects(*EFFECTS, elasticity=each), law, PATH) for each in (None, stiff)
    )
    assert np.abs(one.error_pulses - other.error_pulses).max() <= 1
    pulse = 2 * np.pi / np.abs(RIG.drive.gear * RIG.encoder.resolution)
    assert (np.abs(one.true_q - other.true_q) < pulse).all()


def test_coupled_motors_have_their_own():
    """Without links all inertia is in the motors: in shaft angles C q the coupled loop is two
    that know of no other.
    """
    matrix = np.array([[1.0, 0.0], [-0.7, 1.0]])
    links = tuple(Link(name=str(i + 1)) for i in range(2))
    bodies = tuple(
        Body(mass=0.0, com=(0, 0, 0), inertia=(0,) * 6, rotor=j)
        for j in RIG.drive.reflected_inertia()
    )
    cosine, found = np.array([[0.5, 0.0], [0.0, -0.4]]), []
    for coupling, to_shaft in ((Coupling(matrix=matrix), np.eye(2)), (Coupling(), matrix)):
        dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies, coupling=coupling))
        rig = with_effects(*DRIVE, coupling=coupling)
        rig = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
        path = Harmonics(
            period=2.0, offset=(0.0, 0.0), cosine=to_shaft @ cosine, sine=np.zeros((2, 2))
        )
        record = simulate(dynamics.arm(dynamics.f()), rig, puma560.p_law(), path, duration=0.5)
        assert np.abs(record.error_pulses).max() > 4
        found.append(record.true_q @ (matrix if to_shaft is not matrix else np.eye(2)).T)
    np.testing.assert_allclose(*found, rtol=0, atol=1e-9)


def test_a_controller_at_work_knows_none_of_them():
    # stable on these gears, else its start would be refused
    law = ComputedTorque(ARM, RIG, bandwidth=60)
    rigs = RIG, with_effects(*EFFECTS, elasticity=SPRING, current_lag=1e-4)
    running = [law.start(rig, (0, 0)) for rig in rigs]
    for k in range(20):
        torques = [each.step((k, -2 * k), (1e-3, 0.0), (0.1, 0.0), (0.0, 0.0)) for each in running]
        np.testing.assert_array_equal(*torques)


def test_records_keep_them(tmp_path):
    rig = with_effects(*EFFECTS, elasticity=SPRING)
    record = simulate(ARM, rig, LAW, PATH, duration=0.02)
    record.to_csv(tmp_path / "log.csv")
    assert Record.from_csv(tmp_path / "log.csv").rig == from_plain(rig.describe()) == rig
    assert rig.filled({"drive.ripple.amplitude[1]": 0.5}).drive.ripple.amplitude.tolist() == [
        0.03,
        0.5,
    ]
    assert rig.with_numbers(rig.number_values()) == rig


# -- linear and continuous -----------------------------------------------------------------------
@pytest.mark.parametrize("elasticity", [None, SPRING], ids=["rigid", "elastic"])
def test_linear_models_are_of_joints_that_slide(elasticity):
    """Presliding, load and drift are dry friction, or slow, and leave the linear model as it is."""
    plain, other = (with_effects(*names, elasticity=elasticity) for names in ((), EFFECTS[:3]))
    one, two = (linearise(ARM, rig, puma560.p_law(), [0.1, -0.2]).A for rig in (plain, other))
    np.testing.assert_allclose(one, two, rtol=0, atol=1e-6 * np.abs(one).max())
    one, two = (
        margins(ARM, rig, LAW)
        for rig in (plain, with_effects(*EFFECTS[:3], "jitter", elasticity=elasticity))
    )
    np.testing.assert_allclose(one.gain_up, two.gain_up, rtol=1e-6)
    np.testing.assert_allclose(one.delay, two.delay, rtol=1e-6)


def test_python_control_steps_the_same_loop():
    control = pytest.importorskip("control")
    rig, law = (
        with_effects(*DRIVE, "quadrature", elasticity=SPRING, current_lag=3e-4),
        ComputedTorque(ARM, RIG, bandwidth=60),
    )
    record = simulate(ARM, rig, law, PATH, duration=0.05)
    systems = [to_control(law, rig), to_control(rig), to_control(ARM, rig, sampled=True)]
    loop = control.interconnect(
        systems,
        inputs=[f"{name}[{i}]" for name in ("q_r", "qd_r", "qdd_r") for i in range(2)],
        outputs=[f"{name}[{i}]" for name in ("link", "link_speed", "qd", "tau") for i in range(2)],
    )
    start, states = PATH([0.0]), loop_of(rig, law)
    hanging = states.initial_state(start.q[0], start.qd[0], states.number_values(ARM.f))
    arm = np.concatenate(
        [[*start.q[0], *start.qd[0], 0, 0], hanging[states.state_names.index("link[0]") : -2]]
    )
    initial = [*law.block(rig).initial, 0, 0, *arm]
    given = control.input_output_response(loop, record.t, np.hstack(PATH(record.t)).T, initial)
    np.testing.assert_allclose(given.outputs[:2].T, record.true_q, rtol=0, atol=1e-11)


def test_the_continuous_arm_has_the_equations_of_bristles_and_drift():
    """dr/dt = (v - abs(v) r) / d, friction level r + damping d dr/dt; dw/dt = (1 - w) / T,
    factor 1 + amount w.
    """
    pytest.importorskip("control")
    rig = with_effects("presliding", "friction_drift")
    drive = rig.drive
    system, n = to_control(ARM, rig), 2
    r, w, q, qd = (
        np.array([0.3, -0.5]),
        np.array([0.2, 0.6]),
        np.array([0.1, -0.2]),
        np.array([0.02, -0.05]),
    )
    rate = system.dynamics(0, np.concatenate([q, qd, r, w]), np.zeros(2))
    v, d = qd * drive.gear, drive.presliding.distance
    bending = (np.sign(drive.gear) * v - np.abs(v) * r) / d  # r has the joint's sign
    np.testing.assert_allclose(rate[2 * n : 3 * n], bending, rtol=1e-9)
    np.testing.assert_allclose(rate[3 * n :], (1 - w) / drive.friction_drift.time, rtol=1e-9)
    factor = 1 + drive.friction_drift.amount * w
    friction = (
        drive.joint_coulomb() * factor * r
        + drive.gear**2 * drive.presliding.damping * (d / np.abs(drive.gear)) * bending
    )
    expected = ARM.forward(q, qd, -friction - drive.joint_viscous() * factor * qd)
    np.testing.assert_allclose(rate[n : 2 * n], expected, rtol=1e-9)
    with pytest.raises(ValueError, match="continuous arm's presliding must be positive"):
        to_control(
            ARM,
            dataclasses.replace(
                rig, drive=dataclasses.replace(drive, presliding=Presliding(distance=(0, 0)))
            ),
        )


def test_two_joints_move_as_their_differential_equations_say():
    """Falling with bristles, drift and ripple, against an integrator of the continuous system:
    steps of first order.
    """
    pytest.importorskip("control")
    rig = with_effects("presliding", "friction_drift", "ripple")
    start, system = np.array([[0.1, -0.2], [0.0, 0.5]]), to_control(ARM, rig)
    t = np.arange(285) * rig.period
    exact = (
        solve_ivp(
            lambda t, x: system.dynamics(t, x, np.zeros(2)),
            (0, t[-1]),
            np.concatenate([*start, np.zeros(4)]),
            method="LSODA",
            rtol=1e-9,
            atol=1e-11,
            t_eval=t,
        )
        .y[:2]
        .T
    )
    errors = []
    for steps in (4, 8, 16):
        record = simulate(
            ARM, rig, NoTorque(), PATH, initial=start, duration=0.1995, steps_per_sample=steps
        )
        errors.append(np.abs(record.true_q - exact).max())
    assert np.abs(RIG.position_in_pulses(np.full(2, errors[0]))).max() < 0.3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2, rtol=0.05)


def test_derivatives_follow_differences_of_the_smooth_step():
    """The smooth loop, which derivatives are taken of: its bristles and the exact ones stay
    together on a path.
    """
    rig = with_effects("presliding", "load_friction", "friction_drift", "ripple")
    smooth = loop_of(rig, smooth=True)
    state, time, numbers = (
        ca.SX.sym(*x)
        for x in (
            ("s", len(smooth.state_names)),
            ("t", len(smooth.time_names)),
            ("n", len(smooth.number_names)),
        )
    )
    following = smooth.substep(state, time, numbers)[0]
    slope = ca.Function(
        "slope", [state, time, numbers], [ca.jacobian(following, numbers), following]
    )
    values, point = smooth.number_values(ARM.f), np.zeros(len(smooth.state_names))
    place = {name: i for i, name in enumerate(smooth.state_names)}
    for name, value in {
        "q": 0.1,
        "qd": 0.02,
        "bristle": 0.3,
        "drifted": 0.4,
        "torque": 40.0,
        "impulse": -1e-3,
    }.items():
        point[place[f"{name}[0]"]], point[place[f"{name}[1]"]] = value, -value
    row = np.append(np.zeros(len(smooth.time_names) - 1), smooth.h)
    jacobian = slope(point, row, values)[0].full()
    assert np.isfinite(jacobian).all()
    for name in (
        "drive.presliding.distance[0]",
        "drive.load_friction.share[1]",
        "drive.friction_drift.amount[0]",
        "drive.ripple.amplitude[1]",
        "drive.coulomb[0]",
    ):
        i = smooth.number_names.index(name)
        changed = [values.copy(), values.copy()]
        size = 1e-4 * abs(values[i])
        changed[0][i] += size
        changed[1][i] -= size
        more, less = (slope(point, row, each)[1].full().ravel() for each in changed)
        np.testing.assert_allclose(
            jacobian[:, i], (more - less) / (2 * size), rtol=1e-5, atol=1e-11
        )
        assert np.abs(jacobian[:, i]).max() > 0

"""Gears that give: free vibration and statics by hand, energy, order, and the rigid loop as the
limit.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import Constant, Counting, NoTorque, joint
from scipy.linalg import eig

from ctc import ComputedTorque, FeedForward, evaluate
from plant import (
    PD,
    Drive,
    Elasticity,
    Encoder,
    P,
    PointToPoint,
    Record,
    Rig,
    linearise,
    puma560,
    replay,
    simulate,
    to_control,
)  # fmt: skip
from plant.simulation import ClosedLoop, DivergenceError

H = 0.7e-3 / 4  # the default sub-step
MOTOR, LINK = 0.9, 1.6


def with_gears(rig, elasticity, **changes):
    return dataclasses.replace(
        rig, drive=dataclasses.replace(rig.drive, elasticity=elasticity, **changes)
    )


def one_joint(stiffness, damping=0.0, *, mass=0.0, backlash=None, **friction):
    """Arm and rig of a joint whose motor and link weigh MOTOR and LINK, hanging on nothing where
    it has no mass.
    """
    arm = joint(mass, 0.3, MOTOR + LINK)
    elasticity = Elasticity(stiffness=(stiffness,), damping=(damping,), backlash=backlash)
    numbers = {"viscous": (0.0,), "coulomb": (0.0,)} | friction
    drive = Drive(
        gear=(50.0,),
        motor_inertia=(MOTOR / 2500,),
        motor_gain=(0.2,),
        current_limit=(np.inf,),
        elasticity=elasticity,
        **numbers,
    )
    return arm, Rig(drive=drive, encoder=Encoder(resolution=(1000,)), period=0.7e-3)


def steps_of(arm, rig, count, states, h):
    """States (s, N) after each of so many sub-steps of length h, from a start by name of the
    state.
    """
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=NoTorque(), steps_per_sample=1)
    start = loop.initial_state(np.zeros(arm.n), np.zeros(arm.n))
    for name, value in states.items():
        start[loop.state_names.index(name)] = value
    row = np.append(np.zeros(len(loop.time_names) - 1), h)
    run = loop.substep.mapaccum("run", count)
    following, _ = run(
        start,
        ca.repmat(ca.DM(row), 1, count),
        ca.repmat(ca.DM(loop.number_values(arm.f)), 1, count),
    )
    return dict(zip(loop.state_names, following.full(), strict=True))


def swinging(arm, rig, h=H):
    """Poles [1/s] of a sub-step without friction at rest, by differences: the step's kinks have
    no derivative.
    """
    loop = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=NoTorque(), steps_per_sample=1)
    names = [f"{name}[{i}]" for name in ("q", "link", "qd", "link_speed") for i in range(arm.n)]
    places = [loop.state_names.index(name) for name in names]
    still, row = (
        loop.initial_state(np.zeros(arm.n), np.zeros(arm.n)),
        np.zeros(len(loop.time_names)),
    )
    row[-1] = h

    def after(place, size):
        moved = np.array(still)
        moved[place] += size
        return loop.substep(moved, row, loop.number_values(arm.f))[0].full().ravel()[places]

    matrix = np.column_stack(
        [(after(place, 1e-6) - after(place, -1e-6)) / 2e-6 for place in places]
    )
    return np.log(np.linalg.eigvals(matrix) + 0j) / h


def oscillation(poles):
    """Frequency [Hz] and damping ratio of the fastest pole."""
    fastest = poles[np.argmax(poles.imag)]
    return abs(fastest) / (2 * np.pi), -fastest.real / abs(fastest)


@pytest.mark.parametrize("hz", [5, 25, 100, 200, 300])
@pytest.mark.parametrize("ratio", [0.0, 0.01, 0.03])
def test_free_vibration_has_its_frequency_and_its_damping(hz, ratio):
    """Two masses on a spring, against the roots of their characteristic polynomial."""
    reduced = 1 / (1 / MOTOR + 1 / LINK)
    stiffness = reduced * (2 * np.pi * hz) ** 2
    arm, rig = one_joint(stiffness, 2 * ratio * np.sqrt(stiffness * reduced))
    found, damping = oscillation(swinging(arm, rig))
    assert found == pytest.approx(hz, rel=1e-3)  # asked: 1e-2
    assert abs(damping - ratio) < 1e-4  # asked: 5e-4


def test_the_frequency_is_right_to_fourth_order():
    stiffness = 4e6
    arm, rig = one_joint(stiffness)
    true = np.sqrt(stiffness * (1 / MOTOR + 1 / LINK)) / (2 * np.pi)
    errors = [abs(oscillation(swinging(arm, rig, h))[0] / true - 1) for h in (2e-4, 1e-4)]
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7, 1e9, 1e10])
def test_no_energy_is_added_or_lost_at_any_stiffness(stiffness):
    arm, rig = one_joint(stiffness)
    run = steps_of(arm, rig, 20_000, {"qd[0]": 1.0}, H)
    # What swings is the relative speed; its largest value is that at the start, if nothing is added
    # or lost.
    relative = np.abs(run["qd[0]"] - run["link_speed[0]"])
    early, late = relative[:5000].max(), relative[-5000:].max()
    assert late == pytest.approx(early, rel=1e-3)
    momentum = MOTOR * run["qd[0]"] + LINK * run["link_speed[0]"]
    np.testing.assert_allclose(momentum, MOTOR, rtol=1e-9)


def test_poles_are_those_of_the_generalised_eigenvalue_problem_in_two_joints():
    """The paper's arm without gravity in its equations of motion at one pose, against scipy on
    its two matrices.
    """
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    elasticity = Elasticity.from_resonance(arm, (60.0, 90.0), 0.0, drive=rig.drive)
    motor = np.diag(rig.drive.reflected_inertia())
    zero = np.zeros((2, 2))
    M = np.block([[motor, zero], [zero, arm.D([0.0, 0.0]) - motor]])
    K = np.diag(elasticity.stiffness)
    roots = eig(np.block([[K, -K], [-K, K]]), M, right=False)
    expected = np.sort(np.sqrt(np.abs(roots.real)))[2:] / (2 * np.pi)
    drive = dataclasses.replace(
        rig.drive, viscous=(0.0, 0.0), coulomb=(0.0, 0.0), elasticity=elasticity
    )
    poles = swinging(arm, dataclasses.replace(rig, drive=drive))
    swings = np.sort(np.abs(poles.imag[poles.imag > 100])) / (2 * np.pi)
    # the weight's own stiffness is in the step, not in K
    np.testing.assert_allclose(swings, expected, rtol=2e-3)


@pytest.mark.filterwarnings("ignore:the gear of.*as good as rigid:UserWarning")
@pytest.mark.parametrize("hz", [1e5, 1e8])
def test_a_stiff_gear_ends_in_the_rigid_loop(hz):
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    stiff = with_gears(rig, Elasticity.from_resonance(arm, hz, 0.02))
    law = ComputedTorque(arm, rig, bandwidth=150)
    one, other = (simulate(arm, each, law, path) for each in (rig, stiff))
    assert np.abs(one.error_pulses - other.error_pulses).max() <= 1
    pulse = 2 * np.pi / np.abs(rig.drive.gear * rig.encoder.resolution)
    assert (np.abs(one.true_q - other.true_q) < pulse).all()


def test_links_hang_in_their_springs_and_play():
    """At rest the spring carries the weight: deflection m g r cos(q) / k, and half the play
    more.
    """
    stiffness, play = 2e4, 1e-3
    arm, rig = one_joint(
        stiffness, 30.0, mass=5.0, backlash=(play,), viscous=(1e-3,), coulomb=(0.2,)
    )
    still = PointToPoint(start=(0.2,), goal=(0.2,), duration=0.5)
    record = simulate(arm, rig, P(gain=(0.5,)), still)
    weight = arm.h(record.true_q[-1], [0.0])[0]
    motor = rig.cell_centre(record.counts[-1])[0]
    expected = weight / stiffness + play / 2
    pulse = 2 * np.pi / (50 * 1000)
    assert motor - record.true_q[-1, 0] == pytest.approx(expected, abs=pulse)
    assert np.ptp(record.true_q, axis=0)[0] < 3 * pulse  # it starts where it hangs


def test_play_lets_the_link_fly_until_it_touches():
    """Without gravity a link at rest stays at rest while its motor crosses the play, then is
    hit.
    """
    play, speed = 0.02, 0.5
    arm, rig = one_joint(1e5, backlash=(play,))
    run = steps_of(arm, rig, 600, {"qd[0]": speed}, H)
    touching = play / 2 / speed
    t = H * np.arange(1, 601)
    assert (run["link[0]"][t < touching - H] == 0).all()
    assert run["link_speed[0]"][t > touching + 0.02].max() > speed / 2
    momentum = MOTOR * run["qd[0]"] + LINK * run["link_speed[0]"]
    np.testing.assert_allclose(momentum, MOTOR * speed, rtol=1e-9)


def test_currents_that_lag_follow_their_exponential():
    """A motor alone under constant torque T: its speed is T / J (t - lag (1 - exp(-t / lag)))."""
    lag, torque = 1.3e-3, 2.0
    arm, rig = one_joint(1e-3)
    rig = with_gears(rig, None, current_lag=lag)
    held = ClosedLoop(
        dynamics=arm.dynamics,
        rig=rig,
        law=Constant(torque=torque, period=0.7e-3),
        steps_per_sample=4,
    )
    state = held.initial_state([0.0], [0.0])
    row = np.append(np.zeros(len(held.time_names) - 1), H)
    state = held.law_step(state, row, held.number_values(arm.f)).full().ravel()
    speeds = []
    for _ in range(40):
        state = held.substep(state, row, held.number_values(arm.f))[0].full().ravel()
        speeds.append(state[held.state_names.index("qd[0]")])
    t = H * np.arange(1, 41)
    expected = torque / (MOTOR + LINK) * (t - lag * (1 - np.exp(-t / lag)))
    np.testing.assert_allclose(speeds, expected, rtol=1e-12)


@pytest.mark.parametrize("options", [{}, {"backlash": (2e-4, 2e-4)}])
@pytest.mark.parametrize("changes", [{}, {"current_lag": 4e-4}])
def test_the_kernel_and_casadi_agree(options, changes):
    """A product and its sum are rounded once in the kernel: some 1e-12 of a turn after 2,000
    sub-steps.
    """
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    rig = with_gears(
        rig, Elasticity.from_resonance(arm, 60, 0.02, drive=rig.drive, **options), **changes
    )
    law = FeedForward(arm, puma560.rig(), feedback=PD(
        gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=rig.period))  # fmt: skip
    one, other = (
        simulate(arm, rig, law, path, duration=0.3, backend=backend)
        for backend in ("numba", "casadi")
    )
    np.testing.assert_array_equal(one.error_pulses, other.error_pulses)
    np.testing.assert_allclose(one.true_q, other.true_q, rtol=0, atol=1e-10)


def test_an_encoder_on_the_link_counts_the_link():
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    elasticity = Elasticity.from_resonance(arm, 40, 0.02, drive=rig.drive)
    law = FeedForward(
        arm, rig, feedback=PD(gain=(0.02, 0.015), derivative=(2e-4, 1e-4), filter=900.0)
    )
    for side in ("motor", "link"):
        seen = dataclasses.replace(rig.encoder, side=side)
        record = simulate(
            arm,
            dataclasses.replace(with_gears(rig, elasticity), encoder=seen),
            law,
            path,
            duration=0.5,
        )
        counted = np.abs(rig.counts(record.true_q) - record.counts).max()
        assert (counted == 0) == (side == "link")


def test_with_encoders_on_both_sides_the_law_reads_the_motor_s_and_the_record_holds_both(tmp_path):
    """The run is that with an encoder on the motor, to the last bit; what the links count is
    what the links do.
    """
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    rig = with_gears(rig, Elasticity.from_resonance(arm, 40, 0.02, drive=rig.drive))
    both = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, side="both"))
    plain, made = (simulate(arm, each, puma560.p_law(), path, duration=0.3) for each in (rig, both))
    np.testing.assert_array_equal(made.error_pulses, plain.error_pulses)
    np.testing.assert_array_equal(made.link_counts, rig.counts(made.true_q))
    assert plain.link_counts is None
    assert np.abs(made.link_counts - made.counts).max() > 5
    np.testing.assert_array_equal(replay(arm, made).link_counts, made.link_counts)
    made.to_csv(tmp_path / "both.csv")
    np.testing.assert_array_equal(
        Record.from_csv(tmp_path / "both.csv").link_counts, made.link_counts
    )
    np.testing.assert_allclose(
        made.resampled(2 * rig.period).link_counts, made.link_counts[::2], atol=1e-6
    )


def test_one_joint_alone_may_have_two_encoders(tmp_path):
    """The column of the other is NaN throughout, in files too; what rig and columns say must
    agree.
    """
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    rig = with_gears(rig, Elasticity.from_resonance(arm, 40, 0.02, drive=rig.drive))
    both, one = (dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, side=side))
                 for side in ("both", ["both", "motor"]))  # fmt: skip
    whole, made = (simulate(arm, each, puma560.p_law(), path, duration=0.3) for each in (both, one))
    np.testing.assert_array_equal(made.error_pulses, whole.error_pulses)
    np.testing.assert_array_equal(made.link_counts, whole.link_counts * (1, np.nan))
    made.to_csv(tmp_path / "one.csv")
    again = Record.from_csv(tmp_path / "one.csv")
    np.testing.assert_array_equal(again.link_counts, made.link_counts)
    assert again.rig == made.rig == dataclasses.replace(made.rig)
    np.testing.assert_array_equal(made.resampled(2 * rig.period).link_counts[:, 1], np.nan)
    for counts, text in (
        (whole.link_counts, r"joint q\[1\] has a column, its rig says \('both', 'motor'\)"),
        (made.link_counts[:, ::-1], r"joint q\[0\] is NaN, its rig says"),
        (
            np.where(np.arange(len(made))[:, None] == 7, np.nan, made.link_counts),
            r"got nan at index \(7, 0\)",
        ),
        (np.full_like(made.link_counts, np.nan), "must be of a joint at least"),
    ):
        with pytest.raises(ValueError, match=text):
            dataclasses.replace(made, link_counts=counts)
    for side, text in (
        (("both", "link"), "side of a joint must be one of 'motor', 'both'"),
        ("gear", "side must be one"),
    ):
        with pytest.raises(ValueError, match=text):
            dataclasses.replace(rig.encoder, side=side)
    with pytest.raises(ValueError, match="must have 3 joints"):
        dataclasses.replace(rig.encoder, side=("both", "motor", "motor"))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Elasticity(stiffness=(0.0,), damping=(1.0,)), "stiffness must be positive"),
        (lambda: Elasticity(stiffness=(-5.0,), damping=(1.0,)), "stiffness must be positive"),
        (lambda: Elasticity(stiffness=(5.0,), damping=(-1.0,)), "damping must not be negative"),
        (
            lambda: Elasticity(stiffness=(5.0,), damping=(1.0,), backlash=(7.0,)),
            "backlash must be within one turn",
        ),
        (
            lambda: Elasticity(stiffness=(5.0,), damping=(1.0,), backlash=(-1e-3,)),
            "backlash must not be negative",
        ),
        (
            lambda: with_gears(
                puma560.rig(),
                Elasticity(stiffness=(1e5, 1e5), damping=(1, 1), backlash=(0.0, 0.12)),
            ),
            r"backlash must be within one turn of the motor, 0.117 rad at joint q\[1\]; got 0.12",
        ),
        (lambda: Elasticity.from_resonance(puma560.arm(), 0.0, 0.02), "hz must be positive"),
        (
            lambda: Elasticity.from_resonance(puma560.arm(), 60, -0.02),
            "damping_ratio must not be negative",
        ),
        (
            lambda: with_gears(puma560.rig(), Elasticity(stiffness=(1e5,), damping=(1.0,))),
            "must have 2 joints; got 1",
        ),
        (
            lambda: with_gears(
                puma560.rig(), Elasticity.from_resonance(joint(0.0, 0.0, 20.0), 60, 0.02)
            ),
            "elasticity.hz must have 2 joints; got 1",
        ),
        (
            lambda: with_gears(
                one_joint(1e5)[1], Elasticity.from_resonance(puma560.arm(), 60, 0.02)
            ),
            "elasticity.hz must have 1 joints; got 2",
        ),
        (
            lambda: Elasticity.from_resonance(puma560.arm(), (60, 60, 60), 0.02),
            r"hz must have shape \(2,\); got shape \(3,\)",
        ),
        (
            lambda: Elasticity.from_resonance(puma560.arm(), 60, "low"),
            "damping_ratio must be numbers",
        ),
        (
            lambda: Elasticity.from_resonance(puma560.arm(), (-np.inf, 60), 0.02),
            "hz .*must be finite; got -inf",
        ),
        (
            lambda: Elasticity.from_resonance(puma560.arm(), 60, 0.02, drive=puma560.rig()),
            "drive must be a Drive; got Rig",
        ),
        (
            lambda: with_gears(puma560.rig(), None, current_lag=-1e-4),
            "current_lag must be positive",
        ),
        (
            lambda: with_gears(puma560.rig(), None, current_lag=0.3),
            "current_lag must be at most 0.02 s; got 0.3",
        ),
        (
            lambda: with_gears(puma560.rig(), None, current_lag=(1e-4, 1e-4)),
            "current_lag must be a finite number",
        ),
        (
            lambda: dataclasses.replace(
                puma560.rig(), encoder=Encoder(resolution=(800, 1000), side="link")
            ),
            "link's side needs elastic gears; got rigid ones",
        ),
        (lambda: Encoder(resolution=(800,), side="lnk"), "Did you mean 'link'"),
    ],
)
def test_bad_input_is_refused_in_one_line(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "\n" not in str(error.value)


def test_damping_above_critical_is_warned_of():
    with pytest.warns(UserWarning, match=r"damping_ratio 1.2 is above critical") as warned:
        Elasticity.from_resonance(puma560.arm(), 60, 1.2)
    assert warned[0].filename == __file__


def test_no_lag_is_no_lag():
    """Zero is none: the same rig, and so the same kernel."""
    assert with_gears(puma560.rig(), None, current_lag=0) == puma560.rig()


@pytest.mark.parametrize("share", [1.01, 0.99])
def test_gears_that_steps_do_not_follow_are_warned_of(share):
    """From where the frequency of the step is wrong by 1 %: sqrt(2) in omega h, as `swinging`
    measures.
    """
    reduced, h = 1 / (1 / MOTOR + 1 / LINK), 0.7e-3 / 8
    arm, rig = one_joint(share * reduced * 2 / h**2)
    hz = np.sqrt(share * 2) / h / (2 * np.pi)
    assert oscillation(swinging(arm, rig, 0.99 * h))[0] == pytest.approx(hz, rel=0.0101)
    assert oscillation(swinging(arm, rig, 1.1 * h))[0] != pytest.approx(hz, rel=0.02)

    still = PointToPoint(start=(0.2,), goal=(0.2,), duration=0.01)
    if share < 1:
        simulate(arm, rig, P(gain=(0.5,)), still, steps_per_sample=8)  # a warning would be an error
        return
    said = (
        r"vibrates at 2585 Hz, motor.* of 0.0875 ms follow 2572 Hz to 1 %. Take steps_per_sample=9,"
        r" or leave"
    )
    with pytest.warns(UserWarning, match=said) as warned:
        simulate(arm, rig, P(gain=(0.5,)), still, steps_per_sample=8)
    assert warned[0].filename == __file__
    simulate(arm, rig, P(gain=(0.5,)), still, steps_per_sample=9)


def test_without_inertia_nothing_vibrates_and_nothing_is_warned_of():
    """A motor without inertia moves; with a motor heavier than the whole arm the loop diverges."""
    arm, rig = one_joint(1e5, 1.0)
    still = PointToPoint(start=(0.2,), goal=(0.2,), duration=0.01)
    light, heavy = (
        with_gears(rig, rig.drive.elasticity, motor_inertia=(inertia / 2500,))
        for inertia in (0.0, 2 * (MOTOR + LINK))
    )
    # A warning would be an error.
    assert np.isfinite(simulate(arm, light, P(gain=(0.5,)), still).true_q).all()
    with pytest.raises(DivergenceError):
        simulate(arm, heavy, P(gain=(0.5,)), still)


def test_a_law_with_one_number_of_state_on_one_joint():
    """casadi slices a column of one entry as a row, unless it is told not to."""
    arm, rig = one_joint(1e5, 1.0)
    for each in (rig, with_gears(rig, None), with_gears(rig, None, current_lag=1e-3)):
        record = simulate(
            arm,
            each,
            Counting(period=rig.period),
            PointToPoint(start=(0.0,), goal=(0.1,), duration=0.1),
        )
        np.testing.assert_allclose(record.torque[:, 0], np.arange(len(record)))


def test_the_linear_model_has_the_poles_of_two_masses_and_two_springs():
    """A motor held by its P loop, a link on its gear; viscous friction between, against the
    polynomial's roots.
    """
    stiffness, damping, viscous = 3e5, 40.0, 2e-3
    arm, rig = one_joint(stiffness, damping, viscous=(viscous,))
    held = 0.3 * 50 * 50 * 1000 / (2 * np.pi)
    M = np.diag([MOTOR, LINK])
    K = np.array([[held + stiffness, -stiffness], [-stiffness, stiffness]])
    C = np.array([[viscous * 2500 + damping, -damping], [-damping, damping]])
    zero = np.zeros((2, 2))
    A = np.block([[zero, np.eye(2)], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
    found = np.sort_complex(np.linalg.eigvals(linearise(arm, rig, P(gain=(0.3,)), [0.1]).A))
    np.testing.assert_allclose(
        found, np.sort_complex(np.linalg.eigvals(A)), rtol=1e-4
    )  # the derivative's step is 1e-7 s


def test_python_control_steps_the_same_loop():
    control = pytest.importorskip("control")
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    rig = with_gears(
        rig, Elasticity.from_resonance(arm, 80, 0.02, drive=rig.drive), current_lag=3e-4
    )
    law = ComputedTorque(arm, puma560.rig(), bandwidth=60)
    record = simulate(arm, rig, law, path, duration=0.05)
    systems = [to_control(law, rig), to_control(rig), to_control(arm, rig, sampled=True)]
    loop = control.interconnect(
        systems,
        inputs=[f"{name}[{i}]" for name in ("q_r", "qd_r", "qdd_r") for i in range(2)],
        outputs=[f"{name}[{i}]" for name in ("link", "link_speed", "qd", "tau") for i in range(2)],
    )
    motion = path(record.t)
    start = path([0.0])
    states = ClosedLoop(dynamics=arm.dynamics, rig=rig, law=law, steps_per_sample=4)
    hanging = states.initial_state(start.q[0], start.qd[0], states.number_values(arm.f))
    link = hanging[states.state_names.index("link[0]") :][:2]
    still, at_rest = np.zeros(2), (start.q[0], start.qd[0])
    initial = [law.block(rig).initial, still, *at_rest, still, link, start.qd[0], still]
    given = control.input_output_response(
        loop, record.t, np.hstack(motion).T, np.concatenate(initial)
    )
    np.testing.assert_allclose(given.outputs[:2].T, record.true_q, rtol=0, atol=1e-11)
    smooth = dataclasses.replace(rig, encoder=dataclasses.replace(rig.encoder, smooth=True))
    rate = to_control(arm, smooth).dynamics(0, np.zeros(10), np.zeros(2))
    assert np.isfinite(rate).all()


def test_the_evaluation_has_columns_of_their_own_for_motor_and_link():
    """At 25 Hz the motor stays within a pulse while its link is off by the weight over the
    stiffness.
    """
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    elasticity = Elasticity.from_resonance(arm, 25, 0.02, drive=rig.drive)
    law = FeedForward(arm, rig, feedback=PD(
        gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=rig.period))  # fmt: skip
    report = evaluate(arm, with_gears(rig, elasticity), law, path, duration=0.7, backend="numba")
    assert report.max_error_pulses.max() <= 1
    weight = (
        np.abs([arm.h(q, np.zeros(2)) for q in path(report.record.t).q]).max(axis=0)
        / elasticity.stiffness
    )
    peak = np.abs(report.link_error).max(axis=0)
    assert (peak > 0.5 * weight).all()
    assert (peak < 3 * weight + 1e-3).all()
    rows = {line.split("]")[0]: line.split()[-2:] for line in str(report).splitlines()}
    rms = np.sqrt(np.mean((1e3 * report.link_error) ** 2, axis=0))
    assert rows["link error, peak [mrad"] == [f"{1e3 * value:.3f}" for value in peak]
    assert rows["link error, RMS [mrad"] == [f"{value:.3f}" for value in rms]
    rigid = evaluate(arm, rig, law, path, duration=0.2, backend="numba")
    assert "link error" not in str(rigid)
    pulse = 2 * np.pi / np.abs(rig.drive.gear * rig.encoder.resolution)
    assert (np.abs(rigid.link_error).max(axis=0) < 2 * pulse).all()

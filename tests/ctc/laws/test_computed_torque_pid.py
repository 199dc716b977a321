"""The PID law against scipy's bilinear transform of its transfer function, and at work on gears
that give.
"""

import dataclasses
from functools import cache

import casadi as ca
import numpy as np
import pytest
from closed_loops import without_friction
from scipy import signal

from ctc import ComputedTorquePID, certify, error_loop, evaluate, margins
from identification import identify
from plant import Elasticity, PointToPoint, part, puma560, simulate, to_control
from plant.parts import MODEL_ERROR
from plant.simulation import LANES, Clock, ClosedLoop, Path, loop_kernel, time_tables

RIG, ARM, PATH = puma560.rig(), puma560.arm(), puma560.reference()
NAMES = ("bandwidth", "ratio", "integral", "roll_off", "roll_off_damping")
TUNINGS = {
    "15-40 Hz": (206.0, 1.28, 24.0, 2124.0, 0.96),
    "40-80 Hz": (177.0, 1.52, 79.5, 2969.0, 0.91),
    "150-300 Hz": (155.0, 1.66, 40.6, 449.0, 0.53),
    "rigid": (179.0, 1.44, 66.4, 1085.0, 0.99),
    "without integral": (100.0, 2.0, 0.0, 900.0, 0.7),
}
EVERY = pytest.mark.parametrize("tuning", TUNINGS.values(), ids=TUNINGS)
SLOW = TUNINGS["rigid"]
SMOOTH = dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, smooth=True))


def law(tuning=SLOW, rig=RIG, robot=ARM, **changes):
    return ComputedTorquePID(robot, rig, **(dict(zip(NAMES, tuning, strict=True)) | changes))


def transfer(w, r, i, f, z):
    """Numerator and denominator of a(s), multiplied out."""
    return w * np.poly([-w / r, -i]), np.polymul([1, 0], [1 / f**2, 2 * z / f, 1])


def accelerations(controller, errors):
    """Feedback accelerations (N, 2) of joint errors (N, 2) [rad], at a reference at rest,
    without the amplifier.
    """
    block, state, torque = controller.block(SMOOTH), None, np.zeros(2)
    pose, state, found = np.array([0.3, -0.4]), block.initial, []
    for e in errors:
        counts = SMOOTH.counts(pose - e)
        given = block.step(state, pose, 0, 0, counts, counts, torque, RIG.period, block.values)
        torque, state = (x.full().ravel() for x in given)
        found.append(np.linalg.solve(ARM.D(pose), torque - ARM.h(pose, np.zeros(2))))
    return np.array(found)


# -- the transfer function -----------------------------------------------------------------------
@EVERY
def test_it_is_the_bilinear_transform_of_its_transfer_function(tuning):
    """Noise into both joints, after one sample of nothing: to 1e-9 of the largest answer, as
    scipy filters it.
    """
    errors = np.random.default_rng(1).normal(0, 1e-3, (300, 2))
    errors[0] = 0.0
    b, a, _ = signal.cont2discrete(transfer(*tuning), RIG.period, method="bilinear")
    expected = signal.lfilter(b.ravel(), a, errors, axis=0)
    np.testing.assert_allclose(
        accelerations(law(tuning), errors), expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


def test_python_control_gives_the_same_frequency_response():
    """The law as a python-control system, linearised, from pulses to torque, against a(exp(s T))
    of scipy.
    """
    system = to_control(law(rig=SMOOTH), SMOOTH)
    block = law(rig=SMOOTH).block(SMOOTH)
    still, state = np.zeros(8), np.concatenate([block.initial, np.zeros(2)])
    state = np.asarray(system.dynamics(0, state, still))  # one reading
    state[-2:] = RIG.drive.limited(np.asarray(system.output(0, state, still)))
    linear = system.linearize(state, still, eps=1e-7)
    omega = np.geomspace(5, 4000, 30)
    z = np.exp(1j * omega * RIG.period)
    b, a, _ = signal.cont2discrete(transfer(*SLOW), RIG.period, method="bilinear")
    expected = np.polyval(b.ravel(), z) / np.polyval(a, z)
    pulses, D = SMOOTH.position_in_pulses(np.eye(2)), ARM.D((0, 0))
    for k in range(len(z)):
        found = linear(z[k])[:, -2:]  # torque per pulse
        np.testing.assert_allclose(
            -np.linalg.solve(D, found) @ pulses.T,
            expected[k] * np.eye(2),
            rtol=0,
            atol=1e-4 * abs(expected[k]),
        )


def test_the_loop_of_a_joint_is_pid_times_a_double_integrator():
    """Without weight and friction the arm is a held double integrator, T^2/2 (z + 1) / (z -
    1)^2.
    """
    weightless = puma560.dynamics().arm(
        np.where(np.isin(np.arange(9), (4, 5, 7, 8)), 0.0, puma560.PUBLISHED)
    )
    rig = without_friction(RIG)
    z = np.exp(1j * np.geomspace(10, 4000, 25) * RIG.period)
    b, a, _ = signal.cont2discrete(transfer(*SLOW), RIG.period, method="bilinear")
    expected = (
        np.polyval(b.ravel(), z) / np.polyval(a, z) * RIG.period**2 / 2 * (z + 1) / (z - 1) ** 2
    )
    for joint in range(2):
        system = error_loop(
            None, rig, law(rig=rig, robot=weightless), joint=joint, pose=(0.3, -0.4)
        )
        # multiple poles at 1: three digits are lost
        np.testing.assert_allclose(system(z), expected, rtol=1e-6)
    plant = RIG.period**2 / 2 * np.array([1, 1]), np.poly([1, 1])
    closed = np.polyadd(np.polymul(b.ravel(), plant[0]), np.polymul(a, plant[1]))
    assert np.abs(np.roots(closed)).max() < 1
    assert margins(None, rig, law(rig=rig, robot=weightless)).stable


# -- its start, its end, and a late call ---------------------------------------------------------
def test_the_first_error_makes_no_kick():
    """A constant error of five pulses from the first sample on: proportional at once, then the
    integral's ramp alone.

    a = e (w (w/r + i) - 2 z / f slow + slow T (k + 1/2 + 1/2)), slow = w i w/r: the first sample
    integrates one period.
    """
    w, r, i, f, z = SLOW
    error, slow = np.array([5e-4, -3e-4]), w * w / r * i
    found = accelerations(law(), np.repeat(error[None], 50, axis=0))
    ramp = w * (w / r + i) - 2 * z / f * slow + slow * RIG.period * np.arange(1, 51)
    np.testing.assert_allclose(found, ramp[:, None] * error, rtol=1e-9)


def test_a_late_call_is_a_longer_step():
    """A steady error, read once three periods late, gives what the integral gained in that time,
    and nothing else.
    """
    controller = law()
    block, pose, state, torque = controller.block(SMOOTH), np.zeros(2), None, np.zeros(2)
    state, counts, found = block.initial, SMOOTH.counts(np.array([5e-4, -3e-4])), []
    for dt in (1, 1, 1, 4, 1):
        given = block.step(state, pose, 0, 0, 0, counts, torque, dt * RIG.period, block.values)
        torque, state = (x.full().ravel() for x in given)
        found.append(torque)
    change = np.diff(found, axis=0)
    np.testing.assert_allclose(change[2], 4 * change[0], rtol=1e-9)
    np.testing.assert_allclose(change[3], change[0], rtol=1e-9)


@part
class Deaf(ComputedTorquePID):
    """Takes the commanded torque to be what was applied."""

    def equations(self, rig, state, setpoint, pulses, torque, dt):
        return super().equations(rig, state, setpoint, pulses, state[-rig.n :], dt)


def test_what_the_amplifier_cuts_off_does_not_wind_up():
    """0.05 rad (680 pulses) to come back, at the limit first: it goes no further too far than
    without a limit.

    Measured: 21 % too far, 70 % without a limit (two zeros near the crossover), 340 % if it is not
    told of it.
    """
    still, rig = (
        PointToPoint(start=(0.0, 0.5), goal=(0.0, 0.5), duration=0.5),
        without_friction(RIG),
    )
    numbers, overshoot = dict(zip(NAMES, SLOW, strict=True)), {}
    strong = dataclasses.replace(
        rig, drive=dataclasses.replace(rig.drive, current_limit=(np.inf, np.inf))
    )
    for name, kind, each in (
        ("told", ComputedTorquePID, rig),
        ("deaf", Deaf, rig),
        ("strong", ComputedTorquePID, strong),
    ):
        record = simulate(
            ARM, each, kind(ARM, each, **numbers), still, initial=[[0.05, 0.5], [0.0, 0.0]]
        )
        at_limit = np.abs(record.torque[:8]) >= 0.999 * RIG.drive.torque_limit()
        assert at_limit.any()
        overshoot[name] = -(record.error_pulses[:, 0] / record.error_pulses[0, 0]).min()
        if name == "told":
            assert np.abs(record.error_pulses[-100:]).max() <= 1
    assert 2 * overshoot["told"] < overshoot["strong"] < overshoot["deaf"] / 2


# -- its numbers are lanes -----------------------------------------------------------------------
def test_tunings_are_lanes_of_one_kernel():
    """Forty tunings side by side end where each ends alone."""
    random, samples = np.random.default_rng(5), 60
    tunings = np.array(SLOW) * random.uniform(0.7, 1.3, (LANES, len(SLOW)))
    score = ca.Function(
        "none",
        [ca.SX.sym("log", 8), ca.SX.sym("data", 1), ca.SX.sym("memory", 0)],
        [0, ca.SX(0, 1)],
    )
    loop = ClosedLoop(dynamics=ARM.dynamics, rig=RIG, law=law(), steps_per_sample=4, score=score)
    lanes = [loop.number_names.index(f"law.{name}") for name in NAMES]
    clock = Clock.regular(samples, RIG.period)
    path = Path(PATH, RIG)
    kernel, values = loop_kernel(loop, lanes), loop.number_values(ARM.f)
    tables = kernel.prepared((*time_tables(loop, path, clock), np.zeros((samples, 1))))
    start = np.repeat(loop.initial_state(*path.start())[:, None], LANES, axis=1)
    uniform = values[list(kernel.uniform)]
    final, _ = kernel.run(tables, start.copy(), np.ascontiguousarray(tunings.T), uniform)
    torque = loop.state_names.index("torque[0]")
    assert np.ptp(final[torque]) > 1
    for lane in (0, 17, LANES - 1):
        alone = simulate(ARM, RIG, law(tunings[lane]), PATH, duration=samples * RIG.period)
        np.testing.assert_allclose(
            final[torque : torque + 2, lane], alone.torque[-1], rtol=0, atol=1e-9
        )


# -- at work -------------------------------------------------------------------------------------
def on_gears(arm, hz):
    elasticity = Elasticity.from_resonance(arm, hz, 0.02, drive=RIG.drive)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))


@pytest.mark.parametrize(("name", "hz", "chatter"), [
    ("15-40 Hz", 25, 26), ("40-80 Hz", 60, 32), ("150-300 Hz", 200, 2), ("rigid", None, 8)])  # fmt: skip
def test_it_keeps_one_pulse_where_it_was_tuned_for(name, hz, chatter):
    """Throw-away prototypes reached 25, 31, 1.7 and 7.2 N m of chatter on joint 2."""
    arm = puma560.literature_arm(1.5)
    rig = RIG if hz is None else on_gears(arm, hz)
    report = evaluate(
        arm, rig, law(TUNINGS[name], robot=arm), PATH, backend="numba", steps_per_sample=4
    )
    assert report.within(1)
    assert report.chatter[0] < chatter


@cache
def found():
    record = simulate(ARM, RIG, puma560.p_law(), PATH, duration=0.5)
    return identify(ARM.dynamics, record, seed=1, progress=False)


def test_it_can_be_certified():
    """The worst of forty loops has, simulated alone, the error that the certificate says."""
    controller = ComputedTorquePID(found(), **dict(zip(NAMES, SLOW, strict=True)))
    certificate = certify(found(), RIG, controller, PATH, samples=40, duration=0.2)
    worst = certificate.worst
    alone = simulate(worst.arm, worst.rig, controller, PATH, duration=0.2, steps_per_sample=16)
    assert np.abs(alone.error_pulses).max() == worst.peak


@pytest.mark.parametrize("name", NAMES)
def test_bad_numbers_are_refused_in_one_line(name):
    with pytest.raises(
        ValueError, match=f"^{name} must (be positive|not be negative); got -1"
    ) as refusal:
        law(**{name: -1.0})
    assert "\n" not in str(refusal.value)
    if name != "integral":
        with pytest.raises(ValueError, match=f"^{name} must be positive; got 0"):
            law(**{name: 0.0})


def test_what_errors_of_the_model_move_is_the_integral_of_each_joint():
    """The state begins with the flag of the first reading."""
    assert law(TUNINGS["rigid"]).fields.places(2, MODEL_ERROR) == (range(1, 3),)

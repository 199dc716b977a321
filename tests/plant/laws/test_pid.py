"""PD, PID and the cascade against linear differential and difference equations, at the limit, and
from a file.

One joint without gravity and dry friction under a smooth encoder is J qdd + b qd = tau. What the
laws make of it is written down by hand as a linear system; e is the error in pulses, u the motor
torque, the gear is 1.
"""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from closed_loops import direct_rig, joint
from scipy.linalg import expm

from plant import PD, PID, Cascade, PointToPoint, Record, puma560, simulate
from plant.parts import from_plain
from plant.simulation import ClosedLoop, run

INERTIA, VISCOUS, START = 2.0, 3.0, 0.01
RIG = direct_rig((0.0,), (VISCOUS,), period=1e-3)
ARM = joint(1.0, 0.0, INERTIA)
PULSES = float(RIG.position_in_pulses(np.ones(1))[0])  # per rad
# P [N m/rad], D [N m s/rad], I [N m/(rad s)], [rad/s]
STIFF, DAMPING, RESET, POLE = 800.0, 60.0, 4000.0, 400.0
POSITION = 15.0  # [1/s]
HOLD = PointToPoint(start=(0.0,), goal=(0.0,), duration=0.3)


def gains(*values):
    """Gains per radian as gains per pulse."""
    return tuple((value / PULSES,) for value in values)


P_, D_, I_ = gains(STIFF, DAMPING, RESET)
LAWS = {
    "PD": PD(gain=P_, derivative=D_, filter=POLE),
    "PID": PID(gain=P_, derivative=D_, integral=I_, filter=POLE),
    "Cascade": Cascade(position=(POSITION,), speed=D_, integral=P_, filter=POLE),
}


def by_hand(name):
    """Matrix of (q, qd, smoothed signal, integral) about the reference 0, per radian; the error
    is -q.
    """
    # rate of q through one pole; the speed loop's error is slow = -15 q - pole (q - z)
    if name == "Cascade":
        filtering, slow = np.array([POLE, 0, -POLE, 0]), np.array([-POSITION - POLE, 0, POLE, 0])
        torque, integral = DAMPING * slow + [0, 0, 0, 1], STIFF * slow
    else:  # the same of the error
        filtering = np.array([-POLE, 0, -POLE, 0])
        torque = np.array([-STIFF, 0, 0, 1.0]) + DAMPING * filtering
        integral = np.array([-RESET if name == "PID" else 0.0, 0, 0, 0])
    return np.array([[0, 1, 0, 0], (torque - [0, VISCOUS, 0, 0]) / INERTIA, filtering, integral])


@pytest.mark.parametrize("name", LAWS)
def test_fast_hardware_is_the_linear_differential_equation(name):
    """From 0.01 rad off, at rest, over 0.3 s: of second order in h, but an integral is summed in
    rectangles, of first.

    Measured orders: 2.00; 1.01 to 1.03.
    """
    A = by_hand(name)
    assert np.linalg.eigvals(A[:3, :3] if name == "PD" else A).real.max() < -1
    start = np.array([START, 0.0, START if name == "Cascade" else -START, 0.0])
    expected = np.array([expm(A * t) @ start for t in np.arange(300) * 1e-3])[:, 0]
    off = []
    for steps in (4, 8, 16):
        record = simulate(
            ARM, RIG, LAWS[name], HOLD, steps_per_sample=steps, initial=[[START], [0.0]]
        )
        off.append(np.abs(record.true_q[:, 0] - expected).max())
    assert off[-1] < 1e-3 * START
    np.testing.assert_allclose(
        np.log2(np.divide(off[:-1], off[1:])), 2 if name == "PD" else 1, atol=0.05
    )


def spectrum(law, rig):
    """Eigenvalues of one sample of the simulator's own law step and sub-step about the
    reference.
    """
    loop = ClosedLoop(dynamics=ARM.dynamics, rig=rig, law=law, steps_per_sample=1, smooth=True)
    state, time, numbers = (
        ca.SX.sym("x", len(names))
        for names in (loop.state_names, loop.time_names, loop.number_names)
    )
    following = loop.substep(loop.law_step(state, time, numbers), time, numbers)[0]
    slope = ca.Function("slope", [state, time, numbers], [ca.jacobian(following, state)])
    at = loop.initial_state(np.zeros(1), np.zeros(1))
    at[loop.state_names.index("law[1]")] = 1.0  # a reading has been taken
    return np.linalg.eigvals(slope(at, [0, 0, 0, 0, loop.h], loop.number_values(ARM.f)).full())


@pytest.mark.parametrize("integral", [0.0, RESET])
def test_a_sampled_law_is_the_linear_difference_equation(integral):
    """Poles in z of q, qd, smoothed error and integral, by hand: without viscous friction the held
    torque is exact.

    Compared by the coefficients of the characteristic polynomial (of order one), which are well
    conditioned; roundings.
    """
    rig, T = direct_rig((0.0,), (0.0,), period=1e-3), 1e-3
    if integral:
        law = PID(gain=P_, derivative=D_, integral=I_, filter=POLE, period=T)
    else:
        law = PD(gain=P_, derivative=D_, filter=POLE, period=T)
    change = (1 - np.exp(-POLE * T)) * np.array([-1.0, 0, -1, 0])
    following = np.array([0, 0, 0, 1.0]) + T * integral * np.array([-1.0, 0, 0, 0])
    torque = np.array([-STIFF, 0, 0, 0]) + DAMPING / T * change + following * bool(integral)
    hand = np.array([[1, T, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], following])
    hand[2] += change
    hand[:2] += np.outer([T**2 / 2, T], torque) / INERTIA
    hand = hand if integral else hand[:3, :3]
    got = spectrum(law, rig)
    known = np.concatenate([np.linalg.eigvals(hand), [1.0, 1.0]])  # score and flag are held
    expected = np.concatenate([known, np.zeros(len(got) - len(known))])
    np.testing.assert_allclose(np.poly(got), np.poly(expected), rtol=0, atol=1e-11)


def test_the_reference_is_followed_in_pulses_of_the_motor():
    """The true arm, gears of both signs: PD and PID beat P, and the cascade lags by the speed
    over its gain.
    """
    rig, path = puma560.rig(), puma560.reference()
    common = {"gain": (0.20, 0.15), "derivative": (4e-4, 2e-4), "filter": 3000.0}
    errors = {
        "P": puma560.p_law(),
        "PD": PD(**common),
        "PID": PID(integral=(4.0, 3.0), **common),
        "Cascade": Cascade(
            position=(200.0, 200.0), speed=(1e-3, 1e-3), integral=(0.05, 0.05), filter=3000.0
        ),
    }
    records = {
        name: simulate(puma560.arm(), rig, law, path, duration=1.8) for name, law in errors.items()
    }
    rms = {name: np.sqrt(np.mean(record.error_pulses**2)) for name, record in records.items()}
    assert rms["PID"] < 0.6 * rms["PD"] < 0.6 * rms["P"]
    lag = rig.position_in_pulses(path(records["P"].t).qd) / 200.0
    # What the cascade lags less or more is friction at the turn and the swing of its loop: a tenth
    # of 94 pulses.
    np.testing.assert_allclose(
        records["Cascade"].error_pulses, lag, rtol=0, atol=0.1 * np.abs(lag).max()
    )


# -- at the limit --------------------------------------------------------------------------------
def limited(limit):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_limit=(limit,)))


@pytest.mark.parametrize("law", [LAWS["PID"], LAWS["Cascade"]], ids=["PID", "Cascade"])
def test_at_the_limit_the_integral_comes_to_ask_for_the_limit(law):
    """A joint held 0.1 rad off, amplifier 30 N m: the integral alone tends to 30, where one that
    winds up goes on.

    The integral's own time constant, gain / integral gain, is 0.2 and 0.075 s; after 4 s e^-20 of
    the start is left.
    """
    block = law.block(RIG)
    for limit, check in (
        (30.0, lambda last: abs(last - 30) < 1e-5),
        (np.inf, lambda last: last > 1000),
    ):
        state, torque = block.initial, np.zeros(1)
        for _ in range(4000):
            still = [0.0], [0.0], [0.0], [0.1 * PULSES], [0.0]
            asked, state = (
                x.full().ravel() for x in block.step(state, *still, torque, 1e-3, block.values)
            )
            torque = np.clip(asked, -limit, limit)
        assert check(state[2]), state  # (smoothed signal, reading, integral, asked)


def test_without_wind_up_a_long_way_is_no_long_overshoot():
    """0.5 rad to go at 30 N m: with the limit known to the law, the overshoot is below a third
    of that without.
    """
    law, start = LAWS["PID"], [[0.5], [0.0]]
    path = PointToPoint(start=(0.0,), goal=(0.0,), duration=3.0)
    known = simulate(ARM, limited(30.0), law, path, initial=start)
    assert (np.abs(known.torque[:50]) == 30.0).all()

    class Deaf(PID):
        """Takes what it asked for to be what was applied."""

        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return super().equations(
                rig, state, setpoint, pulses, rig.drive.joint_torque(state[-rig.n :]), dt
            )

    unknown = simulate(ARM, limited(30.0), Deaf(**law.__getstate__()), path, initial=start)
    assert -known.true_q.min() < -unknown.true_q.min() / 3
    assert np.abs(known.error_pulses[-1000:]).max() * 1e-3 < 0.5


# -- in records and scripts ----------------------------------------------------------------------
@pytest.mark.parametrize("period", [None, 0.7e-3])
@pytest.mark.parametrize("kind", [PD, PID, Cascade])
def test_both_backends_the_running_law_and_a_replay_from_a_file_agree(kind, period, tmp_path):
    fields = {"gain": (0.2, 0.15), "derivative": (1e-3, 5e-4), "integral": (2.0, 1.0)}
    if kind is PD:
        fields.pop("integral")
    if kind is Cascade:
        fields = {"position": (100.0, 80.0), "speed": (1e-3, 1e-3), "integral": (0.05, 0.05)}
    rig, law = puma560.rig(), kind(filter=2000.0, period=period, **fields)
    parts = puma560.arm(), rig, law, puma560.reference()
    record, slow = (run(*parts, 0.1, 4, None, backend).record for backend in ("numba", "casadi"))
    np.testing.assert_array_equal(slow.error_pulses, record.error_pulses)
    record.to_csv(tmp_path / "log.csv")
    read = Record.from_csv(tmp_path / "log.csv")
    assert read.law == law
    assert read.law == from_plain(law.describe())
    again = simulate(puma560.arm(), read.rig, read.law, read.reference, duration=0.1)
    np.testing.assert_array_equal(again.error_pulses, record.error_pulses)
    if period is not None:
        counts = record.reference_pulses - record.error_pulses
        running = read.law.start(rig, counts[0])
        torque = [running.step(*row) for row in zip(counts, *parts[-1](record.t), strict=True)]
        np.testing.assert_allclose(
            torque, record.torque, rtol=0, atol=1e-12 * np.abs(record.torque).max()
        )


PLAIN = {"gain": (1, 1), "derivative": (0, 0), "filter": 100.0}


def of_drive(**gains):
    """A cascade of the paper's rig from the gains of a drive."""
    return Cascade.from_drive(puma560.rig(), **{"Kp": 20, "Kv": 0.05, "Tn": 0.02} | gains, filter=9)


def test_gains_of_a_drive_are_given_once_or_per_joint():
    assert of_drive(Kp=20) == of_drive(Kp=(20, 20)) == of_drive(Kp=[20.0])
    assert not of_drive(Tn=np.inf).integral.any()
    assert not of_drive(Kp=0).position.any()


def test_a_difference_may_be_a_whole_number_of_numpy():
    options = {"position": (1,), "speed": (1,), "integral": (1,), "period": 1e-3}
    law = Cascade(**options, difference=np.int64(3))
    assert law == Cascade(**options, difference=3)
    assert from_plain(law.describe()) == law


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (
            lambda: PD(gain=(1, 1), derivative=(0, -1), filter=100),
            r"derivative must not be negative; got \[ 0. -1.\]",
        ),
        (lambda: PD(gain=(1, 1), derivative=(0, 0), filter=0), "filter must be positive; got 0"),
        (
            lambda: PD(gain=(1, 1), derivative=(0,), filter=100),
            r"derivative of PD must have shape \(2,\)",
        ),
        (
            lambda: PD(**PLAIN, period=0),
            "period must be a positive number; got 0. Give seconds, such as rig.period",
        ),
        (lambda: PD(**PLAIN, period="fast"), "period must be a positive number; got 'fast'"),
        (lambda: PD(**PLAIN, periode=1e-3), "Did you mean 'period'"),
        (
            lambda: PD(**PLAIN, integral=(1, 1)),
            "an option of PD must be one of 'gain', 'derivative', 'filter', 'per",
        ),
        (lambda: PID(**PLAIN), "missing a required argument: 'integral'"),
        (lambda: PID(**PLAIN, integral=(1, -1)), "integral must not be negative"),
        (lambda: PID(**(PLAIN | {"gain": (1, 0)}), integral=(1, 0)), "gain must be positive"),
        (
            lambda: Cascade(position=(1,), speed=(0,), integral=(1,), filter=9),
            "speed must be positive",
        ),
        (
            lambda: Cascade(position=(-1,), speed=(1,), integral=(1,), filter=9),
            "position must not be negative",
        ),
        (lambda: of_drive(Tn=0), "Tn must be positive"),
        (lambda: of_drive(Tn=(0.02, -0.02)), "Tn must be positive"),
        (lambda: of_drive(Tn=np.nan), "Tn must be positive"),
        (lambda: of_drive(Kv=0), "Kv must be positive"),
        (lambda: of_drive(Kv=np.inf), "Kv must be finite"),
        (lambda: of_drive(Kp=-1), "Kp must not be negative"),
        (lambda: of_drive(Kp=(1, 2, 3)), "Kp must be one number, or 2; got 3"),
        (lambda: of_drive(Kv=(1, 2, 3)), "Kv must be one number, or 2; got 3"),
        (lambda: of_drive(Tn=(1, 2, 3)), "Tn must be one number, or 2; got 3"),
        (lambda: of_drive(Kv="fast"), "Kv must be numbers"),
        (
            lambda: Cascade(position=(1,), speed=(1,), integral=(1,), difference=True, period=1e-3),
            "difference must be a whole number",
        ),
        (
            lambda: Cascade(position=(1,), speed=(1,), integral=(1,), filter=9, period=-1.0),
            "period must be a positive",
        ),
        (
            lambda: Cascade(position=(1,), speed=(1,), integral=(1,), filter=9).start(
                puma560.rig(), (0, 0)
            ),
            "2 joints",
        ),
        (
            lambda: simulate(ARM, RIG, dataclasses.replace(LAWS["PD"], period=0.3e-3), HOLD),
            "law's period must be a whole multiple of the sub-step",
        ),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)

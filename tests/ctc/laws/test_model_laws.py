"""Every law that holds an arm: its torque on the reference, the error equation it promises, what
it refuses.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from closed_loops import without_friction
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from ctc import (
    Adaptive,
    ComputedTorque,
    ComputedTorquePID,
    FeedForward,
    PDGravity,
    SlidingMode,
)
from identification import identify
from plant import PD, PID, Cascade, P, PointToPoint, part, puma560, simulate
from plant.parts import from_plain
from plant.simulation import run

RIG = puma560.rig()
GAINS = {"gain": (0.2, 0.15), "derivative": (4e-4, 2e-4), "filter": 2000.0, "period": RIG.period}
FEEDBACK, PID_FEEDBACK = PD(**GAINS), PID(integral=(4, 3), **GAINS)
CASCADE = Cascade(position=(100, 100), speed=(1e-3, 1e-3), integral=(0.05, 0.05), filter=3000.0)


@cache
def arm():
    return puma560.arm()


def pid_ahead(rig=RIG, robot=None):
    return FeedForward(robot or arm(), rig, feedback=PID_FEEDBACK)


ROLLING_OFF = {
    "bandwidth": 179.0,
    "ratio": 1.44,
    "integral": 66.4,
    "roll_off": 1085.0,
    "roll_off_damping": 0.99,
}


def rolling_off(rig=RIG, robot=None, **options):
    return ComputedTorquePID(robot or arm(), rig, **{**ROLLING_OFF, **options})


def adaptive(rig=RIG, robot=None, **options):
    chosen = {
        "bandwidth": 60.0,
        "gain": (300.0, 80.0),
        "adaptation": np.full(9, 0.01),
        "filter": 600.0,
        **options,
    }
    return Adaptive(robot or arm(), rig, **chosen)


def sliding(rig=RIG, robot=None, **options):
    return SlidingMode(
        robot or arm(),
        rig,
        **{"bandwidth": 60.0, "reach": 5.0, "layer": 0.05, "filter": 600.0, **options},
    )


MODEL = {
    "feed-forward": lambda rig=RIG, robot=None: FeedForward(robot or arm(), rig, feedback=FEEDBACK),
    "feed-forward, PID": pid_ahead,
    "PID": rolling_off,
    "adaptive": adaptive,
    "sliding mode": sliding,
}
ALL = {
    **MODEL,
    "gravity": lambda rig=RIG, robot=None: PDGravity(robot or arm(), rig, feedback=FEEDBACK),
}
EVERY = pytest.mark.parametrize("law", ALL.values(), ids=ALL)


def step(law, pulses, *motion, rig=RIG, state=None, torque=(0.0, 0.0)):
    """Commanded torque of a law and its next state, by casadi: its symbolic step, before the
    amplifier.
    """
    block = law.block(rig)
    state = block.initial if state is None else state
    both = block.step(
        state, *motion, rig.counts(motion[0]), pulses, torque, law.period or 1e-4, block.values
    )
    return [each.full().ravel() for each in both]


# -- torque --------------------------------------------------------------------------------------
@pytest.mark.parametrize("law", MODEL.values(), ids=MODEL)
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None, derandomize=True)
def test_on_the_reference_the_torque_is_inverse_dynamics_and_friction(law, seed):
    """In the middle of the encoder's cell nothing is fed back: tau = Y(q, qd, qdd) f +
    friction(qd_r).

    Tolerance: some hundred roundings of the largest term.
    """
    random = np.random.default_rng(seed)
    pulses = random.integers(-5000, 5000, 2)
    q, qd, qdd = RIG.cell_centre(pulses), random.normal(0, 0.5, 2), random.normal(0, 1, 2)
    b, c, k = RIG.drive.viscous, RIG.drive.coulomb, RIG.drive.gear
    expected = arm().inverse(q, qd, qdd) + b * k**2 * qd + c * abs(k) * np.sign(qd)
    np.testing.assert_allclose(step(law(), pulses, q, qd, qdd)[0], expected, rtol=0, atol=1e-10)


def test_pd_with_gravity_holds_the_arm_where_it_is():
    """At rest on its reference it commands the weight alone, at the measured pose; so an arm at
    rest stays there.
    """
    pulses = np.array([300, -700])
    q, still = RIG.cell_centre(pulses), np.zeros(2)
    law = PDGravity(arm(), RIG, feedback=FEEDBACK)
    np.testing.assert_allclose(
        step(law, pulses, q, still, still)[0], arm().h(q, still), rtol=0, atol=1e-10
    )
    # Off the reference by whole pulses: the weight at the measured pose and the feedback of the
    # error.
    there = RIG.cell_centre(pulses + np.array([50, -20]))
    asked = step(law, pulses, there, still, still)[0]
    spring = RIG.drive.gear * FEEDBACK.gain * (50, -20)
    np.testing.assert_allclose(asked, arm().h(q, still) + spring, rtol=0, atol=1e-9)


@pytest.mark.parametrize("feedback", [P(gain=(0.2, 0.15)), FEEDBACK, PID_FEEDBACK, CASCADE])
def test_the_feedback_beside_a_model_is_the_feedback_alone(feedback):
    """Fed the same counts, the commanded torque is that of the feedback alone plus inverse dynamics
    and friction.

    At the limit too: of what is cut off, the feedback hears its own part. Alone that is applied -
    model.
    """
    random, law = np.random.default_rng(3), FeedForward(arm(), RIG, feedback=feedback)
    alone_state = joint_state = None
    alone_torque = torque = np.zeros(2)
    for _ in range(20):
        pulses, motion = (
            random.integers(-400, 400, 2),
            (np.zeros(2), random.normal(size=2), random.normal(size=2)),
        )
        aid = arm().inverse(*motion) + RIG.drive.friction(motion[1])
        alone, alone_state = step(feedback, pulses, *motion, state=alone_state, torque=alone_torque)
        both, joint_state = step(law, pulses, *motion, state=joint_state, torque=torque)
        np.testing.assert_allclose(both, alone + aid, rtol=0, atol=1e-9)
        torque = RIG.drive.limited(both)
        alone_torque = torque - aid


# -- the linear error equation -------------------------------------------------------------------
@part
class Informed(ComputedTorque):
    """Computed torque whose observer has been told where the arm starts."""

    start: tuple = ()

    def initial_state(self, n):
        state = super().initial_state(n)
        state[: 2 * n] = np.ravel(self.start)
        return state


FAR_OFF = np.array([[0.05, -0.1], [0.4, 0.3]])
"""Error and its rate at t = 0, far beyond what would be linear if the model did not make it so
[rad, rad/s].
"""


def test_with_the_true_f_the_error_obeys_its_error_equation():
    """On a moving arm, D edd + L J (sqrt(2) w ed + w^2 e) = 0 with J = 1 / (D^-1)_jj and D = L P
    L^T.

    f-hat = f, a smooth encoder, no friction and no limit. What is left is that the torque is held:
    a delay of half a period, so of first order, measured at periods of 0.4, 0.2 and 0.1 ms, w = 30
    rad/s.
    """
    w, path, off = 30.0, puma560.reference(2.0), []
    start = path([0.0])
    initial = start.q[0] - FAR_OFF[0], start.qd[0] - FAR_OFF[1]

    def observer(t, x):
        D = arm().D(path([t]).q[0] - x[:2])
        inverse, root = np.linalg.inv(D), np.linalg.cholesky(D)
        alone = (np.sqrt(2) * w * x[2:] + w**2 * x[:2]) / np.diag(inverse)
        return np.concatenate([x[2:], -inverse @ (root / np.diag(root) @ alone)])

    for period in (4e-4, 2e-4, 1e-4):
        rig = without_friction(
            dataclasses.replace(RIG, drive=limitless()), smooth=True, period=period
        )
        law = Informed(arm(), rig, bandwidth=w, observer_ratio=2.0, start_boost=1, measured=True,
                       start=FAR_OFF.tolist())  # fmt: skip
        record = simulate(arm(), rig, law, path, duration=0.3, initial=initial, steps_per_sample=8)
        e = record.reference(record.t).q - record.true_q
        found = solve_ivp(
            observer, (0, record.t[-1]), FAR_OFF.ravel(), t_eval=record.t, rtol=1e-9, atol=1e-12
        )
        expected = found.y[:2].T
        off.append(np.abs(e - expected).max())
    assert off[-1] < 0.01 * np.abs(FAR_OFF[0]).max()
    np.testing.assert_allclose(np.log2(np.divide(off[:-1], off[1:])), 1.0, atol=0.02)


def limitless():
    return dataclasses.replace(RIG.drive, current_limit=(np.inf, np.inf))


def test_what_the_amplifier_cuts_off_does_not_wind_up():
    """0.05 rad (680 pulses) to come back, at the limit first: 21 % of the way too far, and 338 % by
    a law that is not told of the limit.
    """

    class Deaf(ComputedTorquePID):
        """Takes the commanded torque to be what was applied."""

        def equations(self, rig, state, setpoint, pulses, torque, dt):
            return super().equations(rig, state, setpoint, pulses, state[-rig.n :], dt)

    still, rig = (
        PointToPoint(start=(0.0, 0.5), goal=(0.0, 0.5), duration=0.5),
        without_friction(RIG),
    )
    overshoot = {}
    for kind in (ComputedTorquePID, Deaf):
        law = kind(arm(), rig, **ROLLING_OFF)
        record = simulate(arm(), rig, law, still, initial=[[0.05, 0.5], [0.0, 0.0]])
        assert (np.abs(record.torque[:8]) >= 0.999 * RIG.drive.torque_limit()).any(axis=1).all()
        overshoot[kind] = (record.error_pulses[:, 0] / record.error_pulses[0, 0]).min()
        if kind is ComputedTorquePID:
            assert np.abs(record.error_pulses[-100:]).max() <= 1
    assert -overshoot[ComputedTorquePID] < 0.25
    assert -overshoot[Deaf] > 3 * 0.25


# -- in the simulator and in a script ------------------------------------------------------------
@EVERY
def test_both_backends_and_the_running_law_agree(law):
    """Equal pulses from casadi and numba; the running law's torque to rounding, also of one that
    was written down.
    """
    law = law()
    record, slow = (
        run(arm(), RIG, law, puma560.reference(), 0.1, 4, None, backend).record
        for backend in ("numba", "casadi")
    )
    np.testing.assert_array_equal(slow.error_pulses, record.error_pulses)
    again, counts = from_plain(law.describe()), record.reference_pulses - record.error_pulses
    assert again == law
    running = again.start(RIG, counts[0])
    torque = [running.step(*row) for row in zip(counts, *record.reference(record.t), strict=True)]
    np.testing.assert_allclose(
        torque, record.torque, rtol=0, atol=1e-9 * np.abs(record.torque).max()
    )


@pytest.mark.parametrize(
    "feedback", [FEEDBACK, dataclasses.replace(FEEDBACK, period=None)], ids=["sampled", "fast"]
)
def test_the_model_is_worth_its_place(feedback):
    """Trajectory (6): PD alone, with gravity, with all of the model; each at most two thirds of
    the one before.
    """
    laws = (
        feedback,
        PDGravity(arm(), RIG, feedback=feedback),
        FeedForward(arm(), RIG, feedback=feedback),
    )
    rms = [
        np.linalg.norm(simulate(arm(), RIG, law, puma560.reference()).error_pulses) for law in laws
    ]
    assert rms[1] < 0.67 * rms[0]
    assert rms[2] < 0.67 * rms[1]


# -- what cannot be ------------------------------------------------------------------------------
@EVERY
def test_an_arm_that_no_feedback_stabilises_is_refused(law):
    f = puma560.PUBLISHED.copy()
    f[1:4] = 0.0
    f[0] = 1e-4 * 53.7**2 - 1e-6
    with pytest.raises(ValueError, match="falls short by 1e-06"):
        law(robot=puma560.dynamics().arm(f))


@EVERY
def test_a_rig_of_another_period_is_refused(law):
    """Its observer and filters were made for that period: at another one the arm swings, and
    nothing would say why.
    """
    with pytest.raises(
        ValueError, match=r"sampled as the law's own, every 0\.0007 s; got 0\.002 s"
    ):
        law().block(dataclasses.replace(RIG, period=2e-3))


@EVERY
def test_a_rig_of_another_arm_is_refused(law):
    names = (field.name for field in dataclasses.fields(RIG.drive) if "number" in field.metadata)
    drive = dataclasses.replace(RIG.drive, **{name: getattr(RIG.drive, name)[:1] for name in names})
    one = dataclasses.replace(
        RIG, drive=drive, encoder=dataclasses.replace(RIG.encoder, resolution=(800,))
    )
    with pytest.raises(ValueError, match=r"must have [12] joints"):
        law().start(one, (0,))
    with pytest.raises(ValueError, match="equal joints"):
        law(rig=one)


@cache
def found():
    record = simulate(arm(), RIG, puma560.p_law(), puma560.reference(), duration=0.5)
    return identify(arm().dynamics, record, seed=1, progress=False)


@EVERY
def test_an_identification_is_its_arm_and_its_rig(law):
    plain, own = law(found().rig, found().arm), law(None, found())
    assert type(own.arm) is type(plain.arm)
    assert own == plain
    assert own.describe() == plain.describe()
    assert hash(own) == hash(plain)
    other = dataclasses.replace(RIG, period=2 * RIG.period)
    assert law(other, found()) == law(other, found().arm)  # a rig that is given comes first
    assert dataclasses.replace(own) == from_plain(plain.describe()) == own


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: FeedForward(arm(), RIG), "missing a required argument: 'feedback'"),
        (
            lambda: FeedForward(arm(), RIG, feedback=0.2),
            "feedback of FeedForward must be of type Law",
        ),
        (lambda: PDGravity(arm(), RIG, feedback=P), "got the class P"),
        (
            lambda: PDGravity(arm(), RIG, feedback=P(gain=(1,))).start(RIG, (0, 0)),
            "P.gain must have 2 joints",
        ),
        (
            lambda: FeedForward(arm(), RIG, feedback=ComputedTorque(arm(), RIG)),
            "feedback must be a simple law",
        ),
        (lambda: FeedForward(arm(), RIG, feedback=P(gain=(1,))), "P.gain must have 2 joints"),
        (lambda: PDGravity(arm(), RIG, pd=FEEDBACK), "an option of PDGravity must be one of"),
        (lambda: rolling_off(bandwidth=0), "bandwidth must be positive; got 0"),
        (lambda: sliding(filter=-1), "filter must be positive"),
        (lambda: sliding(bandwith=60), "Did you mean 'bandwidth'"),
        (lambda: rolling_off(roll_off=0), "roll_off must be positive; got 0"),
        (lambda: rolling_off(rolloff=900), "Did you mean 'roll_off'"),
        (
            lambda: adaptive(adaptation=(1, 2)),
            "adaptation must have 9 numbers, one for each of f1..f9; got 2",
        ),
        (lambda: adaptive(adaptation=np.full(9, -1)), "adaptation must not be negative"),
        (lambda: adaptive(gain=(300, -80)), "gain must not be negative"),
        (lambda: adaptive(gain=(300,)).start(RIG, (0, 0)), "Adaptive.gain must have 2 joints"),
        (
            lambda: adaptive(ranges=puma560.PRINTED_RANGES),
            r"f3 = -0.29 is not in \[-0.2, 0.2\]. Widen",
        ),
        (lambda: adaptive(ranges=[(0, 1)]), r"ranges must have shape \(9, 2\)"),
        (lambda: sliding(reach=0), "reach must be positive"),
        (lambda: sliding(layer=-0.1), "layer must be positive"),
        (
            lambda: SlidingMode(arm(), RIG, bandwidth=60, reach=5, layr=0.05, filter=600),
            "Did you mean 'layer'",
        ),
        (
            lambda: SlidingMode(RIG, arm(), bandwidth=60, reach=5, layer=0.05, filter=600),
            "must be of type Arm",
        ),
        (
            lambda: ComputedTorque(arm()),
            "rig of ComputedTorque must be of type Rig; .* or an identification in place",
        ),
        (
            lambda: FeedForward(arm(), feedback=FEEDBACK),
            "rig of FeedForward must be .* Pass the arm's rig, or an",
        ),
        (
            lambda: ComputedTorque(found(), arm()),
            "rig of ComputedTorque must be of type Rig; got a value of type Arm",
        ),
        (lambda: ComputedTorque(rig=RIG), "missing a required argument: 'arm'"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, said):
    with pytest.raises(ValueError, match=said) as refusal:
        call()
    assert "\n" not in str(refusal.value)

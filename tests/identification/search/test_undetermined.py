"""A vertical slide under a controller with an integral: its weight and the integral are one number."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from random_rigs import drawn

from identification import identify
from identification.search import Fit, Outcome, with_undetermined
from plant import (
    PID,
    Cascade,
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    Rig,
    Spline,
    Table,
    puma560,
    simulate,
)

GEAR = 2 * np.pi / 0.01  # motor angle per travel [rad/m]
CHAIN = Chain(links=(Link(name="slide", prismatic=True),), gravity=(0.0, 0.0, -9.81))
DYNAMICS = Dynamics.from_chain(CHAIN)
ROTOR = 1.1e-5  # of the motor [kg m^2]
MASS = 4.2  # [kg]
TRUE = np.array([{"m_slide": MASS, "J_slide": ROTOR * GEAR**2}[name] for name in DYNAMICS.names])
RIG = Rig(
    drive=Drive(
        gear=(GEAR,),
        motor_inertia=(ROTOR,),
        motor_gain=(1.0,),
        current_limit=(1.2,),
        viscous=(25 / GEAR**2,),
        coulomb=(5 / GEAR,),
    ),
    encoder=Encoder(resolution=(8192.0,)),
    period=1e-3,
)
# The speed loop has a bandwidth of 110 rad/s, its integral of 15 rad/s.
SPEED = 110 * TRUE.sum() * 0.01 / 8192 / GEAR
LAW = Cascade(
    position=(22.0,), speed=(SPEED,), integral=(15 * SPEED,), difference=2, period=RIG.period
)
PATH = Harmonics(
    period=3.0, offset=(0.1,), cosine=((-0.03, 0.004, 0.002),), sine=((0.01, -0.006, 0.0),)
)


# A loop of 80 rad/s, whose integral follows the weight with some 16 rad/s.
UNIT = TRUE.sum() * 0.01 / 8192 / GEAR
STIFF = PID(
    gain=(80**2 * UNIT,),
    derivative=(1.4 * 80 * UNIT,),
    integral=(0.2 * 80**3 * UNIT,),
    filter=600.0,
    period=RIG.period,
)


def log(begin, law=LAW):
    """Four seconds without torque, from this instant of the run."""
    record = simulate(DYNAMICS.arm(TRUE), RIG, law, PATH, duration=4 + begin, steps_per_sample=16)
    record = record.cut(begin) if begin else record
    return dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)


def deviations(estimate):
    return (estimate.fit.values - TRUE) / estimate.fit.std


def test_a_log_from_the_start_of_the_controller_determines_the_weight():
    estimate = identify(DYNAMICS, log(0.0), progress=False)
    assert np.abs(estimate.fit.values / TRUE - 1).max() < 1e-3
    assert np.abs(deviations(estimate)).max() < 3
    assert estimate.fit.undetermined == ()


@pytest.mark.parametrize(
    "begin", [0.3, *(pytest.param(t, marks=pytest.mark.slow) for t in (0.83, 2.0))]
)
def test_a_log_from_the_middle_leaves_the_weight_open_and_says_so(begin):
    """The sum of both is known, the weight is not: the integral could carry any part of it.

    From 0.3 s an integral of zero fits, too: the mass came out below zero, with five digits.
    """
    estimate = identify(DYNAMICS, log(begin), progress=False)
    assert np.abs(deviations(estimate)).max() < 3
    assert estimate.fit.undetermined == (DYNAMICS.names,)
    assert estimate.fit.std[0] > 0.1 * MASS
    assert estimate.fit.values.sum() == pytest.approx(TRUE.sum(), rel=1e-3)
    assert any("state of the controller" in warning for warning in estimate.warnings)


def test_a_log_from_the_middle_without_an_error_leaves_the_weight_open():
    """Its integral already moves about the weight that it carries: it did not begin with the log.

    Taken as zero at the first sample, it gave a mass below zero with five digits.
    """
    record = log(1.7855, STIFF)
    assert record.error_pulses[0] == 0
    estimate = identify(DYNAMICS, record, progress=False)
    assert estimate.fit.undetermined == (DYNAMICS.names,)
    assert np.abs(deviations(estimate)).max() < 3
    assert estimate.fit.values.sum() == pytest.approx(TRUE.sum(), rel=1e-3)


@pytest.mark.parametrize(
    ("creep", "law", "counts"),
    [(0, LAW, 0), pytest.param(20, LAW, 1, marks=pytest.mark.slow), (80, STIFF, 2)],
)
def test_a_log_that_begins_at_rest_leaves_the_weight_open(creep, law, counts):
    """The integral carried the slide before the log; friction hides where and how it came to rest.

    Its position and speed took the slopes of the weight over: a mass below zero, thousands of
    deviations off.
    """
    hold, times = 1.0, np.arange(0.0, 6.0, 0.01)
    knots = (0.1, 0.13, 0.06, 0.12, 0.09, 0.11, 0.1)
    moving = Spline(times=tuple(np.linspace(0, 5, 7)), points=tuple((knot,) for knot in knots))
    crept = creep * 0.01 / 8192 * np.minimum(times, hold)
    path = Table(times=times, points=moving(np.maximum(times - hold, 0.0)).q + crept[:, None])
    record = simulate(DYNAMICS.arm(TRUE), RIG, law, path, duration=5.9, steps_per_sample=16)
    record = record.cut(0.94 if creep else 0.9)
    assert np.ptp(record.counts[:30]) == counts
    record = dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)
    estimate = identify(DYNAMICS, record, progress=False)
    assert estimate.fit.undetermined == (DYNAMICS.names,)
    assert np.abs(deviations(estimate)).max() < 3
    assert estimate.fit.values.sum() == pytest.approx(TRUE.sum(), rel=1e-3)


def test_a_stiff_loop_that_begins_with_its_log_determines_the_weight():
    estimate = identify(DYNAMICS, log(0.0, STIFF), progress=False)
    assert estimate.fit.undetermined == ()
    assert np.abs(deviations(estimate)).max() < 3


def test_a_light_weight_is_determined_where_its_controller_begins():
    """Friction moves the integral through zero; the errors bend where the weight is taken up."""
    case = drawn(54, torque=False)
    estimate = identify(case.dynamics, case.record, progress=False)
    assert estimate.fit.undetermined == ()
    assert np.abs((estimate.fit.values - case.truth) / estimate.fit.std).max() < 3


def test_a_logged_torque_determines_the_weight_of_a_log_from_the_middle():
    record = simulate(DYNAMICS.arm(TRUE), RIG, LAW, PATH, duration=8.0, steps_per_sample=16).cut(
        2.0
    )
    estimate = identify(
        DYNAMICS, dataclasses.replace(record, true_q=None, true_qd=None), progress=False
    )
    assert np.abs(estimate.fit.values / TRUE - 1).max() < 0.02
    assert estimate.fit.undetermined == ()


@pytest.mark.slow
def test_the_middle_of_a_log_under_a_pid_determines_an_arm():
    """Weights and integrals act alike for a second only: the arm moves through other poses."""
    arm = puma560.literature_arm(1.5)
    rig = dataclasses.replace(puma560.rig(), period=1e-3)
    law = PID(
        gain=(0.1, 0.075), integral=(0.5, 0.4), derivative=(4e-4, 3e-4), filter=2000, period=1e-3
    )
    record = simulate(arm, rig, law, puma560.reference(), duration=3.0).cut(0.4)
    record = dataclasses.replace(record, torque=None, current=None, true_q=None, true_qd=None)
    estimate = identify(arm.dynamics, record, seed=1, progress=False)
    assert estimate.fit.undetermined == ()
    assert (estimate.fit.std < 0.05).all()
    assert np.abs((estimate.f - arm.f) / estimate.fit.std).max() < 3
    assert not estimate.warnings


def test_unknowns_that_turn_with_several_directions_are_named_once():
    """Another start of the arm alone turns none of them."""
    fit = Fit(
        unknown=("m", "J"),
        values=np.ones(2),
        candidates=np.ones((1, 2)),
        covariance=1e-6 * np.eye(2),
    )
    directions = np.array([[1.0, -1, 1, 0], [2.0, -1, 0, 1], [1e-9, 0, 0, 1]])
    solution = SimpleNamespace(undetermined=directions)
    prediction = SimpleNamespace(widest=lambda direction: direction)
    fit = with_undetermined(Outcome(fit=fit), prediction, solution).fit
    assert fit.undetermined == (("m", "J"),)
    np.testing.assert_allclose(fit.covariance, [[5, -3], [-3, 2]], rtol=1e-5)

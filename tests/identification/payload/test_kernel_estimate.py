"""The window estimator on simulated logs under computed torque: kilograms, intervals, windows
that say too little.
"""

import dataclasses
import functools

import coupled_arm
import numpy as np
import pytest

from ctc import ComputedTorque
from identification import identify
from identification.payload import KernelEstimator, LoadShape, Window, uncertainty
from plant import Body, Elasticity, FrictionCurve, Harmonics, puma560, simulate

RIG, PATH, N = puma560.rig(), puma560.reference(), 286
PLACE = (0.0, -0.4, 0.0)


def shape(position=PLACE):
    return LoadShape.of(puma560.arm(), (0, 5), position, None, (0.2, 0.5), (0,) * 6)


def estimator(position=PLACE, friction=0.0):
    arm = puma560.arm()
    return KernelEstimator(arm, RIG, shape(position), *uncertainty(arm, RIG, None, friction))


@functools.cache
def log(mass, place=PLACE, path=PATH):
    """The arm with this load, under a law that holds the prior."""
    arm, matrix = puma560.arm(), puma560.dynamics().load_matrix()
    loaded = arm.f + matrix @ Body(mass=mass, com=place).standard_parameters
    law = ComputedTorque(arm.dynamics.arm(arm.f + matrix @ shape().prior), RIG, bandwidth=150)
    return simulate(arm.dynamics.arm(loaded), RIG, law, path)


def window(record, start):
    return Window(
        record.counts[start : start + N], record.torque[start : start + N], record.torque[start - 1]
    )


STARTS = np.arange(300, 4900, 190)


def test_known_arm_known_place():
    """At most 0.03 kg in 95 % of the windows over (6); the interval holds the truth and is not
    idle.
    """
    masses = np.repeat([1.0, 3.0, 5.0], len(STARTS))
    found = [estimator()(window(log(mass), start)) for mass in (1.0, 3.0, 5.0) for start in STARTS]
    error = np.abs([each.mass for each in found] - masses)
    inside = [
        low <= mass <= high
        for (low, high), mass in zip((each.interval for each in found), masses, strict=True)
    ]
    assert all(each.sufficient for each in found)
    assert np.percentile(error, 95) < 0.03
    assert np.mean(inside) > 0.93
    assert np.median([np.ptp(each.interval) / 2 for each in found]) < 0.03


def test_known_arm_place_on_a_line():
    """The torque of the segment is right to 5 %, although mass and distance may trade."""
    body, arm = Body(mass=3.0, com=(0, -0.3, 0)), puma560.arm()
    matrix, finder = arm.dynamics.load_matrix(), estimator(None)
    for start in STARTS[::4]:
        found = finder(window(log(3.0, (0, -0.3, 0)), start))
        motion = PATH(np.arange(start, start + N, 15) * RIG.period)
        regressor = (
            np.vstack([arm.dynamics.Y(*state).full() for state in zip(*motion, strict=True)])
            @ matrix
        )
        true = regressor @ body.standard_parameters
        assert np.linalg.norm(regressor @ found.parameters - true) < 0.05 * np.linalg.norm(true)
        assert found.interval[0] <= 3.0 <= found.interval[1]
        np.testing.assert_allclose(found.position[[0, 2]], 0, atol=1e-12)


def test_a_sign_turned_is_seen():
    """A torque of the wrong sign is no load."""
    sound = window(log(3.0), 1000)
    found = estimator()(dataclasses.replace(sound, torque=-sound.torque, before=-sound.before))
    assert not found.sufficient or found.mass < 0.2


def test_an_arm_at_rest_says_nothing():
    still = Harmonics(
        period=1.0, offset=(-0.5, 0.8), cosine=np.zeros((2, 1)), sine=np.zeros((2, 1))
    )
    found = estimator()(window(log(3.0, PLACE, still), 500))
    assert not found.sufficient
    assert "rests" in found.message
    assert found.mass == 2.5


def test_a_load_that_comes_within_the_window_is_not_believed():
    early, late = window(log(0.0), 1000), window(log(5.0), 1000)
    mixed = Window(
        np.vstack([early.counts[:143], late.counts[143:]]),
        np.vstack([early.torque[:143], late.torque[143:]]),
        early.before,
    )
    found = estimator()(mixed)
    assert not found.sufficient


@pytest.mark.parametrize("samples", [1, 30, 58])
def test_a_window_shorter_than_the_kernel_is_refused(samples):
    """Smoothing would exchange samples and kernel, and misfit would be blamed on the load."""
    whole = window(log(3.0), 1000)
    short = Window(whole.counts[:samples], whole.torque[:samples], whole.before)
    with pytest.raises(ValueError, match=rf"at least 59 samples.*; got {samples}\."):
        estimator()(short)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda w: {"torque": w.torque[:, :1]}, "torque"),
        (lambda w: {"torque": w.torque[:-1]}, "torque"),
        (lambda w: {"before": 0.0}, "before"),
        (lambda w: {"before": w.before[None]}, "before"),
        (lambda w: {"counts": w.counts[:, 0]}, "counts"),
    ],
)
def test_a_window_of_other_shapes_is_refused(change, named):
    whole = window(log(3.0), 1000)
    with pytest.raises(ValueError, match=f"^{named} must have shape"):
        dataclasses.replace(whole, **change(whole))


def test_a_window_of_other_joints_is_refused():
    """One column would pass for the counts and torques of every joint."""
    whole = window(log(3.0), 1000)
    with pytest.raises(ValueError, match="2 joints like the arm; got 1"):
        estimator()(Window(whole.counts[:, :1], whole.torque[:, :1], whole.before[:1]))


@pytest.mark.parametrize("field", ["counts", "torque"])
@pytest.mark.parametrize("row", [0, 140])
def test_a_window_that_holds_nan_keeps_the_prior(field, row):
    values = getattr(window(log(3.0), 1000), field).copy()
    values[row] = np.nan
    found = estimator()(dataclasses.replace(window(log(3.0), 1000), **{field: values}))
    assert not found.sufficient
    assert found.mass == 2.5
    assert "NaN" in found.message


def test_friction_that_is_uncertain_widens_the_interval():
    sure, unsure = (estimator(friction=share)(window(log(3.0), 1000)) for share in (0.0, 0.1))
    assert unsure.std > 1.5 * sure.std


@functools.cache
def coupled(elasticity=None):
    """A rig and an arm with a coupled wrist, and the prior of a load that may weigh 5 kg."""
    limit = (50.0, 50.0, 50.0)
    rig = coupled_arm.rig_of(coulomb=(0.1, 0.2, 0.2), current_limit=limit, elasticity=elasticity)
    arm = coupled_arm.arm_of(rig)
    return rig, arm, LoadShape.of(arm, (0, 5), (0.25, 0, 0), None, (0.1, 0.5), (0,) * 6)


def test_friction_of_coupled_motors_is_left_out_where_its_shaft_turns_back():
    """A joint may slide while a shaft that moves it reverses: misfit was 8."""
    rig, arm, load = coupled()
    matrix = arm.dynamics.load_matrix()
    loaded = arm.dynamics.arm(arm.f + matrix @ load.per_kg[0])
    law = ComputedTorque(arm.dynamics.arm(arm.f + matrix @ load.prior), rig, bandwidth=60)
    record = simulate(loaded, rig, law, coupled_arm.path_of(4.0), duration=0.82)
    rows = slice(600, 800)
    found = KernelEstimator(arm, rig, load, *uncertainty(arm, rig, None, 0.0))(
        Window(record.counts[rows], record.torque[rows], record.torque[599])
    )
    assert found.misfit < 1
    assert found.interval[0] <= 1.0 <= found.interval[1]


def slowest_period(arm, rig, mass):
    """Slowest resonance [s] of links with a point mass on coupled, elastic gears, motors locked."""
    body = Body(mass=mass, com=(0.25, 0, 0))
    f = arm.f + arm.dynamics.load_matrix() @ body.standard_parameters
    C = np.array(rig.drive.coupling.matrix)
    links = (
        arm.dynamics.D(np.zeros(arm.n), f).full() - C.T @ np.diag(rig.drive.reflected_inertia()) @ C
    )
    stiffness = C.T @ np.diag(rig.drive.elasticity.stiffness) @ C
    return 2 * np.pi * np.sqrt(np.linalg.eigvals(np.linalg.solve(stiffness, links)).real.max())


@pytest.mark.parametrize("lightest", [0.0, 3.0])
def test_the_kernel_is_two_periods_of_the_heaviest_load(lightest):
    """On the shafts; and the heaviest load of a range is its end, wherever it begins."""
    gears = Elasticity(stiffness=(4000.0, 3000.0, 500.0), damping=(5.0, 5.0, 1.0))
    rig, arm, load = coupled(elasticity=gears)
    load = dataclasses.replace(load, mass=np.array([lightest, 5.0]))
    finder = KernelEstimator(arm, rig, load, *uncertainty(arm, rig, None, 0.0))
    samples = 2 + round(2 * slowest_period(arm, rig, 5.0) / rig.period)
    with pytest.raises(ValueError, match=f"at least {samples} samples"):
        finder(Window(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(3)))


def test_the_uncertainty_of_an_identification_is_its_covariance_and_that_of_other_friction():
    curve = FrictionCurve(offset=(0.002, -0.002))
    rig = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve))
    record = simulate(puma560.arm(), rig, puma560.p_law(), PATH, duration=0.7)
    names = (*puma560.dynamics().names, "drive.coulomb[0]", "drive.curve.offset[1]")
    found = identify(
        puma560.dynamics(), record, unknown=names, method="output_error", progress=False
    )
    unknown, root = uncertainty(found.arm, found.rig, found, 0.05)
    assert unknown == (*names, "drive.viscous[0]", "drive.viscous[1]", "drive.coulomb[1]")
    covariance = root @ root.T
    scale = np.sqrt(np.diag(found.covariance))
    np.testing.assert_allclose(
        covariance[:11, :11] / np.outer(scale, scale), found.fit.correlation, atol=1e-9
    )
    levels = [found.rig.numbers()[name] for name in unknown[11:]]
    np.testing.assert_allclose(covariance[11:, 11:], np.diag((0.05 * np.array(levels)) ** 2))
    assert not covariance[:11, 11:].any()
    # The rig of a law may lack the curve.
    assert names[-1] not in uncertainty(found.arm, RIG, found, 0.05)[0]
    fit = dataclasses.replace(found.fit, covariance=None, fallback_reason="rough")
    with pytest.raises(ValueError, match="found must have a covariance"):
        uncertainty(found.arm, found.rig, dataclasses.replace(found, fit=fit), 0.05)


def test_what_is_refused():
    arm = puma560.arm()
    with pytest.raises(ValueError, match="friction"):
        uncertainty(arm, RIG, None, -0.1)
    with pytest.raises(ValueError, match="found"):
        uncertainty(arm, RIG, arm, 0.0)
    drive = dataclasses.replace(RIG.drive, load_friction=(0.1, 0.1))
    loaded = dataclasses.replace(RIG, drive=drive)
    with pytest.raises(ValueError, match=r"load_friction of the rig .*'genetic'"):
        KernelEstimator(arm, loaded, shape(), *uncertainty(arm, loaded, None, 0.0))

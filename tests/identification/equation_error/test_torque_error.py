"""The error of a torque on a record is what was put into it; friction is not negative."""

import dataclasses

import numpy as np
import pytest
from coupled_arm import PERIOD, arm_of, path_of, rig_of
from packaged_arms import planar
from scipy.ndimage import gaussian_filter1d

from ctc import ComputedTorque
from identification import fit_torque, identify, nearest_physical
from identification.equation_error import bounded
from plant import Drive, Dynamics, Encoder, Rig, puma560, replay, simulate

SECONDS = 8.0


@pytest.fixture(scope="module")
def made():
    """Exact positions and torques of a coupled arm, with open friction in the rig of its logs."""
    rig = rig_of(coulomb=(0.1, 0.08, 0.05), current_limit=(20.0,) * 3)
    arm = arm_of(rig)
    motion = path_of(4.0)(np.arange(0, SECONDS, PERIOD))
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    drive = dataclasses.replace(rig.drive, viscous=None, coulomb=None)
    return arm, rig, dataclasses.replace(rig, drive=drive), motion, torque


@pytest.fixture(scope="module")
def fit(made):
    arm, rig, stated, motion, torque = made
    friction = rig.drive.friction(motion.qd)
    return fit_torque(arm.dynamics, motion.q, torque + friction, rig=stated, band=20.0)


def test_the_error_is_that_which_was_added(made, fit):
    """A sine of 3 Hz passes the band whole: its RMS is its amplitude over the root of 2."""
    _, rig, _, motion, torque = made
    t = np.arange(0, SECONDS, PERIOD)
    amplitude = np.array([0.0, 3.0, 0.5])
    added = amplitude * np.sin(2 * np.pi * 3 * t)[:, None]
    measured = torque + rig.drive.friction(motion.qd) + added
    clean = fit.error_on(motion.q, measured - added, rig=rig)
    error = fit.error_on(motion.q, measured, rig=rig)
    assert clean.total < 3e-3
    np.testing.assert_allclose(error.rms[1:], amplitude[1:] / np.sqrt(2), rtol=0.02)
    size = np.sqrt(np.mean(measured**2, axis=0))
    np.testing.assert_allclose(error.relative[1:], error.rms[1:] / size[1:], rtol=0.02)
    together = np.sqrt((error.rms**2).sum() / (size**2).sum())
    assert error.total == pytest.approx(together, rel=0.02)
    assert error.band == 10.0
    assert fit.error_on(motion.q, measured, rig=rig, band=1.0).total < 0.2 * error.total


def test_all_rows_count_and_a_joint_without_torque_is_left_out(made, fit):
    _, rig, _, motion, torque = made
    torque = torque + rig.drive.friction(motion.qd)
    slow = dataclasses.replace(fit, least_speed=np.full(3, 1e9))  # the fit's own choice is none
    missing = torque.copy()
    missing[:, 1] = np.nan
    error = slow.error_on(motion.q, missing, rig=rig)
    assert error.rows == len(torque) - 2 * 100  # 1 / (10 Hz) at both ends
    assert np.isnan(error.rms[1])
    assert np.isfinite(error.rms[[0, 2]]).all()
    assert error.total < 3e-3
    speed = np.abs(motion.qd[100:-100])
    stuck = missing - 2 * rig.drive.friction(motion.qd) * (np.abs(motion.qd) < 0.05)
    moving = fit.error_on(motion.q, stuck, rig=rig, least_speed=(0.4, 0.4, 0.4))
    fast = (speed > 0.4)[:, [0, 2]].any(axis=1)
    assert moving.rows == pytest.approx(fast.sum(), abs=20)
    assert moving.total < 0.2 * fit.error_on(motion.q, stuck, rig=rig).total
    twice = fit.error_on([motion.q] * 2, [torque] * 2, rig=rig)
    assert twice.rows == 2 * error.rows


def test_one_metric_for_every_fit():
    """An identification and a torque fit of the same values have the same error."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    record = simulate(arm, rig, puma560.p_law(), puma560.reference())
    found = identify(arm.dynamics, record, progress=False)
    fit = fit_torque(arm.dynamics, record)
    same = dataclasses.replace(fit, values=found.f)
    assert same.error_on(record).total == found.error_on(record).total
    assert found.error_on(record, band=5.0).band == 5.0


def test_the_fit_prints_the_error_of_its_own_logs(made, fit):
    _, rig, _, motion, torque = made
    own = fit.error_on(motion.q, torque + rig.drive.friction(motion.qd), rig=rig)
    assert fit.error.total == own.total
    assert f"{fit.error.total:.2%} of the torque" in " ".join(str(fit).split())


def test_bad_input_is_refused(made, fit):
    _, rig, _, motion, torque = made
    with pytest.raises(ValueError, match="band must be at most 160 Hz"):
        fit.error_on(motion.q, torque, rig=rig, band=200.0)
    with pytest.raises(ValueError, match="some rows must be faster than least_speed"):
        fit.error_on(motion.q[:150], torque[:150], rig=rig)


# -- friction ------------------------------------------------------------------------------------
def test_open_friction_is_found_without_a_word(made, fit):
    _, rig, stated, _, _ = made
    assert stated.drive.left_open == ("viscous", "coulomb")
    np.testing.assert_allclose(fit.rig.drive.coulomb, rig.drive.coulomb, rtol=0.02)
    np.testing.assert_allclose(fit.rig.drive.viscous, rig.drive.viscous, rtol=0.02)


def test_bounded_least_squares_is_scipys():
    from scipy.optimize import lsq_linear

    random = np.random.default_rng(3)
    bounds = np.arange(8) >= 4
    active = 0
    for _ in range(50):
        rows, target = random.normal(size=(30, 8)), random.normal(size=30)
        inverse = np.linalg.inv(rows.T @ rows)
        values = bounded(inverse @ rows.T @ target, inverse, bounds)
        lower = np.where(bounds, 0.0, -np.inf)
        expected = lsq_linear(rows, target, (lower, np.inf), tol=1e-14).x
        np.testing.assert_allclose(values, expected, atol=1e-6)
        active += int((values[bounds] == 0).sum())
    assert active > 50


@pytest.mark.slow
def test_friction_is_not_negative_and_its_interval_holds(made):
    """A joint without viscous friction: half of the estimates are at the bound, and 95 % hold."""
    arm, rig, stated, motion, torque = made
    drive = dataclasses.replace(rig.drive, viscous=(1e-3, 0.0, 1e-3))
    torque = torque + drive.friction(motion.qd)
    truth = {f"drive.viscous[{i}]": value for i, value in enumerate(drive.viscous)}
    truth |= dict(zip(arm.dynamics.names, arm.f, strict=True))
    random, at_bound, held, said = np.random.default_rng(0), [], [], []
    for _ in range(24):
        noise = np.repeat(random.normal(size=(len(torque) // 20, 3)), 20, axis=0)
        found = fit_torque(
            arm.dynamics, motion.q, torque + 8 * noise, rig=stated, band=20.0, every=25
        )
        value, std = found["drive.viscous[1]"], found.std[found.names.index("drive.viscous[1]")]
        assert value >= 0
        at_bound.append(value == 0)
        held.append([abs(found[k] - v) < 1.96 * s for k, v, s in
                     ((k, v, found.std[found.names.index(k)]) for k, v in truth.items())])  # fmt: skip
        line = next(line for line in str(found).splitlines() if "drive.viscous[1]" in line)
        said.append(("zero within it" in line) == (value <= 1.96 * std))
        assert not any("negative" in warning for warning in found.warnings)
    assert 0.25 < np.mean(at_bound) < 0.75
    assert np.mean(held) > 0.9
    assert all(said)


def test_friction_that_drives_is_a_wrong_sign(made):
    arm, rig, stated, motion, torque = made
    fit = fit_torque(
        arm.dynamics, motion.q, torque - rig.drive.friction(motion.qd), rig=stated, band=20.0
    )
    assert (fit.rig.drive.coulomb == 0).all()
    assert any("friction must not be negative" in line for line in fit.warnings)


def test_a_prior_decides_what_the_log_does_not():
    """A log in which one joint alone moves says little of the rest: a spread about f does."""
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    path = dataclasses.replace(puma560.reference(), cosine=np.diag([0.0, -np.pi / 4]))
    motion = path(np.arange(0, 8, rig.period))
    random = np.random.default_rng(0)
    torque = np.array([arm.inverse(*state) for state in zip(*motion, strict=True)])
    torque += rig.drive.friction(motion.qd) + random.normal(size=torque.shape)
    near = arm.f * (1 + 0.1 * random.normal(size=arm.f.shape))
    options = {"rig": rig, "band": 10.0, "least_speed": 0.05}
    with pytest.raises(ValueError, match="f7, f8, f9 do not in this motion"):
        fit_torque(arm.dynamics, motion.q, torque, **options)
    fit = fit_torque(arm.dynamics, motion.q, torque, prior=(near, 0.1), **options)
    assert (np.abs(fit.f - arm.f) < 3 * fit.std).all()
    assert (fit.std < 0.11 * np.abs(near)).all()
    # What the log shows is the log's.
    assert (np.abs(fit.f - arm.f) < np.abs(near - arm.f) + fit.std).all()


def test_bodies_of_the_model_are_the_prior_only_where_they_predict_better():
    """Small motions beside a slow torque that the model lacks leave f open; bodies of a hundred
    times the mass are those of another arm.
    """
    chain = planar(2)
    arm = Dynamics.from_chain(chain).arm(Dynamics.from_chain(chain).f(chain.bodies))
    one = np.ones(2)
    drive = Drive(
        gear=one,
        motor_inertia=0 * one,
        motor_gain=one,
        current_limit=np.inf * one,
        viscous=0 * one,
        coulomb=0 * one,
    )
    rig = Rig(drive=drive, encoder=Encoder(resolution=2.0**20 * one), period=0.01)
    t = np.arange(0, 10, rig.period)
    random = np.random.default_rng(1)
    waves = 2 * np.pi * np.array([0.2, 0.45, 0.8])
    q = 0.3 + sum(0.05 * np.sin(np.outer(t, one) * w + random.uniform(0, 6, 2)) for w in waves)
    qd = np.gradient(q, t, axis=0)
    states = zip(q, qd, np.gradient(qd, t, axis=0), strict=True)
    lacking = gaussian_filter1d(random.normal(size=q.shape), 20, axis=0)
    torque = np.array([arm.inverse(*state) for state in states]) + 2 * lacking / lacking.std()

    def fitted(factor, **options):
        bodies = [
            dataclasses.replace(body, mass=factor * body.mass, rotor=factor * body.rotor)
            for body in chain.bodies
        ]
        dynamics = Dynamics.from_chain(dataclasses.replace(chain, bodies=tuple(bodies)))
        return fit_torque(dynamics, q, torque, rig=rig, band=10.0, **options)

    right, other, plain = fitted(1.0), fitted(100.0), fitted(1.0, prior=False)
    assert right.prior.spread == 0.3
    assert other.prior is None
    assert plain.prior is None
    off = [np.linalg.norm(fit.f - arm.f) for fit in (right, plain)]
    assert off[0] < 0.1 * off[1]


# -- what an identification is used for ------------------------------------------------------------
def test_a_torque_fit_goes_where_an_identification_goes():
    arm, rig = puma560.literature_arm(1.5), puma560.rig()
    drive = dataclasses.replace(rig.drive, viscous=None, coulomb=None)
    record = simulate(arm, rig, puma560.p_law(), puma560.reference())
    fit = fit_torque(
        arm.dynamics, dataclasses.replace(record, rig=dataclasses.replace(rig, drive=drive))
    )
    again = replay(fit.arm, record, rig=fit.rig)
    assert np.sqrt(np.mean((again.error_pulses - record.error_pulses) ** 2)) < 1.0
    boxes = [((-0.6, 0.6), (-0.6, 0.6), (-0.3, 0.3))] * 2
    near = nearest_physical(fit, boxes, points=3)
    for q in np.random.default_rng(0).uniform(-2, 2, (20, 2)):
        np.testing.assert_allclose(near.arm.D(q), arm.D(q), atol=0.1 * arm.D(q).max())
    law = ComputedTorque(fit)
    truth = ComputedTorque(arm, rig, bandwidth=law.bandwidth)
    assert law.rig == fit.rig
    runs = [simulate(arm, rig, one, puma560.reference(), duration=1.0) for one in (law, truth)]
    peaks = [np.abs(run.error_pulses).max() for run in runs]
    assert peaks[0] <= peaks[1] + 1

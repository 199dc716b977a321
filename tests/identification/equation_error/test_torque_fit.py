"""Least squares on logged torques: filters against theory, known truths found again, and honest
standard deviations.
"""

import dataclasses

import numpy as np
import pytest
from coupled_arm import PERIOD, arm_of, path_of, rig_of

from identification import fit_torque
from identification.equation_error import (
    Filtering,
    Places,
    System,
    derivatives,
    least_squares,
    low_pass,
    regressor_and_torque,
    torque_fit,
)
from plant import FrictionCurve, puma560, simulate

FRICTION = ("drive.viscous[0]", "drive.coulomb[1]", "drive.coulomb[2]", "drive.curve.offset[2]")


def experiment(seconds=8.0):
    """Exact positions and torques of a coupled planar arm with friction; its dynamics, rig and
    f.
    """
    curve = FrictionCurve(offset=(0.01, -0.02, 0.015), breakaway=(0, 0, 0), speed=(1, 1, 1))
    rig = rig_of(coulomb=(0.1, 0.08, 0.05), current_limit=(20.0,) * 3, curve=curve)
    arm = arm_of(rig)
    motion = path_of(4.0)(np.arange(0, seconds, PERIOD))
    torque = np.array(
        [arm.inverse(*state) for state in zip(*motion, strict=True)]
    ) + rig.drive.friction(motion.qd)
    return arm.dynamics, rig, arm.f, motion, torque


@pytest.fixture(scope="module")
def made():
    return experiment()


# -- filters -------------------------------------------------------------------------------------
@pytest.mark.parametrize("frequency", [5.0, 20.0, 60.0])
def test_low_pass_has_no_phase_and_the_gain_of_butterworth_twice(frequency):
    t = np.arange(0, 4, PERIOD)
    middle = slice(1500, 2500)
    got = low_pass(np.sin(2 * np.pi * frequency * t), PERIOD, 20.0)[middle]
    warped = np.tan(np.pi * frequency * PERIOD) / np.tan(np.pi * 20.0 * PERIOD)
    gain = 1 / (1 + warped**8)  # once forwards, once backwards
    np.testing.assert_allclose(got, gain * np.sin(2 * np.pi * frequency * t[middle]), atol=1e-9)


def test_derivatives_are_those_of_the_motion(made):
    _, rig, _, motion, _ = made
    got = derivatives(motion.q, rig.period, 50.0)
    inside = slice(200, -200)
    for found, true in zip(got, motion, strict=True):
        np.testing.assert_allclose(found[inside], true[inside], atol=2e-4 * np.abs(true).max())


# -- truths --------------------------------------------------------------------------------------
def test_known_arm_and_friction_are_found_again(made):
    """What the rig knows is taken as given (here wrong numbers in the unknown places do not
    matter).
    """
    dynamics, rig, f, motion, torque = made
    drive = dataclasses.replace(rig.drive, viscous=(7.0, 2e-3, 1e-3), coulomb=(0.1, 7.0, 7.0))
    other = dataclasses.replace(rig, drive=drive)
    unknown = (*FRICTION[2:], *dynamics.names, *FRICTION[:2])  # in any order
    found = fit_torque(
        dynamics, motion.q, torque, rig=other, cutoff=100, band=20, every=20, unknown=unknown
    )
    true = dict(zip(dynamics.names, f, strict=True)) | {
        "drive.viscous[0]": 1e-3,
        "drive.coulomb[1]": 0.08,
    }
    true |= {"drive.coulomb[2]": 0.05, "drive.curve.offset[2]": 0.015}
    assert found.names == unknown
    for name in unknown:
        assert found[name] == pytest.approx(true[name], rel=2e-3, abs=2e-3 * 9.81)
    assert found.relative_error < 2e-3
    assert found.rows == 3 * 395  # 8 s, without 50 ms at both ends, every 20 ms


def test_known_numbers_may_have_short_names(made):
    dynamics, rig, f, motion, torque = made
    short, long = (
        fit_torque(
            dynamics, motion.q, torque, rig=rig, cutoff=100, band=20, every=20, known={name: f[1]}
        )
        for name in (dynamics.short_names[1], dynamics.names[1])
    )
    assert dynamics.short_names[1] != dynamics.names[1]
    assert short.known == long.known == {dynamics.names[1]: f[1]}
    np.testing.assert_array_equal(short.values, long.values)


def test_extra_columns_are_found_too(made):
    dynamics, rig, f, motion, torque = made
    last = np.array([0, 0, 1.0])
    found = fit_torque(
        dynamics, motion.q, torque + 3.0 * motion.qd * last, rig=rig, cutoff=100, band=20, every=20,
        extra={"bearing": lambda q, qd, qdd: qd * last},
    )  # fmt: skip
    assert found["bearing"] == pytest.approx(3.0, rel=2e-3)
    np.testing.assert_allclose(found.values[:-1], f, atol=2e-3 * np.abs(f).max())


def test_slow_rows_are_left_out_joint_by_joint(made):
    dynamics, rig, _, motion, torque = made
    limit = np.array([0.3, 0.0, 0.5])
    found = fit_torque(
        dynamics, motion.q, torque, rig=rig, cutoff=100, band=20, every=20, least_speed=limit
    )
    speed = np.abs(low_pass(derivatives(motion.q, PERIOD, 100).qd, PERIOD, 20))[60:-50:20]
    assert found.rows == (speed > limit).sum()
    # With the true signs gone wrong below the limit, the fit does not notice; without the limit it
    # does.
    wrong = torque - 2 * rig.drive.friction(motion.qd) * (np.abs(motion.qd) < 0.05)
    bad = fit_torque(dynamics, motion.q, wrong, rig=rig, cutoff=100, band=20, every=20)
    good = fit_torque(
        dynamics, motion.q, wrong, rig=rig, cutoff=100, band=20, every=20, least_speed=0.3
    )
    assert good.relative_error < 0.2 * bad.relative_error


@pytest.mark.slow
def test_intervals_hold_where_the_torque_error_lasts(made):
    """An error of the torque that stays for a tenth of the log, as of a warm motor: noise alone
    says too little.
    """
    dynamics, rig, _, motion, torque = made
    random, held, by_noise = np.random.default_rng(1), [], []
    clean = fit_torque(dynamics, motion.q, torque, rig=rig, cutoff=100, band=20, every=25).values
    for _ in range(40):
        lasting = np.repeat(random.normal(size=(10, 3)), -(-len(torque) // 10), axis=0)[
            : len(torque)
        ]
        fit = fit_torque(
            dynamics, motion.q, torque + 5 * lasting, rig=rig, cutoff=100, band=20, every=25
        )
        off = np.abs(fit.values - clean)
        held.append(off < 1.96 * fit.std)
        by_noise.append(off < 1.96 * np.sqrt(np.diag(fit.noise_covariance)))
    assert np.mean(held) > 0.93
    assert np.mean(by_noise) < 0.8


def test_segments_without_an_equation_are_no_groups(monkeypatch):
    """They would count as groups that agree with all others, and narrow the intervals."""
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=2.0
    )
    gap = (record.t > 0.5) & (record.t < 1.2)
    groups = []
    monkeypatch.setattr(
        torque_fit,
        "group_std",
        lambda columns, remaining, blocks: groups.append(blocks) or np.ones(columns.shape[1]),
    )
    fit_torque(
        puma560.dynamics(),
        dataclasses.replace(record, valid=np.where(gap, 0.0, 1.0)),
        cutoff=50,
        band=20,
    )
    for blocks in groups:
        assert np.unique(blocks).tolist() == list(range(blocks.max() + 1))
    assert groups


@pytest.mark.parametrize("heard", [(0,), (0, 1), (0, 2), (1, 2)])
def test_a_log_without_an_equation_is_no_run(heard):
    """It would count as one that agrees with all others, and narrow their intervals."""
    random = np.random.default_rng(4)
    systems = []
    for log in range(3):
        rows = np.ones((200, 1, 1))
        torque = 5 + log + random.normal(size=(200, 1))
        used = np.full(torque.shape, log in heard)
        systems.append(
            System(
                regressor=rows,
                torque=torque,
                used=used,
                sample=np.arange(200),
                period=0.1,
                speed=torque,
            )
        )
    dynamics, names, seconds = puma560.dynamics(), ("f1",), np.full(3, 20.0)
    fit = torque_fit.weighted(dynamics, names, systems, seconds=seconds)
    alone = [systems[log] for log in heard]
    expected = torque_fit.weighted(dynamics, names, alone, seconds=seconds[: len(alone)])
    if expected.between is None:
        assert fit.between is None
        return
    np.testing.assert_allclose(fit.covariance, expected.covariance)
    np.testing.assert_allclose(fit.between.values[list(heard)], expected.between.values)
    assert np.isnan(fit.between.std).sum() == 1


@pytest.mark.slow
def test_standard_deviations_are_those_of_repeated_experiments(made):
    """White torque noise, ten times as large on joint 1: the scatter of 40 fits is what each of
    them says.
    """
    dynamics, rig, _, motion, torque = made
    random, noise = np.random.default_rng(0), np.array([30.0, 3.0, 3.0])
    fits = [
        fit_torque(
            dynamics,
            motion.q,
            torque + noise * random.normal(size=torque.shape),
            rig=rig,
            cutoff=100,
            band=20,
            every=25,
        )
        for _ in range(40)
    ]
    said = np.median([np.sqrt(np.diag(fit.noise_covariance)) for fit in fits], axis=0)
    scatter = np.std([fit.values for fit in fits], axis=0)
    assert (np.abs(np.log(scatter / said)) < np.log(1.4)).all()
    wider = np.median([fit.std for fit in fits], axis=0) / said
    assert (wider >= 1).all()
    assert np.median(wider) < 1.5
    sigma = np.median([fit.sigma for fit in fits], axis=0)
    np.testing.assert_allclose(sigma[0] / sigma[1:], 10, rtol=0.1)


@pytest.mark.slow
def test_scatter_is_that_of_the_noise_however_few_the_equations(made):
    """33 equations for 11 numbers: what the fit takes up of the noise is given back."""
    dynamics, rig, _, motion, torque = made
    random = np.random.default_rng(2)
    logs = [torque + random.normal(size=torque.shape) for _ in range(60)]
    fits = [
        fit_torque(dynamics, motion.q, log, rig=rig, cutoff=100, band=20, every=700) for log in logs
    ]
    assert fits[0].rows == 33
    noise = low_pass(random.normal(size=(50_000, 1)), PERIOD, 20).std()
    np.testing.assert_allclose(np.sqrt(np.mean([fit.sigma**2 for fit in fits])), noise, rtol=0.06)


def test_gram_schmidt_solves_what_numpy_solves():
    random = np.random.default_rng(1)
    rows, target = (
        random.normal(size=(300, 7)) * 10.0 ** random.uniform(-6, 6, 7),
        random.normal(size=300),
    )
    rows[:, 3] += 1e4 * rows[:, 2]
    values, covariance, _ = least_squares(tuple("abcdefg"), rows, target)
    expected = np.linalg.lstsq(rows / np.linalg.norm(rows, axis=0), target, rcond=None)[0]
    np.testing.assert_allclose(values * np.linalg.norm(rows, axis=0), expected, rtol=1e-9)
    scaled = rows / np.linalg.norm(rows, axis=0)
    expected = np.linalg.inv(scaled.T @ scaled) / np.outer(*2 * [np.linalg.norm(rows, axis=0)])
    np.testing.assert_allclose(covariance, expected, rtol=1e-6)


def test_fit_prints_a_table_and_offers_the_nearest_name(made):
    dynamics, rig, _, motion, torque = made
    found = fit_torque(dynamics, motion.q, torque, rig=rig, cutoff=100, band=20, every=20)
    lines = str(found).splitlines()
    assert "relative torque error 0." in lines[0]
    assert [line.split()[0] for line in lines[1 : dynamics.p + 1]] == list(dynamics.short_names)
    # Deviations are words: they begin below each other.
    assert len({line.index("+-") for line in lines[1 : dynamics.p + 1]}) == 1
    told, legend = " ".join(lines[dynamics.p + 1 :]).split(), dynamics.legend.split()
    assert told[-len(legend) :] == legend
    assert " ".join(told[: -len(legend)]).startswith("intervals by blocks of one log")
    with pytest.raises(ValueError, match="Did you mean 'my1'"):
        found["mz1"]


def test_every_equation_knows_its_record_joint_and_row():
    """A target that encodes where it stands, of two logs with equations left out, comes out in
    the same order.
    """
    random = np.random.default_rng(3)
    systems = []
    for record, (many, period) in enumerate([(7, 0.5), (4, 0.25)]):
        sample = 3 + 4 * record + 2 * np.arange(many)
        torque = 1000.0 * record + 100.0 * np.arange(3) + sample[:, None]
        used = random.random(torque.shape) < 0.6
        rows = np.zeros((*torque.shape, 1))
        systems.append(
            System(
                regressor=rows, torque=torque, used=used, sample=sample, period=period, speed=torque
            )
        )
    places = Places.of(systems)
    targets = np.concatenate([each.torque[each.used] for each in systems])
    np.testing.assert_array_equal(
        1000 * places.record + 100 * places.joint + places.sample, targets
    )
    np.testing.assert_array_equal(places.t, places.sample * np.where(places.record == 0, 0.5, 0.25))


def test_rows_of_a_system_are_those_of_its_log(made):
    dynamics, rig, _, motion, torque = made
    filtering = Filtering(100, 20, 7, np.zeros(3))
    system = regressor_and_torque(dynamics, motion.q, torque, rig, filtering, dynamics.names, {})
    given = rig.drive.friction(derivatives(motion.q, PERIOD, 100).qd)
    np.testing.assert_allclose(
        system.torque, low_pass(torque - given, PERIOD, 20)[system.sample], atol=1e-12
    )


# -- bad input -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"cutoff": 600.0}, r"cutoff must be below half of the sample rate, 500 Hz; got 600"),
        ({"band": -1.0}, "band must be a positive number"),
        ({"band": 0}, "band must be a positive number"),
        ({"band": 200}, "band must not exceed cutoff"),
        ({"least_speed": -1}, "least_speed must not be negative"),
        ({"unknown": "drive.viscous[0]"}, "must be a sequence of names"),
        ({"every": 2.5}, "every must be a whole number"),
        ({"every": 2000}, "needs more equations"),
        ({"unknown": ("my1",)}, "must name all of f"),
        ({"unknown": None, "rig": puma560.rig()}, "rig must have 3 joints"),
        ({"extra": {"x": lambda q, qd, qdd: qd[:5]}}, "x must have shape"),
        ({"extra": {"x": lambda q, qd, qdd: 0 * qd}}, "x does not in this motion"),
        (
            {"extra": {"x": lambda q, qd, qdd: qd, "y": lambda q, qd, qdd: 2 * qd}},
            "y is a combination of x",
        ),
        ({"least_speed": (1.0, 2.0)}, "least_speed"),
        ({"bnad": 20}, "Did you mean 'band'"),
        ({"torque": np.zeros((5, 3))}, "torque must have shape"),
    ],
)
def test_bad_input_is_refused(made, change, says):
    dynamics, rig, _, motion, torque = made
    given = {
        "dynamics": dynamics,
        "q": motion.q,
        "torque": torque,
        "rig": rig,
        "cutoff": 100,
        "band": 20,
        "every": 20,
    }
    with pytest.raises(ValueError, match=says):
        fit_torque(**(given | change))


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("drive.gear[0]", "linearly"),
        ("drive.viscus[0]", "Did you mean 'drive.viscous"),
        ("drive.motor_gain[0]", "must act on the torque"),
    ],
)
def test_unknowns_are_linear_numbers_of_the_drive(made, name, says):
    dynamics, rig, _, motion, torque = made
    with pytest.raises(ValueError, match=says):
        fit_torque(
            dynamics,
            motion.q,
            torque,
            rig=rig,
            cutoff=100,
            band=20,
            every=20,
            unknown=(*dynamics.names, name),
        )


def test_short_log_is_refused(made):
    dynamics, rig, _, motion, torque = made
    with pytest.raises(ValueError, match="more than 24 samples"):
        fit_torque(dynamics, motion.q[:20], torque[:20], rig=rig, cutoff=100, band=20)


def test_an_f_that_is_not_among_the_unknowns_is_named():
    dynamics = puma560.dynamics()
    names = [name for name in dynamics.names if name != dynamics.names[3]]
    rows = np.zeros((100, 2))
    with pytest.raises(ValueError, match=f"{dynamics.names[3]} is missing"):
        fit_torque(dynamics, rows, rows, rig=puma560.rig(), unknown=names)


def test_a_fit_with_a_prior_says_so():
    record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    fit = fit_torque(puma560.dynamics(), record, prior=(puma560.arm().f, 0.3))
    assert "f has a prior of spread 0.3" in str(fit)

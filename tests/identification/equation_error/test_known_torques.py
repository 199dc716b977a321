"""Springs and injected torques in the torque equation and in identification: known they cost
nothing, linear ones are found, and what is left out is said.
"""

import dataclasses

import numpy as np
import pytest
from closed_loops import without_friction
from mujoco_springs import p_loop

from identification import fit_torque, identify
from identification.equation_error import linear
from identification.preparation import prepare
from identification.search import start_of_fit
from plant import CosineTorque, Counterbalance, Harmonics, JointSpring, puma560, simulate

ARM, RIG, PATH, LAW = (
    puma560.literature_arm(1.5),
    puma560.rig(),
    puma560.reference(),
    puma560.p_law(),
)
DYNAMICS = ARM.dynamics
WIDTH = np.ptp(np.array(puma560.dynamics().ranges), axis=1)
SPRING = JointSpring(stiffness=(60.0, 25.0), angle=(0.2, -0.4), preload=(0.0, 0.0))
STIFFNESS = "springs.stiffness[0]", "springs.stiffness[1]"
SPRUNG = dataclasses.replace(RIG, springs=SPRING)


def pushes(t):
    return np.column_stack([25 * np.sin(2 * np.pi * 3.1 * t), 12 * np.cos(2 * np.pi * 5.3 * t)])


def relative(found):
    """Errors of f, in the widths of the printed ranges."""
    return np.abs(found.f - ARM.f) / WIDTH


def rms(found):
    return np.sqrt(np.mean(relative(found) ** 2))


@pytest.fixture(scope="module")
def plain():
    """From another engine, without springs, and what is found of it."""
    return identify(DYNAMICS, p_loop(ARM, LAW), method="prediction_error", progress=False)


@pytest.fixture(scope="module")
def sprung():
    return p_loop(ARM, LAW, SPRING)


# -- the torque equation -------------------------------------------------------------------------
SMOOTH = without_friction(RIG, viscous=True)
RICH = Harmonics(  # of one frequency alone, a spring is an inertia
    period=3.65,
    offset=(-0.5, 0.3),
    cosine=((0.5, 0.2, -0.1), (0.3, -0.4, 0.1)),
    sine=((0.1, 0.0, 0.1), (0.2, 0.1, 0.1)),
)


def exact():
    """A motion, and the torque that its motors need against springs whose torque is typed here."""
    motion = RICH(np.arange(0, 3.65, RIG.period))
    torque = [ARM.inverse(*state) for state in zip(*motion, strict=True)]
    given = -np.array([60.0, 25.0]) * (motion.q - np.array([0.2, -0.4]))
    return motion.q, np.array(torque) + SMOOTH.drive.friction(motion.qd) - given


def with_springs(springs, rig=SMOOTH):
    return dataclasses.replace(rig, springs=springs)


def test_linear_numbers_of_springs_are_found_with_f():
    q, torque = exact()
    unknown = (*DYNAMICS.names, *STIFFNESS, "springs.preload[1]")
    other = dataclasses.replace(SPRING, stiffness=(1.0, 2.0), preload=(0.0, 3.0))
    options = {"cutoff": 100, "band": 20, "every": 20}
    found = fit_torque(DYNAMICS, q, torque, rig=with_springs(other), unknown=unknown, **options)
    # A filter at 20 Hz takes 1e-4 of a motion below 1 Hz; f of which the path shows little is
    # worse.
    np.testing.assert_allclose([found[name] for name in STIFFNESS], SPRING.stiffness, rtol=2e-3)
    assert abs(found["springs.preload[1]"]) < 0.05  # [N m], of 20
    known = fit_torque(DYNAMICS, q, torque, rig=with_springs(SPRING), **options)
    left = fit_torque(DYNAMICS, q, torque, rig=SMOOTH, **options)
    # 1e-3 measured: the filters at the ends of a motion that is not at rest there
    assert known.relative_error < 3e-3
    assert left.relative_error > 0.01
    assert (np.abs(known.values - ARM.f) / WIDTH).max() < 0.01
    assert (np.abs(left.values - ARM.f) / WIDTH).max() > 1


def test_numbers_that_are_not_linear_are_refused_and_left_out_where_a_search_follows():
    q, torque = exact()
    options = {"cutoff": 100, "band": 20, "every": 20, "rig": SPRUNG}
    with pytest.raises(ValueError, match=r"springs.stiffness\[0\] does not, or not with others"):
        fit_torque(
            DYNAMICS,
            q,
            torque,
            unknown=(*DYNAMICS.names, STIFFNESS[0], "springs.angle[0]"),
            **options,
        )
    with pytest.raises(
        ValueError,
        match=r"names of f, friction and springs.* Did you mean 'springs.stiffness\[0\]'",
    ):
        fit_torque(DYNAMICS, q, torque, unknown=(*DYNAMICS.names, "springs.stifness[0]"), **options)
    coil = Counterbalance(
        stiffness=(4e3, 1e3),
        base_arm=(0.3, 0.2),
        link_arm=(0.1, 0.1),
        free_length=(0.1, 0.1),
        angle=(1.0, 0.0),
        tension=(0.0, 5.0),
    )
    rig = dataclasses.replace(
        RIG, springs=(coil, CosineTorque(amplitude=(3.0, 2.0), phase=(0.0, 1.0)))
    )
    own = [name for name in rig.number_names() if name.startswith("springs")]
    known = ("springs[0].stiffness", "springs[0].tension", "springs[1].amplitude")
    assert linear(DYNAMICS, rig, own) == tuple(name for name in own if name.startswith(known))
    assert linear(DYNAMICS, rig, ("springs[1].phase[0]", "springs[1].phase[1]")) == ()
    of_drive = ("drive.gear[0]", "drive.coulomb[1]", *DYNAMICS.names)
    assert linear(DYNAMICS, rig, of_drive) == of_drive[1:]
    assert linear(DYNAMICS, SPRUNG, ("springs.angle[0]", "springs.stiffness[0]")) == (
        "springs.angle[0]",
    )


# -- identification, on another engine's arm -----------------------------------------------------
@pytest.mark.slow
def test_a_known_spring_costs_nothing(plain, sprung):
    known = identify(
        DYNAMICS, dataclasses.replace(sprung, rig=SPRUNG), method="prediction_error", progress=False
    )
    # One log each: their errors scatter by a factor of 2 (tests/benchmarks/known_torques.py has
    # many).
    assert rms(known) < 3 * rms(plain)
    assert known.fit.rms_innovation < 1.1 * plain.fit.rms_innovation
    left = identify(DYNAMICS, sprung, method="prediction_error", progress=False)
    assert relative(left).max() > 10 * relative(known).max()
    assert left.objective > 3 * known.objective
    assert "warning" in left.summary()
    assert "warning" not in known.summary()


@pytest.mark.slow
def test_stiffness_and_angle_are_found_with_f_by_every_method_that_may(sprung):
    start = JointSpring(stiffness=(40.0, 40.0), angle=(0.0, -0.4))
    record = dataclasses.replace(sprung, rig=dataclasses.replace(RIG, springs=start))
    unknown = (*DYNAMICS.names, *STIFFNESS, "springs.angle[0]")
    found = identify(DYNAMICS, record, unknown=unknown, method="prediction_error", progress=False)
    off = np.abs(found.rig.springs.stiffness - SPRING.stiffness)
    assert (off < 3 * found.fit.std[[9, 10]]).all()
    assert (found.fit.std[[9, 10]] < (30, 2)).all()  # that of joint 2 is like gravity on this path
    assert abs(found.rig.springs.angle[0] - SPRING.angle[0]) < 3 * found.fit.std[11]
    assert 3 * np.sqrt(found.fit.noise_covariance[11, 11]) < 1.0
    placed = dataclasses.replace(
        record, rig=with_springs(dataclasses.replace(start, angle=SPRING.angle), RIG)
    )
    found = identify(
        DYNAMICS, placed, unknown=unknown[:-1], method="equation_error", progress=False
    )
    np.testing.assert_allclose(found.rig.springs.stiffness, SPRING.stiffness, atol=5.0)


@pytest.mark.slow
def test_an_injected_torque_that_is_known_costs_nothing(plain):
    t = RIG.period * np.arange(5215)
    record = p_loop(ARM, LAW, injected=pushes(t))
    records = {"known": record, "left out": dataclasses.replace(record, injected=None)}
    found = {
        name: identify(DYNAMICS, each, method="prediction_error", progress=False)
        for name, each in records.items()
    }
    assert rms(found["known"]) < 3 * rms(plain)
    assert relative(found["left out"]).max() > 3 * relative(found["known"]).max()
    assert found["left out"].objective > 3 * found["known"].objective


def test_a_search_keeps_stiffness_positive_and_moves_an_angle_that_is_zero():
    record = simulate(ARM, SPRUNG, LAW, PATH, duration=0.3)
    record = dataclasses.replace(
        record, rig=with_springs(dataclasses.replace(SPRING, angle=(0.0, -0.4)), RIG)
    )
    unknown = (*DYNAMICS.names, *STIFFNESS, "springs.angle[0]", "springs.preload[0]")
    options = {"steps_per_sample": 4, "sweeps": 3, "threads": 1}
    problem = prepare(
        DYNAMICS, record, unknown, None, "prediction_error", None, None, 0, False, options
    )
    low = dict(zip(unknown, problem.bounds[:, 0], strict=True))
    assert low[STIFFNESS[0]] == low[STIFFNESS[1]] == 0.0
    assert np.isinf(low["springs.angle[0]"])
    fit = fit_torque(
        DYNAMICS,
        *exact(),
        rig=with_springs(dataclasses.replace(SPRING, angle=(0.0, -0.4))),
        cutoff=100,
        band=20,
        every=20,
        unknown=(*DYNAMICS.names, *STIFFNESS),
    )
    values, step = start_of_fit(problem, fit)
    place = unknown.index("springs.angle[0]")
    assert values[place] == 0.0
    assert step[place] > 0
    candidates = np.array([[*ARM.f, 60.0, 25.0, 0.2, 0.0], [*ARM.f, -1.0, 25.0, 0.2, 0.0]])
    costs = problem.objective(candidates)
    assert np.isfinite(costs[0])
    assert costs[1] == np.inf

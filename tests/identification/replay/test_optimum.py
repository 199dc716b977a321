"""Least squares of an extended model: directions, bounds, and what is left beside the unknowns."""

import importlib
from types import SimpleNamespace

import numpy as np
import pytest

from identification.equation_error import PriorRows, along, directions
from identification.replay import Extended, Prediction, fitted, gauss_newton, optimum
from identification.results import NUMBERS
from plant import Harmonics, puma560, read_robot, simulate

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
ARM = puma560.literature_arm(1.5)


def test_orthonormal_directions_make_the_target():
    """As numpy's least squares; a combination of others gets no coefficient and no direction."""
    rng = np.random.default_rng(0)
    rates, target = rng.normal(size=(4, 50)), rng.normal(size=50)
    made = directions(rates)
    np.testing.assert_allclose(made @ rates @ (made @ rates).T, np.eye(4), atol=1e-12)
    expected = np.linalg.lstsq(rates.T, target, rcond=None)[0]
    np.testing.assert_allclose(along(made, rates, target), expected, rtol=1e-9)
    more = np.vstack([rates, rates[0] + rates[1]])
    made = directions(more)
    assert len(made) == 4
    assert along(made, more, target)[4] == 0


def test_a_vector_that_diverges_is_not_the_nearest():
    rows = {0.0: np.full(3, np.nan), 1.0: np.full(3, 2.0), 2.0: np.ones(3)}
    model = SimpleNamespace(all_innovations=lambda vectors: [rows[float(x[0])] for x in vectors])
    np.testing.assert_array_equal(optimum.nearest(model, np.array([[0.0], [1.0], [2.0]])), [2.0])


@pytest.fixture(scope="module")
def model():
    record = simulate(ARM, RIG, puma560.p_law((0.1, 0.08)), PATH, steps_per_sample=16)
    return Extended(DYNAMICS, [record], DYNAMICS.names, ARM.f, NUMBERS)


def parts(model):
    extra = np.zeros(len(model.extra))
    values = np.concatenate([1.02 * ARM.f, model.gains, extra])
    step = np.concatenate([np.full(9, 1e-3), model.gain_steps, extra])
    free = np.full((9, 2), (-np.inf, np.inf))
    bounds = np.vstack(
        [free, model.gain_bounds, np.column_stack([model.least, np.full(len(extra), np.inf)])]
    )
    return values, step, bounds


@pytest.fixture(scope="module")
def at(model):
    return fitted(model, *parts(model))


def test_the_optimum_is_that_of_gauss_newton_on_the_rigid_prediction(model, at):
    prediction = Prediction(DYNAMICS, model.records, DYNAMICS.names)
    values, step, bounds = parts(model)
    solution = gauss_newton(prediction, values[:13], step[:13], bounds[:13], tolerance=1e-6)
    assert at.squares == pytest.approx(float(solution.residual @ solution.residual), rel=1e-4)
    assert (
        np.abs(at.values[:9] - solution.values[:9])
        < 0.1 * np.sqrt(np.diag(solution.covariance))[:9]
    ).all()


def test_what_is_left_is_orthogonal_to_the_rates(at):
    left = at.left(at.innovations)
    lengths = np.sqrt((at.rates**2).sum(axis=1)) * np.sqrt((left**2).sum())
    assert (np.abs((at.rates * left).sum(axis=1)) < 1e-9 * lengths).all()
    assert at.unknown == 9
    assert at.chi_square(left) == 0


def test_values_stay_within_their_bounds(model):
    """f1 held 5 % too high: the others make up for it, at a larger sum of squares."""
    values, step, bounds = parts(model)
    bounds[0, 0] = 1.05 * ARM.f[0]
    held = fitted(model, values, step, bounds)
    assert held.values[0] == bounds[0, 0]
    assert held.squares > fitted(model, *parts(model)).squares


def test_directions_are_made_once_per_round(model, monkeypatch):
    """As often as the rates themselves, while no value is at its bound."""
    made = []
    for module, name in (
        (importlib.import_module("identification.replay.gauss_newton"), "slopes"),
        (optimum, "directions"),
    ):
        function = getattr(module, name)
        monkeypatch.setattr(
            module,
            name,
            lambda *given, _of=(name, function): made.append(_of[0]) or _of[1](*given),
        )
    fitted(model, *parts(model))
    assert made.count("directions") == made.count("slopes") > 1


def test_a_model_that_does_not_follow_is_refused(model):
    values, step, bounds = parts(model)
    values[0] = -100.0
    with pytest.raises(ValueError, match="must follow the log"):
        fitted(model, values, step, bounds)


def test_what_does_not_give_is_the_rigid_loop():
    """Also where joints turn back at coarse sub-steps: stiff springs would stick otherwise
    there, by a whole pulse.
    """
    robot = read_robot("ur5e")
    offset, sine = (0, -1.2, 1.0, -0.5, 0.8, 0), ((0.3,), (0.2,), (0.3,), (0.2,), (0.3,), (0.4,))
    path = Harmonics(period=2.0, offset=offset, cosine=((0.2,),) * 6, sine=sine)
    arm = robot.dynamics.arm(robot.dynamics.f())
    record = simulate(arm, robot.rig, robot.law, path)
    model = Extended(arm.dynamics, [record], arm.dynamics.names, arm.f, NUMBERS)
    prediction = Prediction(arm.dynamics, record)
    extra = np.zeros(len(model.extra))
    plain = model.innovations(np.concatenate([arm.f, model.gains, extra]))
    np.testing.assert_allclose(
        plain, prediction.innovations(np.append(arm.f, model.gains)), atol=1e-3
    )
    extra[model.extra.index("compliance[0]")] = 60.0**-2
    given = [np.concatenate([arm.f, model.gains, each]) for each in (extra, 0 * extra, extra)]
    first, second, third = model.all_innovations(given)
    np.testing.assert_array_equal(second, plain)
    np.testing.assert_array_equal(first, third)
    assert np.abs(first - plain).max() > 0.1


RATES = np.random.default_rng(0).normal(size=(3, 200))
TRUTH = np.array((1.0, -2.0, 0.5))


def linear():
    """Innovations of values that are off, and nothing else."""
    names = ("f1", "f2", "gain")
    every = lambda many: [(np.asarray(each) - TRUTH) @ RATES for each in many]  # noqa: E731
    return SimpleNamespace(
        unknown=names,
        extra=(),
        gains=np.zeros(1),
        weights=np.ones(200),
        scales=np.ones(200),
        prior=PriorRows(None, names),
        all_innovations=every,
        innovations=lambda values: every([values])[0],
    )


def test_what_is_at_its_bound_takes_over_nothing_beyond_it():
    bounds, step = np.array([(-9.0, 9.0), (-9.0, 9.0), (0.0, 0.2)]), np.full(3, 0.01)
    at = fitted(linear(), np.zeros(3), step, bounds)
    best = np.linalg.lstsq(
        RATES[:2].T, (TRUTH[2] - 0.2) * RATES[2] + TRUTH[:2] @ RATES[:2], rcond=None
    )[0]
    np.testing.assert_allclose(at.values, [*best, 0.2], rtol=1e-6)
    np.testing.assert_allclose(at.before, at.innovations, atol=1e-9)
    free = fitted(linear(), np.zeros(3), step, np.array([(-9.0, 9.0)] * 3))
    np.testing.assert_allclose(free.values, TRUTH, rtol=1e-6)
    np.testing.assert_allclose(free.left(RATES[2]), 0, atol=1e-9)

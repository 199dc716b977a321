"""A prior of f: its covariance from bodies, and its rows against Bayesian linear regression in
closed form.
"""

import dataclasses

import numpy as np
import pytest

from identification import identify
from identification.equation_error import Prior, PriorRows, System, weighted
from identification.replay import gauss_newton
from plant import Body, Chain, Dynamics, Link, Placement, Rig, puma560, simulate
from plant.checkup import in_step
from plant.mechanics import from_pseudo_inertia, prior_factor, symmetric_basis

SPREAD = 0.3
BODY = Body(mass=4.0, com=(0.2, 0.05, -0.1), inertia=(0.05, 0.004, -0.002, 0.06, 0.001, 0.04))


def pendulum(body=BODY, frame=None):
    """One link that turns about its z axis, with a rotor; f is mx, my, and Izz with the rotor."""
    link = Link(name="1") if frame is None else Link(name="1", frame=frame)
    chain = Chain(
        links=(link,), gravity=(0.0, -9.81, 0.0), bodies=(dataclasses.replace(body, rotor=0.5),)
    )
    return Dynamics.from_chain(chain)


def rig():
    """A rig of one joint."""
    two = puma560.rig()
    drive = two.drive.filled({})
    one = {
        name: getattr(drive, name)[:1]
        for name in ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
    }
    return Rig(
        drive=type(drive)(**one),
        encoder=dataclasses.replace(two.encoder, resolution=two.encoder.resolution[:1]),
        period=two.period,
    )


def prior_of(name):
    return Prior(names=(name,), mean=np.ones(1), covariance=np.eye(1), spread=0.3)


def test_spread_of_a_body_in_closed_form():
    """Every quadratic form of the pseudo-inertia has the relative spread; a rotor likewise, and
    apart.
    """
    dynamics = pendulum()
    std = dict(
        zip(
            dynamics.names,
            np.sqrt(np.diag(Prior.of(dynamics, rig(), SPREAD).covariance)),
            strict=True,
        )
    )
    m, (x, y, _), (xx, *_, yy, _, zz) = BODY.mass, BODY.com, BODY.inertia[[0, 1, 2, 3, 4, 5]]
    about = {"mx": (yy + zz - xx) / 2 + m * x * x, "my": (xx + zz - yy) / 2 + m * y * y}
    for name, first in (("mx", m * x), ("my", m * y)):
        (own,) = [value for each, value in std.items() if each.startswith(name)]
        assert own == pytest.approx(SPREAD * np.sqrt((m * about[name] + first**2) / 2))
    # Izz is the sum of two second moments: (a + b)^2 - 2 (a b - c^2)
    cross = -BODY.inertia[1] + m * x * y
    squares = sum(about.values()) ** 2 - 2 * (about["mx"] * about["my"] - cross**2)
    (own,) = [value for each, value in std.items() if "Izz" in each]
    assert own == pytest.approx(SPREAD * np.sqrt(squares + 0.5**2))


def test_spread_does_not_depend_on_frames():
    """The same body, given in a frame that is turned and moved, has the same covariance of f."""
    angle = 0.7
    turned = Placement(
        rotation=((np.cos(angle), 0, np.sin(angle)), (0, 1, 0), (-np.sin(angle), 0, np.cos(angle))),
        position=(0.3, -0.2, 0.1),
    )  # fmt: skip
    seen = BODY.seen_from(turned)
    one, other = pendulum(BODY, turned), pendulum(seen)
    assert one.f() == pytest.approx(other.f())
    first, second = (Prior.of(dynamics, rig(), SPREAD).covariance for dynamics in (one, other))
    assert first == pytest.approx(second)


def test_covariance_is_that_of_drawn_bodies():
    dynamics, draw = pendulum(), np.random.default_rng(0)
    factor, drawn = prior_factor(BODY.standard_parameters), []
    for _ in range(4000):
        S = np.tensordot(draw.normal(size=10), symmetric_basis(4), 1)
        pi = from_pseudo_inertia(factor @ (np.eye(4) + 0.02 * S) @ factor.T)
        body = dataclasses.replace(
            Body.from_standard_parameters(pi), rotor=0.5 * (1 + 0.02 * draw.normal())
        )
        drawn.append(dynamics.f((body,)))
    prior = Prior.of(dynamics, rig(), 0.02)
    assert np.cov(np.array(drawn).T) == pytest.approx(
        prior.covariance, rel=0.1, abs=0.05 * np.diag(prior.covariance).min()
    )
    whitened = np.array([prior.deviations(f) for f in drawn])
    assert np.cov(whitened.T) == pytest.approx(np.eye(3), abs=0.1)


def posterior(rows, target, sigma, prior):
    """Mean and covariance of f by Bayes' rule."""
    information = rows.T @ rows / sigma**2 + np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(information)
    return (
        covariance @ (rows.T @ target / sigma**2 + np.linalg.solve(prior.covariance, prior.mean)),
        covariance,
    )


@pytest.fixture
def problem():
    """A prior of the pendulum, rows that do not show Izz, and torques with noise of 0.2."""
    dynamics, draw = pendulum(), np.random.default_rng(1)
    prior = Prior.of(dynamics, rig(), SPREAD)
    rows = draw.normal(size=(400, 3))
    rows[:, next(i for i, name in enumerate(dynamics.names) if "Izz" in name)] = 0.0
    return dynamics, prior, rows, rows @ (1.2 * prior.mean) + 0.2 * draw.normal(size=400)


@pytest.mark.parametrize("weights", [None, 0.01, 1.0, 100.0])
def test_torque_equation_is_bayesian_regression(problem, weights):
    """Stated weights are known up to a factor, which must not weigh the prior."""
    dynamics, prior, rows, target = problem
    system = System(
        regressor=rows[:, None],
        torque=target[:, None],
        used=np.ones((400, 1), bool),
        sample=np.arange(400),
        period=1.0,
        speed=np.ones((400, 1)),
    )
    stated = None if weights is None else np.full((1, 1), weights)
    further = prior.rows(dynamics.names, {})
    fit = weighted(dynamics, dynamics.names, [system], stated, prior=further)
    mean, covariance = posterior(rows, target, fit.sigma[0], prior)
    assert fit.sigma[0] == pytest.approx(0.2, rel=0.1)
    assert fit.values == pytest.approx(mean, rel=1e-4)
    assert fit.covariance == pytest.approx(covariance, rel=1e-4, abs=1e-9)
    idle = next(i for i, name in enumerate(dynamics.names) if "Izz" in name)
    assert fit.std[idle] <= np.sqrt(prior.covariance[idle, idle])


def test_known_parameters_condition_the_prior(problem):
    """What is known moves the means of what is correlated with it."""
    _, prior, _, _ = problem
    rows, target = prior.rows(prior.names[1:], {prior.names[0]: 0.5})
    C, off = prior.covariance, 0.5 - prior.mean[0]
    found = np.linalg.lstsq(rows, target)[0]
    assert found == pytest.approx(prior.mean[1:] + C[1:, 0] / C[0, 0] * off)
    assert np.linalg.inv(rows.T @ rows) == pytest.approx(
        C[1:, 1:] - np.outer(C[1:, 0], C[0, 1:]) / C[0, 0]
    )


class Linear:
    """A prediction whose innovations are linear in f, as `gauss_newton` takes it."""

    def __init__(self, prior, rows, target, sigma):
        self.unknown, self.prior, self._rows, self._target = (
            prior.names,
            PriorRows(prior, prior.names),
            rows,
            target,
        )
        self.prior.settle(sigma**2)
        self.weights = np.append(np.zeros(self.prior.count), np.ones(len(target)))
        self.scales, self.dependent = np.ones(len(self.weights)), self.prior.own(1e-4)

    def innovations(self, values):
        return np.append(self.prior.of(values), self._rows @ values - self._target)

    def all_innovations(self, many):
        return [self.innovations(values) for values in many]


def test_gauss_newton_is_bayesian_regression(problem):
    """Its covariance is scaled by the noise that it finds, of innovations and prior together."""
    _, prior, rows, target = problem
    bounds = np.tile([-np.inf, np.inf], (3, 1))
    found = gauss_newton(Linear(prior, rows, target, 0.2), prior.mean, 0.1 * np.ones(3), bounds)
    mean, covariance = posterior(rows, target, 0.2, prior)
    assert found.values == pytest.approx(mean, rel=1e-6)
    scale = found.covariance[0, 0] / covariance[0, 0]
    assert 0.8 < scale < 1.5
    assert found.covariance == pytest.approx(scale * covariance, rel=1e-6, abs=1e-12)


def test_a_log_without_noise_weighs_no_prior():
    prior = PriorRows(prior_of("a"), ("a",))
    assert [prior.settle(variance) for variance in (0.0, 0.0, 1.0, 1.01)] == [
        True,
        False,
        True,
        False,
    ]


def test_parameters_that_the_prior_alone_tells_apart(problem):
    """Two columns that are one: their sum comes from the log, their difference from the prior."""
    _, prior, rows, target = problem
    rows = np.column_stack([rows[:, 0], rows[:, 0], rows[:, 1]])
    bounds = np.tile([-np.inf, np.inf], (3, 1))
    found = gauss_newton(Linear(prior, rows, target, 1e-4), prior.mean, 0.01 * np.ones(3), bounds)
    assert found.values == pytest.approx(posterior(rows, target, 1e-4, prior)[0], rel=1e-5)


def test_joints_in_step():
    t = np.linspace(0, 6, 500)
    speeds = np.column_stack([np.sin(t), np.cos(3 * t), -2 * np.sin(t), np.zeros(500)])
    assert in_step(speeds) == [(0, 2)]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (0.0, "spread of the prior must be a positive number; got 0"),
        (float("nan"), "spread of the prior must be a positive number; got nan"),
        (-0.3, "spread of the prior must be a positive number"),
        ("0.3", "spread of the prior must be a positive number; got '0.3'"),
        (0.3, "prior needs bodies; the chain has none"),
        ((np.ones(8), 0.3), r"f of the prior must have shape \(9,\); got shape \(8,\)"),
        ((np.full(9, np.nan), 0.3), "f of the prior must be finite"),
        (
            (np.append(np.ones(8), 0.0), 0.3),
            "prior must spread every parameter; f9 has no spread of its own",
        ),
        (((BODY,), 0.3), "bodies must be 2, one Body per link; got 1"),
        ((BODY, BODY), "spread of the prior must be a positive number"),
        (prior_of("f1"), r"prior must be of the f of .* got f1\b"),
    ],
)
def test_refusals(given, said):
    record = simulate(
        puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5
    )
    with pytest.raises(ValueError, match=said) as refusal:
        identify(puma560.dynamics(), record, prior=given, progress=False)
    assert "\n" not in str(refusal.value)

"""The distribution of a mass: against numerical integration, and what is refused."""

import numpy as np
import pytest
from scipy.integrate import quad

from identification.payload import LoadShape, information, judged, posterior
from plant import Body, puma560


def shape(position=(0.0, -0.4, 0.0), mass=(0, 5), **line):
    options = {"along": None, "reach": (0.2, 0.5), "inertia": (0,) * 6} | line
    return LoadShape.of(puma560.arm(), mass, position, **options)


@pytest.mark.parametrize(
    ("centre", "sigma"), [(2.0, 0.1), (0.05, 0.1), (4.99, 0.2), (-0.2, 0.1), (5.5, 0.2)]
)
def test_a_bounded_mass(centre, sigma):
    """Mean, spread and interval of a normal distribution cut at 0 and 5 kg, by quadrature."""
    weight = 1 / sigma**2
    got = posterior(
        shape(), np.array([[weight]]), np.array([centre * weight]), centre**2 * weight + 400.0, 400
    )

    def density(m):
        return np.exp(
            -(((m - centre) / sigma) ** 2) / 2
            + (((np.clip(centre, 0, 5) - centre) / sigma) ** 2) / 2
        )

    points = {"points": [np.clip(centre, 0.001, 4.999)], "limit": 200}
    total = quad(density, 0, 5, **points)[0]
    mean = quad(lambda m: m * density(m), 0, 5, **points)[0] / total
    variance = quad(lambda m: (m - mean) ** 2 * density(m), 0, 5, **points)[0] / total
    assert got.mass == pytest.approx(mean, abs=2e-4)
    assert got.std == pytest.approx(np.sqrt(variance), rel=0.01)
    inside = quad(density, *got.interval, limit=200)[0] / total
    assert inside == pytest.approx(0.95, abs=0.02)
    assert got.misfit == pytest.approx(1.0)


def test_what_is_uncertain_is_estimated_along():
    """Marginal least squares: the same as the joint one with the prior as further rows."""
    random = np.random.default_rng(2)
    load, uncertain, torque = (
        random.normal(size=(50, 2)),
        random.normal(size=(50, 3)),
        random.normal(size=50),
    )
    matrix, vector, _ = information(load, uncertain, torque)
    joint = np.vstack([np.hstack([load, uncertain]), np.hstack([np.zeros((3, 2)), np.eye(3)])])
    solution = np.linalg.lstsq(joint, np.append(torque, np.zeros(3)), rcond=None)[0]
    np.testing.assert_allclose(np.linalg.solve(matrix, vector), solution[:2], rtol=1e-10)
    np.testing.assert_allclose(
        np.linalg.inv(matrix), np.linalg.inv(joint.T @ joint)[:2, :2], rtol=1e-9
    )
    alone, _, square = information(load, np.zeros((50, 0)), torque)
    np.testing.assert_allclose(alone, load.T @ load)
    assert square == pytest.approx(torque @ torque)


def test_too_little_says_so():
    assert "rests" in posterior(shape(), np.zeros((1, 1)), np.zeros(1), 0.0, 0).message
    weak = posterior(shape(), np.array([[1.0]]), np.array([2.0]), 4.0, 100)
    assert not weak.sufficient
    assert "too little" in weak.message
    foreign = posterior(shape(), np.array([[100.0]]), np.array([200.0]), 400.0 + 900.0, 100)
    assert not foreign.sufficient
    assert "no load explains" in foreign.message
    heavy = posterior(shape(), np.array([[100.0]]), np.array([800.0]), 6400.0, 100)
    assert heavy.sufficient
    assert heavy.mass <= 5
    assert "outside" in heavy.message
    grams = posterior(shape(mass=(0, 0.01)), np.full((1, 1), 4e6), np.array([5.8e4]), 841.0, 100)
    assert "0.0145 kg of 0 to 0.01" in grams.message
    assert posterior(shape(), np.array([[100.0]]), np.array([-300.0]), 900.0, 100).mass >= 0


@pytest.mark.parametrize("weight", [1e-300, 1e-20, 1e-17, 1e-14, 1e-10])
def test_a_window_that_says_next_to_nothing_leaves_the_prior(weight):
    """Rounding leaves a resting arm some information, of a deviation far above the range."""
    got = posterior(shape(), np.array([[weight]]), np.array([2 * weight]), 4 * weight, 100)
    assert not got.sufficient
    assert got.mass == pytest.approx(2.5, rel=1e-4)
    assert got.std == pytest.approx(5 / np.sqrt(12), rel=1e-4)


@pytest.mark.parametrize("spoilt", [0, 1, 2])
@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_window_with_a_number_that_is_none_is_not_used(spoilt, number):
    statistics = [np.full((1, 1), 100.0), np.full(1, 200.0), np.array(400.0)]
    statistics[spoilt] = statistics[spoilt] * number
    got = posterior(shape(), *statistics, 100)
    assert not got.sufficient
    assert "NaN" in got.message
    assert got.mass == 2.5
    assert not judged(shape(), True, 1.0, np.nan)[1]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"mass": (5, 0)}, "range"),
        ({"mass": (-1, 5)}, "range"),
        ({"position": None, "reach": (0.5, 0.2)}, "reach must be a shorter"),
        ({"position": None, "reach": (-0.5, -0.2)}, "reach must be .* 0 or more"),
        ({"position": None, "along": (0, 0, 0)}, "length of along"),
        ({"along": (0, 1, 0)}, "both"),
        ({"inertia": (1.0, 0, 0, 0.1, 0, 0.1)}, "^body of the load must .*triangle"),
        ({"position": (0, 1)}, "position"),
    ],
)
def test_bad_shapes_are_refused(options, said):
    with pytest.raises(ValueError, match=said):
        shape(**options)


def test_the_line_is_the_axis_of_the_last_link():
    line = shape(position=None)
    np.testing.assert_allclose(line.places[[0, -1]], [[0, -0.2, 0], [0, -0.5, 0]])
    np.testing.assert_allclose(line.shares @ line.basis, line.per_kg, atol=1e-12)


@pytest.mark.parametrize("joints", [[0, 1], [1]])
@pytest.mark.parametrize("noise", [1e-2, 1e-4])
def test_an_exact_window_resolves_a_centre_along_a_line(joints, noise):
    """Resting, joint 2 feels mass times distance alone, and both joints feel the distance, too."""
    random = np.random.default_rng(3)
    arm, line = puma560.arm(), shape(position=None)
    poses = random.uniform(-2, 2, (100, 2))
    columns = arm.dynamics.load_matrix()
    rows = np.vstack([arm.dynamics.Y(q, (0, 0), (0, 0)).full()[joints] @ columns for q in poses])
    inside = []
    for mass, distance in random.uniform((0.4, 0.25), (1.2, 0.45), (40, 2)):
        load = Body(mass=mass, com=(0, -distance, 0)).standard_parameters
        torque = rows @ load / noise + random.normal(size=len(rows))
        statistics = information(rows @ line.basis.T / noise, np.zeros((len(rows), 0)), torque)
        got = posterior(line, *statistics, len(rows))
        assert got.sufficient
        inside.append(got.interval[0] <= mass <= got.interval[1])
    assert np.mean(inside) >= 0.85

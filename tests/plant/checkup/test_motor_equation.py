"""The equation of motion of a motor, against a least squares of scipy with bounds."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from plant.checkup import Equation, Motion


@pytest.mark.parametrize("seed", range(20))
def test_coefficients_are_the_best_that_are_not_negative(seed):
    """Columns that resemble each other, so that several of them want to be negative."""
    rng = np.random.default_rng(seed)
    rows = 400
    common = rng.standard_normal((rows, 1))
    own = common + rng.uniform(0.1, 1.0) * rng.standard_normal((rows, 3))
    free = rng.standard_normal((rows, 2))
    torque = own @ rng.uniform(-2.0, 2.0, 3) + free @ rng.uniform(-1.0, 1.0, 2)
    torque = torque + 0.1 * rng.standard_normal(rows)
    torque = torque - torque.mean()
    motion = Motion.of(Equation(own, free, torque), rows, 1, closed=False)
    least = np.r_[np.zeros(3), np.full(2, -np.inf)]
    best = lsq_linear(np.c_[own, free], torque, bounds=(least, np.inf), tol=1e-12)
    values = [motion.inertia, motion.viscous, motion.coulomb]
    np.testing.assert_allclose(values, best.x[:3], atol=1e-6)
    np.testing.assert_allclose(motion.coupling, best.x[3:4], atol=1e-6)

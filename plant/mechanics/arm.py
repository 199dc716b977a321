"""An arm: equations of motion with a value of their inertial parameters f."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from plant.parts import Floats, Part, Vector, array, number, part, structure


@part
class Arm(Part):
    """Equations of motion of a robot arm with numbers: `Dynamics` and its inertial parameters f.

    Parameters
    ----------
    dynamics : Dynamics
    f : (p,) array_like
        Inertial parameters, in the order of ``dynamics.names``.

    Notes
    -----
    Arguments q, qd, qdd, tau are (n,), joint side, SI; results are numpy arrays.

    See Also
    --------
    plant.Dynamics, plant.Rig, identification.identify

    Examples
    --------
    >>> from plant import puma560
    >>> arm = puma560.arm()
    >>> arm.D((0, 0)).round(2)
    array([[6.09, 1.1 ],
           [1.1 , 1.68]])
    >>> tau = arm.inverse((0, 0.5), (1, 0), (0, 2))
    >>> arm.forward((0, 0.5), (1, 0), tau).round(6)
    array([0., 2.])
    """

    dynamics: Any = structure()
    f: Vector = number(("p",))

    def __post_init__(self) -> None:
        # Before the check of all parts, which knows the number of parameters only by this array.
        names = self.dynamics.short_names
        if np.shape(self.f) != (len(names),):
            raise ValueError(
                f"f has shape {np.shape(self.f)}; this arm has {len(names)} parameters"
                f" ({names[0]}..{names[-1]}). Pass found.arm.f, or dynamics.f(bodies)."
            )
        super().__post_init__()

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.dynamics.n

    def D(self, q: ArrayLike) -> Floats:
        """Inertia matrix (n, n) [kg m^2], the D of `Dynamics` with this f."""
        return self.dynamics.D(q, self.f).full()

    def h(self, q: ArrayLike, qd: ArrayLike) -> Floats:
        """Coriolis, centrifugal and gravity torque (n,) [N m], the h of `Dynamics` with this f."""
        return self.dynamics.h(q, qd, self.f).full().ravel()

    def inverse(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Floats:
        """Inverse dynamics tau = Y(q, qd, qdd) f: torque (n,) [N m] without friction."""
        return (self.dynamics.Y(q, qd, qdd).full() @ self.f).ravel()

    def forward(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike) -> Floats:
        """Forward dynamics: acceleration (n,) [rad/s^2] without friction; D(q) must be positive."""
        # D(q) of a poor estimate of f may be singular: no acceleration is right then.
        tau = array("tau", tau, (self.n,), advice="One torque per joint [N m, of slides N].")
        self.require_positive(q)
        # qdd = D^-1 (tau - h). A solve, not the inverse of D, which would lose digits.
        return np.asarray(np.linalg.solve(self.D(q), tau - self.h(q, qd)), dtype=float)

    def require_positive(self, q: ArrayLike, least: ArrayLike = 0.0) -> None:
        """Refuse an arm whose D(q) - diag(least) [kg m^2] is not positive definite."""
        smallest = np.linalg.eigvalsh(self.D(q) - np.diag(np.broadcast_to(least, self.n)))[0]
        # Written with `not`, so that an eigenvalue that is not a number is refused too.
        if not smallest > 0:
            raise ValueError(
                f"D must be positive definite; its smallest eigenvalue is {smallest:.3g} at q ="
                f" {np.asarray(q)}. Correct f: no links have such an inertia."
            )

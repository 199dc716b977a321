"""An arm: equations of motion together with one vector f of numbers."""

from __future__ import annotations

import numpy as np

from plant.parts.arguments import array
from plant.parts.part import Part, number, part, structure

__all__ = ["Arm"]


@part
class Arm(Part):
    """`Dynamics` + f.

    Parameters
    ----------
    dynamics : Dynamics
    f : (p,) array_like
        Inertial parameters, in the order of ``dynamics.names``.

    Notes
    -----
    Arguments q, qd, qdd, tau are (n,), joint side, SI; results are numpy arrays.
    """

    dynamics: Part = structure()
    f: np.ndarray = number(("p",))

    def __post_init__(self):
        names = self.dynamics.names
        if np.shape(self.f) != (len(names),):
            raise ValueError(
                f"f has shape {np.shape(self.f)}; this arm has {len(names)} parameters ({names[0]}..{names[-1]}). "
                "Pass found.arm.f, or dynamics.f(bodies)."
            )
        super().__post_init__()

    @property
    def n(self):
        """Number of joints."""
        return self.dynamics.n

    def D(self, q):
        """Inertia matrix (n, n) [kg m^2], the D of `Dynamics` with this f."""
        return self.dynamics.D(q, self.f).full()

    def h(self, q, qd):
        """Coriolis, centrifugal and gravity torque (n,) [N m], the h of `Dynamics` with this f."""
        return self.dynamics.h(q, qd, self.f).full().ravel()

    def inverse(self, q, qd, qdd):
        """Torque (n,) [N m] for a motion: tau = Y(q, qd, qdd) f, without friction."""
        return (self.dynamics.Y(q, qd, qdd).full() @ self.f).ravel()

    def forward(self, q, qd, tau):
        """Acceleration (n,) [rad/s^2] under a torque, without friction.

        Raises
        ------
        ValueError
            D is not positive definite at q.
        """
        tau = array("tau", tau, (self.n,), advice="One torque per joint [N m].")
        self.require_positive(q)
        return np.linalg.solve(self.D(q), tau - self.h(q, qd))

    def require_positive(self, q, least=0.0):
        """Refuse an arm whose D(q) - diag(least) is not positive definite."""
        smallest = np.linalg.eigvalsh(self.D(q) - np.diag(np.broadcast_to(least, self.n)))[0]
        if not smallest > 0:
            raise ValueError(
                f"D must be positive definite; its smallest eigenvalue is {smallest:.3g} at q = {np.asarray(q)}. "
                "Correct f: no links have such an inertia."
            )

"""Inverse dynamics of a serial chain by Lagrange's equations, from nothing but the energies: the
tests' second opinion.

No Newton-Euler recursion, no angular velocity and no cross product occurs here. A link is the set
of its mass elements: with A_i(q) the homogeneous transform from its frame to the base, an element
at rho has the velocity Adot_i (rho, 1), hence

    kinetic energy    T = sum_i  1/2 trace(Adot_i P_i Adot_i')  +  1/2 J_i qd_i^2
    potential energy  V = -sum_i  m_i g . A_i (c_i, 1)
    tau = d/dt dT/dqd - dT/dq + dV/dq

P_i, the integral of (rho, 1)(rho, 1)' dm, follows from mass, centre of mass and the inertia matrix
about it. Both derivatives lose no digits: T is quadratic in qd, so a central difference of any
width is exact, and T and V are analytic in q, so the imaginary part of a step of 1e-30 i is the
slope to rounding.
"""

from typing import NamedTuple

import numpy as np

# rows and columns of Ixx, Ixy, Ixz, Iyy, Iyz, Izz
_ENTRIES = tuple(zip(*np.triu_indices(3), strict=True))
_STEP = 1e-30  # of the imaginary step; its square must vanish beside 1


class Row(NamedTuple):
    """One row of a table of modified DH parameters (Craig), revolute joint.

    Attributes
    ----------
    alpha, a : float
        Twist [rad] and length [m] from axis i-1 to axis i.
    d : float
        Offset along axis i [m].
    theta : float
        Joint angle at q = 0 [rad].
    """

    alpha: float
    a: float
    d: float
    theta: float = 0.0


class Mass(NamedTuple):
    """What one link weighs.

    Attributes
    ----------
    mass : float
        [kg].
    com : tuple of 3 floats
        Centre of mass in the link's frame [m].
    inertia : tuple of 6 floats
        Ixx, Ixy, Ixz, Iyy, Iyz, Izz: entries of the inertia matrix about the centre of mass, axes
        of the link's frame [kg m^2].
    rotor : float
        Motor inertia reflected to the joint [kg m^2].
    """

    mass: float
    com: tuple
    inertia: tuple
    rotor: float = 0.0


def _moments(body):
    """P (4, 4), the integral of (rho, 1)(rho, 1)' dm; about the centre of mass, rho rho' gives
    tr(I)/2 - I.
    """
    ixx, ixy, ixz, iyy, iyz, izz = body.inertia
    inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    com = np.append(body.com, 1.0)
    moments = body.mass * np.outer(com, com)
    moments[:3, :3] += np.eye(3) * np.trace(inertia) / 2 - inertia
    return moments


class Lagrange(NamedTuple):
    """A chain with its bodies, ready to evaluate; made by `lagrange`.

    Attributes
    ----------
    rows : tuple of Row
    bodies : tuple of Mass
    gravity : tuple of 3 floats
        Gravity's acceleration in the base frame [m/s^2].
    """

    rows: tuple
    bodies: tuple
    gravity: tuple

    def _frames(self, q, qd):
        """(A_i, Adot_i) of each link, by the product rule; q and qd may be complex."""
        frame, rate = np.eye(4), np.zeros((4, 4))
        for row, angle, speed in zip(self.rows, q, qd, strict=True):
            c, s = np.cos(angle + row.theta), np.sin(angle + row.theta)
            ca, sa = np.cos(row.alpha), np.sin(row.alpha)
            step = np.array(  # Craig's (3.6)
                [
                    [c, -s, 0, row.a],
                    [s * ca, c * ca, -sa, -sa * row.d],
                    [s * sa, c * sa, ca, ca * row.d],
                    [0, 0, 0, 1],
                ]
            )
            turn = speed * np.array(
                [[-s, -c, 0, 0], [c * ca, -s * ca, 0, 0], [c * sa, -s * sa, 0, 0], [0, 0, 0, 0]]
            )
            frame, rate = frame @ step, rate @ step + frame @ turn
            yield frame, rate

    def kinetic(self, q, qd):
        """Kinetic energy T [J], motor inertias included."""
        links = zip(self.bodies, qd, self._frames(q, qd), strict=True)
        return sum(
            np.trace(rate @ _moments(b) @ rate.T) / 2 + b.rotor * v**2 / 2
            for b, v, (_, rate) in links
        )

    def potential(self, q):
        """Potential energy V [J] in the field of gravity."""
        links = zip(self.bodies, self._frames(q, np.zeros(len(q))), strict=True)
        return -sum(
            b.mass * np.dot(self.gravity, (frame @ [*b.com, 1.0])[:3]) for b, (frame, _) in links
        )

    def tau(self, q, qd, qdd):
        """Joint torques, (n,) [N m], of the motion q [rad], qd [rad/s], qdd [rad/s^2], each
        (n,).
        """
        q, qd, qdd = (np.asarray(x, float) for x in (q, qd, qdd))
        along = 1j * _STEP

        def torque(unit):
            def momentum(q, qd):
                return (self.kinetic(q, qd + unit) - self.kinetic(q, qd - unit)) / 2

            shifted = q + along * unit
            lagrangian = self.kinetic(shifted, qd) - self.potential(shifted)
            return (momentum(q + along * qd, qd + along * qdd) - lagrangian).imag / _STEP

        return np.array([torque(unit) for unit in np.eye(len(q))])

    def h(self, q, qd):
        """Coriolis, centrifugal and gravity torques, (n,) [N m]."""
        return self.tau(q, qd, np.zeros(len(self.rows)))

    def D(self, q):
        """Inertia matrix, (n, n) [kg m^2]: dT/dqd for unit velocities, T being quadratic."""
        units = np.eye(len(self.rows))
        return np.array(
            [[(self.kinetic(q, u + v) - self.kinetic(q, u - v)) / 2 for u in units] for v in units]
        )

    def Y(self, q, qd, qdd):
        """Regressor, (n, 11 n), of the standard parameters m, mx, my, mz, Ixx, .., Izz (about the
        frame's origin), J.

        The energies are linear in them, so a column is the torque of a body whose only parameter is
        a 1: a point at the origin for m, the difference of two bodies for the first moments.
        """
        origin, none, columns = (0.0, 0.0, 0.0), (0.0,) * 6, []
        rest = Mass(0.0, origin, none)

        def torque(link, body):
            bodies = tuple(body if i == link else rest for i in range(len(self.rows)))
            return self._replace(bodies=bodies).tau(q, qd, qdd)

        for link in range(len(self.rows)):
            columns.append(torque(link, Mass(1.0, origin, none)))
            for axis in range(3):
                # Unit mass at a unit distance; the negative inertia about its centre takes away
                # what it has about the origin, and subtracting the mass column leaves the first
                # moment.
                com = tuple(float(axis == j) for j in range(3))
                about_centre = tuple(com[j] * com[k] - (j == k) for j, k in _ENTRIES)
                columns.append(torque(link, Mass(1.0, com, about_centre)) - columns[11 * link])
            columns += [torque(link, Mass(0.0, origin, tuple(row))) for row in np.eye(6)]
            columns.append(torque(link, Mass(0.0, origin, none, 1.0)))
        return np.column_stack(columns)


def lagrange(chain_rows, bodies, gravity):
    """The dynamics of a serial chain of revolute joints by Lagrange's equations.

    Parameters
    ----------
    chain_rows : iterable of (alpha, a, d) or (alpha, a, d, theta)
        Modified DH parameters (Craig), base to tip [rad, m, m, rad].
    bodies : iterable of (mass, com, inertia) or (mass, com, inertia, rotor)
        See `Mass` for meaning and units.
    gravity : sequence of 3 floats
        Gravity's acceleration in the base frame [m/s^2]; (0, 0, -9.81) with z up.

    Returns
    -------
    Lagrange
        With the functions D(q), h(q, qd), tau(q, qd, qdd), Y(q, qd, qdd), kinetic(q, qd) and
        potential(q).
    """
    rows = tuple(Row(*row) for row in chain_rows)
    masses = tuple(Mass(*body) for body in bodies)
    if len(rows) != len(masses):
        raise ValueError(
            f"{len(masses)} bodies given; the chain has {len(rows)} rows. Pass one body per row."
        )
    return Lagrange(rows, masses, tuple(float(g) for g in gravity))

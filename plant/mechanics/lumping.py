"""Lumping f = B pi: the identifiable combinations f of the links' standard parameters pi.

The torque is linear in the *standard parameters* pi of the links (11 each), of which only some
combinations f = B pi are identifiable, and tau = Y f. B is written once, as an expression in
masses, centres of mass and inertias (for the paper's arm: equation (3)), and made a matrix here. A
row of B belongs to the inertial torque, to the gravity torque, or to both: the paper's f3 = m3 x3
a3 is inertial and its f5 = m3 x3 gravitational, although on a physical arm f3 = a3 f5.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from plant.mechanics.body import Body
from plant.parts import Floats, Nested, Part, part, structure

if TYPE_CHECKING:
    from plant.mechanics.chain import Chain
    from plant.mechanics.link import Link


# Names of one link's standard parameters: mass [kg], first moments [kg m], inertia about the
# frame's *origin* [kg m^2], and the rotor inertia reflected to the joint, J [kg m^2].
STANDARD = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "J")

LOAD = STANDARD[:-1]  # those of a load, a body fixed to a link

_PHYSICAL = ("m", "x", "y", "z", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "J")


def parameter_name(kind: str, link: Link) -> str:
    """Name of a link's parameter: "m3", or "m_elbow" where links have names instead of numbers."""
    return f"{kind}{link.name}" if link.name[:1].isdigit() else f"{kind}_{link.name}"


def standard_parameters(bodies: Iterable[Body]) -> Floats:
    """Standard parameters (11 n,) of bodies, rotor inertias included."""
    return np.concatenate([[*body.standard_parameters, body.rotor] for body in bodies])


@part
class Lumping(Part):
    """Matrix B of f = B pi, and the torques that each f enters.

    Parameters
    ----------
    names : tuple of str
        One per f.
    matrix : (p, 11 n) nested tuple
        B, for the standard parameters in the order of `STANDARD`, link by link.
    inertial, gravitational : tuple of bool
        Whether each f enters the inertial torque (D and the Coriolis terms), and the gravity
        torque.

    See Also
    --------
    plant.Dynamics, plant.Chain

    Examples
    --------
    >>> from plant import puma560
    >>> lumping = puma560.dynamics().lumping
    >>> lumping.names[:3], lumping.gravity_section().shape
    (('f1', 'f2', 'f3'), (22, 9))
    """

    names: tuple[str, ...] = structure()
    matrix: Nested = structure()
    inertial: tuple[bool, ...] = structure()
    gravitational: tuple[bool, ...] = structure()

    def __repr__(self) -> str:
        return f"Lumping({len(self.names)} of {len(self.matrix[0])} standard parameters)"

    def __post_init__(self) -> None:
        # One column per standard parameter of each link.
        matrix = np.asarray(self.matrix, float)
        p = len(self.names)
        shaped = matrix.ndim == 2 and matrix.shape[0] == p and matrix.shape[1] % len(STANDARD) == 0
        if not shaped or not np.isfinite(matrix).all():
            raise ValueError(
                f"matrix must be finite, ({p}, 11 n); got shape {matrix.shape}. Give one row per"
                " name."
            )
        for field in ("inertial", "gravitational"):
            flags = getattr(self, field)
            if len(flags) != p:
                raise ValueError(
                    f"{field} must have {p} flags; got {len(flags)}. Give one per name."
                )
            object.__setattr__(self, field, tuple(bool(flag) for flag in flags))
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "matrix", tuple(tuple(row) for row in matrix.tolist()))

    @classmethod
    def standard(cls, chain: Chain) -> Lumping:
        """No lumping: f is the standard parameters themselves."""
        names = tuple(parameter_name(name, link) for link in chain.links for name in STANDARD)
        everywhere = (True,) * len(names)
        return cls(
            names=names, matrix=np.eye(len(names)), inertial=everywhere, gravitational=everywhere
        )

    @classmethod
    def from_equation(
        cls,
        equation: Callable[..., dict[str, Any]],
        links: int,
        *,
        inertial: Collection[str],
        gravitational: Collection[str],
    ) -> Lumping:
        """Read B off an equation for f in physical parameters.

        Parameters
        ----------
        equation : callable
            Takes one object per link with attributes m, x, y, z [m, in the link's frame], Ixx..Izz
            (about the centre of mass) and J (reflected rotor inertia); returns a dictionary name ->
            expression, linear in the standard parameters.
        links : int
        inertial, gravitational : collection of str
            Names that enter the inertial torque, and the gravity torque.
        """
        # One symbol for every physical parameter, so that the equation can be differentiated.
        symbols = [{name: ca.SX.sym(f"{name}{i}") for name in _PHYSICAL} for i in range(links)]
        f = equation(*(SimpleNamespace(**link) for link in symbols))
        physical = ca.vertcat(*(symbol for link in symbols for symbol in link.values()))
        expression = ca.vertcat(*f.values())
        values = ca.Function("f", [physical], [expression])
        slope = ca.Function("B", [physical], [ca.jacobian(expression, physical)])
        # For unit masses at the origin, physical and standard parameters change alike, so the slope
        # there is B.
        matrix = slope([1.0 if name == "m" else 0.0 for name in _PHYSICAL] * links).full()
        # A linear equation equals its matrix at any bodies. One random set of bodies reveals one
        # that is not linear.
        trial = np.random.default_rng(0).uniform(0.5, 1.5, (links, len(_PHYSICAL)))
        bodies = [Body(mass=v[0], com=v[1:4], inertia=v[4:10], rotor=v[10]) for v in trial]
        lumped = values(trial.ravel()).full().ravel()
        if not np.allclose(matrix @ standard_parameters(bodies), lumped, rtol=1e-12):
            raise ValueError(
                "equation must be linear in masses, first moments and inertias; it is not."
                " Correct it."
            )
        return cls(
            names=tuple(f),
            matrix=matrix,
            inertial=tuple(name in inertial for name in f),
            gravitational=tuple(name in gravitational for name in f),
        )

    def inertial_section(self) -> Floats:
        """Standard parameters (11 n, p) of links with the inertial torque of each f."""
        return self._section(self.inertial)

    def gravity_section(self) -> Floats:
        """Standard parameters (11 n, p) of links with the gravity torque of each f."""
        return self._section(self.gravitational)

    def _section(self, rows: tuple[bool, ...]) -> Floats:
        """Right inverse S of these rows of B (B S = 1), sparse: pivoted QR selects its rows."""
        # 0.1 s, which no log needs; its choice among equal columns is in all results
        from scipy.linalg import qr

        matrix = np.array(self.matrix)
        section = np.zeros(matrix.T.shape)
        chosen = np.flatnonzero(rows)
        # An f that the other torque alone contains gets no parameters here: its column stays zero.
        if len(chosen):
            _, triangle, order = qr(matrix[chosen], mode="economic", pivoting=True)
            # Pivots of a QR decomposition fall; the last one is near zero where rows depend.
            if abs(triangle[-1, len(chosen) - 1]) < 1e-10 * abs(triangle[0, 0]):
                raise ValueError(
                    f"f must be independent; the {len(chosen)} of one torque are not. Leave some"
                    " out."
                )
            # The chosen square block is inverted; the parameters outside of it are zero.
            columns = np.sort(order[: len(chosen)])
            section[np.ix_(columns, chosen)] = np.linalg.inv(matrix[np.ix_(chosen, columns)])
        return section

"""Equations of motion D(q; f) qdd + h(q, qd; f) = tau of a serial chain, linear in f.

Source: paper eq. (2). The torque is `plant.mechanics.newton_euler`; D, h, C and Y are read off it.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from casadi import SX
from numpy.typing import ArrayLike

from plant.mechanics.arm import Arm
from plant.mechanics.base_parameters import base_lumping
from plant.mechanics.body import Body
from plant.mechanics.chain import Chain
from plant.mechanics.lumping import STANDARD, Lumping, standard_parameters
from plant.mechanics.newton_euler import by_speeds, collected, lumped_torque, torque
from plant.parts import (
    ArrayOrSymbols,
    CheckedFunction,
    Floats,
    Nested,
    Part,
    array,
    instance,
    part,
    structure,
)


@part
class Dynamics(Part):
    """Equations of motion of an arm whose inertial parameters f are open.

    Parameters
    ----------
    chain : Chain
    lumping : Lumping
        The combinations f of the links' inertial parameters. A lumping is refused if its torque
        differs from that of the chain.
    ranges : (p, 2) nested tuple, optional
        Lower and upper bound of each f: the default bounds of a search.

    Notes
    -----
    `D(q, f)` (n, n), `h(q, qd, f)` (n, 1), `C(q, qd, f)` (n, n) with h = C qd + gravity and Ddot -
    2 C skew, and `Y(q, qd, qdd)` (n, p) with tau = Y f, or `Y(q, qd, qd_r, qdd_r)` with D qdd_r + C
    qd_r + gravity = Y f. All take numpy arrays (and give casadi DM) or casadi symbols. Units of a
    prismatic joint are m and N.

    See Also
    --------
    plant.Arm, plant.Chain

    Examples
    --------
    >>> from plant import puma560
    >>> dynamics = puma560.dynamics()
    >>> dynamics.names
    ('f1', 'f2', 'f3', 'f4', 'f5', 'f6', 'f7', 'f8', 'f9')
    >>> dynamics.Y((0, 0), (0, 0), (1, 0)).shape
    (2, 9)
    """

    chain: Chain = structure(Chain)
    lumping: Lumping = structure(Lumping)
    ranges: Nested = structure(default=None)

    def __repr__(self) -> str:
        return (
            f"Dynamics({self.n} joints, {self.p} parameters"
            f" {self.short_names[0]}..{self.short_names[-1]})"
        )

    def __post_init__(self) -> None:
        width = len(STANDARD) * self.chain.n
        if len(self.lumping.matrix[0]) != width:
            raise ValueError(
                f"lumping must have {width} columns; got {len(self.lumping.matrix[0])}. Match the"
                " chain."
            )
        if self.ranges is not None:
            ranges = array(
                "ranges", self.ranges, (self.p, 2), advice="Give a low and a high end for each f."
            )
            object.__setattr__(self, "ranges", tuple(tuple(row) for row in ranges.tolist()))
        self._prove()

    @classmethod
    def from_chain(cls, chain: Chain, *, rotors: bool = True) -> "Dynamics":
        """Equations of a chain in its base parameters (`base_parameters`), rotors optional."""
        return cls(chain=chain, lumping=base_lumping(chain, rotors=rotors))

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.chain.n

    @property
    def p(self) -> int:
        """Number of parameters f."""
        return len(self.lumping.names)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of f."""
        return self.lumping.names

    @property
    def short_names(self) -> tuple[str, ...]:
        """Names of f for tables and figures: f1, f2, ... where the names are sums (`legend`)."""
        # Names of base parameters are sums; a table has room for names of six letters.
        if max(map(len, self.names)) <= 6:
            return self.names
        return tuple(f"f{i + 1}" for i in range(self.p))

    @property
    def legend(self) -> str:
        """What each short name means, one line each; empty where names are short."""
        if self.short_names == self.names:
            return ""
        width = len(self.short_names[-1])
        return "\n".join(
            f"{s:<{width}} = {name}" for s, name in zip(self.short_names, self.names, strict=True)
        )

    def f(self, bodies: Sequence[Body] | None = None) -> Floats:
        """Parameters f (p,) of an arm with these bodies, one per link; by default the chain's."""
        bodies = self.chain.bodies if bodies is None else tuple(bodies)
        if not bodies:
            raise ValueError(
                "bodies must be known to work out f; this chain has none. Give the Chain its"
                " bodies."
            )
        if len(bodies) != self.n:
            raise ValueError(
                f"bodies must be {self.n}, one per link; got {len(bodies)}. Join a tool to its"
                " link."
            )
        for body in bodies:
            instance("each of the bodies", body, Body, "Give mass, com and inertia.")
        # A body may be given in a frame of its own (`Link.frame`); f refers to the link's frame.
        pairs = zip(bodies, self.chain.links, strict=True)
        in_place = [body.seen_from(link.frame) for body, link in pairs]
        return np.array(self.lumping.matrix) @ standard_parameters(in_place)

    def load_matrix(self, link: int | str = -1) -> Floats:
        """Increments B (p, 10) of f by a load on a link: f + B ``body.standard_parameters``.

        The link is an index in the chain from 0, or a name; by default the last one.
        """
        return _load_matrix(self, link).copy()

    def arm(self, f: ArrayLike) -> Arm:
        """The arm with these f (p,)."""
        return Arm(dynamics=self, f=f)

    # -- everything below is read off one torque --------------------------------------------------
    @cached_property
    def _symbols(self) -> tuple[SX, SX, SX, SX]:
        q, qd, qdd = (SX.sym(name, self.n) for name in ("q", "qd", "qdd"))
        return q, qd, qdd, SX.sym("f", self.p)

    @cached_property
    def _equations(self) -> tuple[SX, SX, SX]:
        """D, Coriolis torque and gravity torque; with few joints collected as sums over f."""
        q, qd, qdd, f = self._symbols
        strength = float(np.linalg.norm(self.chain.gravity))
        rest = SX.zeros(self.n)
        # tau = D qdd + C qd + g. D is the slope of the inertial torque in qdd, and the Coriolis
        # torque is what remains of it at qdd = 0; gravity comes from its own recursion at rest.
        moving, at_rest = lumped_torque(self.chain, self.lumping, q, qd, qdd, f)
        D = ca.jacobian(moving, qdd)
        coriolis = ca.substitute(moving, qdd, rest)
        # Up to three joints the sums over f and over products of speeds are shorter than the
        # recursion.
        if self.n <= 3:
            D = ca.reshape(collected(D, q, f), self.n, self.n)
            coriolis = by_speeds(coriolis, q, qd, f)
            # Without the strength of gravity the coefficients are those of the geometry alone. The
            # strength is put in again afterwards.
            unit = ca.substitute(at_rest, f, f / strength) if strength else at_rest
            at_rest = ca.substitute(collected(unit, q, f), f, strength * f)
        # One triangle, mirrored: D is then symmetric to the last bit.
        return ca.tril2symm(ca.tril(D)), coriolis, at_rest

    def _function(self, name: str, inputs: Sequence[str], result: SX) -> CheckedFunction:
        symbols = dict(zip(("q", "qd", "qdd", "f"), self._symbols, strict=True))
        arguments = [symbols[symbol] for symbol in inputs]
        return CheckedFunction(ca.Function(name, arguments, [result], inputs, [name]))

    @cached_property
    def D(self) -> CheckedFunction:
        """Inertia matrix D(q, f) (n, n) [kg m^2] with rotor inertias. Source: paper eq. (2)."""
        return self._function("D", ("q", "f"), self._equations[0])

    @cached_property
    def h(self) -> CheckedFunction:
        """Coriolis and gravity torque h(q, qd, f) (n, 1) [N m]. Source: paper eq. (2)."""
        _, coriolis, gravity = self._equations
        return self._function("h", ("q", "qd", "f"), coriolis + gravity)

    @cached_property
    def coriolis(self) -> CheckedFunction:
        """Coriolis and centrifugal torque C(q, qd, f) qd (n, 1) [N m], h without gravity."""
        return self._function("coriolis", ("q", "qd", "f"), self._equations[1])

    @cached_property
    def gravity(self) -> CheckedFunction:
        """Gravity torque (q, f) -> (n, 1) [N m], h at rest. Source: paper eq. (2), last term."""
        return self._function("gravity", ("q", "f"), self._equations[2])

    @cached_property
    def C(self) -> CheckedFunction:
        """Coriolis matrix C(q, qd, f) (n, n) from the Christoffel symbols: Ddot - 2 C is skew."""
        # C_ij = sum_k c_ijk qd_k with the Christoffel symbols c_ijk = (dD_ij/dq_k + dD_ik/dq_j -
        # dD_jk/dq_i) / 2. The first term sums to Ddot / 2, the other two are skew in i and j: hence
        # Ddot - 2 C is skew.
        q, qd = self._symbols[:2]
        D = self._equations[0]
        dD = [ca.jacobian(D[:, k], q) for k in range(self.n)]  # dD[k][i, j] = dD_ik / dq_j
        rate = ca.reshape(ca.jacobian(ca.vec(D), q) @ qd, self.n, self.n)
        skewed = SX(self.n, self.n)
        for i in range(self.n):
            for j in range(self.n):
                skewed[i, j] = sum(
                    ((dD[k][i, j] - dD[k][j, i]) * qd[k] for k in range(self.n)), SX(0)
                )
        return self._function("C", ("q", "qd", "f"), (rate + skewed) / 2)

    @cached_property
    def _regressor(self) -> CheckedFunction:
        q, qd, qdd, f = self._symbols
        D, coriolis, gravity = self._equations
        # tau = Y f is linear in f, so Y is its Jacobian.
        Y = ca.jacobian(D @ qdd + coriolis + gravity, f)
        return self._function("Y", ("q", "qd", "qdd"), ca.densify(Y))

    @cached_property
    def _passive_regressor(self) -> CheckedFunction:
        q, qd, _, f = self._symbols
        qd_r = SX.sym("qd_r", self.n)
        qdd_r = SX.sym("qdd_r", self.n)
        # The arguments of passivity-based laws: the Coriolis matrix multiplies a reference speed.
        D, _, gravity = self._equations
        Y = ca.jacobian(D @ qdd_r + self.C(q, qd, f) @ qd_r + gravity, f)
        names = ["q", "qd", "qd_r", "qdd_r"]
        inputs = [q, qd, qd_r, qdd_r]
        return CheckedFunction(ca.Function("Y", inputs, [ca.densify(Y)], names, ["Y"]))

    def Y(
        self, q: ArrayOrSymbols, qd: ArrayOrSymbols, *accelerations: ArrayOrSymbols
    ) -> ArrayOrSymbols:
        """Regressor (n, p) of f: tau = Y(q, qd, qdd) f.

        With four arguments D qdd_r + C qd_r + gravity = Y(q, qd, qd_r, qdd_r) f, as in passivity-
        based laws.
        """
        regressor = self._passive_regressor if len(accelerations) == 2 else self._regressor
        return regressor(q, qd, *accelerations)

    def _prove(self) -> None:
        """Refuse a lumping whose torque is not the chain's, at random states.

        A lumping without any rotor inertia is for an arm without rotors.
        """
        random = np.random.default_rng(0)
        matrix = np.array(self.lumping.matrix)
        # Columns of the rotor inertias J, one per link.
        rotors = slice(STANDARD.index("J"), None, len(STANDARD))
        q, qd, qdd, f = self._symbols
        pi = SX.sym("pi", len(STANDARD) * self.n)
        tau = torque(self.chain, q, qd, qdd, pi, self.chain.gravity)
        chain_torque = ca.Function("tau", [q, qd, qdd, pi], [tau])
        # Both torques are linear in the parameters and smooth in the state: three random states
        # settle equality.
        for _ in range(3):
            point = [random.normal(size=self.n) for _ in range(3)]
            links = random.uniform(0.5, 1.5, len(STANDARD) * self.n)
            # Without a rotor in the lumping the chain is compared without rotors.
            links[rotors] *= matrix[:, rotors].any()
            expected = chain_torque(*point, links).full().ravel()
            lumped = self.Y(*point).full() @ (matrix @ links)
            if not np.allclose(lumped, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max()):
                raise ValueError(
                    f"lumping must describe the motion of the chain; its torque is {lumped}, the"
                    f" chain's {expected}. Correct the equation for f or the table of links."
                )


@lru_cache(maxsize=32)
def _load_matrix(dynamics: Dynamics, link: int | str) -> Floats:
    """B, from point masses at ten places whose standard parameters are independent."""
    # The empty chain has f = 0, and f is linear in the bodies: the f of a probe is its increment.
    massless = Body(mass=0.0, com=(0, 0, 0))
    empty = dataclasses.replace(dynamics.chain, bodies=(massless,) * dynamics.n)
    # The origin, six points on the axes and three between them: ten point masses whose ten
    # parameters are independent.
    places = [np.zeros(3), *np.eye(3), *-np.eye(3)]
    places += [a + b for a, b in itertools.combinations(np.eye(3), 2)]
    probes = [Body(mass=1.0, com=place) for place in places]
    increments = np.array([dynamics.f(empty.carrying(probe, link).bodies) for probe in probes])
    # increments = parameters B^T, one row per probe.
    parameters = np.array([probe.standard_parameters for probe in probes])
    matrix = np.linalg.solve(parameters, increments).T
    matrix[np.abs(matrix) < 1e-13 * np.abs(matrix).max()] = 0.0  # rounding
    return matrix

"""Base parameters: the identifiable combinations of a chain's standard parameters, found from the
regressor.

The columns of the regressor of the standard parameters are linearly dependent. Taken in an order of
preference, each column is either independent of those before it, and its parameter stays, or a
combination of them, and its parameter is regrouped into theirs: what is left, B pi, is the smallest
f with the same torque. The preference (masses, mz and Iyy last) gives the combinations of the
literature, where a link's mass joins the inertia of the link before it.

Source: M. Gautier and W. Khalil, Direct calculation of minimum set of inertial parameters of serial
robots, IEEE Transactions on Robotics and Automation 6 (1990); M. Gautier, Numerical calculation of
the base inertial parameters of robots, Journal of Robotic Systems 8 (1991).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from plant.mechanics.lumping import STANDARD, Lumping, parameter_name
from plant.mechanics.newton_euler import torque
from plant.parts.fields import Floats

if TYPE_CHECKING:
    from plant.mechanics.chain import Chain


def independent_columns(
    regressor: Floats, order: Iterable[int], tolerance: float
) -> tuple[list[int], Floats]:
    """The independent columns (r,), preferred in this order, and all columns as combinations (r,
    columns) of them.
    """
    lengths = np.linalg.norm(regressor, axis=0)
    order = [column for column in order if lengths[column] > tolerance * lengths.max()]
    kept: list[int] = []
    basis = np.empty((len(regressor), 0))
    for column in order:
        new = regressor[:, column] / lengths[column]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            new = new - basis @ (basis.T @ new)
        if np.linalg.norm(new) > tolerance:
            kept.append(column)
            basis = np.column_stack([basis, new / np.linalg.norm(new)])
    kept.sort()
    matrix = np.zeros((len(kept), regressor.shape[1]))
    combinations = np.linalg.lstsq(regressor[:, kept], regressor[:, order], rcond=None)[0]
    matrix[:, order] = np.where(np.abs(combinations) > 1e-9, combinations, 0.0)
    matrix[:, kept] = np.eye(len(kept))
    return kept, matrix


_PREFERENCE = ("J", "Izz", "mx", "my", "Ixx", "Ixy", "Ixz", "Iyz", "Iyy", "mz", "m")
_STATES = 40  # random states, each with n equations: several times as many as there are parameters

# a column (of length 1) with a smaller component outside the span of those before it depends on
# them
_TOLERANCE = 1e-8


def base_lumping(chain: Chain, *, rotors: bool = True) -> Lumping:
    """The lumping of a chain into its base parameters; without rotor inertias, J is zero.

    Names are such as ``Izz1 + Iyy2 + a2^2 m2``, where a2 and d2 are a and d of the row of link 2
    (of its `Link`); four digits stand where a coefficient is neither a product of such lengths nor
    a sum of their squares.
    """
    regressor = _regressor(chain)
    order = [
        STANDARD.index(name) + len(STANDARD) * link
        for name in _PREFERENCE
        for link in reversed(range(chain.n))
        if name != "J" or rotors
    ]
    kept, matrix = independent_columns(regressor, order, _TOLERANCE)
    everywhere = (True,) * len(kept)
    names = tuple(_name(chain, row, column) for row, column in zip(matrix, kept, strict=True))
    return Lumping(names=names, matrix=matrix, inertial=everywhere, gravitational=everywhere)


def _regressor(chain: Chain) -> Floats:
    """Regressor of the standard parameters at random states, stacked: (states n, 11 n)."""
    n = chain.n
    random = np.random.default_rng(0)
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    pi = ca.SX.sym("pi", len(STANDARD) * n)
    slope = ca.jacobian(torque(chain, q, qd, qdd, pi, chain.gravity), pi)
    function = ca.Function("Y", [q, qd, qdd], [ca.densify(slope)])
    return np.vstack([function(*random.uniform(-2, 2, (3, n))).full() for _ in range(_STATES)])


def _name(chain: Chain, row: Floats, kept: int) -> str:
    """A row of B as a sum, its own parameter first."""
    terms = []
    for column in sorted(np.flatnonzero(row), key=lambda column: (column != kept, column)):
        link, kind = divmod(column, len(STANDARD))
        coefficient = row[column]
        parameter = parameter_name(STANDARD[kind], chain.links[link])
        sign = " - " if coefficient < 0 else " + "
        factor = _factor(chain, abs(coefficient))
        terms.append(f"{sign}{factor}{' ' if factor else ''}{parameter}")
    text = "".join(terms)
    return text[3:] if text.startswith(" + ") else text[1:]


def _factor(chain: Chain, value: float) -> str:
    """A coefficient by its name: nothing for 1, a product of up to two lengths, a sum of
    squares, or a number.
    """
    if abs(value - 1) < 1e-9:
        return ""
    lengths = [
        (parameter_name(kind, link), getattr(link, kind))
        for link in chain.links
        for kind in ("a", "d")
    ]
    lengths = [(name, abs(length)) for name, length in lengths if abs(length) > 1e-9]
    products = list(lengths)
    for (name, length), (other, width) in itertools.combinations_with_replacement(lengths, 2):
        products.append((f"{name}^2" if name == other else f"{name} {other}", length * width))
    for count in (2, 3, 4):
        for some in itertools.combinations(lengths, count):
            products.append(
                (f"({' + '.join(f'{name}^2' for name, _ in some)})", sum(x**2 for _, x in some))
            )
    for count, (name, product) in itertools.product((1, 2), products):
        if abs(value - count * product) < 1e-9 * max(1, value):
            return name if count == 1 else f"2 {name}"
    return f"{value:.4g}"

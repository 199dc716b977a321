"""Base parameters: the identifiable combinations of the standard parameters of a chain.

The columns of the regressor of the standard parameters are linearly dependent. Taken in an order of
preference, each column is either independent of the preceding ones, and its parameter stays, or it
is a combination of them, and its parameter is regrouped into theirs. The rest, B pi, is the
smallest f with the same torque. The preference (masses, mz and Iyy last) gives the combinations of
the literature, where a link's mass joins the inertia of the link before it.

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
from plant.parts import Floats

if TYPE_CHECKING:
    from plant.mechanics.chain import Chain


def independent_columns(
    regressor: Floats, order: Iterable[int], tolerance: float
) -> tuple[list[int], Floats]:
    """Indices (r,) of independent columns, and the matrix (r, columns) that combines all columns.

    The order is that of preference: an earlier column stays, a later one is combined.
    """
    lengths = np.linalg.norm(regressor, axis=0)
    # A column of zeros belongs to a parameter without effect on any joint, such as the mass of a
    # first link that turns. It stays out of f.
    order = [column for column in order if lengths[column] > tolerance * lengths.max()]
    independent: list[int] = []
    basis = np.empty((len(regressor), 0))
    # Gram-Schmidt orthogonalisation in the order of preference. All columns have length 1 here, so
    # that one tolerance serves masses and inertias alike.
    for column in order:
        new = regressor[:, column] / lengths[column]
        for _ in range(2):  # twice is enough for orthogonality to rounding
            new = new - basis @ (basis.T @ new)
        if np.linalg.norm(new) > tolerance:
            independent.append(column)
            basis = np.column_stack([basis, new / np.linalg.norm(new)])
    # f follows the order of the links, not the order of preference.
    independent.sort()
    matrix = np.zeros((len(independent), regressor.shape[1]))
    # The dependent columns as combinations of the independent ones. Coefficients below 1e-9 are
    # rounding; an independent column gets its exact unit vector.
    combinations = np.linalg.lstsq(regressor[:, independent], regressor[:, order], rcond=None)[0]
    matrix[:, order] = np.where(np.abs(combinations) > 1e-9, combinations, 0.0)
    matrix[:, independent] = np.eye(len(independent))
    return independent, matrix


# The parameters to keep, the preferred kind first. Masses, mz and Iyy come last, so that they are
# regrouped into others, as in the literature.
_PREFERENCE = ("J", "Izz", "mx", "my", "Ixx", "Ixy", "Ixz", "Iyz", "Iyy", "mz", "m")
# A column of length 1 depends on the preferred ones if its component outside of their span is
# smaller: far above rounding (1e-15), far below any real coefficient.
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
    columns, matrix = independent_columns(regressor, order, _TOLERANCE)
    # The regressor holds inertial and gravity torque together, so each base parameter enters both.
    everywhere = (True,) * len(columns)
    names = tuple(_name(chain, row, column) for row, column in zip(matrix, columns, strict=True))
    return Lumping(names=names, matrix=matrix, inertial=everywhere, gravitational=everywhere)


def _regressor(chain: Chain) -> Floats:
    """Regressor of the standard parameters at random states, stacked: (states n, 11 n)."""
    n = chain.n
    # The seed is fixed: the same chain always gets the same parameters.
    random = np.random.default_rng(0)
    q, qd, qdd = (ca.SX.sym(name, n) for name in ("q", "qd", "qdd"))
    pi = ca.SX.sym("pi", len(STANDARD) * n)
    # tau = Y pi is linear in pi, so its Jacobian is the regressor and contains no pi.
    slope = ca.jacobian(torque(chain, q, qd, qdd, pi, chain.gravity), pi)
    function = ca.Function("Y", [q, qd, qdd], [ca.densify(slope)])
    # Forty states with n equations each: several times as many equations as parameters (11 n).
    return np.vstack([function(*random.uniform(-2, 2, (3, n))).full() for _ in range(40)])


def _name(chain: Chain, row: Floats, independent: int) -> str:
    """The sum that a row of B stands for; the parameter that was not regrouped comes first."""
    terms = []
    # The parameter that names the row comes first, then the rest from the base outwards.
    for column in sorted(np.flatnonzero(row), key=lambda column: (column != independent, column)):
        link, kind = divmod(column, len(STANDARD))
        coefficient = row[column]
        parameter = parameter_name(STANDARD[kind], chain.links[link])
        sign = " - " if coefficient < 0 else " + "
        factor = _factor(chain, abs(coefficient))
        terms.append(f"{sign}{factor}{' ' if factor else ''}{parameter}")
    text = "".join(terms)
    # A leading plus goes, a leading minus stays.
    return text[3:] if text.startswith(" + ") else text[1:]


def _factor(chain: Chain, value: float) -> str:
    """A coefficient as text: "" for 1, a product of lengths, a sum of squares, or a number."""
    if abs(value - 1) < 1e-9:
        return ""
    # Regrouping multiplies by offsets of the table: a and d once in first moments, twice in
    # inertias (parallel-axis theorem), and squares add up over links.
    lengths = [
        (parameter_name(kind, link), getattr(link, kind))
        for link in chain.links
        for kind in ("a", "d")
    ]
    lengths = [(name, abs(length)) for name, length in lengths if abs(length) > 1e-9]
    products = list(lengths)
    for (name, length), (factor, width) in itertools.combinations_with_replacement(lengths, 2):
        product = f"{name}^2" if name == factor else f"{name} {factor}"
        products.append((product, length * width))
    for count in (2, 3, 4):
        for terms in itertools.combinations(lengths, count):
            squares = " + ".join(f"{name}^2" for name, _ in terms)
            products.append((f"({squares})", sum(length**2 for _, length in terms)))
    # Simple products come before their doubles, so that the shortest name is found.
    for count, (name, product) in itertools.product((1, 2), products):
        if abs(value - count * product) < 1e-9 * max(1, value):
            return name if count == 1 else f"2 {name}"
    return f"{value:.4g}"

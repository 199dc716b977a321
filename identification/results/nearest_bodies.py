"""Bodies that have f, nearest to a prior in the log-det divergence of their pseudo-inertias.

Each body is X in P = L X L', with L L' the prior's pseudo-inertia: the prior is X = 1, and the
divergence from it, tr X - log det X - 4, does not depend on frames or units, and is infinite where
a body would cease to be one. A rotor is a matrix (1, 1) of the same kind. With the rows of A for f,
the optimum of

    sum (tr X - log det X) + |A x - f|^2 / (2 softness)

is a root of (gradient + A' y, A x - softness y - f), which Newton's method finds. Softness 0 stands
for A x = f itself, and a softness that goes to zero leads to the nearest f that bodies can have.

Source: T. Lee, P. M. Wensing, F. C. Park, Geometric robot dynamic identification: a convex
programming approach, IEEE Transactions on Robotics 36 (2020) (the divergence); S. Boyd, L.
Vandenberghe, Convex Optimization, 10.3 (Newton's method from a start that meets no equation).

A prior that is wrong by a factor of more than some hundred in a direction (a blade in place of a
ball) can stop the search short of bodies that exist; give a better one then.
"""

from dataclasses import dataclass

import numpy as np

from plant.mechanics import symmetric_basis
from plant.parts import Floats, frozen_settings


@frozen_settings
class NewtonSettings:
    """Limits of Newton's method; chosen by hand.

    Parameters
    ----------
    steps : int
        Steps of Newton's method, at most.
    converged : float
        Residual below which it has converged: relative to f where f is met, a decrement otherwise.
    rounding : float
        Relative residual that counts as converged where no step improves it any more.
    shortest : float
        Length of a step, of 1, below which the search is stuck at the border of possible bodies.
    loss : float
        Share of its extent that a body may lose in one step: the log-det is steep at the border.
    nearly : float
        Relative difference of f below which bodies may have it after all, in a second search.
    hardest, harder : float
        The last softness, and each in units of the previous one; the first is |A x - f|^2 at the
        prior.
    """

    steps: int = 100
    converged: float = 1e-12
    rounding: float = 1e-9
    shortest: float = 1e-10
    loss: float = 0.8
    nearly: float = 1e-5
    hardest: float = 1e-9
    harder: float = 0.2


SETTINGS = NewtonSettings()


@dataclass(frozen=True)
class Block:
    """One body or rotor: factor L (d, d) of its prior, and columns (p, d (d + 1) / 2) of A."""

    factor: Floats
    columns: Floats


def nearest_realisation(
    blocks: list[Block], f: Floats, scale: Floats | None = None
) -> tuple[list[Floats], Floats] | None:
    """Pseudo-inertias with this f, nearest to their priors, and the f that they have.

    `f` (p,). `scale` (p, p): whitening matrix of f, in whose metric the nearest f is taken if
    bodies cannot have this one. Without it f must be met, and the result is None where it is not.
    """
    A = np.column_stack([block.columns for block in blocks])
    problem = _Problem([len(block.factor) for block in blocks])
    # In whitened numbers, the distance is one of standard deviations.
    x = _met(problem, A, f) if scale is None else problem.nearest(scale @ A, scale @ f)
    if x is None:
        return None
    # Back from X to the pseudo-inertia L X L'.
    matrices = [
        block.factor @ X @ block.factor.T
        for block, X in zip(blocks, problem.matrices(x), strict=True)
    ]
    return matrices, A @ x


def _met(problem, A, f):
    """The x of least divergence with A x = f; None if there is none, or the search misses it."""
    equations = _independent(A, f)
    if equations is None:
        return None
    rows, values = equations
    x = problem.exact(rows, values, problem.prior)
    if x is not None:
        return x
    # The search began too far away: begin again at bodies that nearly have f, if there are any.
    start = problem.nearest(rows, values)
    limit = SETTINGS.nearly * (1.0 + np.abs(values).max())
    return (
        problem.exact(rows, values, start) if np.abs(rows @ start - values).max() < limit else None
    )


def _independent(A, f):
    """The same equations as independent, orthonormal rows; None if they contradict each other."""
    # Rows of equal size, so that one tolerance serves numbers of different units.
    size = np.linalg.norm(A, axis=1)
    size[size == 0] = 1.0
    U, values, right = np.linalg.svd(A / size[:, None], full_matrices=False)
    # Directions below rounding carry no equation.
    rank = int((values > 1e-11 * values[0]).sum())
    turned = U.T @ (f / size)
    # A part of f outside of the range of A contradicts it.
    rest = f / size - U[:, :rank] @ turned[:rank]
    if np.abs(rest).max() > 1e-11 * max(1.0, np.abs(f / size).max()):
        return None
    return right[:rank], turned[:rank] / values[:rank]


class _Problem:
    """The divergence of several blocks, as a function of all their x (in an orthonormal basis)."""

    def __init__(self, sizes):
        self.bases = [symmetric_basis(d) for d in sizes]
        # Places of the blocks in the vector x, one after another.
        ends = np.cumsum([len(basis) for basis in self.bases])
        self.places = [
            slice(end - len(basis), end) for end, basis in zip(ends, self.bases, strict=True)
        ]
        self.prior = np.concatenate([np.einsum("kii->k", basis) for basis in self.bases])  # X = 1

    def matrices(self, x):
        """X of each block."""
        return [
            np.einsum("k,kij->ij", x[rows], basis)
            for basis, rows in zip(self.bases, self.places, strict=True)
        ]

    def gradient(self, x):
        """Gradient, 1 - X^-1, of the divergence; None outside of its domain."""
        result = np.empty(len(x))
        for X, basis, rows in zip(self.matrices(x), self.bases, self.places, strict=True):
            if not np.linalg.eigvalsh(X)[0] > 0:
                return None
            result[rows] = np.einsum("kij,ij->k", basis, np.eye(len(X)) - np.linalg.inv(X))
        return result

    def inverse_hessian(self, x, columns):
        """The inverse of the divergence's Hessian, X . X, times columns (k, m)."""
        result = np.empty_like(columns)
        for X, basis, rows in zip(self.matrices(x), self.bases, self.places, strict=True):
            turned = np.einsum("ij,kjl,lm->kim", X, basis, X)
            result[rows] = np.einsum("kij,hij->kh", basis, turned) @ columns[rows]
        return result

    def value(self, x):
        """The divergence, infinite outside of its domain; up to a constant."""
        # Trace and log-det from the eigenvalues, which are positive for bodies.
        values = [np.linalg.eigvalsh(X) for X in self.matrices(x)]
        return sum(float(v.sum() - np.log(v).sum()) if v[0] > 0 else np.inf for v in values)

    def longest(self, x, dx):
        """The longest step, at most 1, in which no X loses more than a share in any direction."""
        length = 1.0
        for X, step in zip(self.matrices(x), self.matrices(dx), strict=True):
            # In coordinates in which X is 1.
            L = np.linalg.cholesky(X)
            change = np.linalg.solve(L, np.linalg.solve(L, step).T)
            # Relative change of the extent in the direction that shrinks most.
            lowest = float(np.linalg.eigvalsh((change + change.T) / 2)[0])
            if lowest < -SETTINGS.loss:
                length = min(length, SETTINGS.loss / -lowest)
        return length

    def exact(self, A, f, x):
        """The x of least divergence with A x = f; None if the steps end at the border of bodies."""
        y = np.zeros(len(f))  # multipliers of the equations

        def residual(x, y):
            gradient = self.gradient(x)
            if gradient is None:
                return np.array([np.inf])
            return np.concatenate([gradient + A.T @ y, A @ x - f])

        present = residual(x, y)
        size = 1.0 + np.abs(f).max(initial=0.0)
        for _ in range(SETTINGS.steps):
            dx, dy = self.step(A, 0.0, x, present)
            length = self.longest(x, dx)
            # Backtrack until the residual decreases by a tenth of the linear prediction.
            while not np.linalg.norm(residual(x + length * dx, y + length * dy)) <= (
                (1 - 0.1 * length) * np.linalg.norm(present)
            ):
                length /= 2
                if length < SETTINGS.shortest:  # at the border, or at rounding
                    return x if np.abs(present).max() < SETTINGS.rounding * size else None
            x = x + length * dx
            y = y + length * dy
            present = residual(x, y)
            if np.abs(present).max() < SETTINGS.converged * size:
                return x
        return None

    def nearest(self, A, f):
        """The x with the least |A x - f|, as the limit of softness to zero."""
        x = self.prior
        # At the first softness, the misfit of the prior costs one half at most.
        softness = max(1.0, float(np.sum((A @ x - f) ** 2)))

        def cost(x):
            return self.value(x) + float(np.sum((A @ x - f) ** 2)) / (2 * softness)

        while softness >= SETTINGS.hardest:
            for _ in range(SETTINGS.steps):
                # None is outside of the domain, which the steps do not leave.
                divergence = self.gradient(x)
                divergence = self.prior if divergence is None else divergence
                gradient = divergence + A.T @ (A @ x - f) / softness
                # Multipliers are eliminated: they are (A x - f) / softness.
                dx, _ = self.step(A, softness, x, np.concatenate([gradient, np.zeros(len(f))]))
                decrement = float(-gradient @ dx)
                length = self.longest(x, dx)
                present = cost(x)
                while (
                    not cost(x + length * dx) <= present - 0.1 * length * decrement
                    and length > SETTINGS.shortest
                ):
                    length /= 2
                # At the optimum of this softness; go on with a harder one.
                if decrement < SETTINGS.converged or length <= SETTINGS.shortest:
                    break
                x = x + length * dx
            softness *= SETTINGS.harder
        return x

    def step(self, A, softness, x, residual):
        """Newton's step of x and multipliers, by the Schur complement of the Hessian."""
        solved = self.inverse_hessian(x, np.column_stack([A.T, residual[: len(x)]]))
        of_rows = solved[:, :-1]
        of_gradient = solved[:, -1]
        # The Hessian is block diagonal, so only this small system is solved.
        schur = A @ of_rows + softness * np.eye(len(A))
        dy = np.linalg.solve(schur, residual[len(x) :] - A @ of_gradient)
        return -of_gradient - of_rows @ dy, dy

"""Bodies that realise f, nearest to a prior: the log-det divergence of their pseudo-inertias,
minimised by Newton.

Each body is X in P = L X L', with L L' the prior's pseudo-inertia: the prior is X = 1, and the
divergence from it, tr X - log det X - 4, does not depend on frames or units, and is infinite where
a body would cease to be one. A rotor is a matrix (1, 1) of the same kind. With the rows of A for f,
the optimum of

    sum (tr X - log det X) + |A x - f|^2 / (2 softness)

is a root of (gradient + A' y, A x - softness y - f), which Newton's method finds; softness 0 is A x
= f itself, and a softness that goes to zero leads to the nearest f that bodies have.

Source: T. Lee, P. M. Wensing, F. C. Park, Geometric robot dynamic identification: a convex
programming approach, IEEE Transactions on Robotics 36 (2020) (the divergence); S. Boyd, L.
Vandenberghe, Convex Optimization, 10.3 (Newton's method from a start that meets no equation).

A prior that is wrong by more than some hundred times in a direction (a blade for what is a ball)
can stop the search short of bodies that exist; give a better one then.
"""

import dataclasses

import numpy as np

from plant.mechanics.body import symmetric_basis
from plant.parts.fields import Floats

_STEPS = 100
_CONVERGED = 1e-12
_ROUNDING = 1e-9
_STUCK = 1e-10  # length of a step below which bodies that are met by no f stop

# share of its extent that a body may lose in one step: the log-det grows steep towards the border
_LOSS = 0.8

_NEARLY = 1e-5  # relative difference of f below which bodies may have it after all

# The last softness, and each in units of the one before; the first is |A x - f|^2 at the prior.
_HARDEST = 1e-9
_HARDER = 0.2


@dataclasses.dataclass(frozen=True)
class Block:
    """One body or rotor: the factor L (d, d) of its prior, and what f gets of each x, (p, d (d +
    1) / 2).
    """

    factor: Floats
    columns: Floats


def nearest_realisation(
    blocks: list[Block], f: Floats, scale: Floats | None = None
) -> tuple[list[Floats], Floats] | None:
    """Pseudo-inertias with this f, nearest to their priors.

    `f` (p,). `scale` (p, p): whitening matrix of f: what is nearest where bodies cannot have f.
    Without it f must be met.

    Returns pseudo-inertias, and the f that they have; None where no bodies with f were found.
    """
    A = np.column_stack([block.columns for block in blocks])
    problem = _Problem([len(block.factor) for block in blocks])
    if scale is None:
        found = None
        if (rows := _independent(A, f)) is not None:
            found = problem.exact(*rows, problem.prior)
            if found is None:  # again from bodies that nearly have f, if there are any
                near = problem.nearest(*rows)
                met = np.abs(rows[0] @ near - rows[1]).max() < _NEARLY * (
                    1.0 + np.abs(rows[1]).max()
                )
                found = problem.exact(*rows, near) if met else None
    else:
        found = problem.nearest(scale @ A, scale @ f)
    if found is None:
        return None
    matrices = [
        b.factor @ X @ b.factor.T for b, X in zip(blocks, problem.matrices(found), strict=True)
    ]
    return matrices, A @ found


def _independent(A: Floats, f: Floats) -> tuple[Floats, Floats] | None:
    """The same equations as independent, orthonormal rows; None where they contradict each
    other.
    """
    size = np.linalg.norm(A, axis=1)
    size[size == 0] = 1.0
    left, values, right = np.linalg.svd(A / size[:, None], full_matrices=False)
    rank = int((values > 1e-11 * values[0]).sum())
    turned = left.T @ (f / size)
    rest = f / size - left[:, :rank] @ turned[:rank]
    if np.abs(rest).max() > 1e-11 * max(1.0, np.abs(f / size).max()):
        return None
    return right[:rank], turned[:rank] / values[:rank]


class _Problem:
    """The divergence of several blocks, as a function of all their x (in an orthonormal basis)."""

    def __init__(self, sizes: list[int]) -> None:
        self.bases = [symmetric_basis(d) for d in sizes]
        ends = np.cumsum([len(each) for each in self.bases])
        self.places = [
            slice(end - len(each), end) for end, each in zip(ends, self.bases, strict=True)
        ]
        self.prior = np.concatenate([np.einsum("kii->k", each) for each in self.bases])

    def matrices(self, x: Floats) -> list[Floats]:
        """X of each block."""
        return [
            np.einsum("k,kij->ij", x[at], each)
            for each, at in zip(self.bases, self.places, strict=True)
        ]

    def gradient(self, x: Floats) -> Floats | None:
        """Gradient, 1 - X^-1, of the divergence; None outside of its domain."""
        result = np.empty(len(x))
        for X, each, at in zip(self.matrices(x), self.bases, self.places, strict=True):
            if not np.linalg.eigvalsh(X)[0] > 0:
                return None
            result[at] = np.einsum("kij,ij->k", each, np.eye(len(X)) - np.linalg.inv(X))
        return result

    def inverse_hessian(self, x: Floats, columns: Floats) -> Floats:
        """The inverse of the divergence's Hessian, X . X, times columns (k, m)."""
        result = np.empty_like(columns)
        for X, each, at in zip(self.matrices(x), self.bases, self.places, strict=True):
            turned = np.einsum("ij,kjl,lm->kim", X, each, X)
            result[at] = np.einsum("kij,hij->kh", each, turned) @ columns[at]
        return result

    def value(self, x: Floats) -> float:
        """The divergence, infinite outside of its domain; up to a constant."""
        values = [np.linalg.eigvalsh(X) for X in self.matrices(x)]
        return sum(float(v.sum() - np.log(v).sum()) if v[0] > 0 else np.inf for v in values)

    def longest(self, x: Floats, dx: Floats) -> float:
        """The longest step, at most 1, in which no X loses more than a share in any direction."""
        most = 1.0
        for X, step in zip(self.matrices(x), self.matrices(dx), strict=True):
            L = np.linalg.cholesky(X)
            change = np.linalg.solve(L, np.linalg.solve(L, step).T)
            least = float(np.linalg.eigvalsh((change + change.T) / 2)[0])
            most = min(most, _LOSS / -least) if least < -_LOSS else most
        return most

    def exact(self, A: Floats, f: Floats, x: Floats) -> Floats | None:
        """The x of least divergence with A x = f; None where Newton's steps end at the border of
        what bodies have.
        """
        y = np.zeros(len(f))

        def residual(x: Floats, y: Floats) -> Floats:
            gradient = self.gradient(x)
            return (
                np.array([np.inf])
                if gradient is None
                else np.concatenate([gradient + A.T @ y, A @ x - f])
            )

        now = residual(x, y)
        size = 1.0 + np.abs(f).max(initial=0.0)
        for _ in range(_STEPS):
            dx, dy = self.step(A, 0.0, x, now)
            length = self.longest(x, dx)
            while not np.linalg.norm(residual(x + length * dx, y + length * dy)) <= (
                (1 - 0.1 * length) * np.linalg.norm(now)
            ):
                length /= 2
                if length < _STUCK:  # at the border, or at rounding
                    return x if np.abs(now).max() < _ROUNDING * size else None
            x = x + length * dx
            y = y + length * dy
            now = residual(x, y)
            if np.abs(now).max() < _CONVERGED * size:
                return x
        return None

    def nearest(self, A: Floats, f: Floats) -> Floats:
        """The x with the least |A x - f|, as the limit of softness to zero."""
        x = self.prior
        softness = max(1.0, float(np.sum((A @ x - f) ** 2)))

        def cost(x: Floats) -> float:
            return self.value(x) + float(np.sum((A @ x - f) ** 2)) / (2 * softness)

        while softness >= _HARDEST:
            for _ in range(_STEPS):
                own = self.gradient(x)
                gradient = (self.prior if own is None else own) + A.T @ (A @ x - f) / softness
                dx, _ = self.step(A, softness, x, np.concatenate([gradient, np.zeros(len(f))]))
                decrement = float(-gradient @ dx)
                length = self.longest(x, dx)
                now = cost(x)
                while (
                    not cost(x + length * dx) <= now - 0.1 * length * decrement and length > _STUCK
                ):
                    length /= 2
                if decrement < _CONVERGED or length <= _STUCK:
                    break
                x = x + length * dx
            softness *= _HARDER
        return x

    def step(
        self, A: Floats, softness: float, x: Floats, residual: Floats
    ) -> tuple[Floats, Floats]:
        """Newton's step of x and multipliers, by the Schur complement of the Hessian."""
        left = self.inverse_hessian(x, np.column_stack([A.T, residual[: len(x)]]))
        schur = A @ left[:, :-1] + softness * np.eye(len(A))
        dy = np.asarray(np.linalg.solve(schur, residual[len(x) :] - A @ left[:, -1]), dtype=float)
        return np.asarray(-left[:, -1] - left[:, :-1] @ dy, dtype=float), dy

"""A casadi Function compiled and mapped over the columns of arrays."""

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from plant.compiler.intrinsics import map_source
from plant.compiler.kernel_cache import Kernel


class MapKernel:
    """A casadi Function (of SX, with dense outputs) compiled, applied to the columns of arrays.

    The last `outer` inputs come from a second array, each column of which is joined with each of the first.
    """

    def __init__(self, function: ca.Function, outer: int = 0) -> None:
        sizes = [function.nnz_in(i) for i in range(function.n_in())]
        self.n_in, self.n_outer = sum(sizes[: len(sizes) - outer]), sum(sizes[len(sizes) - outer :])
        source, self.n_out = map_source(function, outer)
        self._kernel = Kernel(source, ["map"])

    def __call__(self, x: ArrayLike, z: ArrayLike | None = None) -> NDArray[np.float64]:
        """Outputs (n_out, N) for inputs x (n_in, N); (n_out, M, N) with z (n_outer, M). Components are joined."""
        inner = np.ascontiguousarray(x, dtype=float)
        outer = np.empty((0, 1)) if z is None else np.ascontiguousarray(z, dtype=float)
        if inner.shape[0] != self.n_in or outer.shape[0] != self.n_outer:
            got, expected = (inner.shape[0], outer.shape[0]), (self.n_in, self.n_outer)
            raise ValueError(f"x and z must have {expected} rows, one per number; got {got}. Join all inputs in order.")
        y = np.empty((self.n_out, outer.shape[1], inner.shape[1]))
        self._kernel.call("map", inner, outer, y)
        return y[:, 0] if z is None else y

"""Compiled kernels: a casadi Function mapped over columns, or a whole closed loop for one individual or for many."""

from __future__ import annotations

import numpy as np

from plant.compiler.intrinsics import map_source
from plant.compiler.kernel_cache import Kernel

__all__ = ["MapKernel"]


class MapKernel:
    """A casadi Function compiled, applied to the columns of arrays.

    Parameters
    ----------
    function : casadi Function
        Built from SX, with dense outputs.
    outer : int
        How many of the last inputs come from a second array, each column of which is joined with each of the first.
    """

    def __init__(self, function, outer=0):
        sizes = [function.nnz_in(i) for i in range(function.n_in())]
        self.n_in, self.n_outer = sum(sizes[: len(sizes) - outer]), sum(sizes[len(sizes) - outer :])
        source, self.n_out = map_source(function, outer)
        self._kernel = Kernel(source, ["map"])

    def __call__(self, x, z=None):
        """Outputs (n_out, N) for inputs x (n_in, N); (n_out, M, N) with z (n_outer, M). Components are joined."""
        x = np.ascontiguousarray(x, dtype=float)
        outer = np.empty((0, 1)) if z is None else np.ascontiguousarray(z, dtype=float)
        if x.shape[0] != self.n_in or outer.shape[0] != self.n_outer:
            got, expected = (x.shape[0], outer.shape[0]), (self.n_in, self.n_outer)
            raise ValueError(f"x and z must have {expected} rows, one per number; got {got}. Join all inputs in order.")
        y = np.empty((self.n_out, outer.shape[1], x.shape[1]))
        self._kernel.call("map", x, outer, y)
        return y[:, 0] if z is None else y

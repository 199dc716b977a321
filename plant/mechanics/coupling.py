"""Coupling of motors and joints, as in a wrist where one motor moves several joints.

The output of a motor's gear is its *shaft*. Without coupling the shaft is the joint; with it shaft
angles are C q, and joint torques C^T times shaft torques. Rotor inertia and friction act on the
shafts, the links on the joints.
"""

import functools

import casadi as ca
import numpy as np

from plant.mechanics.placement import exact
from plant.parts import ArrayOrSymbols, Floats, Nested, Part, array, part, structure


@part
class Coupling(Part):
    """Coupling matrix between joint angles and the shafts of the motors.

    Parameters
    ----------
    matrix : (n, n) array_like, optional
        C: turns of shaft i per turn of joint j, shaft = C q. By default none: every motor moves its
        own joint alone.

    Notes
    -----
    Angles, speeds and torques are (n,) or (N, n) numpy arrays, or casadi columns (n, 1). The same
    coupling belongs to the `Chain` (rotors turn with the shafts) and to its `Drive` (encoders and
    friction are on the shafts).

    See Also
    --------
    plant.Drive, plant.Chain

    Examples
    --------
    >>> from plant import Coupling
    >>> coupling = Coupling(matrix=((1, 0), (1, 1)))       # shaft 2 turns with joint 1 too
    >>> coupling.shaft((0.3, 0.1))
    array([0.3, 0.4])
    """

    matrix: Nested = structure(default=())

    def __post_init__(self) -> None:
        super().__post_init__()
        # No matrix: C is the identity.
        if isinstance(self.matrix, (tuple, list)) and not self.matrix:
            object.__setattr__(self, "matrix", ())
            return
        advice = "Give a square matrix of numbers: shaft turns per joint turn."
        matrix = array("matrix of a coupling", self.matrix, ("n", "n"), advice=advice)
        if matrix.shape[0] != matrix.shape[1]:
            raise ValueError(
                f"matrix of a coupling must be (n, n); got shape {matrix.shape}. {advice}"
            )
        # Beyond a condition number of 1e6 rows are alike, and C^-1 would amplify rounding.
        if not np.linalg.cond(matrix) < 1e6:
            raise ValueError(
                f"matrix of a coupling must not be singular; got {matrix.tolist()}. Check its rows."
            )
        # The identity becomes "no coupling": equations get no products with it, and it equals the
        # default.
        plain = (matrix == np.eye(len(matrix))).all()
        rows = () if plain else tuple(tuple(row) for row in matrix.tolist())
        object.__setattr__(self, "matrix", rows)

    def require_size(self, n: int, owner: str) -> None:
        """Refuse a coupling that is not of n joints."""
        if self.matrix and len(self.matrix) != n:
            raise ValueError(
                f"coupling of the {owner} must be ({n}, {n}); got {len(self.matrix)} rows. One per"
                " joint."
            )

    def shaft(self, q: ArrayOrSymbols) -> ArrayOrSymbols:
        """Shaft angles or speeds, C q, of joint angles or speeds q."""
        return self._times(np.array(self.matrix), q)

    def joint(self, shaft: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint angles or speeds, C^-1 times shaft angles or speeds."""
        return self._times(self._inverse, shaft)

    def joint_torque(self, shaft_torque: ArrayOrSymbols) -> ArrayOrSymbols:
        """Joint torques, C^T times shaft torques."""
        return self._times(np.array(self.matrix).T, shaft_torque)

    def shaft_torque(self, tau: ArrayOrSymbols) -> ArrayOrSymbols:
        """Shaft torques, C^-T times joint torques."""
        return self._times(self._inverse.T, tau)

    def shaft_inertia(self, D: ca.SX) -> ca.SX:
        """Inertia matrix (n, n) seen from the shafts, C^-T D C^-1."""
        # D is symmetric: (C^-T D)^T = D C^-1, and C^-T times that is the matrix on the shafts.
        return self.shaft_torque(self.shaft_torque(D).T)

    @functools.cached_property
    def _inverse(self) -> Floats:
        # Whole numbers often have a whole inverse: rounding would only lengthen the equations.
        return exact(np.linalg.inv(self.matrix)) if self.matrix else np.empty(0)

    def _times(self, matrix: Floats, x: ArrayOrSymbols) -> ArrayOrSymbols:
        if not self.matrix:
            return x
        # Zeros of a sparse matrix leave no terms in a symbolic expression.
        if isinstance(x, (ca.SX, ca.DM, ca.MX)):
            return ca.sparsify(ca.DM(matrix)) @ x
        # no BLAS: the same bits everywhere
        return (np.asarray(x)[..., None, :] * matrix).sum(axis=-1)

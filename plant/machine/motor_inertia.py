"""Lower bound of the inertia matrix: D(q) must not fall below the least reflected rotor inertias.

A candidate for f may track well although its D is nearly singular away from the path. A
computed-torque law that is built on such a D can be unstable. So D(q) - diag(Jm_min k^2) must be
positive semidefinite at every q. Jm_min is the least rotor inertia that a motor of this kind can
have, and k is the gear ratio. For coupled motors, D is the inertia matrix seen from their shafts.
"""

import functools

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.compiler import MapKernel
from plant.machine.rig import Rig
from plant.mechanics import STANDARD, Arm, Coupling, Dynamics, eliminated
from plant.parts import Floats, frozen_settings

# Ratio of Jm_min to the drive's motor inertia. Source: paper 3.6 (1e-4 kg m^2 / 2e-4 kg m^2).
LEAST_MOTOR_INERTIA = 0.5


@frozen_settings
class PoseSettings:
    """Poses at which the inertia matrix of candidates is checked.

    Parameters
    ----------
    grid : int
        Number of poses in one turn, if D depends on one joint alone. With 360 poses, the grid
        misses an extreme of cos(q) by less than 4e-5 of its amplitude.
    scattered : int
        Poses of a Sobol sequence if D depends on several joints; chosen by hand.
    batch : int
        Poses times candidates in one call of the kernel: as many as stay in the processor's cache.
    """

    grid: int = 360
    scattered: int = 4096
    batch: int = 16384


SETTINGS = PoseSettings()


def least_inertia_margin(dynamics: Dynamics, rig: Rig, f: ArrayLike) -> Floats:
    """Smallest pivot (P,) [kg m^2] of D(q) - diag(Jm_min k^2), for each candidate f (P, p).

    The search covers the poses of `SETTINGS`, not every q. The result is negative if the matrix is
    indefinite at one of these poses.
    """
    f = np.asarray(f, dtype=float)
    kernel, poses = _smallest_pivot(dynamics, rig.drive.coupling)
    least = rig.drive.reflected_inertia(LEAST_MOTOR_INERTIA * rig.drive.motor_inertia)
    # The kernel takes one column per candidate: first its n values of least, then its p of f.
    candidates = np.vstack([np.repeat(least[:, None], len(f), axis=1), f.T])
    margins = np.empty(len(f))
    size = max(1, SETTINGS.batch // poses.shape[1])
    for start in range(0, len(f), size):
        batch = slice(start, start + size)
        margins[batch] = kernel(poses, candidates[:, batch])[0].min(axis=1)
    return margins


def shaft_inertias(dynamics: Dynamics, rig: Rig, q: ArrayLike) -> Floats:
    """Diagonals (p, n) of D seen from the motors' shafts at a pose q (n,).

    Row k is the diagonal for parameter k of f equal to 1 and all others equal to 0.
    """
    # D is linear in f: the unit vectors of f give the share of each parameter.
    coupling = rig.drive.coupling
    matrices = [coupling.shaft_inertia(dynamics.D(q, unit)) for unit in np.eye(dynamics.p)]
    return np.array([np.diag(matrix.full()) for matrix in matrices])


def rotors_alone(dynamics: Dynamics) -> dict[int, int]:
    """Link -> index of the parameter that is the inertia of its rotor and nothing else."""
    # The row of such a parameter has one nonzero entry, at the standard parameter J of the link.
    rows = [(k, np.flatnonzero(row)) for k, row in enumerate(np.array(dynamics.lumping.matrix))]
    single = [(k, *divmod(int(places[0]), len(STANDARD))) for k, places in rows if len(places) == 1]
    return {link: k for k, link, kind in single if STANDARD[kind] == "J"}


def require_inertia(arm: Arm, rig: Rig) -> None:
    """Raise ValueError if D(q) of the arm falls below diag(Jm_min k^2) at a checked pose."""
    rig.require_fit(arm.dynamics.chain)
    margin = least_inertia_margin(arm.dynamics, rig, arm.f[None])[0]
    # The form `not margin >= 0` also refuses a margin that is not a number.
    if not margin >= 0:
        raise ValueError(
            "D(q) must exceed the motors' own inertia diag(Jm_min k^2), Jm_min ="
            f" {LEAST_MOTOR_INERTIA:g} Jm, at every q; f = {np.array2string(arm.f, precision=3)}"
            f" falls short by {-margin:.3g} kg m^2 (in a pivot). Identify again, or check f, the"
            " gears, and that the chain's rotors are drive.reflected_inertia()."
        )


@functools.lru_cache(maxsize=32)
def _smallest_pivot(dynamics: Dynamics, coupling: Coupling) -> tuple[MapKernel, Floats]:
    """Compiled (q, least, f) -> smallest pivot, and the poses (n, N) [rad] of the check."""
    n = dynamics.n
    q = ca.SX.sym("q", n)
    least = ca.SX.sym("least", n)
    f = ca.SX.sym("f", dynamics.p)
    _, pivots = eliminated(coupling.shaft_inertia(dynamics.D(q, f)) - ca.diag(least))
    # The pivots after one that is not positive have no meaning, so the first such pivot decides. A
    # zero pivot before the last one counts as negative.
    smallest = pivots[n - 1]
    for i in reversed(range(n - 1)):
        pivot = pivots[i]
        smallest = ca.if_else(pivot > 0, ca.fmin(pivot, smallest), ca.fmin(pivot, -1e-300))
    # Only joints on which D depends need poses. D never depends on the first joint of a chain.
    joints = np.flatnonzero(ca.which_depends(ca.vec(dynamics.D(q, f)), q, 1, False))
    angles = np.zeros((1, n))
    if len(joints) == 1:
        count = SETTINGS.grid
        angles = np.zeros((count, n))
        angles[:, joints[0]] = np.arange(count) * (2 * np.pi / count)
    elif len(joints):
        from scipy.stats import qmc  # takes 0.3 s to import; the paper's arm does not need it

        count = SETTINGS.scattered
        angles = np.zeros((count, n))
        # A fixed seed: the same candidates always get the same margins.
        angles[:, joints] = 2 * np.pi * qmc.Sobol(len(joints), seed=0).random(count)
    pivots_of = ca.Function("pivots", [q, least, f], ca.cse([ca.densify(smallest)]))
    return MapKernel(pivots_of, outer=2), angles.T

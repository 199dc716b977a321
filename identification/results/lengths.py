"""What f would be if lengths of the links were others: least squares of the torque along a log's motion."""

import dataclasses
from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from identification.equation_error.filtering import derivatives
from identification.equation_error.pulse_fit import BAND_MOST, CUTOFF, path_in
from identification.equation_error.regressor import linear, regressor_along
from plant import Arm, Chain, Record
from plant.mechanics.newton_euler import lumped_torque

_ROWS = 400
"""Samples of the motion, at most."""

_SHARE = 0.01
"""Change of a length, relative."""


def moved_by_lengths(arm: Arm, record: Record, unknown: Sequence[str]) -> dict[str, NDArray[np.float64]]:
    """Change (k,) of the unknowns if one length of a link is 1 % larger, by its name, ``links[1].a`` or ``links[1].d``.

    Parameters
    ----------
    arm : Arm
        As found.
    record : Record
    unknown : sequence of str
        Names of f, and numbers of rig and law; of these, friction takes part.
    """
    dynamics, rig = arm.dynamics, record.rig
    names, p = linear(dynamics, rig, unknown), dynamics.p
    band = min(2 * path_in(record), BAND_MOST / rig.period)
    motion = derivatives(rig.cell_centre(record.counts), rig.period, CUTOFF * band)
    motion = type(motion)(*(each[:: -(-len(record) // _ROWS)] for each in motion))
    columns, _ = regressor_along(dynamics, rig, names, motion)
    torque, moves = columns[:, :, :p] @ arm.f, {}
    scale = 1 / np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-9 * np.abs(torque).max())
    for name, chain in _longer(dynamics.chain).items():
        columns[:, :, :p] = _regressor(chain, arm, motion)
        rows, missing = columns * scale[:, None], (torque - columns[:, :, :p] @ arm.f) * scale
        change = np.linalg.lstsq(rows.reshape(-1, len(names)), missing.ravel(), rcond=None)[0]
        moves[name] = np.array([change[names.index(each)] if each in names else 0.0 for each in unknown])
    return moves


def _longer(chain: Chain) -> dict[str, Chain]:
    """The chain with one length more each."""
    found = {}
    for i, link in enumerate(chain.links):
        for length in ("a", "d"):
            if value := getattr(link, length):
                other = dataclasses.replace(link, **{length: (1 + _SHARE) * value})
                links = (*chain.links[:i], other, *chain.links[i + 1 :])
                found[f"links[{i}].{length}"] = dataclasses.replace(chain, links=links)
    return found


def _regressor(chain: Chain, arm: Arm, motion: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Regressor of f (N, n, p) of another chain."""
    n, p, count = chain.n, arm.dynamics.p, len(motion[0])
    q, qd, qdd, f = (ca.SX.sym(name, size) for name, size in (("q", n), ("qd", n), ("qdd", n), ("f", p)))
    moving, at_rest = lumped_torque(chain, arm.dynamics.lumping, q, qd, qdd, f)
    regressor = ca.Function("Y", [q, qd, qdd], [ca.densify(ca.jacobian(moving + at_rest, f))])
    block = regressor.map(count)(*(each.T for each in motion))
    return np.asarray(block.full().reshape(n, count, p).transpose(1, 0, 2))

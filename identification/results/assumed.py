"""Sensitivity of identified values to assumed numbers, which no log can reveal.

Gears, motor gains and gains of a law without memory change the innovations; to first order, the
unknowns move by what takes that change over. Lengths of the links change the torque along the
motion, and least squares gives the move of the unknowns.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error import (
    BAND_MOST,
    CUTOFF,
    derivatives,
    linear,
    path_in,
    regressor_along,
)
from plant import Arm, Dynamics, Record
from plant.motion import Motion
from plant.parts import Floats, Frozen, Piece, Shown, Table, frozen, least, product, products, real

# Samples of the motion at which torques are compared, at most: neighbours repeat each other, and
# the regressor of a sample is slow. Chosen by hand.
_ROWS = 400

SHARE = 0.01  # change of a length, relative


def moved_by_lengths(arm: Arm, record: Record, unknown: Sequence[str]) -> dict[str, Floats]:
    """Change (k,) of the unknowns if a length of a link is 1 % larger, by name (``links[1].a``).

    `arm`: as identified. `unknown`: names of f, and numbers of rig and law; of these, friction is
    fitted beside f, and the others do not move.
    """
    dynamics = arm.dynamics
    rig = record.rig
    names = linear(dynamics, rig, unknown)
    p = dynamics.p
    stride = -(-len(record) // _ROWS)  # rounded up
    smooth = smoothed(record, rig.cell_centre(record.counts))
    motion = Motion(*(signal[::stride] for signal in smooth))
    # The torque of the arm as identified, with the stated lengths.
    columns, _ = regressor_along(dynamics, rig, names, motion)
    torque = columns[:, :, :p] @ arm.f
    # Each joint counts in units of its own torque (rms).
    size = np.sqrt(np.mean(torque**2, axis=0))
    scale = 1 / np.maximum(size, 1e-9 * np.abs(torque).max())
    moves = {}
    for name, longer_arm in longer(dynamics).items():
        columns[:, :, :p] = regressor_along(longer_arm, rig, names, motion)[0][:, :, :p]
        # The unknowns take over the difference that a longer link makes.
        rows = columns * scale[:, None]
        missing = (torque - columns[:, :, :p] @ arm.f) * scale
        change = least(rows.reshape(-1, len(names)), missing.ravel())
        by_name = dict(zip(names, change, strict=True))
        moves[name] = np.array([by_name.get(number, 0.0) for number in unknown])
    return moves


def smoothed(record: Record, values: Floats) -> Motion:
    """Values (N, n) along a record, low-pass filtered, with first and second derivatives.

    The band is twice that of the record's path.
    """
    band = min(2 * path_in(record), BAND_MOST / record.rig.period)
    return derivatives(values, record.rig.period, CUTOFF * band)


class _Longer(Dynamics):
    """Dynamics of a chain with other lengths, and the lumping of the stated lengths.

    Its f stand for the same standard parameters, and span its torques as well.
    """

    def _prove(self) -> None:
        """Skip the proof that the lumping spans the torques: it holds for the stated lengths."""


def longer(dynamics: Dynamics, share: float = SHARE) -> dict[str, Dynamics]:
    """The arm with one length larger by a share of it, for each length that is not zero."""
    arms = dict[str, Dynamics]()
    factor = 1 + share
    replace = dataclasses.replace
    chain = dynamics.chain
    # Each link has two lengths of Denavit and Hartenberg, or a fixed placement.
    for i, link in enumerate(chain.links):
        position = tuple(factor * x for x in link.before.position)
        changed_links = {
            "a": replace(link, a=factor * link.a),
            "d": replace(link, d=factor * link.d),
            "before": replace(link, before=replace(link.before, position=position)),
        }
        for length, changed in changed_links.items():
            if changed != link:
                links = (*chain.links[:i], changed, *chain.links[i + 1 :])
                arms[f"links[{i}].{length}"] = _Longer(
                    chain=replace(chain, links=links), lumping=dynamics.lumping
                )
    return arms


# Move of a value by 1 % of an assumed number, in its standard deviations, below which it is not
# printed, because it is small beside the interval; chosen by hand.
_LITTLE = 0.05


@frozen
class Assumed(Shown, Frozen):
    """Sensitivity of identified values to assumed numbers; printed, a line per assumed number.

    Attributes
    ----------
    names : tuple of str
        Assumed numbers (a): ``drive.gear[0]``, ``drive.motor_gain[0]``, ``law.gain[0]``,
        ``links[1].a`` and so on.
    unknown : tuple of str
        Identified values (k).
    moves : (a, k) numpy.ndarray
        Change of each value if the assumed number is 1 % larger, and all is identified again.
    std : (k,) numpy.ndarray
        Standard deviations of the values.
    """

    names: tuple[str, ...]
    unknown: tuple[str, ...]
    moves: Floats
    std: Floats

    def covariance(self, percent: ArrayLike = 1.0) -> Floats:
        """Covariance (k, k) of the values by assumed numbers with these standard deviations [%].

        `percent`: one for all, or one of each of `names`.
        """
        sizes = np.array(
            [
                real("percent", size, "Give a standard deviation.")
                for size in np.ravel(percent).tolist()
            ]
        )
        # 0: exact, so a negative size is an error.
        if sizes.shape not in ((1,), (len(self.names),)) or (sizes < 0).any():
            raise ValueError(
                f"percent must be one number of at least 0, or {len(self.names)} of them; got"
                f" {sizes}. 0: exact."
            )
        # Assumptions are independent of each other: their squares add up.
        return products(self.moves * np.broadcast_to(sizes, len(self.names))[:, None])

    def _short(self) -> str:
        return f"{len(self.names)} assumed numbers, {len(self.unknown)} values"

    def _shown(self) -> Iterator[Piece]:
        # Intervals count gears only as far as their tolerance goes, and gains not at all.
        limit = f"from {_LITTLE:g} standard deviations on; no interval counts gains of motors"
        yield f"1 % more of an assumed number moves what is found by ({limit}):"
        rows = []
        for name, moves in zip(self.names, self.moves, strict=True):
            # The hard space keeps a name and its move on one line.
            texts = [
                f"{value}\xa0{move:+.2g}"
                for value, move, std in zip(self.unknown, moves, self.std, strict=True)
                if abs(move) > _LITTLE * std
            ]
            small = f"each value by less than {_LITTLE:g} of its standard deviation"
            rows.append((name, ", ".join(texts) or small))
        yield Table((), rows, words=(1,))


def moved(rates: Floats, effects: Mapping[str, Floats], names: Sequence[str]) -> dict[str, Floats]:
    """Change (v,) of the unknowns, in their steps, with each of these numbers, relative.

    `rates` (v, M): change of the innovations with a step of each unknown. `effects`: change of the
    innovations (at least M,) with each number. `names`: numbers to take; those without effect are
    left out.
    """
    acting = {
        name: effects[name][: rates.shape[1]]
        for name in names
        if np.isfinite(effects[name]).all() and effects[name].any()
    }
    if not acting:
        return {}
    slopes = product(rates, np.array([*acting.values()]).T)
    moves = -np.linalg.solve(products(rates.T), slopes).T
    return dict(zip(acting, moves, strict=True))

"""What one log cannot reveal: by how much each number that was assumed would move what was found.

Gears, motor gains and gains of a law without memory change the innovations; the unknowns that would
take that over to first order are what they move. Lengths of the links change the torque along the
motion; least squares takes that over.
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from identification.equation_error.filters import derivatives
from identification.equation_error.pulse_fit import BAND_MOST, CUTOFF, path_in
from identification.equation_error.regressor import linear, regressor_along
from plant import Arm, Dynamics, Record
from plant.motion.reference import Motion
from plant.parts.arguments import real
from plant.parts.fields import Floats
from plant.parts.frozen import Frozen
from plant.parts.shown import Piece, Shown
from plant.parts.sums import products
from plant.parts.tables import Table

_ROWS = 400  # samples of the motion, at most

SHARE = 0.01  # change of a length, relative


def moved_by_lengths(arm: Arm, record: Record, unknown: Sequence[str]) -> dict[str, Floats]:
    """Change (k,) of the unknowns if one length of a link is 1 % larger, by its name, such as
    ``links[1].a``.

    `arm`: as found. `unknown`: names of f, and numbers of rig and law; of these, friction takes
    part.
    """
    dynamics = arm.dynamics
    rig = record.rig
    names = linear(dynamics, rig, unknown)
    p = dynamics.p
    motion = Motion(
        *(
            each[:: -(-len(record) // _ROWS)]
            for each in smoothed(record, rig.cell_centre(record.counts))
        )
    )
    columns, _ = regressor_along(dynamics, rig, names, motion)
    torque = columns[:, :, :p] @ arm.f
    moves = {}
    scale = 1 / np.maximum(np.sqrt(np.mean(torque**2, axis=0)), 1e-9 * np.abs(torque).max())
    for name, other in longer(dynamics).items():
        columns[:, :, :p] = regressor_along(other, rig, names, motion)[0][:, :, :p]
        rows = columns * scale[:, None]
        missing = (torque - columns[:, :, :p] @ arm.f) * scale
        change = np.linalg.lstsq(rows.reshape(-1, len(names)), missing.ravel(), rcond=None)[0]
        moves[name] = np.array(
            [change[names.index(each)] if each in names else 0.0 for each in unknown]
        )
    return moves


def smoothed(record: Record, values: Floats) -> Motion:
    """Values (N, n) along a record within twice the band of its path, with first and second
    derivatives.
    """
    band = min(2 * path_in(record), BAND_MOST / record.rig.period)
    return derivatives(values, record.rig.period, CUTOFF * band)


class _Longer(Dynamics):
    """Of a chain with other lengths. Its f stand for the same standard parameters, and span its
    torques as well.
    """

    def _prove(self) -> None:
        """The lumping is that of the lengths as they were."""


def longer(dynamics: Dynamics, share: float = SHARE) -> dict[str, Dynamics]:
    """The arm with one length more each, by a share of it."""
    found = dict[str, Dynamics]()
    by = 1 + share
    replace = dataclasses.replace
    chain = dynamics.chain
    for i, link in enumerate(chain.links):
        place = replace(link.before, position=tuple(by * x for x in link.before.position))
        ways = (
            replace(link, a=by * link.a),
            replace(link, d=by * link.d),
            replace(link, before=place),
        )
        for length, other in zip(("a", "d", "before"), ways, strict=True):
            if other != link:
                links = (*chain.links[:i], other, *chain.links[i + 1 :])
                found[f"links[{i}].{length}"] = _Longer(
                    chain=replace(chain, links=links), lumping=dynamics.lumping
                )
    return found


# move of a value by 1 % of an assumed number, in its standard deviations, that is not mentioned
_LITTLE = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Assumed(Shown, Frozen):
    """By how much what was found depends on what was assumed; printed, a line per assumed number.

    Attributes
    ----------
    names : tuple of str
        Assumed numbers (a): ``drive.gear[0]``, ``drive.motor_gain[0]``, ``law.gain[0]``,
        ``links[1].a`` and so on.
    unknown : tuple of str
        What was found (k).
    moves : (a, k) numpy.ndarray
        Change of each value if the assumed number is 1 % larger, and all is found anew.
    std : (k,) numpy.ndarray
        Standard deviations of the values.
    """

    names: tuple[str, ...]
    unknown: tuple[str, ...]
    moves: Floats
    std: Floats

    def covariance(self, percent: ArrayLike = 1.0) -> Floats:
        """Covariance (k, k) of the values by assumed numbers that are right within standard
        deviations of percent.

        `percent`: one for all, or one of each of `names`.
        """
        sizes = np.array(
            [
                real("percent", each, "Give a standard deviation.")
                for each in np.ravel(percent).tolist()
            ]
        )
        if sizes.shape not in ((1,), (len(self.names),)) or (sizes < 0).any():
            raise ValueError(
                f"percent must be one number of at least 0, or {len(self.names)} of them; got"
                f" {sizes}. 0: exact."
            )
        return products(self.moves * np.broadcast_to(sizes, len(self.names))[:, None])

    def _short(self) -> str:
        return f"{len(self.names)} assumed numbers, {len(self.unknown)} values"

    def _shown(self) -> Iterator[Piece]:
        told_from = f"from {_LITTLE:g} standard deviations on"
        yield f"1 % more of an assumed number moves what is found by ({told_from}):"
        rows = []
        for name, row in zip(self.names, self.moves, strict=True):
            told = [
                f"{each}\xa0{move:+.2g}"
                for each, move, std in zip(self.unknown, row, self.std, strict=True)
                if abs(move) > _LITTLE * std
            ]
            rows.append(
                (
                    name,
                    ", ".join(told)
                    or f"each value by less than {_LITTLE:g} of its standard deviation",
                )
            )
        yield Table((), rows, words=(1,))


def moved(rates: Floats, effects: Mapping[str, Floats], names: Sequence[str]) -> dict[str, Floats]:
    """Change (v,) of the unknowns, in their steps, with each of these numbers, relative; none of
    what does not act.

    `rates` (v, M): change of the innovations with a step of each unknown. `effects`: change of the
    innovations (at least M,) with each number. `names`: of those to answer for.
    """
    whole = products(rates.T)
    count = rates.shape[1]
    own = {
        name: effects[name][:count]
        for name in names
        if np.isfinite(effects[name]).all() and effects[name].any()
    }
    return {
        name: -np.linalg.solve(whole, (rates * effect).sum(axis=1)) for name, effect in own.items()
    }

"""Sampled plants: arms, rigs, and the counts that they lose."""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ctc.certification.uncertainty import Uncertainty
from plant import Arm, Law, Reference, Rig
from plant.parts import (
    Bools,
    Floats,
    Frozen,
    Integers,
    Piece,
    Shown,
    Table,
    Verdict,
    frozen,
    kept,
)
from plant.simulation import Population

# Default number of plants of an analysis that runs a population many times (reserves, holds,
# friction). Chosen by hand: if none of 400 plants fails, the failure probability is below 0.75 %
# with 95 % confidence.
_REPEATED = 400


@frozen
class Worst(Shown):
    """The plant with the largest error.

    ``evaluate(worst.arm, worst.rig, law, reference)`` runs it again.

    `arm`, `rig`: the arm with its load; the rig with its friction, phase, delay and lost samples.
    `peak`: largest encoder error [pulses]; inf if the loop diverged. `index`: index of this plant
    among all plants. `values`: values of the numbers sampled for this plant, by name.
    """

    arm: Arm
    rig: Rig
    peak: float
    index: int
    values: dict[str, float]

    def _short(self) -> str:
        return f"plant {self.index}, peak {self.peak:.0f} pulses"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(self._short())
        yield Table(
            ("sampled", ""), [(name, f"{value:.5g}") for name, value in self.values.items()]
        )


@kept
@frozen
class Plants(Frozen):
    """Plants sampled from an `Uncertainty`.

    `arm`, `rig`: nominal; the rig has the parts of all sampled effects. `f` (P, p): parameters of
    each arm, with its load. `names`: names of the numbers that differ; ``load`` [kg] is the mass in
    the gripper. `values` (P, K): values of these numbers; the arm's parameters among them are
    without the load. `dropped`: probability that the counts of a sample are lost. `redrawn`: number
    of draws that were rejected because they described no arm. `projected`: number of plants whose
    draws were rejected again and again, and which were moved towards the identified arm until they
    described an arm. `seed`: seed of the random numbers. `own`: the nominal rig without the sampled
    effects of gears and drives. `uncertainty`: as stated. `derived_names`, `derived` (P, D): names
    and values of the numbers of the loop that follow from the sampled numbers. `said`: names of the
    effects that are sampled, and of those that are not. `expected` (P, K): the part of the values
    that follows from the sampled resonance: f as fitted at that resonance; zero elsewhere.
    `redraws` (P,), `moved` (P,): rejected draws of each plant, and whether it was moved; None in
    files of earlier versions.
    """

    arm: Arm
    rig: Rig
    f: Floats
    names: tuple[str, ...]
    values: Floats
    dropped: float
    redrawn: int
    seed: int
    own: Rig
    uncertainty: Uncertainty
    derived_names: tuple[str, ...]
    derived: Floats
    said: tuple[tuple[str, ...], tuple[str, ...]]
    expected: Floats
    projected: int = 0
    # Not compared, so that files of earlier versions keep their digest.
    redraws: Integers | None = dataclasses.field(default=None, compare=False)
    moved: Bools | None = dataclasses.field(default=None, compare=False)

    def __repr__(self) -> str:
        return f"Plants({len(self)} that differ in {len(self.names)} numbers, seed {self.seed})"

    def __len__(self) -> int:
        return len(self.f)

    @property
    def nominal(self) -> Rig:
        """The nominal rig; if the encoders' phases are sampled, its encoder has no phase."""
        if not self.uncertainty.phase:
            return self.rig
        return dataclasses.replace(
            self.rig, encoder=dataclasses.replace(self.rig.encoder, phase=None)
        )

    def first(self, count: int | None) -> Self:
        """The first `count` plants, by default 400 or, if there are fewer, all.

        A `count` larger than the number of plants is refused.
        """
        # The default is what the analysis needs, not the number of plants of the certificate.
        count = min(_REPEATED, len(self)) if count is None else count
        if not _is_whole(count, 1, len(self)):
            raise ValueError(
                f"samples must be a whole number from 1 to {len(self)}; got {count!r}. Leave it"
                " out, or certify more samples."
            )
        # The first rows of a certificate's samples: the analysis is of the same arms.
        arrays = "f", "values", "derived", "expected"
        fields: dict[str, Any] = {name: getattr(self, name)[:count] for name in arrays}
        # Files of earlier versions have the counts of all plants alone.
        if self.redraws is not None and self.moved is not None:
            redraws = self.redraws[:count]
            moved = self.moved[:count]
            fields |= {"redraws": redraws, "redrawn": int(redraws.sum())}
            fields |= {"moved": moved, "projected": int(moved.sum())}
        return dataclasses.replace(self, **fields)

    def numbers(self) -> tuple[tuple[str, ...], Floats]:
        """Names and values (P, L) of all parameters f, and of the other numbers that differ."""
        # `values` has the parameters without the load, so f replaces them. The load and the
        # resonance act through f and `derived`.
        of_rig = [i for i, name in enumerate(self.names) if name in self.rig.number_names()]
        names = (*self.arm.dynamics.names, *(self.names[i] for i in of_rig), *self.derived_names)
        return names, np.hstack([self.f, self.values[:, of_rig], self.derived])

    def under(
        self, law: Law, reference: Reference, numbers: Any = None, **options: Any
    ) -> Population:
        """The population of all plants under a controller on a reference, with its options.

        `numbers`: names and values (P', L') of other loops, which replace those of the plants. They
        lose counts with the same probability.
        """
        # If no counts are lost, no losses are drawn.
        lost = functools.partial(_lost, self.seed, self.dropped) if self.dropped else None
        return Population(
            self.arm, self.rig, law, reference, *(numbers or self.numbers()), lost=lost, **options
        )

    def lost(self, block: int, width: int, steps: int) -> NDArray[np.bool_]:
        """Whether the counts of each controller step are lost, (steps, width).

        `block`: index of a block of loops; the block has `width` loops side by side.
        """
        return _lost(self.seed, self.dropped, block, width, steps)

    def plant(self, i: int, width: int, steps: int) -> tuple[Arm, Rig]:
        """Arm and rig of plant i, with its lost samples; `width` and `steps` as for `lost`."""
        # A negative index would have the losses of another plant.
        if not _is_whole(i, 0, len(self) - 1):
            raise ValueError(
                f"index must be a whole number from 0 to {len(self) - 1}; got {i!r}. Give that of a"
                " plant."
            )
        numbers = [*self.values[i].tolist(), *self.derived[i].tolist()]
        rig = self.rig.filled(dict(zip((*self.names, *self.derived_names), numbers, strict=True)))
        if self.dropped and rig.transport is not None:
            # Losses are drawn for a block of loops, so a plant's are a column of its block.
            block, lane = divmod(i, width)
            lost = tuple(np.flatnonzero(self.lost(block, width, steps)[:, lane]).tolist())
            rig = dataclasses.replace(rig, transport=dataclasses.replace(rig.transport, lost=lost))
        return self.arm.dynamics.arm(self.f[i]), rig


def _is_whole(value: Any, least: int, most: int) -> bool:
    # True is an int in Python, but never meant as a number of plants.
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and bool(least <= value <= most)


def _lost(seed: int, dropped: float, block: int, width: int, steps: int) -> NDArray[np.bool_]:
    # A stream for each block makes losses independent of the number of threads.
    lost = np.random.default_rng((seed, 1, block)).random((steps, width)) < dropped
    lost[:1] = False  # the first counts have no previous ones to be read in their place
    return lost

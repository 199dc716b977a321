"""Result of a tuning: the controller, what the best of each family does, and the certificate of the one chosen."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ctc.certification.certificate import Certificate
from ctc.certification.certificates import Certificates
from ctc.certification.statement import SEARCH, percent
from plant import Law
from plant.parts.frozen import Frozen
from plant.parts.kinds import kept
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_EACH = 3  # joints up to which a row has the chatter of each; with more it has the largest


@kept
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Trial(Shown, Frozen):
    """A tuning on independent samples.

    Attributes
    ----------
    family : str
    law : Law
    numbers : dict of str -> float
        Its variables.
    left, of : int
        Samples that exceed the limit, and of how many: a check ends early where more do than may.
    allowed : int
        Samples that may.
    peak : float
        Largest tracking error of any of them [pulses]; infinite where one diverged.
    chatter : (n,) numpy.ndarray
        Mean change of the torque from sample to sample, mean of the samples [N m]; infinite where one diverged.
    noise : float
        The same in shares of each joint's torque along the reference, mean of the joints.
    """

    family: str
    law: Law
    numbers: dict[str, float]
    left: int
    of: int
    allowed: int
    peak: float
    chatter: NDArray[np.float64]
    noise: float

    @property
    def rank(self) -> tuple[float, float]:
        """Smaller is better: the share of the samples that fails beyond those that may, then the noise."""
        return max(self.left - self.allowed, 0) / self.of, self.noise

    @property
    def holds(self) -> bool:
        """Whether no more samples exceed the limit than may."""
        return self.left <= self.allowed

    @property
    def tuned(self) -> str:
        """Its variables as a text."""
        return ", ".join(f"{name} {value:.4g}" for name, value in self.numbers.items())

    def _short(self) -> str:
        return f"{self.family}: {self.left} of {self.of} samples exceed the limit, {self.allowed} may"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict(f"{self._short()}; {self.tuned}", self.holds)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Tuning(Shown, Frozen):
    """What `tune` found. Print it for the table and the verdict.

    Controllers are chosen by how many of the validation samples exceed the limit, so those counts flatter; the
    certificate has its own samples.

    Attributes
    ----------
    law : Law
        That with the least chatter that keeps its limit on all validation samples but those that may exceed it; where
        none does, that with which the fewest do.
    trials : tuple of Trial
        The best of each family.
    certificate : Certificate or Certificates
        Of the controller, on samples of its own; of a mapping of motions, one for each.
    fresh : int
        Validation samples of a trial that holds.
    """

    law: Law
    trials: tuple[Trial, ...]
    certificate: Certificate | Certificates
    fresh: int

    @property
    def holds(self) -> bool:
        """Whether one was found that keeps its limit on all validation samples but those that may exceed it."""
        return any(trial.holds for trial in self.trials)

    @property
    def table(self) -> str:
        """The best tuning of each family: share of the validation samples that exceeds the limit, chatter, numbers."""
        return "\n".join(self._table().lines())

    def _table(self) -> Table:
        rows = []
        for trial in sorted(self.trials, key=lambda trial: trial.rank):
            each = trial.chatter if len(trial.chatter) <= _EACH else np.max(trial.chatter, keepdims=True)
            chatter = " / ".join(f"{x:.1f}" for x in each)
            rows.append((trial.family, percent(trial.left / trial.of), chatter, trial.tuned))
        return Table(("", "exceed", "chatter [N m]", "tuned"), rows, words=(3,))

    def _short(self) -> str:
        best = min(self.trials, key=lambda trial: trial.rank)
        return f"{best.family}, {'holds' if self.holds else 'does not hold'}; {len(self.trials)} families"

    def _shown(self) -> Iterator[Piece]:
        most = self.trials[0].allowed
        where = f"all but {most} of {self.fresh} samples" if most else "all samples"
        if not self.holds:
            yield Verdict(f"No controller keeps the limit on {where}; with this one the fewest exceed it.", False)
            near, quiet = (min(self.trials, key=key) for key in (lambda each: each.peak, lambda each: each.noise))
            yield f"least peak: {near.peak:.0f} pulses, {near.family} ({near.tuned})"
            yield f"least chatter: {quiet.chatter.max():.2g} N m, {quiet.family} ({quiet.tuned})"
        yield from (piece for piece in self.certificate._shown() if piece is not SEARCH)
        yield "the best tuning of each family, on independent validation samples:"
        yield self._table()

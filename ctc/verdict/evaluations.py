"""Evaluations of several motions, one row each; the table that they share with a comparison of controllers."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.parts.labels import joint_labels
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table

_COLUMNS = (
    ("within ±1", lambda e: e.share_within(1)),
    ("peak [pulses]", lambda e: _each(e.max_error_pulses, ".0f")),
    ("RMS [pulses]", lambda e: _each(e.rms_error_pulses, ".2f")),
    ("torque, RMS [N m]", lambda e: _each(e.rms_torque, ".1f")),
    ("chatter [N m]", lambda e: _each(e.chatter, ".1f")),
    ("at the limit", lambda e: f"{e.saturation.max():.2%}"),
)

_EACH = 3
"""Joints up to which a cell has a number for each; with more it has the largest."""


def _each(values: NDArray[np.float64], form: str) -> str:
    if len(values) > _EACH:
        return f"{values.max():{form}} q[{values.argmax()}]"
    return " / ".join(format(value, form) for value in values)


def overview(title: str, evaluations: Mapping[str, Any], notes: Mapping[str, str]) -> Iterator[Piece]:
    """One row for each `Evaluation`, notes on some by name, and what a cell holds."""
    rows = [[name, *(cell(evaluation) for _, cell in _COLUMNS)] for name, evaluation in evaluations.items()]
    if rows:
        yield Table([title, *(column for column, _ in _COLUMNS)], rows)
    yield from (f"{name}: {why}" for name, why in notes.items())
    joints = next((evaluation.joints for evaluation in evaluations.values()), ())
    if len(joints) > 1:
        cell = "a / b" if len(joints) <= _EACH else "largest of the joints, and which"
        yield f"{cell}: {', '.join(joint_labels(joints, len(joints)))}"
    if any(evaluation.record.rig.drive.elasticity is None for evaluation in evaluations.values()):
        yield "rigid gears assumed; .evaluations[name].lowest_resonance [Hz] says from where on it holds"


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Evaluations(Shown, Mapping[str, Any]):
    """Evaluations of one arm under one controller in several motions: name -> `Evaluation`. Print it for a table.

    Attributes
    ----------
    evaluations : dict of str -> Evaluation
    """

    evaluations: dict[str, Any]

    def __getitem__(self, name: str) -> Any:
        return self.evaluations[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.evaluations)

    def __len__(self) -> int:
        return len(self.evaluations)

    @property
    def worst(self) -> str:
        """Name of the motion with the largest encoder error; among equals, with the largest before rounding."""
        errors = {name: (e.max_error_pulses.max(), e.max_true_error_pulses.max()) for name, e in self.items()}
        return max(errors, key=errors.__getitem__)

    def within(self, k: float) -> bool:
        """Whether every joint's encoder error is within +-k pulses at every sample of every motion."""
        return all(evaluation.within(k) for evaluation in self.values())

    @property
    def holds(self) -> bool:
        """Whether all motions stay within ±1 pulse, and nothing says that a machine would not begin as they did."""
        return all(evaluation.holds for evaluation in self.values())

    def _short(self) -> str:
        inside = sum(evaluation.within(1) for evaluation in self.values())
        peak = self[self.worst].max_error_pulses.max()
        return f"{inside} of {len(self)} motions within ±1 pulse at every sample; the worst is {self.worst}, {peak:.0f}"

    def _shown(self) -> Iterator[Piece]:
        notes = {name: str(e.from_rest or e.refused) for name, e in self.items() if e.from_rest or e.refused}
        yield Verdict(self._short(), self.holds)
        yield from overview("motion", self, notes)

"""Hypotheses of a user's own about a record, judged with an arm and then without one.

A hypothesis is a row of a table, and changes a record. With an arm, the torque equation of the
changed record judges it, beside the library's own rows in `restated`. Rows that this does not
accept are judged by `record.check()`, which knows no arm, beside the rows of its table.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error.restated import candidates_of
from identification.equation_error.stated_equation import TorqueEquation
from plant import Dynamics, Hypothesis, Record
from plant.checkup import Cause, Experiment, Trials, ranking


class Tried(NamedTuple):
    """Causes that are rows of a user's own, the likeliest first, and rows that were left out.

    `failed`: a line for each row that changes nothing, or that failed, with the reason.
    """

    causes: tuple[Cause, ...]
    failed: tuple[str, ...]


class _WithArm(Experiment):
    """A record whose score is the log likelihood of its torque equation."""

    def __init__(self, record: Record, base: Any = None, dynamics: Any = None) -> None:
        super().__init__(record, base)
        self.dynamics = base.dynamics if base is not None else dynamics

    @functools.cached_property
    def equation(self) -> TorqueEquation | None:
        """The torque equation; None without a torque, or in too short a log."""
        return TorqueEquation.of(self.dynamics, self.record)

    @property
    def score(self) -> float:
        """Log likelihood of the record by the torque equation of its arm."""
        return -np.inf if self.equation is None else self.equation.evidence


def ranked_own_rows(
    dynamics: Dynamics, record: Record, hypotheses: Sequence[Hypothesis[Any]]
) -> Tried:
    """Rank the hypotheses of a user's own, with an arm and then without one."""
    by_name = {hypothesis.name: hypothesis for hypothesis in hypotheses}
    # 1. With the arm, which knows most. A row's own evidence, and its place among the checks, are
    # for `record.check()` alone.
    trials = Trials([replace(row, evidence=None, check="") for row in hypotheses])

    def candidates(experiment):
        if isinstance(experiment, TorqueEquation):
            yield from candidates_of(experiment)
        elif experiment.equation is not None:
            yield from trials(experiment)
            # Beside the library's rows: a user's row must not stand for a likelier mistake.
            yield from candidates_of(experiment.equation)

    labels = tuple(dynamics.chain.joint_labels)
    # A correction that was accepted is applied before the next one is tried.
    ranked = ranking(_WithArm(record, dynamics=dynamics), candidates, labels)
    causes = {cause.name: cause for cause in ranked.causes if cause.name in by_name}
    # `record.check()` goes on from the record as the accepted rows have changed it.
    for experiment in ranked.experiments:
        if isinstance(experiment, _WithArm):
            record = experiment.record

    # 2. The rows that were not accepted, by what the checkup knows: the record's law and reference.
    checkup = record.check(hypotheses=[row for row in hypotheses if row.name not in causes])
    causes |= {cause.name: cause for cause in checkup.causes if cause.name in by_name}
    # A row that failed in both for one reason is named once.
    failed = {f"{name}: {reason}": None for name, reason in trials.failed.items()}
    return Tried((*causes.values(),), (*(failed | dict.fromkeys(checkup.failed)),))

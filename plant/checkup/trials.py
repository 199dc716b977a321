"""Rows of the table, tried on a log: each with its likeliest size, and its log odds."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from plant.checkup.hypothesis import Candidate, Hypothesis, columns_of
from plant.checkup.law_motion import contradicted_by_motion
from plant.checkup.score import SETTINGS, Experiment
from plant.checkup.without_arm import TABLE

# Share of its evidence by which a refined size must be better.
_RUGGED = 0.03


@dataclass
class Trials:
    """Tries every row of a table on a log."""

    table: Sequence[Hypothesis[Any]] = TABLE
    failed: dict[str, str] = field(default_factory=dict)

    def __call__(self, experiment: Experiment) -> Iterator[Candidate]:
        """Candidates of all rows, each with its likeliest size."""
        for hypothesis in self.table:
            for joints in hypothesis.scope(experiment.n):
                try:
                    yield from self._candidates(experiment, hypothesis, joints)
                except ValueError as error:
                    self._note_failure(hypothesis, f"cannot be undone in this log: {error}")
                except Exception as error:  # of a user's own function
                    if hypothesis in TABLE:
                        raise
                    self._note_failure(hypothesis, f"failed: {error!r}")

    def _note_failure(self, hypothesis, reason):
        """Note why a user's own hypothesis fails; a built-in one need not concern every log."""
        if hypothesis not in TABLE:
            self.failed[hypothesis.name] = reason

    def _candidates(self, experiment, hypothesis, joints):
        def changed(size):
            record = hypothesis.undo(experiment.record, joints, size)
            # A function of a user's own may change the log in place, or forget its `return`.
            if not isinstance(record, type(experiment.record)):
                raise ValueError(f"its undo must give a Record; got {record!r:.60}")
            if record == experiment.record:
                self._note_failure(hypothesis, "changes nothing in this log")
            return experiment.changed(record)

        own = hypothesis.evidence and hypothesis.evidence(experiment, joints)
        scored = own is None
        evidence = self._scored(experiment, hypothesis, joints, changed) if scored else own
        names = _column_names(experiment, joints)
        for size, gain in evidence:
            if not scored:
                # This raises a ValueError where the log cannot have this mistake.
                undone = changed(size)
                # The larger of its own evidence and that of the score counts: the score sees more
                # of a large mistake.
                if hypothesis.scored:
                    gain = max(gain, experiment.gain(undone, gain))
            odds = gain - hypothesis.against
            if odds > 0 and contradicted_by_motion(experiment, changed(size), joints):
                continue
            words = {**names, **_shift(size), "inverse": 1 / size if size else np.inf}
            yield Candidate(hypothesis, joints, size, odds, partial(changed, size), words)

    def _scored(self, experiment, hypothesis, joints, changed):
        """The likeliest size, and how much likelier the log is without a mistake of that size."""
        # Here, since it is slow to import.
        from scipy.optimize import minimize_scalar

        sizes = hypothesis.sizes
        if hypothesis.suggested is not None:
            sizes = hypothesis.suggested(experiment, joints)
        if not sizes:
            return []

        def gain(size):
            return changed(float(size)).score - experiment.score

        gains = [experiment.gain(changed(float(size)), hypothesis.against) for size in sizes]
        best = int(np.argmax(gains))
        size, most = float(sizes[best]), gains[best]
        if most <= hypothesis.against:
            return [(size, most)]
        # A mistake of some joints shows in these, and not in others alone.
        if joints and sum(_gains(experiment, changed(size), joints).values()) < 0:
            return []
        # Where the arm is stated wrongly, the torque of a law that knows the arm is a little nearer
        # to the logged one at another scale. So is that of fast hardware in a limit cycle.
        scale = hypothesis.check in ("units of torque", "units of gains", "quantisation step")
        if scale and not _explains(experiment, changed(size), joints):
            return []
        delay = hypothesis.check == "delay"
        # A shift of less than a sample may come from hardware that reads its counter beside the
        # logged instant. It counts as a delay only if it passes the tests of `_passes_as_delay`.
        if delay and abs(size) < 1 and not _passes_as_delay(experiment, changed(size), joints):
            return []
        tolerance = hypothesis.tolerance
        if tolerance is None:
            return [(size, most)]
        # If only the motion shows a delay and the best size is the longest one tried, the gain
        # has another cause.
        if delay and best == len(sizes) - 1 and _silent(experiment, joints):
            return []
        grid_of_sizes = len(sizes) > 1
        if grid_of_sizes:
            ends = sizes[max(best - 1, 0)], sizes[min(best + 1, len(sizes) - 1)]
            # A law tells a scale within its grid to far less than its tolerance.
            options = {"xatol": 1e-3 * min(tolerance, ends[1] - ends[0]), "maxiter": 14}
            result = minimize_scalar(
                lambda size: -gain(size), bounds=ends, method="bounded", options=options
            )
            # Rounding makes the score rugged: a size of the grid stays unless another is clearly
            # better.
            if -result.fun > (1 + _RUGGED) * most:
                size, most = float(result.x), -float(result.fun)
        # A shift by part of a row interpolates between two rows, which averages their noise. That
        # gain is the same on both sides of a whole number. Only the gain beyond that of the
        # mirrored shift is evidence: mirrored at the nearest whole number, for a delay that is no
        # whole number; mirrored at zero, for the direction of the delay.
        peak = most
        if delay:
            whole = hypothesis.whole and round(size)
            if whole and most - gain(2 * whole - size) < hypothesis.against:
                size, most = float(whole), gain(whole)
                peak = most
            most -= max(gain(-size), 0.0)
        # Occam: a size that the log determines well was unlikely to be just that.
        unit = 1.0 if grid_of_sizes else size
        step = 0.02 * tolerance * unit
        curvature = (2 * peak - gain(size + step) - gain(size - step)) / step**2
        occam = np.log1p((tolerance * unit) ** 2 * max(curvature, 0.0)) / 2
        return [(size, most - occam)]


def _gains(before, after, joints):
    """How much each term of the score gains by a change: of these joints, or of all."""
    chosen = columns_of(joints)
    return {
        name: (after.terms[name] - before.terms[name])[chosen].sum()
        for name in after.terms
        if name in before.terms
    }


def _passes_as_delay(before, after, joints):
    """Whether a delay of these joints, or of all, passes the tests that the log allows."""
    # Without a torque of the law only the motion shows a delay, so the motion must give most of the
    # gain. The prior alone is no evidence: a shift can make an inertia uncertain, and an uncertain
    # inertia has a likelier prior.
    if before.torques_of_law is None and before.signals.torque is not None:
        gains = _gains(before, after, joints)
        return bool(gains.get("motion", 0.0) > _EXPLAINED * sum(gains.values()))
    # Two other causes look like a small delay. Fast hardware may read its counter beside the logged
    # instant. A law that did not make the log may come a little nearer to it with late counts.
    return _explains(before, after, joints)


def _explains(before, after, joints):
    """Whether a change explains most of the difference between the law's torque and the logged one.

    True where no law tells a torque.
    """
    if before.command is None or after.command is None:
        return True
    chosen = columns_of(joints)
    # What is unlike the logged torque explains nothing of it.
    return any(
        changed[chosen].mean() < min(_EXPLAINED * stated[chosen].mean(), SETTINGS.unlike)
        for stated, changed in (
            (before.command, after.command),
            (before.slow_command, after.slow_command),
        )
        if stated is not None
    )


# Undoing a mistake must leave less than this share of the difference between the logged torque and
# the law's. If only the motion shows the delay, the motion must give more than this share of the
# evidence.
_EXPLAINED = 0.5


def _silent(experiment, joints):
    """Whether no law tells a torque of these joints: none is stated, or noise hides its steps."""
    command = experiment.command
    return command is None or bool((command[columns_of(joints)] > SETTINGS.unlike).all())


def _shift(samples):
    """A delay in words, and the option of `Record.from_csv` that puts late torques right."""
    amount = f"{abs(samples):.3g}" if abs(samples) > 10 else f"{abs(samples):.2g}"
    unit = "sample" if amount == "1" else "samples"
    option = ""
    # An export is late by whole rows.
    if samples > 0 and amount.isdigit():
        option = (
            f": torque_delay={amount} of Record.from_csv, or torque_delay = {amount} in the table"
            " [log] of the robot file"
        )
    return {"shift": f"{amount} {unit} {'late' if samples > 0 else 'early'}", "option": option}


def _column_names(experiment, joints):
    """Names of the columns of the first joint in messages."""
    signals = experiment.signals
    joint = joints[0] if joints else 0
    names = {
        name: signals.column(name, joint) for name in ("torque", "counts", "reference", "error")
    }
    # The sign of the gear decides which direction of the joint a current drives.
    if experiment.record.torque is None:
        names["torque"] += ", or of the gear"
    if signals.reference is None:
        names["torque"] += ", of the counts or of the gear"
    # The convention that is not stated.
    if experiment.record.rig.encoder.rounding == "fix":
        return names | {"cell": "no wide cell", "rounding": '"floor"'}
    return names | {"cell": "a cell two pulses wide", "rounding": '"fix"'}

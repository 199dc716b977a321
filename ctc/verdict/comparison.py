"""Several laws on one arm and one reference: one table, one figure."""

from __future__ import annotations

import dataclasses

from ctc.figures import plot_comparison
from ctc.verdict.evaluation import evaluate
from plant import DivergenceError, Law
from plant.parts.arguments import instance, known_options

__all__ = ["Comparison", "compare"]

_COLUMNS = (
    ("within +-1", lambda e: e.share_within(1)),
    ("peak [pulses]", lambda e: _each(e.max_error_pulses, ".0f")),
    ("RMS [pulses]", lambda e: _each(e.rms_error_pulses, ".2f")),
    ("torque, RMS [N m]", lambda e: _each(e.rms_torque, ".1f")),
    ("chatter [N m]", lambda e: _each(e.chatter, ".1f")),
    ("at the limit", lambda e: f"{e.saturation.max():.2%}"),
)


def _each(values, form):
    return " / ".join(format(value, form) for value in values)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Verdicts of several laws on the same arm and reference.

    Print it for a table with one row per law and, in a cell, one number per joint; chatter is the mean change of the
    torque from one sample to the next, "at the limit" the share of the samples of the joint that is there most.

    Attributes
    ----------
    evaluations : dict of str -> Evaluation
        By the name of the law, in the order given, without those that diverged.
    diverged : dict of str -> str
        What is to be said of the laws under which the loop did not stay bounded.
    """

    evaluations: dict
    diverged: dict

    def plot(self):
        """Draw the errors of all laws that stayed bounded; see `ctc.figures.plot_comparison`."""
        return plot_comparison(self.evaluations)

    def __str__(self):
        names = [*self.evaluations, *self.diverged]
        width = max(len(name) for name in [*names, "law"])
        joints = next((evaluation.joints for evaluation in self.evaluations.values()), ())
        rows = [[cell(evaluation) for _, cell in _COLUMNS] for evaluation in self.evaluations.values()]
        columns = zip(*([title for title, _ in _COLUMNS], *rows), strict=True)
        wide = [2 + max(map(len, column)) for column in columns]
        lines = [
            f"{name:<{width}}" + "".join(f"{cell:>{space}}" for cell, space in zip(cells, wide, strict=True))
            for name, cells in zip(["law", *self.evaluations], [[title for title, _ in _COLUMNS], *rows], strict=True)
        ]
        lines += [f"{name:<{width}}  {why}" for name, why in self.diverged.items()]
        return "\n".join([*lines, f"a / b: joints {', '.join(joints)}"] if len(joints) > 1 else lines)


@known_options
def compare(laws, arm, rig, reference, *, backend="numba", duration=None, steps_per_sample=16, initial=None):
    """Evaluate several laws on one arm and one reference.

    Parameters
    ----------
    laws : dict of str -> Law
        By the name that each is to have in the table.
    arm : Arm
        The true arm, as far as anyone knows it.
    rig : Rig
    reference : Reference
    backend : {"numba", "casadi"}
        As in `ctc.evaluate`.
    duration : float, optional
        [s]; by default one period of the reference.
    steps_per_sample : int
        Integration steps between two samples.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.

    Returns
    -------
    Comparison
        A law under which the loop diverges is a row of its table.

    Raises
    ------
    ValueError
        Bad input.
    """
    if not isinstance(laws, dict) or not laws or not all(isinstance(name, str) for name in laws):
        raise ValueError(f"laws must be a dict of name -> Law; got {laws!r:.60}. Pass {{'P': p_law, ...}}.")
    evaluations, diverged = {}, {}
    for name, law in laws.items():
        instance(f"law {name!r}", law, Law, "Pass {'P': p_law, ...}.")
    for name, law in laws.items():
        try:
            evaluations[name] = evaluate(
                arm, rig, law, reference,
                backend=backend, duration=duration, steps_per_sample=steps_per_sample, initial=initial,
            )  # fmt: skip
        except DivergenceError as error:
            diverged[name] = str(error)
    return Comparison(evaluations=evaluations, diverged=diverged)

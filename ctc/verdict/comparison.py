"""Several controllers on one arm and one reference: one table, one figure."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from numpy.typing import ArrayLike, NDArray

from ctc.figures.errors import plot_comparison
from ctc.verdict.evaluation import Evaluation
from ctc.verdict.evaluations import evaluate, overview
from plant import Arm, DivergenceError, Law, Reference, Rig
from plant.parts.arguments import instance, known_options
from plant.parts.shown import Piece, Shown, Verdict


def require_laws(laws: Any) -> None:
    """Refuse what is no dict of name -> Law."""
    if not isinstance(laws, dict) or not laws or not all(isinstance(name, str) for name in laws):
        raise ValueError(f"laws must be a dict of name -> Law; got {laws!r:.60}. Pass {{'P': p_law, ...}}.")
    for name, law in laws.items():
        instance(f"law {name!r}", law, Law, "Pass {'P': p_law, ...}.")


_SHORT = 70  # letters of its `repr` that name each controller


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Shown):
    """Evaluations of several controllers on the same arm and reference.

    Print it for a table with one row per controller and, in a cell, one number per joint, or of more than three joints
    the largest; chatter is the mean change of the torque from one sample to the next, "at the limit" the share of the
    samples at the amplifier's limit, of the joint that is there most.

    `evaluations`: by the name of the controller, in the order given, without those that diverged. `diverged`: by name,
    when and where the loop under a controller diverged.
    """

    evaluations: dict[str, Evaluation]
    diverged: dict[str, str]

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the errors of all controllers with bounded errors: (n, laws) Axes of up to four, (laws, n) of more."""
        return plot_comparison(self.evaluations, ax)

    def _short(self) -> str:
        shares = [f"{name} {evaluation.share_within(1)}" for name, evaluation in self.evaluations.items()]
        said = ", ".join([*shares, *(f"{name} diverges" for name in self.diverged)])
        return said if len(said) <= _SHORT else f"{len(shares)} controllers, {len(self.diverged)} diverged"

    def _shown(self) -> Iterator[Piece]:
        inside = {name: evaluation for name, evaluation in self.evaluations.items() if evaluation.within(1)}
        moving = {name: evaluation.from_rest for name, evaluation in inside.items() if evaluation.from_rest is not None}
        count = len(self.evaluations) + len(self.diverged)
        which = f": {', '.join(inside)}" if inside else ""
        said = f"{len(inside)} of {count} controllers within ±1 pulse at every sample{which}"
        yield Verdict(said, len(inside) > len(moving))
        notes = {**self.diverged, **{name: str(why) for name, why in moving.items()}}
        yield from overview("law", self.evaluations, notes)


@known_options
def compare(
    arm: Arm, rig: Rig, laws: dict[str, Law], reference: Reference, *, backend: str = "numba",
    duration: float | None = None, steps_per_sample: int = 16, initial: ArrayLike | None = None,
) -> Comparison:  # fmt: skip
    """Evaluate several controllers on one arm and one reference.

    Parameters
    ----------
    arm : Arm
        The arm that is controlled.
    rig : Rig
    laws : dict of str -> Law
        By the name that each is to have in the table.
    reference : Reference
    backend, duration, steps_per_sample, initial
        As of `ctc.evaluate`.

    Returns
    -------
    Comparison
        A controller under which the loop diverges is a row of its table.

    Raises
    ------
    ValueError
        Bad input.

    See Also
    --------
    ctc.evaluate

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, compare
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> laws = {"P": puma560.p_law(), "computed torque": ComputedTorque(arm, rig)}
    >>> list(compare(arm, rig, laws, puma560.reference(), duration=0.3).evaluations)
    ['P', 'computed torque']
    """
    require_laws(laws)
    evaluations, diverged = {}, {}
    for name, law in laws.items():
        try:
            evaluations[name] = evaluate(
                arm, rig, law, reference,
                backend=backend, duration=duration, steps_per_sample=steps_per_sample, initial=initial,
            )  # fmt: skip
        except DivergenceError as error:
            diverged[name] = str(error)
    return Comparison(evaluations=evaluations, diverged=diverged)

"""`evaluate`: one arm under one controller, on one path or in several motions; `compare`: under
several controllers.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ctc.figures.errors import plot_comparison
from ctc.verdict.evaluation import Evaluation
from plant import Arm, Law, Reference, Rig
from plant.motion.everyday import motions_of, naming, of_motion
from plant.parts.arguments import choice, instance, known_options
from plant.parts.shown import Piece, Shown, Verdict
from plant.parts.tables import Table
from plant.simulation.logged_run import DivergenceError
from plant.simulation.simulator import Injected, run

_COLUMNS = (
    ("within ±1", lambda e: e.share_within(1)),
    ("peak [pulses]", lambda e: _each(e.max_error_pulses, ".0f")),
    ("RMS [pulses]", lambda e: _each(e.rms_error_pulses, ".2f")),
    ("torque, RMS [N m]", lambda e: _each(e.rms_torque, ".1f")),
    ("chatter [N m]", lambda e: _each(e.chatter, ".1f")),
    ("at the limit", lambda e: f"{e.saturation.max():.2%}"),
)

_EACH = 3  # joints up to which a cell has a number for each; with more it has the largest


def _each(values: NDArray[np.float64], form: str) -> str:
    if len(values) > _EACH:
        return f"{values.max():{form}} q[{values.argmax()}]"
    return " / ".join(format(value, form) for value in values)


def overview(
    title: str, evaluations: Mapping[str, Evaluation], notes: Mapping[str, str]
) -> Iterator[Piece]:
    """One row for each `Evaluation`, notes on some by name, and what a cell holds."""
    rows = [
        [name, *(cell(evaluation) for _, cell in _COLUMNS)]
        for name, evaluation in evaluations.items()
    ]
    if rows:
        yield Table([title, *(column for column, _ in _COLUMNS)], rows)
    yield from (f"{name}: {why}" for name, why in notes.items())
    labels = next((evaluation.joint_labels for evaluation in evaluations.values()), [])
    if len(labels) > 1:
        cell = "a / b" if len(labels) <= _EACH else "largest of the joints, and which"
        yield f"{cell}: {', '.join(labels)}"
    if any(evaluation.record.rig.drive.elasticity is None for evaluation in evaluations.values()):
        yield (
            "rigid gears assumed; .evaluations[name].lowest_resonance [Hz] is that from which on it"
            " holds"
        )


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Evaluations(Shown, Mapping[str, Evaluation]):
    """Evaluations of one arm under one controller in several motions: name -> `Evaluation`.
    Print it for a table.
    """

    evaluations: dict[str, Evaluation]

    def __getitem__(self, name: str) -> Evaluation:
        return of_motion(self.evaluations, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.evaluations)

    def __len__(self) -> int:
        return len(self.evaluations)

    @property
    def worst(self) -> str:
        """Name of the motion with the largest encoder error; among equals, with the largest
        before rounding.
        """
        errors = {
            name: (e.max_error_pulses.max(), e.max_true_error_pulses.max())
            for name, e in self.items()
        }
        return max(errors, key=errors.__getitem__)

    def within(self, k: float) -> bool:
        """Whether every joint's encoder error is within +-k pulses at every sample of every
        motion.
        """
        return all(evaluation.within(k) for evaluation in self.values())

    @property
    def holds(self) -> bool:
        """Whether all motions stay within ±1 pulse, and nothing says that a machine would not
        begin as they did.
        """
        return all(evaluation.holds for evaluation in self.values())

    def _short(self) -> str:
        inside = sum(evaluation.within(1) for evaluation in self.values())
        peak = self[self.worst].max_error_pulses.max()
        return (
            f"{inside} of {len(self)} motions within ±1 pulse at every sample; the worst is"
            f" {self.worst}, {peak:.0f}"
        )

    def _shown(self) -> Iterator[Piece]:
        notes = {
            name: str(e.from_rest or e.refused)
            for name, e in self.items()
            if e.from_rest or e.refused
        }
        yield Verdict(self._short(), self.holds)
        yield from overview("motion", self, notes)


@overload
def evaluate(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference,
    *,
    backend: str = ...,
    duration: float | None = ...,
    steps_per_sample: int = ...,
    initial: ArrayLike | None = ...,
    injected: Injected | None = ...,
) -> Evaluation: ...
@overload
def evaluate(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Mapping[str, Reference],
    *,
    backend: str = ...,
    duration: float | None = ...,
    steps_per_sample: int = ...,
    initial: ArrayLike | None = ...,
    injected: Injected | None = ...,
) -> Evaluations: ...
@known_options
def evaluate(
    arm: Arm,
    rig: Rig,
    law: Law,
    reference: Reference | Mapping[str, Reference],
    *,
    backend: str = "casadi",
    duration: float | None = None,
    steps_per_sample: int = 16,
    initial: ArrayLike | None = None,
    injected: Injected | None = None,
) -> Evaluation | Evaluations:
    """Simulate an arm under a controller, and measure the tracking error in encoder pulses.

    Parameters
    ----------
    arm : Arm
        The arm that is controlled; its f need not be the controller's.
    rig : Rig
    law : Law
    reference : Reference, or mapping of str -> Reference
        Or several motions by name, such as `plant.everyday_motions`, each inside limits and torque.
    backend : {"casadi", "numba"}
        casadi evaluates the closed-loop step by `mapaccum`; the compiled kernel must give the same
        verdict.
    duration : float, optional
        Of each motion [s]; by default one period of the reference.
    steps_per_sample : int
        Integration steps between two samples.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.
    injected : (N, n) array_like or callable, optional
        Known torque beside the controller's, as for `plant.simulate`.

    Returns
    -------
    Evaluation
        Print it for a table; ``.within(1)`` is the verdict. Of a mapping `Evaluations`: a row for
        each motion, an `Evaluation` by name, and ``.worst``, its name.

    Raises
    ------
    ValueError
        Bad input, or a loop that diverges; a motion of a mapping that exceeds limits or torque,
        with the factor by which to slow it down.

    See Also
    --------
    ctc.Evaluation, ctc.compare, ctc.certify, plant.everyday_motions

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> evaluate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.5).within(1)
    True
    """
    choice("backend", backend, ("casadi", "numba"))

    def along(motion: Reference) -> Evaluation:
        trace = run(
            arm, rig, law, motion, duration, steps_per_sample, initial, backend, injected=injected
        )
        return Evaluation(arm=arm, record=trace.record, true_error_pulses=trace.true_error_pulses)

    if not isinstance(reference, Mapping):
        return along(reference)
    found = dict[str, Evaluation]()
    for name, motion in motions_of(
        arm, rig, reference, "The order is arm, rig, law, reference."
    ).items():
        with naming(name):
            found[name] = along(motion)
    return Evaluations(evaluations=found)


def require_laws(laws: Any) -> None:
    """Refuse what is no dict of name -> Law."""
    if not isinstance(laws, dict) or not laws or not all(isinstance(name, str) for name in laws):
        raise ValueError(
            f"laws must be a dict of name -> Law; got {laws!r:.60}. Pass {{'P': p_law, ...}}."
        )
    for name, law in laws.items():
        instance(f"law {name!r}", law, Law, "Pass {'P': p_law, ...}.")


_SHORT = 70  # letters of its `repr` that name each controller


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Shown):
    """Evaluations of several controllers on the same arm and reference.

    Print it for a table with one row per controller and, in a cell, one number per joint, or of
    more than three joints the largest; chatter is the mean change of the torque from one sample to
    the next, "at the limit" the share of the samples at the amplifier's limit, of the joint that is
    there most.

    Attributes
    ----------
    evaluations : dict of str -> Evaluation
        By the name of the controller, in the order given, without those that diverged.
    diverged : dict of str -> str
        By name, when and where the loop under a controller diverged.
    """

    evaluations: dict[str, Evaluation]
    diverged: dict[str, str]

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the errors of all controllers with bounded errors: (n, laws) Axes of up to four,
        (laws, n) of more.
        """
        return plot_comparison(self.evaluations, ax)

    def _short(self) -> str:
        shares = [
            f"{name} {evaluation.share_within(1)}" for name, evaluation in self.evaluations.items()
        ]
        said = ", ".join([*shares, *(f"{name} diverges" for name in self.diverged)])
        return (
            said
            if len(said) <= _SHORT
            else f"{len(shares)} controllers, {len(self.diverged)} diverged"
        )

    def _shown(self) -> Iterator[Piece]:
        inside = {
            name: evaluation
            for name, evaluation in self.evaluations.items()
            if evaluation.within(1)
        }
        moving = {
            name: evaluation.from_rest
            for name, evaluation in inside.items()
            if evaluation.from_rest is not None
        }
        count = len(self.evaluations) + len(self.diverged)
        which = f": {', '.join(inside)}" if inside else ""
        said = f"{len(inside)} of {count} controllers within ±1 pulse at every sample{which}"
        yield Verdict(said, len(inside) > len(moving))
        notes = {**self.diverged, **{name: str(why) for name, why in moving.items()}}
        yield from overview("law", self.evaluations, notes)


@known_options
def compare(
    arm: Arm,
    rig: Rig,
    laws: dict[str, Law],
    reference: Reference,
    *,
    backend: str = "numba",
    duration: float | None = None,
    steps_per_sample: int = 16,
    initial: ArrayLike | None = None,
) -> Comparison:
    """Evaluate several controllers on one arm and one reference.

    Parameters
    ----------
    laws : dict of str -> Law
        By the name that each is to have in the table.
    arm, rig, reference, backend, duration, steps_per_sample, initial
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
    evaluations = {}
    diverged = {}
    for name, law in laws.items():
        try:
            evaluations[name] = evaluate(
                arm,
                rig,
                law,
                reference,
                backend=backend,
                duration=duration,
                steps_per_sample=steps_per_sample,
                initial=initial,
            )
        except DivergenceError as error:
            diverged[name] = str(error)
    return Comparison(evaluations=evaluations, diverged=diverged)

"""`evaluate`: an arm under a controller, on a path or in several motions; `compare` controllers."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypedDict, Unpack, overload

from numpy.typing import ArrayLike, NDArray

from ctc.figures import plot_comparison, plot_motions
from ctc.verdict.evaluation import Evaluation
from plant import Arm, Law, Reference, Rig
from plant.motion import motions_of, naming, of_motion
from plant.parts import (
    Floats,
    Piece,
    Shown,
    Table,
    Verdict,
    choice,
    frozen,
    heading,
    instance,
    known_options,
    largest,
    significant,
    with_units,
)
from plant.simulation import DivergenceError, Injected, run

# Head of the columns with a number for each joint, the numbers of an `Evaluation`, their form, and
# whether they are torques.
_COLUMNS: tuple[tuple[str, Callable[[Evaluation], Floats], Callable[[float], str], bool], ...] = (
    ("peak", lambda e: e.max_error_pulses, "{:.0f}".format, False),
    ("RMS", lambda e: e.rms_error_pulses, "{:.2f}".format, False),
    ("torque, RMS", lambda e: e.rms_torque, significant, True),
    ("chatter", lambda e: e.chatter, significant, True),
)

# Joints up to which a cell has a number for each: four would not fit into 80 letters a line.
_JOINTS = 3


def _cell(values: Floats, form: Callable[[float], str], units: Sequence[str]) -> str:
    """Numbers of all joints, or of many joints the largest and its joint."""
    cells = with_units(map(form, values), units)
    if len(cells) > _JOINTS:
        return ", ".join(f"{cells[joint]} q[{joint}]" for joint in largest(values, units))
    return " / ".join(cells)


def overview(
    title: str, evaluations: Mapping[str, Evaluation], notes: Mapping[str, str]
) -> Iterator[Piece]:
    """One row for each `Evaluation`, notes by name, and the meaning of a cell."""
    # All evaluations are of one arm. There is none where every loop diverged.
    first = next(iter(evaluations.values()), None)
    labels = [] if first is None else first.joint_labels
    if first is not None:
        efforts = first.arm.dynamics.chain.effort_units
        pulses = ["pulses"] * len(labels)
        # Columns come from one table, so heads and cells cannot differ.
        columns = [
            (head, numbers, form, efforts if torques else pulses)
            for head, numbers, form, torques in _COLUMNS
        ]
        rows = [
            [
                name,
                evaluation.share_within(1),
                *(_cell(numbers(evaluation), form, units) for _, numbers, form, units in columns),
                f"{evaluation.saturation.max():.2%}",
            ]
            for name, evaluation in evaluations.items()
        ]
        heads = [heading(head, units) for head, _, _, units in columns]
        yield Table([title, "within ±1", *heads, "at the limit"], rows)
    for name, note in notes.items():
        yield f"{name}: {note}"
    if len(labels) > 1:
        cell = "a / b" if len(labels) <= _JOINTS else "largest of the joints, and which"
        yield f"{cell}: {', '.join(labels)}"
    # On elastic gears of the rig itself nothing is assumed.
    if any(evaluation.record.rig.drive.elasticity is None for evaluation in evaluations.values()):
        yield (
            "rigid gears assumed; above .evaluations[name].lowest_resonance [Hz] a controller holds"
            " on elastic gears, too"
        )


@frozen
class Evaluations(Shown, Mapping[str, Evaluation]):
    """Evaluations of one arm in several motions: name -> `Evaluation`. Print it for a table."""

    evaluations: dict[str, Evaluation]

    def __getitem__(self, name: str) -> Evaluation:
        return of_motion(self.evaluations, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self.evaluations)

    def __len__(self) -> int:
        return len(self.evaluations)

    @property
    def worst(self) -> str:
        """Name of the motion with the largest encoder error, then the largest true error."""
        # Whole pulses tie often; the true error decides among equals.
        errors = {
            name: (e.max_error_pulses.max(), e.max_true_error_pulses.max())
            for name, e in self.items()
        }
        return max(errors, key=errors.__getitem__)

    def within(self, k: float) -> bool:
        """Whether every joint stays within +-k pulses at every sample of every motion."""
        return all(evaluation.within(k) for evaluation in self.values())

    @property
    def holds(self) -> bool:
        """Whether all motions stay within ±1 pulse, and a machine would begin as they did."""
        return all(evaluation.holds for evaluation in self.values())

    def plot(self, ax: Any = None) -> NDArray[Any]:
        """Draw the errors of all joints in each motion on (motions,) Axes."""
        return plot_motions(self.evaluations, ax)

    def _short(self) -> str:
        inside = sum(evaluation.within(1) for evaluation in self.values())
        peak = self[self.worst].max_error_pulses.max()
        return (
            f"{inside} of {len(self)} motions within ±1 pulse at every sample; the worst is"
            f" {self.worst}, {peak:.0f}"
        )

    def _shown(self) -> Iterator[Piece]:
        # One note for each motion; the start from rest comes before the refusal of the controller.
        notes = {name: e.reasons[0] for name, e in self.items() if e.reasons}
        yield Verdict(self._short(), self.holds)
        yield from overview("motion", self, notes)


class Options(TypedDict, total=False):
    """Options of `evaluate`, for the types of its calls."""

    backend: str
    duration: float | None
    steps_per_sample: int
    initial: ArrayLike | None
    injected: Injected | None


@overload
def evaluate(
    arm: Arm, rig: Rig, law: Law, reference: Reference, **options: Unpack[Options]
) -> Evaluation: ...
@overload
def evaluate(
    arm: Arm, rig: Rig, law: Law, reference: Mapping[str, Reference], **options: Unpack[Options]
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
        casadi evaluates the closed-loop step by `mapaccum`; the compiled kernel gives the same
        verdict.
    duration : float, optional
        Of each motion [s]; by default one period of the reference.
    steps_per_sample : int
        Integration steps between two samples.
    initial : (2, n) array_like, optional
        Position [rad] and velocity [rad/s] at t = 0; by default those of the reference.
    injected : (N, n) array_like or callable, optional
        Torque in addition to the controller's, as for `plant.simulate`.

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

    # The same loop along one motion, or each of a set.
    def along(motion: Reference) -> Evaluation:
        trace = run(
            arm, rig, law, motion, duration, steps_per_sample, initial, backend, injected=injected
        )
        return Evaluation(arm=arm, record=trace.record, true_error_pulses=trace.true_error_pulses)

    if not isinstance(reference, Mapping):
        return along(reference)
    evaluations = dict[str, Evaluation]()
    # Motions beyond limits or torque are refused before the first run.
    motions = motions_of(arm, rig, reference, "The order is arm, rig, law, reference.")
    for name, motion in motions.items():
        with naming(name):  # errors name the motion
            evaluations[name] = along(motion)
    return Evaluations(evaluations=evaluations)


def require_laws(laws: Any) -> None:
    """Refuse laws that are no dict of name -> Law."""
    # Names are heads of rows.
    if not isinstance(laws, dict) or not laws or not all(isinstance(name, str) for name in laws):
        raise ValueError(
            f"laws must be a dict of name -> Law; got {laws!r:.60}. Pass {{'P': p_law, ...}}."
        )
    for name, law in laws.items():
        instance(f"law {name!r}", law, Law, "Pass {'P': p_law, ...}.")


@frozen
class Comparison(Shown):
    """Evaluations of several controllers on the same arm and reference.

    Print it for a table with one row per controller. A cell has one number per joint, or of more
    than three joints the largest. Chatter is the mean change of the torque from one sample to the
    next, "at the limit" the largest share of samples of a joint at the amplifier's limit.

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
        """Draw bounded errors of all controllers on (n, laws) Axes, (laws, n) of more than four."""
        return plot_comparison(self.evaluations, ax)

    def _short(self) -> str:
        # Shares of samples, not largest errors: they compare controllers that all leave the limit.
        shares = [
            f"{name} {evaluation.share_within(1)}" for name, evaluation in self.evaluations.items()
        ]
        names = ", ".join([*shares, *(f"{name} diverges" for name in self.diverged)])
        # A `repr` is one line: of many controllers only their numbers.
        if len(names) <= 70:
            return names
        return f"{len(shares)} controllers, {len(self.diverged)} diverged"

    def _shown(self) -> Iterator[Piece]:
        inside = {name: e for name, e in self.evaluations.items() if e.within(1)}
        # How a machine would begin matters only for those that hold in motion.
        reasons = {name: e.reasons[0] for name, e in inside.items() if e.reasons}
        # Those that diverged count among all, since they were asked to hold as well.
        count = len(self.evaluations) + len(self.diverged)
        names = f": {', '.join(inside)}" if inside else ""
        verdict = f"{len(inside)} of {count} controllers within ±1 pulse at every sample{names}"
        # It is positive if a machine would begin as one of them did.
        yield Verdict(verdict, len(inside) > len(reasons))
        yield from overview("law", self.evaluations, self.diverged | reasons)


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
        By name in the table.
    arm, rig, reference, backend, duration, steps_per_sample, initial
        As of `ctc.evaluate`, which alone takes several motions.

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
    # A wrong law is refused before the first run, and so is a set of motions.
    require_laws(laws)
    instance("reference", reference, Reference, "Give one motion; evaluate takes several.")
    # In the order given, which is that of the rows and the colours.
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
        # Controllers are compared to find such ones, so a divergence is a result and no error.
        except DivergenceError as error:
            diverged[name] = str(error)
    return Comparison(evaluations=evaluations, diverged=diverged)

"""What a method of identification gives: an `Outcome`, with its `Fit`.

A fit of elastic gears has a `GearResonance`. A result keeps the fit, and the course of the search
as a `Search`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import field, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from identification.equation_error import BetweenRuns, Prior, Resumption, covariance_of
from identification.search.genetic import GeneticResult, GeneticSettings
from identification.search.problem import Problem, Tolerances
from plant.parts import Floats, Frozen, Piece, Shown, Table, Verdict, Warned, frozen, kept


@kept
@frozen
class GearResonance(Shown, Frozen):
    """Locked-rotor resonances of elastic gears, in the pose where the reference begins.

    A gear of stiffness k_i [N m/rad] swings against its locked motor at sqrt(k_i / L_i) / 2 pi
    [Hz], where L_i is the inertia D_ii of the arm less that of the motor.

    `joints`: label of each joint. `pose` (n,): [rad]. `hz` (n,): [Hz]; infinite where the log does
    not distinguish the gear from a rigid one. `low`, `high` (n,): 95 % interval [Hz], from the
    profile likelihood; where `high` is infinite, the gear is stiffer than `low`. `damping_ratio`,
    `damping_low`, `damping_high` (n,): damping ratio of the resonance, and its 95 % interval; where
    the log shows little, that of the prior, 0.005 to 0.05. `searched` (n,): whether the stiffness
    was unknown; the other resonances are those of the rig. `played`: joints whose gear has backlash
    (play) that the rig does not state. The fit takes it for compliance, in all gears with unknown
    stiffness: they are stiffer than `low`.
    """

    # Where: the joints, and the pose at which inertia counts.
    joints: tuple[str, ...]
    pose: Floats
    # The resonances and their intervals, undamped.
    hz: Floats
    low: Floats
    high: Floats
    # The damping ratios and their intervals.
    damping_ratio: Floats
    damping_low: Floats
    damping_high: Floats
    # What limits the meaning of these numbers.
    searched: NDArray[np.bool_]
    played: tuple[str, ...] = ()

    def beside_backlash(self, joints: tuple[str, ...]) -> Self:
        """Lower bounds alone, where the log shows backlash at these joints."""
        return replace(
            # Backlash looks like compliance, so a finite upper end would be wrong.
            self,
            high=np.where(self.searched, np.inf, self.high),
            played=joints,
        )

    def bounds(self, name: str) -> bool:
        """Whether an unknown belongs to a gear of which the log gives only the least stiffness."""
        stiffer = np.flatnonzero(self.searched & np.isinf(self.high)).tolist()
        # Of such a gear the damping is not known either.
        kinds = ("stiffness", "damping")
        return name in [f"drive.elasticity.{kind}[{i}]" for kind in kinds for i in stiffer]

    def _short(self) -> str:
        # A stated resonance has no interval; any finite end prints it as a number.
        tops = np.where(self.searched, self.high, 0)
        texts = [
            f"{hz:.1f}" if np.isfinite(top) else f">{low:.0f}"
            for hz, low, top in zip(self.hz, self.low, tops, strict=True)
        ]
        return f"{', '.join(texts)} Hz"

    def _shown(self) -> Iterator[Piece]:
        yield Verdict("resonance of each link against its locked motor, with 95 % intervals")
        # Stated resonance, lower bound, or interval with damping.
        rows = []
        for i, label in enumerate(self.joints):
            hz = f"{self.hz[i]:.1f}"
            ratio = (
                f"{self.damping_ratio[i]:.3f} [{self.damping_low[i]:.3f},"
                f" {self.damping_high[i]:.3f}]"
            )
            if not self.searched[i]:
                rows.append((label, hz, "as the rig says", ""))
            elif np.isinf(self.high[i]):
                rows.append((label, "", f"stiffer than {self.low[i]:.0f}", ""))
            else:
                rows.append((label, hz, f"[{self.low[i]:.1f}, {self.high[i]:.1f}]", ratio))
        yield Table(("", "[Hz]", "interval", "damping ratio"), rows, words=(2, 3))
        if self.played and self.searched.any():
            yield Warned(
                [
                    f"bounds alone: backlash was found at {', '.join(self.played)} that the rig"
                    " does not state, and the search takes it for compliance. State it in the"
                    " Elasticity, and identify again."
                ]
            )


# The modules of these classes know nothing of files: here they become values that a file can keep.
for _class in (GeneticSettings, GeneticResult, Resumption):
    kept(_class)


@kept
@frozen
class Fit(Shown, Frozen):
    """Values of the unknowns, and their covariance.

    Attributes
    ----------
    unknown : tuple of str
        Names of the unknowns.
    values : (k,) numpy.ndarray
    candidates : (C, k) numpy.ndarray
        Vectors that repeat the records as well as the values do, within the noise of the paper's
        objective (4), best first; the values alone where a method tries no others.
        ``Uncertainty(plants=...)`` uses them where there is no covariance.
    covariance : (k, k) numpy.ndarray or None
        Of the values; None where the method provides none. It includes noise, scaled by the
        innovations and their autocorrelation, and the tolerances of the rig: see `Tolerances`.
    noise_covariance : (k, k) numpy.ndarray or None
        The part of it that noise alone causes, if the rig is exact.
    between : BetweenRuns or None
        Agreement of two records or more, and the covariance that their differences add.
    rms_innovation : float or None
        Root mean square of the innovations [pulses]: counted positions minus their one-step
        predictions. Rounding alone gives 0.289.
    fallback_reason : str or None
        Reason for which the values are not those of the last fit; a covariance, where there is
        one, is that of the last fit and not theirs.
    zeros : (R, n) numpy.ndarray or None
        Angles of the joints of each record where its counters read zero [rad], if unknown.
    resumptions : tuple of (Resumption or None)
        State of the law, and of the arm, at the first sample of each record whose law was running
        before it.
    undetermined : tuple of tuple of str
        Groups of unknowns that the log does not tell apart from the state of its law at the start:
        the integral of a controller, for instance, may have held a part of a weight.
    gains : (2n,) numpy.ndarray or None
        Fitted observer gains of the innovations, of position and of speed.
    resonance : GearResonance or None
        Of elastic gears. Where it only gives a bound, stiffness and damping have no variance.
    prior : Prior or None
        Of f.
    torque_noise : (n,) numpy.ndarray or None
        Standard deviation of the noise of a logged torque that the fit repeats, joint side [N m];
        an upper bound where a controller's torque chatters. None where no torque was repeated.
    noise_innovation : float
        Root mean square of the innovations that this noise causes [pulses].
    rounding_innovation : float
        Root mean square of the innovations of simulated logs with these values [pulses], where the
        loop of a log felt the rounding of its counts; else zero.
    """

    # The estimate itself.
    unknown: tuple[str, ...]
    values: Floats
    candidates: Floats
    # Its uncertainty, as far as the method provides one.
    covariance: Floats | None = None
    noise_covariance: Floats | None = None
    between: BetweenRuns | None = None
    rms_innovation: float | None = None
    fallback_reason: str | None = None
    # Nuisance values that were estimated beside the unknowns.
    zeros: Floats | None = None
    resumptions: tuple[Resumption | None, ...] = ()
    undetermined: tuple[tuple[str, ...], ...] = ()
    gains: Floats | None = None
    # Elastic gears, and prior knowledge.
    resonance: GearResonance | None = None
    prior: Prior | None = None
    # Noise of the torques that were repeated.
    torque_noise: Floats | None = None
    noise_innovation: float = 0.0
    rounding_innovation: float = 0.0

    def _short(self) -> str:
        covariance = "no covariance" if self.covariance is None else "with covariance"
        fallback = ", a fallback" if self.fallback_reason else ""
        return f"{len(self.values)} values, {covariance}{fallback}"

    def _shown(self) -> Iterator[Piece]:
        deviations = [""] * len(self.values)
        if self.covariance is not None:
            deviations = [f"+- {std:.2g}" for std in self.std]
        # A method without a covariance leaves the column of deviations empty.
        columns = zip(self.unknown, self.values, deviations, strict=True)
        rows = [(name, f"{value:.5g}", deviation) for name, value, deviation in columns]
        yield Table((), rows, words=(2,))
        if self.fallback_reason:
            yield f"a fallback: {self.fallback_reason}"

    @property
    def std(self) -> Floats:
        """Standard deviations (k,) of the values.

        Raises
        ------
        ValueError
            A fit without a covariance.
        """
        # Raises where there is none: a silent zero would claim certainty.
        return np.sqrt(np.diag(self._required_covariance))

    @property
    def correlation(self) -> Floats:
        """Correlations (k, k) of the values; zero of one that equal ends of its range fix."""
        # A fixed value has no deviation: dividing by infinity gives it no correlation either.
        std = np.where(self.std > 0, self.std, np.inf)
        return self._required_covariance / np.outer(std, std)

    def covariance_of(self, names: Sequence[str]) -> Floats:
        """Covariance (m, m) of numbers by their names; zero of numbers that were not unknown."""
        if self.covariance is None:
            return np.zeros((len(names),) * 2)
        return covariance_of(names, self.unknown, self.covariance)

    @property
    def finds_gears(self) -> bool:
        """Whether numbers of elastic gears are among the unknowns."""
        return any(name.startswith("drive.elasticity") for name in self.unknown)

    @property
    def _required_covariance(self) -> Floats:
        if self.covariance is None:
            # The most specific explanation first.
            reason = self.fallback_reason or "its method has none; use the default method"
            raise ValueError(
                f"standard deviations need a covariance; this fit provides none: {reason}."
            )
        return self.covariance


@kept
@frozen
class Outcome(Frozen):
    """Fit of a method, and the course of its search.

    `message`: reason for which the search ended. `evaluations`: simulated experiments. `rounding`
    (M,) or None: mean innovations that the rounding of counts causes in logs of this motion,
    weighted and in the order of `Prediction`; None where it causes none, or was not simulated.
    `stages`: values (k,) of the stages before the last, by name. `grouped` (k,) or None: standard
    deviations of the values by their scatter between segments of a long log. `steps`: steps of the
    model per sample that the fit needed; 1 where the method leaves them to the problem.
    """

    fit: Fit
    message: str = ""
    evaluations: int = 0
    genetic: GeneticResult | None = None
    rounding: Floats | None = None
    grouped: Floats | None = None
    stages: dict[str, Floats] = field(default_factory=dict)
    steps: int = 1


@kept
@frozen
class Search(Shown, Frozen):
    """Method, settings and course of the search of an identification.

    `tolerances`: those of the rigs, which the intervals include. `ranges` (k, 2): those of the
    user. `stages`: values (k,) of the stages before the last, by name. `initial_objective`:
    objective (4) of the best candidate of the initial generation [pulses^2]; of a method without
    generations, that of the result. `initial_population` (P, k). `initial_costs` (P,): objective
    (4) of its candidates, inf for one that is no arm or diverges. `history` (generations + 1, 3):
    best, mean and worst finite objective of each generation. `evaluations`: simulated experiments.
    `seconds`: time of the identification. `message`: reason for which the search ended.
    """

    method: str
    seed: int
    settings: GeneticSettings
    tolerances: Tolerances
    ranges: Floats | None
    stages: dict[str, Floats]
    initial_objective: float
    initial_population: Floats
    initial_costs: Floats
    history: Floats
    evaluations: int
    seconds: float = field(compare=False)
    message: str

    def _short(self) -> str:
        return (
            f"{self.method}, seed {self.seed}, {self.evaluations} evaluations in"
            f" {self.seconds:.1f} s"
        )

    def _shown(self) -> Iterator[Piece]:
        yield f"{self.message}"
        rows = [
            ("method", self.method),
            ("seed", f"{self.seed}"),
            ("evaluations", f"{self.evaluations}"),
            # The history begins with the initial population, which is no generation.
            ("generations", f"{max(len(self.history) - 1, 0)}"),
            ("time [s]", f"{self.seconds:.1f}"),
        ]
        yield Table((), rows)

    @classmethod
    def of(cls, problem: Problem, outcome: Outcome, objective: float, seconds: float) -> Self:
        """Search of a problem with this outcome; `objective`: objective (4) of the result."""
        genetic = outcome.genetic
        # Arrays of zero length stand for the generations that a method does not have.
        unknown = len(problem.unknown)
        return cls(
            method=problem.method,
            seed=problem.seed,
            settings=problem.settings,
            tolerances=problem.tolerances,
            ranges=problem.ranges,
            stages=outcome.stages,
            initial_objective=genetic.initial_cost if genetic else objective,
            initial_population=genetic.initial_population if genetic else np.empty((0, unknown)),
            initial_costs=genetic.initial_costs if genetic else np.empty(0),
            history=genetic.history if genetic else np.empty((0, 3)),
            evaluations=outcome.evaluations,
            seconds=seconds,
            message=outcome.message,
        )

"""How likely a log is with its rig and its law, without a model of the arm.

Three equations of each joint hold in a right log: the counts follow the reference, the law gives
the logged torque, and the motion needs that torque, with an inertia and with friction that are not
negative. What each of them leaves unexplained, and the `priors` of what the motion shows, make one
log likelihood: the score by which `without_arm` compares hypotheses.
"""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from plant.checkup.along_log import steps_of_torque, torque_along
from plant.checkup.filtered import SETTINGS as FILTER
from plant.checkup.filtered import Filter, Filtered, centred
from plant.checkup.motor_equation import RIDGE, Columns, Equation, Motion
from plant.checkup.motor_equation import SETTINGS as EQUATION
from plant.checkup.priors import limit_prior, motion_priors
from plant.checkup.signals import Signals
from plant.checkup.torque_regression import SETTINGS as REGRESSION
from plant.laws import commanded_torque
from plant.parts import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class ScoreSettings:
    """Numbers of the score.

    They are chosen by hand; ``tests/benchmarks/second_reading.py causes`` counts the mistakes that
    are named with them.

    Parameters
    ----------
    command_rows : int
        Rows of logged and commanded torques that are compared, at most.
    tracking, command, steps, motion, uncoupled : float
        Share of the variance (0 to 1) that an equation leaves unexplained in a right log.
        `tracking`: the loop lags. `command`: values are rounded. `steps`: the memory of the law is
        unknown. `motion` (few joints) and `uncoupled` (more joints): the equation of motion lacks
        effects of pose and couplings (a real arm of six joints leaves up to 0.03).
    soft : float
        Standard deviation of the logarithm of the scale at which the counts of a right loop follow:
        gravity and springs hold the joint against a soft loop.
    unlike : float
        Unexplained share of the steps of a torque from which on a law does not explain them.
    like : float
        Difference of logged and commanded torque, as a share of both, up to which the law gives the
        logged torque.
    limited : float
        Share of the commands beyond the amplifier's limit from which on a log without a torque
        shows the limit; share of a logged torque at its ends from which on it is cut off.
    swinging : float
        Share of a torque that the motion leaves unexplained where an arm swings freely: twice
        differentiated counts are noise beside its torque.
    latest : float
        Delay of logged torques [s] up to which they are compared with those of the law. Chosen by
        hand: torques that a driver filters, or sends in packets, are late by 40 ms.
    another_zero : float
        Share of the mean square of a logged torque that its constant must exceed to show another
        zero of the reference. Smaller constants are offsets of current sensors. Chosen by hand.
    shifted : float
        Median of an error, over its changes (rms), from which on a reference with another zero is
        tried. Chosen by hand.
    dependent_motion : float
        Samples that count as one equation of motion, since its residual changes with the pose.
    dependent_time : float
        The same [s], of a log whose samples are close together.
    """

    command_rows: int = 3000
    tracking: float = 3e-2
    command: float = 1e-4
    steps: float = 1e-2
    motion: float = 5e-3
    uncoupled: float = 2e-2
    soft: float = 0.06
    unlike: float = 0.3
    like: float = 0.1
    limited: float = 0.5
    swinging: float = 0.05
    latest: float = 0.15
    another_zero: float = 0.25
    shifted: float = 3.0
    dependent_motion: float = 50.0
    dependent_time: float = 0.035


SETTINGS = ScoreSettings()


class Experiment:
    """A log with its score; a changed log takes over the columns that are as before.

    Parameters
    ----------
    record : Record
    base : Experiment, optional
        The experiment that was changed.
    """

    def __init__(self, record: Any, base: "Experiment | None" = None) -> None:
        self.record = record
        self.signals: Signals = Signals(record, base.signals if base else None)
        self.n = record.n
        self.base = base
        self._filtered: dict[tuple[str, int], tuple[Floats, Filtered]] = {}
        self._of_inputs: dict[tuple[str, int], tuple[tuple[Any, ...], Any]] = {}
        self._once: dict[Callable[[Self], Any], Any] = {}

    def changed(self, record: Any) -> Self:
        """The experiment of a record that a hypothesis has changed."""
        return type(self)(record, self)

    def once(self, quantity: Callable[[Self], Any]) -> Any:
        """A quantity of this experiment, computed once."""
        if quantity not in self._once:
            self._once[quantity] = quantity(self)
        return self._once[quantity]

    @functools.cached_property
    def filter(self) -> Filter:
        """The filter of all columns: that of the base where the times are the same."""
        t = self.signals.t
        if self.base is not None and (
            t is self.base.signals.t or np.array_equal(t, self.base.signals.t)
        ):
            return self.base.filter
        return Filter(self.signals)

    @functools.cached_property
    def long_enough(self) -> bool:
        """Whether speeds can be compared: as in the base, where both have one filter."""
        if self.base is not None and self.filter is self.base.filter:
            return self.base.long_enough
        return self.signals.long_enough

    def filtered(self, name: str, i: int) -> Filtered:
        """Counts, reference, torque or commanded torque of joint i after the filter.

        It is that of the base where the column is the same.
        """
        table = getattr(self.signals if name in ("counts", "reference") else self, name)
        key = name, i
        if key not in self._filtered:
            column = table[:, i]
            base = self.base
            if base is not None and self.filter is base.filter and key in base._filtered:
                before, filtered = base._filtered[key]
                if before is table or np.array_equal(before[:, i], column):
                    self._filtered[key] = table, filtered
                    return filtered
            self._filtered[key] = table, self.filter(column)
        return self._filtered[key][1]

    def as_before(
        self,
        name: str,
        i: int,
        inputs: tuple[Any, ...],
        quantity: Callable[..., Any],
        *arguments: Any,
    ) -> Any:
        """Value of `quantity` for joint i; the base's value if the base had the same inputs."""
        before, value = (self.base and self.base._of_inputs.get((name, i))) or (None, None)
        # Compare identity, not values: a change of a log keeps the objects of its other columns.
        if before is None or any(a is not b for a, b in zip(before, inputs, strict=True)):
            value = quantity(*arguments)
        self._of_inputs[name, i] = inputs, value
        return value

    # -- the three equations ----------------------------------------------------------------------
    def commanded_at(self, rows: slice) -> Floats | None:
        """Motor torque (K, n) of a law without memory at some valid rows; None if unknown."""
        record, drive = self.record, self.record.rig.drive
        if self.signals.reference is None:
            return None
        valid = np.flatnonzero(record.valid > 0)[rows]
        law = record.law, record.rig, record.reference_pulses, record.error_pulses, record.valid
        torque = self.as_before(str(rows), 0, law, commanded_torque, record, valid)
        if torque is None:
            return None
        # A known torque that was injected beside the command acts on the motor, too.
        injected = 0.0 if record.injected is None else record.injected[valid]
        return drive.motor_torque(torque + injected)

    @functools.cached_property
    def commanded(self) -> Floats | None:
        """Motor torque (M, n) of a law without memory, before the limit; None if it is unknown."""
        return self.commanded_at(slice(None))

    @functools.cached_property
    def following(self) -> tuple[Floats, Floats]:
        """Share of the counts' speed that the reference leaves unexplained; its log likelihood.

        Each (n,); the share is 1 where it is unknown.
        """
        noise = self.filter.speed_noise
        half = self.filter.equations / 2
        shares = np.ones(self.n)
        likelihoods = np.full(self.n, -half * np.log(1 + SETTINGS.tracking))
        if self.signals.reference is None:
            return shares, likelihoods
        for i in range(self.n):
            reference = self.filtered("reference", i)
            # While the reference rests, the counts move by noise alone and show no scale.
            if np.mean(reference.speed**2) > noise and not self.cut_off[i]:
                columns = reference, self.filtered("counts", i)
                shares[i], likelihoods[i] = self.as_before(
                    "following", i, columns, _following, *columns, noise, half
                )
        return shares, likelihoods

    @functools.cached_property
    def cut_off(self) -> Bools:
        """Whether a logged torque (n,) is at one of its ends for most of the log.

        The counts of such a joint follow no reference, whatever their scale.
        """
        torque = self.signals.torque
        if torque is None:
            return np.zeros(self.n, dtype=bool)
        least, largest = torque.min(axis=0), torque.max(axis=0)
        at_end = np.mean((torque == least) | (torque == largest), axis=0)
        return (at_end > SETTINGS.limited) & (least < largest)

    @property
    def tracking(self) -> Floats:
        """Share (n,) of the counts' speed that the reference leaves unexplained; 1 unknown."""
        return self.following[0]

    @functools.cached_property
    def torque_along(self) -> Any:
        """Joint torque (K, n) of the law along the log, or None; that of the base where it can be.

        No change of a logged torque changes what the law commands.
        """
        record = self.record
        law, rig = record.law, record.rig
        columns = record.t, record.valid, record.error_pulses, record.reference_pulses
        inputs = law, rig, record.reference, *columns
        return self.as_before("along the log", 0, inputs, torque_along, self.signals, law, rig)

    @functools.cached_property
    def has_memory(self) -> bool:
        """Whether a law is stated whose torque depends on more than the present counts."""
        law = self.record.law
        return law is not None and law.has_memory(self.n)

    @functools.cached_property
    def torques_of_law(self) -> tuple[Floats, Floats] | None:
        """Commanded and logged motor torque (K, n) of comparable rows; None without both.

        Those of a law with memory are steps from sample to sample.
        """
        signals, law = self.signals, self.record.law
        if signals.torque is None or signals.reference is None or law is None or law.replays:
            return None
        if not self.long_enough:
            return None
        if self.has_memory:
            along = self.torque_along
            return None if along is None else steps_of_torque(signals, along)
        rows = slice(None, None, max(1, len(signals.t) // SETTINGS.command_rows))
        commanded = self.commanded_at(rows)
        if commanded is None:
            return None
        return centred(self.limited(commanded)), centred(signals.torque[rows])

    def limited(self, commanded: Floats) -> Floats:
        """Motor torque (K, n) of amplifiers that limit the commanded one."""
        drive = self.record.rig.drive
        return np.asarray(drive.motor_torque(drive.limited(drive.joint_torque(commanded))))

    @functools.cached_property
    def command(self) -> Floats | None:
        """Difference (n,) of commanded and logged torque, as a share of both; None without both."""
        return None if self.torques_of_law is None else shares(self.torques_of_law)

    @functools.cached_property
    def slow_command(self) -> Floats | None:
        """The same of slow steps, of a law with memory.

        Noise of a current hides the steps from sample to sample, and hardly these. So does that of
        counts between two rows, which a derivative enlarges.
        """
        if self.torques_of_law is None or not self.has_memory:
            return None
        return shares(steps_of_torque(self.signals, self.torque_along, slow=True))

    @functools.cached_property
    def torque(self) -> Floats | None:
        """Motor torque (M, n), logged or else commanded; None without either."""
        if self.signals.torque is not None:
            return self.signals.torque
        commanded = self.commanded
        if commanded is None:
            return None
        limited = self.limited(commanded)
        # A few peaks beyond the limit come from late or noisy counts. The limit is applied only if
        # most commands of a joint are beyond it.
        share = np.mean(~np.isclose(commanded, limited), axis=0)
        return limited if (share > SETTINGS.limited).any() else commanded

    @functools.cached_property
    def motions(self) -> list[Motion] | None:
        """The regression of each motor's torque on the motion; None without a torque."""
        if self.equations_of_motion is None:
            return None
        closed = self.signals.reference is not None
        return [
            self.as_before(
                "motion",
                i,
                (equation, closed),
                Motion.of,
                equation,
                self.filter.equations,
                self.n - 1,
                closed,
            )
            for i, equation in enumerate(self.equations_of_motion)
        ]

    @functools.cached_property
    def swings(self) -> bool:
        """Whether no loop holds the motion, and the torque is small beside noise of accelerations.

        All changes of a log have the same answer, so that their scores compare.
        """
        if self.base is not None:
            return self.base.swings
        if self.signals.reference is not None:
            return False
        held = Experiment(self.record)
        held.swings = False
        motions = held.motions or ()
        return any(motion.unexplained > SETTINGS.swinging for motion in motions)

    @functools.cached_property
    def equations_of_motion(self) -> list[Equation] | None:
        """Columns of each motor's equation of motion; None without a torque, or without rows."""
        if self.torque is None or not len(self.filter.rows):
            return None
        counts = tuple(self.filtered("counts", i) for i in range(self.n))
        inputs = *counts, self.record.rig, self.swings
        columns = self.as_before(
            "columns", 0, inputs, Columns, self.signals, self.filter, counts, self.swings
        )
        torques = [self.filtered("torque", i) for i in range(self.n)]
        return [
            self.as_before("equation", i, (torque, columns), columns.equation, i, torque)
            for i, torque in enumerate(torques)
        ]

    # -- the score --------------------------------------------------------------------------------
    @functools.cached_property
    def terms(self) -> dict[str, Floats]:
        """Log likelihoods (n,) of the equations, and of what rig and law state, by name."""
        return self.beside_law | self._of_law

    @property
    def _of_law(self):
        """Log likelihood (n,) of the logged torque under the law; nothing without both."""
        half = self.filter.equations / 2
        if self.command is None:
            return {}
        if self.slow_command is None:
            return {"command": -half * np.log(self.command + SETTINGS.command)}
        # Shares above `unlike` differ by noise alone, so they are clipped there. Of steps over a
        # window only one per window is independent, so their evidence is divided. The clearer of
        # the two pieces of evidence is taken.
        unlike = SETTINGS.unlike + SETTINGS.steps
        quick, slow = (
            np.log(unlike / (np.minimum(share, SETTINGS.unlike) + SETTINGS.steps))
            for share in (self.command, self.slow_command)
        )
        explained = np.maximum(quick, slow / REGRESSION.per_window)
        return {"command": half * (explained - np.log(unlike))}

    @functools.cached_property
    def beside_law(self) -> dict[str, Floats]:
        """Log likelihoods (n,) of all that needs no run of a law with memory, by name."""
        terms = {"tracking": self.following[1]}
        if self.motions is not None and self.equations_of_motion is not None:
            freedom = self._freedom(self.equations_of_motion[0])
            unexplained = np.array([motion.unexplained for motion in self.motions])
            coupled = self.n <= EQUATION.coupled
            lacking = (SETTINGS.motion if coupled else SETTINGS.uncoupled) * self.weakness
            # Another motor's speed explains less of a torque: more of it is left to be explained.
            beside_speed = np.array([motion.beside_speed for motion in self.motions])
            share = np.minimum(unexplained + lacking, 1.0) * beside_speed
            terms["motion"] = -freedom / 2 * np.log(share)
            terms |= motion_priors(self.motions, self.record.rig.drive)
        if self.signals.torque is not None:
            terms["limit"] = limit_prior(self.signals.torque, self.record.rig.drive)
        return terms

    def _freedom(self, equation):
        """Independent equations of a motion beyond its unknown coefficients.

        What the regression lacks changes with the pose, and so does its residual.
        """
        unknown = equation.own.shape[1] + equation.free.shape[1]
        dependent = max(SETTINGS.dependent_motion, SETTINGS.dependent_time / self.signals.interval)
        equations = self.filter.equations * FILTER.dependent / dependent
        # Priors of the unknown coefficients replace some of them.
        return max(equations - unknown, equations / 4)

    @functools.cached_property
    def weakness(self) -> Floats:
        """Variance of the strongest motor's torque over that of each (n,); 1 in a closed loop.

        Where no loop drives a motor, the others move it, and what the regression lacks of their
        torques is large beside its own.
        """
        if self.signals.reference is not None or self.torque is None:
            return np.ones(self.n)
        if self.base is None or self.base.torque is None:
            power = np.var(self.torque, axis=0)
            return power.max() / np.maximum(power, RIDGE * power.max() or 1.0)
        # A change of unit leaves the weakness of a motor as it is in the base. A column that was
        # another motor's in the base has that motor's weakness.
        rows = slice(None, None, max(1, len(self.torque) // FILTER.rows))
        before, after = (centred(torque[rows]) for torque in (self.base.torque, self.torque))
        sizes = np.outer(np.linalg.norm(after, axis=0), np.linalg.norm(before, axis=0))
        exchanged = np.abs(after.T @ before) > _THE_SAME * sizes
        which = np.where(exchanged.any(axis=1), exchanged.argmax(axis=1), np.arange(self.n))
        return self.base.weakness[which]

    @functools.cached_property
    def score(self) -> float:
        """Log likelihood of the log."""
        return _total(self.terms)

    @property
    def largest_score(self) -> float:
        """That of a log whose torque is exactly what the law commands."""
        if self.record.law is None:
            return _total(self.beside_law)
        unexplained = SETTINGS.steps if self.has_memory else SETTINGS.command
        explained = -self.filter.equations / 2 * np.log(unexplained)
        return _total(self.beside_law) + self.n * float(explained)

    def gain(self, changed: Self, least: float) -> float:
        """Gain in log likelihood by a change, or its upper bound if that is below `least`.

        A run of the law along the log takes most of the time of a trial. It is left out if even its
        best result cannot raise the gain to `least`.
        """
        most = changed.largest_score - self.score
        return most if most < least else changed.score - self.score


def _total(terms):
    return float(sum(term.sum() for term in terms.values()))


def _following(reference, counts, noise, half):
    """Share of the counts' speed that the reference leaves unexplained, and its log likelihood.

    A loop may lag: its counts follow behind the reference, or as a low-pass of it, of the second
    order where a speed loop is inside. What is in proportion to either's acceleration, or to the
    jerk of the counts, is no evidence; no loop leads. A soft loop follows at another scale: gravity
    and springs hold it.
    """
    # Each set of lags is tried: one whose coefficient is negative would lead.
    lagging = [reference.acceleration, counts.acceleration, counts.jerk]
    columns = np.column_stack([*lagging, reference.speed, -counts.speed])
    squares = columns.T @ columns / len(columns)
    # Columns of one size, so that the ridge is relative.
    k = len(lagging)
    size = np.sqrt(np.maximum(np.diag(squares)[:k], np.finfo(float).tiny))
    squares[:k] /= size[:, None]
    squares[:, :k] /= size
    pair = np.column_stack([np.exp(_SCALES * SETTINGS.soft), np.ones(len(_SCALES))])
    least = np.full(len(pair), np.inf)
    choices = itertools.chain(*(itertools.combinations(range(k), count) for count in range(k + 1)))
    for lags in map(list, choices):
        across = squares[lags, k:]
        times = np.linalg.solve(squares[np.ix_(lags, lags)] + RIDGE * np.eye(len(lags)), across)
        unexplained = squares[k:, k:] - across.T @ times
        possible = (times @ pair.T >= 0).all(axis=0)
        speeds = np.einsum("si,ij,sj->s", pair, unexplained, pair)
        least[possible] = np.minimum(least[possible], speeds[possible])
    # The reference is what was asked for: what of the counts does it leave unexplained?
    share = np.minimum((np.maximum(least, 0.0) + noise) / (squares[-1, -1] + noise), 1.0)
    likelihood = -half * np.log(share + SETTINGS.tracking) - _SCALES**2 / 2
    best = int(np.argmax(likelihood))
    # A best scale at either end lies outside the range of soft loops: the counts follow nothing. An
    # example is an error of the wrong sign: the counts of a joint that rests then seem to move
    # twice as far as the reference.
    if best in (0, len(_SCALES) - 1):
        return 1.0, float(-half * np.log(1 + SETTINGS.tracking))
    return float(share[best]), float(likelihood[best])


# Scales of soft loops that are tried [standard deviations of their logarithm].
_SCALES = np.linspace(-6, 6, 25)


def shares(torques: tuple[Floats, Floats]) -> Floats:
    """Mean square (n,) of the difference of two torques (K, n), as a share of that of both."""

    def share(a, b):
        size = (np.mean(a**2) + np.mean(b**2)) / 2
        return np.mean((a - b) ** 2) / size if size > 0 else 1.0

    return np.array([share(a, b) for a, b in zip(*(x.T for x in torques), strict=True)])


# Correlation, in absolute value, above which two columns of torque are one, perhaps in other units.
_THE_SAME = 0.999

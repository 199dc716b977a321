"""How likely a log is with its rig and its law, without a model of the arm.

Three equations of each joint hold in a right log: the counts follow the reference, the law gives
the logged torque, and the motion needs that torque, with an inertia and with friction that are not
negative. What each of them leaves unexplained, and how far inertia and friction are from what the
rig states, make one log likelihood: the score by which `without_arm` compares hypotheses.
"""

import functools
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from plant.checkup.along_log import steps_of_torque, torque_along
from plant.checkup.signals import Signals
from plant.laws.replayed import commanded_torque
from plant.parts.fields import Bools, Floats


@dataclass(frozen=True, kw_only=True)
class ScoreSettings:
    """Numbers of the score.

    They are chosen by hand; ``tests/benchmarks/second_reading.py causes`` counts the mistakes that
    are named with them.

    Parameters
    ----------
    rows, command_rows : int
        Rows of the filtered log that are compared, at most, and rows of logged and commanded
        torques.
    coupled : int
        Joints up to which the regression has inertias that depend on the pose.
    per_window : int
        Rows taken from a filter's window: more of them are not independent.
    dependent, dependent_motion : float
        Samples that count as one equation, since residuals of neighbours are alike; of the motion.
    dependent_time : float
        The same of the motion [s], of a log whose samples are close together.
    tracking, command, steps, motion, uncoupled : float
        Share of the variance (0 to 1) that each equation leaves unexplained in a right log: by lag
        of the loop; by rounding; by the unknown memory of a law; by pose and couplings that the
        regression does not have, of few joints and of more than `coupled` ones (a real arm of six
        leaves up to 0.03).
    soft : float
        Standard deviation of the logarithm of the scale at which the counts of a right loop follow:
        gravity and springs hold the joint against a soft loop.
    unlike : float
        Unexplained share of the steps of a torque from which on a law does not explain them.
    inertia, inertia_spread : float
        Median of the inertia at a motor [rotor inertias], and standard deviation of its logarithm.
    rotor : float
        Share of the stated rotor inertia that no arm undercuts.
    rotor_spread : float
        Relative standard deviation of that limit.
    coupling_spread : float
        Relative standard deviation of the largest coupling of two motors, since inertias are means
        over poses.
    surest : float
        Square of the standard deviations of one coupling that count, at most: what the regression
        lacks is not normally distributed.
    friction_spread : float
        Standard deviation of the logarithm of friction over the stated one.
    guessed, guess_spread : float
        Share of rigs whose friction is a guess, and the standard deviation of its logarithm.
    beyond, beyond_spread : float
        Share of the amplifier's limit that a torque may reach, and its relative standard deviation.
    limited : float
        Share of the commands beyond the amplifier's limit from which on a log without a torque
        shows the limit; share of a logged torque at its ends from which on it is cut off.
    slow : float
        Share of the RMS speed below which a joint may stick, so that its friction is unknown.
    swinging : float
        Share of a torque that the motion leaves unexplained where an arm swings freely: twice
        differentiated counts are noise beside its torque.
    average : float
        Window [s] over which the terms of a motion that no loop holds are averaged: much of a
        swing. Real pendulums turn at 1 to 2 Hz.
    windows : int
        Windows of that kind that a log has beyond the unknown coefficients, at least; they are
        shorter in a short one.
    segments : int
        Segments of a log, each left out once by the jackknife of the regression.
    """

    rows: int = 800
    command_rows: int = 3000
    coupled: int = 3
    per_window: int = 7
    dependent: float = 7.0
    dependent_motion: float = 50.0
    dependent_time: float = 0.035
    tracking: float = 3e-2
    command: float = 1e-4
    steps: float = 1e-2
    soft: float = 0.06
    unlike: float = 0.3
    motion: float = 5e-3
    uncoupled: float = 2e-2
    inertia: float = 5.0
    inertia_spread: float = 1.5
    rotor: float = 0.8
    rotor_spread: float = 0.1
    coupling_spread: float = 0.2
    surest: float = 50.0
    friction_spread: float = 0.4
    guessed: float = 0.2
    guess_spread: float = 1.5
    beyond: float = 1.02
    beyond_spread: float = 0.02
    limited: float = 0.5
    slow: float = 0.05
    swinging: float = 0.05
    average: float = 0.25
    windows: int = 2
    segments: int = 10


SETTINGS = ScoreSettings()


class Filtered(NamedTuple):
    """A smoothed column at the compared rows, each (M,): value, derivatives, sign of speed."""

    value: Floats
    speed: Floats
    acceleration: Floats
    jerk: Floats
    direction: Floats


class Filter:
    """Smooths columns of one log, at rows whose whole window was measured."""

    def __init__(self, signals: Signals) -> None:
        self.t = signals.t
        self.interval = signals.interval
        window = signals.window
        steps = int((self.t[-1] - self.t[0]) / self.interval + 1e-6)
        self.times = self.t[0] + np.arange(steps + 1) * self.interval
        rows = np.flatnonzero(signals.clear)
        stride = max(1, window // SETTINGS.per_window, -(-len(rows) // SETTINGS.rows))
        self.rows = rows[::stride]
        self.stride = stride
        # Samples behind each row: all of them, or those of its window where rows lie further apart.
        samples = min(stride, window) * len(self.rows)
        self.equations = samples / SETTINGS.dependent
        # Four samples more than the window, so that differences of smoothed values fit in.
        kernel = np.zeros(window + 4)
        kernel[2:-2] = np.hanning(window + 2)[1:-1]
        kernel /= kernel.sum()

        def rate(column):
            return (np.roll(column, 1) - np.roll(column, -1)) / (2 * self.interval)

        before, after = np.roll(kernel, -1), np.roll(kernel, 1)
        second = (after - 2 * kernel + before) / self.interval**2
        self.kernels = np.column_stack([kernel, rate(kernel), second, rate(second)])

    def __call__(self, column: Floats) -> Filtered:
        """Filter a column (M,) of the log."""
        even = np.interp(self.times, self.t, column)
        value, speed, acceleration, jerk = (self._at_rows(even) @ self.kernels).T
        # The sign of the speed passes the same filter as the torque that it causes.
        rate = np.convolve(even, self.kernels[::-1, 1], mode="same")
        direction = self._at_rows(np.sign(rate)) @ self.kernels[:, 0]
        return Filtered(value, speed, acceleration, jerk, direction)

    def average(self, table: Floats, windows: int) -> Floats:
        """Average a table (M, k) of the compared rows over `SETTINGS.average` seconds.

        A motion that no loop holds has large accelerations and small torques: noise of the one
        hides the other, and averages out.
        """
        rows = SETTINGS.average / (self.interval * self.stride)
        # A short log is averaged over less, so that it has so many windows.
        rows = min(rows, len(table) / windows)
        kernel = np.hanning(2 * int(rows / 2) + 3)[1:-1]
        return np.column_stack(
            [np.convolve(column, kernel / kernel.sum(), mode="valid") for column in table.T]
        )

    def _at_rows(self, even):
        half = len(self.kernels) // 2
        return np.lib.stride_tricks.sliding_window_view(even, len(self.kernels))[self.rows - half]


class Motion(NamedTuple):
    """Regression of the torque of one motor on the motion, with standard deviations.

    Inertia [kg m^2], viscous [N m s/rad] and Coulomb friction [N m], none negative; `unexplained`:
    share (0 to 1) of the variance that the speed alone leaves of the torque, and `beside_speed`:
    share of the torque's that it leaves; `coupling` (n - 1,): inertias of the other motors'
    accelerations [kg m^2], of either sign.
    """

    inertia: float
    inertia_std: float
    viscous: float
    viscous_std: float
    coulomb: float
    coulomb_std: float
    unexplained: float
    beside_speed: float
    coupling: Floats
    coupling_std: Floats


class Equation(NamedTuple):
    """Columns of a motor's equation of motion at the compared rows.

    Acceleration, speed and its sign (M, 3); columns of other terms (M, k), the other motors'
    accelerations before them; the torque [N m] and its slope (M,) [N m/s].
    """

    own: Floats
    free: Floats
    torque: Floats
    slope: Floats


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
        self._once: dict[str, Any] = {}

    def changed(self, record: Any) -> Self:
        """The experiment of a record that a hypothesis has changed."""
        return type(self)(record, self)

    def once(self, name: str, quantity: Callable[[Self], Any]) -> Any:
        """A quantity of this experiment, computed once."""
        if name not in self._once:
            self._once[name] = quantity(self)
        return self._once[name]

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
        """Whether speeds can be compared: with the filter of the base, what holds of the base."""
        if self.base is not None and self.filter is self.base.filter:
            return self.base.long_enough
        return self.signals.long_enough

    def filtered(self, name: str, table: Floats, i: int) -> Filtered:
        """Column i of a table (M, n) after the filter; that of the base where it is the same."""
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
        self, name: str, i: int, inputs: tuple[Any, ...], quantity: Callable[[], Any]
    ) -> Any:
        """A quantity of joint i and of these inputs; that of the base where all are its own."""
        before, value = (self.base and self.base._of_inputs.get((name, i))) or (None, None)
        # Objects are compared, not their values: a change of a log leaves its other columns alone.
        if before is None or any(a is not b for a, b in zip(before, inputs, strict=True)):
            value = quantity()
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
        torque = self.as_before(
            str(rows), 0, law, functools.partial(commanded_torque, record, valid)
        )
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
        signals, half = self.signals, self.filter.equations / 2
        unknown = np.ones(self.n), np.full(self.n, -half * np.log(1 + SETTINGS.tracking))
        if signals.reference is None:
            return unknown
        shares, likelihoods = unknown
        for i in range(self.n):
            reference = self.filtered("reference", signals.reference, i)
            # Beside a goal that rests the counts move by noise alone, whatever their scale.
            if np.mean(reference.speed**2) > self.speed_noise and not self.cut_off[i]:
                counts = self.filtered("counts", signals.counts, i)
                shares[i], likelihoods[i] = self.as_before(
                    "following",
                    i,
                    (reference, counts),
                    functools.partial(_following, reference, counts, self.speed_noise, half),
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
    def speed_noise(self) -> float:
        """Variance of a smoothed speed that rounding to whole pulses causes."""
        return float((self.filter.kernels[:, 1] ** 2).sum()) / 12

    @functools.cached_property
    def torque_along(self) -> Any:
        """Joint torque (K, n) of the law along the log, or None; that of the base where it can be.

        No change of a logged torque changes what the law commands.
        """
        record = self.record
        columns = record.t, record.valid, record.error_pulses, record.reference_pulses
        return self.as_before(
            "along the log",
            0,
            (record.law, record.rig, record.reference, *columns),
            functools.partial(torque_along, self.signals, record.law, record.rig),
        )

    @functools.cached_property
    def torques_of_law(self) -> tuple[Floats, Floats] | None:
        """Commanded and logged motor torque (K, n) of comparable rows; None without both.

        Those of a law with memory are steps from sample to sample.
        """
        signals = self.signals
        law = self.record.law
        if signals.torque is None or signals.reference is None or law is None or law.replays:
            return None
        if not self.long_enough:
            return None
        if law.has_memory(self.n):
            along = self.torque_along
            return None if along is None else steps_of_torque(signals, along)
        rows = slice(None, None, max(1, len(signals.t) // SETTINGS.command_rows))
        commanded = self.commanded_at(rows)
        if commanded is None:
            return None
        drive = self.record.rig.drive
        # The amplifier limits what the law commands.
        commanded = drive.motor_torque(drive.limited(drive.joint_torque(commanded)))
        return _centred(commanded), _centred(signals.torque[rows])

    @functools.cached_property
    def command(self) -> Floats | None:
        """Difference (n,) of commanded and logged torque, as a share of both; None without both."""
        return None if self.torques_of_law is None else _shares(self.torques_of_law)

    @functools.cached_property
    def slow_command(self) -> Floats | None:
        """The same of steps over the smoothing window, of a law with memory.

        Noise of a current hides the steps from sample to sample, and hardly these.
        """
        if self.torques_of_law is None or not self.record.law.has_memory(self.n):
            return None
        return _shares(steps_of_torque(self.signals, self.torque_along, self.signals.window))

    @functools.cached_property
    def torque(self) -> Floats | None:
        """Motor torque (M, n), logged or else commanded; None without either."""
        if self.signals.torque is not None:
            return self.signals.torque
        commanded = self.commanded
        if commanded is None:
            return None
        drive = self.record.rig.drive
        limited = np.asarray(drive.motor_torque(drive.limited(drive.joint_torque(commanded))))
        # Single peaks beyond the limit are those of counts that are late or noisy. A log whose
        # commands are mostly beyond it shows the limit.
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
                functools.partial(
                    _regression, *equation[:3], self.filter.equations, self.n - 1, closed=closed
                ),
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
        counts = tuple(self.filtered("counts", self.signals.counts, i) for i in range(self.n))
        inputs = *counts, self.record.rig, self.swings
        equation = self.as_before("columns", 0, inputs, functools.partial(self._columns, counts))
        torques = [self.filtered("torque", self.torque, i) for i in range(self.n)]
        return [
            self.as_before(
                "equation", i, (torque, equation), functools.partial(equation, i, torque)
            )
            for i, torque in enumerate(torques)
        ]

    def _columns(self, counts):
        """A function of motor and filtered torque that gives its equation of motion."""
        to_angle = self.record.rig.encoder.to_angle
        # The derivatives of a joint at rest are rounding errors, which explain a constant torque.
        moves = np.ptp(self.signals.counts, axis=0) > 0
        per_pulse = np.broadcast_to(to_angle(np.ones(self.n)), (self.n,)) * moves
        acceleration = np.column_stack([column.acceleration for column in counts]) * per_pulse
        speed = np.column_stack([column.speed for column in counts]) * per_pulse
        direction = np.column_stack([column.direction for column in counts])
        angle = self.record.rig.cell_centre(np.column_stack([column.value for column in counts]))
        # Gravity acts on absolute angles of links in one plane, behind a first joint that stands
        # upright or not.
        absolute = np.cumsum(angle, axis=1)
        angles = [absolute] if self.n < 3 else [absolute, absolute[:, 1:] - angle[:, :1]]
        gravity = [function(each) for each in angles for function in (np.sin, np.cos)]
        shared = np.column_stack(
            [np.ones(len(angle)), *gravity, *self._coupling(angle, speed, acceleration)]
        )
        # Windows exceed the unknown coefficients: acceleration, friction, and those of `shared`.
        windows = SETTINGS.windows + self.n + 2 + shared.shape[1]

        def average(table):
            return self.filter.average(table, windows) if self.swings else table

        def equation(i, torque):
            own = np.column_stack([acceleration[:, i], speed[:, i], direction[:, i]])
            free = np.column_stack([np.delete(acceleration, i, axis=1), shared])
            value, slope = average(np.column_stack([torque.value, torque.speed])).T
            return Equation(average(own), average(free), value, slope)

        return equation

    def _coupling(self, angle, speed, acceleration):
        """Columns of an inertia that depends on the pose, and of the Coriolis torques with it.

        A log of many joints has too many of them.
        """
        if self.n > SETTINGS.coupled:
            return
        products = [
            speed[:, i] * speed[:, j]
            for i, j in itertools.combinations_with_replacement(range(self.n), 2)
        ]
        # The first joint's angle does not change the inertia.
        for function in (np.cos, np.sin):
            for column in function(angle[:, 1:]).T:
                # Without its mean the coefficient of the acceleration alone is a mean over the log.
                pose = column - column.mean()
                yield from (pose * term for term in (*acceleration.T, *products))

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
        # Steps that the law does not explain differ by noise alone. Of steps over a window one per
        # window is independent. The clearer evidence of both counts.
        unlike = SETTINGS.unlike + SETTINGS.steps
        quick, slow = (
            np.log(unlike / (np.minimum(share, SETTINGS.unlike) + SETTINGS.steps))
            for share in (self.command, self.slow_command)
        )
        explained = np.maximum(quick, slow / SETTINGS.per_window)
        return {"command": half * (explained - np.log(unlike))}

    @functools.cached_property
    def beside_law(self) -> dict[str, Floats]:
        """Log likelihoods (n,) of all that needs no run of a law with memory, by name."""
        terms = {"tracking": self.following[1]}
        if self.motions is not None and self.equations_of_motion is not None:
            freedom = self._freedom(self.equations_of_motion[0])
            unexplained = np.array([motion.unexplained for motion in self.motions])
            coupled = self.n <= SETTINGS.coupled
            lacking = (SETTINGS.motion if coupled else SETTINGS.uncoupled) * self.weakness
            # Another motor's speed explains less of a torque: more of it is left to be explained.
            beside_speed = np.array([motion.beside_speed for motion in self.motions])
            share = np.minimum(unexplained + lacking, 1.0) * beside_speed
            terms["motion"] = -freedom / 2 * np.log(share)
            drive = self.record.rig.drive
            terms["inertia"] = np.array(
                [
                    _inertia_prior(motion, rotor)
                    for motion, rotor in zip(self.motions, drive.motor_inertia, strict=True)
                ]
            )
            terms["coupling"] = _coupling_prior(self.motions)
            for name in ("coulomb", "viscous"):
                terms[name] = np.array(
                    [
                        _friction_prior(getattr(motion, name), getattr(motion, f"{name}_std"), size)
                        for motion, size in zip(self.motions, getattr(drive, name), strict=True)
                    ]
                )
        if self.signals.torque is not None:
            terms["limit"] = self._limit_prior
        return terms

    def _freedom(self, equation):
        """Independent equations of a motion beyond its unknown coefficients.

        What the regression lacks changes with the pose, and so does its residual.
        """
        unknown = equation.own.shape[1] + equation.free.shape[1]
        dependent = max(SETTINGS.dependent_motion, SETTINGS.dependent_time / self.signals.interval)
        equations = self.filter.equations * SETTINGS.dependent / dependent
        # Priors of the unknown coefficients replace some of them.
        return max(equations - unknown, equations / 4)

    @functools.cached_property
    def weakness(self) -> Floats:
        """Largest mean square of a motor's torque over that of each (n,); 1 in a closed loop.

        Where no loop drives a motor, the others move it, and what the regression lacks of their
        torques is large beside its own.
        """
        if self.signals.reference is not None or self.torque is None:
            return np.ones(self.n)
        if self.base is None or self.base.torque is None:
            power = np.var(self.torque, axis=0)
            return power.max() / np.maximum(power, _RIDGE * power.max() or 1.0)
        # Another unit makes no motor stronger: a column that was another motor's is as weak as it.
        rows = slice(None, None, max(1, len(self.torque) // SETTINGS.rows))
        before, after = (_centred(torque[rows]) for torque in (self.base.torque, self.torque))
        sizes = np.outer(np.linalg.norm(after, axis=0), np.linalg.norm(before, axis=0))
        exchanged = np.abs(after.T @ before) > _THE_SAME * sizes
        which = np.where(exchanged.any(axis=1), exchanged.argmax(axis=1), np.arange(self.n))
        return self.base.weakness[which]

    @property
    def _limit_prior(self):
        """Log likelihood (n,) of the largest torques under the amplifier's limit."""
        drive = self.record.rig.drive
        limit = drive.motor_gain * drive.current_limit
        share = np.abs(self.signals.torque).max(axis=0) / limit
        beyond = np.log(np.maximum(share / SETTINGS.beyond, 1.0)) / SETTINGS.beyond_spread
        return -(np.minimum(beyond, 10.0) ** 2) / 2

    @functools.cached_property
    def score(self) -> float:
        """Log likelihood of the log."""
        return _total(self.terms)

    @property
    def largest_score(self) -> float:
        """That of a log whose torque is exactly what the law commands."""
        law = self.record.law
        if law is None:
            return _total(self.beside_law)
        unexplained = SETTINGS.steps if law.has_memory(self.n) else SETTINGS.command
        explained = -self.filter.equations / 2 * np.log(unexplained)
        return _total(self.beside_law) + self.n * float(explained)

    def gain(self, changed: Self, least: float) -> float:
        """How much likelier a change makes the log; an upper bound where that is below `least`.

        A run of the law along the log takes most of the time of a trial, and cannot make up for
        counts that follow no reference and a motion that needs another torque.
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
        times = np.linalg.solve(squares[np.ix_(lags, lags)] + _RIDGE * np.eye(len(lags)), across)
        left = squares[k:, k:] - across.T @ times
        possible = (times @ pair.T >= 0).all(axis=0)
        least[possible] = np.minimum(
            least[possible], np.einsum("si,ij,sj->s", pair, left, pair)[possible]
        )
    # The reference is what was asked for: what of the counts does it leave unexplained?
    share = np.minimum((np.maximum(least, 0.0) + noise) / (squares[-1, -1] + noise), 1.0)
    likelihood = -half * np.log(share + SETTINGS.tracking) - _SCALES**2 / 2
    best = int(np.argmax(likelihood))
    # At the ends the best scale lies beyond those of soft loops: such counts follow nothing. Those
    # that an error of the wrong sign gives, beside counts that rest, move twice as far.
    if best in (0, len(_SCALES) - 1):
        return 1.0, float(-half * np.log(1 + SETTINGS.tracking))
    return float(share[best]), float(likelihood[best])


# Scales of soft loops that are tried [standard deviations of their logarithm].
_SCALES = np.linspace(-6, 6, 25)


def _centred(columns):
    # A short log may leave no rows.
    return columns - columns.mean(axis=0) if len(columns) else columns


def _shares(torques):
    """Difference (n,) of two torques (K, n), as a share of both."""
    return np.array([_share(a - b, a, b) for a, b in zip(*(x.T for x in torques), strict=True)])


def _share(difference, a, b, noise=0.0):
    """Mean square of a difference as a share of that of its terms, which noise takes to 1."""
    size = (np.mean(a**2) + np.mean(b**2)) / 2 + noise
    return float((np.mean(difference**2) + noise) / size) if size > 0 else 1.0


def _regression(own, free, torque, equations, others, *, closed):
    """Regress a torque (M,) on columns of its own motion (M, 3), not negative, and free ones.

    The first `others` of the free columns are the other motors' accelerations. `closed`: whether a
    loop turns a delay of the counts into torque.
    """
    nothing = Motion(0.0, np.inf, 0.0, np.inf, 0.0, np.inf, 1.0, 1.0, *np.full((2, others), np.inf))
    if not len(torque):
        return nothing
    torque = _centred(torque)
    speed = own[:, 1]
    # An average over much of a swing has friction of a known sign in all its rows.
    rows = np.abs(speed) > SETTINGS.slow * np.sqrt(np.mean(speed**2)) * closed
    size = float(np.mean(torque[rows] ** 2)) if rows.sum() > free.shape[1] + 3 else 0.0
    if not size:
        return nothing
    # 1. Normal equations of columns of one size; what the free ones explain is taken out.
    columns = np.column_stack([own, free])[rows]
    scale = np.sqrt(np.mean(columns**2, axis=0))
    scale[scale == 0] = 1.0
    table = np.column_stack([columns / scale, torque[rows]])
    length = len(table) // SETTINGS.segments
    parts = table[: length * SETTINGS.segments].reshape(SETTINGS.segments, length, -1)
    segments = parts.transpose(0, 2, 1) @ parts / len(table)
    squares = table.T @ table / len(table)
    k = own.shape[1]
    free_squares = squares[k:-1, k:-1] + _RIDGE * np.eye(free.shape[1])
    across = squares[k:-1][:, [*range(k), -1]]
    mine = [*range(k), -1]
    by_free = np.linalg.solve(free_squares, across)
    reduced = squares[np.ix_(mine, mine)] - across.T @ by_free
    # 2. The likeliest coefficients that are not negative: of some of the columns.
    value, left = _not_negative(reduced)
    # Late counts in a loop add torque in proportion to speed: the part that the speed explains is
    # no merit of a hypothesis.
    by_speed = squares[1, -1] ** 2 / max(squares[1, 1], _RIDGE) if closed else 0.0
    beside_speed = max(squares[-1, -1] - by_speed, _RIDGE * size)
    share = max(left, 0.0) / beside_speed
    # 3. The coefficients of the free columns beside those, and standard deviations of all.
    coupling = (by_free[:, -1] - by_free[:, :k] @ value)[:others]
    std = _deviations(squares, segments, left / equations)
    value, std = (x / scale[: k + others] for x in (np.r_[value, coupling], std[: k + others]))
    inertia, viscous, coulomb = zip(value[:k], std[:k], strict=True)
    return Motion(
        *inertia,
        *viscous,
        *coulomb,
        unexplained=min(share, 1.0),
        beside_speed=beside_speed / squares[-1, -1],
        coupling=value[k:],
        coupling_std=std[k:],
    )


def _deviations(squares, segments, variance):
    """Standard deviations (k,) of a least-squares fit, of unit variance `variance`.

    squares (k + 1, k + 1), segments (S, k + 1, k + 1): normal equations of the log and of its
    parts. A jackknife over the parts covers what the regression lacks, which changes with the pose.
    """
    ridge = _RIDGE * np.eye(len(squares) - 1)
    inverse = np.linalg.inv(squares[:-1, :-1] + ridge)
    without = squares - segments
    values = np.linalg.solve(without[:, :-1, :-1] + ridge, without[:, :-1, -1:])[..., 0]
    moved = values - inverse @ squares[:-1, -1]
    jackknife = (len(segments) - 1) * np.mean(moved**2, axis=0)
    return np.sqrt(np.maximum(np.diag(inverse) * max(variance, 0.0), jackknife))


# Correlation of two columns of a torque that are one, in other units.
_THE_SAME = 0.999

# Relative weight that keeps normal equations of columns that are alike solvable: rounding errors
# of a sum of 2000 products are below it.
_RIDGE = 1e-9


def _not_negative(squares):
    """Least squares with coefficients that are not negative; what it leaves unexplained.

    squares (k + 1, k + 1): normal equations, the measured column last.
    """
    k = len(squares) - 1
    value, least = np.zeros(k), squares[-1, -1]
    # Of three columns there are seven choices; all of them is the usual one.
    for count in range(k, 0, -1):
        for some in itertools.combinations(range(k), count):
            chosen = list(some)
            inner = squares[np.ix_(chosen, chosen)] + _RIDGE * np.eye(count)
            target = squares[chosen, -1]
            coefficients = np.linalg.solve(inner, target)
            left = squares[-1, -1] - target @ coefficients
            if (coefficients >= 0).all() and left < least:
                value, least = np.zeros(k), left
                value[chosen] = coefficients
        if value.any():
            break
    return value, least


def _inertia_prior(motion, rotor):
    """Log likelihood of an inertia at the motor: not less than its rotor, nor a thousand times."""
    # A motion that is held tells neither an inertia nor its deviation.
    if not rotor or not 0 < motion.inertia_std < np.inf:
        return 0.0

    def log_prior(inertia):
        usual = np.log(inertia / rotor / SETTINGS.inertia) / SETTINGS.inertia_spread
        below = np.log(np.minimum(inertia / rotor / SETTINGS.rotor, 1.0)) / SETTINGS.rotor_spread
        return -(usual**2) / 2 - np.minimum(below**2, SETTINGS.surest) / 2

    return _likeliest(motion.inertia, motion.inertia_std, SETTINGS.inertia * rotor, log_prior)


def _likeliest(value, std, usual, log_prior):
    """Log likelihood of an estimate and of a positive quantity with a prior, at the likeliest one.

    An estimate that is not significant takes nothing from the prior's `usual` value.
    """
    quantity = np.append(value + std * _DEVIATIONS, usual)
    quantity = quantity[quantity > 0]
    return float((-(((quantity - value) / std) ** 2) / 2 + log_prior(quantity)).max())


# Standard deviations beside an estimate at which a quantity is tried: their step changes a log
# likelihood by less than a tenth.
_DEVIATIONS = np.linspace(-6, 6, 49)


def _coupling_prior(motions):
    """Log likelihood (n,) of the couplings: an inertia matrix has no negative eigenvalue."""
    n = len(motions)
    away = ~np.eye(n, dtype=bool)
    coupling, std = np.zeros((2, n, n))
    coupling[away] = np.concatenate([motion.coupling for motion in motions])
    std[away] = np.concatenate([motion.coupling_std for motion in motions])
    # |M_ij| <= sqrt(M_ii M_jj), by inertias as large as they may be.
    largest = np.sqrt([motion.inertia + motion.inertia_std for motion in motions])
    bound = np.outer(largest, largest)
    known = away & np.isfinite(bound) & np.isfinite(std + std.T)
    symmetric = np.where(known, coupling + coupling.T, 0.0)[known] / 2
    # The matrix is symmetric; what is not is an error of the regression.
    spread = np.sqrt(
        (std**2 + std.T**2)[known]
        + (coupling[known] - symmetric) ** 2
        + (SETTINGS.coupling_spread * bound[known]) ** 2
    )
    beyond = np.maximum((np.abs(symmetric) - bound[known]) / spread, 0.0)
    prior = np.zeros((n, n))
    prior[known] = -np.minimum(beyond**2, SETTINGS.surest) / 2
    return prior.sum(axis=1)


def _friction_prior(size, std, stated):
    """Log likelihood of a friction beside the stated one, which is measured, or a guess."""
    if not stated or not 0 < std < np.inf:
        return 0.0

    def log_prior(friction):
        distance = np.log(friction / stated)
        measured, guess = (
            np.log(share) - (distance / spread) ** 2 / 2 - np.log(spread)
            for share, spread in (
                (1 - SETTINGS.guessed, SETTINGS.friction_spread),
                (SETTINGS.guessed, SETTINGS.guess_spread),
            )
        )
        return np.logaddexp(measured, guess)

    return _likeliest(size, std, stated, log_prior)

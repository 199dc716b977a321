"""The torque equation of a log as it is stated, and how well the log fulfils it, whatever f is.

Least squares of the smoothed torques on the smoothed motion, with base parameters and friction of
any value, leaves a share of the torque. Where the chain states its bodies, the torque that they
need, times one common factor, leaves another share. Where the torque of a sampled law was not
logged, the law is run along the log, and its initial integral is a constant.
"""

import functools
import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from identification.equation_error.filters import derivatives, low_pass
from identification.equation_error.law_gains import MainGain, main_gain
from identification.equation_error.law_memory import is_under_way, torque_along_log
from identification.equation_error.leaning_base import LeaningBase
from identification.equation_error.regressor import regressor_along
from identification.equation_error.torque_logs import TorqueLog
from plant import Dynamics, Record, Rig
from plant.checkup import LEAST_MOTION, Signals, hardly_moving
from plant.motion import Motion
from plant.parts import Bools, Floats, Integers


@dataclass(frozen=True, kw_only=True)
class RestatedSettings:
    """How the residuals of two statements are compared.

    Parameters
    ----------
    equations : int
        Equations of a log that are compared, divided among its joints; chosen by hand.
    independent : float
        Independent equations that a log counts for, at most; chosen by hand. Errors of a model
        repeat along a motion, so more samples are no more evidence.
    repeating : float
        Time [s] in which these errors are alike: a short log has fewer independent equations. So
        chosen that logs of 3 s (``tests/benchmarks/causes.py``) have all of them. Right logs of 1.1
        to 1.8 s that begin within a motion (``tests/identification/search/test_memory.py``) would
        have log odds of up to 21 for late counts or other gains otherwise.
    floor : float
        Share of the torques (rms) that noise and friction leave in any case; chosen by hand.
    generated, generated_by_joint : float
        Power of friction, as a share of that of the torques, below which friction drives the
        motion instead of braking it, of all joints and of one; chosen by hand, well below what
        noise gives.
    unphysical : float
        Log odds against a statement under which friction does so, at most.
    suspected : float
        Share of the torques that must be left as stated, so that zeros, exchanges and timing are
        tried: they are many.
    tilts : tuple of float
        Angles [degrees] by which gravity is turned to find the likeliest tilt, one after the other.
    level : float
        Tilt [degrees] below which a base is level.
    reach : float
        Range [degrees] of the joint that moves furthest, below which no unit of positions is
        believed: collinear motions through 1 and 2 degrees are nearly linear, so that f of any
        value fits them better (``tests/benchmarks/any_rig.py``, seeds 8 and 20).
    braked : float
        Power of the stated friction, as a share of that of the torques, from which on a torque
        without friction shows.
    friction : float
        Standard deviation of the logarithm of friction before the log is read.
    usual : float
        Power of the friction of gears, as a share of that of the torques, where none is stated:
        0.9 and 0.5 in the logs of a UR10 and a Panda.
    unknown_state : float
        Log odds against any mistake of a log with half of the independent equations, if the state
        of its law before it is unknown: the integral is wrong, and so is the torque where the law
        saturates. Right logs of the same test have up to 5 for a mistake.
    against_gains : float
        Log odds against other gains of a law beside another mistake. They explain up to 3 of a
        right log, and 13 and more of one with other gains (``tests/benchmarks/causes.py``).
    drift : float
        Evidence of another bandwidth that drifting friction looks like: 2 beyond what is against
        another gain, with a margin (``tests/benchmarks/causes.py``).
    gains : float
        Standard deviation of a law's gains, relative: as of the cause "law gain" of
        ``identification/results/with_arm.py``.
    scale : float
        Factor by which the bodies that a chain states may be wrong together.
    roughly : float
        Share of the torques (rms) that those bodies leave in any case: 0.2 and 0.3 in the same
        logs.
    certain : float
        Standard deviations by which the friction of a joint must drive it.
    moving : float
        Share of the time of the filters in which a joint has moved in one direction, from which on
        its torque is compared; chosen by hand.
    by_joint : float
        Independent equations that a joint's torque counts for, where joints are judged apart.
    limits : tuple of float
        Shares of the largest torque that a law commands at which a limit is tried; chosen by hand,
        so that neighbours differ by less than the refinement.
    refined : tuple of float
        Factors by which the likeliest of these limits is refined; chosen by hand.
    counted_late : tuple of float
        Delays of the counts [samples] that are tried where a law's torque depends on them, and the
        largest one: those of loggers in ``tests/benchmarks/spoilers.py`` are 0.3 to 2.
    counted : float
        Error [samples] to which the likeliest of these is refined; chosen by hand.
    changed : tuple of float
        Changes [%] of the main gain of a law that are tried, between the smallest and the largest
        one: gains in ``tests/benchmarks/causes.py`` are 15 to 40 % off.
    refined_change : float
        Error [%] to which the likeliest of these is refined; chosen by hand.
    late : tuple of float
        Times [ms] by which torques may be late that are tried: a few cycles of a slow bus.
    near_limit, limited, mostly_limited : float
        Share of the amplifier's limit from which on a torque is at it, and share of the samples of
        a joint at it from which on variants of anti-windup are told apart. The right law of log 34
        of ``tests/benchmarks/any_rig.py``, 0.2 % of whose samples are at it, was called another
        variant with odds of 1e7. Chosen by hand. A law that is at it for more than the share
        `mostly_limited` has a constant torque: integrals that wound up along late counts of a
        UR5e left 0.0 % of it.
    """

    equations: int = 700
    independent: float = 40.0
    repeating: float = 0.075
    floor: float = 0.005
    generated: float = -0.02
    generated_by_joint: float = -0.3
    unphysical: float = 15.0
    suspected: float = 0.02
    tilts: tuple[float, ...] = (15.0, 10.0, 5.0, 5.0, 2.0)
    level: float = 3.0
    reach: float = 5.0
    braked: float = 0.02
    friction: float = 0.7
    usual: float = 0.2
    unknown_state: float = 8.0
    against_gains: float = 8.0
    drift: float = 6.0
    gains: float = 0.3
    near_limit: float = 0.98
    limited: float = 0.05
    mostly_limited: float = 0.5
    scale: float = 1.25
    roughly: float = 0.2
    certain: float = 3.0
    moving: float = 0.5
    by_joint: float = 20.0
    limits: tuple[float, ...] = (
        0.03,
        0.05,
        0.07,
        0.1,
        0.15,
        0.2,
        0.3,
        0.4,
        0.5,
        0.6,
        0.7,
        0.8,
        0.9,
    )
    refined: tuple[float, ...] = (0.82, 0.88, 0.94, 1.06, 1.12, 1.18)
    counted_late: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
    counted: float = 0.05
    changed: tuple[float, ...] = (-60.0, -40.0, -20.0, 20.0, 40.0, 70.0, 120.0)
    refined_change: float = 2.0
    late: tuple[float, ...] = (-80.0, -40.0, -20.0, -10.0, 10.0, 20.0, 40.0, 60.0, 80.0)


SETTINGS = RestatedSettings()


class Remainder(NamedTuple):
    """What least squares leaves of the torques, and the power of its friction, as shares.

    `left`, `power`: of all joints; `left_by_joint`, `power_by_joint` (n,): of each; `std` and
    `power_std` (n,): standard deviations of the powers. `gain`: relative change of a law's main
    gains, on average; 0 without one.
    """

    left: float
    power: float
    std: float
    left_by_joint: Floats
    power_by_joint: Floats
    power_std: Floats
    gain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class TorqueEquation:
    """Smoothed motion and torque of a log, with the statements that a hypothesis can change.

    `interval`: time between two samples [s]. `motion`, `torque`, `dry` (M, n): positions,
    speeds and accelerations, torques of the joints, and signs of the speeds, filtered alike.
    `rows`: samples that are compared. `weightless` (n,): joints whose torque is any that
    friction can carry. `unit` (n,): of the torques that are left, by default their rms.
    `gravity`: factor of the stated gravity. `tilt` (2,): angles [rad] about the level axes by
    which the base is tilted; None as stated. `constant`: whether each torque has an unknown
    constant. `commanded`: whether the torque is that of the law, none was logged.
    `frictionless`: whether it is known to have less friction in it than the rig states.
    `record`: the record as it is stated, and `signals`: its torques before they were smoothed;
    None of a band, and the record of a restated log. `main_gain`: of the law, where it was run;
    `open_gains`: whether it is unknown, joint by joint.
    """

    dynamics: Dynamics
    rig: Rig
    interval: float
    motion: Motion
    torque: Floats
    dry: Floats
    rows: Integers
    weightless: Bools
    gravity: float = 1.0
    tilt: Floats | None = None
    constant: bool = False
    commanded: bool = False
    frictionless: bool = False
    unit: Floats | None = None
    record: Record | None = None
    signals: Any = None
    main_gain: MainGain | None = None
    open_gains: bool = False

    @classmethod
    def of(cls, dynamics: Dynamics, record: Record) -> "TorqueEquation | None":
        """The equation of a record; None without a torque, or in too short a log."""
        record.rig.require_fit(dynamics.chain)
        law = record.law
        stated = record
        logged = record.torque is not None or record.current is not None
        sampled = not logged and law is not None and bool(law.period) and law.has_memory(record.n)
        gain = None
        if sampled:
            # The law's torque stands in for one that was not logged.
            under_way = is_under_way(dynamics, record)
            record = replace(record, torque=torque_along_log(record, under_way))
            gain = main_gain(stated, under_way)
        signals = Signals(record)
        if signals.motor_torque is None or not signals.long_enough:
            return None
        margin = _shift(len(signals.clear), signals.interval)
        rows = np.flatnonzero(signals.clear[margin : len(signals.clear) - margin]) + margin
        # Counts of zero are an angle, which speeds do not have.
        zero = record.rig.to_angle(np.zeros(record.n))
        positions, speeds, accelerations = map(record.rig.to_angle, signals.motion)
        dry = np.column_stack([signals.smooth_even(np.sign(x)) for x in signals.motion.speed.T])
        return cls(
            dynamics=dynamics,
            rig=record.rig,
            interval=signals.interval,
            motion=Motion(positions, speeds - zero, accelerations - zero),
            torque=record.rig.drive.gear * signals.smooth(signals.motor_torque),
            dry=dry,
            rows=rows[:: max(1, len(rows) * record.n // SETTINGS.equations)],
            weightless=hardly_moving(record),
            constant=sampled,
            commanded=not logged,
            record=stated,
            signals=signals,
            main_gain=gain,
        )

    @classmethod
    def of_band(cls, dynamics: Dynamics, log: TorqueLog, band: float) -> "TorqueEquation | None":
        """The equation of positions and torques in a band [Hz]; None where a torque is missing."""
        margin = max(math.ceil(1 / (band * log.rig.period)), _shift(len(log.q), log.rig.period))
        rows = np.arange(margin, len(log.q) - margin)
        if not np.isfinite(log.torque).all() or len(rows) < 2 * dynamics.p:
            return None
        period = log.rig.period
        motion = derivatives(log.q, period, band)
        return cls(
            dynamics=dynamics,
            rig=log.rig,
            interval=period,
            motion=motion,
            torque=low_pass(log.torque, period, band),
            dry=low_pass(np.sign(motion.qd), period, band),
            rows=rows[:: max(1, len(rows) * dynamics.n // SETTINGS.equations)],
            weightless=np.ptp(log.rig.position_in_pulses(log.q), axis=0) < LEAST_MOTION,
        )

    @functools.cached_property
    def columns(self) -> Floats:
        """Regressor (R, n, k) of f and friction in the rows that are compared."""
        if self.tilt is not None:
            return self._with_joints(self._base.regressor(self.tilt, self.gravity))
        motion = self._compared
        names = self.dynamics.names
        Y = regressor_along(self.dynamics, self.rig, names, motion)[0]
        if self.gravity != 1:
            # A pose at rest gives the part by gravity.
            resting = Motion(motion.q, 0 * motion.q, 0 * motion.q)
            still = regressor_along(self.dynamics, self.rig, names, resting)[0]
            Y = Y + (self.gravity - 1) * still
        return self._with_joints(Y)

    @property
    def _compared(self) -> Motion:
        """The motion in the rows that are compared."""
        return Motion(*(signal[self.rows] for signal in self.motion))

    @functools.cached_property
    def _base(self) -> LeaningBase:
        return LeaningBase.along(self.dynamics, self.rig, self._compared)

    def _with_joints(self, Y: Floats) -> Floats:
        """The regressor (R, n, k) of f, then columns of springs, of gains, and of friction."""
        motion = self._compared
        # Stiffness and rest of a stated spring are seldom exact: an arm is not accused of them.
        sprung = np.eye(self.dynamics.n)[np.any(self._springs != 0, axis=0)].T
        springs = [sprung * term[:, :, None] for term in (motion.q, np.ones_like(motion.q))]
        return np.concatenate([Y, *springs, *self._gains, *self._friction], axis=2)

    @functools.cached_property
    def _gains(self) -> list[Floats]:
        """Column (R, n, n) of main gains that are open."""
        if not self.open_gains or self.main_gain is None:
            return []
        effect = self.signals.smooth(self.signals.rows(self.main_gain.effect))
        # The law would add this torque to the stated one, on the other side of the equation.
        return [-np.eye(self.dynamics.n) * effect[self.rows][:, :, None]]

    @property
    def gains_of_joints(self) -> bool:
        """Whether a law was run that has a main gain of each joint."""
        return self.main_gain is not None and self.main_gain.by_joint

    @functools.cached_property
    def with_open_gains(self) -> "TorqueEquation":
        """The same log, with any main gains of its law."""
        equation = replace(self, open_gains=True)
        place = self.columns.shape[2] - _width(self._friction)
        columns = np.insert(self.columns, [place] * self.dynamics.n, equation._gains[0], axis=2)
        return equation.with_columns(columns, self.needed)

    @property
    def _springs(self) -> Floats:
        """Torque (R, n) of the stated springs, which the motors need not give."""
        q = self.motion.q[self.rows]
        return np.zeros_like(q) + self.rig.spring_torque(q)

    @functools.cached_property
    def needed(self) -> Floats | None:
        """Torque (R, n) that the stated bodies need; None without them."""
        if not self.dynamics.chain.bodies:
            return None
        # Which parameters act depends on the direction of gravity.
        dynamics = self.dynamics if self.tilt is None else self._base.arms[0]
        return self.columns[:, :, : dynamics.p] @ dynamics.f()

    @property
    def _friction(self) -> list[Floats]:
        """Columns (R, n, n) of viscous and dry friction, and of a constant torque."""
        motion = self._compared
        terms = (motion.qd, self.dry[self.rows], np.ones_like(motion.qd))
        eye = np.eye(self.dynamics.n)
        return [eye * term[:, :, None] for term in terms[: 2 + self.constant]]

    @functools.cached_property
    def likeliest_tilt(self) -> Floats:
        """The likeliest tilt (2,) [rad] about the level axes of the base."""

        def unlikely(tilt):
            # The regressors of the three directions serve every tilt.
            equation = replace(self, tilt=tilt)
            equation.__dict__["_base"] = self._base
            return -equation.evidence

        tilt = np.zeros(2)
        for step in np.deg2rad(SETTINGS.tilts):
            middle = unlikely(tilt)
            moves = np.zeros(2)
            for axis, move in enumerate(step * np.eye(2)):
                less, more = unlikely(tilt - move), unlikely(tilt + move)
                # The vertex of a parabola through three values, or a step downhill.
                curvature = less - 2 * middle + more
                vertex = (less - more) / (2 * curvature) if curvature > 0 else np.sign(less - more)
                moves[axis] = step * np.clip(vertex, -2, 2)
            tilt = tilt + moves
        return tilt

    @property
    def likeliest_gravity(self) -> Floats:
        """Gravity (3,) [m/s^2] of the chain on a base with the likeliest tilt."""
        return self.gravity * self._base.turned(self.likeliest_tilt)

    def cut_off(self, limits: Floats) -> "TorqueEquation":
        """The same motion with torques that are limited (n,) [N m] at the motors."""
        limited = np.clip(self.signals.motor_torque, -limits, limits)
        return self.with_torque(self.rig.drive.gear * self.signals.smooth(limited))

    @functools.cached_property
    def likeliest_limits(self) -> Floats:
        """The likeliest limits (n,) [N m] of the motors' torques, each of a few."""
        largest = np.abs(self.signals.motor_torque).max(axis=0)
        limits = largest.copy()
        joints = range(self.dynamics.n)
        for i in joints:
            limits = self._likeliest(limits, i, largest[i] * np.array([*SETTINGS.limits, 1.0]))
        for i in joints:
            limits = self._likeliest(limits, i, limits[i] * np.array([*SETTINGS.refined, 1.0]))
        return np.minimum(limits, largest)

    def _likeliest(self, limits: Floats, joint: int, trials: Floats) -> Floats:
        """The limits (n,) with the likeliest of some trials at a joint."""
        rows = np.tile(limits, (len(trials), 1))
        rows[:, joint] = trials
        return rows[np.argmax([self.cut_off(row).evidence for row in rows])]

    @property
    def independent(self) -> float:
        """Independent equations that the log counts for."""
        duration = len(self.torque) * self.interval
        return min(SETTINGS.independent, duration / SETTINGS.repeating)

    @property
    def against_any(self) -> float:
        """Log odds against any mistake: of a law whose state is unknown, in a short log."""
        return (
            self.constant * SETTINGS.unknown_state * (SETTINGS.independent / self.independent - 1)
        )

    def _repeating(self, equations: int) -> float:
        """Factor of the error of an equation: errors repeat along a motion, so fewer count."""
        return math.sqrt(max(1.0, equations / (2 * self.independent)))

    @functools.cached_property
    def evidence(self) -> float:
        """Log likelihood of the statements: of what is left, of the stated bodies, of friction."""
        return (
            -self.independent * math.log(self.left + SETTINGS.floor)
            - min(SETTINGS.unphysical, self._driving)
            + self.evidence_of_bodies(self.scale)
        )

    @property
    def evidence_at_best(self) -> float:
        """The same, or that of other main gains if they are likelier, for all that is against them.

        Of two mistakes at once neither may explain more of a log than none.
        """
        if self.open_gains or not self.gains_of_joints:
            return self.evidence
        return max(self.evidence, self.with_open_gains.evidence - SETTINGS.against_gains)

    @property
    def _driving(self) -> float:
        """Log odds for friction of its usual size that drives the motion, against one that brakes.

        A short log gives friction hundreds of times the power of the torques: that is neither.
        """
        fitted = self.fitted
        limits = np.full(self.dynamics.n + 1, SETTINGS.generated_by_joint)
        limits[-1] = SETTINGS.generated
        power = np.append(fitted.power_by_joint, fitted.power)
        std = np.append(fitted.power_std, fitted.std)
        known = np.maximum(std, 1e-9)
        usual = max(self.braking, SETTINGS.usual)
        # The deviation of a dead column has no square.
        odds = -2 * (usual / known) * (power / known)
        return float(odds[power + SETTINGS.certain * std < limits].max(initial=0.0))

    @property
    def left(self) -> float:
        """Share (rms) of the torques that the equation of motion leaves; NaN where none moves."""
        return self.fitted.left

    @functools.cached_property
    def of_joints(self) -> tuple[Floats, Floats, Floats]:
        """Columns (R n, k) and torques (R n,) in units of the torques; one over these units (R, n).

        It is zero where nothing is compared.
        """
        # Static friction carries any torque of a joint that rests.
        moving = np.abs(self.dry[self.rows]) > SETTINGS.moving
        torque = (self.torque[self.rows] + self._springs) * moving
        unit = self.unit
        if unit is None:
            # Of the motors alone: positions in another unit would change what springs bear.
            unit = np.sqrt(np.mean((self.torque[self.rows] * moving) ** 2, axis=0))
        unit = np.where(self.weightless | (unit == 0), np.inf, unit)
        A = (self.columns * (moving / unit)[:, :, None]).reshape(torque.size, -1)
        # Each column in units of its largest value.
        A /= np.maximum(np.abs(A).max(axis=0), 1e-300)
        return A, (torque / unit).ravel(), moving / unit

    @functools.cached_property
    def fitted(self) -> Remainder:
        """What least squares leaves of the torques, and the power of its friction."""
        A, b, scale = self.of_joints
        # The products of the columns are many times faster, and exact enough for a share of 1e-4.
        inverse = np.linalg.pinv(A.T @ A + self._prior, rcond=1e-12, hermitian=True)
        values = inverse @ (A.T @ b)
        remaining = (b - A @ values).reshape(scale.shape)
        left = float(np.sqrt(np.mean(remaining**2)))
        speed = self.motion.qd[self.rows]
        power = np.abs(speed * b.reshape(speed.shape)).sum(axis=0)
        # Work of the friction of each joint per unit of the values; f does none of it.
        work = (speed[:, :, None] * A.reshape(*speed.shape, -1)).sum(axis=0)
        work[:, : -_width(self._friction)] = 0.0
        error = left * self._repeating(b.size)
        std = error * np.sqrt(np.einsum("jk,kl,jl->j", work, inverse, work).clip(0))
        total = work.sum(axis=0)
        # Joints whose gain hardly acts say little about it.
        acting = float(values[self._places_of_gains] @ self._gain_sizes)
        return Remainder(
            left=left,
            power=float(total @ values / (power.sum() or 1.0)),
            std=error * math.sqrt(max(total @ inverse @ total, 0.0)) / (power.sum() or 1.0),
            left_by_joint=np.sqrt(np.mean(remaining**2, axis=0)),
            power_by_joint=work @ values / np.maximum(power, 1e-300),
            power_std=std / np.maximum(power, 1e-300),
            gain=acting / float((self._gain_sizes**2).sum() or 1.0),
        )

    @functools.cached_property
    def _gain_sizes(self) -> Floats:
        """Largest torque (n,), in its unit, per relative change of each joint's main gain."""
        scale = self.of_joints[2]
        largest = [np.abs(gains * scale[:, :, None]).max(axis=(0, 1)) for gains in self._gains]
        return np.concatenate([np.empty(0), *largest])

    @functools.cached_property
    def _prior(self) -> Floats:
        """Information (k, k) on the values of the columns: gains are nearly as stated.

        Without it, gains of zero would explain any log with a torque of nothing.
        """
        A, b, _ = self.of_joints
        information = np.zeros(A.shape[1])
        error = SETTINGS.floor * self._repeating(b.size)
        usual = SETTINGS.gains * self._gain_sizes
        information[self._places_of_gains] = (error / np.where(usual > 0, usual, np.inf)) ** 2
        return np.diag(information)

    @property
    def _places_of_gains(self) -> slice:
        """The columns of gains, which stand before those of friction."""
        end = self.columns.shape[2] - _width(self._friction)
        return slice(end - _width(self._gains), end)

    @functools.cached_property
    def _beside_friction(self) -> Floats | None:
        """Torques, and those that the stated bodies need (2, R n), without friction of any size."""
        if self.needed is None:
            return None
        A, b, scale = self.of_joints
        F = A[:, -_width([*self._gains, *self._friction]) :]
        torques = np.column_stack([b, (self.needed * scale).ravel()])
        return (torques - F @ np.linalg.lstsq(F.T @ F, F.T @ torques, rcond=1e-12)[0]).T

    @functools.cached_property
    def scale(self) -> float:
        """The torques, in units of those that the stated bodies need; 1 without bodies."""
        if self._beside_friction is None:
            return 1.0
        torques, needed = self._beside_friction
        return max(0.0, float(needed @ torques / max(needed @ needed, 1e-300)))

    def evidence_of_bodies(self, scale: float) -> float:
        """Log likelihood of the stated bodies, whose torques are so many times as large."""
        if self._beside_friction is None:
            return 0.0
        torques, needed = self._beside_friction
        left = float(np.sqrt(np.mean((torques - scale * needed) ** 2)))
        return -self.independent * math.log(left + SETTINGS.roughly)

    @property
    def braking(self) -> float:
        """Power of the stated friction, as a share of that of the torques."""
        drive = self.rig.drive
        speed = self.motion.qd[self.rows]
        # Signs are those of the counts, which a gear may turn.
        dry = np.abs(self.dry[self.rows]) * np.sign(speed)
        friction = drive.joint_viscous() * speed + drive.joint_coulomb() * dry
        return float((speed * friction).sum() / (np.abs(speed * self.torque[self.rows]).sum() or 1))

    def with_columns(self, columns: Floats, needed: Floats | None) -> "TorqueEquation":
        """The same log with another regressor (R, n, k), and torque (R, n) of the bodies."""
        equation = replace(self)
        equation.__dict__.update(columns=columns, needed=needed)
        return equation

    def with_torque(self, torque: Floats) -> "TorqueEquation":
        """The same motion with another torque (M, n): its regressor stays."""
        return self.restated(torque=torque).with_columns(self.columns, self.needed)

    def restated(self, **changes: Any) -> "TorqueEquation":
        """The same log with other statements, no longer that of its record."""
        return replace(self, record=None, **changes)


def _width(blocks: list[Floats]) -> int:
    """Number of columns of some blocks (R, n, k)."""
    return sum(block.shape[2] for block in blocks)


def _shift(rows: int, period: float) -> int:
    """Samples at either end of a log that are not compared, so that torques can be shifted."""
    return min(round(1e-3 * max(SETTINGS.late) / period), rows // 8)

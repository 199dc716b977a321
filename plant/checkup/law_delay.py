"""Delay of the counts under a law with memory: only the right rows give the logged torque.

The law is run along the counts of the log, shifted by whole samples. Its memory before the log is
unknown, so two quantities without it are compared: the steps of the torques, in which an integral
cancels, and smoothed torques without their mean.
"""

from dataclasses import dataclass

import numpy as np

from plant.checkup.signals import Signals
from plant.laws.resumed import FAST, Resumed
from plant.motion.smooth_splines import smooth_splines
from plant.parts.fields import Floats


@dataclass(frozen=True, kw_only=True)
class LawDelaySettings:
    """Numbers of the search for the rows that a law with memory read, chosen by hand.

    Parameters
    ----------
    earliest, latest : int
        Samples by which counts may be late; negative is early.
    rounds : int
        Searches over all joints, since the torque of one may depend on the counts of another.
    better : float
        Residual that the right rows may leave, as a share of the residual of the next best rows.
    same : float
        Residual [share of the torque] below which two residuals do not differ.
    samples : int
        Samples in the middle of the log along which the law is run.
    period : float
        Largest ratio of the law's period, and of the rig's, to the interval of the log.
    """

    earliest: int = -2
    latest: int = 3
    rounds: int = 3
    better: float = 0.25
    same: float = 1e-4
    samples: int = 5000
    period: float = 1.01


SETTINGS = LawDelaySettings()


def law_delays(signals: Signals) -> Floats:
    """Samples (n,) by which the counts of each joint are late; NaN where the torque does not tell.

    Fast hardware leaves only the smoothed torques. They alone do not show that nothing is late,
    since a law lags by itself.
    """
    late = np.zeros(signals.n, int)
    unknown = np.full(signals.n, np.nan)
    law = _law_along_log(signals)
    if law is None:
        return unknown
    run = _RunAlongLog(signals, law)
    shifts = np.arange(SETTINGS.earliest, SETTINGS.latest + 1)
    for _ in range(SETTINGS.rounds):
        # For each joint, the shift with the least residual of steps, and of smoothed torques.
        residuals = np.array([run.residuals(late + shift) for shift in shifts])
        by_steps, by_smoothed = residuals.argmin(axis=0)
        least, following = np.sort(residuals, axis=0)[:2]
        steps_clear, smoothed_clear = least + SETTINGS.same < SETTINGS.better * following
        # The steps decide where they are clear; otherwise both quantities must agree.
        agree = by_steps == by_smoothed
        correction = np.where(steps_clear | agree, shifts[by_steps], 0)
        if not correction.any():
            return np.where(steps_clear | (smoothed_clear & agree & (late != 0)), late, unknown)
        # A corrected joint changes the torque of others: search again.
        late += correction
    return unknown


def _law_along_log(signals):
    """The law that reads the counts of the log; None where its torque cannot be compared."""
    law = signals.record.law
    rig = signals.rig
    # Laws without memory have the better estimate of `tracking.law_fit`.
    if law is None or law.replays or not law.has_memory(signals.n) or signals.reference is None:
        return None
    # The logged torque is the yardstick.
    if signals.torque is None or not (signals.long_enough and signals.tracks.all()):
        return None
    # A slower law would need the rows between those of the log.
    slower = (law.period or 0.0) > SETTINGS.period * signals.interval
    if slower or not 1 / SETTINGS.period < signals.interval / rig.period < SETTINGS.period:
        return None
    # A law that is resumed has a memory already; any other starts with its initial one.
    if not isinstance(law, Resumed):
        law = Resumed(law=law, state=law.initial_state(signals.n))
    return law.along(rig)


class _RunAlongLog:
    """A law run along the middle of a log, at even times."""

    def __init__(self, signals, law):
        self.signals = signals
        self.law = law
        record = signals.record
        rig = signals.rig
        # The middle of the log, where its filters have rows on both sides.
        start = max(0, (len(signals.clear) - SETTINGS.samples) // 2)
        # The law starts with the wrong memory, and filters need rows on both sides.
        self.clear = signals.clear[start : start + SETTINGS.samples].copy()
        self.clear[: signals.window] = False
        self.clear[-signals.window :] = False
        self.t = signals.t[0] + signals.interval * (start + np.arange(len(self.clear)))
        # Fast hardware has no period: it is run some steps per sample.
        self.period = law.period or signals.interval / FAST
        self.steps = np.arange(self.t[0], self.t[-1] + self.period / 2, self.period)
        self.counts = law.replayed(record)
        self.reference = _at_times(self.steps, signals.t, signals.reference)
        self.motion = [np.zeros_like(self.reference)] * 3
        step = law.block(rig).step
        # The law's outputs, torque and state, may depend on the inputs 1 to 3: reference position,
        # velocity and acceleration. Splines of a logged reference are made only if they do.
        if record.reference is not None:
            self.motion = record.reference(self.steps - record.t[0])
        elif any(step.jac_sparsity(out, of).nnz() for out in (0, 1) for of in (1, 2, 3)):
            self.motion = self._smooth_motion()
        self.injected = 0.0
        if record.injected is not None:
            self.injected = _at_times(self.t, record.t, record.injected)
        # The amplifier limits what the law commands, so compare limited torques.
        logged = _at_times(self.t, signals.t, signals.torque)
        self.logged = self._limited(rig.drive.joint_torque(logged))

    def _smooth_motion(self):
        """Position, velocity and acceleration of the logged reference."""
        signals = self.signals
        rig = signals.rig
        rows = (signals.t >= self.t[0]) & (signals.t <= self.t[-1])
        reference = signals.reference[rows]
        encoder = rig.encoder
        # Whole pulses were rounded from a smooth path: the splines may pass anywhere in the cells.
        whole = bool((reference == np.trunc(reference)).all())
        if whole:
            reference = encoder.position_in_pulses(encoder.cell_centre(reference))
        # The law needs velocities and accelerations, which differences of whole pulses do not give.
        splines = smooth_splines(signals.t[rows], reference, whole, 1.0)
        return [
            rig.to_angle(np.column_stack([spline(self.steps, order) for spline in splines]))
            for order in range(3)
        ]

    def residuals(self, late):
        """Deviation (n,) from the logged torque, relative to it: of its steps, and smoothed.

        `late` (n,): samples by which the counts were late.
        """
        signals = self.signals
        t = signals.record.t
        counts = [
            # Late counts stand so many samples behind the row in which the law read them.
            np.interp(self.steps + samples * signals.interval, t, column)
            for samples, column in zip(late, self.counts.T, strict=True)
        ]
        columns = *self.motion, self.reference, np.column_stack(counts)
        ((torque, _),) = self.law.steps(signals.rig, columns, self.period, [self.law.state])
        # Each sample has the torque of the last step of the law up to it.
        step = np.floor((self.t - self.t[0]) / self.period + 1e-6).astype(int)
        deviation = self._limited(torque[step] + self.injected) - self.logged
        steps = self._mean_step(deviation) / np.maximum(self._mean_step(self.logged), 1e-300)
        smoothed = self._mean_size(deviation) / np.maximum(self._mean_size(self.logged), 1e-300)
        return steps, smoothed

    def _mean_step(self, torque):
        return np.abs(np.diff(torque, axis=0))[self.clear[1:]].mean(axis=0)

    def _mean_size(self, torque):
        """Mean size (n,) of smoothed torque about its mean, in which unknown memory cancels."""
        smooth = np.column_stack([self.signals.smooth_even(column) for column in torque.T])
        smooth = smooth[self.clear]
        return np.abs(smooth - smooth.mean(axis=0)).mean(axis=0)

    def _limited(self, torque):
        """Motor torques of joint torques (M, n), within the amplifier's limit."""
        drive = self.signals.rig.drive
        return drive.motor_torque(drive.limited(torque))


def _at_times(times, t, columns):
    return np.column_stack([np.interp(times, t, column) for column in columns.T])

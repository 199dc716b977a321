"""When a loop is sampled: evenly, or at the time stamps of a log."""

from __future__ import annotations

import dataclasses

import numpy as np

__all__ = ["Clock"]

_EVEN = 0.01
"""Periods by which time stamps may be off and still count as even."""

_OTHER = 0.1
"""Share by which the usual interval of a log may differ from its rig's period."""

_LONGEST = 1.5
"""Periods after which a gap is bridged by samples that nobody has measured."""


@dataclasses.dataclass(frozen=True, eq=False)
class Clock:
    """Samples of a loop, and the sub-steps between them.

    Parameters
    ----------
    t : (M,) numpy.ndarray
        Times of the samples, from 0 [s].
    lengths : (M,) numpy.ndarray
        From each sample to the next [s].
    rows : (N,) numpy.ndarray of int
        Which of them are in the log; those between bridge a gap.
    even : float or None
        The period, where all intervals have it.
    """

    t: np.ndarray
    lengths: np.ndarray
    rows: np.ndarray
    even: float | None

    @classmethod
    def regular(cls, samples, period):
        """So many samples at k period."""
        return cls(np.arange(samples) * period, np.full(samples, period), np.arange(samples), period)

    @classmethod
    def of(cls, record):
        """The clock of a record: its time stamps, or k period where they are that.

        In a gap of more than 1.5 periods, samples are put between that nobody has measured, so that no step is longer
        than what the rig's period allows.

        Raises
        ------
        ValueError
            Time stamps that have nothing to do with the rig's period.
        """
        t, period = record.t - record.t[0], record.rig.period
        late = t - np.arange(len(t)) * period
        if np.abs(late).max() <= _EVEN * period:
            return cls.regular(len(t), period)
        lengths = np.append(np.diff(t), period)
        usual = float(np.median(lengths))
        if abs(usual - period) > _OTHER * period:
            wrong = int(np.argmax(np.abs(late) > _EVEN * period))
            raise ValueError(
                f"t must advance by the rig's period {period:.6g} s, or nearly; sample {wrong} is {late[wrong]:+.3g} s "
                f"off, and the usual interval is {usual:.6g} s. Correct the period, or the unit of t."
            )
        parts = np.ceil(lengths / (_LONGEST * period) - 1e-9).astype(int)
        first = np.cumsum(parts) - parts
        within = np.arange(parts.sum()) - np.repeat(first, parts)
        shorter = lengths / parts
        return cls(np.repeat(t, parts) + within * np.repeat(shorter, parts), np.repeat(shorter, parts), first, None)

    def __len__(self):
        return len(self.t)

    def place(self, t):
        """Place (K,) of times among the samples of the log, as a fraction between two; whole ones are exact."""
        if self.even is not None:
            place = np.asarray(t) / self.even
            return np.where(np.abs(place - np.round(place)) < 1e-9, np.round(place), place)
        return np.interp(t, self.t[self.rows], np.arange(len(self.rows)))

    def apart(self, rows):
        """From samples of the log to the next, (K, 1) [s]."""
        if self.even is not None:
            return self.even
        return np.append(np.diff(self.t[self.rows]), self.lengths[-1])[rows][:, None]

    def bridged(self, values):
        """Values (N, m) of the log's samples for all samples (M, m), on straight lines across gaps."""
        return np.column_stack([np.interp(np.arange(len(self)), self.rows, column) for column in values.T])

    def measured(self, values):
        """Values (N, m) of the log's samples for all samples (M, m), zero between."""
        filled = np.zeros((len(self), values.shape[1]))
        filled[self.rows] = values
        return filled

    def starts(self, steps, every=1):
        """Start (K,) [s] of every so many sub-steps, with so many sub-steps per sample."""
        if self.even is not None:
            return np.arange(-(-len(self) * steps // every)) * (self.even / steps * every)
        return (self.t[:, None] + self.lengths[:, None] / steps * np.arange(steps)).ravel()[::every]

    def step_lengths(self, steps):
        """Length (K,) [s] of all sub-steps."""
        if self.even is not None:
            return np.full(len(self) * steps, self.even / steps)
        return np.repeat(self.lengths / steps, steps)

    def middles(self, steps):
        """Middle (K,) [s] of all sub-steps."""
        if self.even is not None:
            return (np.arange(len(self) * steps) + 0.5) * (self.even / steps)
        return self.starts(steps) + self.step_lengths(steps) / 2

"""Sampling times of a loop: even, or the time stamps of a log."""

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plant.parts import Floats, frozen_settings


@frozen_settings
class ClockSettings:
    """Tolerances of time stamps, in periods of the rig, and the size of gaps; chosen by hand.

    Parameters
    ----------
    even : float
        Time stamps count as even if no sample k is further than this from k periods.
    period : float
        Largest relative difference of a log's median interval from its rig's period.
    longest : float
        Interval above which a gap is bridged by samples without measurement.
    bridging : int
        Most samples without measurement: 14 hours at 1 kHz. An instant that is wrong, such as a
        date among seconds, would need more than any memory holds.
    """

    even: float = 0.01
    period: float = 0.1
    longest: float = 1.5
    bridging: int = 1 << 25


SETTINGS = ClockSettings()


@dataclass(frozen=True, eq=False)
class Clock:
    """Samples of a loop, and the sub-steps between them."""

    # Times (M,) of the samples, from 0 [s].
    t: NDArray[Any]
    # Length (M,) from each sample to the next [s].
    lengths: NDArray[Any]
    # Places (N,) of the samples that are in the log; the others bridge a gap.
    rows: NDArray[np.int_]
    # The period [s] if all intervals have it.
    even: float | None

    @classmethod
    def regular(cls, samples: int, period: float) -> Self:
        """An even clock: sample k is at k * period [s]."""
        return cls(
            np.arange(samples) * period, np.full(samples, period), np.arange(samples), period
        )

    @classmethod
    def of(cls, record: Any) -> Self:
        """The clock of a record: its time stamps, or k * period for sample k if they are even.

        Samples without measurement divide each interval of more than `SETTINGS.longest` periods
        into equal parts, so that no part is longer than this limit.
        """
        t = record.t - record.t[0]
        period = record.rig.period
        lateness = t - np.arange(len(t)) * period
        uneven = np.abs(lateness) > SETTINGS.even * period
        if not uneven.any():
            return cls.regular(len(t), period)
        intervals = np.diff(t)
        median = float(np.median(intervals))
        if abs(median - period) > SETTINGS.period * period:
            wrong = int(np.argmax(uneven))
            raise ValueError(
                f"t must advance by the rig's period {period:.6g} s, or nearly; sample {wrong} is"
                f" {lateness[wrong]:+.3g} s off, and the usual interval is {median:.6g} s. Correct"
                " the period, or the unit of t."
            )
        # The last sample is held for one period.
        lengths = np.append(intervals, period)
        # Each interval begins at a sample of the log and has equal parts; most have one part, and
        # the shortest are rounded to none.
        parts = np.maximum(np.ceil(lengths / (SETTINGS.longest * period) - 1e-9), 1)
        # Before they are whole numbers, which a gap of any length may exceed.
        if parts.sum() - len(parts) > SETTINGS.bridging:
            longest = int(np.argmax(lengths))
            got = f"{lengths[longest]:.6g} s pass after sample {longest}"
            raise ValueError(
                f"t must have gaps of at most {SETTINGS.bridging} samples in all; {got}. Correct"
                " the instant, or cut the log there."
            )
        parts = parts.astype(int)
        rows = np.cumsum(parts) - parts
        within = np.arange(parts.sum()) - np.repeat(rows, parts)
        shorter = np.repeat(lengths / parts, parts)
        return cls(np.repeat(t, parts) + within * shorter, shorter, rows, None)

    def __len__(self) -> int:
        return len(self.t)

    def place(self, t: NDArray[Any]) -> Floats:
        """Index (K,) in the log of each time t [s], with a fraction if t is between two samples."""
        if self.even is not None:
            place = np.asarray(t) / self.even
            # The quotient may have a rounding error; the time of a sample must give a whole index.
            return np.where(np.abs(place - np.round(place)) < 1e-9, np.round(place), place)
        return np.interp(t, self.t[self.rows], np.arange(len(self.rows)))

    def apart(self, rows: NDArray[np.int_]) -> Floats | float:
        """Intervals (K, 1) [s] after the samples `rows` of the log; one number if all are even."""
        if self.even is not None:
            return self.even
        # The interval across a gap is the whole gap.
        return np.append(np.diff(self.t[self.rows]), self.lengths[-1])[rows][:, None]

    def bridged(self, values: Floats) -> Floats:
        """Values (N, m) of the log for all samples (M, m), on straight lines across gaps."""
        return np.column_stack(
            [np.interp(np.arange(len(self)), self.rows, column) for column in values.T]
        )

    def between(self, values: Floats, t: NDArray[Any]) -> Floats:
        """Values (N, m) of the log at times t (K,) [s], (K, m), on straight lines."""
        place = self.place(t)
        rows = np.arange(len(self.rows))
        return np.column_stack([np.interp(place, rows, column) for column in values.T])

    def measured(self, values: Floats) -> Floats:
        """Values (N, m) of the log for all samples (M, m), zero in the samples between."""
        # If the values are weights, zero excludes the samples that bridge a gap.
        filled = np.zeros((len(self), values.shape[1]))
        filled[self.rows] = values
        return filled

    def starts(self, steps: int, places: NDArray[np.int_], every: int = 1) -> NDArray[Any]:
        """Starts (K,) [s] of the sub-steps `places`, multiples of `every`; a sample has `steps`."""
        if self.even is not None:
            return places // every * (self.even / steps * every)
        sample = places // steps
        return self.t[sample] + self.lengths[sample] / steps * (places % steps)

    def step_lengths(self, steps: int, places: NDArray[np.int_]) -> NDArray[Any]:
        """Length (K,) [s] of some sub-steps (K,)."""
        if self.even is not None:
            return np.full(len(places), self.even / steps)
        return self.lengths[places // steps] / steps

    def middles(self, steps: int, places: NDArray[np.int_]) -> NDArray[Any]:
        """Middle (K,) [s] of some sub-steps (K,)."""
        if self.even is not None:
            return (places + 0.5) * (self.even / steps)
        return self.starts(steps, places) + self.step_lengths(steps, places) / 2

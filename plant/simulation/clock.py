"""Sampling times of a loop: even, or the time stamps of a log."""

import dataclasses
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from plant.parts.fields import Floats

_EVEN = 0.01  # jitter [periods] up to which time stamps count as even

_OTHER = 0.1  # largest relative difference of a log's median interval from its rig's period

_LONGEST = 1.5  # periods above which a gap is bridged by samples without measurement


@dataclasses.dataclass(frozen=True, eq=False)
class Clock:
    """Samples of a loop at times t (M,) from 0 [s], and the sub-steps between them.

    `lengths` (M,) are from each sample to the next [s], `rows` (N,) those of the samples that are
    in the log (the others bridge a gap), `even` is the period where all intervals have it.
    """

    t: NDArray[Any]
    lengths: NDArray[Any]
    rows: NDArray[np.int_]
    even: float | None

    @classmethod
    def regular(cls, samples: int, period: float) -> Self:
        """So many samples at k period."""
        return cls(
            np.arange(samples) * period, np.full(samples, period), np.arange(samples), period
        )

    @classmethod
    def of(cls, record: Any) -> Self:
        """The clock of a record: its time stamps, or k period where they are that.

        A gap of more than 1.5 periods is divided by samples without measurement, so that no
        sub-step is longer than the rig's period allows.
        """
        t = record.t - record.t[0]
        period = record.rig.period
        late = t - np.arange(len(t)) * period
        if np.abs(late).max() <= _EVEN * period:
            return cls.regular(len(t), period)
        lengths = np.append(np.diff(t), period)
        usual = float(np.median(lengths))
        if abs(usual - period) > _OTHER * period:
            wrong = int(np.argmax(np.abs(late) > _EVEN * period))
            raise ValueError(
                f"t must advance by the rig's period {period:.6g} s, or nearly; sample {wrong} is"
                f" {late[wrong]:+.3g} s off, and the usual interval is {usual:.6g} s. Correct the"
                " period, or the unit of t."
            )
        parts = np.ceil(lengths / (_LONGEST * period) - 1e-9).astype(int)
        first = np.cumsum(parts) - parts
        within = np.arange(parts.sum()) - np.repeat(first, parts)
        shorter = lengths / parts
        return cls(
            np.repeat(t, parts) + within * np.repeat(shorter, parts),
            np.repeat(shorter, parts),
            first,
            None,
        )

    def __len__(self) -> int:
        return len(self.t)

    def place(self, t: NDArray[Any]) -> Floats:
        """Index (K,) of times in the log, with the fraction between two samples; whole ones are
        exact.
        """
        if self.even is not None:
            place = np.asarray(t) / self.even
            return np.where(np.abs(place - np.round(place)) < 1e-9, np.round(place), place)
        return np.interp(t, self.t[self.rows], np.arange(len(self.rows)))

    def apart(self, rows: NDArray[np.int_]) -> Floats | float:
        """Intervals from samples of the log to the next, (K, 1) [s]; one number where they are
        even.
        """
        if self.even is not None:
            return self.even
        return np.append(np.diff(self.t[self.rows]), self.lengths[-1])[rows][:, None]

    def bridged(self, values: Floats) -> Floats:
        """Values (N, m) of the log's samples for all samples (M, m), on straight lines across
        gaps.
        """
        return np.column_stack(
            [np.interp(np.arange(len(self)), self.rows, column) for column in values.T]
        )

    def between(self, values: Floats, t: NDArray[Any]) -> Floats:
        """Values (N, m) of the log's samples at times t (K,) [s], (K, m), on straight lines."""
        place = self.place(t)
        rows = np.arange(len(self.rows))
        return np.column_stack([np.interp(place, rows, column) for column in values.T])

    def measured(self, values: Floats) -> Floats:
        """Values (N, m) of the log's samples for all samples (M, m), zero between."""
        filled = np.zeros((len(self), values.shape[1]))
        filled[self.rows] = values
        return filled

    def starts(self, steps: int, places: NDArray[np.int_], every: int = 1) -> NDArray[Any]:
        """Start (K,) [s] of some sub-steps (K,), whole multiples of `every`, with so many
        sub-steps per sample.
        """
        if self.even is not None:
            return places // every * (self.even / steps * every)
        owner = places // steps
        return self.t[owner] + self.lengths[owner] / steps * (places % steps)

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

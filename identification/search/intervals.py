"""Intervals of resonances by their profile likelihood, and whether a log tells a gear from a rigid one."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from identification.replay.gauss_newton import Solution, slopes
from identification.replay.profile_likelihood import Profile
from identification.replay.resonances import INFLATION, Resonances, Start
from identification.search.gear_resonance import GearResonance

_TWO_SIDED, _ONE_SIDED, _RIGID = 3.84, 2.71, 3.84
"""Twice the rise of the log-likelihood at the ends of an interval, at a bound, and up to which a gear may be rigid."""

_NORMAL = 1.96


class Intervals:
    """What a log says of each resonance.

    Parameters
    ----------
    view : Resonances
    solution : Solution
        The best fit.
    start : Start
        Its steps and bounds.
    final : bool
        Give intervals even where a better fit is met.

    Attributes
    ----------
    better : (k,) numpy.ndarray or None
        Coordinates of a better fit, if one was met; unless `final`, there are no intervals then.
    """

    def __init__(self, view: Resonances, solution: Solution, start: Start, *, final: bool) -> None:
        self._view, self._solution, self._start = view, solution, start
        self._unit = view.settle(solution.values)
        n = len(view.inertia(solution.values))
        self._periods, self._rigid = np.zeros((n, 2)), np.zeros(n, bool)
        self.better: NDArray[np.float64] | None = None
        steps = start.steps.copy()
        varied = np.flatnonzero(steps) if view.stiffness else np.empty(0, int)
        change = slopes(view, solution.values, steps, varied, view.innovations(solution.values))
        for i, place in view.stiffness.items():
            profile = Profile(view, solution.values, change, steps, start.bounds, place, final=final)
            self._periods[i], self._rigid[i] = self._of(profile, place)
            if profile.better is not None and not final:
                self.better = profile.better
                break

    def _of(self, profile: Profile, place: int) -> tuple[tuple[float, float], bool]:
        """Least and largest squared period [s^2], and whether the gear may be rigid."""
        unit, best, (low, high) = self._unit, self._solution.values[place], self._start.bounds[place]
        std = self._std(place)
        if best <= low or profile.rise(low, _RIGID * unit) < _RIGID * unit:
            return (low, profile.end(_NORMAL * std, _ONE_SIDED * unit, high)), True
        level = _TWO_SIDED * unit
        return (profile.end(_NORMAL * std, level, low), profile.end(_NORMAL * std, level, high)), False

    def _std(self, place: int) -> float:
        return float(np.sqrt(INFLATION * self._solution.covariance[place, place]))

    def covariance(self) -> NDArray[np.float64]:
        """Of the values (k, k); zero for stiffness and damping of a gear that may be rigid."""
        change = self._view.slopes(self._solution.values)
        for places in (self._view.stiffness, self._view.damping):
            change[[place for i, place in places.items() if self._rigid[i]]] = 0.0
        return INFLATION * change @ self._solution.covariance @ change.T

    def resonance(self, joints: Sequence[str], pose: NDArray[np.float64]) -> GearResonance:
        """The table of what was found."""
        view, solution = self._view, self._solution
        hz, ratio = view.resonances(solution.values)
        low, high, ratio_low, ratio_high = hz.copy(), hz.copy(), ratio.copy(), ratio.copy()
        searched = np.array([i in view.stiffness for i in range(len(hz))])
        with np.errstate(divide="ignore"):
            high[searched], low[searched] = 1 / (2 * np.pi * np.sqrt(self._periods[searched].T))
        high[self._rigid] = hz[self._rigid] = np.inf
        for i, place in view.damping.items():
            ratio_low[i], ratio_high[i] = ratio[i] * np.exp(_NORMAL * self._std(place) * np.array([-1, 1]))
        return GearResonance(
            joints=tuple(joints), pose=pose, hz=hz, low=low, high=high, damping_ratio=ratio, damping_low=ratio_low,
            damping_high=ratio_high, searched=searched,
        )  # fmt: skip

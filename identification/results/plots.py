"""Figures of results: errors, innovations, spectrum, intervals; the oscillation. matplotlib is imported when drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from identification.replay.prediction import Prediction
from plant import simulate
from plant.parts.labels import literal
from plant.simulation.injection import injected_beside

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["LOGS", "draw_intervals", "plot_identification", "plot_oscillation"]

_MEASURED, _MODEL, _LEFT = "#b3bcc0", "#c8553d", "#1f6f8b"
LOGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("measured", {"color": _MEASURED, "linewidth": 2.6}),
    ("simulated", {"color": _MODEL, "linewidth": 0.8}),
)
"""How a log and its model are drawn: the model lies on the log, which is wider."""

_MEANING = 68
"""Letters of a parameter's meaning that a figure shows; `Dynamics.legend` has them all."""


@literal
def plot_identification(found: Any) -> Figure:
    """Draw the first record of an `Identification`.

    One row per joint: tracking errors measured and simulated with what was found, the whole record and a short stretch
    of it, and the innovations. Below: spectrum of tracking errors and innovations; half-widths of the 95 % intervals,
    as shares of the values; what short names of parameters mean.

    Returns
    -------
    matplotlib figure
    """
    import matplotlib.pyplot as plt

    dynamics, record, n = found.arm.dynamics, found.records[0], found.arm.n
    prediction = Prediction(dynamics, record, found.unknown)
    left = prediction.innovations(np.append(found.values, prediction.nuisances)).reshape(-1, n)
    model = None
    if record.reference is not None:
        duration, added = len(record) * record.rig.period, injected_beside(record)
        model = simulate(found.arm, found.rig, found.law, record.reference, duration=duration, injected=added)
    meaning = [line if len(line) <= _MEANING else f"{line[:_MEANING]} ..." for line in dynamics.legend.splitlines()]
    half = (len(meaning) + 1) // 2
    heights = [*[1.8 if n < 4 else 1.5] * n, 2.6, 0.14 * half + 0.01]
    figure = plt.figure(figsize=(12, sum(heights)), layout="constrained")
    grid = figure.add_gridspec(n + 2, 3, height_ratios=heights)
    for joint, label in enumerate(dynamics.chain.joint_labels):
        titles = (label, *(("a stretch of it", "innovation: counted minus predicted") if joint == 0 else ("", "")))
        axes = [_axis(figure, grid[joint, column], title) for column, title in enumerate(titles)]
        for axis, start, end in ((axes[0], 0.0, 1.0), (axes[1], 0.30, 0.36)):
            some = slice(int(start * len(record)), int(end * len(record)))
            for log, (name, style) in zip((record, model), LOGS, strict=True):
                if log is not None:
                    axis.plot(log.t[some], log.error_pulses[some, joint], label=name, **style)
        axes[0].set_ylabel("error [pulses]")
        axes[2].plot(record.t, left[:, joint], color=_LEFT, linewidth=0.5)
        for axis in axes:
            axis.set_xlabel("time [s]" if joint == n - 1 else "")
    _legend(figure.axes[1])
    axis = _axis(figure, grid[n, 0], "spectrum")
    for signal, colour, name in ((record.error_pulses, "#444444", "error"), (left, _LEFT, "innovation")):
        axis.loglog(*_spectrum(signal, record.rig.period), color=colour, linewidth=0.7, label=name)
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("amplitude [pulses]")
    _legend(axis)
    draw_intervals(_axis(figure, grid[n, 1:], "95 % intervals"), found)
    axis = figure.add_subplot(grid[n + 1, :])
    axis.axis("off")
    for x, lines in ((0.0, meaning[:half]), (0.5, meaning[half:])):
        axis.text(x, 1, "\n".join(lines), fontsize=7, family="monospace", va="top", transform=axis.transAxes)
    return figure


def _legend(axis: Axes) -> None:
    """A legend above the axis, to the right of its title."""
    axis.legend(frameon=False, fontsize=8, ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)


def draw_intervals(axis: Axes, found: Any) -> None:
    """Half-widths of the 95 % intervals, all counted and of noise alone, as shares of the values; beyond 100 % the sign
    is not known.
    """
    names = found.short_names
    axis.set_xticks(np.arange(len(names)), names, rotation=0 if len(names) < 12 else 90, fontsize=8)
    axis.set_xlim(-0.5, len(names) - 0.5)
    axis.set_ylabel("half-width [% of the value]")
    if found.covariance is None:
        return
    kinds: list[tuple[Any, str, dict[str, Any]]] = [(found.covariance, "all that is counted", {"color": _LEFT})]
    if found.fit.noise_covariance is not None:
        kinds.append((found.fit.noise_covariance, "noise alone", {"facecolor": "white", "edgecolor": _MODEL}))
    for covariance, label, style in kinds:
        share = 196 * np.sqrt(np.diag(covariance)) / np.maximum(np.abs(found.values), np.finfo(float).tiny)
        there = np.flatnonzero((share > 0) & (share < 1e6))  # not what is known, or a value of zero
        axis.scatter(there, share[there], s=24, zorder=3, label=label, **style)
    axis.set_yscale("log")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.axhline(100, color="0.5", linewidth=0.8, linestyle="--")
    _legend(axis)


def _axis(figure: Figure, place: Any, title: str) -> Axes:
    axis = figure.add_subplot(place)
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5)
    axis.set_title(title, fontsize=9, loc="left")
    return axis


@literal
def plot_oscillation(found: Any) -> Figure:
    """Draw an `Oscillation`: errors measured and without it, one row per joint, and their spectrum below.

    Source: paper Figs. 10-11.

    Returns
    -------
    matplotlib figure
    """
    import matplotlib.pyplot as plt

    record = found.record
    n, quiet = record.n, found.removed(record.error_pulses)
    figure = plt.figure(figsize=(9, (2.0 if n < 4 else 1.5) * n + 2.6), layout="constrained")
    grid = figure.add_gridspec(n + 1, 1, height_ratios=[*[1.0] * n, 1.2])
    for joint, label in enumerate(found.joints):
        axis = _axis(figure, grid[joint], f"{label}, tracking error")
        axis.plot(record.t, record.error_pulses[:, joint], color="0.7", linewidth=0.6, label="measured")
        axis.plot(record.t, quiet[:, joint], color=_MODEL, linewidth=1.0, label="without the oscillation")
        axis.set_ylabel("[pulses]")
    _legend(figure.axes[0])
    axis.set_xlabel("time [s]")
    bands = "; shaded: modes of the linearised loop" if found.modes else ""
    axis = _axis(figure, grid[n], f"spectrum; dashed: {found.frequency:.1f} Hz{bands}")
    for signal, colour in ((record.error_pulses, "0.5"), (quiet, _MODEL)):
        axis.loglog(*_spectrum(signal, record.rig.period), color=colour, linewidth=0.7)
    for low, high in found.modes:
        axis.axvspan(low, high, color="#e9e4d4", zorder=0)
    axis.axvline(found.frequency, color="0.3", linewidth=0.8, linestyle="--")
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("amplitude [pulses]")
    return figure


def _spectrum(signal: NDArray[np.float64], period: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Frequencies [Hz] and amplitudes [pulses] of a signal (N, n), joints together."""
    centred = (signal - signal.mean(axis=0)) * np.hanning(len(signal))[:, None]
    amplitude = np.sqrt((np.abs(np.fft.rfft(centred, axis=0)) ** 2).sum(axis=1)) * 4 / len(signal)
    return np.fft.rfftfreq(len(signal), period)[1:], amplitude[1:]

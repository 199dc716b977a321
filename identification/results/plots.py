"""Figures of results: errors, innovations, spectrum, intervals; the oscillation. matplotlib is
imported when drawn.
"""

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.replay.prediction import Prediction
from identification.search.memory import as_repeated, run_again
from plant import Record
from plant.checkup.oscillation import spectrum
from plant.parts.fields import Floats
from plant.parts.figures import BAND, LOGS, axes_of, colour_of, dressed, legend_above, literal
from plant.simulation.logged_run import DivergenceError


def repeated(found: Any) -> Record | None:
    """The first record of an `Identification`, simulated with what was found; None where that
    diverges.

    It begins as the record does, its law with the memory that was found: the run that
    `Diagnostics.difference` is of.
    """
    (record,) = as_repeated(found.records[:1], found.fit.resumptions[:1])
    try:
        return run_again(record, found.arm, found.rig, found.law)
    except DivergenceError:
        return None


# letters of a parameter's meaning that a figure shows; `Dynamics.legend` has them all
_MEANING = 68

_ADVICE = "Draw without ax once: it returns them in their order"


@literal
def plot_identification(found: Any, ax: Any = None) -> NDArray[Any]:
    """Draw the first record of an `Identification`.

    Three panels per joint: tracking errors measured and simulated with what was found, the whole
    record and a short segment of it, and the innovations. Then the spectrum of tracking errors and
    innovations, and half-widths of the 95 % intervals, as shares of the values. A figure of its own
    says below what short names of parameters mean.

    `ax` (3 n + 2,): where to draw, joint by joint; a new figure by default.
    """
    dynamics = found.arm.dynamics
    record = found.records[0]
    n = found.arm.n
    axes = axes_of(
        ax,
        (3 * n + 2,),
        lambda: _new_axes(n, len(found.fit.values), dynamics.legend.splitlines()),
        _ADVICE,
    )
    prediction = Prediction(dynamics, record, found.fit.unknown)
    left = prediction.innovations(np.append(found.fit.values, prediction.nuisances)).reshape(-1, n)
    model = repeated(found)
    for joint, label in enumerate(dynamics.chain.joint_labels):
        whole, segment, rest = axes[3 * joint : 3 * joint + 3]
        for axis, start, end in ((whole, 0.0, 1.0), (segment, 0.30, 0.36)):
            some = slice(int(start * len(record)), int(end * len(record)))
            for log, (name, style) in zip((record, model), LOGS, strict=True):
                if log is not None:
                    axis.plot(log.t[some], log.error_pulses[some, joint], label=name, **style)
            axis.set_ylabel("error [pulses]")
        rest.plot(record.t, left[:, joint], color=colour_of(0), linewidth=0.5)
        rest.set_ylabel("innovation [pulses]")
        titles = (
            label,
            *(("a segment", "innovation: measured minus predicted") if joint == 0 else ("", "")),
        )
        for axis, title in zip((whole, segment, rest), titles, strict=True):
            dressed(axis, title)
            axis.set_xlabel("time [s]" if joint == n - 1 else "")
    legend_above(axes[1])
    spectrum, intervals = axes[-2:]
    for signal, colour, name in (
        (record.error_pulses, "#444444", "error"),
        (left, colour_of(0), "innovation"),
    ):
        spectrum.loglog(
            *_spectrum(signal, record.rig.period), color=colour, linewidth=0.7, label=name
        )
    dressed(spectrum, "spectrum").set_xlabel("frequency [Hz]")
    spectrum.set_ylabel("amplitude [pulses]")
    legend_above(spectrum)
    draw_intervals(dressed(intervals, "95 % intervals"), found)
    return axes


def _new_axes(n: int, values: int, meaning: list[str]) -> list[Any]:
    """Axes of a figure that says below what the parameters mean, in two columns."""
    import matplotlib.pyplot as plt

    short = [line if len(line) <= _MEANING else f"{line[:_MEANING]} ..." for line in meaning]
    half = (len(short) + 1) // 2
    heights = [*[1.8 if n < 4 else 1.5] * n, max(2.6, interval_height(values))]
    figure = plt.figure(figsize=(10.5, sum(heights) + 0.14 * half), layout="constrained")
    grid = figure.add_gridspec(n + 1, 3, height_ratios=heights)
    columns = itertools.zip_longest(short[:half], short[half:], fillvalue="")
    lines = [f"{first:<{_MEANING + 8}}{second}" for first, second in columns]
    if lines:
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7, family="monospace")
    places = [grid[joint, column] for joint in range(n) for column in range(3)]
    return [figure.add_subplot(place) for place in (*places, grid[n, 2], grid[n, :2])]


def interval_height(values: int) -> float:
    """Height of a panel of so many intervals, a line each [inch]."""
    return 0.9 + 0.17 * values


def draw_intervals(axis: Any, found: Any) -> None:
    """Half-widths of the 95 % intervals, all counted and of noise alone, as shares of the values;
    beyond 100 % the sign is not known.
    """
    names = found.short_names
    axis.set_yticks(np.arange(len(names)), names, fontsize=8)
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_ylabel("parameter")
    axis.set_xlabel("half-width [% of the value]")
    if found.covariance is None:
        return
    dot = {"color": colour_of(0), "s": 16}
    ring = {"edgecolor": colour_of(1), "facecolor": "none", "s": 60}
    kinds: list[tuple[Any, str, dict[str, Any]]] = [(found.covariance, "all that is counted", dot)]
    if found.fit.noise_covariance is not None:
        kinds.append((found.fit.noise_covariance, "noise alone", ring))
    for covariance, label, style in kinds:
        share = (
            196
            * np.sqrt(np.diag(covariance))
            / np.maximum(np.abs(found.fit.values), np.finfo(float).tiny)
        )
        there = np.flatnonzero((share > 0) & (share < 1e6))  # not what is known, or a value of zero
        axis.scatter(share[there], there, zorder=3, label=label, **style)
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.axvline(100, color="0.5", linewidth=0.8, linestyle="--")
    legend_above(axis)


@literal
def plot_oscillation(found: Any, ax: Any = None) -> NDArray[Any]:
    """Draw an `Oscillation`: errors measured and without it, one row per joint, and their spectrum
    below.

    `ax` (n + 1,): where to draw; a new figure by default.

    Source: paper Figs. 10-11.
    """
    record = found.record
    n, quiet = record.n, found.removed(record.error_pulses)

    def new() -> Any:
        import matplotlib.pyplot as plt

        heights = [*[2.0 if n < 4 else 1.5] * n, 2.6]
        size = (9, sum(heights))
        return plt.subplots(n + 1, 1, figsize=size, height_ratios=heights, layout="constrained")[1]

    axes = axes_of(ax, (n + 1,), new)
    (_, measured), (_, thin) = LOGS
    for joint, (axis, label) in enumerate(zip(axes, found.joints, strict=False)):
        axis.plot(record.t, record.error_pulses[:, joint], label="measured", **measured)
        axis.plot(record.t, quiet[:, joint], label="without the oscillation", **thin)
        dressed(axis, f"{label}, tracking error").set_ylabel("error [pulses]")
    legend_above(axes[0])
    axes[-2].set_xlabel("time [s]")
    bands = "; shaded: modes of the linearised loop" if found.modes else ""
    spectrum = dressed(axes[-1], f"spectrum; dashed: {found.frequency:.1f} Hz{bands}")
    for signal, style in ((record.error_pulses, measured), (quiet, thin)):
        spectrum.loglog(*_spectrum(signal, record.rig.period), **style | {"linewidth": 0.8})
    for low, high in found.modes:
        spectrum.axvspan(low, high, color=BAND, zorder=0)
    spectrum.axvline(found.frequency, color="0.3", linewidth=0.8, linestyle="--")
    spectrum.set_xlabel("frequency [Hz]")
    spectrum.set_ylabel("amplitude [pulses]")
    return axes


def _spectrum(signal: Floats, period: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """Frequencies [Hz] and amplitudes [pulses] of a signal (N, n), joints together."""
    frequency, power = spectrum(signal, period)
    return frequency[1:], np.sqrt(power.sum(axis=1))[1:] * 4 / len(signal)

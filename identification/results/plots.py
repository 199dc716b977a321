"""Figures of results: errors, innovations, spectrum, intervals; the oscillation."""

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.replay import Prediction
from identification.replay.followed import SETTINGS as FOLLOWED
from identification.results.seen import of_prior
from identification.search import as_repeated, run_again
from plant import Record
from plant.checkup import spectrum
from plant.parts import BAND, LOGS, axes_of, colour_of, dressed, legend_above, literal
from plant.simulation import DivergenceError


def repeated(identification: Any) -> Record | None:
    """Simulate the first record of an `Identification` again, with the identified values.

    The simulation begins as the record does, and its law begins with the identified memory.
    `Diagnostics.difference` is the difference between this simulation and the record, but for the
    finer sub-steps that it may have had. The function returns None if the simulation diverges.
    """
    (record,) = as_repeated(identification.records[:1], identification.fit.resumptions[:1])
    try:
        return run_again(record, identification.arm, identification.rig, identification.law)
    except DivergenceError:
        return None


# A figure cuts each line of `Dynamics.legend` after this number of characters, so that two columns
# of lines fit below its axes.
_MEANING = 68

_ADVICE = "Draw without ax once: it returns them in their order"


@literal
def plot_identification(identification: Any, ax: Any = None) -> NDArray[Any]:
    """Draw the first record of an `Identification`.

    Each joint has three panels. The first two show the measured and the simulated tracking error,
    of the entire record and of a short segment; the third shows the innovations. The last two
    panels show the spectra of tracking errors and innovations, and the half-widths of the 95 %
    intervals as shares of the values. A new figure explains the short names of the parameters below
    its axes.

    `ax` (3 n + 2,): where to draw, joint by joint; a new figure by default.
    """
    dynamics = identification.arm.dynamics
    record = identification.records[0]
    n = identification.arm.n
    values = identification.fit.values
    axes = axes_of(
        ax,
        (3 * n + 2,),
        lambda: _new_axes(n, len(values), dynamics.legend.splitlines()),
        _ADVICE,
    )
    # An innovation is a measurement minus its prediction, which is made from the counts one sample
    # ahead.
    prediction = Prediction(dynamics, record, identification.fit.unknown)
    innovations = prediction.innovations(np.append(values, prediction.nuisances)).reshape(-1, n)
    model = repeated(identification)
    # The observer starts at rest, and its first innovations correct that start. The limits of the
    # axis leave them out, since they would hide later innovations of less than a pulse.
    settled = innovations[FOLLOWED.settling :]

    # 1. Errors and innovations, joint by joint.
    for joint, label in enumerate(dynamics.chain.joint_labels):
        record_axis, segment_axis, innovation_axis = axes[3 * joint : 3 * joint + 3]
        for axis, start, end in ((record_axis, 0.0, 1.0), (segment_axis, 0.30, 0.36)):
            rows = slice(int(start * len(record)), int(end * len(record)))
            for log, (name, style) in zip((record, model), LOGS, strict=True):
                # A model that diverges has no curve.
                if log is not None:
                    axis.plot(log.t[rows], log.error_pulses[rows, joint], label=name, **style)
            axis.set_ylabel("error [pulses]")
        innovation_axis.plot(record.t, innovations[:, joint], color=colour_of(0), linewidth=0.5)
        innovation_axis.set_ylabel("innovation [pulses]")
        largest = np.abs(settled[:, joint]).max(initial=0.0)
        if np.isfinite(largest) and largest > 0:
            innovation_axis.set_ylim(-1.1 * largest, 1.1 * largest)
        # The first panel of each row has the joint as its title. The other two have titles in the
        # first row only, and only the last row has labels of time.
        dressed(record_axis, label)
        dressed(segment_axis, "a segment" if joint == 0 else "")
        dressed(innovation_axis, "innovation: measured minus predicted" if joint == 0 else "")
        for axis in (record_axis, segment_axis, innovation_axis):
            axis.set_xlabel("time [s]" if joint == n - 1 else "")
    legend_above(axes[1])

    # 2. Spectra and intervals.
    spectra, intervals = axes[-2:]
    # The innovations should be white; a peak is an effect that the model lacks.
    period = record.rig.period
    thin = {"linewidth": 0.7}
    _draw_spectrum(spectra, record.error_pulses, period, color="#444444", label="error", **thin)
    _draw_spectrum(spectra, innovations, period, color=colour_of(0), label="innovation", **thin)
    legend_above(dressed(spectra, "spectrum"))
    draw_intervals(dressed(intervals, INTERVALS), identification)
    return axes


def _new_axes(n, values, meaning):
    """Make a figure that explains the parameters in two columns below its axes; return the axes."""
    import matplotlib.pyplot as plt

    short = [line if len(line) <= _MEANING else f"{line[:_MEANING]} ..." for line in meaning]
    half = (len(short) + 1) // 2
    # Heights [inch]: the rows of joints are lower if there are four joints or more, and the last
    # row is high enough for all intervals.
    heights = [*[1.8 if n < 4 else 1.5] * n, max(2.6, interval_height(values))]
    figure = plt.figure(figsize=(10.5, sum(heights) + 0.14 * half), layout="constrained")
    grid = figure.add_gridspec(n + 1, 3, height_ratios=heights)
    columns = itertools.zip_longest(short[:half], short[half:], fillvalue="")
    lines = [f"{line:<{_MEANING + 8}}{following}" for line, following in columns]
    if lines:
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7, family="monospace")
    cells = [grid[joint, column] for joint in range(n) for column in range(3)]
    return [figure.add_subplot(cell) for cell in (*cells, grid[n, 2], grid[n, :2])]


# Title of a panel of intervals; short, since the legend stands beside it.
INTERVALS = "95 % intervals"


# Shares beyond it [%] are drawn up to it: those of values at or near zero are infinite or huge, and
# would leave no room for the others.
_MOST = 1e6


def interval_height(values: int) -> float:
    """Height of a panel of so many intervals, a line each [inch]."""
    return 0.9 + 0.17 * values


def draw_intervals(axis: Any, identification: Any) -> None:
    """Draw half-widths of the 95 % intervals, and those from noise alone, as shares of the values.

    The colour of a bar says where the value comes from: the log, or the prior.
    """
    names = identification.short_names
    axis.set_yticks(np.arange(len(names)), names, fontsize=8)
    # The first parameter on top.
    axis.set_ylim(len(names) - 0.5, -0.5)
    axis.set_ylabel("parameter")
    if identification.covariance is None:
        axis.set_xlabel("half-width [% of the value]: none, as there is no covariance")
        return
    axis.set_xlabel("half-width [% of the value]; dashed: 100 %, the sign is unknown beyond it")
    size = np.maximum(np.abs(identification.fit.values), np.finfo(float).tiny)

    def shares(covariance: Any) -> Any:
        with np.errstate(over="ignore"):
            share = 196 * np.sqrt(np.diag(covariance)) / size  # 1.96 standard deviations [%]
        return np.minimum(share, _MOST)

    total = shares(identification.covariance)
    # A known value has an interval of no width, and no bar.
    drawn = total > 0
    of_prior_names = set(of_prior(identification))
    from_prior = np.array([name in of_prior_names for name in names])
    noise = np.full_like(total, np.nan)
    if identification.fit.noise_covariance is not None:
        noise = shares(identification.fit.noise_covariance)
    # A logarithmic axis has no zero: bars begin below the smallest share.
    visible = np.concatenate([total[drawn], noise[drawn & (noise > 0)]])
    start = 0.6 * min(visible, default=1.0)
    for rows, label, joint in ((~from_prior, "from the log", 0), (from_prior, "from the prior", 1)):
        rows = np.flatnonzero(rows & drawn)
        if rows.size:
            axis.barh(rows, total[rows] - start, 0.6, start, color=colour_of(joint), label=label)
    rows = np.flatnonzero(drawn & (noise > 0))
    if rows.size:
        # Each mark is the half-width from noise alone; tolerances of the rig account for the rest
        # of the bar.
        axis.plot(noise[rows], rows, "|", color="black", markersize=9, label="noise alone")
    rows = np.flatnonzero(total == _MOST)
    if rows.size:
        axis.plot(total[rows], rows, ">", color="black", markersize=5, label="beyond the axis")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    # Beyond 100 % the sign of the value is not known.
    axis.axvline(100, color="0.5", linewidth=0.8, linestyle="--")
    legend_above(axis, columns=3)


@literal
def plot_oscillation(oscillation: Any, ax: Any = None) -> NDArray[Any]:
    """Draw an `Oscillation`: errors with and without it, a row per joint, and their spectra below.

    `ax` (n + 1,): where to draw; a new figure by default.

    Source: paper Figs. 10-11.
    """
    record = oscillation.record
    n = record.n
    quiet = oscillation.removed(record.error_pulses)

    def new():
        import matplotlib.pyplot as plt

        heights = [*[2.0 if n < 4 else 1.5] * n, 2.6]
        size = (9, sum(heights))
        return plt.subplots(n + 1, 1, figsize=size, height_ratios=heights, layout="constrained")[1]

    axes = axes_of(ax, (n + 1,), new)
    (_, measured), (_, thin) = LOGS
    for joint, (axis, label) in enumerate(zip(axes, oscillation.joints, strict=False)):
        axis.plot(record.t, record.error_pulses[:, joint], label="measured", **measured)
        axis.plot(record.t, quiet[:, joint], label="without the oscillation", **thin)
        dressed(axis, f"{label}, tracking error").set_ylabel("error [pulses]")
    legend_above(axes[0])
    axes[-2].set_xlabel("time [s]")
    bands = "; shaded: modes of the linearised loop" if oscillation.modes else ""
    spectra = dressed(axes[-1], f"spectrum; dashed: {oscillation.frequency:.1f} Hz{bands}")
    for signal, style in ((record.error_pulses, measured), (quiet, thin)):
        _draw_spectrum(spectra, signal, record.rig.period, **style | {"linewidth": 0.8})
    for low, high in oscillation.modes:
        spectra.axvspan(low, high, color=BAND, zorder=0)
    spectra.axvline(oscillation.frequency, color="0.3", linewidth=0.8, linestyle="--")
    return axes


def _draw_spectrum(axis, signal, period, **style):
    """Draw the amplitudes of a signal (N, n), joints together, over frequency."""
    frequency, power = spectrum(signal, period)
    # A sine has half of its amplitude on this side of the spectrum, and the window halves that
    # again: the factor 4 restores the amplitude.
    amplitude = np.sqrt(power.sum(axis=1)) * 4 / len(signal)
    axis.loglog(frequency[1:], amplitude[1:], **style)  # without the mean
    axis.set_xlabel("frequency [Hz]")
    axis.set_ylabel("amplitude [pulses]")

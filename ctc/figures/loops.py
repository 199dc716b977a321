"""Figures over frequency: the loops of a controller, and on which gears it holds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.parts import axes_of, colour_of, dressed, legend_above, literal, row_by_row

# Told apart in print, and where curves lie on one another.
_DASHES = ("-", "--", ":", "-.")


@literal
def plot_margins(margins: Any, ax: Any = None) -> NDArray[Any]:
    """Bode diagram of each joint's loop, with its sensitivity, up to half the sampling rate."""
    axes = row_by_row(ax, 3, 1, width=7.0)[:, 0]
    f = margins.frequency
    for joint, loop in enumerate(margins.response):
        # The phase is known up to full turns: take the one between -360 and 0 degrees at the
        # crossover, whose distance to -180 degrees is the phase margin.
        phase = np.unwrap(np.angle(loop))
        crossover = np.abs(np.abs(loop) - 1).argmin()
        phase -= 2 * np.pi * np.ceil(phase[crossover] / (2 * np.pi))
        curves = (
            20 * np.log10(np.abs(loop)),
            np.rad2deg(phase),
            20 * np.log10(np.abs(1 / (1 + loop))),
        )
        for axis, values in zip(axes, curves, strict=True):
            # Joints under one law often lie on one another.
            axis.plot(
                f,
                values,
                color=colour_of(joint),
                linewidth=1.4,
                label=margins.joint_labels[joint],
                linestyle=_DASHES[joint % len(_DASHES)],
            )
    begin = f[np.searchsorted(f, f[-1] / 1000)]
    panels = (
        ("loop gain [dB]", 0, (-40, 60)),
        ("phase [°]", -180, (-400, 10)),
        ("sensitivity [dB]", 0, (-60, 15)),
    )
    for axis, (name, level, ends) in zip(axes, panels, strict=True):
        # Gain one, the phase of instability, and errors that the loop neither reduces nor grows.
        axis.axhline(level, color="0.35", linewidth=0.6, linestyle="--")
        axis.set(ylabel=name, xscale="log", xlim=(begin, f[-1]), ylim=ends)
    axes[1].set_yticks(np.arange(-360, 1, 90))
    legend_above(axes[0], at_left=True)
    axes[-1].set_xlabel("frequency [Hz]")
    return axes


@literal
def plot_sweep(sweep: Any, ax: Any = None) -> NDArray[Any]:
    """Share of samples within the limit over the gears' resonance; bars where all samples are."""
    names = list(sweep.shares)
    hz = sweep.hz
    # A resonance stands for the interval up to the geometric means with its neighbours.
    edges = np.sqrt(hz[1:] * hz[:-1])
    edges = np.concatenate([[hz[0] ** 2 / edges[0]], edges, [hz[-1] ** 2 / edges[-1]]])

    def new() -> Any:
        import matplotlib.pyplot as plt

        # A bar for each controller below the curves.
        heights = (3.6, 0.42 * len(names) + 0.5)
        size = (9.0, sum(heights))
        options: Any = {"height_ratios": heights, "sharex": True, "layout": "constrained"}
        return plt.subplots(2, 1, figsize=size, **options)[1]

    axes = axes_of(ax, (2,), new)
    share, bars = axes
    for row, name in enumerate(names):
        within = sweep.shares[name]
        colour = colour_of(row)
        share.plot(
            hz, 100 * within, color=colour, linewidth=1.6, linestyle=_DASHES[row % 4], label=name
        )
        # Bars of neighbouring resonances touch: without an outline they are one.
        full = within >= 1
        start = edges[:-1][full]
        width = np.diff(edges)[full]
        bars.barh(np.full(len(start), -row), width, 0.62, left=start, color=colour, linewidth=0)
    share.set(ylabel=f"samples within ±{sweep.within:g} pulse [%]", ylim=(-2, 104))
    legend_above(share, at_left=True)
    # From top to bottom in the order of the legend.
    bars.set_yticks([-row for row in range(len(names))], names)
    bars.set_ylim(-len(names) + 0.4, 0.6)
    dressed(bars, "every sample within")
    # A grid across a bar has no meaning; that of the shares is drawn again.
    for axis in axes:
        _along_resonances(axis, edges[0], edges[-1])
        dressed(axis).grid(visible=False, axis="y")
    share.grid(visible=True, axis="y", alpha=0.25, linewidth=0.5)
    bars.set_xlabel(
        f"resonance of the gears, motors locked [Hz]; damping ratio {sweep.damping_ratio:g}"
    )
    return axes


def _along_resonances(axis: Any, low: float, high: float) -> None:
    """Make an axis of frequencies [Hz] logarithmic, with plain numbers in place of powers."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    ticks = (5, 10, 15, 25, 40, 60, 100, 150, 250, 500, 1000)

    axis.set(xscale="log", xlim=(low, high))
    # A logarithmic axis would set ticks at powers of ten alone, two in this range.
    axis.xaxis.set_major_locator(FixedLocator([hz for hz in ticks if low <= hz <= high]))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())

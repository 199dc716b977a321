"""Figures over frequency: the loops of a controller, and on which gears it holds."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.parts.figures import axes_of, colour_of, dressed, legend_above, literal, row_by_row

_DASHES = ("-", "--", ":", "-.")
# resonances [Hz] at which an axis has ticks
_TICKS = (5, 10, 15, 25, 40, 60, 100, 150, 250, 500, 1000)


@literal
def plot_margins(margins: Any, ax: Any = None) -> NDArray[Any]:
    """Bode diagram of the loop of each joint, and its sensitivity; all over frequency, up to
    half the sampling rate.
    """
    axes = row_by_row(ax, 3, 1, width=7.0)[:, 0]
    f = margins.frequency
    for joint, loop in enumerate(margins.response):
        phase = np.unwrap(np.angle(loop))
        phase -= 2 * np.pi * np.ceil(phase[np.abs(np.abs(loop) - 1).argmin()] / (2 * np.pi))
        options = {
            "color": colour_of(joint),
            "linewidth": 1.4,
            "label": margins.joint_labels[joint],
        }
        # joints under one law often lie on one another
        options["linestyle"] = _DASHES[joint % len(_DASHES)]
        curves = (
            20 * np.log10(np.abs(loop)),
            np.rad2deg(phase),
            20 * np.log10(np.abs(1 / (1 + loop))),
        )
        for axis, values in zip(axes, curves, strict=True):
            axis.plot(f, values, **options)
    begin = f[np.searchsorted(f, f[-1] / 1000)]
    panels = (
        ("loop gain [dB]", 0, (-40, 60)),
        ("phase [°]", -180, (-400, 10)),
        ("sensitivity [dB]", 0, (-60, 15)),
    )
    for axis, (name, level, ends) in zip(axes, panels, strict=True):
        axis.axhline(level, color="0.35", linewidth=0.6, linestyle="--")
        axis.set(ylabel=name, xscale="log", xlim=(begin, f[-1]), ylim=ends)
    axes[1].set_yticks(np.arange(-360, 1, 90))
    legend_above(axes[0], left=True)
    axes[-1].set_xlabel("frequency [Hz]")
    return axes


@literal
def plot_sweep(sweep: Any, ax: Any = None) -> NDArray[Any]:
    """Share of samples within the limit over the resonance of the gears, and bars where every
    sample is.
    """
    names = list(sweep.shares)
    hz = sweep.hz
    edges = np.sqrt(hz[1:] * hz[:-1])
    edges = np.concatenate([[hz[0] ** 2 / edges[0]], edges, [hz[-1] ** 2 / edges[-1]]])

    def new() -> Any:
        import matplotlib.pyplot as plt

        heights = (3.6, 0.42 * len(names) + 0.5)
        size = (9.0, sum(heights))
        return plt.subplots(
            2, 1, figsize=size, height_ratios=heights, sharex=True, layout="constrained"
        )[1]

    axes = axes_of(ax, (2,), new)
    share, bars = axes
    for place, name in enumerate(names):
        own = sweep.shares[name]
        share.plot(
            hz,
            100 * own,
            color=colour_of(place),
            linewidth=1.6,
            linestyle=_DASHES[place % 4],
            label=name,
        )
        wide = np.diff(edges)[own >= 1]
        left = edges[:-1][own >= 1]
        bars.barh(
            np.full(len(left), -place), wide, 0.62, left=left, color=colour_of(place), linewidth=0
        )
    share.set(ylabel=f"samples within ±{sweep.within:g} pulse [%]", ylim=(-2, 104))
    legend_above(share, left=True)
    bars.set_yticks([-place for place in range(len(names))], names)
    bars.set_ylim(-len(names) + 0.4, 0.6)
    dressed(bars, "every sample within")
    for axis in axes:
        _along_resonances(axis, edges[0], edges[-1])
        dressed(axis).grid(visible=False, axis="y")
    share.grid(visible=True, axis="y", alpha=0.25, linewidth=0.5)
    bars.set_xlabel(
        f"resonance of the gears, motors locked [Hz]; damping ratio {sweep.damping_ratio:g}"
    )
    return axes


def _along_resonances(axis: Any, low: float, high: float) -> None:
    """A logarithmic axis of frequencies [Hz] with numbers that are read at once."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    axis.set(xscale="log", xlim=(low, high))
    axis.xaxis.set_major_locator(FixedLocator([hz for hz in _TICKS if low <= hz <= high]))
    axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())

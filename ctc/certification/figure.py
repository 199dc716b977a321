"""Figure of a certificate: peak errors, worst loop, sensitivities; matplotlib is imported only
when it is drawn.
"""

import textwrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.imperfections import IMPERFECTIONS
from ctc.figures.errors import draw_band
from ctc.verdict.evaluations import evaluate
from plant.parts.figures import BAND, axes_of, colour_of, dressed, legend_above, literal
from plant.simulation.logged_run import DivergenceError

_NAMES = 8  # sensitivities in the figure
_LARGEST = 4  # pulses beyond the limit that have a bar of their own
_HEIGHT = 3.9  # of the figure [inches], for few joints
_STRIP = 2.3  # height of the resonances below [inches]
_NUMBERED = 3  # joints up to which bars have numbers
_LINE = 200  # letters of a line below the panels
_TITLE = 125  # of a line of the title

_WORDS = {row.number: row.words for row in IMPERFECTIONS.values()} | {
    "drive.viscous": "viscous friction",
    "drive.coulomb": "dry friction",
    "encoder.phase.shift": "encoder offset",
    "transport.delay": "delay of the torque",
    "load": "load in the gripper",
    "damping_ratio": "damping ratio",
}


@literal
def plot_certificate(certificate: Any, ax: Any = None) -> NDArray[Any]:
    """Draw the peak errors of all loops, the error of the worst one, and the sensitivities."""
    labels = certificate.plants.arm.dynamics.chain.joint_labels
    found = [influence for influence in certificate.sensitivities if influence.sense][:_NAMES][::-1]
    axes = axes_of(
        ax, (3 + bool(certificate.cells),), lambda: _new_axes(certificate, labels, found)
    )
    for axis in axes:
        dressed(axis)
    _peaks(axes[0], certificate, labels)
    _worst(axes[1], certificate, labels)
    _sensitivities(axes[2], certificate, labels, found)
    if certificate.cells:
        _resonances(axes[3], certificate, labels)
    return axes


def _new_axes(certificate: Any, labels: list[str], found: list[Any]) -> list[Any]:
    """Axes of a figure with the verdict above them, and the long names of its parameters below."""
    import matplotlib.pyplot as plt

    rows: Any = [["peaks", "worst", "sensitivities"]]
    heights = [_HEIGHT + 0.25 * max(len(labels) - _NUMBERED, 0)]
    if certificate.cells:
        rows = [*rows, ["resonances"] * 3]
        heights = [*heights, _STRIP]
    short = _short(certificate)
    long = [
        f"{short[x.name]} = {x.name}"
        for x in reversed(found)
        if short.get(x.name, x.name) != x.name
    ]
    lines = [line for each in long for line in textwrap.wrap(each, _LINE, subsequent_indent="    ")]
    figure, axes = plt.subplot_mosaic(
        rows,
        figsize=(11, sum(heights) + 0.13 * len(lines)),
        width_ratios=(1.3, 1.4, 1),
        height_ratios=heights,
        layout="constrained",
    )
    if lines:
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7)
    figure.suptitle(textwrap.fill(certificate.verdict, _TITLE), fontsize=11)
    return list(axes.values())


def _short(certificate: Any) -> dict[str, str]:
    """Names of the arm's parameters, and what figures call them."""
    dynamics = certificate.plants.arm.dynamics
    return dict(zip(dynamics.names, dynamics.short_names, strict=True))


def _peaks(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Share of the loops by their largest encoder error."""
    within = int(certificate.within)
    peak = certificate.runs.peak
    last = within + _LARGEST
    highest = int(min(max(np.max(peak, where=np.isfinite(peak), initial=0), within + 1), last))
    highest = last if np.isinf(peak).any() else highest
    counts = np.arange(highest + 1)
    width = 0.8 / peak.shape[1]
    for joint, column in enumerate(peak.T):
        share = np.bincount(np.minimum(column, highest).astype(int), minlength=highest + 1) / len(
            column
        )
        place = counts + (joint - (peak.shape[1] - 1) / 2) * width
        axis.bar(place, 100 * share, width, color=colour_of(joint), label=labels[joint])
        for x, y in zip(place, 100 * share, strict=True):
            if y and len(labels) <= _NUMBERED:
                axis.annotate(
                    f"{y:.2g}" if y < 99.5 else f"{y:.0f}",
                    (x, y),
                    (0, 3),
                    textcoords="offset points",
                    ha="center",
                    fontsize=7,
                )
    axis.axvspan(within + 0.5, highest + 0.5, color=BAND, zorder=0)
    axis.set(
        xlim=(-0.5, highest + 0.5),
        ylim=(0, 100 / (1 - _headroom(labels))),
        yticks=range(0, 101, 20),
    )
    axis.set_xticks(
        counts,
        [*(str(k) for k in counts[:-1]), f"{highest}+" if peak.max() > highest else str(highest)],
    )
    axis.set(xlabel="largest encoder error of a loop [pulses]", ylabel="loops [%]")
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    dressed(axis, f"{len(peak):,} closed loops; shaded: outside", 10)


def _worst(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Error of the worst loop over time; what is outside stands out."""
    worst = certificate.worst
    settings = certificate.settings
    within = certificate.within
    options = {name: settings[name] for name in ("steps_per_sample", "duration")}
    axis.set(xlabel="time [s]", ylabel="error [pulses]")
    try:
        run = evaluate(
            worst.arm, worst.rig, certificate.law, certificate.reference, backend="numba", **options
        )
    except DivergenceError:
        dressed(axis, f"the worst of them (plant {worst.index}) diverges", 10)
        axis.set(xticks=[], yticks=[])
        return
    t = run.record.t
    counts = run.record.t >= settings["after"] - 1e-9 * run.record.rig.period
    for joint, error in enumerate(run.record.error_pulses.T):
        colour = colour_of(joint)
        outside = counts & (np.abs(error) > within)
        axis.plot(t, error, drawstyle="steps-post", linewidth=0.4, alpha=0.45, color=colour)
        axis.plot(
            t[outside],
            error[outside],
            "o",
            markersize=4,
            color=colour,
            label=f"q[{joint}]: {outside.sum()} of {counts.sum()} samples outside",
        )
    draw_band(axis, int(within) if within == int(within) else within)
    low, high = axis.get_ylim()
    axis.set_ylim(low, low + (high - low) / (1 - _headroom(labels)))
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    dressed(axis, f"the worst of them (plant {worst.index}); shaded: ±{within:g} pulse", 10)


def _sensitivities(axis: Any, certificate: Any, labels: list[str], found: list[Any]) -> None:
    """Share of the variance of the peaks that each number explains, the largest on top."""
    axis.set(xlabel="share of the variance [%]")
    axis.grid(visible=False, axis="y")
    if not found:
        dressed(axis, "sensitivity: nothing that was sampled stands out", 10)
        axis.set(xticks=[], yticks=[])
        return
    dressed(axis, "sensitivity to", 10)
    shares = [100 * influence.share for influence in found]
    short = _short(certificate)
    names = [_label(short.get(influence.name, influence.name), labels) for influence in found]
    axis.barh(names, shares, height=0.6, color=colour_of(0))
    for place, influence in enumerate(found):
        axis.annotate(
            influence.sense,
            (shares[place], place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axis.set(xlim=(0, 1.35 * max(shares)), ylim=(-0.6, max(len(found), 4) - 0.4))
    axis.tick_params(axis="y", labelsize=8)


def _resonances(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Share that exceeds the limit in each cell of the stated resonances, with its bound; the
    worst one stands out.
    """
    confidence = certificate.confidence
    worst = certificate.worst_cell
    for i, name in enumerate(dict.fromkeys(cell.name for cell in certificate.cells)):
        own = [cell for cell in certificate.cells if cell.name == name]
        for low, high in sorted({cell.hz for cell in own}):
            there = [cell for cell in own if cell.hz == (low, high)]
            bound = max(cell.upper(confidence) for cell in there)
            share = sum(cell.failures for cell in there) / max(sum(cell.count for cell in there), 1)
            colour = colour_of(i)
            first = bool(low == own[0].hz[0])
            whose = "" if name == "resonance" else f"{labels[int(name.partition('[')[2][:-1])]}: "
            axis.plot(
                (low, high),
                (100 * share,) * 2,
                color=colour,
                label=f"{whose}share outside the limit" * first,
            )
            axis.plot(
                (low, high),
                (100 * bound,) * 2,
                color=colour,
                linestyle=":",
                label=f"{whose}{100 * confidence:g} % bound" * first,
            )
            if worst.name == name and worst.hz == (low, high):
                axis.axvspan(low, high, color=BAND, zorder=0, label="worst part")
    axis.set_xscale("log")
    lowest = min(cell.hz[0] for cell in certificate.cells)
    highest = max(cell.hz[1] for cell in certificate.cells)
    ticks = np.unique(np.round(np.geomspace(lowest, highest, 7)))
    axis.set_xticks(ticks, [f"{hz:g}" for hz in ticks])
    axis.set_xticks([], minor=True)
    axis.set_ylim(bottom=-0.03 * axis.get_ylim()[1])  # where no loop is outside, its line is seen
    axis.set(xlabel="locked-rotor resonance [Hz]", ylabel="loops outside the limit [%]")
    legend_above(axis, left=True, columns=5)


def _headroom(labels: list[str]) -> float:
    """Share of a panel's height that its legend takes."""
    return 0.065 * (1 + len(labels))


def _label(name: str, labels: list[str]) -> str:
    """Name of a number in words."""
    kind, _, index = name[:-1].rpartition("[") if name.endswith("]") else (name, "", "")
    words = _WORDS.get(kind, kind)
    return f"{words},\n{labels[int(index)]}" if index else words

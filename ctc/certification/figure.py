"""Figure of a certificate: peak errors, worst loop, sensitivities; matplotlib is imported only when it is drawn."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from ctc.figures import COLOURS, draw_band
from ctc.verdict.evaluation import evaluate
from plant import DivergenceError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_certificate"]

_NAMES = 8
"""Sensitivities in the figure."""

_LARGEST = 4
"""Pulses beyond the limit that have a bar of their own."""

_HEIGHT = 3.9
"""Of the figure [inches], for few joints."""

_NUMBERED = 3
"""Joints up to which bars have numbers."""

_LINE = 200
"""Letters of a line below the panels."""

_TITLE = 150
"""Of a line of the title."""

_WORDS = {
    "drive.viscous": "viscous friction",
    "drive.coulomb": "dry friction",
    "encoder.phase.shift": "encoder's zero",
    "transport.delay": "delay of the torque",
    "load": "load in the hand",
    "resonance": "resonance",
    "damping_ratio": "damping ratio",
    "drive.elasticity.backlash": "backlash",
    "drive.current_lag.time": "current lag",
}


def plot_certificate(certificate: Any) -> Figure:
    """Draw the peak errors of all loops, the error of the worst one, and the sensitivities; the title is the verdict.

    Parameters
    ----------
    certificate : Certificate

    Returns
    -------
    matplotlib.figure.Figure
    """
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13, _HEIGHT), width_ratios=(1, 1.5, 1), layout="constrained")
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    labels = certificate.plants.arm.dynamics.chain.joint_labels
    _peaks(axes[0], certificate, labels)
    _worst(axes[1], certificate, labels)
    _sensitivities(axes[2], certificate, labels)
    figure.suptitle(textwrap.fill(certificate.verdict, _TITLE), fontsize=11)
    return figure


def _peaks(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Share of the loops by their largest counted error."""
    within, peak = int(certificate.within), certificate.runs.peak
    last = within + _LARGEST
    highest = int(min(max(np.max(peak, where=np.isfinite(peak), initial=0), within + 1), last))
    highest = last if np.isinf(peak).any() else highest
    counts, width = np.arange(highest + 1), 0.8 / peak.shape[1]
    for joint, column in enumerate(peak.T):
        share = np.bincount(np.minimum(column, highest).astype(int), minlength=highest + 1) / len(column)
        place = counts + (joint - (peak.shape[1] - 1) / 2) * width
        axis.bar(place, 100 * share, width, color=COLOURS[joint % len(COLOURS)], label=labels[joint])
        for x, y in zip(place, 100 * share, strict=True):
            if y and len(labels) <= _NUMBERED:
                axis.annotate(f"{y:.2g}" if y < 99.5 else f"{y:.0f}", (x, y), (0, 1), textcoords="offset points",
                              ha="center", fontsize=7)  # fmt: skip
    axis.axvspan(within + 0.5, highest + 0.5, color=COLOURS[1], alpha=0.12, zorder=0)
    axis.annotate("outside", (highest + 0.45, 0.97), xycoords=axis.get_xaxis_transform(), ha="right", va="top",
                  fontsize=8, color=COLOURS[1])  # fmt: skip
    axis.set_xlim(-0.5, highest + 0.5)
    axis.set_ylim(0, 100 / (1 - _headroom(labels)))
    axis.set_yticks(range(0, 101, 20))
    axis.set_xticks(counts, [*(str(k) for k in counts[:-1]), f"{highest}+" if peak.max() > highest else str(highest)])
    axis.set_xlabel("largest counted error of a loop [pulses]")
    axis.set_ylabel("loops [%]")
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    axis.set_title(f"{len(peak):,} closed loops", fontsize=10)


def _worst(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Error of the worst loop over time; what is outside stands out."""
    worst, settings, within = certificate.worst, certificate.settings, certificate.within
    options = {name: settings[name] for name in ("steps_per_sample", "duration")}
    axis.set_xlabel("time [s]")
    axis.set_ylabel("error [pulses]")
    try:
        run = evaluate(worst.arm, worst.rig, certificate.law, certificate.reference, backend="numba", **options)
    except DivergenceError:
        axis.set_title(f"the worst of them (plant {worst.index}) diverges", fontsize=10)
        return
    t, counts = run.record.t, run.record.t >= settings["after"] - 1e-9 * run.record.rig.period
    for joint, error in enumerate(run.record.error_pulses.T):
        colour, outside = COLOURS[joint % len(COLOURS)], counts & (np.abs(error) > within)
        axis.plot(t, error, drawstyle="steps-post", linewidth=0.4, alpha=0.45, color=colour)
        axis.plot(t[outside], error[outside], "o", markersize=4, color=colour,
                  label=f"{labels[joint]}: {outside.sum()} of {counts.sum()} samples outside")  # fmt: skip
    draw_band(axis, int(within) if within == int(within) else within)
    low, high = axis.get_ylim()
    axis.set_ylim(low, low + (high - low) / (1 - _headroom(labels)))
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    axis.set_title(f"the worst of them (plant {worst.index})", fontsize=10)


def _sensitivities(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Share of the variance of the peaks that each number explains."""
    found = [influence for influence in certificate.sensitivities if influence.sense][:_NAMES][::-1]
    axis.set_title("sensitivity to", fontsize=10)
    axis.set_xlabel("explains of the variance of the peaks [%]")
    if not found:
        axis.annotate("nothing that was drawn stands out", (0.5, 0.5), xycoords="axes fraction", ha="center")
        axis.set_yticks([])
        return
    shares = [100 * influence.share for influence in found]
    dynamics = certificate.plants.arm.dynamics
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    names = [_label(short.get(influence.name, influence.name), labels) for influence in found]
    axis.barh(names, shares, height=0.6, color=COLOURS[0])
    long = [f"{short[x.name]} = {x.name}" for x in reversed(found) if short.get(x.name, x.name) != x.name]
    lines = [line for each in long for line in textwrap.wrap(each, _LINE, subsequent_indent="    ")]
    axis.figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7)
    axis.figure.set_figheight(_HEIGHT + 0.25 * max(len(labels) - _NUMBERED, 0) + 0.13 * len(lines))
    for place, influence in enumerate(found):
        axis.annotate(influence.sense, (shares[place], place), (3, 0), textcoords="offset points", va="center",
                      fontsize=8)  # fmt: skip
    axis.set_xlim(0, 1.35 * max(shares))
    axis.set_ylim(-0.6, max(len(found), 4) - 0.4)
    axis.tick_params(axis="y", labelsize=8)


def _headroom(labels: list[str]) -> float:
    """Share of a panel's height that its legend takes."""
    return 0.065 * (1 + len(labels))


def _label(name: str, labels: list[str]) -> str:
    """Name of a number in words."""
    kind, _, index = name.rstrip("]").partition("[")
    words = _WORDS.get(kind, kind)
    return f"{words},\n{labels[int(index)]}" if index else words

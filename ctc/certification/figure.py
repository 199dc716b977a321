"""Figure of a certificate: peak errors, worst loop, sensitivities, and resonances.

matplotlib is imported only when a figure is drawn.
"""

import textwrap
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.certification.imperfections import IMPERFECTIONS
from ctc.figures import draw_band
from ctc.verdict import evaluate
from plant.parts import BAND, axes_of, colour_of, dressed, frozen_settings, legend_above, literal
from plant.simulation import DivergenceError


@frozen_settings
class FigureSettings:
    """Layout of the figure of a certificate, chosen by eye.

    Parameters
    ----------
    influences : int
        Sensitivities that are drawn.
    cloud : int
        Sampled loops whose errors are shaded behind the worst one.
    blocks : int
        Parts of the path, in each of which the cloud has one lowest and one highest error.
    bars : int
        Pulses beyond the limit that have separate bars; larger errors share the last one.
    numbered_joints : int
        Joints up to which bars have numbers.
    width, panel_height, strip_height : float
        Of the figure, of its panels for few joints, and of the resonances below [inch].
    joint_height, line_height : float
        Additional height of each further joint, and of each line below the panels [inch].
    line_letters, title_letters : int
        Letters of a line below the panels, and of a line of the title.
    """

    # Contents
    influences: int = 8
    cloud: int = 16
    blocks: int = 200
    bars: int = 4
    numbered_joints: int = 3
    # Sizes
    width: float = 11
    panel_height: float = 3.9
    strip_height: float = 2.3
    joint_height: float = 0.25
    line_height: float = 0.13
    line_letters: int = 200
    title_letters: int = 125


SETTINGS = FigureSettings()

# Kinds of numbers -> words of the axis of sensitivities.
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
    # A number without a direction explains nearly nothing.
    influences = [influence for influence in certificate.sensitivities if influence.sense]
    # Horizontal bars are drawn from below: the largest is the last.
    drawn = influences[: SETTINGS.influences][::-1]
    panels = 3 + bool(certificate.cells)
    axes = axes_of(ax, (panels,), lambda: _new_axes(certificate, labels, drawn))
    for axis in axes:
        dressed(axis)
    # What happened, the worst case, why, and for which gears.
    _peaks(axes[0], certificate, labels)
    _worst(axes[1], certificate, labels)
    _sensitivities(axes[2], certificate, labels, drawn)
    if certificate.cells:
        _resonances(axes[3], certificate, labels)
    return axes


def _new_axes(certificate: Any, labels: list[str], influences: list[Any]) -> list[Any]:
    """Axes of a figure with the verdict above them, and the long names of its parameters below."""
    import matplotlib.pyplot as plt

    # Legends have a line for each joint, so panels grow with the joints beyond the first three.
    further = max(len(labels) - SETTINGS.numbered_joints, 0)
    rows: Any = [["peaks", "worst", "sensitivities"]]
    heights = [SETTINGS.panel_height + SETTINGS.joint_height * further]
    if certificate.cells:
        rows.append(["resonances"] * 3)
        heights.append(SETTINGS.strip_height)
    short = _short(certificate)
    lines = []
    for influence in reversed(influences):
        name = influence.name
        if short.get(name, name) != name:
            meaning = f"{short[name]} = {name}"
            lines += textwrap.wrap(meaning, SETTINGS.line_letters, subsequent_indent="    ")
    # The resonances have a strip of the full width.
    figure, axes = plt.subplot_mosaic(
        rows,
        figsize=(SETTINGS.width, sum(heights) + SETTINGS.line_height * len(lines)),
        width_ratios=(1.3, 1.4, 1),
        height_ratios=heights,
        layout="constrained",
    )
    if lines:
        figure.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=7)
    figure.suptitle(textwrap.fill(certificate.verdict, SETTINGS.title_letters), fontsize=11)
    return list(axes.values())


def _short(certificate: Any) -> dict[str, str]:
    """Short names of the arm's parameters in the figure, by name."""
    dynamics = certificate.plants.arm.dynamics
    return dict(zip(dynamics.names, dynamics.short_names, strict=True))


def _peaks(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Share of the loops by their largest encoder error."""
    within = int(certificate.within)
    peak = certificate.runs.peak
    # The last bar holds all larger errors, and loops that diverged.
    limit = within + SETTINGS.bars
    # A peak that is infinite has no bar of its own; it counts in the last one.
    largest = np.max(peak, where=np.isfinite(peak), initial=0)
    highest = limit if np.isinf(peak).any() else int(min(max(largest, within + 1), limit))
    counts = np.arange(highest + 1)
    width = 0.8 / peak.shape[1]
    for joint, column in enumerate(peak.T):
        loops = np.bincount(np.minimum(column, highest).astype(int), minlength=highest + 1)
        percent = 100 * (loops / len(column))
        # The bars of the joints stand side by side, centred about the count.
        centre = counts + (joint - (peak.shape[1] - 1) / 2) * width
        axis.bar(centre, percent, width, color=colour_of(joint), label=labels[joint])
        # Numbers above the bars of more joints would overlap.
        for x, y in zip(centre, percent, strict=True):
            if y and len(labels) <= SETTINGS.numbered_joints:
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
    ticks = [str(k) for k in counts]
    if peak.max() > highest:
        ticks[-1] += "+"
    axis.set_xticks(counts, ticks)
    axis.set(xlabel="largest encoder error of a loop [pulses]", ylabel="loops [%]")
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    dressed(axis, f"{len(peak):,} closed loops; shaded: outside", 10)


def _worst(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Range of the errors of sampled loops along the path; the worst on top, with marks outside."""
    worst = certificate.worst
    within = certificate.within
    # Before the run: a diverged one has axes without a curve.
    axis.set(xlabel="time [s]", ylabel="error before rounding [pulses]")
    # Runs of a population have no time series, so these loops are simulated again.
    run = _run(certificate, worst)
    if run is None:
        dressed(axis, f"the worst of them (plant {worst.index}) diverges", 10)
        axis.set(xticks=[], yticks=[])
        return
    cloud = min(SETTINGS.cloud, len(certificate.plants))
    samples = [_run(certificate, certificate.plant(index)) for index in range(cloud)]
    _draw_cloud(axis, [run, *(sample for sample in samples if sample is not None)])
    for joint, error in enumerate(_errors(run).T):
        axis.plot(run.record.t, error, color=colour_of(joint), linewidth=0.7)
    t = run.record.t
    # Instants are multiples of the period to rounding: 1e-9 of it keeps the one at `after`.
    # Instants before `after` do not count, as in the certificate.
    counts = t >= certificate.settings["after"] - 1e-9 * run.record.rig.period
    for joint, error in enumerate(run.record.error_pulses.T):
        outside = counts & (np.abs(error) > within)
        axis.plot(
            t[outside],
            error[outside],
            "o",
            markersize=4,
            color=colour_of(joint),
            label=f"q[{joint}]: {outside.sum()} of {counts.sum()} samples outside",
        )
    draw_band(axis, int(within) if within == int(within) else within)
    low, high = axis.get_ylim()
    # Room for the legend above the curves.
    axis.set_ylim(low, low + (high - low) / (1 - _headroom(labels)))
    axis.legend(frameon=False, fontsize=8, loc="upper left")
    title = f"worst (plant {worst.index}), pale: {cloud} others; band: ±{within:g} pulse"
    dressed(axis, title, 10)


def _run(certificate: Any, plant: Any) -> Any:
    """The `Evaluation` of a sampled plant, or None where its loop diverges."""
    options = {name: certificate.settings[name] for name in ("steps_per_sample", "duration")}
    law, path = certificate.law, certificate.reference
    try:
        return evaluate(plant.arm, plant.rig, law, path, backend="numba", **options)
    except DivergenceError:
        return None


def _errors(run: Any) -> NDArray[Any]:
    """Errors (N, n) before rounding, at the sampling instants of a run [pulses]."""
    steps = len(run.true_error_pulses) // len(run.record)
    return run.true_error_pulses[::steps][: len(run.record)]


def _draw_cloud(axis: Any, runs: list[Any]) -> None:
    """Shade the range of the errors of all runs along the path, joint by joint."""
    t = runs[0].record.t
    starts = np.unique(np.linspace(0, len(t), SETTINGS.blocks, endpoint=False).astype(int))
    errors = np.array([_errors(run) for run in runs])
    low = np.minimum.reduceat(errors.min(axis=0), starts)
    high = np.maximum.reduceat(errors.max(axis=0), starts)
    for joint in range(errors.shape[2]):
        style = {"color": colour_of(joint), "alpha": 0.25, "linewidth": 0, "zorder": 1}
        axis.fill_between(t[starts], low[:, joint], high[:, joint], **style)


def _sensitivities(axis: Any, certificate: Any, labels: list[str], influences: list[Any]) -> None:
    """Share of the variance of the peaks that each number explains, the largest on top."""
    axis.set(xlabel="share of the variance [%]")
    axis.grid(visible=False, axis="y")
    if not influences:
        dressed(axis, "sensitivity: nothing that was sampled stands out", 10)
        axis.set(xticks=[], yticks=[])
        return
    dressed(axis, "sensitivity to", 10)
    shares = [100 * influence.share for influence in influences]
    # Short names fit beside the bars; their meanings stand below the figure.
    short = _short(certificate)
    names = [_label(short.get(influence.name, influence.name), labels) for influence in influences]
    axis.barh(names, shares, height=0.6, color=colour_of(0))
    for row, influence in enumerate(influences):
        axis.annotate(
            influence.sense,
            (shares[row], row),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    # Room for the directions beside the bars; few bars keep the thickness of four.
    axis.set(xlim=(0, 1.35 * max(shares)), ylim=(-0.6, max(len(influences), 4) - 0.4))
    axis.tick_params(axis="y", labelsize=8)


def _resonances(axis: Any, certificate: Any, labels: list[str]) -> None:
    """Failures in each cell of the stated resonances, with bounds; the worst cell is shaded."""
    confidence = certificate.confidence
    worst = certificate.worst_cell
    for i, name in enumerate(dict.fromkeys(cell.name for cell in certificate.cells)):
        of_joint = [cell for cell in certificate.cells if cell.name == name]
        # The index in the name of a cell is that of its joint.
        joint = "" if name == "resonance" else f"{labels[int(name.partition('[')[2][:-1])]}: "
        colour = colour_of(i)
        for low, high in sorted({cell.hz for cell in of_joint}):
            # One line over the damping ratios: their share together, their largest bound.
            same_hz = [cell for cell in of_joint if cell.hz == (low, high)]
            bound = 100 * max(cell.upper(confidence) for cell in same_hz)
            failures = sum(cell.failures for cell in same_hz)
            share = 100 * (failures / max(sum(cell.count for cell in same_hz), 1))
            # Only one of the lines of a joint has an entry in the legend.
            entry = bool(low == of_joint[0].hz[0])
            outside = f"{joint}share outside the limit" * entry
            bounded = f"{joint}{100 * confidence:g} % bound" * entry
            axis.plot((low, high), (share, share), color=colour, label=outside)
            axis.plot((low, high), (bound, bound), color=colour, linestyle=":", label=bounded)
            if worst.name == name and worst.hz == (low, high):
                axis.axvspan(low, high, color=BAND, zorder=0, label="worst part")
    axis.set_xscale("log")
    # Whole numbers of Hz in place of powers of ten.
    lowest = min(cell.hz[0] for cell in certificate.cells)
    highest = max(cell.hz[1] for cell in certificate.cells)
    ticks = np.unique(np.round(np.geomspace(lowest, highest, 7)))
    axis.set_xticks(ticks, [f"{hz:g}" for hz in ticks])
    axis.set_xticks([], minor=True)
    # A line at zero would lie on the axis.
    axis.set_ylim(bottom=-0.03 * axis.get_ylim()[1])
    axis.set(xlabel="locked-rotor resonance [Hz]", ylabel="loops outside the limit [%]")
    legend_above(axis, at_left=True, columns=5)


def _headroom(labels: list[str]) -> float:
    """Share of a panel's height that its legend takes."""
    return 0.065 * (1 + len(labels))


def _label(name: str, labels: list[str]) -> str:
    """Name of a number in words."""
    kind, _, index = name[:-1].rpartition("[") if name.endswith("]") else (name, "", "")
    words = _WORDS.get(kind, kind)
    return f"{words},\n{labels[int(index)]}" if index else words

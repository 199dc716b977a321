"""Figures of a report: the log and its fit, what is left of it, intervals, the controller's error."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.figures.errors import draw_band
from identification.replay.prediction import Prediction
from identification.results.plots import draw_intervals, interval_height, repeated
from plant.parts.figures import BAND, LOGS, colour_of, dressed, legend_above, literal

_BINS = 900
"""Places along the time axis; of each the least and the largest sample are drawn."""

_STRETCH = 0.08
"""Share of the record that the second column shows."""


@literal
def draw_fit(found: Any) -> Any:
    """Tracking errors of the first record, measured and simulated: all of it, and a stretch."""
    record, model = found.records[0], repeated(found)
    joints = found.arm.dynamics.chain.joint_labels
    axes = _rows(len(joints), 2, (2.2, 1.0))
    begin = int(0.3 * len(record))
    stretch = slice(begin, begin + max(2, int(_STRETCH * len(record))))
    for joint, label in enumerate(joints):
        for axis, part in zip(axes[joint], (slice(None), stretch), strict=True):
            for log, (name, style) in zip((record, model), LOGS, strict=True):
                if log is not None:
                    axis.plot(*_thinned(log.t[part], log.error_pulses[part, joint]), label=name, **style)
        axes[joint, 0].set_ylabel(f"{label}\nerror [pulses]")
    legend_above(axes[0, 0], left=True)
    return axes


@literal
def draw_innovations(found: Any) -> Any:
    """What is left of the first record: counts less their one-step predictions."""
    record, n = found.records[0], found.arm.n
    prediction = Prediction(found.arm.dynamics, record, found.fit.unknown)
    left = prediction.innovations(np.append(found.fit.values, prediction.nuisances)).reshape(-1, n)
    axes = _rows(n, 2, (2.2, 1.0))
    for joint, label in enumerate(found.arm.dynamics.chain.joint_labels):
        colour = colour_of(joint)
        axes[joint, 0].plot(*_thinned(record.t, left[:, joint]), color=colour, lw=0.5)
        axes[joint, 0].set_ylabel(f"{label}\ninnovation [pulses]")
        spread = max(1.0, np.quantile(np.abs(left[:, joint]), 0.999))
        axes[joint, 1].hist(np.clip(left[:, joint], -spread, spread), bins=60, color=colour, density=True)
        axes[joint, 1].axvspan(-0.5, 0.5, color=BAND, zorder=0)
        axes[joint, 1].set_yticks([])
        axes[joint, 1].set_ylabel("share")
    axes[-1, 1].set_xlabel("innovation [pulses]")
    return axes


@literal
def draw_certainty(found: Any) -> Any:
    """Half-widths of the 95 % intervals; see `identification.results.plots.draw_intervals`."""
    axes = _rows(1, 1, (1.0,))
    axes[0, 0].figure.set_size_inches(9, max(1.8, interval_height(len(found.fit.values))))
    draw_intervals(axes[0, 0], found)
    return axes


@literal
def draw_errors(evaluation: Any) -> Any:
    """Counted errors of a controller, joint by joint, and the promised band."""
    record = evaluation.record
    axes = _rows(len(evaluation.joint_labels), 1, (1.0,))
    for joint, label in enumerate(evaluation.joint_labels):
        axis = axes[joint, 0]
        axis.plot(*_thinned(record.t, record.error_pulses[:, joint]), color=colour_of(joint), lw=0.7)
        axis.set_ylabel(f"{label}\nerror [pulses]")
        draw_band(axis)
    return axes


@literal
def draw_path(evaluation: Any) -> Any:
    """The path that a controller was to follow, joint by joint."""
    record, links = evaluation.record, evaluation.arm.dynamics.chain.links
    axes, q = _rows(len(links), 1, (1.0,)), record.reference(record.t).q
    for joint, (label, link) in enumerate(zip(evaluation.joint_labels, links, strict=True)):
        axis = axes[joint, 0]
        axis.plot(*_thinned(record.t, q[:, joint]), color=colour_of(joint), lw=1.0)
        axis.set_ylabel(f"{label}\nq [{'m' if link.prismatic else 'rad'}]")
    return axes


def _rows(rows: int, columns: int, widths: tuple[float, ...]) -> Any:
    import matplotlib.pyplot as plt

    height = 1.7 if rows < 4 else 1.3
    axes = plt.subplots(
        rows, columns, figsize=(9, height * rows + 0.5), squeeze=False, layout="constrained",
        gridspec_kw={"width_ratios": widths},
    )[1]  # fmt: skip
    for axis in axes.flat:
        dressed(axis)
        axis.tick_params(labelsize=8)
        axis.yaxis.label.set_size(8)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=8)
    return axes


def _thinned(t: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """At most two samples per place of the axis, the least and the largest, in their order."""
    if len(t) <= 4 * _BINS:
        return t, y
    kept = []
    for part in np.array_split(np.arange(len(t)), _BINS):
        kept += sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})
    return t[kept], y[kept]

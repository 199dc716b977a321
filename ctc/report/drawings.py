"""Figures of a report: the log and its fit, what is left of it, intervals, the controller's error."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ctc.figures import COLOURS, draw_band
from identification.replay.prediction import Prediction
from plant import simulate
from plant.parts.labels import literal
from plant.simulation.injection import injected_beside

__all__ = ["draw_errors", "draw_fit", "draw_innovations", "draw_intervals"]

_BINS = 900
"""Places along the time axis; of each the least and the largest sample are drawn."""

_STRETCH = 0.08
"""Share of the record that the second column shows."""

_MEASURED, _MODEL = "#444444", "#c8553d"


@literal
def draw_fit(found: Any) -> Any:
    """Tracking errors of the first record, measured and simulated: all of it, and a stretch."""
    record = found.records[0]
    model = None
    if record.reference is not None:
        duration = len(record) * record.rig.period
        model = simulate(
            found.arm, found.rig, found.law, record.reference, duration=duration, injected=injected_beside(record)
        )
    joints = found.arm.dynamics.chain.joint_labels
    figure, axes = _rows(len(joints), 2, (2.2, 1.0))
    begin = int(0.3 * len(record))
    stretch = slice(begin, begin + max(2, int(_STRETCH * len(record))))
    for joint, label in enumerate(joints):
        for axis, part in zip(axes[joint], (slice(None), stretch), strict=True):
            for log, colour, name in (
                (record, _MEASURED, "measured"),
                (model, _MODEL, "simulated"),
            ):
                if log is not None:
                    axis.plot(*_thinned(log.t[part], log.error_pulses[part, joint]), color=colour, lw=0.8, label=name)
        axes[joint, 0].set_ylabel(f"{label}\n[pulses]")
    axes[0, 0].legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


@literal
def draw_innovations(found: Any) -> Any:
    """What is left of the first record: counts less their one-step predictions."""
    record, n = found.records[0], found.arm.n
    prediction = Prediction(found.arm.dynamics, record, found.unknown)
    left = prediction.innovations(np.append(found.values, prediction.nuisances)).reshape(-1, n)
    figure, axes = _rows(n, 2, (2.2, 1.0))
    for joint, label in enumerate(found.arm.dynamics.chain.joint_labels):
        colour = COLOURS[joint % len(COLOURS)]
        axes[joint, 0].plot(*_thinned(record.t, left[:, joint]), color=colour, lw=0.5)
        axes[joint, 0].set_ylabel(f"{label}\n[pulses]")
        spread = max(1.0, np.quantile(np.abs(left[:, joint]), 0.999))
        axes[joint, 1].hist(np.clip(left[:, joint], -spread, spread), bins=60, color=colour, density=True)
        axes[joint, 1].axvspan(-0.5, 0.5, color="#e9e4d4", zorder=0)
        axes[joint, 1].set_yticks([])
    axes[-1, 1].set_xlabel("innovation [pulses]")
    return figure


@literal
def draw_intervals(found: Any) -> Any:
    """Half-widths of the 95 % intervals, all counted and of noise alone, as shares of the values, on one log axis."""
    import matplotlib.pyplot as plt

    names, half = list(found.short_names), 1.96 * found.std
    known = half > 0
    scale = np.abs(found.values)
    order = np.flatnonzero(known)
    figure, axis = plt.subplots(figsize=(9, 0.9 + 0.24 * len(order)), layout="constrained")
    place = np.arange(len(order))
    axis.scatter(100 * half[order] / scale[order], place, s=26, color=COLOURS[0], zorder=3, label="all that is counted")
    noise = found.fit.noise_covariance
    if noise is not None:
        share = 196 * np.sqrt(np.diag(noise))[order] / scale[order]
        axis.scatter(share, place, s=22, facecolor="white", edgecolor=COLOURS[1], zorder=3, label="noise alone")
    axis.axvline(100, color="0.4", lw=0.8, ls="--")
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_yticks(place, [names[i] for i in order], fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("half-width of the 95 % interval [% of the value]; dashed: the sign is not known beyond")
    axis.grid(alpha=0.25, lw=0.5)
    axis.spines[["top", "right"]].set_visible(False)
    axis.legend(frameon=False, fontsize=8, ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
    return figure


@literal
def draw_errors(evaluation: Any) -> Any:
    """Counted errors of a controller, joint by joint, and the promised band."""
    record = evaluation.record
    figure, axes = _rows(len(evaluation.joint_labels), 1, (1.0,))
    for joint, label in enumerate(evaluation.joint_labels):
        axis = axes[joint, 0]
        axis.plot(*_thinned(record.t, record.error_pulses[:, joint]), color=COLOURS[joint % len(COLOURS)], lw=0.7)
        axis.set_ylabel(f"{label}\n[pulses]")
        draw_band(axis)
    return figure


def _rows(rows: int, columns: int, widths: tuple[float, ...]) -> Any:
    import matplotlib.pyplot as plt

    height = 1.7 if rows < 4 else 1.3
    figure, axes = plt.subplots(
        rows, columns, figsize=(9, height * rows + 0.5), squeeze=False, layout="constrained",
        gridspec_kw={"width_ratios": widths},
    )  # fmt: skip
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
        axis.tick_params(labelsize=8)
        axis.yaxis.label.set_size(8)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]", fontsize=8)
    return figure, axes


def _thinned(t: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """At most two samples per place of the axis, the least and the largest, in their order."""
    if len(t) <= 4 * _BINS:
        return t, y
    kept = []
    for part in np.array_split(np.arange(len(t)), _BINS):
        kept += sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})
    return t[kept], y[kept]

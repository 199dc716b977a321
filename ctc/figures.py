"""Figures of tracking errors, torques, phase and margins, and the paper's Figs. 6-9 and 12-15 redrawn.

matplotlib is imported only when a figure is drawn. Every function returns the figure and leaves saving to the caller.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from plant import Record
from plant.parts.labels import joint_labels, literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "COLOURS", "draw_band", "plot_comparison", "plot_evaluation", "plot_identification", "plot_margins",
    "plot_phase", "plot_record", "plot_sweep",
]  # fmt: skip

COLOURS = ("#1f6f8b", "#c8553d", "#5a7d2a", "#7b4b94", "#b8860b", "#2fb5c7", "#d87ca8")
"""Of the joints, in turn."""
_BAND = "#e9e4d4"
_ABREAST = 4
"""Laws beside each other at most; more stand below each other."""
_PHASES = 3
"""Phase plots beside each other at most."""
_WIDEST = 22.0
"""Of a figure [inches]."""


def _figure(rows: int, columns: int, width: float = 9.0, height: float = 2.3) -> tuple[Figure, NDArray[Any]]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        rows, columns, figsize=(width, height * rows), sharex=True, squeeze=False, layout="constrained"
    )
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure, axes


def _pulses(axis: Any, t: NDArray[Any], error: NDArray[Any], colour: str) -> None:
    axis.plot(t, error, drawstyle="steps-post", color=colour, linewidth=0.7)


def draw_band(axis: Any, pulses: float = 1) -> None:
    """The promised band, and whole pulses on the axis, which never ends at the band."""
    from matplotlib.ticker import MaxNLocator

    axis.axhspan(-pulses, pulses, color=_BAND, zorder=0)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -2.0 * pulses), max(high, 2.0 * pulses))
    axis.annotate(f"±{pulses} pulse", (1.0, pulses), (-2, 1), xycoords=axis.get_yaxis_transform(),
                  textcoords="offset points", ha="right", va="bottom", fontsize=7, color="0.35",
                  bbox={"facecolor": "white", "alpha": 0.6, "linewidth": 0, "pad": 0.5})  # fmt: skip


def _limit(axis: Any, drive: Any, joint: int) -> None:
    """The amplifier's limit as dashed lines, where it has one; coupled motors have theirs on the shafts."""
    limit = drive.torque_limit()[joint]
    if np.isfinite(limit) and not drive.coupling.matrix:
        for sign in (1, -1):
            axis.axhline(sign * limit, color="0.35", linewidth=0.7, linestyle="--")
        axis.annotate("amplifier's limit", (1.0, limit), (-2, 2), xycoords=axis.get_yaxis_transform(),
                      textcoords="offset points", ha="right", va="bottom", fontsize=7, color="0.35")  # fmt: skip
        axis.set_ylim(-1.2 * limit, 1.2 * limit)


def _equal_rows(axes: NDArray[Any], headroom: float = 1.0) -> None:
    """One scale per row, so that columns can be compared; `headroom` above one leaves place for a legend."""
    for row in axes:
        largest = max(abs(limit) for axis in row for limit in axis.get_ylim())
        for axis in row:
            axis.set_ylim(-largest, largest * headroom)


def _require_evaluation(name: str, evaluation: Any) -> None:
    if not hasattr(evaluation, "true_error_pulses"):
        raise ValueError(f"{name} must be an Evaluation; got {type(evaluation).__name__}. Pass what evaluate gave.")


@literal
def plot_evaluation(evaluation: Any, axes: Any = None) -> Figure:
    """Encoder error with the +-1 pulse band (left), torque and the amplifier's limit (right), one row per joint.

    Parameters
    ----------
    evaluation : Evaluation
    axes : (n, 2) array of matplotlib axes, optional
        Where to draw; a new figure by default.

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    ctc.Evaluation, ctc.plot_phase

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate, plot_evaluation
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> drawn = plot_evaluation(evaluate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.3))
    """
    record = evaluation.record
    figure, axes = _figure(record.n, 2, width=11) if axes is None else (np.asarray(axes).flat[0].figure, axes)
    for joint, (left, right) in enumerate(axes):
        colour = COLOURS[joint % len(COLOURS)]
        _pulses(left, record.t, record.error_pulses[:, joint], colour)
        draw_band(left)
        left.set_ylabel(f"{evaluation.joint_labels[joint]}\nerror [pulses]")
        right.plot(record.t, record.torque[:, joint], color=colour, linewidth=0.7)
        right.set_ylabel("torque [N m]")
        _limit(right, record.rig.drive, joint)
    axes[0][0].set_title(f"{evaluation.share_within(1)} of the samples within ±1 pulse", fontsize=10)
    axes[0][1].set_title("joint torque", fontsize=10)
    return figure


@literal
def plot_phase(evaluation: Any) -> Figure:
    """Phase plot: rate of the true error over the true error, one panel per joint; a limit cycle shows as a ring.

    Parameters
    ----------
    evaluation : Evaluation

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    ctc.plot_evaluation

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, evaluate, plot_phase
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> drawn = plot_phase(evaluate(arm, rig, ComputedTorque(arm, rig), puma560.reference(), duration=0.3))
    """
    import matplotlib.pyplot as plt

    _require_evaluation("evaluation", evaluation)
    record, error = evaluation.record, evaluation.true_error_pulses
    rate = np.gradient(error, record.rig.period * len(record) / len(error), axis=0)
    columns = min(record.n, _PHASES)
    rows = -(-record.n // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(4.5 * columns, 4 * rows), squeeze=False, layout="constrained")
    for axis in axes.flat[record.n :]:
        axis.remove()
    for joint, axis in enumerate(axes.flat[: record.n]):
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5)
        axis.axvspan(-1, 1, color=_BAND, zorder=0)
        axis.plot(error[:, joint], rate[:, joint], color=COLOURS[joint % len(COLOURS)], linewidth=0.4, alpha=0.6)
        axis.plot(error[0, joint], rate[0, joint], "o", color="0.2", markersize=4, label="start")
        reach = 1.1 * max(np.abs(error[:, joint]).max(), 2.0)
        axis.set_xlim(-reach, reach)
        axis.set_xlabel("true error [pulses]; shaded: ±1 pulse")
        axis.set_title(evaluation.joint_labels[joint], fontsize=10)
    for axis in axes[:, 0]:
        axis.set_ylabel("rate of the error [pulses/s]")
    axes[0, 0].legend(loc="upper right", fontsize=8, frameon=False)
    return figure


@literal
def plot_comparison(evaluations: dict[str, Any]) -> Figure:
    """Tracking errors of several laws on the same arm.

    Up to four laws stand side by side at equal scales; more stand one below the other, each at its own scale, with the
    +-1 pulse band to compare by.

    Parameters
    ----------
    evaluations : dict of str -> Evaluation

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    ctc.Comparison, ctc.plot_evaluation

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, compare, plot_comparison
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> laws = {"P": puma560.p_law(), "computed torque": ComputedTorque(arm, rig)}
    >>> drawn = plot_comparison(compare(arm, rig, laws, puma560.reference(), duration=0.3).evaluations)
    """
    if not isinstance(evaluations, dict) or not evaluations:
        given = f"{evaluations!r:.40}" if evaluations else "none"
        raise ValueError(f"evaluations must be a dict, one per law; got {given}. Pass {{name: evaluate(...)}}.")
    for name, evaluation in evaluations.items():
        _require_evaluation(f"evaluation {name!r}", evaluation)
    first = next(iter(evaluations.values())).record
    abreast = len(evaluations) <= _ABREAST
    if abreast:
        figure, axes = _figure(first.n, len(evaluations), width=5.2 * len(evaluations))
    else:
        figure, axes = _figure(len(evaluations), first.n, width=min(5.2 * first.n, _WIDEST), height=1.5)
        axes = axes.T
    for column, (name, evaluation) in enumerate(evaluations.items()):
        record = evaluation.record
        for joint in range(record.n):
            axis = axes[joint, column]
            _pulses(axis, record.t, record.error_pulses[:, joint], COLOURS[joint % len(COLOURS)])
            draw_band(axis)
            if abreast and column == 0:
                axis.set_ylabel(f"{evaluation.joint_labels[joint]}\nerror [pulses]")
            elif not abreast:
                axis.set_ylabel("error [pulses]" if joint == 0 else "")
                axis.set_xlabel(f"{evaluation.joint_labels[joint]}: time [s]" if column == len(evaluations) - 1 else "")
        axes[0, column].set_title(f"{name}: {evaluation.share_within(1)} within ±1 pulse", fontsize=10)
    if abreast:
        _equal_rows(axes)
    return figure


@literal
def plot_record(record: Record, joints: Sequence[str] = ()) -> Figure:
    """Tracking error and motor current of every joint. Source: paper Figs. 6-9.

    Parameters
    ----------
    record : Record
    joints : sequence of str, optional
        Names of the joints; by default those of the rig's drive.

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    plant.Record, ctc.plot_evaluation

    Examples
    --------
    >>> from plant import puma560, simulate
    >>> from ctc import plot_record
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    >>> drawn = plot_record(record)
    """
    current = record.current
    columns = 1 if current is None else 2
    labels = joint_labels(joints or record.rig.drive.joints, record.n)
    figure, axes = _figure(record.n, columns, width=5.5 * columns)
    for joint in range(record.n):
        colour = COLOURS[joint % len(COLOURS)]
        axes[joint, 0].plot(record.t, record.error_pulses[:, joint], color=colour, linewidth=0.7)
        axes[joint, 0].set_ylabel(f"{labels[joint]}\nerror [pulses]")
        if current is not None:
            axes[joint, 1].plot(record.t, current[:, joint], color=colour, linewidth=0.7)
            axes[joint, 1].set_ylabel("current [A]")
    axes[0, 0].set_title("tracking error (paper: Figs. 6, 7)", fontsize=10)
    if columns == 2:
        axes[0, 1].set_title("motor current (paper: Figs. 8, 9)", fontsize=10)
    return figure


@literal
def plot_identification(
    measured: Record, first: Record, best: Record, others: Sequence[Record] = (), joints: Sequence[str] = ()
) -> Figure:
    """Measured tracking errors beside those of models. Source: paper Figs. 12-15.

    Parameters
    ----------
    measured : Record
        The robot.
    first, best : Record
        The best model of the initial population, and of the last one.
    others : sequence of Record
        More models of the initial population, drawn thin.
    joints : sequence of str, optional
        Names of the joints; by default those of the rig's drive.

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    identification.Identification, ctc.plot_record

    Examples
    --------
    >>> from plant import puma560, replay, simulate
    >>> from ctc import plot_identification
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    >>> model = replay(puma560.literature_arm(1.5), record)
    >>> drawn = plot_identification(record, model, record)
    """
    figure, axes = _figure(measured.n, 2, width=11)
    labels = joint_labels(joints or measured.rig.drive.joints, measured.n)
    titles = ("initial population (paper: Figs. 12, 13)", "after identification (paper: Figs. 14, 15)")
    for column, (model, title) in enumerate(zip((first, best), titles, strict=True)):
        for joint in range(measured.n):
            axis = axes[joint, column]
            for i, other in enumerate(others if column == 0 else ()):
                label = f"next {len(others)} models" if i == 0 else None
                axis.plot(other.t, other.error_pulses[:, joint], color="0.8", linewidth=0.5, label=label)
            axis.plot(measured.t, measured.error_pulses[:, joint], color="0.35", linewidth=0.7, label="robot")
            colour = COLOURS[joint % len(COLOURS)]
            axis.plot(model.t, model.error_pulses[:, joint], color=colour, linewidth=0.7, label="best model")
            axis.set_ylabel(f"{labels[joint]}\nerror [pulses]" if column == 0 else "")
            axis.legend(loc="upper right", fontsize=7, ncols=3, frameon=False)
        axes[0, column].set_title(title, fontsize=10)
    _equal_rows(axes, headroom=1.3)
    return figure


@literal
def plot_margins(margins: Any) -> Figure:
    """Bode diagram of the loop of each joint, and its sensitivity; all over frequency, up to half the sampling rate.

    Parameters
    ----------
    margins : Margins

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    ctc.Margins

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, margins, plot_margins
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> drawn = plot_margins(margins(arm, rig, ComputedTorque(arm, rig, bandwidth=60)))
    """
    figure, axes = _figure(3, 1, width=7.0)
    f = margins.frequency
    for joint, loop in enumerate(margins.response):
        phase = np.unwrap(np.angle(loop))
        phase -= 2 * np.pi * np.ceil(phase[np.abs(np.abs(loop) - 1).argmin()] / (2 * np.pi))
        options = {"color": COLOURS[joint % len(COLOURS)], "linewidth": 1.2, "label": margins.joint_labels[joint]}
        options["linestyle"] = ("-", "--", ":", "-.")[joint % 4]  # joints under one law often lie on one another
        axes[0, 0].plot(f, 20 * np.log10(np.abs(loop)), **options)
        axes[1, 0].plot(f, np.rad2deg(phase), **options)
        axes[2, 0].plot(f, 20 * np.log10(np.abs(1 / (1 + loop))), **options)
    for axis, level in zip(axes[:, 0], (0, -180, 0), strict=True):
        axis.axhline(level, color="0.35", linewidth=0.6, linestyle="--")
    near = slice(np.searchsorted(f, f[-1] / 1000), None)
    for axis, name in zip(axes[:, 0], ("loop [dB]", "phase [deg]", "sensitivity [dB]"), strict=True):
        axis.set_ylabel(name)
        axis.set_xscale("log")
        axis.set_xlim(f[near][0], f[-1])
    axes[0, 0].set_ylim(-40, 60)
    axes[1, 0].set_yticks(np.arange(-360, 1, 90))
    axes[1, 0].set_ylim(-400, 10)
    axes[2, 0].set_ylim(-60, 15)
    axes[0, 0].legend(frameon=False, fontsize=8)
    axes[-1, 0].set_xlabel("frequency [Hz]")
    return figure


@literal
def plot_sweep(sweep: Any) -> Figure:
    """Share of samples within the limit over the resonance of the gears, and bars where every sample is, law by law.

    Parameters
    ----------
    sweep : ResonanceSweep

    Returns
    -------
    matplotlib.figure.Figure

    See Also
    --------
    ctc.ResonanceSweep

    Examples
    --------
    >>> from plant import puma560
    >>> from ctc import ComputedTorque, plot_sweep, sweep_resonance
    >>> arm, rig = puma560.arm(), puma560.rig()
    >>> laws = {"60 rad/s": ComputedTorque(arm, rig, bandwidth=60)}
    >>> drawn = plot_sweep(sweep_resonance(arm, rig, laws, puma560.reference(), hz=(30, 100), duration=0.3))
    """
    import matplotlib.pyplot as plt
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

    names, hz = list(sweep.shares), sweep.hz
    edges = np.sqrt(hz[1:] * hz[:-1])
    edges = np.concatenate([[hz[0] ** 2 / edges[0]], edges, [hz[-1] ** 2 / edges[-1]]])
    heights = (3.6, 0.42 * len(names) + 0.5)
    figure, (share, bars) = plt.subplots(
        2, 1, figsize=(9.0, sum(heights)), height_ratios=heights, sharex=True, layout="constrained"
    )
    for place, name in enumerate(names):
        colour, own = COLOURS[place % len(COLOURS)], sweep.shares[name]
        share.plot(hz, 100 * own, color=colour, linewidth=1.6, label=name)
        for low, high, inside in zip(edges[:-1], edges[1:], own >= 1, strict=True):
            if inside:
                bars.barh(-place, high - low, 0.62, left=low, color=colour, linewidth=0)
    share.set_ylabel(f"samples within ±{sweep.within:g} pulse [%]")
    share.set_ylim(-2, 104)
    share.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.2)
    bars.set_yticks([-place for place in range(len(names))], names)
    bars.set_ylim(-len(names) + 0.4, 0.6)
    bars.set_title("every sample within", loc="left", fontsize=9)
    bars.set_xscale("log")
    bars.set_xlim(edges[0], edges[-1])
    ticks = [x for x in (5, 10, 15, 25, 40, 60, 100, 150, 250, 500, 1000) if edges[0] <= x <= edges[-1]]
    bars.xaxis.set_major_locator(FixedLocator(ticks))
    bars.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    bars.xaxis.set_minor_formatter(NullFormatter())
    bars.set_xlabel(f"resonance of the gears, motors locked [Hz]; damping ratio {sweep.damping_ratio:g}")
    for axis in (share, bars):
        axis.spines[["top", "right"]].set_visible(False)
        axis.grid(alpha=0.25, linewidth=0.5, axis="x")
    share.grid(alpha=0.25, linewidth=0.5, axis="y")
    return figure

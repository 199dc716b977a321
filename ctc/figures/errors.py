"""Figures of tracking errors, torques and phase; the paper's Figs. 6-9 and 12-15 redrawn.

matplotlib is imported only when a figure is drawn. Every function draws on the Axes that ``ax=``
gives it, or on a new figure, returns the Axes and leaves saving to the caller:
``axes.flat[0].figure.savefig(...)``.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant import Record
from plant.parts import (
    BAND,
    LOGS,
    axes_of,
    colour_of,
    dressed,
    frozen_settings,
    instance,
    joint_labels,
    legend_above,
    literal,
    row_by_row,
)


@frozen_settings
class FigureSettings:
    """Layout of the figures of errors; chosen by hand.

    Parameters
    ----------
    abreast : int
        Controllers beside each other at most; more stand below each other.
    strip : int
        Motions beside each other at most.
    phases : int
        Phase plots beside each other at most.
    widest : float
        Width of a figure at most [inch]; wider ones are scaled down to a page, and not read.
    """

    abreast: int = 4
    strip: int = 4
    phases: int = 3
    widest: float = 11.2


LAYOUT = FigureSettings()


def draw_band(axis: Any, pulses: float = 1) -> None:
    """Shade the specified band; the axis has whole pulses, and never ends at the band."""
    from matplotlib.ticker import MaxNLocator

    # Behind the curves.
    axis.axhspan(-pulses, pulses, color=BAND, zorder=0)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    # At the band's edges a small error would look as large as the limit.
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -2.0 * pulses), max(high, 2.0 * pulses))


def _pulses(axis: Any, t: NDArray[Any], error: NDArray[Any], colour: str) -> None:
    # A count holds until the next sample: steps, no slopes between whole pulses.
    axis.plot(t, error, drawstyle="steps-post", color=colour, linewidth=0.7)


def _limit(axis: Any, drive: Any, joint: int) -> bool:
    """Draw the amplifier's limit as dashed lines; False where the joint has none."""
    limit = drive.torque_limit()[joint]
    # Limits of coupled motors act on their shafts, not on one joint.
    if not np.isfinite(limit) or drive.coupling.matrix:
        return False
    for sign in (1, -1):
        axis.axhline(sign * limit, color="0.35", linewidth=0.7, linestyle="--")
    # A little more than the limit, so that its lines do not lie on the frame.
    axis.set_ylim(-1.2 * limit, 1.2 * limit)
    return True


def equal_rows(axes: NDArray[Any], headroom: float = 1.0) -> None:
    """Give each row one scale, to compare its columns; `headroom` above one is for a legend."""
    for row in axes:
        largest = max(abs(limit) for axis in row for limit in axis.get_ylim())
        for axis in row:
            axis.set_ylim(-largest, largest * headroom)


def _require_evaluation(name: str, evaluation: Any) -> None:
    # By its attribute: the class is in a room above the figures.
    if not hasattr(evaluation, "true_error_pulses"):
        raise ValueError(
            f"{name} must be an Evaluation; got {type(evaluation).__name__}. Pass what evaluate"
            " gave."
        )


def titled(axes: NDArray[Any], head: str, labels: Sequence[str] = ()) -> None:
    """Set a head above the first of the axes (n,), and each joint's label above its axis."""
    for axis, label in zip(axes, labels or [""] * len(axes), strict=True):
        dressed(axis, f"{head}\n{label}" if axis is axes[0] else label, 10)


@literal
def plot_evaluation(evaluation: Any, ax: Any = None) -> NDArray[Any]:
    """Draw encoder error with the ±1 pulse band, and torque with its limit; one row per joint."""
    _require_evaluation("evaluation", evaluation)
    record = evaluation.record
    limited = False
    axes = row_by_row(ax, record.n, 2, width=11)
    units = evaluation.arm.dynamics.chain.joint_units
    for joint, (unit, (error_axis, torque_axis)) in enumerate(zip(units, axes, strict=True)):
        # The band comes after the curve, whose range the axis keeps.
        _pulses(error_axis, record.t, record.error_pulses[:, joint], colour_of(joint))
        draw_band(error_axis)
        error_axis.set_ylabel("error [pulses]")
        torque_axis.plot(record.t, record.torque[:, joint], color=colour_of(joint), linewidth=0.7)
        torque_axis.set_ylabel(f"torque [{unit.effort}]")
        # The title explains the dashed lines only where there are some.
        limited |= _limit(torque_axis, record.rig.drive, joint)
    titled(
        axes[:, 0],
        f"{evaluation.share_within(1)} of the samples within ±1 pulse (shaded)",
        evaluation.joint_labels,
    )
    titled(axes[:, 1], f"joint torque{'; dashed: the amplifier limit' * limited}")
    return axes


@literal
def plot_phase(evaluation: Any, ax: Any = None) -> NDArray[Any]:
    """Phase plot: rate of the true error over it, a panel per joint; limit cycles are rings."""
    _require_evaluation("evaluation", evaluation)
    record = evaluation.record
    error = evaluation.true_error_pulses
    # The true error has several instants to a sample of the record.
    rate = np.gradient(error, record.rig.period * len(record) / len(error), axis=0)

    def new() -> Any:
        import matplotlib.pyplot as plt

        columns = min(record.n, LAYOUT.phases)
        # Rounded up.
        rows = -(-record.n // columns)
        size = (4.5 * columns, 4 * rows)
        _, grid = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
        # The last row may have more panels than joints.
        for axis in grid.flat[record.n :]:
            axis.remove()
        return grid.flat[: record.n]

    axes = axes_of(ax, (record.n,), new)
    for joint, axis in enumerate(axes):
        dressed(axis, evaluation.joint_labels[joint], 10)
        axis.axvspan(-1, 1, color=BAND, zorder=0)
        axis.plot(error[:, joint], rate[:, joint], color=colour_of(joint), linewidth=0.5, alpha=0.8)
        # A trajectory in the plane has no time: the dot says where it begins.
        axis.plot(error[0, joint], rate[0, joint], "o", color="0.2", markersize=4, label="start")
        # Both sides alike, and never less than two pulses: the band keeps its meaning.
        reach = 1.1 * max(np.abs(error[:, joint]).max(), 2.0)
        axis.set(xlim=(-reach, reach), xlabel="true error [pulses]; shaded: ±1 pulse")
        axis.set_ylabel("rate of the error [pulses/s]")
    legend_above(axes[0])
    return axes


@literal
def plot_comparison(evaluations: dict[str, Any], ax: Any = None) -> NDArray[Any]:
    """Tracking errors of several controllers on the same arm."""
    if not isinstance(evaluations, dict) or not evaluations:
        got = f"{evaluations!r:.40}" if evaluations else "none"
        raise ValueError(
            f"evaluations must be a dict, one per controller; got {got}. Pass {{name:"
            " evaluate(...)}."
        )
    for name, evaluation in evaluations.items():
        _require_evaluation(f"evaluation {name!r}", evaluation)
    n = next(iter(evaluations.values())).record.n
    laws = len(evaluations)
    # A column for each controller; of many controllers a row for each, by the transposed axes.
    abreast = laws <= LAYOUT.abreast
    if abreast:
        # `drawn` has the shape of the page, `axes` (joint, controller).
        drawn = axes = row_by_row(ax, n, laws, width=min(5.2 * laws, LAYOUT.widest))
    else:
        drawn = row_by_row(ax, laws, n, width=min(5.2 * n, LAYOUT.widest), height=1.5)
        axes = drawn.T
    for column, (name, evaluation) in enumerate(evaluations.items()):
        record = evaluation.record
        for joint, axis in enumerate(axes[:, column]):
            _pulses(axis, record.t, record.error_pulses[:, joint], colour_of(joint))
            draw_band(axis)
            # Inner axes need no label of their own.
            axis.set_ylabel("error [pulses]" if (column if abreast else joint) == 0 else "")
            if not abreast and column == laws - 1:
                axis.set_xlabel(f"{evaluation.joint_labels[joint]}\ntime [s]")
        # Narrow columns need a title of two lines.
        between = "\n" if abreast and laws > 2 else ": "
        head = f"{name}{between}{evaluation.share_within(1)} within ±1 pulse (shaded)"
        if abreast:
            titled(axes[:, column], head, evaluation.joint_labels if column == 0 else ())
        else:
            dressed(axes[0, column], head, 10)
    # Stacked panels hold one controller each: a common scale would flatten the good ones.
    if abreast:
        equal_rows(axes)
    return drawn


@literal
def plot_motions(evaluations: Mapping[str, Any], ax: Any = None) -> NDArray[Any]:
    """Tracking errors of one arm in several motions: a small panel each, with all joints."""
    columns = min(len(evaluations), LAYOUT.strip)
    rows = -(-len(evaluations) // columns)

    def new() -> Any:
        # Motions differ in length, so that no panels share their time.
        panels = row_by_row(None, rows, columns, width=2.6 * columns, height=1.7, time=False)
        return panels.flat[: len(evaluations)]

    axes = axes_of(ax, (len(evaluations),), new)
    for axis, (name, evaluation) in zip(axes, evaluations.items(), strict=True):
        record = evaluation.record
        for joint, label in enumerate(evaluation.joint_labels):
            error = record.error_pulses[:, joint]
            axis.plot(
                record.t,
                error,
                drawstyle="steps-post",
                color=colour_of(joint),
                linewidth=0.7,
                alpha=0.8,
                label=label,
            )
        draw_band(axis)
        dressed(axis, f"{name}: {evaluation.share_within(1)}", 8)
        axis.set(xlabel="time [s]", ylabel="error [pulses]")
    if ax is None:
        figure = axes[0].figure
        # Cells of the last row without a motion.
        for axis in figure.axes[len(evaluations) :]:
            axis.set_axis_off()
        figure.legend(
            *axes[0].get_legend_handles_labels(),
            loc="outside upper right",
            frameon=False,
            fontsize=8,
            ncols=min(len(axes[0].lines), 6),
        )
        figure.suptitle(
            "share of the samples within ±1 pulse (shaded)", fontsize=9, x=0.01, ha="left"
        )
    return axes


@literal
def plot_record(
    record: Record,
    joints: Sequence[str] = (),
    *,
    models: tuple[Sequence[Record], Record] | None = None,
    ax: Any = None,
) -> NDArray[Any]:
    """Draw tracking error and motor current of every joint, or errors beside those of models.

    Source: paper Figs. 6-15.

    Parameters
    ----------
    record : Record
    joints : sequence of str, optional
        Names of the joints; by default those of the rig's drive.
    models : (sequence of Record, Record), optional
        Simulations of models of the initial population, the best first (the rest is drawn thin),
        and of the best model of the last population.
    ax : (n, 2) array of matplotlib Axes, optional
        Where to draw, (n, 1) of a record without currents; a new figure by default.

    Returns
    -------
    numpy.ndarray of matplotlib Axes
        Of the same shape.

    Raises
    ------
    ValueError
        Another number of Axes, or no record.

    See Also
    --------
    plant.Record, identification.Identification

    Examples
    --------
    >>> from plant import puma560, replay, simulate
    >>> from ctc import plot_record
    >>> arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    >>> record = simulate(arm, rig, puma560.p_law(), path, duration=0.5)
    >>> drawn = plot_record(record)
    >>> models = [replay(puma560.literature_arm(1.5), record)], record
    >>> beside = plot_record(record, models=models)
    """
    instance("record", record, Record, "Pass what simulate or from_csv gave.")
    labels = joint_labels(joints or record.rig.drive.joints, record.n)
    if models is not None:
        return _beside(record, *models, labels, ax)
    # A log without currents has a column of errors alone.
    current = record.current
    columns = 1 if current is None else 2
    axes = row_by_row(ax, record.n, columns, width=5.5 * columns)
    for joint, row in enumerate(axes):
        row[0].plot(record.t, record.error_pulses[:, joint], color=colour_of(joint), linewidth=0.7)
        row[0].set_ylabel("error [pulses]")
        if current is not None:
            row[1].plot(record.t, current[:, joint], color=colour_of(joint), linewidth=0.7)
            row[1].set_ylabel("current [A]")
    titled(axes[:, 0], "tracking error (paper: Figs. 6, 7)", labels)
    if current is not None:
        titled(axes[:, 1], "motor current (paper: Figs. 8, 9)")
    return axes


def _beside(
    record: Record, initial: Sequence[Record], best: Record, labels: list[str], ax: Any
) -> NDArray[Any]:
    """Draw measured tracking errors beside those of models."""
    axes = row_by_row(ax, record.n, 2, width=11)
    titles = (
        "initial population (paper: Figs. 12, 13)",
        "after identification (paper: Figs. 14, 15)",
    )
    (_, robot), (_, thin) = LOGS
    for column, (models, title) in enumerate(zip((initial, [best]), titles, strict=True)):
        # The best of a population comes first.
        model, *alternatives = models
        for joint, axis in enumerate(axes[:, column]):
            # Behind the robot and the best; one entry of the legend stands for all of them.
            for i, alternative in enumerate(alternatives):
                label = f"next {len(alternatives)} models" if i == 0 else None
                error = alternative.error_pulses[:, joint]
                axis.plot(alternative.t, error, color=colour_of(5), linewidth=0.5, label=label)
            axis.plot(record.t, record.error_pulses[:, joint], label="robot", **robot)
            axis.plot(model.t, model.error_pulses[:, joint], label="best model", **thin)
            axis.set_ylabel("error [pulses]" if column == 0 else "")
        titled(axes[:, column], title, labels if column == 0 else ())
        axes[0, column].legend(loc="upper right", fontsize=8, ncols=3, frameon=False)
    # The progress shows only on one scale.
    equal_rows(axes, headroom=1.3)
    return axes

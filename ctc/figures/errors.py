"""Figures of tracking errors, torques and phase; the paper's Figs. 6-9 and 12-15 redrawn.

matplotlib is imported only when a figure is drawn. Every function draws on the Axes that ``ax=``
gives it, or on a new figure, returns the Axes and leaves saving to the caller:
``axes.flat[0].figure.savefig(...)``.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant import Record
from plant.parts.figures import (
    BAND,
    LOGS,
    axes_of,
    colour_of,
    dressed,
    legend_above,
    literal,
    row_by_row,
)
from plant.parts.messages import joint_labels

_ABREAST = 4  # controllers beside each other at most; more stand below each other
_PHASES = 3  # phase plots beside each other at most
_WIDEST = 22.0  # of a figure [inches]


def draw_band(axis: Any, pulses: float = 1) -> None:
    """The specified band, shaded, and whole pulses on the axis, which never ends at the band."""
    from matplotlib.ticker import MaxNLocator

    axis.axhspan(-pulses, pulses, color=BAND, zorder=0)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True))
    low, high = axis.get_ylim()
    axis.set_ylim(min(low, -2.0 * pulses), max(high, 2.0 * pulses))


def _pulses(axis: Any, t: NDArray[Any], error: NDArray[Any], colour: str) -> None:
    axis.plot(t, error, drawstyle="steps-post", color=colour, linewidth=0.7)


def _limit(axis: Any, drive: Any, joint: int) -> bool:
    """The amplifier's limit as dashed lines, where it has one; coupled motors have theirs on the
    shafts.
    """
    limit = drive.torque_limit()[joint]
    if not np.isfinite(limit) or drive.coupling.matrix:
        return False
    for sign in (1, -1):
        axis.axhline(sign * limit, color="0.35", linewidth=0.7, linestyle="--")
    axis.set_ylim(-1.2 * limit, 1.2 * limit)
    return True


def equal_rows(axes: NDArray[Any], headroom: float = 1.0) -> None:
    """One scale per row, so that columns can be compared; `headroom` above one leaves place for
    a legend.
    """
    for row in axes:
        largest = max(abs(limit) for axis in row for limit in axis.get_ylim())
        for axis in row:
            axis.set_ylim(-largest, largest * headroom)


def _require_evaluation(name: str, evaluation: Any) -> None:
    if not hasattr(evaluation, "true_error_pulses"):
        raise ValueError(
            f"{name} must be an Evaluation; got {type(evaluation).__name__}. Pass what evaluate"
            " gave."
        )


def titled(axes: NDArray[Any], head: str, labels: Sequence[str] = ()) -> None:
    """A head above the first of the axes (n,), and the label of each joint above its own."""
    for axis, label in zip(axes, labels or [""] * len(axes), strict=True):
        dressed(axis, f"{head}\n{label}" if axis is axes[0] else label, 10)


@literal
def plot_evaluation(evaluation: Any, ax: Any = None) -> NDArray[Any]:
    """Encoder error with the ±1 pulse band (left), torque and the amplifier's limit (right), one
    row per joint.
    """
    _require_evaluation("evaluation", evaluation)
    record = evaluation.record
    limited = False
    axes = row_by_row(ax, record.n, 2, width=11)
    for joint, (left, right) in enumerate(axes):
        _pulses(left, record.t, record.error_pulses[:, joint], colour_of(joint))
        draw_band(left)
        left.set_ylabel("error [pulses]")
        right.plot(record.t, record.torque[:, joint], color=colour_of(joint), linewidth=0.7)
        right.set_ylabel("torque [N m]")
        limited |= _limit(right, record.rig.drive, joint)
    titled(
        axes[:, 0],
        f"{evaluation.share_within(1)} of the samples within ±1 pulse (shaded)",
        evaluation.joint_labels,
    )
    titled(axes[:, 1], f"joint torque{'; dashed: the amplifier limit' * limited}")
    return axes


@literal
def plot_phase(evaluation: Any, ax: Any = None) -> NDArray[Any]:
    """Phase plot: rate of the true error over the true error, one panel per joint; a limit cycle
    shows as a ring.
    """
    _require_evaluation("evaluation", evaluation)
    record = evaluation.record
    error = evaluation.true_error_pulses
    rate = np.gradient(error, record.rig.period * len(record) / len(error), axis=0)

    def new() -> Any:
        import matplotlib.pyplot as plt

        columns = min(record.n, _PHASES)
        rows = -(-record.n // columns)
        size = (4.5 * columns, 4 * rows)
        made = plt.subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")[1]
        for axis in made.flat[record.n :]:
            axis.remove()
        return made.flat[: record.n]

    axes = axes_of(ax, (record.n,), new)
    for joint, axis in enumerate(axes):
        dressed(axis, evaluation.joint_labels[joint], 10)
        axis.axvspan(-1, 1, color=BAND, zorder=0)
        axis.plot(error[:, joint], rate[:, joint], color=colour_of(joint), linewidth=0.5, alpha=0.8)
        axis.plot(error[0, joint], rate[0, joint], "o", color="0.2", markersize=4, label="start")
        reach = 1.1 * max(np.abs(error[:, joint]).max(), 2.0)
        axis.set(xlim=(-reach, reach), xlabel="true error [pulses]; shaded: ±1 pulse")
        axis.set_ylabel("rate of the error [pulses/s]")
    legend_above(axes[0])
    return axes


@literal
def plot_comparison(evaluations: dict[str, Any], ax: Any = None) -> NDArray[Any]:
    """Tracking errors of several controllers on the same arm."""
    if not isinstance(evaluations, dict) or not evaluations:
        given = f"{evaluations!r:.40}" if evaluations else "none"
        raise ValueError(
            f"evaluations must be a dict, one per controller; got {given}. Pass {{name:"
            " evaluate(...)}."
        )
    for name, evaluation in evaluations.items():
        _require_evaluation(f"evaluation {name!r}", evaluation)
    n = next(iter(evaluations.values())).record.n
    laws = len(evaluations)
    if abreast := laws <= _ABREAST:
        drawn = axes = row_by_row(ax, n, laws, width=5.2 * laws)
    else:
        drawn = row_by_row(ax, laws, n, width=min(5.2 * n, _WIDEST), height=1.5)
        axes = drawn.T
    for column, (name, evaluation) in enumerate(evaluations.items()):
        record = evaluation.record
        for joint, axis in enumerate(axes[:, column]):
            _pulses(axis, record.t, record.error_pulses[:, joint], colour_of(joint))
            draw_band(axis)
            axis.set_ylabel("error [pulses]" if (column if abreast else joint) == 0 else "")
            if not abreast and column == laws - 1:
                axis.set_xlabel(f"{evaluation.joint_labels[joint]}\ntime [s]")
        head = f"{name}: {evaluation.share_within(1)} within ±1 pulse (shaded)"
        if abreast:
            titled(axes[:, column], head, evaluation.joint_labels if column == 0 else ())
        else:
            dressed(axes[0, column], head, 10)
    if abreast:
        equal_rows(axes)
    return drawn


@literal
def plot_record(
    record: Record,
    joints: Sequence[str] = (),
    *,
    models: tuple[Sequence[Record], Record] | None = None,
    ax: Any = None,
) -> NDArray[Any]:
    """Tracking error and motor current of every joint, or the errors beside those of models.
    Source: paper Figs. 6-15.

    Parameters
    ----------
    record : Record
    joints : sequence of str, optional
        Names of the joints; by default those of the rig's drive.
    models : (sequence of Record, Record), optional
        What models of the initial population give, the best first and the others thin; and the best
        of the last one.
    ax : (n, 2) array of matplotlib Axes, optional
        Where to draw, (n, 1) of a record without currents; a new figure by default.

    Returns
    -------
    numpy.ndarray of matplotlib Axes
        Of the same shape.

    Raises
    ------
    ValueError
        Another number of Axes.

    See Also
    --------
    plant.Record, identification.Identification

    Examples
    --------
    >>> from plant import puma560, replay, simulate
    >>> from ctc import plot_record
    >>> record = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference(), duration=0.5)
    >>> drawn = plot_record(record)
    >>> beside = plot_record(record, models=([replay(puma560.literature_arm(1.5), record)], record))
    """
    labels = joint_labels(joints or record.rig.drive.joints, record.n)
    if models is not None:
        return _beside(record, *models, labels, ax)
    current = record.current
    columns = 1 if current is None else 2
    axes = row_by_row(ax, record.n, columns, width=5.5 * columns)
    for joint, row in enumerate(axes):
        row[0].plot(record.t, record.error_pulses[:, joint], color=colour_of(joint), linewidth=0.7)
        row[0].set_ylabel("error [pulses]")
        if current is not None:
            row[1].plot(record.t, current[:, joint], color=colour_of(joint), linewidth=0.7)
            row[1].set_ylabel("current [A]")
    titles = ("tracking error (paper: Figs. 6, 7)", "motor current (paper: Figs. 8, 9)")
    for column, title, named in zip(axes.T, titles, (labels, ()), strict=False):
        titled(column, title, named)
    return axes


def _beside(
    record: Record, initial: Sequence[Record], best: Record, labels: list[str], ax: Any
) -> NDArray[Any]:
    """Measured tracking errors beside those of models."""
    axes = row_by_row(ax, record.n, 2, width=11)
    titles = (
        "initial population (paper: Figs. 12, 13)",
        "after identification (paper: Figs. 14, 15)",
    )
    (_, robot), (_, thin) = LOGS
    for column, ((model, *others), title) in enumerate(zip((initial, [best]), titles, strict=True)):
        for joint, axis in enumerate(axes[:, column]):
            for i, other in enumerate(others):
                label = f"next {len(others)} models" if i == 0 else None
                axis.plot(
                    other.t,
                    other.error_pulses[:, joint],
                    color=colour_of(5),
                    linewidth=0.5,
                    label=label,
                )
            axis.plot(record.t, record.error_pulses[:, joint], label="robot", **robot)
            axis.plot(model.t, model.error_pulses[:, joint], label="best model", **thin)
            axis.set_ylabel("error [pulses]" if column == 0 else "")
        titled(axes[:, column], title, labels if column == 0 else ())
        axes[0, column].legend(loc="upper right", fontsize=8, ncols=3, frameon=False)
    equal_rows(axes, headroom=1.3)
    return axes

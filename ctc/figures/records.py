"""The paper's Figs. 6-9 and 12-15 redrawn: a record, and what models make of it."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from ctc.figures.errors import equal_rows, titled
from plant import Record
from plant.parts.figures import LOGS, colour_of, literal, row_by_row
from plant.parts.labels import joint_labels


@literal
def plot_record(
    record: Record, joints: Sequence[str] = (), *, models: tuple[Sequence[Record], Record] | None = None, ax: Any = None
) -> NDArray[Any]:
    """Tracking error and motor current of every joint, or the errors beside those of models. Source: paper Figs. 6-15.

    Parameters
    ----------
    record : Record
    joints : sequence of str, optional
        Names of the joints; by default those of the rig's drive.
    models : (sequence of Record, Record), optional
        What models of the initial population give, the best first and the others thin; and the best of the last one.
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


def _beside(record: Record, initial: Sequence[Record], best: Record, labels: list[str], ax: Any) -> NDArray[Any]:
    """Measured tracking errors beside those of models."""
    axes = row_by_row(ax, record.n, 2, width=11)
    titles = ("initial population (paper: Figs. 12, 13)", "after identification (paper: Figs. 14, 15)")
    (_, robot), (_, thin) = LOGS
    for column, ((model, *others), title) in enumerate(zip((initial, [best]), titles, strict=True)):
        for joint, axis in enumerate(axes[:, column]):
            for i, other in enumerate(others):
                label = f"next {len(others)} models" if i == 0 else None
                axis.plot(other.t, other.error_pulses[:, joint], color=colour_of(5), linewidth=0.5, label=label)
            axis.plot(record.t, record.error_pulses[:, joint], label="robot", **robot)
            axis.plot(model.t, model.error_pulses[:, joint], label="best model", **thin)
            axis.set_ylabel("error [pulses]" if column == 0 else "")
        titled(axes[:, column], title, labels if column == 0 else ())
        axes[0, column].legend(loc="upper right", fontsize=8, ncols=3, frameon=False)
    equal_rows(axes, headroom=1.3)
    return axes

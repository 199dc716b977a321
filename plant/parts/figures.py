"""Shared by all figures: axes that a caller may pass, colours, literal texts.

A plot takes ``ax=``, as many matplotlib Axes as it draws, and returns the Axes on which it has
drawn: one, or an array where it draws several. Without ``ax`` it makes a figure of its own.
matplotlib is imported when something is drawn.

All colours of joints except the grey come from M. Okabe, K. Ito, Color universal design, 2008.
Readers with defective colour vision can tell them apart.
"""

import functools
import inspect
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])

# The colours of the joints, or of the laws, in turn.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#4d4d4d")

# The colour of areas shaded behind curves.
BAND = "#e9e4d4"

# The styles of a log and its model: the model's thin curve is drawn on the log's wide one.
LOGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("measured", {"color": "#b3bcc0", "linewidth": 2.6}),
    ("simulated", {"color": COLOURS[1], "linewidth": 0.8}),
)

# The names of the formatters that write numbers at ticks, such as LogFormatter, begin like this.
_NUMBERS = ("Log", "Scalar")


def colour_of(place: int) -> str:
    """Colour of the joint, or law, at this place."""
    return COLOURS[place % len(COLOURS)]


def axes_of(
    ax: Any, shape: tuple[int, ...], new: Callable[[], Any], advice: str = ""
) -> NDArray[Any]:
    """The Axes to draw on, in an array of this shape; the shape () holds one.

    They are the caller's, in their order, or those that `new` makes if `ax` is None. `advice` tells
    the caller how to make suitable Axes. A wrong number of Axes, or another type, is refused.
    """
    axes = np.array(new() if ax is None else ax, dtype=object)
    count = int(np.prod(shape))
    # Duck typing: matplotlib need not be imported for the check.
    if axes.size == count and all(hasattr(axis, "get_xlim") for axis in axes.flat):
        return axes.reshape(shape)
    # The message shows the call that makes suitable Axes.
    recipe = advice or f"Make them by plt.subplots({', '.join(map(str, shape))})"
    wanted = f"{count} matplotlib Axes" if shape else "a matplotlib Axes"
    got = (
        f"{axes.size}"
        if all(hasattr(axis, "get_xlim") for axis in axes.flat)
        else f"{type(ax).__name__}"
    )
    raise ValueError(f"ax must be {wanted}; got {got}. {recipe}, or leave ax out.")


def row_by_row(
    ax: Any, rows: int, columns: int, *, width: float = 9.0, height: float = 2.3, time: bool = True
) -> NDArray[Any]:
    """Axes (rows, columns) with grids; without `ax` a new figure. With `time` the x axis is time.

    `width` of the figure and `height` of a row are in inches.
    """

    def new() -> Any:
        # Imported here, since the import is slow and many users never draw.
        import matplotlib.pyplot as plt

        size = (width, height * rows)
        return plt.subplots(
            rows, columns, figsize=size, sharex=time, squeeze=False, layout="constrained"
        )[1]

    axes = axes_of(ax, (rows, columns), new)
    for axis in axes.flat:
        dressed(axis)
    # The rows of a new figure share the time axis, so only the lowest row is labelled.
    for axis in axes[-1] if time else ():
        axis.set_xlabel("time [s]")
    return axes


def dressed(axis: Any, title: str = "", size: float = 9) -> Any:
    """Add a grid to the axis, hide its top and right borders, set its title at the left."""
    # A polar axis has other borders.
    for side in ("top", "right"):
        if side in axis.spines:
            axis.spines[side].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.5)
    # The grid lies behind bars and curves.
    axis.set_axisbelow(True)
    if title:
        axis.set_title(title, fontsize=size, loc="left")
    return axis


def legend_above(axis: Any, *, at_left: bool = False, columns: int = 2) -> None:
    """A legend above the axis, clear of the curves; `at_left` suits an axis without a title."""
    side, x = ("lower left", 0) if at_left else ("lower right", 1)
    axis.legend(
        loc=side,
        bbox_to_anchor=(x, 1),
        borderaxespad=0.1,
        frameon=False,
        fontsize=8,
        ncols=columns,
        handlelength=1.2,
        columnspacing=1.2,
    )


def literal(plot: F) -> F:
    """Decorate a plot so that its texts are not set as formulas: a joint may be named ``$x_{$``.

    Numbers at the ticks of the returned Axes keep their formulas, such as ``$10^{-3}$``. If the
    caller passed ``ax=``, only the texts of the returned Axes change.
    """
    signature = inspect.signature(plot)

    @functools.wraps(plot)
    def drawn(*args: Any, **kwargs: Any) -> Any:
        drawn_axes = plot(*args, **kwargs)
        axes = [*np.array(drawn_axes, dtype=object).flat]
        # 1. Collect the labels of ticks that are numbers: "$10^{-3}$" must stay mathematics.
        numbers = set[int]()
        for plot_axes in axes:
            for name in ("xaxis", "yaxis", "zaxis"):
                axis = getattr(plot_axes, name, None)  # only axes in space have a zaxis
                if axis is None:
                    continue
                formatter = type(axis.get_major_formatter()).__name__
                if formatter.startswith(_NUMBERS):
                    numbers.update(map(id, axis.get_majorticklabels()))
                    numbers.update(map(id, axis.get_minorticklabels()))
                    # The power of ten that all of them share.
                    numbers.add(id(axis.get_offset_text()))
        # 2. Switch mathematics off in all other texts. A figure made here belongs to the plot as a
        # whole, with its title; a figure of the caller keeps the texts of its other Axes.
        by_caller = signature.bind(*args, **kwargs).arguments.get("ax") is not None
        artists: Sequence[Any] = axes if by_caller else [axes[0].figure]
        for parent in artists:
            for text in parent.findobj(lambda artist: hasattr(artist, "set_parse_math")):
                if id(text) not in numbers:
                    text.set_parse_math(False)
        return drawn_axes

    return drawn  # type: ignore[return-value]  # has the signature of what it wraps

"""The one name of a joint in messages, tables and figures: the robot's own, with its place in q beside it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

__all__ = ["joint_label", "joint_labels", "literal"]

F = TypeVar("F", bound=Callable[..., Any])

_NUMBERS = ("Log", "Scalar")
"""How the names of the formatters begin that write numbers at ticks."""


def joint_label(names: Sequence[str], joint: int) -> str:
    """Label of a joint by its place from 0: ``joint 2 (q[0])``, ``elbow_joint (q[2])``; ``joint q[0]`` if unnamed.

    See Also
    --------
    plant.joint_labels

    Examples
    --------
    >>> from plant import joint_label
    >>> joint_label(("shoulder", "elbow"), 1)
    'joint elbow (q[1])'
    """
    if not names:
        return f"joint q[{joint}]"
    return f"{'' if 'joint' in names[joint].lower() else 'joint '}{names[joint]} (q[{joint}])"


def joint_labels(names: Sequence[str], n: int) -> list[str]:
    """Labels of all n joints.

    See Also
    --------
    plant.joint_label

    Examples
    --------
    >>> from plant import joint_labels
    >>> joint_labels((), 2)
    ['joint q[0]', 'joint q[1]']
    """
    return [joint_label(names, joint) for joint in range(n)]


def literal(plot: F) -> F:
    """Decorate what draws a figure: texts in it are taken as they are, so a robot may call a joint ``$x_{$``.

    Numbers at ticks keep their mathematics.
    """

    @functools.wraps(plot)
    def drawn(*args: Any, **kwargs: Any) -> Any:
        figure, numbers = plot(*args, **kwargs), set[int]()
        for axes in figure.axes:
            for axis in (getattr(axes, name, None) for name in ("xaxis", "yaxis", "zaxis")):
                if axis is not None and type(axis.get_major_formatter()).__name__.startswith(_NUMBERS):
                    numbers.update(map(id, (*axis.get_majorticklabels(), *axis.get_minorticklabels())))
        for text in figure.findobj(lambda artist: hasattr(artist, "set_parse_math")):
            if id(text) not in numbers:
                text.set_parse_math(False)
        return figure

    return drawn  # type: ignore[return-value]  # has the signature of what it wraps

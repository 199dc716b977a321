"""Messages to the user: warnings at the caller's line, progress bars, labels of joints."""

import sys
import warnings
from collections.abc import Sequence
from typing import Any

from tqdm import tqdm

_OURS = ("plant", "identification", "ctc")


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called these packages, through however many of their functions."""
    frame = sys._getframe()
    level = 1
    # Step up to the first frame outside these packages; `stacklevel` counts from this function.
    while (
        frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OURS
    ):
        frame = frame.f_back
        level += 1
    warnings.warn(text, category, stacklevel=level)


def progress_bar(total: int | None, label: str, unit: str, shown: bool) -> Any:
    """A bar on standard error, to use in a ``with`` statement; it is gone when the work is done.

    Where standard error is a file or a pipe there is none, shown or not.
    """
    # `disable=None` lets tqdm find out whether standard error is a terminal.
    return tqdm(total=total, desc=label, unit=unit, disable=None if shown else True, leave=False)


def joint_label(names: Sequence[str], joint: int) -> str:
    """Label of a joint by its index: ``joint 2 (q[0])``, ``elbow_joint (q[2])``, ``joint q[0]``."""
    if not names:
        return f"joint q[{joint}]"
    # "joint elbow_joint" would say the word twice.
    return f"{'' if 'joint' in names[joint].lower() else 'joint '}{names[joint]} (q[{joint}])"


def joint_labels(names: Sequence[str], n: int) -> list[str]:
    """Labels of all n joints."""
    return [joint_label(names, joint) for joint in range(n)]

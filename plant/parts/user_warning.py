"""Warnings that point at the user's own line."""

import sys
import warnings

_OURS = ("plant", "identification", "ctc")


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the line that called these packages, through however many of their functions."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _OURS:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, category, stacklevel=level)

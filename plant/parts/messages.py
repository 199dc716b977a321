"""Messages to the user: warnings at the caller's line, progress bars, labels of joints."""

import contextlib
import contextvars
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeAlias

from tqdm import tqdm

Say: TypeAlias = Callable[[str], Any]

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


class ProgressBar:
    """A progress bar, or a part of the bar around it; progress counts from 0 to `total`."""

    def __init__(self, total: float | None, advance: Callable[[float], Any], say: Say) -> None:
        self.n = 0.0
        self.total = total
        self._advance = advance
        self._say = say

    def update(self, count: float = 1) -> None:
        """Count finished work; work beyond the total moves nothing."""
        self.move_to(self.n + count)

    def move_to(self, n: float) -> None:
        """Progress that was reached; a bar does not go back."""
        if self.total is not None:
            n = min(n, self.total)
        moved = max(n - self.n, 0.0)
        self.n += moved
        self._advance(moved)

    def set_postfix_str(self, text: str) -> None:
        """A text behind the time left."""
        self._say(text)

    def print(self, text: str) -> None:
        """A line above the bar on standard error, also where that is a file or a pipe."""
        tqdm.write(text, file=sys.stderr)

    @contextlib.contextmanager
    def part(self, count: float, text: str = "") -> Iterator[None]:
        """A context for `count` of the work: bars inside it move this bar by so much together."""
        end = self.n + count
        if text:
            self._say(text)
        token = _AROUND.set((self, count))
        try:
            yield
        finally:
            _AROUND.reset(token)
        # Work of unknown length may have no bar, or one that ended early.
        self.move_to(end)


# The bar around, and how much of it the next one stands for.
_AROUND: contextvars.ContextVar[tuple[ProgressBar, float] | None] = contextvars.ContextVar(
    "around", default=None
)


@contextlib.contextmanager
def _outermost() -> Iterator[None]:
    """A context in which bars move no other bar, unless in a part of theirs."""
    token = _AROUND.set(None)
    try:
        yield
    finally:
        _AROUND.reset(token)


# A bar that moves evenly in its work may wait long for the first of few steps: without digits of
# the count, and with the time left from the mean rate.
_FORMAT = "{desc}: {percentage:3.0f} %|{bar}| {elapsed}, {remaining} left{postfix}"


@contextlib.contextmanager
def progress_bar(total: float | None, label: str, unit: str, shown: bool) -> Iterator[ProgressBar]:
    """A bar with the time left on standard error; it is gone when the work is done.

    Where standard error is a file or a pipe there is none, shown or not. Inside a part of another
    bar it moves that one.
    """
    around = _AROUND.get()
    if around is not None and total:
        bar, share = around
        # Several bars may follow each other inside one part: its end limits them all.
        end = bar.n + share
        moved = ProgressBar(
            total,
            lambda count: bar.move_to(min(bar.n + count * share / total, end)),
            bar.set_postfix_str,
        )
        with _outermost():
            yield moved
        return
    # `disable=None` lets tqdm find out whether standard error is a terminal.
    options: dict[str, Any] = {"disable": None if shown else True, "leave": False, "unit": unit}
    if total is not None:
        # Of unequal steps the mean rate tells more than that of the last one.
        options |= {"bar_format": _FORMAT, "smoothing": 0, "miniters": 0}
    with tqdm(total=total, desc=label, **options) as drawn, _outermost():
        yield ProgressBar(total, drawn.update, drawn.set_postfix_str)


class JointUnits(NamedTuple):
    """Units of a joint in tables and messages: `TURNS` or `SLIDES`."""

    position: str
    effort: str
    stiffness: str
    damping: str
    inertia: str

    @property
    def speed(self) -> str:
        """Of its rate."""
        return f"{self.position}/s"


TURNS = JointUnits("rad", "N m", "N m/rad", "N m s/rad", "kg m^2")
SLIDES = JointUnits("m", "N", "N/m", "N s/m", "kg")


def joint_label(names: Sequence[str], joint: int) -> str:
    """Label of a joint by its index: ``joint 2 (q[0])``, ``elbow_joint (q[2])``, ``joint q[0]``."""
    if not names:
        return f"joint q[{joint}]"
    # "joint elbow_joint" would say the word twice.
    return f"{'' if 'joint' in names[joint].lower() else 'joint '}{names[joint]} (q[{joint}])"


def joint_labels(names: Sequence[str], n: int) -> list[str]:
    """Labels of all n joints."""
    return [joint_label(names, joint) for joint in range(n)]

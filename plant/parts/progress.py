"""Progress bars: on a terminal, and nowhere else, so that no log file fills with them."""

from typing import Any

from tqdm import tqdm


def progress_bar(total: int | None, label: str, unit: str, shown: bool) -> Any:
    """A bar on standard error, to use in a ``with`` statement; it is gone when the work is done.

    Where standard error is a file or a pipe there is none, shown or not.
    """
    return tqdm(total=total, desc=label, unit=unit, disable=None if shown else True, leave=False)

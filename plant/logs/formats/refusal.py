"""What every reader refuses in the same words."""

from collections.abc import Callable, Collection


class RefusalError(ValueError):
    """A message that is complete: what was expected, what came, what to do; without the path."""


def choice_of(names: Collection[str] | None, prefix: str) -> Callable[[str], bool]:
    """Whether a column is wanted: one of these names, or, without names, all that start with the prefix."""
    return (lambda name: name.startswith(prefix)) if names is None else set(names).__contains__


def require_size(size: int, most: int) -> None:
    """Refuse columns of more than `most` bytes.

    Raises
    ------
    RefusalError
    """
    if size > most:
        raise RefusalError(
            f"must hold at most {most >> 20} MiB; it declares {size >> 20}. Cut the log into several files."
        )

"""Blocks of columns, and elements of them: ``block``, ``block[2]``, ``block.elbow``."""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple


class RefusalError(ValueError):
    """A message that is complete: what was expected, what came, what to do; without the path."""


def choice_of(names: Collection[str] | None, prefix: str) -> Callable[[str], bool]:
    """Predicate of the wanted columns: these names, or else all that start with the prefix."""
    # Without names the prefix chooses; the parent has put the prefix before each given name.
    return (lambda name: name.startswith(prefix)) if names is None else set(names).__contains__


def require_size(size: int, max_bytes: int) -> None:
    """Refuse columns of more than `max_bytes`."""
    if size > max_bytes:
        declared = f"it declares {size >> 20}"
        raise RefusalError(
            f"must hold at most {max_bytes >> 20} MiB; {declared}. Cut the log into several files."
        )


def require_real(name: str, kind: Any, sound: bool) -> None:
    """Refuse a column whose kind is no sound one: no real numbers."""
    if not sound:
        raise RefusalError(
            f"must hold real numbers; got {kind} in column {name!r}. Leave it out with names=."
        )


class Block(NamedTuple):
    """Columns (N,) or (N, k), and what each of the k is called, where they have names."""

    values: Any
    labels: tuple[str, ...] = ()

    def elements(self, name: str) -> Iterator[str]:
        """Names of the block's columns, of a block that is called `name`."""
        # Elements have names or numbers, never both: a message would offer each column twice.
        if self.values.ndim == 2:
            yield from (f"{name}.{label}" for label in self.labels)
            yield from (
                f"{name}[{i}]" for i in range(self.values.shape[1] if not self.labels else 0)
            )


def home_of(wanted: str, names: Iterable[str]) -> str | None:
    """The longest name of a block that `wanted` equals, or of which it is an element."""
    # Names may contain dots and brackets themselves, so the longest match is the block.
    return max(
        (name for name in names if wanted == name or wanted.startswith((f"{name}.", f"{name}["))),
        key=len,
        default=None,
    )


def picked(wanted: str, blocks: Mapping[str, Block]) -> Any:
    """A block (N, k), or one of its columns (N,); None where there is none of that name."""
    name = home_of(wanted, blocks)
    if name is None:
        return None
    block = blocks[name]
    rest = wanted[len(name) :]
    if not rest:
        return block.values
    if block.values.ndim != 2:
        return None
    # A label may hold any character, so it is compared as a whole and not parsed.
    if rest[1:] in block.labels and rest[0] == ".":
        return block.values[:, block.labels.index(rest[1:])]
    # At most 9 digits: int() of a long text of digits is slow.
    index = re.fullmatch(r"\[(\d{1,9})\]", rest)
    return (
        block.values[:, int(index[1])] if index and int(index[1]) < block.values.shape[1] else None
    )

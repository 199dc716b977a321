"""What keeps old names and old orders of arguments working for one release, with a DeprecationWarning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["Renamed", "install", "old_option", "old_order", "warn_renamed"]

F = TypeVar("F", bound=Callable[..., Any])


def warn_renamed(old: str, new: str, *, stacklevel: int = 3) -> None:
    """Say that a name is on its way out, and what to write instead."""
    warnings.warn(f"{old} will go in the next release. Use {new}.", DeprecationWarning, stacklevel=stacklevel)


class Renamed:
    """An attribute or a method under its old name: ``Renamed("to_angle")``.

    Parameters
    ----------
    new : str
        Name, or path of names, of what is there now.
    """

    def __init__(self, new: str) -> None:
        self.new = new

    def __set_name__(self, owner: type, name: str) -> None:
        self.old = name

    def __get__(self, thing: Any, owner: type) -> Any:
        if thing is None:
            return self
        warn_renamed(f"{owner.__name__}.{self.old}", f"{owner.__name__}.{self.new}")
        return functools.reduce(getattr, self.new.split("."), thing)


def install(owner: type, **names: str) -> None:
    """Give a class its old names: old=new."""
    for old, new in names.items():
        renamed = Renamed(new)
        renamed.__set_name__(owner, old)
        setattr(owner, old, renamed)


def old_order(*names: str, first: type, new: str, **absent: Any) -> Callable[[F], F]:
    """Decorate a function whose positional arguments had another order, `names`; then a `first` comes first.

    `absent` are arguments that could be left out, with what they were then.
    """

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def wrapper(*arguments: Any, **options: Any) -> Any:
            if arguments:
                old = len(arguments) <= len(names) and isinstance(arguments[0], first)
            else:
                old = not absent.keys() <= options.keys()
            if not old:
                return function(*arguments, **options)
            warn_renamed(f"{function.__name__}({', '.join(names)})", new)
            return function(**dict(zip(names, arguments, strict=False)), **(absent | options))

        return wrapper  # type: ignore[return-value]  # users see the function that is decorated

    return decorate


def old_option(old: str, new: str) -> Callable[[F], F]:
    """Decorate a function whose option had another name."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def wrapper(*arguments: Any, **options: Any) -> Any:
            if old in options:
                warn_renamed(f"{function.__name__}({old}=)", f"{function.__name__}({new}=)")
                options[new] = options.pop(old)
            return function(*arguments, **options)

        return wrapper  # type: ignore[return-value]  # users see the function that is decorated

    return decorate

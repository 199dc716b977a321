"""What to call parameters in tables and figures."""

from __future__ import annotations

from collections.abc import Iterable

from plant import Dynamics

__all__ = ["short_names"]


def short_names(dynamics: Dynamics, names: Iterable[str]) -> tuple[str, ...]:
    """The same names with those of f short (`Dynamics.short_names`); `Dynamics.legend` says what they mean."""
    short = dict(zip(dynamics.names, dynamics.short_names, strict=True))
    return tuple(short.get(name, name) for name in names)

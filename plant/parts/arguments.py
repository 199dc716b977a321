"""Checks of arguments: every message says the expected value, the received one, and a remedy."""

import dataclasses
import difflib
import functools
import inspect
import math
import numbers
import typing
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from plant.parts.fields import Floats
from plant.parts.one_thread import one_thread

T = TypeVar("T")
C = TypeVar("C", bound=Callable[..., Any])

_UNSOLVED = "needs equations with one solution"


def array(
    name: str,
    value: ArrayLike,
    shape: tuple[int | str | None, ...],
    *,
    advice: str,
    finite: bool = True,
    shared: bool = False,
) -> Floats:
    """`value` as a new float64 array of exactly this shape, or a refusal in one line.

    A string or None in the shape stands for any length; `advice` is the last part of the message,
    what to do instead. `shared`: an array that cannot be written to is not copied.
    """
    # A view of writable memory could change behind our back, so only an array that owns its data
    # and cannot be written to is shared.
    frozen = (
        shared
        and isinstance(value, np.ndarray)
        and value.flags.owndata
        and not value.flags.writeable
    )
    expected = (
        "("
        + ", ".join("any" if s is None else str(s) for s in shape)
        + ("," if len(shape) == 1 else "")
        + ")"
    )
    try:
        # Otherwise a copy: the caller may go on to change his array.
        result = np.asarray(value, dtype=float) if frozen else np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(
            f"{name} must be numbers of shape {expected}; got {value!r:.80}. {advice}"
        ) from None
    matches = result.ndim == len(shape) and all(
        not isinstance(s, int) or s == got for s, got in zip(shape, result.shape, strict=True)
    )
    # Samples and joints exchanged is the most common mistake; a square array cannot show it.
    if not matches and result.ndim == len(shape) == 2 and result.T.shape == shape != result.shape:
        advice = f"It lies on its side: give its transpose (.T). {advice}"
    if not matches:
        # A number in place of a list is told by itself, since its shape says little.
        number = "" if result.ndim else f", {value!r:.80}"
        raise ValueError(
            f"{name} must have shape {expected}; got shape {result.shape}{number}. {advice}"
        )
    if finite and not np.isfinite(result).all():
        # One index is enough: the message must stay one line for a log of any length.
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(result))[0])
        where = f" at index {index[0] if len(index) == 1 else index}" if index else ""
        raise ValueError(f"{name} must be finite; got {result[index]}{where}. {advice}")
    return result


def joint_numbers(name: str, value: Any, n: int, *, finite: bool = False) -> Any:
    """Numbers of n joints in their last axis, as an array; casadi symbols remain as they are."""
    if isinstance(value, (ca.SX, ca.MX, ca.DM)):
        return value
    shape = np.shape(value)
    return array(name, value, (*shape[:-1], n), advice="Give one number per joint.", finite=finite)


def choice(name: str, value: T, allowed: Collection[T]) -> T:
    """Return `value` if it is one of `allowed`, or refuse it and offer the nearest."""
    if value in allowed:
        return value
    # The right text but the wrong type, such as "2" for 2, needs another hint than a misspelling.
    texts = {str(option): option for option in allowed}
    same = texts.get(str(value))
    # Which of several is meant is not known.
    only = f"Write {next(iter(allowed))!r}." if len(allowed) == 1 else "Take one of these."
    hint = near(value, allowed, only) if same is None else f"Write {same!r}."
    raise ValueError(
        f"{name} must be one of {several(repr(a) for a in allowed)}; got {value!r}. {hint}"
    )


def several(names: Iterable[str], limit: int = 20) -> str:
    """Names separated by commas; beyond `limit` of them, only how many remain."""
    texts = list(names)
    return ", ".join(texts[:limit]) + (
        f" and {len(texts) - limit} more" if len(texts) > limit else ""
    )


def near(value: Any, candidates: Iterable[Any], otherwise: str = "", *, cutoff: float = 0.4) -> str:
    """Last part of a message: the most similar candidate, or `otherwise` where none is similar."""
    matches = difflib.get_close_matches(
        str(value), [str(candidate) for candidate in candidates], n=1, cutoff=cutoff
    )
    return f"Did you mean {matches[0]!r}?" if matches else otherwise


def instance(name: str, value: T, kind: type[Any], advice: str) -> T:
    """Return `value` if it is a `kind`, or refuse it."""
    if isinstance(value, kind):
        return value
    received = (
        f"the class {value.__name__}"
        if inspect.isclass(value)
        else f"a value of type {type(value).__name__}"
    )
    raise ValueError(f"{name} must be of type {kind.__name__}; got {received}. {advice}")


def real(name: str, value: Any, advice: str, *, positive: bool = False) -> float:
    """Return `value` as a float if it is one finite number, positive if `positive`."""
    # True is a Real number in Python, but never meant as a quantity.
    sound = isinstance(value, numbers.Real) and not isinstance(value, bool) and math.isfinite(value)
    if sound and (value > 0 or not positive):
        return float(value)
    raise ValueError(
        f"{name} must be a {'positive' if positive else 'finite'} number; got {value!r:.60}."
        f" {advice}"
    )


def whole(name: str, value: Any, advice: str, *, least: int = 1) -> int:
    """Return `value` if it is a whole number of at least `least`, or refuse it."""
    # True is an int in Python, but never meant as a count.
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and value >= least:
        return int(value)
    raise ValueError(
        f"{name} must be a whole number of at least {least}; got {value!r:.60}. {advice}"
    )


_MAGNITUDES = "Gains and poles are magnitudes; the sign of the gear is in the drive."


def signs(
    owner: object,
    *,
    positive: Iterable[str] = (),
    not_negative: Iterable[str] = (),
    advice: str = _MAGNITUDES,
    labels: Sequence[str] = (),
) -> None:
    """Refuse a part if one of these numbers, or an entry of one, has the wrong sign; None passes.

    With `labels` of the joints the message names the joint.
    """
    for names, sound, rule in (
        (positive, np.greater, "be positive"),
        (not_negative, np.greater_equal, "not be negative"),
    ):
        # argmin of the comparison is the first entry that fails it.
        for name in names:
            value: Any = getattr(owner, name)
            if value is not None and not (right := sound(value, 0)).all():
                got = f"{value[right.argmin()]} at {labels[right.argmin()]}" if labels else value
                raise ValueError(f"{name} must {rule}; got {got}. {advice}")


def decimal(text: str) -> float:
    """A number in a file: ASCII digits without underscores; ``nan`` and ``inf`` are numbers too."""
    # `float` itself accepts 1_000 and digits of other scripts, which in a file are damage.
    if "_" in text or not text.isascii():
        raise ValueError(
            f"a number must have digits 0 to 9 alone; got {text!r:.40}. Write it like 17.4 or 1e-3."
        )
    return float(text)


def optional_period(law: Any) -> None:
    """Keep the period of a law as a float, or None for fast hardware; refuse anything else."""
    if law.period is not None:
        advice = "Give seconds, such as rig.period; leave it out for fast hardware."
        object.__setattr__(law, "period", real("period", law.period, advice, positive=True))


def known_options(callable_: C) -> C:
    """Decorate a function or class: wrong options are a ValueError that offers the nearest name."""
    signature = inspect.signature(callable_)
    # With **kwargs any misspelled option would bind, so there would be nothing to check.
    if any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values()):
        raise ValueError(
            f"{callable_} takes any keyword; known_options needs named ones. Name them."
        )
    keywords = [
        k
        for k, p in signature.parameters.items()
        if p.kind is not p.POSITIONAL_ONLY and k not in ("self", "cls")
    ]

    # Options whose annotation is a union with a dataclass, such as settings or None: a field of the
    # dataclass may be passed to the function itself by mistake.
    kinds = [
        (k, kind) for k, p in signature.parameters.items() for kind in typing.get_args(p.annotation)
    ]
    parts = [(name, kind) for name, kind in kinds if dataclasses.is_dataclass(kind)]

    def verify(args, kwargs):
        for key in kwargs:
            # An unknown option gets a better message than Python's: the settings class that has it,
            # or the most similar name.
            if key not in signature.parameters:
                if not keywords:
                    raise ValueError(
                        f"{callable_.__name__} has no options; got {key!r}. Leave it out."
                    )
                for name, kind in parts:
                    if key in {field.name for field in dataclasses.fields(kind)}:
                        give = f"Give {name}={kind.__name__}({key}=...)."
                        raise ValueError(
                            f"{callable_.__name__} takes {key} by its {kind.__name__}; got {key}=."
                            f" {give}"
                        )
                choice(f"an option of {callable_.__name__}", key, keywords)
        # Missing, doubled and surplus positional arguments are left to Python's own rules.
        try:
            signature.bind(*args, **kwargs)
        except TypeError as error:
            takes = f"{callable_.__name__} takes ({', '.join(keywords)})"
            # Python's own words: "missing a required argument: 'name'".
            advice = "Give it" if str(error).startswith("missing") else "Name the arguments"
            raise ValueError(f"{takes}; this call does not fit: {error}. {advice}.") from None

    is_class = inspect.isclass(callable_)
    # A class stays a class, for isinstance and inheritance: only its __init__ is wrapped.
    wrapped = callable_.__init__ if is_class else callable_

    @functools.wraps(wrapped)
    def wrapper(*args, **kwargs):
        verify(args[is_class:], kwargs)  # without self
        try:
            with one_thread:
                return wrapped(*args, **kwargs)
        except np.linalg.LinAlgError as error:
            # A nested call has been explained already by the innermost function.
            if _UNSOLVED in str(error):
                raise
            cause = f"{callable_.__name__} {_UNSOLVED}; they have none or many ({error})"
            raise np.linalg.LinAlgError(
                f"{cause}. Look for a joint that hardly moves, or a column of zeros."
            ) from error

    if not is_class:
        return wrapper  # type: ignore[return-value]  # has the signature of what it wraps
    callable_.__init__ = wrapper  # type: ignore[method-assign]  # of whatever class
    return callable_

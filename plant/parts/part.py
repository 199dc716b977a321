"""A part of an experiment: a frozen description made of numbers and structure.

Arms, rigs, drives, encoders, laws and references are parts. The *numbers* of a part (gear ratios,
friction, gains, f1..f9) can be listed by name, replaced by casadi symbols, or declared unknown; its
*structure* (joints, periods, flags) is fixed once a model has been built from it. A part can be
written as kind + fields and rebuilt from that; it can be copied, and sent to another process.
"""

import dataclasses
import functools
import json
import numbers
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Self, TypeVar, dataclass_transform

import casadi as ca
import numpy as np

from plant.parts.arguments import array, choice, instance, known_options, real
from plant.parts.fields import ArrayOrSymbols, Floats
from plant.parts.frozen import Frozen
from plant.parts.kinds import PARTS, kind_of
from plant.parts.saved import Saved

T = TypeVar("T", bound="Part")


class Declared:
    """An attribute that a subclass must give, as a class attribute, a property or a field."""

    __isabstractmethod__ = True

    def __init__(self, meaning: str) -> None:
        self.__doc__ = meaning


def declared(meaning: str) -> Any:
    """Declare an attribute that a subclass must define, like an abstract method."""
    return Declared(meaning)


def number(
    shape: tuple[int | str, ...],
    *,
    default: Any = dataclasses.MISSING,
    finite: bool = True,
    alike: bool = False,
) -> Any:
    """Declare a field of numbers: `shape` is () for one number or ("n",) for one per joint.

    Any name in `shape` stands for a length, which is the same in all fields of the part. A field
    with `default` None may be left out; it then adds no number to the part. One number given for
    ("n",) is repeated for each joint if another field of the part tells how many joints there are;
    if `alike`, it stays one number.

    See Also
    --------
    plant.part, plant.structure

    Examples
    --------
    >>> from plant import StatelessLaw, number, part
    >>> @part
    ... class Constant(StatelessLaw):
    ...     level: object = number(("n",))
    ...     def equations(self, rig, state, setpoint, pulses, torque, dt):
    ...         return self.level, state
    ...
    >>> Constant(level=(1.0, 2.0)).level
    array([1., 2.])
    """
    # The names of numbers have one index.
    if len(shape) > 1:
        raise ValueError(
            f"shape must be () or one length; got {shape!r:.60}. Declare a matrix as structure."
        )
    return dataclasses.field(
        default=default, metadata={"number": shape, "finite": finite, "alike": alike}
    )


def structure(
    kind: type | None = None,
    *,
    default: Any = dataclasses.MISSING,
    kw_only: bool = True,
    several: bool = False,
    choices: tuple[Any, ...] = (),
) -> Any:
    """Declare a field that is structure: it decides the equations, so it cannot be unknown.

    With a `kind` (a type; float for one finite number) any other value is refused, but None
    passes if it is the default. A field of `several` parts holds a tuple, and the numbers of these
    parts count too: ``springs[0].stiffness[1]``. A field with `choices` takes one of them.

    See Also
    --------
    plant.part, plant.number

    Examples
    --------
    >>> from plant import Part, part, structure
    >>> @part
    ... class Choice(Part):
    ...     measured: bool = structure(bool, default=False)
    ...
    >>> Choice(measured=True)
    Choice(measured=True)
    """
    metadata = {"structure": True, "kind": kind, "several": several, "choices": choices}
    return dataclasses.field(default=default, kw_only=kw_only, metadata=metadata)


class Part(Saved):
    """Base of all parts. Two parts are equal when their descriptions are.

    See Also
    --------
    plant.part, plant.number, plant.structure

    Examples
    --------
    >>> from plant import Part, puma560
    >>> law = puma560.p_law()
    >>> law.save("law.json")
    >>> Part.load("law.json") == law
    True
    """

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]

    def __init__(self, *_: Any, **__: Any) -> None:
        raise ValueError(
            f"{type(self).__name__} must be a dataclass of named fields; it is none. Put @part"
            " above it."
        )

    def __post_init__(self) -> None:
        # An optional number that was left out is no number of the part.
        present = [field for field in dataclasses.fields(self) if "number" in field.metadata]
        present = [
            field
            for field in present
            if getattr(self, field.name) is not None or field.default is not None
        ]
        values = {field.name: getattr(self, field.name) for field in present}
        # A copy gives the number for all joints alike as it is kept, an array without axes.
        for name, value in values.items():
            if isinstance(value, np.ndarray) and value.ndim == 0:
                values[name] = value.item()
        lengths: dict[str, int] = {}
        # Single numbers come last: the arrays before them tell the number of joints to fill.
        for field in sorted(
            present, key=lambda field: isinstance(values[field.name], numbers.Real)
        ):
            shape = field.metadata["number"]
            value = values[field.name]
            # The first field with a named length fixes that length for all others.
            expected = tuple(lengths.get(s, s) for s in shape)
            if shape == ("n",) and isinstance(value, numbers.Real) and not isinstance(value, bool):
                # A number that is alike for all joints stays single, even if their number is known.
                if field.metadata["alike"]:
                    expected = ()
                elif "n" in lengths:
                    value = np.full(lengths["n"], value)
            name = f"{field.name} of {type(self).__name__}"
            advice = f"Give {'one number, or ' if expected == () != shape else ''}{_amount(shape)}."
            value = array(name, value, expected, finite=field.metadata["finite"], advice=advice)
            if shape == ("n",) and not value.size:
                raise ValueError(
                    f"{name} must have shape (n,), of one joint or more; got none. {advice}"
                )
            # Infinity may be allowed (no limit), NaN never.
            if np.isnan(value).any():
                raise ValueError(f"{name} must be numbers; got NaN. Give its value.")
            lengths.update(
                {s: got for s, got in zip(shape, value.shape, strict=False) if isinstance(s, str)}
            )
            # A frozen part whose array could be written to would change its equations and its hash.
            value.setflags(write=False)
            object.__setattr__(self, field.name, value if shape else float(value))

    # -- numbers by name --------------------------------------------------------------------------
    def _leaves(
        self, prefix: str = ""
    ) -> "Iterator[tuple[str, Part, dataclasses.Field[Any], Any]]":
        # The order of the fields is the order of the numbers; `_filled` walks in the same order.
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if "number" in field.metadata and value is not None:
                yield f"{prefix}{field.name}", self, field, value
            elif isinstance(value, Part):
                yield from value._leaves(f"{prefix}{field.name}.")
            elif field.metadata.get("several") and isinstance(value, tuple):
                for i, item in enumerate(value):
                    yield from item._leaves(f"{prefix}{field.name}[{i}].")

    def require_joints(self, n: int, prefix: str = "") -> None:
        """Refuse this part if an array with one number per joint does not have `n` numbers."""
        for name, _, field, value in self._leaves(prefix):
            # A number for all joints alike fits any.
            if field.metadata["number"] == ("n",) and np.ndim(value) and len(value) != n:
                raise ValueError(
                    f"{name} must have {n} joints; got {len(value)}. Give one number per joint."
                )

    def number_names(self, prefix: str = "") -> list[str]:
        """Names of all numbers, in order: ``drive.gear[0]``; a single number has no index."""
        names: list[str] = []
        for name, _, _, value in self._leaves(prefix):
            names += [name] if np.ndim(value) == 0 else [f"{name}[{i}]" for i in range(len(value))]
        return names

    def number_values(self) -> Floats:
        """Values of all numbers, (k,), in the order of `number_names`."""
        return np.concatenate(
            [np.atleast_1d(np.asarray(v, float)) for _, _, _, v in self._leaves()] or [np.empty(0)]
        )

    def numbers(self, prefix: str = "") -> dict[str, float]:
        """Values of all numbers by name."""
        return dict(zip(self.number_names(prefix), self.number_values().tolist(), strict=True))

    def with_numbers(self, vector: ArrayOrSymbols) -> Self:
        """Copy with its numbers from `vector` (k,): floats, or casadi symbols for equations."""
        k = len(self.number_names())
        advice = "Give one for each of number_names()."
        symbolic = isinstance(vector, (ca.SX, ca.MX, ca.DM))
        if not symbolic:
            # The fields know which of them may be infinite.
            vector = array("vector", vector, (k,), advice=advice, finite=False)
        elif vector.numel() != k:
            raise ValueError(f"vector must have {k} symbols; got {vector.numel()}. {advice}")
        # The position is a list, so that parts within parts advance the same counter.
        return self._filled(vector, [0], symbolic)

    def filled(self, values: Mapping[str, float], prefix: str = "") -> Self:
        """Copy with the numbers in `values`, which has names as in `number_names(prefix)`."""
        # Names of other numbers in the mapping are ignored: it may serve several parts.
        changed = [values.get(name, value) for name, value in self.numbers(prefix).items()]
        return self.with_numbers(np.array(changed))

    def _filled(self, vector: ArrayOrSymbols, position: list[int], symbolic: bool) -> Self:
        changes = {}
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if "number" in field.metadata and value is not None:
                count = 1 if np.ndim(value) == 0 else len(value)
                taken = vector[position[0] : position[0] + count]
                changes[field.name] = taken if symbolic or np.ndim(value) else float(taken[0])
                position[0] += count
            elif isinstance(value, Part):
                changes[field.name] = value._filled(vector, position, symbolic)
            elif field.metadata.get("several") and isinstance(value, tuple):
                changes[field.name] = tuple(
                    item._filled(vector, position, symbolic) for item in value
                )
        # Floats pass all checks again. Symbols cannot, so the copy is made without its constructor.
        if not symbolic:
            return dataclasses.replace(self, **changes)
        copy = object.__new__(type(self))
        for field in dataclasses.fields(self):
            object.__setattr__(copy, field.name, changes.get(field.name, getattr(self, field.name)))
        return copy

    def variants(self) -> dict[str, Self]:
        """Copies that differ in one switch or choice, by its text: ``integration='forward'``.

        A switch that is None by default follows from other fields, so it stays.
        """
        others = {}
        for field in dataclasses.fields(self):
            stated = field.metadata.get("kind") is bool and field.default is not None
            switch = (False, True) if stated else ()
            for value in field.metadata.get("choices") or switch:
                if value != getattr(self, field.name):
                    change = {field.name: value}
                    others[f"{field.name}={value!r}"] = dataclasses.replace(self, **change)
        return others

    # -- description ------------------------------------------------------------------------------
    def describe(self) -> dict[str, Any]:
        """Kind and fields as a dictionary that JSON stores without loss; `restore` reads it."""
        fields = {f.name: _plain(getattr(self, f.name)) for f in dataclasses.fields(self)}
        return {"kind": kind_of(type(self)), **fields}

    # -- copies -----------------------------------------------------------------------------------
    def __getstate__(self) -> dict[str, Any]:
        """The fields alone: a copy builds its symbols and compiled functions anew."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}

    # Arrays become read-only again after unpickling.
    __setstate__ = Frozen.__setstate__

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return type(self) is type(other) and self._description == other._description

    def __hash__(self) -> int:
        return self._hash

    @functools.cached_property
    def _description(self) -> dict[str, Any]:
        # Described once: rigs and laws are compared many times while a log is examined.
        return self.describe()

    @functools.cached_property
    def _hash(self) -> int:
        # An object of the user may change: JSON refuses it, so that its part has no hash.
        return hash(json.dumps(_alike(self._description), sort_keys=True))


def _amount(shape: tuple[int | str, ...]) -> str:
    if not shape:
        return "one number"
    if shape[0] == "n":
        return "a list, one number per joint"
    return "a row of numbers" if isinstance(shape[0], str) else f"{shape[0]} numbers"


def _plain(value: Any) -> Any:
    if isinstance(value, Part):
        return value.describe()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return value


def _alike(value: Any) -> Any:
    """Plain data in which equal numbers have the same text: 0.0 and -0.0, or 1 and 1.0."""
    if isinstance(value, dict):
        return {key: _alike(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [_alike(item) for item in value]
    return hash(value) if isinstance(value, numbers.Real) else value


@dataclass_transform(
    frozen_default=True,
    kw_only_default=True,
    eq_default=False,
    field_specifiers=(number, structure),
)
def part(cls: type[T]) -> type[T]:
    """Class decorator: make a frozen, keyword-only dataclass that checks its options.

    Files may name the class from then on.

    Raises
    ------
    ValueError
        A class that lacks what its base declares.

    See Also
    --------
    plant.number, plant.structure, plant.Part

    Examples
    --------
    >>> from plant import Part, number, part
    >>> @part
    ... class Weight(Part):
    ...     mass: float = number(())
    ...
    >>> Weight(mass=2.0)
    Weight(mass=2.0)
    """
    # Check the types of structure before the class's own __post_init__ relies on them.
    complete = cls.__post_init__

    @functools.wraps(complete)
    def __post_init__(self: Any) -> None:
        for field in dataclasses.fields(self):
            kind = field.metadata.get("kind")
            value = getattr(self, field.name)
            name = f"{field.name} of {cls.__name__}"
            if field.metadata.get("choices"):
                choice(name, value, field.metadata["choices"])
            # None passes if it is the default: the field was left out.
            if kind is None or (value is None and field.default is None):
                continue
            if kind is float:
                object.__setattr__(self, field.name, real(name, value, "Give it in SI units."))
            else:
                instance(name, value, kind, f"Give one {kind.__name__}.")
        complete(self)
        # The class's own checks come first: they know which parts the field takes.
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.metadata.get("several") and isinstance(value, (tuple, list)):
                for item in value:
                    instance(f"{field.name} of {cls.__name__}", item, Part, "Give parts alone.")
                # Only the numbers of a tuple count.
                object.__setattr__(self, field.name, tuple(value))

    cls.__post_init__ = __post_init__  # type: ignore[method-assign]  # wrapped
    cls = dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(cls)
    # A declared attribute may be given as a dataclass field, which abc does not see.
    lacking = sorted(
        set(getattr(cls, "__abstractmethods__", ()))
        - {field.name for field in dataclasses.fields(cls)}
    )
    if lacking:
        base = next(b.__name__ for b in cls.__mro__ if lacking[0] in vars(b))
        absent = ", ".join(lacking)
        raise ValueError(
            f"{cls.__name__} must give all that {base} declares; it lacks {absent}. Define it."
        )
    cls.__abstractmethods__ = frozenset()  # type: ignore[attr-defined]  # a declared attribute may be a field
    # From now on files may name this class.
    PARTS[kind_of(cls)] = cls
    return known_options(cls)

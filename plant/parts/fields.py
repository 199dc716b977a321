"""Types of the fields of parts for type checkers; at run time, plain arrays and tuples."""

from typing import TYPE_CHECKING, Any, Generic, Self, TypeAlias, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
Integers: TypeAlias = NDArray[np.intp]

# A numpy array, or a casadi expression of that shape; what comes out is of the kind that went in.
ArrayOrSymbols: TypeAlias = Any

if TYPE_CHECKING:
    T = TypeVar("T")

    class _ArrayLike(Generic[T]):
        @overload
        def __get__(self, part: None, owner: Any) -> Self: ...
        @overload
        def __get__(self, part: object, owner: Any) -> T: ...
        def __get__(self, part: object | None, owner: Any = None) -> Any: ...
        def __set__(self, part: object, value: ArrayLike) -> None: ...

    class Vector(_ArrayLike[Floats]):
        """A field of numbers: anything array-like goes in, a numpy.ndarray comes out."""

    class Nested(_ArrayLike[tuple[Any, ...]]):
        """A field of structural numbers: array-like goes in, nested tuples of floats come out."""

else:
    Vector = np.ndarray
    Nested = tuple

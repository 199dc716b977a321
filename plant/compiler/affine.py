"""Affine arithmetic: what a casadi Function makes of ranges of its inputs, as a bound that holds
for all of them.

A number is value + slopes d + r: its value at the centre, slopes (T, s) along deviations |d_j| <=
size_j, and a remainder |r| <= R of what is not linear in them. Of a smooth operation R is half its
largest second derivative times the square of the deviation (Taylor); the distance of one with kinks
from the nearest line is a deviation of its own, and so is what jumps. Rows (T) are instants. The
rounding of floating-point numbers is not in it.

Source: L. H. de Figueiredo, J. Stolfi, Affine arithmetic: concepts and applications, Numerical
Algorithms 37 (2004).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.compiler.translate import single_assignment

Rows = NDArray[np.float64]
_NONE = np.zeros((1, 0))


class Affine(NamedTuple):
    """Value (T,) or one number, slopes (T, s), remainder (T,) or one number."""

    value: Any
    slopes: Rows = _NONE
    remainder: Any = 0.0

    def times(self, by: Any, more: Any = 0.0) -> "Affine":
        """A multiple, by (T,) or one number, with more remainder."""
        return Affine(
            self.value * by,
            self.slopes * np.reshape(by, (-1, 1)),
            np.abs(by) * self.remainder + more,
        )

    def plus(self, other: "Affine") -> "Affine":
        """The sum."""
        narrow, wide = sorted((self.slopes, other.slopes), key=lambda each: each.shape[1])
        if narrow.shape[1]:
            wide = np.array(np.broadcast_to(wide, (max(len(wide), len(narrow)), wide.shape[1])))
            wide[:, : narrow.shape[1]] += narrow
        return Affine(self.value + other.value, wide, self.remainder + other.remainder)

    def where(self, there: Any) -> "Affine":
        """It where a condition (T,) holds, 0 elsewhere; what is left out may be infinite."""
        slopes = (
            np.where(np.reshape(there, (-1, 1)), self.slopes, 0.0)
            if self.slopes.shape[1]
            else self.slopes
        )
        return Affine(
            np.where(there, self.value, 0.0), slopes, np.where(there, self.remainder, 0.0)
        )

    @property
    def ranges(self) -> bool:
        """Whether it is more than a number."""
        return self.slopes.shape[1] > 0 or bool(np.any(self.remainder))


class Arithmetic:
    """Operations on numbers whose deviations have the `sizes` (T, s); those of kinks and jumps
    are added to them.
    """

    def __init__(self, sizes: Rows) -> None:
        self.sizes = sizes

    def __call__(self, function: ca.Function, inputs: Sequence[Sequence[Any]]) -> list[Affine]:
        """Outputs of an SX Function, joined; each component of its inputs is an `Affine`, or (T,)
        or one number.

        ValueError for an operation of which no range is known.
        """
        nodes, outputs = single_assignment(function, [[(each, 0) for each in of] for of in inputs])
        made = list[Affine]()
        with np.errstate(all="ignore"):
            for op, of, _ in nodes:
                if not isinstance(of, tuple) or isinstance(of, Affine):
                    made.append(of if isinstance(of, Affine) else Affine(of))
                    continue
                given = [made[i] for i in of]
                if op == "FMIN" and nodes[of[0]].op == "FMAX":
                    x, low = (made[i] for i in nodes[of[0]].of)
                    if not (low.ranges or given[1].ranges):
                        op = "CLIP"
                        given = [x, low, given[1]]
                made.append(self._made(op, given))
        return [made[i] for i in outputs]

    def deviation(self, x: Affine) -> Any:
        """Largest deviation from its value (T,)."""
        return (np.abs(x.slopes) * self.sizes[:, : x.slopes.shape[1]]).sum(axis=1) + x.remainder

    def fresh(self, value: Any, radius: Any) -> Affine:
        """A number about a value (T,) that deviates by up to a radius (T,), whatever all others
        do.
        """
        if not np.any(radius):
            return Affine(value)
        slopes = np.zeros((len(self.sizes), self.sizes.shape[1] + 1))
        slopes[:, -1] = radius
        self.sizes = np.hstack([self.sizes, np.ones((len(self.sizes), 1))])
        return Affine(value, slopes)

    def _made(self, op: str, of: list[Affine]) -> Affine:
        """Result of one operation."""
        x = of[0]
        y = of[-1]
        if op in _NUMBERS and not any(each.ranges for each in of):
            return Affine(1.0 * _NUMBERS[op](*(each.value for each in of)))
        if op in _LINEAR:
            return x.times(_LINEAR[op]) if len(of) == 1 else x.plus(y.times(_LINEAR[op]))
        if op in _SMOOTH:
            return self._smooth(x, *_SMOOTH[op](x.value, self.deviation(x)))
        if op in _JUMPS:
            d = self.deviation(x)
            return self._between(_JUMPS[op](x.value - d), _JUMPS[op](x.value + d))
        if op in ("LT", "LE"):
            apart = y.plus(x.times(-1.0))
            d = self.deviation(apart)
            holds = np.greater if op == "LT" else np.greater_equal
            return self._between(holds(apart.value - d, 0), holds(apart.value + d, 0))
        if op in ("EQ", "NE"):
            apart = x.plus(y.times(-1.0))
            d = self.deviation(apart)
            same = self._between((apart.value == 0) & (d == 0), np.abs(apart.value) <= d)
            return same if op == "EQ" else Affine(1.0).plus(same.times(-1.0))
        if op in ("AND", "IF_ELSE_ZERO"):
            return self._product(x, y) if x.ranges else y.where(x.value != 0)
        if op == "OR":
            return x.plus(y).plus(self._product(x, y).times(-1.0))
        if op in ("MUL", "DIV"):
            return self._product(x, y if op == "MUL" else self._made("INV", [y]))
        if op in ("FMAX", "FMIN"):
            sign = 1.0 if op == "FMAX" else -1.0
            over = self._bent(y.plus(x.times(-1.0)).times(sign), lambda v: np.maximum(v, 0.0), 0.0)
            return x.plus(over.times(sign))
        if op == "CLIP":
            low = of[1].value
            high = of[2].value
            return self._bent(x, lambda v: np.minimum(np.maximum(v, low), high), low, high)
        if op == "FABS":
            return self._bent(x, np.abs, 0.0)
        if op == "FLOOR":
            d = self.deviation(x)
            low, moves = np.floor(x.value - d), np.floor(x.value - d) < np.floor(x.value + d)
            return Affine(
                np.where(moves, x.value - 0.5, low), x.where(moves).slopes, x.where(moves).remainder
            ).plus(self.fresh(0.0, 0.5 * moves))
        if op == "COPYSIGN":
            d = self.deviation(y)
            ends = np.copysign(1.0, y.value - d), np.copysign(1.0, y.value + d)
            return self._product(self._made("FABS", [x]), self._between(*ends))
        raise ValueError(
            f"operation must have a range; got {op}. Add it to plant/compiler/affine.py."
        )

    def _between(self, low: Any, high: Any) -> Affine:
        """What jumps from one value to another: either, or anything between."""
        low, high = np.asarray(low, float), np.asarray(high, float)
        return Affine((low + high) / 2).plus(self.fresh(0.0, np.abs(high - low) / 2))

    def _product(self, x: Affine, y: Affine) -> Affine:
        both = x.times(y.value).plus(y.times(x.value))
        more = self.deviation(x) * self.deviation(y) if x.ranges and y.ranges else 0.0
        return Affine(x.value * y.value, both.slopes, both.remainder + more)

    def _smooth(self, x: Affine, value: Any, slope: Any, bend: Any) -> Affine:
        """By Taylor: value and slope at the centre, and the largest second derivative in the
        range.
        """
        return x.times(slope, bend / 2 * self.deviation(x) ** 2)._replace(value=value)

    def _bent(self, x: Affine, function: Callable[[Any], Any], *knots: Any) -> Affine:
        """A function of straight lines between knots as a line, of those tried the nearest, and
        how far it is.
        """
        d = self.deviation(x)
        low = x.value - d
        high = x.value + d
        places = np.array(
            np.broadcast_arrays(
                low, *(np.minimum(np.maximum(knot, low), high) for knot in knots), high
            )
        )
        values = function(places)
        width = np.maximum(high - low, 1e-300)
        rise = values[-1] - values[0]
        # a line as near to the middle as to the ends
        both = (len(knots) > 1) & (places[1] > low) & (places[-2] < high)
        slopes = np.array(
            np.broadcast_arrays(np.where(both, 2 * rise / (width + rise), rise / width), 0.0)
        )
        left = values - slopes[:, None] * places
        radii = np.ptp(left, axis=1) / 2
        middles = (left.max(axis=1) + left.min(axis=1)) / 2
        # of a small part of the range nothing but its size is kept
        best = (both & (3 * rise < width)).astype(int)
        slope, radius, middle = (
            np.take_along_axis(each, best[None], 0)[0] for each in (slopes, radii, middles)
        )
        exact = radius <= 1e-13 * np.abs(places).max(axis=0)
        line = x.times(slope)
        return line._replace(value=line.value + middle).plus(
            self.fresh(0.0, np.where(exact, 0.0, radius))
        )


def _inverse(x: Any, d: Any) -> tuple[Any, Any, Any]:
    least = np.abs(x) - d
    return 1 / x, -1 / x**2, np.where(least > 0, 2 / least**3, np.inf)


# Operation -> factor of the one number it is of, or of the second that is added.
_LINEAR = {"ASSIGN": 1.0, "ADD": 1.0, "SUB": -1.0, "NEG": -1.0, "TWICE": 2.0}

# Operation -> value, slope, and largest second derivative within a deviation.
_SMOOTH: dict[str, Callable[[Any, Any], tuple[Any, Any, Any]]] = {
    "SQ": lambda x, d: (x**2, 2 * x, 2.0),
    "INV": _inverse,
    "SQRT": lambda x, d: (
        np.sqrt(x),
        0.5 / np.sqrt(x),
        np.where(x > d, np.maximum(x - d, 0) ** -1.5 / 4, np.inf),
    ),
    "SIN": lambda x, d: (np.sin(x), np.cos(x), np.minimum(np.abs(np.sin(x)) + d, 1)),
    "COS": lambda x, d: (np.cos(x), -np.sin(x), np.minimum(np.abs(np.cos(x)) + d, 1)),
    "EXP": lambda x, d: (np.exp(x), np.exp(x), np.exp(x + d)),
    "TANH": lambda x, d: (np.tanh(x), 1 - np.tanh(x) ** 2, 0.77),
}

_JUMPS: dict[str, Callable[[Any], Any]] = {"SIGN": np.sign, "NOT": lambda x: np.equal(x, 0)}
# Operations on numbers without a range.
_NUMBERS: dict[str, Callable[..., Any]] = {
    "ADD": np.add,
    "SUB": np.subtract,
    "MUL": np.multiply,
    "DIV": np.divide,
    "FLOOR": np.floor,
    "FABS": np.abs,
    "COPYSIGN": np.copysign,
    "FMIN": np.fmin,
    "FMAX": np.fmax,
    "LT": np.less,
    "LE": np.less_equal,
    "EQ": np.equal,
    "NE": np.not_equal,
    "AND": np.logical_and,
    "OR": np.logical_or,
    "IF_ELSE_ZERO": lambda c, x: np.where(c != 0, x, 0.0),
}

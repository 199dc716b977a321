"""Source text of the elementary functions that generated kernels call: sine, cosine, and what else needs a choice.

Every function is inlined, has no branch and calls nothing, so that a loop over individuals becomes vector instructions.
"""

from __future__ import annotations

import math

__all__ = ["COSINE", "HALF_PI", "HELPERS", "SINE"]

# Sine and cosine together: subtract a multiple k of pi/2 in three parts (Cody and Waite; the first two have 33
# significant bits, so that their products with k are exact for abs(k) < 2^20), then polynomials on [-pi/4, pi/4] that
# interpolate at Chebyshev nodes in r^2, exchanged and negated by the quadrant. No branch, no table, no call. Absolute
# error below 3e-15 for abs(x) < 1e5; tests/plant/test_translate.py measures it and works the coefficients out again.
SINE = (
    -0.16666666666666666, 0.008333333333330948, -0.00019841269836756774,
    2.7557316101617874e-06, -2.505113165023518e-08, 1.5918115263265974e-10,
)  # fmt: skip
COSINE = (
    0.041666666666666664, -0.0013888888888887398, 2.480158729876456e-05,
    -2.7557317271145144e-07, 2.087614614655861e-09, -1.1382623647474604e-11,
)  # fmt: skip
HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)


def _horner(coefficients):
    text = repr(coefficients[-1])
    for value in reversed(coefficients[:-1]):
        text = f"({text} * z + {value!r})"
    return text


HELPERS = f"""
@inline
def sincos_{{h}}(x):
    k = np.floor(x * {2 / math.pi!r} + 0.5)
    r = ((x - k * {HALF_PI[0]!r}) - k * {HALF_PI[1]!r}) - k * {HALF_PI[2]!r}
    z = r * r
    s = r + r * z * {_horner(SINE)}
    c = (1.0 - 0.5 * z) + z * z * {_horner(COSINE)}
    half = np.floor(0.5 * k)
    after = np.floor(0.5 * k + 0.5)
    swap = k != 2.0 * half
    s_sign = 1.0 - 2.0 * (half - 2.0 * np.floor(0.5 * half))
    c_sign = 1.0 - 2.0 * (after - 2.0 * np.floor(0.5 * after))
    return s_sign * (c if swap else s), c_sign * (s if swap else c)


@inline
def sin_{{h}}(x):
    return sincos_{{h}}(x)[0]


@inline
def cos_{{h}}(x):
    return sincos_{{h}}(x)[1]


@inline
def sign_{{h}}(x):
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else x)


@inline
def min_{{h}}(x, y):
    return x if x < y else y


@inline
def max_{{h}}(x, y):
    return x if x > y else y


@inline
def less_{{h}}(x, y):
    return 1.0 if x < y else 0.0


@inline
def atmost_{{h}}(x, y):
    return 1.0 if x <= y else 0.0


@inline
def equal_{{h}}(x, y):
    return 1.0 if x == y else 0.0


@inline
def both_{{h}}(x, y):
    return 1.0 if (x != 0.0) & (y != 0.0) else 0.0


@inline
def either_{{h}}(x, y):
    return 1.0 if (x != 0.0) | (y != 0.0) else 0.0


@inline
def where_{{h}}(condition, x):
    return x if condition != 0.0 else 0.0
"""

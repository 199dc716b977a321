"""Source text of the elementary functions that generated kernels call: sine, cosine, and what else needs a choice.

Every function is inlined, has no branch and calls nothing, so that a loop over individuals becomes vector instructions.
"""

from __future__ import annotations

import math

__all__ = ["COSINE", "HELPERS", "PI", "SINE"]

# Sine and cosine together: subtract a multiple k of pi in three parts (Cody and Waite; the first two have 33 bits, so
# that their products with k are exact for abs(k) < 2^20), then polynomials on [-pi/2, pi/2] interpolated at Chebyshev
# nodes in r^2; both change sign if k is odd. Adding 1.5 2^52 rounds to a whole number and leaves its parity in the last
# bit. No branch, no table, no call. Absolute error below 3e-15 for abs(x) < 1e5; tests/plant/test_translate.py measures
# it and works the coefficients out again.
SINE = (
    -0.1666666666666665, 0.008333333333325928, -0.00019841269836466636, 2.7557318055221206e-06,
    -2.505197288121006e-08, 1.6050970646122487e-10, -7.408031343670488e-13,
)  # fmt: skip
COSINE = (
    0.04166666666666666, -0.0013888888888884765, 2.480158729891222e-05, -2.7557318573107296e-07,
    2.087668153639063e-09, -1.1466251369215444e-11, 4.6464228378080794e-14,
)  # fmt: skip
PI = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)
_WHOLE = 1.5 * 2.0**52


def _horner(coefficients):
    text = repr(coefficients[-1])
    for value in reversed(coefficients[:-1]):
        text = f"fma_{{h}}({text}, z, {value!r})"
    return text


HELPERS = f"""
@intrinsic
def fma_{{h}}(context, x, y, z):
    def codegen(context, builder, signature, arguments):
        double = arguments[0].type
        fused = builder.module.declare_intrinsic("llvm.fmuladd", [double], FunctionType(double, [double] * 3))
        return builder.call(fused, arguments)

    return float64(float64, float64, float64), codegen


@intrinsic
def negative_if_odd_{{h}}(context, x, whole):
    def codegen(context, builder, signature, arguments):
        bits, parity = (builder.bitcast(x, IntType(64)) for x in arguments)
        sign = builder.shl(parity, IntType(64)(63))
        return builder.bitcast(builder.xor(bits, sign), arguments[0].type)

    return float64(float64, float64), codegen


@intrinsic
def widest_{{h}}(context):
    def codegen(context, builder, signature, arguments):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite checks against a list of its own
        return context.get_dummy_value()

    return void(), codegen


@inline
def sincos_{{h}}(x):
    whole = fma_{{h}}(x, {1 / math.pi!r}, {_WHOLE!r})
    k = whole - {_WHOLE!r}
    r = fma_{{h}}(-k, {PI[2]!r}, fma_{{h}}(-k, {PI[1]!r}, fma_{{h}}(-k, {PI[0]!r}, x)))
    z = r * r
    s = fma_{{h}}(r * z, {_horner(SINE)}, r)
    c = fma_{{h}}(z * z, {_horner(COSINE)}, fma_{{h}}(-0.5, z, 1.0))
    return negative_if_odd_{{h}}(s, whole), negative_if_odd_{{h}}(c, whole)


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

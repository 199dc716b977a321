"""The operations of kernels as LLVM instructions.

A generated kernel is a numba function whose loops are Python and whose bodies are intrinsics: Python that runs while
numba compiles and emits one instruction per line through this class. numba itself never sees the lines, which makes
compiling ten times faster, and nothing is left to chance: what is fused, what is a minimum, what a NaN does is said
here. No operation branches and only those of the mathematical library call, so that a loop over individuals becomes
vector instructions.

The text of this module stands at the head of every generated file, and so in its hash.
"""

import math
from functools import partialmethod

from llvmlite import ir
from numba.core import cgutils
from numba.core.types import float64

__all__ = ["COSINE", "OPERATIONS", "PI", "SINE", "Emitter"]

# Sine and cosine together: subtract a multiple k of pi in two parts (Cody and Waite; the first has 33 bits, so that its
# product with k is exact for abs(k) < 2^20), then polynomials on [-pi/2, pi/2] interpolated at Chebyshev
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
PI = (3.1415926534682512, 1.2154201013012384e-10)
WHOLE = 1.5 * 2.0**52

DOUBLE, LONG = ir.DoubleType(), ir.IntType(64)


class Emitter:
    """Emits instructions at a builder's place, for so many individuals at once.

    Arguments are values of that builder, or Python numbers. With more than one individual a value is a vector; one
    longer than the processor's becomes several instructions side by side, which do not wait for each other.
    """

    def __init__(self, context, builder, width=1):
        self.context, self.builder, self.width = context, builder, width
        self.double = DOUBLE if width == 1 else ir.VectorType(DOUBLE, width)
        self.long = LONG if width == 1 else ir.VectorType(LONG, width)

    # -- values ------------------------------------------------------------------------------------------------------
    def value(self, x):
        """A number as a constant; a value as it is."""
        return self._constant(self.double, DOUBLE(float(x))) if isinstance(x, (int, float)) else x

    def _constant(self, kind, x):
        return x if self.width == 1 else ir.Constant(kind, [x] * self.width)

    def view(self, kind, array, stride, offset):
        """Elements ``[r]`` = array[r stride + offset] of a contiguous numba array of this type."""
        data = self.context.make_array(kind)(self.context, self.builder, array).data
        return View(self, data, stride, offset)

    def index(self, row, columns):
        """Where a row of an array with so many columns begins."""
        return LONG(0) if row == 0 else self.builder.mul(row, LONG(columns))

    def pack(self, *values):
        """A tuple of numbers for numba."""
        return cgutils.pack_array(self.builder, [self.value(x) for x in values])

    def unpack(self, values):
        """The values of such a tuple, each for every individual."""
        values = cgutils.unpack_tuple(self.builder, values)
        return values if self.width == 1 else [self._splat(x) for x in values]

    def _splat(self, x):
        first = self.builder.insert_element(ir.Constant(self.double, ir.Undefined), x, ir.IntType(32)(0))
        everywhere = ir.Constant(ir.VectorType(ir.IntType(32), self.width), [0] * self.width)
        return self.builder.shuffle_vector(first, ir.Constant(self.double, ir.Undefined), everywhere)

    def widest(self):
        """Ask for vectors of 512 bits where there are such, which LLVM leaves half empty on many processors."""
        set.add(self.builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite knows but its own list

    # -- arithmetic --------------------------------------------------------------------------------------------------
    def assign(self, x):
        return x

    def add(self, x, y):
        return self.builder.fadd(self.value(x), self.value(y))

    def sub(self, x, y):
        return self.builder.fsub(self.value(x), self.value(y))

    def mul(self, x, y):
        return self.builder.fmul(self.value(x), self.value(y))

    def div(self, x, y):
        return self.builder.fdiv(self.value(x), self.value(y))

    def neg(self, x):
        return self.builder.fneg(self.value(x))

    def sq(self, x):
        return self.mul(x, x)

    def twice(self, x):
        return self.add(x, x)

    def inv(self, x):
        return self.div(1.0, x)

    def fma(self, x, y, z):
        """Return x y + z, rounded once where the processor can."""
        return self._intrinsic("llvm.fmuladd", x, y, z)

    def fms(self, x, y, z):
        return self.fma(x, y, self.neg(z))

    def fnma(self, x, y, z):
        return self.fma(self.neg(x), y, z)

    # -- functions ---------------------------------------------------------------------------------------------------
    def sincos(self, x):
        """Sine and cosine, of an angle below 1e5."""
        whole = self.fma(x, 1 / math.pi, WHOLE)
        k = self.neg(self.sub(whole, WHOLE))
        r = self.fma(k, PI[1], self.fma(k, PI[0], x))
        z = self.mul(r, r)
        s = self.fma(self.mul(r, z), self._polynomial(SINE, z), r)
        c = self._polynomial((1.0, -0.5, *COSINE), z)
        return self._negative_if_odd(s, whole), self._negative_if_odd(c, whole)

    def sin(self, x):
        return self.sincos(x)[0]

    def cos(self, x):
        return self.sincos(x)[1]

    def _polynomial(self, coefficients, z):
        total = coefficients[-1]
        for value in reversed(coefficients[:-1]):
            total = self.fma(total, z, value)
        return total

    def _negative_if_odd(self, x, whole):
        bits, parity = (self.builder.bitcast(v, self.long) for v in (x, whole))
        sign = self.builder.shl(parity, self._constant(self.long, LONG(63)))
        return self.builder.bitcast(self.builder.xor(bits, sign), self.double)

    def _intrinsic(self, name, *arguments):
        kind = ir.FunctionType(self.double, [self.double] * len(arguments))
        suffix = "f64" if self.width == 1 else f"v{self.width}f64"
        function = cgutils.get_or_insert_function(self.builder.module, kind, f"{name}.{suffix}")
        return self.builder.call(function, [self.value(x) for x in arguments])

    def _library(self, function, *arguments):
        call = self.context.get_function(function, float64(*[float64] * len(arguments)))
        arguments = [self.value(x) for x in arguments]
        if self.width == 1:
            return call(self.builder, arguments)
        result = ir.Constant(self.double, ir.Undefined)
        for lane in (ir.IntType(32)(i) for i in range(self.width)):
            value = call(self.builder, [self.builder.extract_element(x, lane) for x in arguments])
            result = self.builder.insert_element(result, value, lane)
        return result

    sqrt = partialmethod(_intrinsic, "llvm.sqrt")
    floor = partialmethod(_intrinsic, "llvm.floor")
    ceil = partialmethod(_intrinsic, "llvm.ceil")
    trunc = partialmethod(_intrinsic, "llvm.trunc")
    fabs = partialmethod(_intrinsic, "llvm.fabs")
    copysign = partialmethod(_intrinsic, "llvm.copysign")
    exp = partialmethod(_library, math.exp)
    log = partialmethod(_library, math.log)
    pow = constpow = partialmethod(_library, math.pow)
    tan = partialmethod(_library, math.tan)
    asin = partialmethod(_library, math.asin)
    acos = partialmethod(_library, math.acos)
    atan = partialmethod(_library, math.atan)
    atan2 = partialmethod(_library, math.atan2)
    sinh = partialmethod(_library, math.sinh)
    cosh = partialmethod(_library, math.cosh)
    tanh = partialmethod(_library, math.tanh)

    # -- choices: conditions are 1.0 and 0.0, as casadi has them -----------------------------------------------------
    def _if(self, condition, x, y):
        return self.builder.select(condition, self.value(x), self.value(y))

    def _compare(self, how, x, y):
        return self.builder.fcmp_ordered(how, self.value(x), self.value(y))

    def _holds(self, x):
        return self.builder.fcmp_unordered("!=", self.value(x), self.value(0.0))

    def limit(self, x, bound):
        """Return x within +-bound: on AVX-512 in one instruction, of which 8 numbers are a vector."""
        if self.width % 8 or "+avx512dq" not in self.context.codegen().magic_tuple()[2]:
            return self.fmin(self.fmax(x, self.neg(bound)), bound)
        builder, eight, index = self.builder, ir.VectorType(DOUBLE, 8), ir.IntType(32)
        numbers = [eight, eight, index, eight, ir.IntType(8), index]
        name = "llvm.x86.avx512.mask.range.pd.512"
        function = cgutils.get_or_insert_function(builder.module, ir.FunctionType(eight, numbers), name)
        parts, x, bound = [], self.value(x), self.value(bound)
        for start in range(0, self.width, 8):
            those = ir.Constant(ir.VectorType(index, 8), [index(start + i) for i in range(8)])
            a, b = (builder.shuffle_vector(v, v, those) for v in (x, bound))
            parts.append(builder.call(function, [a, b, index(2), a, ir.IntType(8)(255), index(4)]))
        while len(parts) > 1:
            size = parts[0].type.count
            both = ir.Constant(ir.VectorType(index, 2 * size), [index(i) for i in range(2 * size)])
            parts = [builder.shuffle_vector(*parts[:2], both), *parts[2:]]
        return parts[0]

    def fmin(self, x, y):
        return self._if(self._compare("<", x, y), x, y)

    def fmax(self, x, y):
        return self._if(self._compare(">", x, y), x, y)

    def sign(self, x):
        return self._if(self._compare(">", x, 0.0), 1.0, self._if(self._compare("<", x, 0.0), -1.0, x))

    def lt(self, x, y):
        return self._if(self._compare("<", x, y), 1.0, 0.0)

    def le(self, x, y):
        return self._if(self._compare("<=", x, y), 1.0, 0.0)

    def eq(self, x, y):
        return self._if(self._compare("==", x, y), 1.0, 0.0)

    def ne(self, x, y):
        return self._if(self._compare("==", x, y), 0.0, 1.0)

    def not_(self, x):
        return self.eq(x, 0.0)

    def and_(self, x, y):
        return self._if(self.builder.and_(self._holds(x), self._holds(y)), 1.0, 0.0)

    def or_(self, x, y):
        return self._if(self.builder.or_(self._holds(x), self._holds(y)), 1.0, 0.0)

    def if_else_zero(self, condition, x):
        return self._if(self._holds(condition), x, 0.0)


class View:
    """Every `stride`-th number of an array from `offset` on, and those of the next individuals, to read and write."""

    def __init__(self, emitter, data, stride, offset):
        self.emitter, self.data, self.stride, self.offset = emitter, data, stride, offset

    def _place(self, r):
        builder = self.emitter.builder
        start = builder.mul(self.stride, LONG(r)) if isinstance(self.stride, ir.Value) else LONG(self.stride * r)
        place = builder.gep(self.data, [builder.add(start, self.offset)])
        return place if self.emitter.width == 1 else builder.bitcast(place, self.emitter.double.as_pointer())

    def __getitem__(self, r):
        return self.emitter.builder.load(self._place(r), align=8)

    def __setitem__(self, r, value):
        self.emitter.builder.store(self.emitter.value(value), self._place(r), align=8)


OPERATIONS = {
    name.rstrip("_").upper(): f"e.{name}"
    for name in vars(Emitter)
    if not name.startswith("_") and name not in ("value", "view", "index", "pack", "unpack", "widest")
}
"""Name of an operation -> the method that emits it."""

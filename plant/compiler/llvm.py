"""The operations of kernels as LLVM instructions.

A generated kernel is a numba function that calls one intrinsic: Python that runs while numba
compiles and emits one instruction per line through this class. numba itself never sees the lines,
nor the loops around them, which makes compiling more than ten times faster, and nothing is left to
chance: what is fused, what is a minimum, what a NaN does is said here. No operation branches and
only those of the mathematical library call, so that a loop over individuals becomes vector
instructions.

The text of this module stands at the head of every generated file, and so in its hash.
"""

import contextlib
import math
from functools import partialmethod

from llvmlite import ir
from numba.core import cgutils
from numba.core.types import float64

# Sine and cosine together: subtract a multiple k of a step in two parts (Cody and Waite; the first
# has 33 bits, so that its product with k is exact for abs(k) < 2^20), then polynomials in r^2 that
# interpolate at Chebyshev nodes. Adding 1.5 2^52 rounds to a whole number and leaves its lowest
# bits in the lowest bits of the sum. No branch and no call. Absolute error below 3e-15 for abs(x) <
# 1e5; tests/plant/compiler/test_translate.py measures it and works the coefficients out again. With
# a step of pi both change sign if k is odd. Where 16 numbers can be looked up in registers
# (AVX-512) the step is pi/8: shorter polynomials, and the sine and cosine of the multiple by the
# addition theorem.
STEPS = {
    "pi": (3.1415926534682512, 1.2154201013012384e-10),
    "pi/8": (0.3926990816835314, 1.519275126626548e-11),
}
SINE = {
    "pi": (
        -0.1666666666666665,
        0.008333333333325928,
        -0.00019841269836466636,
        2.7557318055221206e-06,
        -2.505197288121006e-08,
        1.6050970646122487e-10,
        -7.408031343670488e-13,
    ),
    "pi/8": (
        -0.16666666666666624,
        0.00833333333297451,
        -0.00019841265187900753,
        2.7538007106314512e-06,
    ),
}
COSINE = {
    "pi": (
        0.04166666666666666,
        -0.0013888888888884765,
        2.480158729891222e-05,
        -2.7557318573107296e-07,
        2.087668153639063e-09,
        -1.1466251369215444e-11,
        4.6464228378080794e-14,
    ),
    "pi/8": (0.04166666666617326, -0.0013888886585418279, 2.4785654625498236e-05),
}
EIGHTHS = (0.3826834323650898, 0.7071067811865476, 0.9238795325112867)  # sin(k pi/8), k = 1, 2, 3
WHOLE = 1.5 * 2.0**52

DOUBLE = ir.DoubleType()
LONG = ir.IntType(64)
INDEX = ir.IntType(32)
EIGHT = ir.VectorType(DOUBLE, 8)


class Values:
    """What operations work on, at a builder's place, for so many individuals at once.

    Arguments are values of that builder, or Python numbers. With more than one individual a value
    is a vector; one longer than the processor's becomes several instructions side by side, which do
    not wait for each other.
    """

    def __init__(self, context, builder, width=1):
        self.context = context
        self.builder = builder
        self.width = width
        self.double = DOUBLE if width == 1 else ir.VectorType(DOUBLE, width)
        self.long = LONG if width == 1 else ir.VectorType(LONG, width)

    # -- values -----------------------------------------------------------------------------------
    def value(self, x):
        """A number as a constant; a value as it is."""
        return self._constant(self.double, DOUBLE(float(x))) if isinstance(x, (int, float)) else x

    def _constant(self, kind, x):
        return x if self.width == 1 else ir.Constant(kind, [x] * self.width)

    def view(self, kind, array, stride, offset):
        """Elements ``[r]`` = array[r stride + offset] of a contiguous numba array of this type."""
        return View(self, self.elements(kind, array), stride, offset)

    def elements(self, kind, array):
        """Where the first element of a contiguous numba array of this type stands."""
        return self.context.make_array(kind)(self.context, self.builder, array).data

    def index(self, row, columns):
        """Where a row of an array with so many columns begins."""
        return LONG(0) if row == 0 else self.builder.mul(row, LONG(columns))

    def pack(self, *values):
        """A tuple of numbers for numba."""
        return cgutils.pack_array(self.builder, [self.value(x) for x in values])

    def shared(self, *values):
        """Numbers that all individuals share, each for every one of them."""
        return values if self.width == 1 else [self._splat(x) for x in values]

    def _splat(self, x):
        # A Python number becomes a constant of any width where it is used.
        if isinstance(x, (int, float)):
            return x
        first = self.builder.insert_element(ir.Constant(self.double, ir.Undefined), x, INDEX(0))
        everywhere = ir.Constant(ir.VectorType(INDEX, self.width), [0] * self.width)
        return self.builder.shuffle_vector(
            first, ir.Constant(self.double, ir.Undefined), everywhere
        )

    # -- loops ------------------------------------------------------------------------------------
    @contextlib.contextmanager
    def individuals(self, count):
        """Emit what follows for all of `count` individuals; yields the number of the first one."""
        # One vector needs no loop, and compiles sooner without.
        if count == self.width:
            yield LONG(0)
            return
        numbers = LONG(0), LONG(count), LONG(self.width)
        with cgutils.for_range_slice(self.builder, *numbers) as (first, _):
            yield first

    @contextlib.contextmanager
    def every(self, period, i):
        """Emit what follows for each `period`-th step i; yields the number of the period."""
        if period == 1:
            yield i
            return
        remainder = self.builder.srem(i, LONG(period))
        with self.builder.if_then(self.builder.icmp_signed("==", remainder, LONG(0))):
            yield self.builder.sdiv(i, LONG(period))

    def none_positive(self, view, count):
        """Whether the quantity at row 0 of a view is above 0 in none of `count` individuals."""
        positive = ir.IntType(1)(0)
        for first in range(0, count, self.width):
            # A NaN is not above 0.
            above = self.builder.fcmp_ordered(">", view.moved(first)[0], self.value(0.0))
            # Bits of a vector as one number: it is zero where no individual is above.
            if self.width > 1:
                bits = self.builder.bitcast(above, ir.IntType(self.width))
                above = self.builder.icmp_unsigned("!=", bits, bits.type(0))
            positive = self.builder.or_(positive, above)
        return self.builder.not_(positive)

    def widest(self):
        """Ask for vectors of 512 bits where there are such, which LLVM leaves half empty on many
        processors.
        """
        # llvmlite knows but its own list
        set.add(self.builder.function.attributes, '"prefer-vector-width"="512"')

    def _looked_up(self, table, whole):
        """Of 16 numbers those at the places that the lowest bits say."""
        bits = self.builder.bitcast(whole, self.long)
        if self.width != 8:
            place = self.builder.and_(bits, self._constant(self.long, LONG(15)))
            return self._by_lane(lambda place: self._number(table, place), place)
        low, high = (ir.Constant(EIGHT, [DOUBLE(x) for x in table[i : i + 8]]) for i in (0, 8))
        kind = ir.FunctionType(EIGHT, [EIGHT, ir.VectorType(LONG, 8), EIGHT])
        permute = self._function("llvm.x86.avx512.vpermi2var.pd.512", kind)
        return self.builder.call(permute, [low, bits, high])

    def _number(self, table, place):
        kind = ir.ArrayType(DOUBLE, len(table))
        name = f"table_{'_'.join(x.hex() for x in table[:2])}"
        if name not in self.builder.module.globals:
            variable = ir.GlobalVariable(self.builder.module, kind, name)
            variable.global_constant = True
            variable.linkage = "internal"
            variable.initializer = ir.Constant(kind, [DOUBLE(x) for x in table])
        first = self.builder.bitcast(self.builder.module.globals[name], DOUBLE.as_pointer())
        return self.builder.load(self.builder.gep(first, [place], source_etype=DOUBLE), typ=DOUBLE)

    def _negative_if_odd(self, x, whole):
        bits, parity = (self.builder.bitcast(v, self.long) for v in (x, whole))
        sign = self.builder.shl(parity, self._constant(self.long, LONG(63)))
        return self.builder.bitcast(self.builder.xor(bits, sign), self.double)

    def _has(self, feature):
        """Whether the processor for which numba compiles has a feature."""
        return f"+{feature}" in self.context.codegen().magic_tuple()[2].split(",")

    def _function(self, name, kind):
        return cgutils.get_or_insert_function(self.builder.module, kind, name)

    def _intrinsic(self, name, *arguments):
        suffix = "f64" if self.width == 1 else f"v{self.width}f64"
        function = self._function(
            f"{name}.{suffix}", ir.FunctionType(self.double, [self.double] * len(arguments))
        )
        return self.builder.call(function, [self.value(x) for x in arguments])

    def _library(self, function, *arguments):
        call = self.context.get_function(function, float64(*[float64] * len(arguments)))
        return self._by_lane(
            lambda *lane: call(self.builder, lane), *(self.value(x) for x in arguments)
        )

    def _by_lane(self, function, *vectors):
        """A function of numbers, one individual after the other."""
        if self.width == 1:
            return function(*vectors)
        result = ir.Constant(self.double, ir.Undefined)
        for lane in map(INDEX, range(self.width)):
            value = function(*(self.builder.extract_element(x, lane) for x in vectors))
            result = self.builder.insert_element(result, value, lane)
        return result


class Emitter(Values):
    """The operations, each emitted by its method; every public method is one."""

    # -- arithmetic -------------------------------------------------------------------------------
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

    # -- functions --------------------------------------------------------------------------------
    def sincos(self, x):
        """Sine and cosine, of an angle below 1e5."""
        return self._sincos_by_table(x) if self._has("avx512f") else self._sincos_by_sign(x)

    def _sincos_by_sign(self, x):
        whole, r, z = self._reduced(x, "pi")
        s = self.fma(self.mul(r, z), self._polynomial(SINE["pi"], z), r)
        c = self._polynomial((1.0, -0.5, *COSINE["pi"]), z)
        return self._negative_if_odd(s, whole), self._negative_if_odd(c, whole)

    def _sincos_by_table(self, x):
        whole, r, z = self._reduced(x, "pi/8")
        s = self.fma(self.mul(r, z), self._polynomial(SINE["pi/8"], z), r)
        c = self.mul(z, self._polynomial((-0.5, *COSINE["pi/8"]), z))  # cosine - 1
        half = (0.0, *EIGHTHS, 1.0, *EIGHTHS[::-1])
        sines = [*half, *(-x for x in half), *half]
        sine, cosine = (self._looked_up(sines[i : i + 16], whole) for i in (0, 4))
        return (
            self.fma(cosine, s, self.fma(sine, c, sine)),
            self.fnma(sine, s, self.fma(cosine, c, cosine)),
        )

    def _reduced(self, x, step):
        """The nearest multiple of the step, in the lowest bits; what is left of x, and its
        square.
        """
        first, second = STEPS[step]
        whole = self.fma(x, 1 / first, WHOLE)
        k = self.neg(self.sub(whole, WHOLE))
        r = self.fma(k, second, self.fma(k, first, x))
        return whole, r, self.mul(r, r)

    def sin(self, x):
        return self.sincos(x)[0]

    def cos(self, x):
        return self.sincos(x)[1]

    def _polynomial(self, coefficients, z):
        total = coefficients[-1]
        for value in reversed(coefficients[:-1]):
            total = self.fma(total, z, value)
        return total

    sqrt = partialmethod(Values._intrinsic, "llvm.sqrt")
    floor = partialmethod(Values._intrinsic, "llvm.floor")
    ceil = partialmethod(Values._intrinsic, "llvm.ceil")
    trunc = partialmethod(Values._intrinsic, "llvm.trunc")
    fabs = partialmethod(Values._intrinsic, "llvm.fabs")
    copysign = partialmethod(Values._intrinsic, "llvm.copysign")
    exp = partialmethod(Values._library, math.exp)
    log = partialmethod(Values._library, math.log)
    pow = constpow = partialmethod(Values._library, math.pow)
    tan = partialmethod(Values._library, math.tan)
    asin = partialmethod(Values._library, math.asin)
    acos = partialmethod(Values._library, math.acos)
    atan = partialmethod(Values._library, math.atan)
    atan2 = partialmethod(Values._library, math.atan2)
    sinh = partialmethod(Values._library, math.sinh)
    cosh = partialmethod(Values._library, math.cosh)
    tanh = partialmethod(Values._library, math.tanh)

    # -- choices: conditions are 1.0 and 0.0, as casadi has them ----------------------------------
    def _if(self, condition, x, y):
        return self.builder.select(condition, self.value(x), self.value(y))

    def _compare(self, how, x, y):
        return self.builder.fcmp_ordered(how, self.value(x), self.value(y))

    def _holds(self, x):
        return self.builder.fcmp_unordered("!=", self.value(x), self.value(0.0))

    def limit(self, x, bound):
        """Return x within +-bound, which is not negative: on AVX-512 the smaller magnitude, with
        the sign of x.
        """
        if self.width != 8 or not self._has("avx512dq"):
            return self.fmin(self.fmax(x, self.neg(bound)), bound)
        kind = ir.FunctionType(EIGHT, [EIGHT, EIGHT, INDEX, EIGHT, ir.IntType(8), INDEX])
        choose = self._function("llvm.x86.avx512.mask.range.pd.512", kind)
        x = self.value(x)
        return self.builder.call(
            choose, [x, self.value(bound), INDEX(2), x, ir.IntType(8)(255), INDEX(4)]
        )

    def fmin(self, x, y):
        return self._if(self._compare("<", x, y), x, y)

    def fmax(self, x, y):
        return self._if(self._compare(">", x, y), x, y)

    def sign(self, x):
        return self._if(
            self._compare(">", x, 0.0), 1.0, self._if(self._compare("<", x, 0.0), -1.0, x)
        )

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
    """Every `stride`-th number of an array from `offset` on, and those of the next individuals,
    to read and write.
    """

    def __init__(self, emitter, data, stride, offset):
        self.emitter = emitter
        self.data = data
        self.stride = stride
        self.offset = offset

    def moved(self, count):
        """The view of the individuals that stand `count` behind those of this one."""
        offset = self.emitter.builder.add(self.offset, LONG(count))
        return View(self.emitter, self.data, self.stride, offset)

    def _place(self, r):
        builder = self.emitter.builder
        start = (
            builder.mul(self.stride, LONG(r))
            if isinstance(self.stride, ir.Value)
            else LONG(self.stride * r)
        )
        place = builder.gep(self.data, [builder.add(start, self.offset)], source_etype=DOUBLE)
        return (
            place
            if self.emitter.width == 1
            else builder.bitcast(place, self.emitter.double.as_pointer())
        )

    def __getitem__(self, r):
        return self.emitter.builder.load(self._place(r), align=8, typ=self.emitter.double)

    def __setitem__(self, r, value):
        self.emitter.builder.store(self.emitter.value(value), self._place(r), align=8)


# Name of an operation -> the method that emits it.
OPERATIONS = {
    name.rstrip("_").upper(): f"e.{name}" for name in vars(Emitter) if not name.startswith("_")
}

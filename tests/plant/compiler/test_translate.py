"""The translator against mpmath (sine, cosine, their polynomials) and against casadi (every
operation).
"""

import math
import platform

import casadi as ca
import llvmlite.binding
import mpmath
import numpy as np
import pytest

from plant.compiler import (
    COSINE,
    LANE,
    OPERATIONS,
    SINE,
    STATE,
    STEPS,
    TIME,
    UNIFORM,
    Kernel,
    MapKernel,
    Names,
    head,
    intrinsic,
    translate,
)

EPS = np.finfo(float).eps


def compiled(expression, *symbols):
    return MapKernel(ca.Function("f", list(symbols), [ca.densify(expression)]))


@pytest.fixture(scope="module", params=["sign", "table"])
def sine_and_cosine(request):
    """Both ways to work them out, whichever this processor would choose."""
    source = head() + intrinsic(
        "pair", ["x"], [f"s, c = e._sincos_by_{request.param}(x)"], ["s", "c"]
    )
    source += (
        "\n\n@compiled\ndef f_{h}(x, y):\n    for i in range(len(x)):\n        y[0, i], y[1, i] ="
        " pair_{h}(x[i])\n"
    )
    kernel = Kernel(source, ["f"])

    def evaluated(x):
        y = np.empty((2, len(x)))
        kernel.call("f", x, y)
        return y

    return evaluated


def worst_error(function, x):
    got = function(x)
    with mpmath.workdps(40):
        exact = [
            [
                float(f(mpmath.mpf(v)) - mpmath.mpf(g))
                for v, g in zip(x.tolist(), row.tolist(), strict=True)
            ]
            for f, row in zip((mpmath.sin, mpmath.cos), got, strict=True)
        ]
    return np.abs(exact).max()


# 3e-15 is what plant/compiler/llvm.py promises: the polynomials' error and the roundings of
# reduction and sum.
def test_sine_and_cosine_agree_with_mpmath_at_random_angles(sine_and_cosine):
    random = np.random.default_rng(0)
    angles = [random.uniform(-scale, scale, 700) for scale in (1e-6, 1.0, np.pi, 10.0, 1e3, 1e5)]
    assert worst_error(sine_and_cosine, np.concatenate([*angles, [0.0, -0.0, 1e5, -1e5]])) < 3e-15


def test_sine_and_cosine_agree_with_mpmath_beside_multiples_of_a_sixteenth_turn(sine_and_cosine):
    random = np.random.default_rng(1)
    # 254647 pi / 8 < 1e5
    turns = np.concatenate([np.arange(-160, 161), random.integers(-254647, 254647, 300)])
    nearest = turns * np.float64(np.pi / 8)
    beside = [
        nearest,
        np.nextafter(nearest, np.inf),
        np.nextafter(nearest, -np.inf),
        nearest + 1e-9,
        nearest - 1e-6,
    ]
    # between two
    beside += [(turns + 0.5) * np.float64(np.pi / 8), (turns + 0.5) * np.float64(np.pi)]
    assert worst_error(sine_and_cosine, np.concatenate(beside)) < 3e-15


def interpolated(function, count, step):
    """Coefficients of the polynomial through `count` Chebyshev nodes on [0, (step/2)^2 1.0001],
    in 60 digits.
    """
    with mpmath.workdps(60):
        end = (step / 2) ** 2 * mpmath.mpf("1.0001")
        nodes = [
            end / 2 * (1 + mpmath.cos(mpmath.pi * (2 * k + 1) / (2 * count))) for k in range(count)
        ]
        powers = mpmath.matrix(count, count)
        for i in range(count):
            for j in range(count):
                powers[i, j] = nodes[i] ** j
        return [
            float(c) for c in mpmath.lu_solve(powers, mpmath.matrix([function(z) for z in nodes]))
        ]


@pytest.mark.parametrize(("name", "parts"), [("pi", 1), ("pi/8", 8)])
def test_polynomials_interpolate_the_rest_of_sine_and_cosine_at_chebyshev_nodes(name, parts):
    with mpmath.workdps(60):
        step = mpmath.pi / parts
    sine = interpolated(
        lambda z: (mpmath.sin(mpmath.sqrt(z)) / mpmath.sqrt(z) - 1) / z, len(SINE[name]), step
    )
    cosine = interpolated(
        lambda z: (mpmath.cos(mpmath.sqrt(z)) - 1 + z / 2) / z**2, len(COSINE[name]), step
    )
    # 60 digits leave no doubt about the last bit of a double; 1e-13 allows for constants worked out
    # in fewer digits, and an error of 1e-13 in any coefficient moves sine and cosine by less than
    # 1e-14 of their small last terms.
    np.testing.assert_allclose(SINE[name], sine, rtol=1e-13)
    np.testing.assert_allclose(COSINE[name], cosine, rtol=1e-13)


@pytest.mark.parametrize(("name", "parts"), [("pi", 1), ("pi/8", 8)])
def test_parts_of_a_step_add_up_and_the_first_has_exact_products_with_whole_numbers(name, parts):
    with mpmath.workdps(60):
        assert (
            abs(sum(mpmath.mpf(part) for part in STEPS[name]) - mpmath.pi / parts)
            < mpmath.mpf(2) ** -86
        )
    mantissa = math.frexp(STEPS[name][0])[0]
    # 33 bits, and 53 - 33 = 20 for the whole number
    assert mantissa * 2**33 == int(mantissa * 2**33)


@pytest.mark.parametrize("width", [2, 4, 8, 16])
@pytest.mark.parametrize(
    "operation", ["sincos(x)[0]", "sincos(x)[1]", "limit(x, 2.0)", "exp(x)", "trunc(x)", "sign(x)"]
)
def test_vectors_give_what_numbers_give(operation, width):
    results = []
    for w in (1, width):
        views = [f"{name} = e.view(kinds[{i}], {name}, {w}, j)" for i, name in enumerate("xy")]
        source = head() + intrinsic(
            "some", ["x", "y", "j"], [*views, "x = x[0]", f"y[0] = e.{operation}"], width=w
        )
        source += f"""

@compiled
def f_{{h}}(x, y):
    for j in range(0, len(x), {w}):
        some_{{h}}(x, y, j)
"""
        x, y = np.random.default_rng(0).uniform(-50, 50, 64), np.empty(64)
        Kernel(source, ["f"]).call("f", x, y)
        results.append(y)
    np.testing.assert_array_equal(*results)


def every_operation(x, y):
    """One expression per operation that the translator knows; x and y are any numbers, u lies in
    [-1, 1].
    """
    u = ca.SX.sym("u")
    return u, [
        x + y,
        x - y,
        x * y,
        x / y,
        -x,
        x * x,
        2 * x,
        1 / y,
        ca.sqrt(x),
        ca.exp(x),
        ca.log(x),
        x**y,
        x**2.5,
        ca.sin(x),
        ca.cos(x),
        ca.tan(x),
        ca.asin(u),
        ca.acos(u),
        ca.atan(x),
        ca.atan2(x, y),
        ca.sinh(x),
        ca.cosh(x),
        ca.tanh(x),
        ca.floor(x),
        ca.ceil(x),
        ca.fabs(x),
        ca.copysign(x, y),
        ca.sign(x),
        ca.fmin(x, y),
        ca.fmax(x, y),
        x < y,
        x <= y,
        ca.eq(x, y),
        ca.ne(x, y),
        ca.logic_not(x),
        ca.logic_and(x, y),
        ca.logic_or(x, y),
        ca.if_else(x, y, 0),
        ca.if_else(x > y, ca.sin(y), x),
    ]


def test_every_operation_gives_what_casadi_gives():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    u, expressions = every_operation(x, y)
    function = ca.Function("f", [x, y, u], [ca.densify(ca.vertcat(*expressions))])
    met = {function.instruction_id(k) for k in range(function.n_instructions())}
    known = {name: getattr(ca, f"OP_{name}") for name in OPERATIONS if hasattr(ca, f"OP_{name}")}
    missing = {name for name, code in known.items() if code not in met}
    # casadi makes none of it in an SX function; copying is harmless to know
    assert missing <= {"ASSIGN"}

    random = np.random.default_rng(2)
    special = np.array([0.0, -0.0, 1.0, -1.0, 2.0, -2.0, 0.5, -0.5, 3.0, 1e-300, 1e6])
    pairs = np.array(np.meshgrid(special[:10], special[:10])).reshape(2, -1)
    points = np.hstack([random.uniform(-20, 20, (2, 400)), pairs])
    points = np.vstack([points, random.uniform(-1, 1, points.shape[1])])
    points[2, :5] = (0.0, -0.0, 1.0, -1.0, 0.5)
    got = MapKernel(function)(points)
    expected = function.map(points.shape[1])(points[:1], points[1:2], points[2:]).full()
    # roots of negative numbers: where casadi gives NaN, so does the kernel
    assert np.isnan(expected).any()
    np.testing.assert_array_equal(np.isnan(got), np.isnan(expected))
    # Two mathematical libraries may differ by an ulp or two each; sine and cosine by 3e-15 absolute
    # (above).
    np.testing.assert_allclose(got, expected, rtol=4 * EPS, atol=3e-15)
    exact = slice(23, 37)  # floor to logic_or: rounding, signs and comparisons
    np.testing.assert_array_equal(got[exact], expected[exact])


def test_nan_travels_and_infinity_is_a_number():
    x = ca.SX.sym("x", 2)
    expressions = [
        ca.sin(x[0]),
        ca.cos(x[0]),
        x[0] + x[1],
        x[0] * x[1],
        ca.floor(x[0]),
        ca.sign(x[0]),
        ca.sqrt(x[0]),
    ]
    kernel = compiled(
        ca.vertcat(*expressions, ca.fmin(x[1], ca.inf), ca.fmax(x[1], -ca.inf), x[1] + ca.inf), x
    )
    got = kernel(np.array([[np.nan, np.inf, 1.0], [1.0, 1.0, 3.0]]))
    assert np.isnan(got[:7, 0]).all()
    assert np.isnan(got[:2, 1]).all()  # no sine of infinity
    np.testing.assert_array_equal(got[7:, 2], [3.0, 3.0, np.inf])
    constants = compiled(ca.vertcat(x[0] - ca.inf, ca.SX.nan() + x[1], x[0] * 1e-310), x)
    np.testing.assert_array_equal(constants(np.ones((2, 1)))[:, 0], [-np.inf, np.nan, 1e-310])


def test_outputs_may_be_inputs_constants_and_each_other():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    function = ca.Function("f", [x, y], [ca.vertcat(x[1], x[0]), ca.SX([7.0]), y * x[0], y * x[0]])
    got = MapKernel(function)(np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    np.testing.assert_array_equal(got, [[3, 4], [1, 2], [7, 7], [5, 12], [5, 12]])


@pytest.mark.parametrize(
    ("name", "make"), [("OP_ERF", ca.erf), ("OP_LOG1P", ca.log1p), ("OP_FMOD", ca.fmod)]
)
def test_operation_without_translation_is_refused_by_name(name, make):
    x = ca.SX.sym("x")
    made = make(x, 2.0) if name == "OP_FMOD" else make(x)
    with pytest.raises(
        ValueError, match=rf"must be one of .*; got {name} in f\. .*llvm\.py"
    ) as error:
        compiled(made, x)
    assert "\n" not in str(error.value)


def test_arrays_of_the_wrong_shape_are_refused():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    plain = MapKernel(ca.Function("f", [x, y], [x * y]))
    joined = MapKernel(ca.Function("f", [x, y], [x * y]), outer=1)
    got = joined(np.array([[1.0, 2.0]]), np.array([[3.0, 4.0, 5.0]]))
    np.testing.assert_array_equal(got[0], [[3, 6], [4, 8], [5, 10]])
    one, two = np.ones((1, 3)), np.ones((2, 3))
    for call in (lambda: plain(one), lambda: joined(one), lambda: joined(two, one)):
        with pytest.raises(ValueError, match="rows, one per number; got"):
            call()


def test_function_of_mx_is_refused():
    x = ca.MX.sym("x")
    with pytest.raises(ValueError, match=r"must be built from SX; got MXFunction f\. Use expand"):
        MapKernel(ca.Function("f", [x], [2 * x]))


def test_each_instruction_runs_as_seldom_as_its_arguments_allow():
    symbols = [ca.SX.sym(name) for name in ("uniform", "lane", "time", "state")]
    u, lane, t, s = symbols
    expressions = [u * u + 1, u * lane, u * t, lane * t, ca.sin(s), ca.SX(3) + u]
    function = ca.Function("f", symbols, [ca.vertcat(*expressions)])
    inputs = [[("u", UNIFORM)], [("l", LANE)], [("t", TIME)], [("s", STATE)]]
    rows = iter(range(5, 100))
    program = translate(function, inputs, Names(), lambda: next(rows))
    texts = {
        kind: "; ".join(line.text() for line in lines) for kind, lines in program.lines.items()
    }
    assert texts[UNIFORM].count(";") == 2
    assert texts[LANE] == "e.mul(u, l)"
    assert texts[TIME] in ("e.mul(u, t)", "e.mul(t, u)")
    assert "e.mul(l, t)" in texts[STATE]
    assert "e.sin(s)" in texts[STATE]
    # u l is an output: carried from the lane loop to the steps
    assert list(program.crossing.values()) == [5]
    assert program.used == {"u": UNIFORM, "l": LANE, "t": TIME, "s": STATE}


def test_sine_and_cosine_of_one_angle_and_divisions_by_one_number_share_their_work():
    symbols = lane, s = [ca.SX.sym(name) for name in ("lane", "state")]
    expressions = [ca.sin(lane) * s, ca.cos(lane) * s, lane / s, lane * lane / s, s / lane]
    function = ca.Function("f", symbols, [ca.vertcat(*expressions)])
    rows = iter(range(5, 100))
    program = translate(function, [[("l", LANE)], [("s", STATE)]], Names(), lambda: next(rows))
    lanes, states = ("; ".join(map(str, program.lines[kind])) for kind in (LANE, STATE))
    assert lanes.count("e.sincos(l)") == 1
    assert "sin" not in states
    assert states.count("e.inv(s)") == 1
    assert states.count("e.div(") == 1  # s / l, which nothing shares
    # sine, cosine and the square of l, each worked out once per individual
    assert len(program.crossing) == 3
    x = np.random.default_rng(3).uniform(-3, 3, (2, 50))
    expected = function.map(50)(x[:1], x[1:]).full()
    np.testing.assert_allclose(MapKernel(function)(x), expected, rtol=4 * EPS, atol=1e-14)


def texts(expression, *symbols, relaxed):
    """What the instructions of an expression in these state symbols become."""
    function = ca.Function("f", list(symbols), [expression])
    inputs = [[(f"{symbol.name()}{i}", STATE) for i in range(symbol.numel())] for symbol in symbols]
    return [
        line.text()
        for line in translate(function, inputs, Names(), None, relaxed=relaxed).lines[STATE]
    ]


def test_products_are_fused_with_the_sum_that_alone_needs_them():
    a, b, c = x = [ca.SX.sym(name) for name in "abc"]
    assert texts(a * b + c, *x, relaxed=False) == ["e.mul(a0, b0)", "e.add(v1, c0)"]
    assert texts(a * b + c, *x, relaxed=True) == ["e.fma(a0, b0, c0)"]
    assert texts(c + a * b, *x, relaxed=True) == ["e.fma(a0, b0, c0)"]
    assert texts(c - a * b, *x, relaxed=True) == ["e.fnma(a0, b0, c0)"]
    assert texts(a * b - c, *x, relaxed=True) == ["e.fms(a0, b0, c0)"]
    assert texts(2 * a - c, *x, relaxed=True) == ["e.fms(a0, 2.0, c0)"]
    assert texts(a * a + c, *x, relaxed=True) == ["e.fma(a0, a0, c0)"]
    first = "e.fnma(a0, b0, c0)"  # c - (a b + a c) is c - a b - a c
    assert texts(c - (a * b + a * c), *x, relaxed=True) == [first, "e.fnma(a0, c0, v1)"]
    assert texts(c - (a * b - a * c), *x, relaxed=True) == [first, "e.fma(a0, c0, v1)"]
    product = a * b
    twice = texts(ca.vertcat(product + c, product), *x, relaxed=True)
    assert twice == ["e.mul(a0, b0)", "e.add(v1, c0)"]  # the product is needed for itself too


def test_rounding_towards_zero_is_one_instruction_if_it_is_all_of_one_number():
    x = a, b = [ca.SX.sym(name) for name in "ab"]
    assert texts(ca.copysign(ca.floor(ca.fabs(a)), a), *x, relaxed=False) == ["e.trunc(a0)"]
    assert len(texts(ca.copysign(ca.floor(ca.fabs(a)), b), *x, relaxed=False)) == 3


def test_limits_are_one_instruction_if_they_cannot_be_negative():
    x = a, b = [ca.SX.sym(name) for name in "ab"]
    magnitude = ca.fabs(b)
    assert (
        texts(ca.fmin(ca.fmax(a, -magnitude), magnitude), *x, relaxed=False)[-1]
        == "e.limit(a0, v1)"
    )
    assert len(texts(ca.fmin(ca.fmax(a, -b), b), *x, relaxed=False)) == 3
    assert len(texts(ca.fmin(ca.fmax(a, -magnitude), b), *x, relaxed=False)) == 4


def fused(x, y, z):
    """x y + z, rounded once."""
    with mpmath.workprec(400):
        return float(mpmath.mpf(float(x)) * mpmath.mpf(float(y)) + mpmath.mpf(float(z)))


@pytest.mark.skipif(
    platform.machine() == "x86_64" and not llvmlite.binding.get_host_cpu_features().get("fma"),
    reason="this processor has no fused multiply-add",
)
def test_fused_kernels_round_once():
    """By a loop kernel's own helper, against exact arithmetic; the sum cancels, so that a second
    rounding shows.
    """
    random = np.random.default_rng(5)
    x, y = random.normal(size=(2, 200))
    z = -x * y * (1 + 1e-15 * random.normal(size=200))
    source = head() + intrinsic("fused", ["x", "y", "z"], [], ["e.fma(x, y, z)"])
    source += "\n\n@compiled\ndef f_{h}(x, y, z):\n    return fused_{h}(x, y, z)[0]\n"
    kernel = Kernel(source, ["f"])
    got = [kernel.call("f", *point) for point in zip(x, y, z, strict=True)]
    np.testing.assert_array_equal(got, [fused(*point) for point in zip(x, y, z, strict=True)])
    assert not np.array_equal(got, x * y + z)

"""casadi Function -> straight-line Python for numba, sorted by when each instruction has to run.

Every input component is declared as one of four kinds, and an instruction belongs to the latest kind that it needs:

========== ========================================================= ==========================
kind       what it is                                                runs
========== ========================================================= ==========================
uniform    a number, the same for all individuals                    once
lane       a number that differs between individuals                 once per individual
time       known beforehand, changes with time (the reference)       once per step
state      the rest                                                  once per step and individual
========== ========================================================= ==========================
"""

from __future__ import annotations

import dataclasses
import math

import casadi as ca

__all__ = ["HELPERS", "LANE", "STATE", "TIME", "UNIFORM", "Names", "Program", "translate"]

UNIFORM, LANE, TIME, STATE = 1, 2, 4, 8

# casadi's operations by name -> text of the expression; {0}, {1} are the arguments, {h} the hash of the file.
_OPERATIONS = {
    "ASSIGN": "{0}",
    "ADD": "{0} + {1}",
    "SUB": "{0} - {1}",
    "MUL": "{0} * {1}",
    "DIV": "{0} / {1}",
    "NEG": "-{0}",
    "SQ": "{0} * {0}",
    "TWICE": "{0} + {0}",
    "INV": "1.0 / {0}",
    "SQRT": "math.sqrt({0})",
    "EXP": "math.exp({0})",
    "LOG": "math.log({0})",
    "POW": "math.pow({0}, {1})",
    "CONSTPOW": "math.pow({0}, {1})",
    "SIN": "sin_{h}({0})",
    "COS": "cos_{h}({0})",
    "TAN": "math.tan({0})",
    "ASIN": "math.asin({0})",
    "ACOS": "math.acos({0})",
    "ATAN": "math.atan({0})",
    "ATAN2": "math.atan2({0}, {1})",
    "SINH": "math.sinh({0})",
    "COSH": "math.cosh({0})",
    "TANH": "math.tanh({0})",
    "FLOOR": "np.floor({0})",
    "CEIL": "np.ceil({0})",
    "FABS": "abs({0})",
    "COPYSIGN": "math.copysign({0}, {1})",
    "SIGN": "sign_{h}({0})",
    "FMIN": "min_{h}({0}, {1})",
    "FMAX": "max_{h}({0}, {1})",
    "LT": "less_{h}({0}, {1})",
    "LE": "atmost_{h}({0}, {1})",
    "EQ": "equal_{h}({0}, {1})",
    "NE": "1.0 - equal_{h}({0}, {1})",
    "NOT": "equal_{h}({0}, 0.0)",
    "AND": "both_{h}({0}, {1})",
    "OR": "either_{h}({0}, {1})",
    "IF_ELSE_ZERO": "where_{h}({0}, {1})",
}
_BY_CODE = {getattr(ca, f"OP_{name}"): text for name, text in _OPERATIONS.items()}
_CODE_NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}

# Sine and cosine: subtract a multiple of pi in three parts (Cody and Waite; the first two have 33 and 33 significant
# bits, so that their products with whole numbers below 2^20 are exact), then an odd polynomial on [-pi/2, pi/2] that
# interpolates sin(r)/r at Chebyshev nodes in r^2. Absolute error below 3e-15 for abs(x) < 1e5 (tests/plant/
# test_translate.py measures it and works the coefficients out again). No branch, no table, no call.
POLYNOMIAL = (
    -0.16666666666666666, 0.008333333333333316, -0.00019841269841254966, 2.7557319219160833e-06,
    -2.505210761669045e-08, 1.6058977292642743e-10, -7.643969663988074e-13, 2.7314368769379893e-15,
)  # fmt: skip
PI_PARTS = (3.1415926534682512, 1.2154201012607932e-10, 4.044532497591901e-21)

HELPERS = """
@inline
def polynomial_{h}(r):
    s = r * r
    p = POLYNOMIAL_8
    p = p * s + POLYNOMIAL_7
    p = p * s + POLYNOMIAL_6
    p = p * s + POLYNOMIAL_5
    p = p * s + POLYNOMIAL_4
    p = p * s + POLYNOMIAL_3
    p = p * s + POLYNOMIAL_2
    p = p * s + POLYNOMIAL_1
    return r + r * s * p


@inline
def sin_{h}(x):
    k = np.floor(x * INVERSE_PI + 0.5)
    odd = k - 2.0 * np.floor(0.5 * k)
    r = ((x - k * PI_1) - k * PI_2) - k * PI_3
    return (1.0 - 2.0 * odd) * polynomial_{h}(r)


@inline
def cos_{h}(x):
    k = np.floor(x * INVERSE_PI) + 0.5
    odd = np.floor(k) - 2.0 * np.floor(0.5 * np.floor(k))
    r = ((x - k * PI_1) - k * PI_2) - k * PI_3
    return (2.0 * odd - 1.0) * polynomial_{h}(r)


@inline
def sign_{h}(x):
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else x)


@inline
def min_{h}(x, y):
    return x if x < y else y


@inline
def max_{h}(x, y):
    return x if x > y else y


@inline
def less_{h}(x, y):
    return 1.0 if x < y else 0.0


@inline
def atmost_{h}(x, y):
    return 1.0 if x <= y else 0.0


@inline
def equal_{h}(x, y):
    return 1.0 if x == y else 0.0


@inline
def both_{h}(x, y):
    return 1.0 if (x != 0.0) & (y != 0.0) else 0.0


@inline
def either_{h}(x, y):
    return 1.0 if (x != 0.0) | (y != 0.0) else 0.0


@inline
def where_{h}(condition, x):
    return x if condition != 0.0 else 0.0
"""
for _i, _value in enumerate(POLYNOMIAL, 1):
    HELPERS = HELPERS.replace(f"POLYNOMIAL_{_i}", repr(_value))
for _i, _value in enumerate(PI_PARTS, 1):
    HELPERS = HELPERS.replace(f"PI_{_i}", repr(_value))
HELPERS = HELPERS.replace("INVERSE_PI", repr(1 / math.pi))


class Names:
    """Fresh variable names, shared by all programs of one file."""

    def __init__(self):
        self.count = 0

    def __call__(self):
        self.count += 1
        return f"v{self.count}"


@dataclasses.dataclass
class Program:
    """Lines of one function, by the kind of the instruction.

    Attributes
    ----------
    lines : dict
        UNIFORM, LANE, TIME, STATE -> list of text lines, without indentation.
    results : list of str
        Expressions of all output components, outputs joined.
    crossing : dict
        Variable of a LANE line that a STATE line needs -> row of the work array that carries it.
    used : set of str
        Input expressions that occur.
    """

    lines: dict
    results: list
    crossing: dict
    used: set


def translate(function, inputs, names, rows):
    """Translate an SX Function.

    Parameters
    ----------
    function : casadi Function
    inputs : list of list of (str, int)
        For each input, for each component: the expression that reads it, and its kind.
    names : Names
    rows : callable
        Gives a fresh row of the work array for what crosses from LANE to STATE.

    Returns
    -------
    Program

    Raises
    ------
    ValueError
        The function is not made of SX, or holds an operation that has no translation (named).
    """
    if function.class_name() != "SXFunction":
        raise ValueError(
            f"function must be built from SX; got {function.class_name()} {function.name()}. Use expand()."
        )
    lines = {UNIFORM: [], LANE: [], TIME: [], STATE: []}
    crossing, made, used, work = {}, set(), set(), {}
    starts = [sum(function.nnz_out(i) for i in range(k)) for k in range(function.n_out())]
    results = ["0.0"] * sum(function.nnz_out(i) for i in range(function.n_out()))

    def use(index, level):
        text, _ = work[index]
        if level == STATE and text in made:
            crossing.setdefault(text, rows())
        return text

    for k in range(function.n_instructions()):
        code, to, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_CONST:
            work[to[0]] = (_literal(function.instruction_constant(k)), 0)
        elif code == ca.OP_INPUT:
            work[to[0]] = inputs[of[0]][of[1]]
            used.add(work[to[0]][0])
        elif code == ca.OP_OUTPUT:
            results[starts[to[0]] + to[1]] = use(of[0], STATE)
        elif code in _BY_CODE:
            kinds = 0
            for index in of:
                kinds |= work[index][1]
            level = _level(kinds)
            name, text = names(), _BY_CODE[code]
            for i, index in enumerate(of):
                text = text.replace(f"{{{i}}}", use(index, level))
            lines[level].append(f"{name} = {text}")
            if level == LANE:
                made.add(name)
            work[to[0]] = (name, level)
        else:
            raise ValueError(
                f"operation must be one of {', '.join(_OPERATIONS)}; got {_CODE_NAMES.get(code, code)} in "
                f"{function.name()}. Express it by those, or add it to plant/translate.py."
            )
    return Program(lines, results, crossing, used)


def _literal(value):
    return f"({value!r})" if math.isfinite(value) else f"np.{value!r}" if value > 0 else f"(-np.{-value!r})"


def _level(kinds):
    if kinds & STATE or (kinds & TIME and kinds & LANE):
        return STATE
    if kinds & TIME:
        return TIME
    return LANE if kinds & LANE else UNIFORM

"""Translate a casadi Function into the statements of a C99 function.

The statements contain no `if`, no loop and no static variable.

The instructions are those of the compiled kernels (`plant.compiler.translate`,
`plant.compiler.instructions`), rounded where casadi rounds.
"""

import re
import textwrap
from collections import Counter
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.compiler.instructions import STATE, TIME, UNIFORM, needed, rewritten
from plant.compiler.translate import single_assignment

# Binding strength of an expression. An operand needs parentheses only if it is weaker than its
# place requires. The weakest strength is 0, which the conditional operator ?: has.
_SUM = 1
_PRODUCT = 2
_SIGNED = 3
_WHOLE = 4

# For each operation: its spelling in C, its strength, and the strength that each argument needs.
# C calls any other operation by its name in lower case, in the C library or in `_HELPERS`.
_SPELLING = {
    "ASSIGN": ("{}", 0, (0,)),
    "ADD": ("{} + {}", _SUM, (_SUM, _PRODUCT)),
    "SUB": ("{} - {}", _SUM, (_SUM, _PRODUCT)),
    "MUL": ("{} * {}", _PRODUCT, (_PRODUCT, _SIGNED)),
    "DIV": ("{} / {}", _PRODUCT, (_PRODUCT, _SIGNED)),
    "SQ": ("{0} * {0}", _PRODUCT, (_WHOLE,)),
    "TWICE": ("2.0 * {}", _PRODUCT, (_SIGNED,)),
    "INV": ("1.0 / {}", _PRODUCT, (_SIGNED,)),
    "NEG": ("-{}", _SIGNED, (_WHOLE,)),
    "LT": ("(double)({} < {})", _SIGNED, (_SUM, _SUM)),
    "LE": ("(double)({} <= {})", _SIGNED, (_SUM, _SUM)),
    "EQ": ("(double)({} == {})", _SIGNED, (_SUM, _SUM)),
    "NE": ("(double)({} != {})", _SIGNED, (_SUM, _SUM)),
    "NOT": ("(double)({} == 0.0)", _SIGNED, (_SUM,)),
    "AND": ("(double)({} != 0.0 && {} != 0.0)", _SIGNED, (_SUM, _SUM)),
    "OR": ("(double)({} != 0.0 || {} != 0.0)", _SIGNED, (_SUM, _SUM)),
    "IF_ELSE_ZERO": ("{} != 0.0 ? {} : 0.0", 0, (_SUM, _SUM)),
    "FIRST": ("sin({})", _WHOLE, (0,)),
    "SECOND": ("cos({})", _WHOLE, (0,)),
    "CONSTPOW": ("pow({}, {})", _WHOLE, (0, 0)),
    "FMIN": ("smaller({}, {})", _WHOLE, (0, 0)),
    "FMAX": ("larger({}, {})", _WHOLE, (0, 0)),
    "LIMIT": ("smaller(larger({0}, -{1}), {1})", _WHOLE, (0, _WHOLE)),
}

_AGAIN = ("SQ", "LIMIT", "SINCOS")  # operations that write their last argument twice

_LONG = 64  # an expression with more characters gets a variable of its own

_HELPERS = {
    "sign": (
        """/* -1, 0 or 1 */
static double sign(double x)
{
    return x > 0.0 ? 1.0 : x < 0.0 ? -1.0 : x;
}

"""
    ),
    "smaller": (
        """/* As fmin, which is seldom inlined: of a number and a NaN, the number. */
static double smaller(double a, double b)
{
    return a < b || b != b ? a : b;
}

"""
    ),
    "larger": (
        """/* As fmax */
static double larger(double a, double b)
{
    return a > b || b != b ? a : b;
}

"""
    ),
}


def literal(value: float) -> str:
    """A number as C writes it, without loss."""
    return repr(float(value)).replace("inf", "INFINITY").replace("nan", "NAN")


def helpers(body: str) -> str:
    """Return the C text of those `_HELPERS` that the C code `body` calls."""
    # The \b keeps out calls of a longer name that ends with that of a helper.
    return "".join(text for name, text in _HELPERS.items() if re.search(rf"\b{name}\(", body))


def statements(
    function: ca.Function, inputs: list[list[tuple[str, int]]]
) -> tuple[dict[int, list[str]], list[str], set[str]]:
    """An SX Function in C: declarations by their kind, expressions of results, and inputs used.

    For each component of each input, `inputs` holds the C expression that reads it and its kind.
    The dictionary lists the declarations of UNIFORM first, then those of TIME, then those of
    STATE. The list of results joins the components of all outputs.
    """
    # Without other roundings than casadi's, C and the compiled step give the same bits.
    nodes, outputs = rewritten(*single_assignment(function, inputs), relaxed=False)
    order = needed(nodes, outputs)
    # Count how often the C text uses each node. An operation in `_AGAIN` uses its last argument
    # twice.
    uses = Counter(outputs)
    for index in order:
        op, of, _ = nodes[index]
        if isinstance(of, tuple):
            uses.update(of if op not in _AGAIN else (*of, of[-1]))
    lines: dict[int, list[str]] = {UNIFORM: [], TIME: [], STATE: []}
    used: set[str] = set()
    text: dict[int, str] = {}
    strength: dict[int, int] = {}
    for index in order:
        op, of, kind = nodes[index]
        if op == "INPUT":
            used.add(of)
        if op == "SINCOS":
            # C computes sine and cosine apart: both read the text of the angle.
            text[index], strength[index] = text[of[0]], strength[of[0]]
            continue
        if not isinstance(of, tuple):
            text[index] = literal(of) if op == "CONST" else of
            # A sign or a cast binds weaker than a name.
            strength[index] = _SIGNED if text[index].startswith(("-", "(")) else _WHOLE
            continue
        # An operation that `_SPELLING` lacks calls the C function of its name in lower case.
        call = f"{op.lower()}({', '.join(['{}'] * len(of))})", _WHOLE, [0] * len(of)
        pattern, strength[index], needs = _SPELLING.get(op, call)
        # Parentheses only where an operand binds weaker than its place requires.
        parts = [
            text[i] if strength[i] >= least else f"({text[i]})"
            for i, least in zip(of, needs, strict=True)
        ]
        text[index] = pattern.format(*parts)
        # A repeated or long expression gets a variable, so that readers and compilers can follow.
        if uses[index] > 1 or len(text[index]) > _LONG:
            # The name is k for UNIFORM, r for TIME or x for STATE, followed by a count.
            name = f"{'krx'[(UNIFORM, TIME, STATE).index(kind)]}{len(lines[kind]) + 1}"
            lines[kind].append(f"const double {name} = {text[index]};")
            text[index], strength[index] = name, _WHOLE
    return lines, [text[index] for index in outputs], used


def comment(text: str, width: int = 116) -> str:
    """A C comment of one or more lines, in ASCII, without marks that would end it."""
    # Text of a user could end the comment, or hold characters that a compiler refuses.
    text = re.sub(r"[^\w\s()\[\]{}+\-^.,:;=*<>'/|%]", " ", text, flags=re.ASCII)
    text = " ".join(text.replace("*/", "* /").replace("/*", "/ *").split())
    return "/* " + "\n * ".join(textwrap.wrap(text, width)) + " */"


def paragraph(text: str) -> str:
    """Return lines of text for a comment that an earlier line has opened."""
    # Without the marks of begin and end.
    return f" * {comment(text)[3:-3]}"


def braced(values: NDArray[np.float64]) -> str:
    """Return the C initializer of an array: one line if it is short, or else several lines."""
    inner = "{" + ", ".join(literal(value) for value in values) + "}"
    if len(inner) < 70:
        return inner
    return (
        "{\n"
        + textwrap.fill(inner[1:-1], 112, initial_indent="    ", subsequent_indent="    ")
        + ",\n}"
    )


def constant(name: str, values: Any, meaning: str) -> str:
    """Declaration of a constant, or of an array of constants, under a comment."""
    if np.ndim(values):
        return (
            f"{comment(meaning)}\nstatic const double {name}[{len(values)}] = {braced(values)};\n"
        )
    return f"{comment(meaning)}\nstatic const double {name} = {literal(values)};\n"

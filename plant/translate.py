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
from collections import Counter

import casadi as ca

__all__ = ["LANE", "STATE", "TIME", "UNIFORM", "Names", "Program", "translate"]

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

    def emit(level, text):
        name = names()
        lines[level].append(f"{name} = {text}")
        if level == LANE:
            made.add(name)
        return name

    instructions = _single_assignment(function)
    divisors = Counter(of[1] for code, _, of in instructions if code == ca.OP_DIV)
    angles = {code: {of[0] for c, _, of in instructions if c == code} for code in (ca.OP_SIN, ca.OP_COS)}
    pairs = dict.fromkeys(angles[ca.OP_SIN] & angles[ca.OP_COS])
    for code, to, of in instructions:
        if code == ca.OP_CONST:
            work[to] = (_literal(of), 0)
        elif code == ca.OP_INPUT:
            work[to] = inputs[of[0]][of[1]]
            used.add(work[to][0])
        elif code == ca.OP_OUTPUT:
            results[starts[to[0]] + to[1]] = use(of, STATE)
        elif code not in _BY_CODE:
            raise ValueError(
                f"operation must be one of {', '.join(_OPERATIONS)}; got {_CODE_NAMES.get(code, code)} in "
                f"{function.name()}. Express it by those, or add it to plant/translate.py."
            )
        else:
            level = _level(work[index][1] for index in of)
            if code in angles and of[0] in pairs:  # sine and cosine of one angle share their work
                if pairs[of[0]] is None:
                    pair = emit(level, f"sincos_{{h}}({use(of[0], level)})")
                    pairs[of[0]] = {ca.OP_SIN: emit(level, f"{pair}[0]"), ca.OP_COS: emit(level, f"{pair}[1]")}
                    made.discard(pair)
                work[to] = (pairs[of[0]][code], level)
                continue
            if code == ca.OP_DIV and divisors[of[1]] > 1 and work[of[1]][1] == STATE:
                # Many divisions by one number that changes all the time share its reciprocal. (Others stay as they
                # are: a rounding in what the encoder reads is amplified by an observer's gains.)
                inverse = ("inverse", of[1])
                if inverse not in work:
                    work[inverse] = (emit(STATE, f"1.0 / {use(of[1], STATE)}"), STATE)
                code, of = ca.OP_MUL, (of[0], inverse)
            text = _BY_CODE[code]
            for i, index in enumerate(of):
                text = text.replace(f"{{{i}}}", use(index, level))
            work[to] = (emit(level, text), level)
    return Program(lines, results, crossing, used)


def _literal(value):
    return f"({value!r})" if math.isfinite(value) else f"np.{value!r}" if value > 0 else f"(-np.{-value!r})"


def _single_assignment(function):
    """Instructions as (code, result, arguments), with results numbered instead of work places that are used again."""
    latest, found = {}, []
    for k in range(function.n_instructions()):
        code, to, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            found.append((code, (to[0], to[1]), latest[of[0]]))
            continue
        if code == ca.OP_CONST:
            found.append((code, k, function.instruction_constant(k)))
        elif code == ca.OP_INPUT:
            found.append((code, k, (of[0], of[1])))
        else:
            found.append((code, k, tuple(latest[index] for index in of)))
        latest[to[0]] = k
    return found


def _level(kinds):
    """When something made of these kinds has to run."""
    needs = 0
    for kind in kinds:
        needs |= kind
    if needs & STATE or (needs & TIME and needs & LANE):
        return STATE
    if needs & TIME:
        return TIME
    return LANE if needs & LANE else UNIFORM

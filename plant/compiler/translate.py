"""casadi Function -> calls of `llvm.Emitter`, sorted by when each has to run (`instructions`)."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import casadi as ca

from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM, Node, kind_of, needed, rewritten
from plant.compiler.llvm import OPERATIONS
from plant.compiler.splitting import Line

_BY_CODE = {getattr(ca, f"OP_{name}"): name for name in OPERATIONS if hasattr(ca, f"OP_{name}")}
_CALL = ["", "{}({{0}})", "{}({{0}}, {{1}})", "{}({{0}}, {{1}}, {{2}})"]
_WEIGHTS = {"SINCOS": 27, "SIN": 15, "COS": 15}  # in instructions; the others are one or a call
_CODE_NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}


class Names:
    """Fresh variable names, shared by all programs of one file."""

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> str:
        self.count += 1
        return f"v{self.count}"


@dataclasses.dataclass
class Program:
    """Lines of one function, by the kind of the instruction, and the expressions of its results, outputs joined.

    `crossing` is the row of the work array that carries a variable of a LANE line to a STATE line, `used` the kind of
    each input expression that occurs.
    """

    lines: dict[int, list[Line]]
    results: list[str]
    crossing: dict[str, int]
    used: dict[str, int]


def translate(
    function: ca.Function,
    inputs: list[list[tuple[str, int]]],
    names: Names,
    rows: Callable[[], int],
    *,
    relaxed: bool = False,
    wanted: int | None = None,
) -> Program:
    """Translate an SX Function; refused if it is not of SX, or holds an operation that has no translation.

    `inputs`: for each input, for each component, the expression that reads it, and its kind; `rows` gives a fresh row
    of the work array for what crosses from LANE to STATE; only what the first `wanted` output components need is
    translated. `relaxed` allows other roundings than casadi's (`instructions`), above all fused multiply-adds. Which
    ones is decided here, not by LLVM, so that every kernel of one function gives the same bits.
    """
    if function.class_name() != "SXFunction":
        raise ValueError(
            f"function must be built from SX; got {function.class_name()} {function.name()}. Use expand()."
        )
    nodes, outputs = rewritten(*single_assignment(function, inputs), relaxed=relaxed)
    outputs = outputs[:wanted]
    lines: dict[int, list[Line]] = {UNIFORM: [], LANE: [], TIME: [], STATE: []}
    crossing: dict[str, int] = {}
    used: dict[str, int] = {}
    text: dict[int, Any] = {}
    made: set[str] = set()

    def use(index: int, kind: int) -> str:
        name: str = text[index]
        if kind == STATE and name in made:
            crossing.setdefault(name, rows())
        return name

    for index in needed(nodes, outputs):
        node = nodes[index]
        if node.op == "CONST":
            text[index] = _literal(node.of)
        elif node.op == "INPUT":
            text[index] = node.of
            used[node.of] = node.kind
        elif node.op in ("FIRST", "SECOND"):
            text[index] = text[node.of[0]][node.op == "SECOND"]
        else:
            needs = tuple(use(argument, node.kind) for argument in node.of)
            results = (names(), names()) if node.op == "SINCOS" else (names(),)
            text[index] = results if node.op == "SINCOS" else results[0]
            lines[node.kind].append(
                Line(results, _CALL[len(needs)].format(OPERATIONS[node.op]), needs, _WEIGHTS.get(node.op, 1))
            )
            if node.kind == LANE:
                made.update(results)
    return Program(lines, [use(index, STATE) for index in outputs], crossing, used)


def _literal(value: float) -> str:
    return repr(value) if math.isfinite(value) else f'float("{value!r}")'


def single_assignment(function: ca.Function, inputs: list[list[tuple[str, int]]]) -> tuple[list[Node], list[int]]:
    """Nodes of an SX Function, each after those it needs, and the indices of those that are its outputs, joined.

    `inputs` are as in `translate`. ValueError for an operation that has no translation (named).
    """
    starts = [sum(function.nnz_out(i) for i in range(k)) for k in range(function.n_out() + 1)]
    latest: dict[int, int] = {}
    nodes, outputs = [Node("CONST", 0.0, 0)], [0] * starts[-1]
    for k in range(function.n_instructions()):
        code, to, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            outputs[starts[to[0]] + to[1]] = latest[of[0]]
            continue
        if code == ca.OP_CONST:
            node = Node("CONST", function.instruction_constant(k), 0)
        elif code == ca.OP_INPUT:
            node = Node("INPUT", *inputs[of[0]][of[1]])
        elif code in _BY_CODE:
            arguments = tuple(latest[index] for index in of)
            node = Node(_BY_CODE[code], arguments, kind_of(nodes[index].kind for index in arguments))
        else:
            raise ValueError(
                f"operation must be one of {', '.join(_BY_CODE.values())}; got {_CODE_NAMES.get(code, code)} in "
                f"{function.name()}. Express it by those, or add it to plant/compiler/llvm.py."
            )
        latest[to[0]] = len(nodes)
        nodes.append(node)
    return nodes, outputs

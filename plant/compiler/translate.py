"""casadi Function -> calls of `llvm.Emitter`, sorted by the time at which they run, and cut."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from itertools import accumulate, pairwise
from typing import Any, NamedTuple

import casadi as ca

from plant.compiler.instructions import LANE, STATE, TIME, UNIFORM, Node, kind_of, needed, rewritten
from plant.compiler.llvm import OPERATIONS


class Line(NamedTuple):
    """One assignment; ``{0}``, ``{1}`` in its template stand for `needs`, names or literals."""

    names: tuple[str, ...]
    template: str
    needs: tuple[str, ...]
    weight: int = 1

    def text(self, renamed: Mapping[str, str] | None = None) -> str:
        """The right side, with some names changed."""
        text = self.template
        for i, name in enumerate(self.needs):
            text = text.replace(f"{{{i}}}", (renamed or {}).get(name, name))
        return text

    def __str__(self) -> str:
        return f"{', '.join(self.names)} = {self.text()}"


# The operations of casadi by their codes; FMA, LIMIT and others exist after the rewriting alone.
_BY_CODE = {getattr(ca, f"OP_{name}"): name for name in OPERATIONS if hasattr(ca, f"OP_{name}")}
# Text of a call by the number of its arguments.
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
    """Lines of one function by the kind of their instructions, and expressions of results.

    `crossing` is the row of the work array that carries a variable of a LANE line to a STATE line,
    `used` the kind of each input expression that occurs.
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
    """Translate an SX Function; refuse other functions, and operations without a translation.

    `inputs`: for each input, for each component, the expression that reads it, and its kind; `rows`
    gives a fresh row of the work array for a value that crosses from LANE to STATE; only the
    first `wanted` output components are translated. `relaxed` allows other roundings than casadi's
    (`instructions`), above all fused multiply-adds. They are decided here, not by LLVM, so that
    every kernel of one function gives the same bits.
    """
    if function.class_name() != "SXFunction":
        raise ValueError(
            f"function must be built from SX; got {function.class_name()} {function.name()}. Use"
            " expand()."
        )
    nodes, outputs = rewritten(*single_assignment(function, inputs), relaxed=relaxed)
    # Before `needed`, so that instructions of the other outputs alone are left out.
    outputs = outputs[:wanted]
    lines: dict[int, list[Line]] = {UNIFORM: [], LANE: [], TIME: [], STATE: []}
    crossing: dict[str, int] = {}
    used: dict[str, int] = {}
    text: dict[int, Any] = {}
    lane_names: set[str] = set()

    def use(index: int, kind: int) -> str:
        name: str = text[index]
        # STATE lines run in a loop of their own, so they read a LANE value from the work array.
        if kind == STATE and name in lane_names:
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
            # SINCOS has two results; these nodes name one of them.
            text[index] = text[node.of[0]][node.op == "SECOND"]
        else:
            needs = tuple(use(argument, node.kind) for argument in node.of)
            results = (names(), names()) if node.op == "SINCOS" else (names(),)
            text[index] = results if node.op == "SINCOS" else results[0]
            lines[node.kind].append(
                Line(
                    results,
                    _CALL[len(needs)].format(OPERATIONS[node.op]),
                    needs,
                    _WEIGHTS.get(node.op, 1),
                )
            )
            if node.kind == LANE:
                lane_names.update(results)
    return Program(lines, [use(index, STATE) for index in outputs], crossing, used)


def _literal(value: float) -> str:
    # Without quotes, inf and nan would be names that no kernel has.
    return repr(value) if math.isfinite(value) else f'float("{value!r}")'


def single_assignment(
    function: ca.Function, inputs: list[list[tuple[str, int]]]
) -> tuple[list[Node], list[int]]:
    """Nodes of an SX Function, each after its arguments, and the indices of its joined outputs.

    `inputs` are as in `translate`. ValueError for an operation that has no translation (named).
    """
    # Position of each output's first component among those of all outputs.
    starts = [sum(function.nnz_out(i) for i in range(k)) for k in range(function.n_out() + 1)]
    latest: dict[int, int] = {}
    # A component that no instruction writes stays at node 0, which is zero.
    nodes = [Node("CONST", 0.0, 0)]
    outputs = [0] * starts[-1]
    # casadi uses its registers again; `latest` holds the node that a register has at this point.
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        to = function.instruction_output(k)
        of = function.instruction_input(k)
        if code == ca.OP_OUTPUT:
            outputs[starts[to[0]] + to[1]] = latest[of[0]]
            continue
        if code == ca.OP_CONST:
            node = Node("CONST", function.instruction_constant(k), 0)
        elif code == ca.OP_INPUT:
            node = Node("INPUT", *inputs[of[0]][of[1]])
        elif code in _BY_CODE:
            arguments = tuple(latest[index] for index in of)
            node = Node(
                _BY_CODE[code], arguments, kind_of(nodes[index].kind for index in arguments)
            )
        else:
            raise ValueError(
                f"operation must be one of {', '.join(_BY_CODE.values())}; got"
                f" {_CODE_NAMES.get(code, code)} in {function.name()}. Express it by those, or add"
                " it to plant/compiler/llvm.py."
            )
        latest[to[0]] = len(nodes)
        nodes.append(node)
    return nodes, outputs


def cut(
    lines: list[Line],
    stores: Mapping[int | str, str],
    rows: Mapping[str, int],
    fresh: Callable[[], int],
    size: int,
) -> list[list[str]]:
    """Pieces of about `size` instructions, each a loop; ``{row}`` is a row of the work array.

    `stores` says which name or literal a row, or another place, holds in the end, `rows` which row
    a name may be read from; `fresh` gives a new row. A processor looks a few hundred instructions
    ahead: in one long loop these belong to one individual, or a vector of them, and wait for each
    other, in short loops to several.
    """
    # 1. For each name, the piece that assigns it and the last one that reads it.
    bounds = _bounds(lines, stores, size)
    rows, final = dict(rows), len(bounds) - 2
    piece_of = {
        name: k
        for k, (a, b) in enumerate(pairwise(bounds))
        for line in lines[a:b]
        for name in line.names
    }
    read_in: dict[str, int] = {}  # name -> last piece that reads it
    for k, (a, b) in enumerate(pairwise(bounds)):
        read_in |= dict.fromkeys((name for line in lines[a:b] for name in line.needs), k)
    # copied from row to row
    read_in |= dict.fromkeys((name for name in stores.values() if name in rows), final)
    held: dict[int | str, str] = {row: name for name, row in rows.items()}
    # A row is overwritten as soon as its new value is known and its old one has been read for the
    # last time.
    known_in = dict.fromkeys(rows, final) | piece_of
    stored_in = {
        row: max(known_in.get(name, 0), read_in.get(held.get(row, ""), 0))
        for row, name in stores.items()
    }
    # 2. The text of each piece: rows to read, instructions, rows that later pieces read, results.
    pieces = []
    for k, (a, b) in enumerate(pairwise(bounds)):
        ending = {row: name for row, name in stores.items() if stored_in[row] == k}
        assigned = {name for line in lines[a:b] for name in line.names}
        needed = dict.fromkeys(
            [*(name for line in lines[a:b] for name in line.needs), *ending.values()]
        )
        # A value that is read has another name in every piece: variables that are assigned once
        # compile much faster.
        read = {name: f"{name}_{k}" for name in needed if name in rows and name not in assigned}
        text = [f"{new} = {{{rows[name]}}}" for name, new in read.items()]
        text += [f"{', '.join(line.names)} = {line.text(read)}" for line in lines[a:b]]
        # A variable ends with its loop, so later pieces read it from a row.
        later = {name for line in lines[b:] for name in line.needs}
        later |= {name for row, name in stores.items() if stored_in[row] > k}
        for line in lines[a:b] if k < final else []:
            for name in line.names:
                if name in later:
                    rows[name] = fresh()
                    text.append(f"{{{rows[name]}}} = {name}")
        text += [f"{_target(row)} = {read.get(name, name)}" for row, name in ending.items()]
        pieces.append(text)
    return pieces


def _target(place: int | str) -> str:
    return place if isinstance(place, str) else f"{{{place}}}"


def _bounds(lines: list[Line], stores: Mapping[int | str, str], size: int) -> list[int]:
    """Where to cut: near equal sizes, at the places that fewest values have to cross."""
    assigned = {name: i for i, line in enumerate(lines) for name in line.names}
    # A stored value is needed until the end.
    read = {name: i for i, line in enumerate(lines) for name in line.needs} | dict.fromkeys(
        stores.values(), len(lines)
    )
    # Each value adds 1 where it is assigned and subtracts 1 after its last use; the sum up to a
    # line is the number of values that cross it.
    change = [0] * (len(lines) + 2)
    for name, i in assigned.items():
        if name in read:
            change[i + 1] += 1
            change[read[name] + 1] -= 1
    crossing = list(accumulate(change))  # values made before line k and read from there on
    weights = list(accumulate((line.weight for line in lines), initial=0))
    count = max(1, round(weights[-1] / size))
    bounds = [0]
    for k in range(1, count):
        # A cut may be a third of a piece away from where all pieces are equal.
        low, high = ((k + side / 3) * weights[-1] / count for side in (-1, 1))
        near = [i for i, weight in enumerate(weights) if low <= weight <= high and i > bounds[-1]]
        # There is no cut where one heavy instruction covers the whole range.
        bounds += [min(near, key=lambda i: crossing[i])] if near else []
    return [*bounds, len(lines)]

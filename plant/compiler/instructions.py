"""The instructions of a function, and shorter ones for long expressions of casadi.

Every input component is declared as *uniform* (a number, the same for all individuals: it runs
once), *lane* (a number that differs between them: once per individual), *time* (known beforehand,
changes with time, as the reference: once per step), or *state* (the rest: once per step and
individual). An instruction belongs to the latest kind that it needs.

Rewritten in one pass:

* copysign(floor(fabs(x)), x) is trunc(x); fmin(fmax(x, -b), b) is limit(x, b) if b is an absolute
  value.
* The sine and the cosine of one angle share their work.
* Divisions by one number that changes all the time share its reciprocal. (Others stay as they are:
  a rounding in the encoder's reading is amplified by an observer's gains.)

and, where other roundings than casadi's are allowed (`relaxed`):

* x + a + b is x + (a + b) if a and b are earlier than x; products alike.
* A division by an earlier value is a product with its reciprocal.
* x - (a b + c d) is x - a b - c d, with two fused operations.
* A product that only a sum needs is fused with it.
"""

import itertools
from collections import Counter
from collections.abc import Iterable
from typing import Any, NamedTuple

# One bit per kind, so that the kinds of several arguments can be joined by or.
UNIFORM = 1
LANE = 2
TIME = 4
STATE = 8


class Node(NamedTuple):
    """One instruction: its operation, its arguments, and the time at which it has to run.

    `of` are the indices of the nodes that it needs, the value of a constant, or the text of an
    input; `kind` is 0 for a constant.
    """

    op: str
    of: Any
    kind: int


def kind_of(kinds: Iterable[int]) -> int:
    """When something made of these kinds has to run."""
    needs = 0
    for kind in kinds:
        needs |= kind
    # A value that changes with time and between individuals runs as often as the state.
    if needs & STATE or (needs & TIME and needs & LANE):
        return STATE
    if needs & TIME:
        return TIME
    return LANE if needs & LANE else UNIFORM


def rewritten(
    nodes: list[Node], outputs: list[int], *, relaxed: bool
) -> tuple[list[Node], list[int]]:
    """Nodes and outputs, rewritten; nodes that nothing needs any more are left in.

    Each node comes after those it needs.
    """
    if relaxed:
        # This comes before products are fused with sums, which cannot be reordered any more.
        nodes, outputs = _early_first(nodes, outputs)
    new: list[Node] = []
    position: dict[int, int] = {}
    uses = _uses(nodes, outputs)
    # A reciprocal that is computed once pays from the second division on.
    divisors = Counter(node.of[1] for node in nodes if node.op == "DIV")
    angles = [{node.of[0] for node in nodes if node.op == op} for op in ("SIN", "COS")]
    shared: dict[
        tuple[Any, ...], int
    ] = {}  # nodes that several others need, by operation and arguments

    def add(op: str, *of: int) -> int:
        new.append(Node(op, of, kind_of(new[index].kind for index in of)))
        return len(new) - 1

    def once(op: str, *of: int) -> int:
        if (op, of) not in shared:
            shared[op, of] = add(op, *of)
        return shared[op, of]

    def product(index: int, kind: int) -> tuple[int, ...] | None:
        """Factors of a node that is a product of this kind and needed once; None otherwise."""
        node = new[index]
        # A product that is needed elsewhere exists anyway; fusing it would compute it again. One of
        # an earlier kind would run more often.
        if not relaxed or index in often or node.kind != kind:
            return None
        if node.op == "TWICE":
            return node.of[0], two
        return {"MUL": node.of, "SQ": node.of * 2}.get(node.op)

    def added(x: int, sign: int, factors: tuple[int, ...]) -> int:
        return add("FMA" if sign > 0 else "FNMA", *factors, x)

    def sum_of(x: int, sign: int, y: int, kind: int) -> int:
        """The node x + sign y."""
        # x + sign a b is one fused operation.
        if factors := product(y, kind):
            return added(x, sign, factors)
        # y = a b + c, or c - a b, where c is a product, too: x takes up both by fused operations.
        node = new[y]
        if node.op in ("FMA", "FNMA") and y not in often and (factors := product(node.of[2], kind)):
            return added(added(x, sign, factors), sign if node.op == "FMA" else -sign, node.of[:2])
        if factors := product(x, kind):
            return add("FMA" if sign > 0 else "FMS", *factors, y)
        return add("ADD" if sign > 0 else "SUB", x, y)

    often: set[int] = set()  # nodes that are needed more than once
    # Factor of TWICE where it is fused as a product.
    two = len(new)
    new.append(Node("CONST", 2.0, 0))
    for index, (op, of, kind) in enumerate(nodes):
        # Constants and inputs have no arguments.
        if not isinstance(of, tuple):
            new.append(nodes[index])
            position[index] = len(new) - 1
            continue
        at = [position[i] for i in of]
        if op == "COPYSIGN" and (x := _truncated(new, *at)) is not None:
            position[index] = add("TRUNC", x)
        elif op == "FMIN" and (x := _limited(new, *at)) is not None:
            position[index] = add("LIMIT", x, at[1])
        # Both take one result of the same SINCOS.
        elif op in ("SIN", "COS") and of[0] in angles[0] & angles[1]:
            position[index] = add("FIRST" if op == "SIN" else "SECOND", once("SINCOS", *at))
        elif op == "DIV" and _by_reciprocal(divisors[of[1]], nodes[of[1]].kind, kind, relaxed):
            position[index] = add("MUL", at[0], once("INV", at[1]))
        elif op in ("ADD", "SUB"):
            position[index] = sum_of(at[0], 1 if op == "ADD" else -1, at[1], kind)
        else:
            position[index] = add(op, *at)
        if uses[index] > 1:
            often.add(position[index])
    return new, [position[index] for index in outputs]


def _by_reciprocal(divisions: int, divisor: int, kind: int, relaxed: bool) -> bool:
    # A reciprocal of the state's kind pays where it is shared. An earlier one always pays, since it
    # runs less often than the division, but rounds otherwise. Constants (kind 0) stay divisors.
    return divisions > 1 if divisor == STATE else relaxed and 0 < divisor < kind


def _early_first(nodes: list[Node], outputs: list[int]) -> tuple[list[Node], list[int]]:
    """Nodes and outputs in which sums (products) join their two earlier arguments first."""
    new: list[Node] = []
    position: list[int] = []
    uses = _uses(nodes, outputs)
    for op, of, kind in nodes:
        at = of
        if isinstance(of, tuple):
            at = tuple(position[i] for i in of)
            # Either argument can be the inner sum (product), and either argument of it the early
            # one.
            for k, m in itertools.product((0, 1), (0, 1)) if op in ("ADD", "MUL") else ():
                inner = new[at[k]]
                early = at[1 - k]
                # An inner result that is needed elsewhere would be computed twice.
                if inner.op != op or uses[of[k]] > 1:
                    continue
                joined = kind_of((new[inner.of[m]].kind, new[early].kind))
                # The new node pays only where it runs less often than the one that it replaces.
                if joined < kind:
                    new.append(Node(op, (inner.of[m], early), joined))
                    at = (inner.of[1 - m], len(new) - 1)
                    break
        position.append(len(new))
        new.append(Node(op, at, kind))
    return new, [position[index] for index in outputs]


def needed(nodes: list[Node], outputs: list[int]) -> list[int]:
    """Indices of the nodes on which an output depends, in order."""
    # Each node comes after its arguments, so one pass backwards finds all of them.
    indices = set(outputs)
    for index in reversed(range(len(nodes))):
        if index in indices and isinstance(nodes[index].of, tuple):
            indices.update(nodes[index].of)
    return sorted(indices)


def _uses(nodes: list[Node], outputs: list[int]) -> Counter[int]:
    """How often each node is needed."""
    arguments = (nodes[index].of for index in needed(nodes, outputs))
    return Counter(outputs) + Counter(
        index for of in arguments if isinstance(of, tuple) for index in of
    )


def _truncated(nodes: list[Node], magnitude: int, x: int) -> int | None:
    """The x of copysign(floor(fabs(x)), x); None for other nodes."""
    # casadi has no instruction that rounds toward zero, and writes it by these three.
    floor = nodes[magnitude]
    if floor.op != "FLOOR" or nodes[floor.of[0]].op != "FABS":
        return None
    return x if nodes[floor.of[0]].of == (x,) else None


def _limited(nodes: list[Node], above: int, bound: int) -> int | None:
    """The x of fmin(fmax(x, -bound), bound) for an absolute value as bound; otherwise None."""
    # Only an absolute value is certain not to be negative, as `limit` requires.
    if nodes[above].op != "FMAX" or nodes[bound].op != "FABS":
        return None
    x, below = nodes[above].of
    return x if nodes[below].op == "NEG" and nodes[below].of == (bound,) else None

"""The instructions of a function, and shorter ones for what casadi writes at length.

Every input component is declared as one of four kinds, and an instruction belongs to the latest kind that it needs:

========== ========================================================= ==========================
kind       what it is                                                runs
========== ========================================================= ==========================
uniform    a number, the same for all individuals                    once
lane       a number that differs between individuals                 once per individual
time       known beforehand, changes with time (the reference)       once per step
state      the rest                                                  once per step and individual
========== ========================================================= ==========================

What is rewritten, in one pass:

* copysign(floor(fabs(x)), x) is trunc(x).
* The sine and the cosine of one angle share their work.
* Divisions by one number that changes all the time share its reciprocal. (Others stay as they are: a rounding in what
  the encoder reads is amplified by an observer's gains.)
* A product that only a sum needs is fused with it, if asked for.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

__all__ = ["LANE", "STATE", "TIME", "UNIFORM", "Node", "kind_of", "rewritten"]

UNIFORM, LANE, TIME, STATE = 1, 2, 4, 8


class Node(NamedTuple):
    """One instruction.

    Attributes
    ----------
    op : str
        Name of the operation; "CONST" and "INPUT" for what needs none.
    of : tuple of int, float or str
        Indices of the nodes that it needs; the value of a constant; the text of an input.
    kind : int
        When it has to run; 0 for a constant.
    """

    op: str
    of: tuple
    kind: int


def kind_of(kinds):
    """When something made of these kinds has to run."""
    needs = 0
    for kind in kinds:
        needs |= kind
    if needs & STATE or (needs & TIME and needs & LANE):
        return STATE
    if needs & TIME:
        return TIME
    return LANE if needs & LANE else UNIFORM


def rewritten(nodes, outputs, *, fuse):
    """Nodes and outputs, rewritten; nodes that nothing needs any more are left in.

    Parameters
    ----------
    nodes : list of Node
        Each after those it needs.
    outputs : list of int
    fuse : bool
    """
    new, place = [], {}
    uses = Counter(outputs) + Counter(index for node in nodes if isinstance(node.of, tuple) for index in node.of)
    divisors = Counter(node.of[1] for node in nodes if node.op == "DIV")
    angles = [{node.of[0] for node in nodes if node.op == op} for op in ("SIN", "COS")]
    shared = {}  # what several nodes need, by what it is

    def add(op, *of):
        new.append(Node(op, of, kind_of(new[index].kind for index in of)))
        return len(new) - 1

    def once(op, *of):
        if (op, of) not in shared:
            shared[op, of] = add(op, *of)
        return shared[op, of]

    def product(index, kind):
        """Factors of a node that is a product of this kind and needed once; None otherwise."""
        node = new[place[index]]
        if not fuse or uses[index] > 1 or node.kind != kind:
            return None
        if node.op == "TWICE":
            return node.of[0], two
        return {"MUL": node.of, "SQ": node.of * 2}.get(node.op)

    two = len(new)
    new.append(Node("CONST", 2.0, 0))
    for index, (op, of, kind) in enumerate(nodes):
        if not isinstance(of, tuple):
            new.append(nodes[index])
            place[index] = len(new) - 1
            continue
        at = [place[i] for i in of]
        if op == "COPYSIGN" and (x := _truncated(new, *at)) is not None:
            place[index] = add("TRUNC", x)
        elif op in ("SIN", "COS") and of[0] in angles[0] & angles[1]:
            place[index] = add("FIRST" if op == "SIN" else "SECOND", once("SINCOS", *at))
        elif op == "DIV" and divisors[of[1]] > 1 and nodes[of[1]].kind == STATE:
            place[index] = add("MUL", at[0], once("INV", at[1]))
        elif op in ("ADD", "SUB") and (factors := product(of[1], kind)):
            place[index] = add("FMA" if op == "ADD" else "FNMA", *factors, at[0])
        elif op in ("ADD", "SUB") and (factors := product(of[0], kind)):
            place[index] = add("FMA" if op == "ADD" else "FMS", *factors, at[1])
        else:
            place[index] = add(op, *at)
    return new, [place[index] for index in outputs]


def _truncated(nodes, magnitude, x):
    """The x of copysign(floor(fabs(x)), x); None if it is something else."""
    floor = nodes[magnitude]
    if floor.op != "FLOOR" or nodes[floor.of[0]].op != "FABS":
        return None
    return x if nodes[floor.of[0]].of == (x,) else None

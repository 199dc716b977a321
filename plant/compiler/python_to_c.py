"""Functions of numbers, arrays and branches, as numba compiles them, in C99: one text for both.

What is not known here is refused, so that C and Python cannot drift apart. Every number is a
double, and an index of an array is cast; arrays are known by their names, wherever these occur. The
caller's C has ``least`` and ``greatest`` of two numbers, which are Python's min and max.
"""

import ast
import dataclasses
import itertools
import re
import textwrap
from collections.abc import Collection, Mapping
from typing import Any

from plant.compiler.c_statements import literal

_OPERATORS: Mapping[type, str] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.Eq: "==",
    ast.NotEq: "!=",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
    ast.And: "&&",
    ast.Or: "||",
    ast.USub: "-",
    ast.Not: "!",
}

_FUNCTIONS = {
    "abs": "fabs",
    "min": "least",
    "max": "greatest",
    "math.ceil": "ceil",
    "np.ceil": "ceil",
    "np.floor": "floor",
    "int": "(int)",
}


@dataclasses.dataclass(frozen=True)
class CNames:
    """What names stand for: arrays, of which some are only read (all else is a number), and
    functions of its own.

    The functions get a `prefix`, since C's library has a ``read``. `sizes` are the lengths of
    arrays in C, `each` that of all others, and of their shapes.
    """

    arrays: Collection[str]
    read: Collection[str]
    functions: Collection[str]
    prefix: str
    sizes: Mapping[str, str]
    each: str


class CFunction:
    """One function in C: its `head`, its `body`, and what its docstring `said`."""

    def __init__(self, node: ast.FunctionDef, names: CNames) -> None:
        self.names = names
        self.parameters = [argument.arg for argument in node.args.args]
        gives = any(
            isinstance(each, ast.Return) and each.value is not None for each in ast.walk(node)
        )
        kinds = (self._kind(name) for name in self.parameters)
        listed = ", ".join(
            f"{kind}{name}" for kind, name in zip(kinds, self.parameters, strict=True)
        )
        self.head = f"static {'double' if gives else 'void'} {names.prefix}{node.name}({listed})"
        self._counters, self._locals = set[str](), dict[str, None]()
        body = [line for each in node.body[1:] for line in self._statement(each)]
        declared = [f"double {name} = 0.0;" for name in self._locals]
        written = "\n".join(body)
        unused = [
            f"(void){name};" for name in self.parameters if not re.search(rf"\b{name}\b", written)
        ]
        self.body = textwrap.indent("\n".join([*declared, *unused, written]), "    ")
        self.said = (ast.get_docstring(node) or "").split("\n\n")[0]

    # -- statements -------------------------------------------------------------------------------
    def _statement(self, node: ast.stmt) -> list[str]:
        match node:
            case ast.Expr(value=ast.Call()):
                return [f"{self._value(node.value)};"]
            case ast.Return(value=value):
                return ["return;" if value is None else f"return {self._value(value)};"]
            case ast.Continue():
                return ["continue;"]
            case ast.If():
                lines = [f"if ({_bare(self._value(node.test))}) {{", *self._block(node.body)]
                if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
                    first, *rest = self._statement(node.orelse[0])
                    return [*lines, f"}} else {first}", *rest]
                return [
                    *lines,
                    *(["} else {", *self._block(node.orelse)] if node.orelse else []),
                    "}",
                ]
            case ast.For(target=ast.Name(id=name), orelse=[]):
                return self._loop(name, node)
            case ast.AugAssign(target=ast.Subscript() | ast.Name()):
                return [
                    f"{self._target(node.target)} {_symbol(node.op)}= {self._value(node.value)};"
                ]
            case ast.Assign():
                return self._assigned(node)
        raise _unknown(node)

    def _block(self, body: list[ast.stmt]) -> list[str]:
        return [f"    {line}" for each in body for line in self._statement(each)]

    def _loop(self, name: str, node: ast.For) -> list[str]:
        match node.iter:
            case ast.Call(func=ast.Name(id="range"), args=args) if not node.orelse:
                low, high = ("0", args[0]) if len(args) == 1 else (self._whole(args[0]), args[1])
                self._counters.add(name)
                head = f"for (int {name} = {low}; {name} < {self._whole(high)}; {name}++) {{"
                return [head, *self._block(node.body), "}"]
            case ast.Name(id=array) if array in self.names.arrays:
                self._counters.add(name)
                first = f"    const double {name} = {array}[at];"
                return [
                    f"for (int at = 0; at < {self.names.each}; at++) {{",
                    first,
                    *self._block(node.body),
                    "}",
                ]
        raise _unknown(node)

    def _assigned(self, node: ast.Assign) -> list[str]:
        first, *more = node.targets
        if isinstance(first, ast.Tuple) and not more:
            return self._several(first.elts, node.value)
        if self._is_array(first):
            return [f"double *{ast.unparse(first)} = {self._value(node.value)};"]
        return [f"{' = '.join(map(self._target, node.targets))} = {self._value(node.value)};"]

    def _several(self, targets: list[ast.expr], value: ast.expr) -> list[str]:
        """All values are made before one is given a name."""
        if isinstance(value, ast.IfExp):
            lines = [f"if ({self._value(value.test)}) {{"]
            lines += [f"    {line}" for line in self._several(targets, value.body)] + ["} else {"]
            return [*lines, *(f"    {line}" for line in self._several(targets, value.orelse)), "}"]
        if not isinstance(value, ast.Tuple) or len(value.elts) != len(targets):
            raise _unknown(value)
        pairs = [
            (target, self._value(each)) for target, each in zip(targets, value.elts, strict=True)
        ]
        arrays = [
            f"double *{ast.unparse(target)} = {each};"
            for target, each in pairs
            if self._is_array(target)
        ]
        pairs = [(target, each) for target, each in pairs if not self._is_array(target)]
        given = ", ".join(f"value_{i} = {each}" for i, (_, each) in enumerate(pairs))
        taken = [f"    {self._target(target)} = value_{i};" for i, (target, _) in enumerate(pairs)]
        return [*arrays, "{", f"    const double {given};", *taken, "}"] if pairs else arrays

    def _is_array(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id in self.names.arrays

    def _target(self, node: ast.expr) -> str:
        if (
            isinstance(node, ast.Name)
            and node.id not in self.parameters
            and node.id not in self._counters
        ):
            self._locals[node.id] = None
        return self._value(node)

    # -- expressions ------------------------------------------------------------------------------
    def _value(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=bool() | float() as value):
                return literal(value)
            case ast.Constant(value=int(value)):
                return str(value)
            case ast.Name(id=name):
                return name
            case ast.Attribute(value=ast.Name(id="np"), attr="inf"):
                return "INFINITY"
            case ast.UnaryOp(op=ast.USub() | ast.Not() as op, operand=operand):
                return f"{_symbol(op)}({self._value(operand)})"

            case ast.BoolOp(op=op, values=values):
                return f"({f' {_symbol(op)} '.join(self._value(each) for each in values)})"
            case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=among)]):
                return f"({' || '.join(f'{self._value(left)} == {self._value(each)}' for each in among)})"
            case (
                ast.BinOp(left=left, op=op, right=right)
                | ast.Compare(left=left, ops=[op], comparators=[right])
            ):
                return f"({self._value(left)} {_symbol(op)} {self._value(right)})"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"({self._value(test)} ? {self._value(body)} : {self._value(orelse)})"
            case ast.Subscript():
                return self._place(node)
            case ast.Call():
                return self._call(node)
        raise _unknown(node)

    def _place(self, node: ast.Subscript) -> str:
        match node:
            case ast.Subscript(value=ast.Attribute(attr="shape")):
                return self.names.each
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Slice(lower=None, step=None)):
                return name
            case ast.Subscript(
                value=ast.Name(id=name), slice=ast.Slice(lower=ast.expr() as lower, step=None)
            ):
                return f"{name} + {self._value(lower)}"
            case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=[row, column])):
                return f"{name}[{self._whole(row)} * {self.names.each} + {self._whole(column)}]"
            case ast.Subscript(value=ast.Name(id=name), slice=index) if not isinstance(
                index, ast.Slice
            ):
                return f"{name}[{self._whole(index)}]"
        raise _unknown(node)

    def _whole(self, node: ast.expr) -> str:
        """A value as an index."""
        value = _bare(self._value(node))
        known = value.isdigit() or value.isupper() or value in self._counters
        return value if known else f"(int)({value})"

    def _kind(self, name: str) -> str:
        constant = "const " if name in self.names.read else ""
        return f"{constant}double *" if name in self.names.arrays else "double "

    def _call(self, node: ast.Call) -> str:
        match node.func:
            case ast.Attribute(attr="reshape", value=value):
                return self._value(value)
            case ast.Name(id="len") if isinstance(node.args[0], ast.Name):
                return self.names.sizes.get(node.args[0].id, self.names.each)
        name = ast.unparse(node.func)
        if node.keywords or name not in (*_FUNCTIONS, *self.names.functions):
            raise _unknown(node)
        given = ", ".join(_bare(self._value(each)) for each in node.args)
        return f"{_FUNCTIONS.get(name, f'{self.names.prefix}{name}')}({given})"


def _bare(text: str) -> str:
    """A value without brackets around all of it."""
    depths = itertools.accumulate({"(": 1, ")": -1}.get(sign, 0) for sign in text[:-1])
    return text[1:-1] if text.startswith("(") and all(depths) else text


def _symbol(op: Any) -> str:
    if type(op) not in _OPERATORS:
        raise _unknown(op)
    return _OPERATORS[type(op)]


def _unknown(node: ast.AST) -> ValueError:
    said = ast.unparse(node) if isinstance(node, (ast.stmt, ast.expr)) else type(node).__name__
    return ValueError(
        f"what C is made of must be numbers, arrays and branches; got {said!r:.80}. Write it so."
    )

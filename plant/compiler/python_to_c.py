"""Python functions of numbers, arrays and records, which numba compiles, translated to C99.

A construct without a translation is refused, so that C and Python cannot drift apart. Every number
is a double, and an index of an array is cast; arrays and records are known by their names, which
mean the same in all functions. The caller's C has ``least`` and ``greatest`` of two numbers, which
are Python's min and max.
"""

import ast
import dataclasses
import itertools
import re
import textwrap
from collections.abc import Collection, Mapping
from typing import Any

from plant.compiler.c_statements import literal

# C's operators; constructs that are missing in these tables have no translation.
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

# Functions of C by the names of Python's; the last is a cast.
_FUNCTIONS = {
    "abs": "fabs",
    "min": "least",
    "max": "greatest",
    "math.ceil": "ceil",
    "np.ceil": "ceil",
    "np.floor": "floor",
    "int": "(int)",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class CNames:
    """Meanings of the names in the Python functions that become C.

    Parameters
    ----------
    arrays : collection of str
        Arrays of doubles, of this name in every function.
    read : collection of str
        Arrays that are only read.
    records : mapping of str to str
        Records, of this name in every function, and their C types; C has pointers to them.
    functions : collection of str
        Python functions that C has, too.
    prefix : str
        Beginning of the names of functions in C, whose library has a ``read``.
    sizes : mapping of str to str
        Lengths of arrays in C, by the Python expression of the array.
    length : str
        Length of all other arrays.
    """

    arrays: Collection[str]
    read: Collection[str]
    records: Mapping[str, str]
    functions: Collection[str]
    prefix: str
    sizes: Mapping[str, str]
    length: str


class CFunction:
    """One function in C: its `head`, its `body`, and the `summary` of its docstring."""

    def __init__(self, node: ast.FunctionDef, names: CNames) -> None:
        self.names = names
        self.parameters = [argument.arg for argument in node.args.args]
        declared = ", ".join(f"{self._kind(name)}{name}" for name in self.parameters)
        # A function that returns a value anywhere returns it everywhere: C has one type of result.
        returns = [inner.value for inner in ast.walk(node) if isinstance(inner, ast.Return)]
        kind = "double" if any(returns) else "void"
        self.head = f"static {kind} {names.prefix}{node.name}({declared})"
        self.summary = (ast.get_docstring(node) or "").split("\n\n")[0]

        # C declares the variables at the beginning; which they are is known after the statements.
        self._counters = set[str]()
        self._locals = dict[str, None]()
        # The docstring comes first; it becomes the comment of the C function.
        text = "\n".join(line for inner in node.body[1:] for line in self._statement(inner))
        # The initial value silences compilers that cannot see that every path assigns one.
        variables = [f"double {name} = 0.0;" for name in self._locals]
        unused = [
            f"(void){name};" for name in self.parameters if not re.search(rf"\b{name}\b", text)
        ]
        self.body = textwrap.indent("\n".join([*variables, *unused, text]), "    ")

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
                return self._branches(node)
            case ast.For(orelse=[]):
                return self._loop(node)
            case ast.AugAssign():
                operator = _symbol(node.op)
                return [f"{self._target(node.target)} {operator}= {self._value(node.value)};"]
            case ast.Assign(targets=[ast.Name(id=name)]) if name in self.names.records:
                return [self._pointer(name, self._value(node.value))]
            case ast.Assign(targets=[ast.Name() | ast.Attribute() | ast.Subscript() as target]):
                return [f"{self._target(target)} = {self._value(node.value)};"]
        raise _unknown(node)

    def _branches(self, node: ast.If) -> list[str]:
        lines = [f"if ({_bare(self._value(node.test))}) {{", *self._block(node.body)]
        # An elif is an if within the else of its tree.
        if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
            following = self._branches(node.orelse[0])
            return [*lines, f"}} else {following[0]}", *following[1:]]
        if node.orelse:
            lines += ["} else {", *self._block(node.orelse)]
        return [*lines, "}"]

    def _block(self, body: list[ast.stmt]) -> list[str]:
        return [f"    {line}" for node in body for line in self._statement(node)]

    def _loop(self, node: ast.For) -> list[str]:
        """A loop over numbers, or over an array of numbers or records, with or without numbers."""
        # A loop over elements alone needs a counter, too; the guards have no variable of this name.
        counter: Any = "at"
        element: Any = None
        array = node.iter
        match node.target, node.iter:
            case ast.Name(id=counter), ast.Call(func=ast.Name(id="range"), args=[number]):
                size = self._index(number)
            case (
                ast.Tuple(elts=[ast.Name(id=counter), ast.Name(id=element)]),
                ast.Call(func=ast.Name(id="enumerate"), args=[array]),
            ):
                size = self._length(array)
            case ast.Name(id=element), ast.Name() | ast.Attribute():
                size = self._length(array)
            case _:
                raise _unknown(node)
        # A counter is a whole number, so it needs no cast as an index.
        self._counters.add(counter)
        lines = [f"for (int {counter} = 0; {counter} < {size}; {counter}++) {{"]
        # Records are passed by their address, since the loop may change them; numbers are copied.
        if element in self.names.records:
            lines.append(f"    {self._pointer(element, f'{self._value(array)}[{counter}]')}")
        elif element is not None:
            self._counters.add(element)
            lines.append(f"    const double {element} = {self._value(array)}[{counter}];")
        return [*lines, *self._block(node.body), "}"]

    def _pointer(self, name: str, value: str) -> str:
        return f"{self.names.records[name]} *{name} = &{value.removeprefix('&')};"

    def _length(self, array: ast.expr) -> str:
        return self.names.sizes.get(ast.unparse(array), self.names.length)

    def _target(self, node: ast.expr) -> str:
        # Arguments and counters have declarations; every other name becomes a variable.
        if isinstance(node, ast.Name) and node.id not in {*self.parameters, *self._counters}:
            self._locals[node.id] = None
        return self._value(node)

    # -- expressions ------------------------------------------------------------------------------
    def _value(self, node: ast.expr) -> str:
        match node:
            # bool first: it is an int in Python, but a number here.
            case ast.Constant(value=bool() | float() as value):
                return literal(value)
            case ast.Constant(value=int(value)):
                return str(value)
            case ast.Name(id=name):
                return name
            case ast.Attribute(value=ast.Name(id="np"), attr="inf"):
                return "INFINITY"
            case ast.Attribute(value=ast.Name(id=name), attr=field) if name in self.names.records:
                # A record within a record is passed on by its address.
                address = "&" if field in self.names.records else ""
                return f"{address}{name}->{field}"
            case ast.Attribute(value=ast.Attribute() | ast.Subscript() as record, attr=field):
                return f"{self._value(record).removeprefix('&')}.{field}"
            case ast.Subscript(value=array, slice=ast.Tuple(elts=indices)):
                return self._value(array) + "".join(f"[{self._index(i)}]" for i in indices)
            case ast.Subscript(value=array, slice=index) if not isinstance(index, ast.Slice):
                return f"{self._value(array)}[{self._index(index)}]"
            case ast.UnaryOp(op=ast.USub() | ast.Not() as operator, operand=operand):
                return f"{_symbol(operator)}({self._value(operand)})"
            case ast.BoolOp(op=operator, values=values):
                # Parentheses around each operation keep Python's grouping.
                return f"({f' {_symbol(operator)} '.join(map(self._value, values))})"
            case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple(elts=among)]):
                text = self._value(left)
                return f"({' || '.join(f'{text} == {self._value(member)}' for member in among)})"
            case (
                ast.BinOp(left=left, op=operator, right=right)
                | ast.Compare(left=left, ops=[operator], comparators=[right])
            ):
                return f"({self._value(left)} {_symbol(operator)} {self._value(right)})"
            case ast.IfExp(test=test, body=body, orelse=orelse):
                return f"({self._value(test)} ? {self._value(body)} : {self._value(orelse)})"
            case ast.Call():
                return self._call(node)
        raise _unknown(node)

    def _index(self, node: ast.expr) -> str:
        """A value as an index: all but counters, sizes and constants is cast."""
        value = _bare(self._value(node))
        # Capitals are constants of an enum.
        is_whole = value.isdigit() or value.isupper() or value in self._counters
        return value if is_whole else f"(int)({value})"

    def _kind(self, name: str) -> str:
        if name in self.names.records:
            return f"{self.names.records[name]} *"
        constant = "const " if name in self.names.read else ""
        return f"{constant}double *" if name in self.names.arrays else "double "

    def _call(self, node: ast.Call) -> str:
        name = ast.unparse(node.func)
        if name == "len" and len(node.args) == 1:
            return self._length(node.args[0])
        if node.keywords or name not in (*_FUNCTIONS, *self.names.functions):
            raise _unknown(node)
        arguments = ", ".join(_bare(self._value(argument)) for argument in node.args)
        return f"{_FUNCTIONS.get(name, f'{self.names.prefix}{name}')}({arguments})"


def _bare(text: str) -> str:
    """A value without the parentheses around all of it, if it has any."""
    # The depth of parentheses after each character but the last: if it never falls to zero, the
    # first parenthesis ends with the text.
    depths = itertools.accumulate({"(": 1, ")": -1}.get(sign, 0) for sign in text[:-1])
    return text[1:-1] if text.startswith("(") and all(depths) else text


def _symbol(op: Any) -> str:
    if type(op) not in _OPERATORS:
        raise _unknown(op)
    return _OPERATORS[type(op)]


def _unknown(node: ast.AST) -> ValueError:
    text = ast.unparse(node) if isinstance(node, (ast.stmt, ast.expr)) else type(node).__name__
    return ValueError(
        f"what C is made of must be numbers, arrays and branches; got {text!r:.80}. Write it so."
    )

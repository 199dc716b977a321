"""How the pages of a tree of Python packages read, in numbers: counted the same way for any tree.

A code line is a physical line that holds a token which is neither a comment nor part of a
docstring. Tokens are names, numbers, operators and strings of one line. A binding is a name that is
assigned to, or an argument. A private number constant is a module-level name such as ``_LIMIT``
that is bound to nothing but numbers.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

FILLER = frozenset(
    [
        "each",
        "own",
        "some",
        "other",
        "others",
        "found",
        "told",
        "said",
        "made",
        "left",
        "given",
        "kept",
        "known",
        "first",
        "last",
        "whole",
        "before",
        "after",
        "more",
        "there",
        "here",
        "those",
        "what",
        "which",
        "such",
        "way",
    ]
)
"""Words that name no concept of the field when a variable is called by them alone."""

TOKENS = (tokenize.NAME, tokenize.NUMBER, tokenize.OP, tokenize.STRING)
LAYOUT = (tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
# From Python 3.12 on an f-string is several tokens; counted as one, as older versions have it.
FSTRING_START = getattr(tokenize, "FSTRING_START", None)
FSTRING_END = getattr(tokenize, "FSTRING_END", None)

NUMBERS = (
    ast.Constant,
    ast.BinOp,
    ast.UnaryOp,
    ast.Tuple,
    ast.List,
    ast.operator,
    ast.unaryop,
    ast.expr_context,
)


@dataclass(frozen=True)
class Token:
    """A token of a page: its kind, its text, its first and last line."""

    kind: int
    text: str
    begin: int
    end: int


@dataclass
class Reading:
    """Sums over the files of a tree; the properties are what a table shows."""

    files: int = 0
    code_lines: int = 0
    docstring_lines: int = 0
    tokens: int = 0
    comments: int = 0
    characters: int = 0
    filled_lines: int = 0
    constants: int = 0
    bindings: int = 0
    filler_bindings: int = 0
    format_skips: int = 0
    starred_targets: int = 0
    longest_function: int = 0
    longest_name: str = ""

    @property
    def tokens_per_line(self) -> float:
        return self.tokens / self.code_lines

    @property
    def line_length(self) -> float:
        return self.characters / self.filled_lines

    @property
    def comments_per_100(self) -> float:
        return 100 * self.comments / self.code_lines

    @property
    def filler_percent(self) -> float:
        return 100 * self.filler_bindings / self.bindings


def tokens_of(text: str) -> Iterator[Token]:
    """Tokens of a page, an f-string as one."""
    depth = 0
    begin = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == FSTRING_START:
            begin = begin if depth else token.start[0]
            depth += 1
        elif token.type == FSTRING_END:
            depth -= 1
            if not depth:
                string = "f" if begin == token.end[0] else "\n"
                yield Token(tokenize.STRING, string, begin, token.end[0])
        elif not depth:
            yield Token(token.type, token.string, token.start[0], token.end[0])


def docstring_lines(tree: ast.AST) -> set[int]:
    """Lines of all strings that stand alone as a statement."""
    lines: set[int] = set()
    for node in ast.walk(tree):
        value = node.value if isinstance(node, ast.Expr) else None
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            lines |= set(range(node.lineno, node.end_lineno + 1))
    return lines


def is_number(value: ast.expr) -> bool:
    """Whether an expression is made of nothing but numbers, signs and tuples of them."""
    nodes = list(ast.walk(value))
    constants = [node.value for node in nodes if isinstance(node, ast.Constant)]
    return (
        all(isinstance(node, NUMBERS) for node in nodes)
        and bool(constants)
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in constants)
    )


def private_numbers(tree: ast.Module) -> list[str]:
    """Names of the private number constants of a module."""
    names = []
    for statement in tree.body:
        if isinstance(statement, ast.Assign):
            (target, *_) = statement.targets
            value = statement.value
        elif isinstance(statement, ast.AnnAssign) and statement.value is not None:
            target = statement.target
            value = statement.value
        else:
            continue
        if is_number(value):
            elements = target.elts if isinstance(target, ast.Tuple | ast.List) else [target]
            names += [x.id for x in elements if isinstance(x, ast.Name)]
    return [name for name in names if re.fullmatch(r"_[A-Z][A-Z0-9_]*", name)]


def bound_names(tree: ast.AST) -> Iterator[str]:
    """Every name that is assigned to, and every argument."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def starred_targets(tree: ast.AST) -> int:
    """Number of targets such as ``*b`` in ``a, *b = ...``: their length is known to nobody."""
    nodes = (node for node in ast.walk(tree) if isinstance(node, ast.Starred))
    return sum(isinstance(node.ctx, ast.Store) for node in nodes)


def read_file(path: Path, name: str, total: Reading) -> None:
    """Add a file to a reading."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    documented = docstring_lines(tree)
    code: set[int] = set()
    for token in tokens_of(text):
        if token.kind == tokenize.COMMENT:
            total.comments += 1
        elif token.kind not in LAYOUT:
            code |= set(range(token.begin, token.end + 1))
        several_lines = token.kind == tokenize.STRING and "\n" in token.text
        total.tokens += token.kind in TOKENS and not several_lines
    code -= documented

    filled = [line for line in text.splitlines() if line.strip()]
    names = list(bound_names(tree))
    total.files += 1
    total.code_lines += len(code)
    total.docstring_lines += len(documented)
    total.characters += sum(map(len, filled))
    total.filled_lines += len(filled)
    total.constants += len(private_numbers(tree))
    total.bindings += len(names)
    total.filler_bindings += sum(x in FILLER for x in names)
    total.format_skips += text.count("# fmt: skip")
    total.starred_targets += starred_targets(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = len(code & set(range(node.lineno, node.end_lineno + 1)))
            if length > total.longest_function:
                total.longest_function = length
                total.longest_name = f"{name}: {node.name}"


def read(root: Path, packages: Iterable[str]) -> Reading:
    """The reading of these packages in a tree."""
    total = Reading()
    for package in packages:
        for path in sorted((root / package).rglob("*.py")):
            read_file(path, path.relative_to(root).as_posix(), total)
    return total

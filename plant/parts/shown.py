"""Display of results: a text of 80 columns, HTML in a notebook, one short line as `repr`.

A result defines its pieces once, the verdict first (`Shown._shown`), and a summary in one line
(`Shown._short`).
"""

import dataclasses
import html
from collections.abc import Iterable, Iterator, Sequence

from plant.parts.tables import Table, wrapped

_INDENT = "    "

# Colours of text and ground are the page's own, light or dark.
_STYLE = """
.onepulse table { border-collapse: collapse; border: 0; margin: .5em 0; \
font-variant-numeric: tabular-nums; }
.onepulse th, .onepulse td { padding: .2em .9em .2em 0; border: 0; \
border-bottom: 1px solid rgba(128, 128, 128, .4);
  text-align: left; vertical-align: top; }
.onepulse th { vertical-align: bottom; }
.onepulse .number { text-align: right; }
.onepulse td.number { white-space: nowrap; }
.onepulse .wide { overflow-x: auto; }
.onepulse .verdict { border-left: .35em solid #808080; padding-left: .6em; \
margin: .3em 0; max-width: 60em; }
.onepulse .good { border-color: #2e9e62; }
.onepulse .bad { border-color: #d5602f; }
.onepulse p, .onepulse ul { margin: .3em 0; max-width: 60em; }
.onepulse pre { overflow-x: auto; }
"""


@dataclasses.dataclass(frozen=True)
class Verdict:
    """The main statement of a result; `good` is None where nothing is judged."""

    sentence: str
    good: bool | None = None


@dataclasses.dataclass(frozen=True)
class Warned:
    """Warnings, a line each."""

    warnings: Sequence[str]


@dataclasses.dataclass(frozen=True)
class Aside:
    """Lines that few need, such as what the names of parameters mean; folded in a notebook."""

    title: str
    lines: Sequence[str]


Piece = str | Table | Verdict | Warned | Aside  # of what a result shows; a str is a sentence


class Shown:
    """Base of results: printed as text of at most 80 columns, shown as HTML in a notebook.

    A dataclass that derives from it has ``repr=False``.
    """

    def _shown(self) -> Iterable[Piece]:
        """Pieces of its display, the verdict first."""
        # Abstract, but without abc: results are frozen dataclasses that also derive from other
        # bases.
        raise NotImplementedError(f"{type(self).__name__} must say what it shows. Define _shown.")

    def _short(self) -> str:
        """Text between the brackets of its `repr`."""
        raise NotImplementedError(f"{type(self).__name__} must say itself in short. Define _short.")

    def __repr__(self) -> str:
        name = type(self).__name__
        # On one line: a repr stands in lists and in tracebacks.
        short = " ".join(self._short().split())
        room = 100 - len(f"{name}()")  # a list of results shows each within 100 letters
        if len(short) > room:
            short = f"{short[: room - 4]} ..."
        return f"{name}({short})"

    def __str__(self) -> str:
        return as_text(self._shown())

    def _repr_html_(self) -> str:
        return f'<div class="onepulse">\n<style>{_STYLE}</style>\n{body(self)}\n</div>'


def as_text(pieces: Iterable[Piece]) -> str:
    """Lines of no more than 80 columns."""
    return "\n".join(line for piece in pieces for line in _lines(piece))


def inside(result: Shown) -> Iterator[Piece]:
    """Pieces of a result within another one: its verdict becomes an ordinary sentence."""
    yield from (
        piece.sentence if isinstance(piece, Verdict) else piece for piece in result._shown()
    )


def body(result: Shown) -> str:
    """HTML of a result without a style, for a page that has its own."""
    # Text and HTML come from the same pieces, so they cannot contradict each other.
    return "\n".join(_html(part) for part in result._shown())


def _lines(part: Piece) -> Iterator[str]:
    if isinstance(part, str):
        # Indented: only verdicts and tables begin at the margin, where the eye looks first.
        yield from wrapped(part, indent=_INDENT)
    elif isinstance(part, Table):
        yield from part.lines()
    elif isinstance(part, Verdict):
        yield from wrapped(part.sentence)
    elif isinstance(part, Warned):
        for warning in part.warnings:
            yield from wrapped(f"warning: {warning}", indent=_INDENT)
    else:
        for line in part.lines:
            yield from wrapped(line, indent=_INDENT)


def _html(part: Piece) -> str:
    if isinstance(part, str):
        return f"<p>{text(part)}</p>"
    if isinstance(part, Table):
        return table(part.head, part.rows, (0, *part.words)) if part.rows else ""
    if isinstance(part, Verdict):
        # The mark repeats the colour for those who cannot see it.
        kind = {None: "", True: " good", False: " bad"}[part.good]
        mark = {None: "", True: "✓ ", False: "✗ "}[part.good]
        return f'<p class="verdict{kind}"><b>{mark}{text(part.sentence)}</b></p>'
    if isinstance(part, Warned):
        return items([f"warning: {warning}" for warning in part.warnings]) if part.warnings else ""
    return details(part.title, preformatted("\n".join(part.lines))) if part.lines else ""


_NUMBER = ' class="number"'


def text(value: object) -> str:
    """Escaped text."""
    return html.escape(str(value))


def items(lines: Iterable[str], kind: str = "") -> str:
    """A list of texts."""
    rows = "\n".join(f"<li>{text(line)}</li>" for line in lines)
    return f'<ul class="{kind}">\n{rows}\n</ul>' if kind else f"<ul>\n{rows}\n</ul>"


def table(
    head: Sequence[str], rows: Iterable[Sequence[object]], words: Sequence[int] = (0,)
) -> str:
    """HTML table that scrolls inside a narrow page.

    The columns `words` hold text; all others hold numbers, which are set to the right.
    """

    def row(tag: str, cells: Sequence[object]) -> str:
        # A unit must not break over two lines.
        kinds = ("" if i in words else _NUMBER for i in range(len(cells)))
        texts = (text(cell).replace("N m", "N&nbsp;m") for cell in cells)
        return (
            "<tr>"
            + "".join(f"<{tag}{k}>{c}</{tag}>" for k, c in zip(kinds, texts, strict=True))
            + "</tr>"
        )

    # A table without titles needs no empty head.
    above = f"<thead>{row('th', head)}</thead>\n" if any(head) else ""
    below = "\n".join(row("td", cells) for cells in rows)
    return f'<div class="wide"><table>\n{above}<tbody>\n{below}\n</tbody></table></div>'


def preformatted(value: str) -> str:
    """Code or a table of text."""
    return f"<pre>{text(value)}</pre>"


def details(summary: str, *parts: str) -> str:
    """A folded section with a summary, which a printed page shows unfolded."""
    return f"<details>\n<summary>{text(summary)}</summary>\n" + "\n".join(parts) + "\n</details>"

"""HTML: escaped text, tables, lists, what folds. For pages of a report, and for results in notebooks."""

import html
from collections.abc import Iterable, Sequence

_NUMBER = ' class="number"'


def text(value: object) -> str:
    """Escaped text."""
    return html.escape(str(value))


def items(lines: Iterable[str], kind: str = "") -> str:
    """A list of texts."""
    rows = "\n".join(f"<li>{text(line)}</li>" for line in lines)
    return f'<ul class="{kind}">\n{rows}\n</ul>' if kind else f"<ul>\n{rows}\n</ul>"


def table(head: Sequence[str], rows: Iterable[Sequence[object]], words: Sequence[int] = (0,)) -> str:
    """A table that scrolls inside a narrow page; these columns hold words, the others numbers, to the right."""

    def row(tag: str, cells: Sequence[object]) -> str:
        kinds = ("" if i in words else _NUMBER for i in range(len(cells)))
        said = (text(cell).replace("N m", "N&nbsp;m") for cell in cells)
        return "<tr>" + "".join(f"<{tag}{k}>{c}</{tag}>" for k, c in zip(kinds, said, strict=True)) + "</tr>"

    above = f"<thead>{row('th', head)}</thead>\n" if any(head) else ""
    below = "\n".join(row("td", cells) for cells in rows)
    return f'<div class="wide"><table>\n{above}<tbody>\n{below}\n</tbody></table></div>'


def preformatted(value: str) -> str:
    """Code or a table of text."""
    return f"<pre>{text(value)}</pre>"


def details(summary: str, *parts: str) -> str:
    """What is folded until it is asked for; open on paper."""
    return f"<details>\n<summary>{text(summary)}</summary>\n" + "\n".join(parts) + "\n</details>"

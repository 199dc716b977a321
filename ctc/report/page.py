"""An HTML page: sections, figures as inline SVG, one style for screens, phones and paper."""

import io
import re
from collections.abc import Iterable
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from plant.parts import text

# Template of the page, with its style.
_PAGE = Path(__file__).with_suffix(".html")


def page(title: str, subtitle: str, parts: Iterable[str]) -> str:
    """A page of these parts."""
    template = Template(_PAGE.read_text(encoding="utf-8"))
    return template.substitute(title=text(title), subtitle=text(subtitle), parts="\n".join(parts))


def section(title: str, *parts: str) -> str:
    """A section with its heading."""
    return f"<section>\n<h2>{text(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def figure(drawing: Any, label: str, caption: str) -> str:
    """The figure of some Axes as inline SVG, whose text stays text; the figure is closed.

    The caption of the page replaces the title above the Axes and the text below them. Curves keep
    only the points that a page can show.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    # 1. Take away both, and the height of the text below: 0.14 inch a line at its size.
    drawing = np.ravel(drawing)[0].figure
    lines = drawing.get_supxlabel().splitlines()
    drawing.set_size_inches(drawing.get_figwidth(), drawing.get_figheight() - 0.14 * len(lines))
    drawing.suptitle("")
    drawing.supxlabel("")

    # 2. Lay out once with the full curves: their extent decides the axes, and thinning follows
    # the pixels of a fixed layout.
    drawing.draw_without_rendering()
    drawing.set_layout_engine("none")
    for axis in drawing.axes:
        for line in axis.lines:
            thin(line, axis)

    # 3. Text that a browser can select and search; no date and no random ids, so that the same
    # results give the same page.
    style: Any = {"svg.fonttype": "none", "svg.hashsalt": label, "font.sans-serif": ["DejaVu Sans"]}
    stream = io.StringIO()
    with mpl.rc_context(style):
        drawing.savefig(stream, format="svg", metadata={"Date": None})
    plt.close(drawing)
    svg = _short(stream.getvalue(), re.sub(r"\W+", "-", label.lower()))
    # Screen readers read the label in place of the drawing.
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{text(label)}"', 1)
    return (
        f'<figure>\n<div class="drawing">{svg}</div>\n'
        f"<figcaption>{text(caption)}</figcaption>\n</figure>"
    )


def thin(line: Any, axis: Any) -> None:
    """Keep the minimum and the maximum of a long curve in each column of its axis, in order."""
    # Forty columns to an inch: finer than a screen shows a line. Chosen by hand.
    columns = int(axis.get_window_extent().width / axis.figure.dpi * 40)
    x, y = (np.asarray(values) for values in line.get_data())
    # Two points a column save little of a short curve; a curve that turns back has no columns.
    if len(x) <= 4 * columns or (np.diff(x) <= 0).any():
        return
    # On the screen, since the axis may be logarithmic; no place in x depends on y.
    along = axis.transData.transform(np.column_stack([x, np.ones(len(x))]))[:, 0]
    column = np.floor((along - along[0]) / (along[-1] - along[0]) * columns).astype(int)
    # A missing sample (NaN) is neither extreme: only a column without any other stays a gap.
    low = np.where(np.isnan(y), np.inf, y)
    high = np.where(np.isnan(y), -np.inf, y)
    points: list[int] = []
    for part in np.split(np.arange(len(x)), np.flatnonzero(np.diff(column)) + 1):
        # One point where both are the same; in order of x, so that the curve does not turn back.
        points += sorted({int(part[low[part].argmin()]), int(part[high[part].argmax()])})
    line.set_data(x[points], y[points])
    # Steps between such points would draw blocks.
    line.set_drawstyle("default")


def _short(svg: str, key: str) -> str:
    """The same drawing in a shorter SVG; classes and ids begin with `key`.

    Coordinates have tenths of a point, and one class stands for each style.
    """
    # 1. What only a file of its own needs: prologue, metadata, comments, namespaces.
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    # 2. Turns by nothing, and digits that no screen shows.
    svg = re.sub(r' transform="rotate\(-0 [^)]*\)"', "", svg)
    svg = re.sub(
        r' (d|x|y|transform)="[^"]*"', lambda match: re.sub(r"-?\d+\.\d+", _tenths, match[0]), svg
    )
    # 3. White space: letters separate the numbers of a path by themselves.
    svg = re.sub(
        r'(?<= d=")[^"]*', lambda match: re.sub(r"\s*([A-Za-z])\s*", r"\1", match[0].strip()), svg
    )
    svg = re.sub(r"\s+", " ", svg)
    # 4. Ids that nothing refers to.
    used = set(re.findall(r'#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda match: match[0] if match[1] in used else "", svg)
    # 5. A number for each style, as a class; its text then stands once in the drawing.
    styles: dict[str, int] = {}
    svg = re.sub(
        r' style="([^"]*)"',
        lambda match: f' class="{key}-{styles.setdefault(match[1], len(styles))}"',
        svg,
    )
    # Figures share one page: the key keeps their ids apart.
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", svg)
    rules = "".join(f".{key}-{number}{{{style}}}" for style, number in styles.items())
    return svg.replace("</svg>", f"<style>{rules}</style></svg>")


def _tenths(match: re.Match[str]) -> str:
    return f"{float(match[0]):.1f}".removesuffix(".0")

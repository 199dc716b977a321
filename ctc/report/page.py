"""The page itself: sections, figures as inline SVG, and one style for screens, phones and paper."""

import io
import re
from collections.abc import Iterable
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from plant.parts.shown import text

_LINE = 0.14  # height of a line below the Axes of a figure [inch]
_PLACES = 40  # along an axis, per inch
_PAGE = Path(__file__).with_suffix(".html")  # template of it, with its style


def page(title: str, subtitle: str, parts: Iterable[str]) -> str:
    """The whole page."""
    template = Template(_PAGE.read_text(encoding="utf-8"))
    return template.substitute(title=text(title), subtitle=text(subtitle), parts="\n".join(parts))


def section(title: str, *parts: str) -> str:
    """A section with its heading."""
    return f"<section>\n<h2>{text(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def figure(drawing: Any, says: str, caption: str) -> str:
    """The figure of some Axes as inline SVG, with text as text; closed afterwards.

    What stands above and below them is said by the page, in words. Curves have what a page can show
    of them.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    stream = io.StringIO()
    drawing = np.ravel(drawing)[0].figure
    below = drawing.get_supxlabel()
    drawing.set_size_inches(
        drawing.get_figwidth(), drawing.get_figheight() - _LINE * len(below.splitlines())
    )
    drawing.suptitle("")
    drawing.supxlabel("")
    drawing.draw_without_rendering()
    drawing.set_layout_engine("none")  # is laid out
    for axis in drawing.axes:
        for line in axis.lines:
            _thin(line, axis)
    with mpl.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": says, "font.sans-serif": ["DejaVu Sans"]}
    ):
        drawing.savefig(stream, format="svg", metadata={"Date": None})
    plt.close(drawing)
    svg = _short(stream.getvalue(), re.sub(r"\W+", "-", says.lower()))
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{text(says)}"', 1)
    return (
        "<figure>\n<div"
        f' class="drawing">{svg}</div>\n<figcaption>{text(caption)}</figcaption>\n</figure>'
    )


def _thin(line: Any, axis: Any) -> None:
    """Keep two points of a long curve per place of its axis, the least and the largest, in their
    order.
    """
    places = int(axis.get_window_extent().width / axis.figure.dpi * _PLACES)
    x, y = (np.asarray(values) for values in line.get_data())
    if len(x) <= 4 * places or (np.diff(x) <= 0).any():
        return
    along = axis.transData.transform(np.column_stack([x, y]))[:, 0]
    own = np.floor((along - along[0]) / (along[-1] - along[0]) * places).astype(int)
    parts = np.split(np.arange(len(x)), np.flatnonzero(np.diff(own)) + 1)
    kept = [
        i
        for part in parts
        for i in sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})
    ]
    line.set_data(x[kept], y[kept])
    line.set_drawstyle("default")


def _short(svg: str, key: str) -> str:
    """An SVG with the same drawing in less text: tenths of a point, one class for one style; ids
    begin with `key`.
    """
    styles: dict[str, int] = {}
    svg = re.sub(
        r"<metadata>.*?</metadata>|<!--.*?-->", "", svg[svg.index("<svg") :], flags=re.DOTALL
    )
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r' transform="rotate\(-0 [^)]*\)"', "", svg)
    svg = re.sub(
        r' (d|x|y|transform)="[^"]*"', lambda found: re.sub(r"-?\d+\.\d+", _tenths, found[0]), svg
    )
    svg = re.sub(
        r'(?<= d=")[^"]*', lambda found: re.sub(r"\s*([A-Za-z])\s*", r"\1", found[0].strip()), svg
    )
    svg = re.sub(r"\s+", " ", svg)
    used = set(re.findall(r'#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in used else "", svg)
    svg = re.sub(
        r' style="([^"]*)"',
        lambda found: f' class="{key}-{styles.setdefault(found[1], len(styles))}"',
        svg,
    )
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", svg)
    rules = "".join(f".{key}-{place}{{{style}}}" for style, place in styles.items())
    return svg.replace("</svg>", f"<style>{rules}</style></svg>")


def _tenths(found: re.Match[str]) -> str:
    return f"{float(found[0]):.1f}".removesuffix(".0")

"""The page itself: sections, figures as inline SVG, and one style for screens, phones and paper."""

import io
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from plant.parts.markup import text

_LINE = 0.14
"""Height of a line below the Axes of a figure [inch]."""

_PLACES = 40
"""Along an axis, per inch."""

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 62rem; background: #fff; color: #1c2326;
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; padding-bottom: .25rem; border-bottom: 1px solid #d8dcdd; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { margin: .5rem 0; max-width: 46rem; }
.sub { color: #59666b; margin: 0; }
ul { margin: .4rem 0; padding-left: 1.2rem; max-width: 50rem; }
li { margin: .25rem 0; overflow-wrap: anywhere; }
.verdict { list-style: none; padding: 0; margin: 1.2rem 0; max-width: none; }
.verdict li { margin: 0 0 .5rem; padding: .6rem .9rem; border-left: 5px solid #8a979c; background: #f4f6f6; }
.verdict li.good { border-color: #2c7a4b; }
.verdict li.bad { border-color: #b3401f; background: #fbf2ee; }
.verdict b { display: block; }
.wide { overflow-x: auto; margin: .6rem 0; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .28rem .7rem .28rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #e6e9ea; }
th { font-weight: 600; white-space: nowrap; }
td.number, th.number { text-align: right; white-space: nowrap; }
figure { margin: 1rem 0; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { color: #59666b; font-size: .9rem; max-width: 46rem; }
.drawing { overflow-x: auto; }
.drawing svg { min-width: 42rem; }
pre { overflow-x: auto; background: #f4f6f6; padding: .8rem; font: 13px/1.45 ui-monospace, Menlo, Consolas, monospace; }
details { margin: .6rem 0; }
summary { cursor: pointer; color: #1f6f8b; }
@media (max-width: 36rem) {
  table { font-size: .8rem; }
  th, th.number { white-space: normal; }
}
@media print {
  body { max-width: none; padding: 0; font-size: 10.5pt; }
  h2 { break-after: avoid; }
  figure, tr, .verdict li { break-inside: avoid; }
  .wide, .drawing { overflow: visible; }
  .drawing svg { min-width: 0; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
}
"""


def page(title: str, subtitle: str, parts: Iterable[str]) -> str:
    """The whole page."""
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{text(title)}</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<header>\n<h1>{text(title)}</h1>\n"
        f'<p class="sub">{text(subtitle)}</p>\n</header>\n<main>\n' + "\n".join(parts) + "\n</main>\n</body>\n</html>\n"
    )


def section(title: str, *parts: str) -> str:
    """A section with its heading."""
    return f"<section>\n<h2>{text(title)}</h2>\n" + "\n".join(parts) + "\n</section>"


def figure(drawing: Any, says: str, caption: str) -> str:
    """The figure of some Axes as inline SVG, with text as text; closed afterwards.

    What stands above and below them is said by the page, in words. Curves have what a page can show of them.
    """
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    stream, drawing = io.StringIO(), np.ravel(drawing)[0].figure
    below = drawing.get_supxlabel()
    drawing.set_size_inches(drawing.get_figwidth(), drawing.get_figheight() - _LINE * len(below.splitlines()))
    drawing.suptitle("")
    drawing.supxlabel("")
    drawing.draw_without_rendering()
    drawing.set_layout_engine("none")  # is laid out
    for axis in drawing.axes:
        for line in axis.lines:
            _thin(line, axis)
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": says, "font.sans-serif": ["DejaVu Sans"]}):
        drawing.savefig(stream, format="svg", metadata={"Date": None})
    plt.close(drawing)
    svg = _short(stream.getvalue(), re.sub(r"\W+", "-", says.lower()))
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{text(says)}"', 1)
    return f'<figure>\n<div class="drawing">{svg}</div>\n<figcaption>{text(caption)}</figcaption>\n</figure>'


def _thin(line: Any, axis: Any) -> None:
    """Keep two points of a long curve per place of its axis, the least and the largest, in their order."""
    places = int(axis.get_window_extent().width / axis.figure.dpi * _PLACES)
    x, y = (np.asarray(values) for values in line.get_data())
    if len(x) <= 4 * places or (np.diff(x) <= 0).any():
        return
    along = axis.transData.transform(np.column_stack([x, y]))[:, 0]
    own = np.floor((along - along[0]) / (along[-1] - along[0]) * places).astype(int)
    parts = np.split(np.arange(len(x)), np.flatnonzero(np.diff(own)) + 1)
    kept = [i for part in parts for i in sorted({int(part[y[part].argmin()]), int(part[y[part].argmax()])})]
    line.set_data(x[kept], y[kept])
    line.set_drawstyle("default")


def _short(svg: str, key: str) -> str:
    """An SVG with the same drawing in less text: tenths of a point, one class for one style; ids begin with `key`."""
    styles: dict[str, int] = {}
    svg = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", svg[svg.index("<svg") :], flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    svg = re.sub(r' transform="rotate\(-0 [^)]*\)"', "", svg)
    svg = re.sub(r' (d|x|y|transform)="[^"]*"', lambda found: re.sub(r"-?\d+\.\d+", _tenths, found[0]), svg)
    svg = re.sub(r'(?<= d=")[^"]*', lambda found: re.sub(r"\s*([A-Za-z])\s*", r"\1", found[0].strip()), svg)
    svg = re.sub(r"\s+", " ", svg)
    used = set(re.findall(r'#([^")]+)', svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in used else "", svg)
    svg = re.sub(r' style="([^"]*)"', lambda found: f' class="{key}-{styles.setdefault(found[1], len(styles))}"', svg)
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", svg)
    rules = "".join(f".{key}-{place}{{{style}}}" for style, place in styles.items())
    return svg.replace("</svg>", f"<style>{rules}</style></svg>")


def _tenths(found: re.Match[str]) -> str:
    return f"{float(found[0]):.1f}".removesuffix(".0")

"""The page itself: sections, figures as inline SVG, and one style for screens, phones and paper."""

import io
import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from plant.parts.markup import text

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
.drawing svg { min-width: 36rem; }
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
    """The figure of some Axes as inline SVG, with text as text; closed afterwards."""
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    stream, drawing = io.StringIO(), np.ravel(drawing)[0].figure
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": says, "font.family": "sans-serif"}):
        drawing.savefig(stream, format="svg", metadata={"Date": None})
    plt.close(drawing)
    svg = stream.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = re.sub(r'\s+xmlns(:\w+)?="[^"]*"', "", svg).replace("xlink:href", "href")
    key = re.sub(r"\W+", "-", says.lower())
    svg = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{key}-", svg)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{text(says)}"', 1)
    return f'<figure>\n<div class="drawing">{svg}</div>\n<figcaption>{text(caption)}</figcaption>\n</figure>'

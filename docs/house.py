"""The house in one picture: packages as houses, layers of pyproject.toml as floors, `python
docs/house.py` draws it.
"""

import ast
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT = Path(__file__).resolve().parent.parent
PICTURE = Path(__file__).with_name("images") / "house.png"
HOUSES = {"plant": "#dfeaf0", "identification": "#f5e3dd", "ctc": "#e6eddc"}
TO_PLAIN = {ord("\n"): " ", ord("`"): None}
HIDDEN = ("version", "__main__")


def floors():
    """Package -> its floors from the ground up, each a list of rooms."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"][
        "contracts"
    ]
    found = {}
    for contract in contracts:
        for package in contract.get("containers", ()):
            rows = [
                [room.strip() for room in row.split("|")] for row in reversed(contract["layers"])
            ]
            found[package] = [
                kept for row in rows if (kept := [room for room in row if room not in HIDDEN])
            ]
    return found


def sentence(package, room):
    """The first sentence of what a room says of itself."""
    path = ROOT / package / room
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return (
        ast.get_docstring(ast.parse(file.read_text(encoding="utf-8")))
        .split("\n\n")[0]
        .translate(TO_PLAIN)
    )


def wrapped(text, width):
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] += word + " "
    return "\n".join(lines)


def draw():
    """The figure."""
    tallest = max(map(len, floors().values()))
    figure, axis = plt.subplots(figsize=(13.5, 0.87 * (tallest + 0.85)), layout="constrained")
    high, left = 0.86, 0.0
    for package, width in (("plant", 4.6), ("identification", 3.5), ("ctc", 3.3)):
        rows = floors()[package]
        axis.add_patch(
            FancyBboxPatch(
                (left, 0),
                width,
                len(rows),
                boxstyle="round,pad=0.05",
                fc=HOUSES[package],
                ec="none",
            )
        )
        axis.text(
            left + width / 2, len(rows) + 0.25, package, ha="center", fontsize=15, weight="bold"
        )
        for floor, rooms in enumerate(rows):
            wide = width / len(rooms)
            for place, room in enumerate(rooms):
                x, y = left + place * wide + 0.06, floor + 0.07
                box = FancyBboxPatch(
                    (x, y),
                    wide - 0.12,
                    high,
                    boxstyle="round,pad=0,rounding_size=0.06",
                    fc="white",
                    ec="0.55",
                )
                axis.add_patch(box)
                axis.text(
                    x + 0.1,
                    y + high - 0.1,
                    room,
                    va="top",
                    fontsize=11,
                    weight="bold",
                    color="#1f3a4d",
                )
                text = wrapped(sentence(package, room), int(17 * (wide - 0.2)))
                axis.text(
                    x + 0.1,
                    y + high - 0.34,
                    text,
                    va="top",
                    fontsize=8,
                    linespacing=1.1,
                    color="0.2",
                )
        left += width + 0.85
    for x, y, text in ((5.02, 7.4, "Record"), (9.37, 5.4, "Arm\n(f found)")):
        arrow = FancyArrowPatch(
            (x - 0.34, y),
            (x + 0.37, y),
            arrowstyle="-|>,head_width=5,head_length=7",
            lw=2,
            color="#c8553d",
        )
        axis.add_patch(arrow)
        axis.text(x + 0.02, y + 0.12, text, ha="center", va="bottom", fontsize=10, color="#c8553d")
    axis.text(
        left - 0.85,
        tallest + 0.35,
        "A folder imports only from folders below it and from the packages on its left.",
        ha="right",
        fontsize=10,
        style="italic",
        color="0.3",
    )
    axis.set_xlim(-0.1, left - 0.75)
    axis.set_ylim(-0.15, tallest + 0.7)
    axis.set_axis_off()
    return figure


if __name__ == "__main__":
    draw().savefig(PICTURE, dpi=110)

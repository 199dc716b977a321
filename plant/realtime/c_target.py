"""A running controller in C for a microcontroller: its processors, single precision, the same bits everywhere.

With the elementary functions of ``c/elementary.c`` instead of the library's, double precision gives the same bits on
every processor.
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from plant.machine.rig import Rig
from plant.parts.arguments import choice

_ELEMENTARY = {"sin": "sine", "cos": "cosine", "exp": "exponential"}
_LIBRARY = "acos|asin|atan|atan2|ceil|copysign|cos|cosh|exp|fabs|floor|fmod|log|pow|sin|sinh|sqrt|tan|tanh|trunc"
_APART = r'/\*.*?\*/|"[^"\n]*"|#include[^\n]*'
_SINGLE = 2.0**-24
_LOST = 0.5


_PROCESSORS = {
    "cortex-m7": {"cpu": "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard", "board": "mps2-an500"},
    "cortex-m4f": {"cpu": "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard", "board": "mps2-an386"},
}


class Target(NamedTuple):
    """Where a controller in C runs: a processor, None for the host; and whether its numbers are single."""

    name: str | None
    single: bool

    @classmethod
    def of(cls, target: str | None, precision: str, rig: Rig, largest: float) -> "Target":
        """From the arguments of `Running.to_c`; single precision is refused where it loses counts."""
        choice("target", target, (None, *_PROCESSORS))
        single = choice("precision", precision, ("double", "single")) == "single"
        lost = np.abs(rig.position_in_pulses(np.eye(rig.n) * 2 * np.pi * _SINGLE)).max(axis=0)
        if single and lost.max() > _LOST:
            joint = rig.joint_labels[int(lost.argmax())]
            raise ValueError(
                f"precision must be 'double' for {joint}: in single it rounds by {lost.max():.2g} pulses within a "
                f"turn; at most {_LOST:g} are lost unseen. Use double, or an encoder of fewer pulses."
            )
        if single and largest > 1 / _SINGLE:
            raise ValueError(f"largest_count must be at most 2^24 in single precision; got {largest:g}. Use double.")
        return cls(target, single)

    @property
    def files(self) -> dict[str, str]:
        """Templates of the files beside the controller's own."""
        if self.name is None:
            return {}
        more = ("toolchain.cmake", "board.c", "board.ld", "stack.awk")
        return {"Makefile": "Makefile.target"} | {name: name for name in more}

    @property
    def values(self) -> dict[str, str]:
        """What the templates say of it."""
        words = "single precision" if self.single else "double precision"
        clock = {} if self.single else {"clock": ", double now", "at": "now", "passed": ", now", "never": "NAN, "}
        about = f"Numbers: {words}{'' if self.name is None else f', for {self.name}'}."
        values = {"clock": "", "at": "NAN", "passed": "", "never": "", "precision": about} | clock
        return values if self.name is None else values | _PROCESSORS[self.name]

    @property
    def elementary(self) -> str:
        """The functions that a processor's C has of its own."""
        own = self.name is not None and not self.single
        return (Path(__file__).with_name("c") / "elementary.c").read_text("ascii") if own else ""

    def translated(self, text: str) -> str:
        """C of the templates as it is for this target; comments, strings and file names stay."""
        if not self.single and self.name is None:
            return text
        parts = re.split(f"({_APART})", text, flags=re.DOTALL)
        change = _in_single if self.single else _with_own
        return "".join(part if i % 2 else change(part) for i, part in enumerate(parts))


HOST = Target(None, False)


def _with_own(text: str) -> str:
    return re.sub(rf"\b({'|'.join(_ELEMENTARY)})\(", lambda found: f"{_ELEMENTARY[found[1]]}(", text)


def _in_single(text: str) -> str:
    """Every number and function of C99 in single precision."""
    text = re.sub(r"\bdouble\b", "float", text)
    text = re.sub(rf"\b({_LIBRARY})\(", r"\1f(", text)
    return re.sub(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])", r"\1f", text)

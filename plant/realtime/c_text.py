"""What the two exports to C share: files from templates (`plant/realtime/c`), their output, comments, and constants.

The numbers of a law and its rig are declared each under its description from the class's docstring.
"""

import re
import textwrap
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from string import Template
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from plant.compiler.c_statements import literal
from plant.machine.rig import Rig
from plant.parts.arguments import array, choice, instance, real
from plant.realtime.c_target import HOST, Target
from plant.version import __version__

_TEMPLATES = Path(__file__).with_name("c")
RUNNING = {".h": _TEMPLATES / "running.h", ".c": _TEMPLATES / "running.c"}
_FLAGS = "-std=c99 -O2 -Wall -Wextra -pedantic -ffp-contract=off"


def write_files(folder: str | Path, name: str, kind: str, values: Mapping[str, Any], target: Target = HOST) -> None:
    """Write header and source of a `kind` ("law" or "running"), a program that replays a record, and how to make it."""
    templates = {f"{name}.h": f"{kind}.h", f"{name}.c": f"{kind}.c"}
    templates |= {file: file for file in ("main.c", "Makefile", "CMakeLists.txt")} | target.files
    write_templates(folder, name, {file: _TEMPLATES / of for file, of in templates.items()}, values, target)


def write_templates(
    folder: str | Path, name: str, templates: Mapping[str, Path], values: Mapping[str, Any], target: Target = HOST
) -> None:
    """Write files of an export, each from its template: all or none."""
    values = {"name": name, "NAME": name.upper(), "flags": _FLAGS, **values}
    place = _free_folder(folder, templates, name)
    texts = {}
    for file, of in templates.items():
        template = Template(of.read_text("ascii"))
        text = template.substitute(values, made=f"{file} - made by onepulse {__version__} for {name}")
        texts[file] = target.translated(text) if file.endswith((".c", ".h")) else text
    place.mkdir(parents=True, exist_ok=True)
    for file, text in texts.items():
        (place / file).write_bytes(text.encode("ascii"))


_TAKEN = ("main", "board")  # files of other contents


def require_exportable(rig: Rig, name: Any) -> None:
    """Refuse an encoder that does not count, and what C could not have as a name."""
    require_counts(rig)
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name) or name in _TAKEN:
        rule = "be a small letter and up to 39 small letters, digits or _, and not main or board"
        raise ValueError(f"name must {rule}; got {name!r:.60}. It names the files and the functions.")


def _free_folder(given: str | Path, files: Iterable[str], name: str) -> Path:
    """The folder, if no file in it would be lost; earlier exports of this name may be overwritten."""
    try:
        folder = Path(given)
    except TypeError:
        raise ValueError(f"folder must be a path; got {given!r:.60}. Give the name of a folder.") from None
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder must be a folder; {folder} is a file. Name another.")
    for file in files:
        path = folder / file
        if path.is_symlink() or path.exists():
            own = path.is_file() and not path.is_symlink()
            first = path.read_bytes().split(b"\n", 1)[0] if own else b""
            if not re.search(rf"made by onepulse \S+ for {name}\b".encode(), first):
                raise ValueError(f"{path} must not exist, or be an export of {name}; it is another. Name a new folder.")
    return folder


class Output(NamedTuple):
    """What a controller in C gives: joint torques, or counts of a converter of this scale (n,) [1/A] and range."""

    scale: NDArray[np.float64] | None
    largest: float

    @classmethod
    def of(cls, law: Any, rig: Rig, output: str, counts_per_ampere: Any, largest_count: int) -> Self:
        """From the arguments of `Law.to_c`; refused where the converter ends below the amplifier's limit."""
        if choice("output", output, ("torque", "dac")) == "torque":
            if counts_per_ampere is not None:
                rule = "be left out for output='torque'; got one"
                raise ValueError(f"counts_per_ampere must {rule}. Choose output='dac'.")
            return cls(None, largest_count)
        advice = "Give one number per joint, with the sign of its wiring."
        scale = array("counts_per_ampere", counts_per_ampere, (rig.n,), advice=advice)
        if (scale == 0).any():
            raise ValueError(f"counts_per_ampere must not be zero; got {scale}. {advice}")
        real("largest_count", largest_count, "32767 is that of 16 bits.", positive=True)
        if largest_count != int(largest_count) or largest_count > 2**31 - 1:
            usual = "32767 is that of 16 bits."
            raise ValueError(f"largest_count must be whole and below 2^31; got {largest_count}. {usual}")
        short = np.flatnonzero(largest_count / np.abs(scale) < rig.drive.current_limit)
        if len(short):
            joint = int(short[0])
            raise ValueError(
                f"largest_count must reach the current limit, {rig.drive.current_limit[joint]:g} A at "
                f"{law.joint_labels(rig)[joint]}; it ends at {largest_count / abs(scale[joint]):g} A. Lower "
                "drive.current_limit, so that the law knows the applied torque."
            )
        return cls(scale, largest_count)

    @property
    def kind(self) -> str:
        return "double" if self.scale is None else "int32_t"

    @property
    def values(self) -> dict[str, str]:
        """What the templates say of it."""
        if self.scale is None:
            meaning = "of the joints, after the amplifier's limit [N m]"
            return {"output": "torque", "type": self.kind, "format": "%.17g", "meaning": meaning}
        meaning = f"of the converter: rounded, within +-{self.largest:.0f}"
        return {"output": "counts", "type": self.kind, "format": '%" PRId32 "', "meaning": meaning}

    @property
    def constant(self) -> str:
        """Declaration of the scale."""
        said = "Counts of the converter per motor current [1/A]."
        return "" if self.scale is None else constant("counts_per_ampere", self.scale, said)

    def converted(self, factor: ca.SX, rig: Rig, torque: ca.SX) -> ca.SX:
        """The output (n, 1) for a limited joint torque: of a converter its whole counts."""
        if self.scale is None:
            return torque
        nearest = ca.floor(factor * rig.drive.current(torque) + 0.5)
        return ca.fmin(ca.fmax(nearest, -self.largest), self.largest)


def sides(without: Collection[str]) -> str:
    """Sentences on the parts of the model that the output leaves out, on sides, and on how to compile."""
    left = f"The torque is without {', '.join(without)}: the firmware adds that. " if without else ""
    return f"""{left}Counts are those of the motors' encoders, with their sign; reference and torque are joint side,
SI units. Compile without -ffast-math, which would leave NaN unseen."""


def rig_of(law: Any, given: Any, call: str) -> Rig:
    """The rig that a law drives: the given one, or its own."""
    rig = getattr(law, "rig", None) if given is None else given
    if rig is None:
        raise ValueError(f"rig must be given, since {type(law).__name__} holds none. Call {call}.")
    made: Rig = instance("rig", rig, Rig, "Pass found.rig.")
    return made


def require_counts(rig: Rig) -> None:
    """Refuse an encoder that does not count."""
    if rig.encoder.smooth:
        raise ValueError("rig must have an encoder that counts; got a smooth one. Use Encoder(..., smooth=False).")


# -- text ----------------------------------------------------------------------------------------------------------
def comment(text: str, width: int = 116) -> str:
    """A C comment of one or more lines, without what could end it or is not ASCII."""
    text = re.sub(r"[^\w\s()\[\]{}+\-^.,:;=*<>'/|%]", " ", text, flags=re.ASCII)
    text = " ".join(text.replace("*/", "* /").replace("/*", "/ *").split())
    return "/* " + "\n * ".join(textwrap.wrap(text, width)) + " */"


def paragraph(text: str) -> str:
    """Lines of a comment that has begun."""
    return f" * {comment(text)[3:-3]}"


def braced(values: NDArray[np.float64]) -> str:
    """Values of an array, on as many lines as they need."""
    inner = "{" + ", ".join(literal(value) for value in values) + "}"
    if len(inner) < 70:
        return inner
    return "{\n" + textwrap.fill(inner[1:-1], 112, initial_indent="    ", subsequent_indent="    ") + ",\n}"


def constant(name: str, values: Any, said: str) -> str:
    """Declaration of a constant, or of an array of constants, under a comment."""
    if np.ndim(values):
        return f"{comment(said)}\nstatic const double {name}[{len(values)}] = {braced(values)};\n"
    return f"{comment(said)}\nstatic const double {name} = {literal(values)};\n"

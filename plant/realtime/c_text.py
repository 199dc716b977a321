"""Common parts of the exports to C: target, files from templates (`plant/realtime/c`), and output.

The C libraries of processors round sines and exponentials differently. On a microcontroller the
functions of ``c/elementary.c`` replace them, so double precision gives the host's bits.
"""

import re
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from string import Template
from typing import Any, NamedTuple, Self

import casadi as ca
import numpy as np

from plant.compiler import constant
from plant.machine import Rig
from plant.parts import Floats, array, choice, instance, real
from plant.version import __version__

# Functions of C's library that c/elementary.c replaces on a microcontroller.
_ELEMENTARY = {"sin": "sine", "cos": "cosine", "exp": "exponential"}

# Functions of C's library that have a variant in single precision, of the same name and an f.
_LIBRARY = (
    "acos|asin|atan|atan2|ceil|copysign|cos|cosh|exp|fabs|floor|fmod|log|pow|sin|sinh|sqrt|tan|tanh"
    "|trunc"
)

# Comments, strings and file names, which a translation must not change.
_APART = r'/\*.*?\*/|"[^"\n]*"|#include[^\n]*'

# Relative rounding error of single precision.
_SINGLE = 2.0**-24

# Largest rounding error of a position [pulses]: below half a pulse the count stays the same.
_LOST = 0.5

# Flags of gcc for a processor, and the board of QEMU that has it.
_PROCESSORS = {
    "cortex-m7": {
        "cpu": "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard",
        "board": "mps2-an500",
    },
    "cortex-m4f": {
        "cpu": "-mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard",
        "board": "mps2-an386",
    },
}


class Target(NamedTuple):
    """Processor of a controller in C, None for the host, and whether its numbers are single."""

    name: str | None
    single: bool

    @classmethod
    def of(cls, target: str | None, precision: str, rig: Rig, largest: float) -> "Target":
        """From the arguments of `Running.to_c`; refuse single precision where it loses counts."""
        choice("target", target, (None, *_PROCESSORS))
        single = choice("precision", precision, ("double", "single")) == "single"
        # The worst joint decides: all numbers of a controller have one precision.
        lost = np.abs(rig.position_in_pulses(np.eye(rig.n) * 2 * np.pi * _SINGLE)).max(axis=0)
        if single and lost.max() > _LOST:
            joint = rig.joint_labels[int(lost.argmax())]
            raise ValueError(
                f"precision must be 'double' for {joint}: in single it rounds by {lost.max():.2g}"
                f" pulses within a turn; at most {_LOST:g} changes no count. Use double, or an"
                " encoder of fewer pulses."
            )
        # Beyond 2^23 the half that rounds a count to the nearest is lost in single precision: an
        # odd count becomes the next even one.
        if single and largest > 0.5 / _SINGLE:
            raise ValueError(
                f"largest_count must be at most 2^23 in single precision; got {largest:g}. Use"
                " double."
            )
        return cls(target, single)

    @property
    def files(self) -> dict[str, str]:
        """Templates of the files that the target adds to an export or replaces in it."""
        if self.name is None:
            return {}
        # A controller for the host needs no start-up code.
        extra = ("toolchain.cmake", "board.c", "board.ld", "stack.awk")
        return {"Makefile": "Makefile.target"} | {name: name for name in extra}

    @property
    def values(self) -> dict[str, str]:
        """Values of the templates that depend on the target."""
        target = "" if self.name is None else f", for {self.name}"
        words = "single" if self.single else "double"
        values = {
            "precision": f"Numbers: {words} precision{target}.",
            **_PROCESSORS.get(self.name or "", {}),
        }
        # In single precision a clock resolves no microseconds after half a minute, so the
        # controller takes no clock.
        if self.single:
            return values | {"clock": "", "at": "NAN", "passed": "", "never": ""}
        return values | {"clock": ", double now", "at": "now", "passed": ", now", "never": "NAN, "}

    @property
    def exact(self) -> bool:
        """Whether a processor must give the host's bits: only double precision promises that."""
        return self.name is not None and not self.single

    @property
    def constants(self) -> dict[str, float]:
        """Constants of the guards that depend on the precision, by name."""
        # Largest count: up to here single precision holds whole numbers exactly.
        return {"EXACT": 1 / _SINGLE} if self.single else {}

    @property
    def elementary(self) -> str:
        """Elementary functions that replace those of a processor's C library."""
        return fragment("elementary.c", {}) if self.exact else ""

    def translated(self, text: str) -> str:
        """C of the templates as it is for this target; comments, strings and file names stay."""
        if self.single:
            change = _in_single
        elif self.exact:
            change = _with_elementary
        else:
            return text
        # The pattern is a group, so every second part is a comment, a string or a file name.
        parts = re.split(f"({_APART})", text, flags=re.DOTALL)
        return "".join(part if i % 2 else change(part) for i, part in enumerate(parts))


HOST = Target(None, False)


def _with_elementary(text: str) -> str:
    return re.sub(
        rf"\b({'|'.join(_ELEMENTARY)})\(", lambda match: f"{_ELEMENTARY[match[1]]}(", text
    )


def _in_single(text: str) -> str:
    """C in single precision: its type, its decimal constants and the functions of `_LIBRARY`."""
    text = re.sub(r"\bdouble\b", "float", text)
    text = re.sub(rf"\b({_LIBRARY})\(", r"\1f(", text)
    # A constant without f would make its whole expression double, which processors without double
    # precision in hardware compute slowly.
    return re.sub(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)(?![\w.])", r"\1f", text)


_TEMPLATES = Path(__file__).with_name("c")

# `Law.to_c` and `Running.to_c` fill the same two templates with different values.
CONTROLLER = {".h": _TEMPLATES / "controller.h", ".c": _TEMPLATES / "controller.c"}

# -ffp-contract=off: a fused product and sum would round differently than on the host.
_FLAGS = "-std=c99 -O2 -Wall -Wextra -pedantic -ffp-contract=off"


def write_files(
    folder: str | Path, name: str, values: Mapping[str, Any], target: Target = HOST
) -> None:
    """Write header and source of a controller, a program that replays a record, and a Makefile."""
    files = {file: file for file in ("main.c", "Makefile", "CMakeLists.txt")} | target.files
    templates = {file: _TEMPLATES / template for file, template in files.items()}
    # The controller's own files have its name, so that several fit into one project.
    templates |= {f"{name}{suffix}": template for suffix, template in CONTROLLER.items()}
    write_templates(folder, name, templates, values, target)


def fragment(file: str, values: Mapping[str, Any]) -> str:
    """Text of a template that becomes a value of another one."""
    # ASCII alone: compilers disagree about other characters, even in comments.
    return Template((_TEMPLATES / file).read_text("ascii")).substitute(values)


def write_templates(
    folder: str | Path,
    name: str,
    templates: Mapping[str, Path],
    values: Mapping[str, Any],
    target: Target = HOST,
) -> None:
    """Write files of an export, each from its template, after all texts are filled."""
    values = {"name": name, "NAME": name.upper(), "flags": _FLAGS, **values}
    place = _free_folder(folder, templates, name)
    # All texts are filled and encoded before the first file is written, so an error in one leaves
    # no partial export.
    contents = {}
    for file, of in templates.items():
        template = Template(of.read_text("ascii"))
        text = template.substitute(
            values, made=f"{file} - made by onepulse {__version__} for {name}"
        )
        text = target.translated(text) if file.endswith((".c", ".h")) else text
        try:
            contents[file] = text.encode("ascii")
        except UnicodeEncodeError as error:
            raise ValueError(
                f"{file} must be ASCII; got {text[error.start]!r}. Rename what has it in its name."
            ) from None
    place.mkdir(parents=True, exist_ok=True)
    for file, content in contents.items():
        (place / file).write_bytes(content)


ONE_CONTROLLER = "/* One controller; several do not know of each other. */\n"


def struct(members: Iterable[str], name: str) -> str:
    """Declaration of a C struct."""
    lines = "".join(f"    {member}\n" for member in members)
    return f"typedef struct {{\n{lines}}} {name};\n"


_TAKEN = ("main", "board")  # files of other contents


def require_exportable(rig: Rig, name: Any) -> None:
    """Refuse an encoder that does not count, and a name that C does not allow."""
    require_counts(rig)
    if (
        not isinstance(name, str)
        or not re.fullmatch(r"[a-z][a-z0-9_]{0,39}", name)
        or name in _TAKEN
    ):
        rule = "be a small letter and up to 39 small letters, digits or _, and not main or board"
        raise ValueError(
            f"name must {rule}; got {name!r:.60}. It names the files and the functions."
        )


def require_folder(name: str, folder: Path) -> None:
    """Refuse a folder that cannot be made, since it or a parent of it has the name of a file."""
    # Without this check `mkdir` would fail later, after all texts are made. A link that leads
    # nowhere does not exist, but takes the name.
    for place in (folder, *folder.parents):
        if (place.is_symlink() or place.exists()) and not place.is_dir():
            raise ValueError(f"{name} must be a folder; {place} is a file. Name another.")


def _free_folder(destination: str | Path, files: Iterable[str], name: str) -> Path:
    """Folder of the export, unless a file in it would be lost.

    Earlier exports of this name may be overwritten.
    """
    try:
        folder = Path(destination)
    except TypeError:
        raise ValueError(
            f"folder must be a path; got {destination!r:.60}. Give the name of a folder."
        ) from None
    require_folder("folder", folder)
    for file in files:
        path = folder / file
        # A link could lead to a file of another folder, so it is refused, whatever it names.
        if path.is_symlink() or path.exists():
            is_plain = path.is_file() and not path.is_symlink()
            heading = path.read_bytes().split(b"\n", 1)[0] if is_plain else b""
            if not re.search(rf"made by onepulse \S+ for {name}\b".encode(), heading):
                raise ValueError(
                    f"{path} must not exist, or be an export of {name}; it is another. Name a new"
                    " folder."
                )
    return folder


# The inner loop that takes an output.
_INNER = {"goal": "PositionServo", "frame": "MitDrive"}

# q, qd, kp, kd, tau
FRAME_ROWS = 5


class Output(NamedTuple):
    """Output of a controller in C: joint torques, counts of a converter, goals or frames.

    `scale` (n,) [1/A] and the `largest` count belong to the converter. `sends`: "goal" or "frame".
    """

    scale: Floats | None
    largest: float
    sends: str | None = None

    @classmethod
    def of(
        cls, law: Any, rig: Rig, output: str, counts_per_ampere: Any, largest_count: int
    ) -> Self:
        """From the arguments of `Law.to_c`; refuse a converter below the amplifier's limit."""
        choice("output", output, ("torque", "dac", *_INNER))
        if output in _INNER and (rig.inner is None or rig.inner.sends != output):
            kind = "none" if rig.inner is None else type(rig.inner).__name__
            choose = "torque" if rig.inner is None else rig.inner.sends
            raise ValueError(
                f"output={output!r} needs a rig whose inner loop takes {output}s, a"
                f" {_INNER[output]}; this one has {kind}. Choose output={choose!r}, or state"
                " inner=."
            )
        if output != "dac":
            if counts_per_ampere is not None:
                rule = f"be left out for output={output!r}; got one"
                raise ValueError(f"counts_per_ampere must {rule}. Choose output='dac'.")
            return cls(None, largest_count, output if output in _INNER else None)
        advice = "Give one number per joint, with the sign of its wiring."
        scale = array("counts_per_ampere", counts_per_ampere, (rig.n,), advice=advice)
        if (scale == 0).any():
            raise ValueError(f"counts_per_ampere must not be zero; got {scale}. {advice}")
        real("largest_count", largest_count, "32767 is that of 16 bits.", positive=True)
        if largest_count != int(largest_count) or largest_count > 2**31 - 1:
            usual = "32767 is that of 16 bits."
            raise ValueError(
                f"largest_count must be whole and below 2^31; got {largest_count}. {usual}"
            )
        # A clipped count would apply less torque than the observer of the law believes. The count
        # of the limit is rounded as in `converted`: a quotient misses a full scale by a bit.
        counts = np.floor(np.abs(scale) * rig.drive.current_limit + 0.5)
        short = np.flatnonzero(counts > largest_count)
        if len(short):
            joint = int(short[0])
            raise ValueError(
                f"largest_count must reach the current limit, {rig.drive.current_limit[joint]:g} A"
                f" at {law.joint_labels(rig)[joint]}; it ends at"
                f" {largest_count / abs(scale[joint]):g} A. Lower drive.current_limit, so that the"
                " law knows the applied torque."
            )
        return cls(scale, largest_count)

    @property
    def kind(self) -> str:
        return "double" if self.scale is None and self.sends != "goal" else "int32_t"

    def size(self, n: int) -> int:
        """Numbers of the output for n joints."""
        return FRAME_ROWS * n if self.sends == "frame" else n

    @property
    def values(self) -> dict[str, str]:
        """Values of the templates that depend on the output."""
        whole = {"type": self.kind, "format": '%" PRId32 "'}
        if self.sends == "goal":
            return {"output": "goal", "meaning": "of the servos [counts]", **whole}
        if self.sends == "frame":
            meaning = (
                "of the drives, as their fields round them: q of all joints, then qd, kp, kd, tau"
                " (SI)"
            )
            return {"output": "frame", "type": self.kind, "format": "%.17g", "meaning": meaning}
        if self.scale is None:
            meaning = "of the joints, after the amplifier's limit [N m]"
            return {"output": "torque", "type": self.kind, "format": "%.17g", "meaning": meaning}
        meaning = f"of the converter: rounded, within +-{self.largest:.0f}"
        return {"output": "counts", "meaning": meaning, **whole}

    @property
    def constant(self) -> str:
        """Declaration of the scale."""
        meaning = "Counts of the converter per motor current [1/A]."
        return "" if self.scale is None else constant("counts_per_ampere", self.scale, meaning)

    def converted(self, factor: ca.SX, rig: Rig, torque: ca.SX) -> ca.SX:
        """A limited joint torque as output (n, 1): whole counts for a converter, else itself."""
        if self.scale is None:
            return torque
        nearest = ca.floor(factor * rig.drive.current(torque) + 0.5)
        return ca.fmin(ca.fmax(nearest, -self.largest), self.largest)


def sides(without: Collection[str]) -> str:
    """Sentences of the header: omitted parts of the model, motor or joint side, and compilation."""
    text = (
        "Counts are those of the motors' encoders, with their sign; reference and torque are joint"
        " side, SI units. Compile without -ffast-math, which would leave NaN unseen."
    )
    if without:
        return f"The torque is without {', '.join(without)}: the firmware adds that. {text}"
    return text


def rig_of(law: Any, rig_argument: Any, call: str) -> Rig:
    """The rig that a law drives: the given one, or its own."""
    rig = getattr(law, "rig", None) if rig_argument is None else rig_argument
    if rig is None:
        raise ValueError(f"rig must be given, since {type(law).__name__} holds none. Call {call}.")
    checked: Rig = instance("rig", rig, Rig, "Pass found.rig.")
    return checked


def require_counts(rig: Rig) -> None:
    """Refuse an encoder that does not count."""
    if rig.encoder.smooth:
        raise ValueError(
            "rig must have an encoder that counts; got a smooth one. Use Encoder(...,"
            " smooth=False)."
        )

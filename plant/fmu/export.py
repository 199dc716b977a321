"""Export of a control law or an arm as an FMU: description, binary for Linux, C sources."""

import hashlib
import io
import platform
import shutil
import subprocess
import sys
import tempfile
import uuid
import zipfile
import zlib
from pathlib import Path
from string import Template
from typing import NamedTuple

import numpy as np

from plant.compiler import braced
from plant.fmu.model import Variable, arm_values, arm_variables, described, law_variables
from plant.laws import Law
from plant.machine import InnerLoop, Rig
from plant.mechanics import Arm
from plant.parts import choice, instance, known_options, write_whole
from plant.realtime import Running, require_counts, require_folder, rig_of
from plant.simulation import stepped_loop
from plant.version import __version__

_TEMPLATES = Path(__file__).with_name("c")
# The earliest time of a ZIP archive: the same model must give the same bytes.
_STAMP = (1980, 1, 1, 0, 0, 0)
_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared", "-fvisibility=hidden")


class _Model(NamedTuple):
    """Content of an FMU: variables, C text by file, values of the templates, usual step [s].

    The token of an FMU is a hash of its `repr`, names of fields included.
    """

    # Name and sentence for the description of the model.
    name: str
    said: str
    variables: list[Variable]
    files: dict[str, str]
    values: dict[str, str]
    step: float


@known_options
def to_fmu(
    model: Law | Running | Arm, path: str | Path, rig: Rig | None = None, version: int = 2
) -> None:
    """Export a control law, or an arm with drives and encoders, as an FMU for co-simulation.

    It holds a binary for Linux on x86-64 and its C, and no Python. Its state can be saved, restored
    and serialised.

    Parameters
    ----------
    model : Law, Running or Arm
        A law with the guards of `Law.start`; what `Law.start` gave, with guards, limits and
        ``without=`` of its own; or an arm.
    path : str or Path
        Of the file, which ends in ``.fmu``; its name is the model's. An earlier export is
        overwritten, nothing else is.
    rig : Rig, optional
        What the law drives, by default the rig that it holds; of an arm its drives and encoders.
    version : {2, 3}
        Of FMI.

    Raises
    ------
    ValueError
        No rig; a law that repeats a log; a name that C or FMI cannot have; another file of that
        name; no C compiler.

    See Also
    --------
    plant.Law, plant.SteppedArm

    Notes
    -----
    A step of a law is one period: it takes counts and reference of its beginning, and gives the
    torque to be held along it. A step of an arm is any multiple of a quarter of the rig's period:
    it takes that torque, and gives the counts of its end. A master that steps the law first, and
    then the arm with its torque, repeats `simulate`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from plant import puma560, to_fmu
    >>> path = Path(tempfile.mkdtemp()) / "puma.fmu"
    >>> to_fmu(puma560.arm(), path, rig=puma560.rig())
    >>> path.exists()
    True
    """
    choice("version", version, (2, 3))
    target = _checked_path(path)
    parts = _arm(model, rig) if isinstance(model, Arm) else _law(model, rig)
    sources = _sources(parts, f"fmi{version}.c")
    # The sources come first: the token is computed from them.
    name = target.stem
    # The same content gives the same token, by which an importer recognises that binary and
    # description belong together.
    token = str(uuid.UUID(bytes=hashlib.sha256(repr((sources, parts)).encode()).digest()[:16]))
    values = parts.values | {
        "token": token,
        "made": f"made by onepulse {__version__}",
        "model": name,
    }
    texts = {
        f"sources/{file}": Template(text).substitute(values)
        for file, text in (sources | parts.files).items()
    }
    # `common.c` is no unit of its own: the interface of each version includes it.
    files = [file for file in sources | parts.files if file.endswith(".c") and file != "common.c"]
    # The description lists the variables, so it comes after the token, which already covers them.
    values |= described(version, parts.variables, files)
    values |= {"said": parts.said, "tool": f"onepulse {__version__}", "step": repr(parts.step)}
    described_in = {"modelDescription.xml": f"fmi{version}.xml"}
    if version == 3:
        # FMI 3 describes the build of the sources in a file of its own.
        described_in["sources/buildDescription.xml"] = "build.xml"
    texts |= {file: Template(_template(of)).substitute(values) for file, of in described_in.items()}
    # Both standards prescribe the folder of a platform's binary.
    folder = "linux64" if version == 2 else "x86_64-linux"
    binary = {f"binaries/{folder}/{name}.so": _compiled(texts, files)}
    _write(target, {file: text.encode() for file, text in texts.items()} | binary)


def _template(name: str) -> str:
    return (_TEMPLATES / name).read_text("ascii")


def _law(model: Law | Running, rig: Rig | None) -> _Model:
    if not isinstance(model, Running):
        instance("model", model, Law, "Give a law, what law.start(...) gave, or an arm.")
        rig = rig_of(model, rig, "to_fmu(law, path, rig)")
        # The start is a placeholder: the first counts that the FMU receives take its place.
        # A servo has a torque named `start`, which hides the method.
        begin = Law.start if isinstance(model, InnerLoop) else type(model).start
        model = begin(model, rig, np.zeros(rig.n))
    elif rig is not None:
        raise ValueError(
            "rig must be left out for a controller that law.start(...) gave; got one. It has its"
            " own."
        )
    guards = "without guards"
    if model.guards is not None:
        guards = "with the guards of its running controller"
    description = f"{type(model.law).__name__} {guards}"
    values = {"period": repr(model.period), "start": braced(np.zeros(4 * model.n))}
    return _Model(
        "controller", description, law_variables(model), _controller(model), values, model.period
    )


def _controller(running: Running) -> dict[str, str]:
    """The C of the controller."""
    with tempfile.TemporaryDirectory() as folder:
        # `to_c` writes files, so they are read back from a temporary folder.
        running.to_c(folder)
        return {
            file: (Path(folder) / file).read_text("ascii")
            for file in ("controller.h", "controller.c")
        }


def _arm(arm: Arm, rig: Rig | None) -> _Model:
    if rig is None:
        raise ValueError(
            "rig must be given with an arm: its drives and encoders. Call to_fmu(arm, path,"
            " rig=rig)."
        )
    instance("rig", rig, Rig, "Call to_fmu(arm, path, rig=rig).")
    loop = stepped_loop(arm, rig, 4, 3)
    require_counts(rig)
    description = "A geared arm with its drives and encoders"
    values = arm_values(arm, loop)
    return _Model("arm", description, arm_variables(arm), {}, values, rig.period)


def _sources(parts: _Model, interface: str) -> dict[str, str]:
    """Templates by file; adds the numbers of variables, which fill them, to the values."""
    kinds = [(variable.whole, variable.settable) for variable in parts.variables]
    parts.values.update(
        name=parts.name,
        NAME=parts.name.upper(),
        n=str(sum(variable.name.startswith("torque.") for variable in parts.variables)),
        reals=str(sum(not is_whole for is_whole, _ in kinds)),
        reals_set=str(kinds.count((False, True))),
        wholes=str(sum(is_whole for is_whole, _ in kinds)),
        wholes_set=str(kinds.count((True, True))),
    )
    templates = (
        {"arm.h": "arm.h", "model.c": "arm.c"} if parts.name == "arm" else {"model.c": "law.c"}
    )
    shared = {file: file for file in ("fmu.h", "common.c", interface)}
    return {file: _template(of) for file, of in (shared | templates).items()}


def _compiled(texts: dict[str, str], files: list[str]) -> bytes:
    """The shared library."""
    # The binary is for one platform; others have to compile the sources.
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        raise ValueError(
            f"to_fmu needs a C compiler (cc or gcc) on Linux, x86_64; this is {platform.system()}"
            f" on {platform.machine()}, with {compiler or 'none'}. Install gcc there."
        )
    with tempfile.TemporaryDirectory() as folder:
        for file, text in texts.items():
            (Path(folder) / Path(file).name).write_text(text, "utf-8")
        command = [compiler, *_FLAGS, "-o", "fmu.so", *files, "-lm"]
        # The command is the compiler that was found above, with names of files made here.
        outcome = subprocess.run(command, cwd=folder, capture_output=True, text=True)  # noqa: S603
        # One line of the compiler's message usually names the missing tool or header.
        if outcome.returncode:
            raise ValueError(
                f"the C must compile; {compiler} says {outcome.stderr.strip()[:200]!r}. Try another"
                " compiler."
            )
        return (Path(folder) / "fmu.so").read_bytes()


def _checked_path(location: str | Path) -> Path:
    """The path, if its name is one for C and nothing else lies there."""
    if not isinstance(location, (str, Path)):
        raise ValueError(
            f"path must be that of a file; got {location!r:.60}. Give a name that ends in .fmu."
        )
    path = Path(location)
    # FMI makes the model identifier from the name, and that is part of names in C.
    if path.suffix != ".fmu" or not (path.stem.isidentifier() and path.stem.isascii()):
        raise ValueError(
            f"path must end in .fmu, its name in letters, digits and _; got {path.name!r:.60}."
            " Rename it."
        )
    require_folder("the folder of path", path.parent)
    if path.exists():
        # Overwrite only an FMU whose description names this library as its generator.
        try:
            with zipfile.ZipFile(path) as earlier:
                ours = b'generationTool="onepulse' in earlier.read("modelDescription.xml")
        # A RuntimeError comes from a description that is encrypted or packed by an unknown method.
        except (OSError, KeyError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
            ours = False
        if not ours:
            raise ValueError(
                f"{path} must not exist, or be an earlier export; it is another file. Choose a new"
                " name."
            )
    return path


def _write(path: Path, content: dict[str, bytes]) -> None:
    """The archive, with the same bytes for the same content."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for file, data in content.items():
            info = zipfile.ZipInfo(file, _STAMP)
            info.compress_type = zipfile.ZIP_DEFLATED
            # Readable by all; by default only the owner could read an entry made of a ZipInfo.
            info.external_attr = 0o644 << 16
            archive.writestr(info, data)
    path.parent.mkdir(parents=True, exist_ok=True)
    # An error must leave no half of a file, and an earlier export as it was.
    write_whole(path, [buffer.getvalue()])

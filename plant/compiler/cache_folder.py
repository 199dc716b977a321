"""The folder of compiled kernels: the user's alone, of a bounded size."""

import contextlib
import os
import re
import stat
import tempfile
import warnings
from pathlib import Path

# environment variable that names another folder for compiled kernels
CACHE_VARIABLE = "ONEPULSE_CACHE"

# bytes of all kernels in the folder; beyond, those that were not used for the longest time go
MOST = 2 << 30

_REFUSED: set[Path] = set()  # folders of which the user has been told
_KERNEL = re.compile(r"kernel_([0-9a-f]{24})[._]")


def cache_folder() -> Path:
    """Folder of compiled kernels; a private temporary one where the usual one cannot be trusted
    or written.
    """
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(os.environ.get(CACHE_VARIABLE) or os.path.join(base, "onepulse"))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "getuid") and (
            status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077
        ):
            raise PermissionError
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        if CACHE_VARIABLE in os.environ and folder not in _REFUSED:
            _REFUSED.add(folder)
            warnings.warn(
                f"{CACHE_VARIABLE} must name a folder of yours that nobody else can enter (chmod"
                f" 700); {folder} is not used, and kernels are compiled anew in every process."
                " Change its mode or name another.",
                stacklevel=2,
            )
        return private_folder()


def private_folder(kept: list[tempfile.TemporaryDirectory[str]] = []) -> Path:  # noqa: B006
    """A temporary folder: one per process, made when it is first needed."""
    if not kept:
        kept.append(tempfile.TemporaryDirectory(prefix="onepulse"))
    return Path(kept[0].name)


def is_own(path: Path) -> bool:
    """Whether a file or a folder is there, no link, and the user's: what another left there is
    not trusted.
    """
    try:
        status = path.lstat()
    except OSError:
        return False
    return not stat.S_ISLNK(status.st_mode) and (
        not hasattr(os, "getuid") or status.st_uid == os.getuid()
    )


def prune(folder: Path, used: str) -> None:
    """Remove kernels from a folder until they have at most `MOST` bytes, not the one whose hash
    is `used`.
    """
    sizes: dict[str, int] = {}
    ages: dict[str, float] = {}
    files: dict[str, list[Path]] = {}
    for file in (*folder.glob("kernel_*"), *folder.glob("__pycache__/kernel_*")):
        found = _KERNEL.match(file.name)
        with contextlib.suppress(OSError):
            status = file.lstat()
            if found and stat.S_ISREG(status.st_mode):
                files.setdefault(found[1], []).append(file)
                sizes[found[1]] = sizes.get(found[1], 0) + status.st_size
                ages[found[1]] = max(ages.get(found[1], 0.0), status.st_mtime)
    total = sum(sizes.values())
    for kernel in sorted(ages, key=ages.__getitem__):
        if total <= MOST:
            break
        if kernel != used:
            total -= sizes[kernel]
            for file in files[kernel]:
                with contextlib.suppress(OSError):
                    file.unlink()


def replace(path: Path, text: str) -> None:
    """Write a file so that others see the old one or the new one, never half of it."""
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(name, path)
    except OSError:
        os.unlink(name)
        raise

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

_REFUSED: set[Path] = set()  # folders that a warning has named
_KERNEL = re.compile(r"kernel_([0-9a-f]{24})[._]")


def cache_folder() -> Path:
    """Folder of compiled kernels; a private temporary one if the usual one is not safe."""
    # The usual place of caches on Linux.
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(os.environ.get(CACHE_VARIABLE) or os.path.join(base, "onepulse"))
    try:
        # Kernels are code that runs, so nobody else may write here.
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        # Windows has neither user numbers nor these modes.
        if hasattr(os, "getuid") and (
            status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077
        ):
            raise PermissionError
        # A disk that is full or read-only shows only when a file is written.
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        # The usual folder may be missing, as in a container, but a folder that the user has named
        # must not be left out in silence. Once is enough.
        if CACHE_VARIABLE in os.environ and folder not in _REFUSED:
            _REFUSED.add(folder)
            warnings.warn(
                f"{CACHE_VARIABLE} must name a folder of yours that nobody else can enter (chmod"
                f" 700); {folder} is not used, and kernels are compiled anew in every process."
                " Change its mode or name another.",
                stacklevel=2,
            )
        return private_folder()


def private_folder(folders: list[tempfile.TemporaryDirectory[str]] = []) -> Path:  # noqa: B006
    """A temporary folder: one per process, made when it is first needed."""
    # The default argument lives as long as the process, and takes the folder with it.
    if not folders:
        folders.append(tempfile.TemporaryDirectory(prefix="onepulse"))
    return Path(folders[0].name)


def is_own(path: Path) -> bool:
    """Whether a file or folder exists, is no link, and belongs to the user."""
    try:
        # `lstat` judges a link itself, not the file to which it leads.
        status = path.lstat()
    except OSError:
        return False
    return not stat.S_ISLNK(status.st_mode) and (
        not hasattr(os, "getuid") or status.st_uid == os.getuid()
    )


def prune(folder: Path, used: str) -> None:
    """Remove kernels from a folder until they have at most `MOST` bytes, but not `used`."""
    sizes: dict[str, int] = {}
    ages: dict[str, float] = {}
    files: dict[str, list[Path]] = {}
    # The sources, their locks and checksums, and the machine code that numba has cached.
    for file in (*folder.glob("kernel_*"), *folder.glob("__pycache__/kernel_*")):
        match = _KERNEL.match(file.name)
        # Another process may remove the file meanwhile.
        with contextlib.suppress(OSError):
            status = file.lstat()
            if match and stat.S_ISREG(status.st_mode):
                files.setdefault(match[1], []).append(file)
                sizes[match[1]] = sizes.get(match[1], 0) + status.st_size
                # Each process that uses a kernel touches its lock, so the newest file has the time
                # of its last use.
                ages[match[1]] = max(ages.get(match[1], 0.0), status.st_mtime)
    total = sum(sizes.values())
    # The kernel that was not used for the longest time goes first.
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
    # In the same folder, since a move between disks is not one step.
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(name, path)
    except OSError:
        os.unlink(name)
        raise

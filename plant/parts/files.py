"""Files that are written whole or not at all, and read only if they are files of a sound size."""

import contextlib
import glob
import os
import secrets
import stat
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_OLD = 60.0  # age [s] beyond which a file beside its place is what a killed process left


def path_of(name: str, given: Any) -> Path:
    """A path that is named, or a refusal."""
    if not isinstance(given, str | os.PathLike) or not os.fspath(given):
        raise ValueError(f"{name} must be a path; got {given!r:.60}. Name a file or a folder.")
    return Path(given)


def require_bounded(path: str | Path, most: int) -> None:
    """Refuse a folder, a pipe, a device, and a file of more than `most` bytes, before anything of
    it is read.

    The ValueError does not name the path.
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(
            "must be a file; got a folder, a pipe or a device. Give the path of the file itself."
        )
    if status.st_size > most:
        got = f"got {-(-status.st_size >> 20)} MiB"
        raise ValueError(
            f"must have at most {most >> 20} MiB; {got}. Cut it into several files, or give"
            " another."
        )


def read_bounded(path: str | Path, most: int) -> bytes:
    """All bytes of a file, at most `most` of them, as `require_bounded`; one that grows while it
    is read is refused.
    """
    require_bounded(path, most)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError(
                "must be a file; got a pipe or a device. Give the path of the file itself."
            )
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(
            f"must have at most {most >> 20} MiB; it grows. Give a file that is complete."
        )
    return data


def require_new(target: str | Path, overwrite: bool) -> Path:
    """The path of a file to be written; one that is there is refused, unless it may be
    overwritten.
    """
    path = Path(target)
    if path.exists() and not overwrite:
        raise ValueError(
            f"target must be a new file; {path} is there. Name another one, or pass overwrite=True."
        )
    if not path.parent.is_dir():
        raise ValueError(
            f"target must be in a folder that is there; {path.parent} is not. Make it first."
        )
    return path


def write_whole(path: str | Path, content: Iterable[str | bytes]) -> None:
    """Write a file beside its place, to the disk, then put it there: whoever reads sees the old one
    or the new one.

    A link is followed; the folder must be there. Content is str (as UTF-8) or bytes, one after
    another. A folder, a pipe or a device in its place is refused; after an OSError what was there
    before is as it was.
    """
    place = Path(os.path.realpath(path))
    if place.exists() and not place.is_file():
        raise ValueError(
            f"{path} must be a file or not be there; it is a folder, a pipe or a device. Choose"
            " another."
        )
    temporary = place.with_name(f"{_beside(place)}{secrets.token_hex(8)}")
    try:
        with open(temporary, "xb") as file:
            for each in content:
                file.write(each.encode() if isinstance(each, str) else each)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, place)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    if os.name == "posix":
        with contextlib.suppress(OSError):  # a folder that cannot be synchronised
            folder = os.open(place.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def remove_remains(path: str | Path) -> None:
    """Remove what killed processes left beside a file, unless it is as new as one that is being
    written.
    """
    place = Path(os.path.realpath(path))
    for left in place.parent.glob(f"{glob.escape(_beside(place))}{'[0-9a-f]' * 16}"):
        with contextlib.suppress(OSError):
            if left.stat().st_mtime < time.time() - _OLD:
                left.unlink()


def _beside(place: Path) -> str:
    """How the names begin under which a file is written."""
    return f".{place.name[:100]}."

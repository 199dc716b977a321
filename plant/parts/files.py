"""Files that are written whole or not at all, and read only if they are files of a sound size."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from collections.abc import Callable, Iterable
from pathlib import Path

__all__ = ["read_bounded", "require_bounded", "write_whole"]


def require_bounded(path: str | Path, most: int) -> None:
    """Refuse a folder, a pipe, a device, and a file of more than `most` bytes, before anything of it is read.

    Raises
    ------
    ValueError
        Without the path.
    FileNotFoundError
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise ValueError("must be a file; got a folder, a pipe or a device. Give the path of the file itself.")
    if status.st_size > most:
        raise ValueError(f"must have at most {most >> 20} MiB; got {status.st_size >> 20} MiB. Give a smaller file.")


def read_bounded(path: str | Path, most: int) -> bytes:
    """All bytes of a file, at most `most` of them.

    Raises
    ------
    ValueError
        What `require_bounded` refuses; a file that grows while it is read.
    """
    require_bounded(path, most)
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError("must be a file; got a pipe or a device. Give the path of the file itself.")
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(f"must have at most {most >> 20} MiB; it grows. Give a file that is complete.")
    return data


def write_whole(path: str | Path, text: Iterable[str], *, about_to_replace: Callable[[], None] | None = None) -> None:
    """Write a file beside its place, to the disk, then put it there: whoever reads sees the old one or the new one.

    Parameters
    ----------
    path : str or Path
        A link is followed. The folder must be there.
    text : iterable of str
        One after another.
    about_to_replace : callable, optional
        Called when all is on the disk, before it takes its place.

    Raises
    ------
    ValueError
        A folder, a pipe or a device in its place.
    OSError
        A folder that is not there or cannot be written, a full disk; what was there before is as it was.
    """
    place = Path(os.path.realpath(path))
    if place.exists() and not place.is_file():
        raise ValueError(f"{path} must be a file or not be there; it is a folder, a pipe or a device. Choose another.")
    temporary = place.with_name(f".{place.name[:100]}.{secrets.token_hex(8)}")
    try:
        with open(temporary, "x", encoding="utf-8", newline="\n") as file:
            for each in text:
                file.write(each)
            file.flush()
            os.fsync(file.fileno())
        if about_to_replace is not None:
            about_to_replace()
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

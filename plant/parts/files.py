"""Atomic writing of files, and bounded reading of regular files."""

import contextlib
import glob
import os
import secrets
import shutil
import stat
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

# A temporary file not written to for longer than this [s] counts as abandoned; chosen by hand.
_OLD = 60.0


def path_of(name: str, value: Any) -> Path:
    """Return `value` as a path, or refuse it."""
    path = os.fspath(value) if isinstance(value, str | os.PathLike) else None
    # Entries of a folder that is named by bytes are named by bytes, too.
    if not path or not isinstance(path, str):
        raise ValueError(f"{name} must be a path; got {value!r:.60}. Name a file or a folder.")
    return Path(value)


def require_bounded(path: str | Path, most: int) -> None:
    """Refuse, without reading it, anything but a regular file of at most `most` bytes.

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
    """All bytes of a regular file; refuse one that has, or grows to, more than `most` bytes."""
    require_bounded(path, most)
    # Without O_NONBLOCK the opening of a pipe would wait for its writer.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        # Since the first check the path may have come to name a pipe; the open file stays the same.
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError(
                "must be a file; got a pipe or a device. Give the path of the file itself."
            )
        # One byte more than allowed shows that the file has grown past the limit.
        data = file.read(most + 1)
    if len(data) > most:
        raise ValueError(
            f"must have at most {most >> 20} MiB; it grows. Give a file that is complete."
        )
    return data


def require_new(target: str | Path, overwrite: bool) -> Path:
    """Path of a file to write. A missing folder, or without `overwrite` an old file, is refused."""
    path = path_of("target", target)
    if path.exists() and not overwrite:
        raise ValueError(
            f"target must be a new file; {path} is there. Name another one, or pass overwrite=True."
        )
    # A folder with a misspelled name should not be made silently.
    if not path.parent.is_dir():
        raise ValueError(
            f"target must be in a folder that is there; {path.parent} is not. Make it first."
        )
    return path


def write_whole(path: str | Path, content: Iterable[str | bytes]) -> None:
    """Write a file atomically: a reader sees the previous file or the new one, never a mixture.

    A link is followed; its target's folder must exist. `content` yields str (written as UTF-8) or
    bytes. A folder, a pipe or a device at the path is refused; after an OSError the previous file
    is unchanged. The new file has the permissions of the previous one.
    """
    # Follow links: replacing the link itself would leave the file it points to unchanged.
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise ValueError(
            f"{path} must be a file or not be there; it is a folder, a pipe or a device. Choose"
            " another."
        )
    # The temporary file is in the same folder: `os.replace` works only within one file system.
    temporary = target.with_name(f"{_beside(target)}{secrets.token_hex(8)}")
    try:
        with open(temporary, "xb") as file:
            # Before there is content, which others may not be allowed to read.
            with contextlib.suppress(OSError):  # no previous file, or no permissions there
                shutil.copymode(target, temporary)
            for piece in content:
                file.write(piece.encode() if isinstance(piece, str) else piece)
            # The content must be on the disk before the name points to it, or a power failure could
            # leave an empty file.
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    # Also after KeyboardInterrupt no temporary file should stay.
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
    # The new name is an entry of the folder, which has to reach the disk as well.
    if os.name == "posix":
        with contextlib.suppress(OSError):  # a folder that cannot be synchronised
            folder = os.open(target.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


def remove_remains(path: str | Path) -> None:
    """Remove old temporary files, which killed processes left beside a file."""
    target = Path(os.path.realpath(path))
    for remnant in target.parent.glob(f"{glob.escape(_beside(target))}{'[0-9a-f]' * 16}"):
        with contextlib.suppress(OSError):
            # A younger file may belong to a process that is writing it now.
            if remnant.stat().st_mtime < time.time() - _OLD:
                remnant.unlink()


def _beside(target: Path) -> str:
    """Prefix of the names of temporary files for `target`; cut, as a name has a limited length."""
    # File systems limit names to 255 bytes, and 50 characters have at most 200.
    return f".{target.name[:50]}."

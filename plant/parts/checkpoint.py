"""Checkpoints: finished stages of long work in a file; resumed work ends in the same bits.

A stage is a pure function of the inputs that the checkpoint is bound to. Its result is stored;
called again, the work reads it from the file and computes the remaining stages. The file is
replaced as a whole (`plant.parts.files`), so a killed process leaves the last state that was
written. A file of other inputs, versions or another processor is refused.
"""

import dataclasses
import hashlib
import logging
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
from llvmlite.binding import get_host_cpu_name
from numpy.typing import ArrayLike

from plant.parts.fields import Floats
from plant.parts.files import path_of, read_bounded, remove_remains, write_whole
from plant.parts.messages import warn
from plant.parts.plain import from_plain, to_plain
from plant.parts.saved import FORMAT, MOST, fingerprint, parsed, versions, written

T = TypeVar("T")


@dataclasses.dataclass(frozen=True, kw_only=True)
class WriteInterval:
    """Shortest time from one write of a checkpoint to the next.

    Parameters
    ----------
    durations : float
        In durations of the previous write, so that writing takes at most a twentieth of the time
        although the file grows with the work; chosen by hand.
    seconds : float
        In seconds, for small files; chosen by hand.
    """

    durations: float = 20
    seconds: float = 0.2


INTERVAL = WriteInterval()


class Checkpoint:
    """Finished stages of one piece of work; the end of its ``with`` statement writes them.

    `path` is a file, made if it does not exist; or the checkpoint of larger work; or None, which
    stores nothing. `work` names the work. A file of other work, another version or another
    processor is refused.
    """

    def __init__(self, path: "str | Path | Checkpoint | None", work: str) -> None:
        self._prefix = ""
        self._file = None
        self._work = work
        # A part of larger work must leave the file open for the stages that follow it.
        self._owner = not isinstance(path, Checkpoint)
        # A checkpoint inside another one shares its file, below the prefix of its stages.
        if isinstance(path, Checkpoint):
            self._prefix = path._prefix
            self._file = path._file
            self._work = path._work
        elif path is not None:
            self._file = _File(path_of("checkpoint", path), work)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._file is not None:
            self._file.write()
            self._file.closed = self._owner

    def part(self, name: str) -> "Checkpoint":
        """The same file for a part of the work, whose stages have names of their own."""
        # The prefix keeps equal names of stages in different parts apart.
        part = Checkpoint(self, "")
        part._prefix = f"{self._prefix}{name}, "
        return part

    def bind(self, inputs: Callable[[], Mapping[str, Any]]) -> "Checkpoint":
        """Refuse a file whose stages had other inputs: name -> part, record, array or setting.

        `inputs` is called only if there is a file.
        """
        if self._file is not None:
            fingerprints = {name: fingerprint(value) for name, value in inputs().items()}
            # A new file stores these fingerprints as its first stage; a resumed one returns the
            # stored ones.
            stored = self.stage("inputs", lambda: fingerprints)
            different = [name for name in fingerprints if stored.get(name) != fingerprints[name]]
            if different:
                raise ValueError(
                    f"checkpoint {self._file.path} must be of the same {different[0]}; it was made"
                    " with another. Give the same, or another file."
                )
        return self

    def stage(self, name: str, make: Callable[[], T]) -> T:
        """Result of `make`, or its stored result if this stage was finished in an earlier run.

        The log reports the time that it took.
        """
        # The clock must not jump when the system time is set.
        began = time.monotonic()
        result = make() if self._file is None else self._file.stage(f"{self._prefix}{name}", make)
        logging.getLogger(f"onepulse.{self._work}").info(
            "%s%s: %.1f s", self._prefix, name, time.monotonic() - began
        )
        return result

    def remembered(
        self, name: str, function: Callable[[Floats], ArrayLike]
    ) -> Callable[..., ArrayLike]:
        """A function of one array, each of whose values is a stage."""

        def remembering(x: Floats) -> ArrayLike:
            # The shape counts too: arrays of different shape can have the same bytes.
            digest = hashlib.sha256(
                repr(x.shape).encode() + np.ascontiguousarray(x).tobytes()
            ).hexdigest()
            return self.stage(f"{name} {digest[:24]}", lambda: function(x))

        return remembering if self._file is not None else function


class _File:
    """All stages of a file by name, as plain data and, once written, as text."""

    def __init__(self, path: Path, work: str) -> None:
        self.path = path
        # Reentrant, since `stage` writes while it holds the lock; stages may finish in threads.
        self._lock = threading.RLock()
        self._head = {
            "kind": "checkpoint",
            "format": FORMAT,
            "work": work,
            "versions": versions(),
            "processor": get_host_cpu_name(),
        }
        self._stages: dict[str, Any] = {}
        self._texts: dict[str, str] = {}
        self._pending = True
        self._failed = False
        self._next = 0.0
        self.closed = False
        # Write the file now, so that a path that cannot be written is refused before hours of work.
        if path.exists():
            self._read()
            self._pending = False
            remove_remains(path)
        else:
            try:
                write_whole(path, self._text())
            except OSError as error:
                raise ValueError(
                    f"checkpoint {path} must be a file that can be written; {error.strerror}."
                ) from None

    def stage(self, name: str, make: Callable[[], T]) -> T:
        with self._lock:
            if name in self._stages:
                result: T = self._restored(name)
                return result
        # Compute without the lock: stages in other threads need not wait for this one.
        result = make()
        plain = to_plain(result)
        with self._lock:
            self._stages[name] = plain
            self._pending = True
            if time.monotonic() >= self._next:
                self.write()
        return result

    def _restored(self, name: str) -> Any:
        """Stored result of a finished stage."""
        try:
            return from_plain(self._stages[name])
        except (ValueError, TypeError, AttributeError, LookupError, RecursionError) as error:
            message = " ".join(str(error).split())
            raise ValueError(
                f"checkpoint {self.path} is spoilt: {message:.200} Delete it and begin anew."
            ) from None

    def write(self) -> None:
        """Write the stages that are not on the disk yet; a failure is warned of once."""
        with self._lock:
            if not self._pending or self.closed:
                return
            began = time.monotonic()
            try:
                write_whole(self.path, self._text())
                self._pending = False
                self._failed = False
            except OSError as error:
                # A full disk must not end the work, nor warn at every stage; the next write tries
                # again.
                if not self._failed:
                    self._failed = True
                    warn(
                        f"checkpoint {self.path} cannot be written ({error.strerror}); the work"
                        " goes on. Make room."
                    )
            ended = time.monotonic()
            # The pause follows the duration of this write, since the file grows with each stage.
            self._next = ended + max(INTERVAL.seconds, INTERVAL.durations * (ended - began))

    def _text(self) -> Any:
        """The file's text; that of each stage is made once."""
        # The head without its closing brace, the stages, and the sum last, as the writer iterates.
        yield "".join(written(self._head)).removesuffix("\n}") + ',\n "stages": {'
        yield ",".join(self._stage_texts())
        yield f'\n}},\n "sha256": "{self._sum()}"}}\n'

    def _stage_texts(self) -> list[str]:
        for name, plain in self._stages.items():
            # The text of a stage never changes; only new stages are converted.
            if name not in self._texts:
                self._texts[name] = (
                    "".join(written({name: plain})).removesuffix("\n}").removeprefix("{")
                )
        return [self._texts[name] for name in self._stages]

    def _sum(self) -> str:
        return hashlib.sha256(",".join(self._stage_texts()).encode()).hexdigest()

    def _read(self) -> None:
        try:
            data = parsed(read_bounded(self.path, MOST))
            sound = isinstance(data, dict) and data.get("kind") == "checkpoint"
            if not sound or not isinstance(data.get("stages"), dict):
                raise ValueError("must be a checkpoint; it is another file. Give another name.")
            # Another version or processor may round otherwise, so that the resumed result would not
            # have the bits of an uninterrupted run.
            for key, expected in self._head.items():
                if data.get(key) != expected:
                    received = _in_short(data.get(key))
                    raise ValueError(
                        f"must be of the {key} {_in_short(expected)}; got {received}."
                        " Give another file."
                    )
            self._stages = data["stages"]
            # The sum covers the stages as they would be written again, so it notices an edited
            # number.
            if data.get("sha256") != self._sum():
                raise ValueError(
                    "must be as it was written; it has been changed. Delete it, and begin anew."
                )
        except (OSError, ValueError) as error:
            raise ValueError(f"checkpoint {self.path} {' '.join(str(error).split())}") from None


def _in_short(value: Any) -> str:
    """A value of the head, in short."""
    return (
        ", ".join(f"{key} {entry}" for key, entry in value.items())
        if isinstance(value, dict)
        else f"{value!r:.60}"
    )

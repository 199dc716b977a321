"""Generated source -> compiled module, cached on disk across processes.

One file per kernel, named by the hash of its content; the hash stands in the module's name and in
every function's name, because numba's cache would silently hand out another kernel with the same
names. The text that runs is always the one just generated: the file is there for numba's cache
only, and numba's cached code is used only if its checksum is the one of its making. The
folder belongs to the user alone (mode 0700); any other folder is not trusted, nor is a file in it
of another user (`plant.compiler.cache_folder`).
"""

import contextlib
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import logging
import os
import platform
import shutil
import sys
import threading
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numba
from llvmlite.binding import get_host_cpu_features

from plant.compiler.background import in_background
from plant.compiler.cache_folder import cache_folder, is_own, private_folder, prune, replace

if sys.platform != "win32":
    import fcntl


# Environment variable: set to 1 before numba compiles anything, it takes the processor for one
# without AVX-512.  Kernels then take the other path of `plant.compiler.llvm`; numba's cache tells
# them apart by the processor's features.
AVX512_VARIABLE = "ONEPULSE_NO_AVX512"

if os.environ.get(AVX512_VARIABLE) == "1":
    _config: Any = numba.config
    _FEATURES = _config.CPU_FEATURES or get_host_cpu_features().flatten()
    _config.CPU_FEATURES = _FEATURES.replace("+avx512", "-avx512")

_LOG = logging.getLogger("onepulse.compiler")
_LOCK = threading.RLock()
_MODULES: dict[str, ModuleType] = {}
_FORKING: list[bool] = []


class Kernel:
    """Compiled `functions` of one generated file; ``{h}`` in its template stands for its hash.

    The names in `functions` are without the hash.
    """

    def __init__(self, template: str, functions: Collection[str]) -> None:
        # Another numba or Python may compile the same text otherwise, or refuse the cached code.
        key = "\n".join([template, numba.__version__, platform.python_version()])
        self.hash = hashlib.sha256(key.encode()).hexdigest()[:24]
        self.source = template.replace("{h}", self.hash)
        # What this process has not called yet: a first call compiles, or loads from disk.
        self._fresh = set(functions)
        self._path: Path | None = None

    @property
    def path(self) -> Path:
        """File that holds the source."""
        return self._path or cache_folder() / f"kernel_{self.hash}.py"

    def call(self, name: str, *arguments: Any) -> Any:
        """Call one of the functions, compiling it or taking it from the cache first."""
        # Only the first call compiles; all later ones need neither a thread nor a lock.
        if name not in self._fresh:
            return self._function(name)(*arguments)
        if cast(Any, numba.config).DISABLE_JIT:
            raise ValueError(
                "NUMBA_DISABLE_JIT must be 0: kernels are LLVM, not Python; it is set. Unset it,"
                " and restart."
            )
        # LLVM does not look for signals, so it runs beside the main thread.
        (result,) = in_background(lambda: self._first_call(name, *arguments))
        return result

    def _first_call(self, name: str, *arguments: Any) -> Any:
        # One thread of this process, and one process of this machine.
        with _LOCK, self._alone():
            # numba compiles within the call; only its files show whether it has.
            cached = self._stamps()
            began = time.monotonic()
            try:
                result = self._function(name)(*arguments)
            except Exception as error:
                # numba names no exception for a cache entry that it cannot load. Where there was
                # one, a new compilation decides: an error of the kernel itself comes again. If
                # the disk refuses the cache, the kernel is compiled without it.
                if not cached and not _is_of_disk(error):
                    raise
                result = self._anew(name, *arguments)
            if self._stamps() != cached:  # something was compiled
                _LOG.info(
                    "kernel %s, %s: compiled in %.1f s",
                    self.hash[:8],
                    name,
                    time.monotonic() - began,
                )
                self._note()
            self._fresh.discard(name)
        return result

    def _anew(self, name: str, *arguments: Any) -> Any:
        """The result of a new compilation, in memory alone where the disk does not take it."""
        # Files that could not be loaded must not be found again.
        # Nothing of the cache may be left: one of its files has just failed to load.
        self._drop(lambda file: True)
        try:
            _MODULES[self.hash] = self._module()
            return self._function(name)(*arguments)
        except Exception as error:
            if not _is_of_disk(error):
                raise
        # The disk refuses the cache: compile the same text without one.
        _MODULES[self.hash] = self._executed(
            self.source.replace("cache=True", "cache=False"), "<kernel>"
        )
        return self._function(name)(*arguments)

    def function(self, name: str, *arguments: Any) -> Callable[..., Any]:
        """The compiled function itself, for frequent calls, after a first call."""
        self.call(name, *arguments)
        return self._function(name)

    def _function(self, name: str) -> Any:
        if self.hash not in _MODULES:
            with _LOCK:
                # Another thread may have loaded it before this one got the lock.
                if self.hash not in _MODULES:
                    _MODULES[self.hash] = self._module()
        return getattr(_MODULES[self.hash], f"{name}_{self.hash}")

    def _module(self) -> ModuleType:
        path = self._path = cache_folder() / f"kernel_{self.hash}.py"
        try:
            # A file that is written again has a new time, and numba would take it for another
            # source.
            if not (is_own(path) and path.is_file() and path.read_bytes() == self.source.encode()):
                replace(path, self.source)
            # numba loads machine code from this folder, so another user must not own it.
            if (path.parent / "__pycache__").exists() and not is_own(path.parent / "__pycache__"):
                raise PermissionError
        except OSError:  # something else stands there
            path = self._path = private_folder() / path.name
            replace(path, self.source)
        noted = self._noted()
        # Cached code runs as it is: only files with the checksum of their making may stay.
        self._drop(lambda file: not is_own(file) or noted.get(file.name) != _checksum(file))
        return self._executed(self.source, str(path))

    def _executed(self, source: str, path: str) -> ModuleType:
        loader = _Loader(source, path)
        config = cast(Any, numba.config)
        spec = importlib.machinery.ModuleSpec(f"kernel_{self.hash}", loader)
        # numba's cache looks it up by name
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)
        # numba's cache stays beside the file
        elsewhere = config.CACHE_DIR
        config.CACHE_DIR = ""
        try:
            loader.exec_module(module)
        finally:
            config.CACHE_DIR = elsewhere
        return module

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Keep other processes from compiling this kernel, so that one compiles it for all."""
        with contextlib.ExitStack() as stack:
            if sys.platform != "win32":
                with contextlib.suppress(OSError):  # a folder that knows no locks
                    file = stack.enter_context(
                        (cache_folder() / f"kernel_{self.hash}.lock").open("w")
                    )
                    fcntl.flock(file, fcntl.LOCK_EX)  # ends with the process that holds it
                    os.utime(file.fileno())  # when it was used last
            yield

    # -- files that numba has cached, and their checksums -----------------------------------------
    def _cached(self) -> list[Path]:
        return list((self.path.parent / "__pycache__").glob(f"kernel_{self.hash}.*.nb*"))

    def _stamps(self) -> set[tuple[str, int, int]]:
        """Names, sizes and times of the files that numba has cached."""
        stamps = set[tuple[str, int, int]]()
        for file in self._cached():
            # Another process may remove the file meanwhile.
            with contextlib.suppress(OSError):
                status = file.stat()
                stamps.add((file.name, status.st_size, status.st_mtime_ns))
        return stamps

    def _sums(self) -> Path:
        return self.path.with_suffix(".sums")

    def _noted(self) -> dict[str, str | None]:
        # Checksums of another user would vouch for code of that user.
        if not is_own(self._sums()):
            return {}
        try:
            noted = json.loads(self._sums().read_text())
            return noted if isinstance(noted, dict) else {}
        except (OSError, ValueError, RecursionError):
            return {}

    def _note(self) -> None:
        try:
            replace(
                self._sums(), json.dumps({file.name: _checksum(file) for file in self._cached()})
            )
        except OSError:
            return  # not noted, so not trusted: the next process compiles again
        # The folder grows by new kernels alone, so its size is checked here.
        prune(self.path.parent, self.hash)

    def _drop(self, condemned: Callable[[Path], bool]) -> None:
        for file in self._cached():
            if condemned(file):
                with contextlib.suppress(OSError):
                    # A link is removed itself, not the folder to which it leads.
                    (
                        shutil.rmtree(file)
                        if file.is_dir() and not file.is_symlink()
                        else file.unlink()
                    )


class _Loader(importlib.abc.InspectLoader):
    """Runs the text it was given, under the name of the file beside which numba caches."""

    def __init__(self, source: str, path: str) -> None:
        self.source = source
        self.path = path

    def get_source(self, fullname: str) -> str:
        return self.source

    def get_code(self, fullname: str) -> Any:
        return self.source_to_code(self.source, self.path)


def _is_of_disk(error: Exception) -> bool:
    """Whether numba could not use its cache: no room, no permission, no folder ("no locator")."""
    return isinstance(error, OSError) or (
        isinstance(error, RuntimeError) and "cannot cache function" in str(error)
    )


def _wait() -> None:
    """Before a fork, wait for compiling threads: in the child their locks would stay locked."""
    _FORKING.append(_LOCK.acquire())


def _go_on() -> None:
    # Parent and child both hold the lock that `_wait` has acquired.
    if _FORKING:
        _FORKING.pop()
        _LOCK.release()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_wait, after_in_parent=_go_on, after_in_child=_go_on)


def _checksum(file: Path) -> str | None:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None

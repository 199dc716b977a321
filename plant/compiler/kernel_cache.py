"""Generated source -> compiled module, cached on disk across processes.

One file per kernel, named by the hash of its content; the hash stands in the module's name and in every function's
name, because numba's cache would silently hand out another kernel with the same names. The text that runs is always
the one just generated: the file is there for numba's cache only, and what numba cached is used only if its checksum
is the one noted when it was made. The folder belongs to the user alone (mode 0700); any other folder is not trusted.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import platform
import stat
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numba
from llvmlite.binding import get_host_cpu_features

from plant.compiler.background import in_background

if sys.platform != "win32":
    import fcntl

__all__ = ["AVX512_VARIABLE", "CACHE_VARIABLE", "Kernel", "cache_folder"]

CACHE_VARIABLE = "ONEPULSE_CACHE"
"""Environment variable that names another folder for compiled kernels."""

AVX512_VARIABLE = "ONEPULSE_NO_AVX512"
"""Environment variable: set to 1 before numba compiles anything, it takes the processor for one without AVX-512.

Kernels then take the other path of `plant.compiler.llvm`; numba's cache tells them apart by the processor's features.
"""

if os.environ.get(AVX512_VARIABLE) == "1":
    _config: Any = numba.config
    _FEATURES = _config.CPU_FEATURES or get_host_cpu_features().flatten()
    _config.CPU_FEATURES = _FEATURES.replace("+avx512", "-avx512")

_LOCK = threading.RLock()
_MODULES: dict[str, ModuleType] = {}
_REFUSED: set[Path] = set()  # folders of which the user has been told


def cache_folder() -> Path:
    """Folder of compiled kernels; a private temporary one where the usual one cannot be trusted or written."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")
    folder = Path(os.environ.get(CACHE_VARIABLE) or os.path.join(base, "onepulse"))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
        if hasattr(os, "getuid") and (status.st_uid != os.getuid() or stat.S_IMODE(status.st_mode) & 0o077):
            raise PermissionError
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        if CACHE_VARIABLE in os.environ and folder not in _REFUSED:
            _REFUSED.add(folder)
            warnings.warn(
                f"{CACHE_VARIABLE} must name a folder of yours that nobody else can enter (chmod 700); {folder} is not "
                "used, and kernels are compiled anew in every process. Change its mode or name another.",
                stacklevel=2,
            )
        return _private_folder()


def _private_folder(kept: list[tempfile.TemporaryDirectory[str]] = []) -> Path:  # noqa: B006 - one folder per process, made when first needed
    if not kept:
        kept.append(tempfile.TemporaryDirectory(prefix="onepulse"))
    return Path(kept[0].name)


class Kernel:
    """Compiled functions of one generated file.

    Parameters
    ----------
    template : str
        Source in which ``{h}`` stands for the hash.
    functions : list of str
        Names, without the hash, of the functions that will be called.
    """

    def __init__(self, template: str, functions: Collection[str]) -> None:
        key = "\n".join([template, numba.__version__, platform.python_version()])
        self.hash = hashlib.sha256(key.encode()).hexdigest()[:24]
        self.source = template.replace("{h}", self.hash)
        self._fresh = set(functions)
        self._path: Path | None = None

    @property
    def path(self) -> Path:
        """File that holds the source."""
        return self._path or cache_folder() / f"kernel_{self.hash}.py"

    def call(self, name: str, *arguments: Any) -> Any:
        """Call one of the functions, compiling it or taking it from the cache first."""
        if name not in self._fresh:
            return self._function(name)(*arguments)
        (result,) = in_background(lambda: self._first_call(name, *arguments))
        return result

    def _first_call(self, name: str, *arguments: Any) -> Any:
        with _LOCK, self._alone():
            cached = self._cached()
            try:
                result = self._function(name)(*arguments)
            except Exception:
                # numba names no exception for a cache entry that it cannot load. Where there was one, a new compilation
                # decides: an error of the kernel itself comes again.
                if not cached:
                    raise
                _MODULES.pop(self.hash, None)
                self._drop(lambda file: True)
                result = self._function(name)(*arguments)
            self._note()
            self._fresh.discard(name)
        return result

    def function(self, name: str, *arguments: Any) -> Callable[..., Any]:
        """The compiled function itself, for those who call it often; it is first called with these arguments."""
        self.call(name, *arguments)
        return self._function(name)

    def _function(self, name: str) -> Any:
        if self.hash not in _MODULES:
            with _LOCK:
                if self.hash not in _MODULES:
                    _MODULES[self.hash] = self._module()
        return getattr(_MODULES[self.hash], f"{name}_{self.hash}")

    def _module(self) -> ModuleType:
        path = self._path = cache_folder() / f"kernel_{self.hash}.py"
        try:
            if not (path.is_file() and path.read_bytes() == self.source.encode()):
                _replace(path, self.source)
        except OSError:  # something else stands there
            path = self._path = _private_folder() / path.name
            _replace(path, self.source)
        noted = self._noted()
        self._drop(lambda file: noted.get(file.name) != _checksum(file))
        loader, config = _Loader(self.source, str(path)), cast(Any, numba.config)
        spec = importlib.machinery.ModuleSpec(f"kernel_{self.hash}", loader)
        module = sys.modules[spec.name] = importlib.util.module_from_spec(spec)  # numba's cache looks it up by name
        elsewhere, config.CACHE_DIR = config.CACHE_DIR, ""  # numba's cache stays beside the file
        try:
            loader.exec_module(module)
        finally:
            config.CACHE_DIR = elsewhere
        return module

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """While no other process compiles this kernel: what two need at once is compiled by one of them."""
        with contextlib.ExitStack() as stack:
            if sys.platform != "win32":
                with contextlib.suppress(OSError):  # a folder that knows no locks
                    file = stack.enter_context((cache_folder() / f"kernel_{self.hash}.lock").open("w"))
                    fcntl.flock(file, fcntl.LOCK_EX)  # ends with the process that holds it
            yield

    # -- what numba cached, and whether it is still what it was -----------------------------------------------------
    def _cached(self) -> list[Path]:
        return list((self.path.parent / "__pycache__").glob(f"kernel_{self.hash}.*.nb*"))

    def _sums(self) -> Path:
        return self.path.with_suffix(".sums")

    def _noted(self) -> dict[str, str | None]:
        try:
            noted = json.loads(self._sums().read_text())
            return noted if isinstance(noted, dict) else {}
        except (OSError, ValueError, RecursionError):
            return {}

    def _note(self) -> None:
        try:
            _replace(self._sums(), json.dumps({file.name: _checksum(file) for file in self._cached()}))
        except OSError:
            return  # not noted, so not trusted: the next process compiles again

    def _drop(self, condemned: Callable[[Path], bool]) -> None:
        for file in self._cached():
            if condemned(file):
                file.unlink(missing_ok=True)


class _Loader(importlib.abc.InspectLoader):
    """Runs the text it was given, under the name of the file beside which numba caches."""

    def __init__(self, source: str, path: str) -> None:
        self.source, self.path = source, path

    def get_source(self, fullname: str) -> str:
        return self.source

    def get_code(self, fullname: str) -> Any:
        return self.source_to_code(self.source, self.path)


def _checksum(file: Path) -> str | None:
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return None


def _replace(path: Path, text: str) -> None:
    """Write a file so that others see the old one or the new one, never half of it."""
    handle, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.replace(name, path)
    except OSError:
        os.unlink(name)
        raise

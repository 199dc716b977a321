"""Caches on full disks, with wrong things in place, of other users, and too large; forks, and
JIT switched off.
"""

import importlib
import os
import resource
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import plant.compiler.kernel_cache
from plant.compiler import CACHE_VARIABLE, Kernel, prune

pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits and owners of POSIX")

FOLDER = importlib.import_module("plant.compiler.cache_folder")
TEMPLATE = """import numba


@numba.njit(cache=True)
def times_{h}(x):
    return x * FACTOR
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def called(monkeypatch, factor="3.0"):
    """A kernel of a process that knows none; whether numba took it from its cache, and what it
    gives of 2.
    """
    monkeypatch.setattr(plant.compiler.kernel_cache, "_MODULES", {})
    kernel = Kernel(TEMPLATE.replace("FACTOR", factor), ["times"])
    result = kernel.call("times", 2.0)
    return kernel, bool(kernel._function("times").stats.cache_hits), result


@pytest.mark.parametrize("most", [0, 1000])
def test_a_full_disk_is_not_fatal(folder, monkeypatch, most):
    """A limit of every file's size stands in for it: of the source, or of what numba writes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    try:
        kernel, cached, result = called(monkeypatch)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (cached, result) == (False, 6.0)
    assert not [
        file
        for file in folder.rglob("*")
        if file.is_file() and file.suffix not in (".lock", ".py", ".sums")
    ]
    assert kernel.call("times", 3.0) == 9.0
    assert called(monkeypatch)[1:] == (False, 6.0)
    assert called(monkeypatch)[1:] == (True, 6.0)


def test_wrong_things_in_their_places_are_not_fatal(folder, monkeypatch):
    kernel, *_ = called(monkeypatch)
    index, code = (next(iter(folder.glob(f"__pycache__/*{end}"))) for end in (".nbi", ".nbc"))
    for place in (index, code, kernel._sums(), folder / f"kernel_{kernel.hash}.lock"):
        place.unlink()
        place.mkdir()
        (place / "something").write_text("")
        assert called(monkeypatch)[2] == 6.0
    for file in folder.glob("__pycache__/*"):
        file.unlink()
    (folder / "__pycache__").rmdir()
    (folder / "__pycache__").write_text("a file where the folder should be")
    assert called(monkeypatch)[2] == 6.0


def test_files_and_folders_of_another_user_are_not_trusted(folder, monkeypatch):
    called(monkeypatch)
    assert called(monkeypatch)[1]
    if os.getuid():
        pytest.skip("only root can give files away")
    for pattern in ("*.sums", "__pycache__/*.nbc", "__pycache__/*.nbi"):
        for file in folder.glob(pattern):
            os.chown(file, 12345, -1)
        assert called(monkeypatch)[1:] == (False, 6.0), pattern
        assert called(monkeypatch)[1]
    os.chown(folder / "__pycache__", 12345, -1)
    kernel = called(monkeypatch)[0]
    assert kernel.path.parent != folder


def test_links_are_not_followed(folder, monkeypatch, tmp_path):
    called(monkeypatch)
    (folder / "__pycache__").rename(tmp_path / "elsewhere")
    (folder / "__pycache__").symlink_to(tmp_path / "elsewhere")
    kernel, _, result = called(monkeypatch)
    assert result == 6.0
    assert kernel.path.parent != folder


def test_the_kernels_that_were_not_used_for_longest_go_first(folder, monkeypatch):
    kernels = [called(monkeypatch, f"{i}.0")[0] for i in (3, 4, 5)]
    for i, kernel in enumerate(kernels):
        for file in (
            *folder.glob(f"*{kernel.hash}*"),
            *folder.glob(f"__pycache__/*{kernel.hash}*"),
        ):
            os.utime(file, (i, i))
    called(monkeypatch, "3.0")  # used again
    each = sum(file.stat().st_size for file in folder.rglob(f"*{kernels[0].hash}*"))
    monkeypatch.setattr(FOLDER, "MOST", int(2.5 * each))
    prune(folder, kernels[2].hash)
    assert [called(monkeypatch, f"{i}.0")[1] for i in (3, 5, 4)] == [True, True, False]
    monkeypatch.setattr(FOLDER, "MOST", 0)
    called(monkeypatch, "6.0")
    assert len({file.name[:31] for file in folder.glob("kernel_*")}) == 1


def test_without_jit_one_line_says_so(folder, monkeypatch):
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    with pytest.raises(
        ValueError, match=r"NUMBA_DISABLE_JIT must be 0: .* Unset it, and restart\.$"
    ):
        called(monkeypatch)


FORK = """
import os, threading, time
from plant.compiler import kernel_cache
from plant.compiler.kernel_cache import Kernel
slow = "import numba\\n\\n\\n@numba.njit(cache=True)\\ndef slow_{h}(x):\\n    y = 0.0\\n"
slow += "".join(f"    y += x ** {i} if y < {i}.5 else x\\n" for i in range(60)) + "    return y\\n"
fast = "import numba\\n\\n\\n@numba.njit(cache=True)\\ndef fast_{h}(x):\\n    return x + 1\\n"
thread = threading.Thread(target=Kernel(slow, ["slow"]).call, args=("slow", 0.5))
thread.start()
while not kernel_cache._MODULES:
    time.sleep(0.001)
child = os.fork()
if not child:
    if not kernel_cache._LOCK.acquire(blocking=False):
        os._exit(2)  # held by a thread that is not in this process
    kernel_cache._LOCK.release()
    os._exit(0 if Kernel(fast, ["fast"]).call("fast", 2.0) == 3.0 else 1)
assert os.waitpid(child, 0)[1] == 0
thread.join()
assert Kernel(fast, ["fast"]).call("fast", 3.0) == 4.0
print("no deadlock")
"""


def test_a_fork_during_a_compilation_does_not_deadlock(tmp_path):
    environment = {
        CACHE_VARIABLE: str(tmp_path / "kernels"),
        "PYTHONPATH": str(Path(__file__).parents[3]),
    }
    said = subprocess.run(  # noqa: S603 - the script above
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", FORK],
        env=os.environ | environment, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert said.stdout == "no deadlock\n", said.stderr

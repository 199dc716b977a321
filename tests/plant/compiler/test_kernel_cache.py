"""The kernel cache: right results whatever lies in the folder, and no compilation twice.

A kernel here multiplies by a constant, so a mix-up shows as a wrong number. Each `run` is a process
of its own, forked from one in which numba is awake: that saves two seconds every time.
"""

import json
import os
import stat
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import plant.compiler.kernel_cache
from plant.compiler import CACHE_VARIABLE, Kernel, cache_folder

pytestmark = pytest.mark.skipif(os.name != "posix", reason="forks processes and sets file modes")

TEMPLATE = """import numba

compiled = numba.njit(cache=True)


@compiled
def times_{h}(x):
    return x * FACTOR


@compiled
def plus_{h}(x):
    return x + FACTOR
"""

SCRIPT = """
import json, os, sys, traceback, types
for depth, name in enumerate(("plant", "plant.compiler")):  # without what their __init__ imports
    sys.modules[name] = package = types.ModuleType(name)
    package.__path__ = [sys.argv[1 + depth]]
import numba
from plant.compiler.cache_folder import CACHE_VARIABLE
from plant.compiler.kernel_cache import Kernel
numba.njit(lambda x: x * 2.0)(1.0)

def work(folder, templates):
    os.environ[CACHE_VARIABLE] = folder
    results = []
    for template in templates:
        kernel = Kernel(template, ["times", "plus"])
        result = kernel.call("times", 2.0)
        stats = kernel._function("times").stats
        results.append((result, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), str(kernel.path)))
    return results

for line in sys.stdin:
    child = os.fork()
    if not child:
        try:
            answer = work(*json.loads(line))
        except BaseException:
            answer = traceback.format_exc()
        print(json.dumps(answer), flush=True)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        print(json.dumps("the process crashed"), flush=True)
"""


def text_of(factor):
    return TEMPLATE.replace("FACTOR", factor)


def kernel_of(factor):
    return Kernel(text_of(factor), ["times", "plus"])


def start():
    """A process in which numba is awake but no kernel was made, and which forks for every
    request.
    """
    room = Path(plant.compiler.kernel_cache.__file__).parent
    command = [sys.executable, "-c", SCRIPT, str(room.parent), str(room)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)  # noqa: S603


def ask(process, folder, *factors):
    process.stdin.write(json.dumps([str(folder), [text_of(factor) for factor in factors]]) + "\n")
    process.stdin.flush()


def answer(process):
    results = json.loads(process.stdout.readline())
    assert isinstance(results, list), results
    return [tuple(result) for result in results]


@pytest.fixture(scope="module")
def run():
    """(result of times(2), from numba's cache, compiled, path) of each kernel, in a new process."""
    with start() as process:

        def in_new_process(folder, *factors):
            ask(process, folder, *factors)
            return answer(process)

        yield in_new_process
        process.stdin.close()


@pytest.fixture(scope="module")
def used(tmp_path_factory, run):
    """A folder in which another process left the kernel of 3.0."""
    folder = tmp_path_factory.mktemp("cache") / "kernels"
    assert run(folder, "3.0")[0][:3] == (6.0, 0, 1)
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty cache for this process."""
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "kernels"))
    monkeypatch.setattr(plant.compiler.kernel_cache, "_MODULES", {})
    return tmp_path / "kernels"


def kept(folder, pattern):
    found = sorted(folder.rglob(pattern))
    assert found
    return found


def test_hash_is_in_the_name_of_file_module_and_functions_and_follows_the_text(folder):
    kernel, same, other = kernel_of("3.0"), kernel_of("3.0"), kernel_of("4.0")
    assert kernel.path == same.path
    assert kernel.hash != other.hash
    assert kernel.path == folder / f"kernel_{kernel.hash}.py"
    assert "{h}" not in kernel.source
    function = kernel._function("times")
    assert function.__name__ == f"times_{kernel.hash}"
    assert function.py_func.__module__ == f"kernel_{kernel.hash}"
    assert kernel.path.read_text() == kernel.source


def test_two_kernels_in_one_process_do_not_mix(folder):
    kernels = {factor: kernel_of(factor) for factor in ("3.0", "4.0")}
    assert [kernels[f].call("times", 2.0) for f in ("3.0", "4.0", "3.0")] == [6.0, 8.0, 6.0]
    assert [kernels[f].call("plus", 2.0) for f in ("4.0", "3.0")] == [6.0, 5.0]
    assert kernel_of("3.0").call("times", 1.5) == 4.5


def test_new_process_takes_the_kernel_from_the_cache_and_two_do_not_mix(run, used):
    # Both kernels have functions of the same names, differing only in the hash.
    first, second = run(used, "3.0", "7.0")
    assert first[:3] == (6.0, 1, 0)
    assert second[0] == 14.0
    assert [line[:3] for line in run(used, "7.0", "3.0")] == [(14.0, 1, 0), (6.0, 1, 0)]


def test_file_whose_content_is_right_is_never_rewritten(run, used):
    path = Path(run(used, "3.0")[0][3])
    # numba's index holds the time stamp: a new one costs one compilation
    os.utime(path, ns=(10**18, 10**18))
    run(used, "3.0")
    before = path.stat()
    assert run(used, "3.0")[0][:3] == (6.0, 1, 0)
    assert (path.stat().st_mtime_ns, path.stat().st_ino) == (10**18, before.st_ino)


def test_folder_belongs_to_the_user_alone(folder):
    assert cache_folder() == folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def test_environment_variable_comes_before_the_usual_places(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    assert cache_folder() == tmp_path / "xdg" / "onepulse"
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.delenv(CACHE_VARIABLE)
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert cache_folder() == tmp_path / "home" / ".cache" / "onepulse"


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o777])
def test_folder_open_to_others_is_not_used(folder, mode):
    folder.mkdir()
    folder.chmod(mode)
    with pytest.warns(UserWarning, match="chmod 700"):
        fallback = cache_folder()
    assert fallback != folder
    assert stat.S_IMODE(fallback.stat().st_mode) == 0o700
    # Said once; afterwards the same folder is passed over in silence.
    assert fallback == cache_folder()  # one per process


@pytest.mark.filterwarnings("ignore:ONEPULSE_CACHE")
def test_folder_of_another_user_is_not_used(folder, monkeypatch):
    folder.mkdir(mode=0o700)
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    assert cache_folder() != folder


@pytest.mark.filterwarnings("ignore:ONEPULSE_CACHE")
def test_unusable_folder_is_not_fatal(folder, monkeypatch):
    folder.write_text("a file where the folder should be")
    assert kernel_of("3.0").call("times", 2.0) == 6.0
    monkeypatch.setenv(CACHE_VARIABLE, "/proc/nowhere/kernels")
    monkeypatch.setattr(plant.compiler.kernel_cache, "_MODULES", {})
    assert kernel_of("3.0").call("times", 2.0) == 6.0


def test_folder_in_place_of_the_source_is_not_fatal(folder, monkeypatch):
    folder.mkdir(mode=0o700)
    kernel = kernel_of("3.5")
    (folder / f"kernel_{kernel.hash}.py").mkdir()
    assert kernel.call("times", 2.0) == 7.0
    assert kernel.path.parent != folder
    # nothing half-written is left
    assert {file.suffix for file in folder.iterdir() if file.is_file()} == {".lock"}


@pytest.mark.filterwarnings("ignore:ONEPULSE_CACHE")
def test_read_only_folder_is_not_fatal(folder):
    folder.mkdir(mode=0o700)
    folder.chmod(0o500)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pytest.skip("this user writes where nobody may (root)")
    except OSError:
        assert cache_folder() != folder
        assert kernel_of("3.0").call("times", 2.0) == 6.0
    finally:
        folder.chmod(0o700)


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0x10
    path.write_bytes(content)


def truncate(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 3])


def alter(path):
    """The machine code multiplies by 5: nothing but a checksum tells."""
    content = path.read_bytes()
    assert struct.pack("<d", 3.0) in content
    path.write_bytes(content.replace(struct.pack("<d", 3.0), struct.pack("<d", 5.0)))


def garbage(path):
    path.write_bytes(b"\xff\xfe{garbage")


def nested(path):
    path.write_text("[" * 200_000)


def foreign(path):
    """The same kernel with another constant, as an attacker or a mix-up would leave it."""
    path.write_text(path.read_text().replace("3.0", "5.0"))


@pytest.mark.parametrize(
    ("pattern", "damage"),
    [
        ("*.py", truncate), ("*.py", foreign), ("*.nbi", truncate), ("*.nbi", flip), ("*.nbi", garbage),
        ("*.nbc", truncate), ("*.nbc", flip), ("*.nbc", alter), ("*.nbc", garbage),
        ("*.sums", garbage), ("*.sums", nested),
    ],
    ids=lambda value: getattr(value, "__name__", value),
)  # fmt: skip
def test_damaged_file_is_rebuilt(run, used, pattern, damage):
    kernel = kernel_of("3.0")
    run(used, "3.0")
    for path in kept(used, f"kernel_{kernel.hash}{pattern}"):
        damage(path)
    assert run(used, "3.0")[0][0] == 6.0
    assert run(used, "3.0")[0][:3] == (6.0, 1, 0)  # and cached again
    assert (used / kernel.path.name).read_text() == kernel.source


def test_code_of_another_kernel_in_the_cache_is_not_run(run, used):
    """A whole and valid file of numba's, but of another kernel under this one's name."""
    run(used, "3.0", "9.0")
    mine, other = kernel_of("3.0").hash, kernel_of("9.0").hash
    for path in kept(used, f"kernel_{other}.*.nbc"):
        victim = path.with_name(path.name.replace(other, mine))
        assert victim.exists()
        victim.write_bytes(path.read_bytes())
    assert run(used, "3.0")[0][0] == 6.0


def test_two_processes_at_once_agree_and_compile_once(run, tmp_path):
    with start() as first, start() as second:
        for process in (first, second):
            ask(process, tmp_path / "none")
        for process in (first, second):
            assert answer(process) == []
        for process in (first, second):  # both awake: now the race
            ask(process, tmp_path / "kernels", "3.0", "4.0")
        answers = [answer(process) for process in (first, second)]
        assert [[line[0] for line in each] for each in answers] == [[6.0, 8.0]] * 2
        assert [sum(line[2] for line in lines) for lines in zip(*answers, strict=True)] == [1, 1]
        first.stdin.close()
        second.stdin.close()
    run(tmp_path / "kernels", "3.0", "4.0")  # if each condemned the other's files
    assert [line[:3] for line in run(tmp_path / "kernels", "3.0", "4.0")] == [
        (6.0, 1, 0),
        (8.0, 1, 0),
    ]


def test_error_of_the_kernel_itself_comes_through(folder):
    with pytest.raises(Exception, match=r"(?i)string|unicode|typing"):
        kernel_of("3.0").call("times", "text")
    assert kernel_of("3.0").call("times", np.float64(2.0)) == 6.0

"""Campaigns: results by name, failures named, nothing lost when killed, and folders that refuse
what is not theirs.
"""

import functools
import operator
import os
import sqlite3
import subprocess
import sys
import threading
import time
import tracemalloc
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import campaign_tasks as work
import numpy as np
import pytest

from ctc import ComputedTorque, campaign
from plant import puma560


def run(tasks, **options):
    return campaign(tasks, progress=False, **options)


def test_results_and_errors_by_name():
    done = run(
        {
            "a": (work.square, (3,), {}),
            "b": (work.failing, (), {"x": 1}),
            "c": (work.square, (), {"x": 4}),
        }
    )
    assert dict(done.results) == {"a": 9, "c": 16}
    assert dict(done.errors) == {"b": "RuntimeError: no 1 at all"}
    assert "2 tasks done, 1 failed" in str(done)
    assert "no 1 at all" in str(done)


def test_a_million_are_not_listed():
    """An iterable is read as workers become free: never much farther than what has ended."""
    read, ended, ahead = 0, 0, 0
    lock = threading.Lock()

    def given():
        nonlocal read, ahead
        for i in range(500):
            read += 1
            ahead = max(ahead, read - ended)
            yield str(i), (count, (i,), {})

    def count(i):
        nonlocal ended
        with lock:
            ended += 1
        return i

    came = []
    run(
        given(), executor=lambda: ThreadPoolExecutor(2), each=lambda name, result: came.append(name)
    )
    assert sorted(came, key=int) == [str(i) for i in range(500)]
    assert ahead <= 8


def test_memory_does_not_grow_with_the_tasks_of_a_folder(tmp_path):
    peaks = []
    for count in (300, 1500):
        tracemalloc.start()
        run(
            ((str(i), (bytes.decode, (b"x" * 2000,), {})) for i in range(count)),
            folder=tmp_path / str(count),
        )
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < peaks[0] + 300_000  # the results alone are 2.4 MB more


def test_a_task_that_fails_is_tried_again_so_often_and_no_more(tmp_path):
    def flaky(path):
        path.write_text(path.read_text() + "x" if path.exists() else "x")
        if len(path.read_text()) < 3:
            raise OSError("the network is gone")
        return 1

    assert run({"a": (flaky, (tmp_path / "a",), {})}, retries=2).results == {"a": 1}
    assert "network" in run({"b": (flaky, (tmp_path / "b",), {})}, retries=1).errors["b"]
    assert (tmp_path / "b").read_text() == "xx"


def test_results_in_a_folder_come_back_as_they_were(tmp_path):
    law = ComputedTorque(puma560.arm(), puma560.rig(), bandwidth=150)
    values = {
        "law/a": law,
        "x": np.arange(3.0),
        "nan": float("nan"),
        "mixed": {"a": [1, (2.5, None)]},
        "text": "ä\n",
    }
    done = run({name: (_same, (value,), {}) for name, value in values.items()}, folder=tmp_path)
    assert not done.errors
    assert list(done.results) == list(values)
    assert done.results["law/a"] == law
    assert np.array_equal(done.results["x"], values["x"])
    assert np.isnan(done.results["nan"])
    assert done.results["mixed"] == {"a": [1, [2.5, None]]} or done.results["mixed"] == {
        "a": [1, (2.5, None)]
    }
    (file,) = (tmp_path / "results").rglob("*.json")
    assert ComputedTorque.load(file) == law
    with pytest.raises(KeyError):
        done.results["nothing"]


def test_what_no_file_can_hold_is_named(tmp_path):
    done = run({"a": (threading.Lock, (), {}), "b": (work.square, (2,), {})}, folder=tmp_path)
    assert done.results["b"] == 4
    assert "must be kept in a file" in done.errors["a"]


def _same(value):
    return value


def start(folder, log, count, kind):
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join((os.getcwd(), str(Path(work.__file__).parent))),
    }
    return subprocess.Popen(  # noqa: S603 - the script beside this one
        [sys.executable, work.__file__, folder, log, str(count), kind],
        env=environment,
        stdout=subprocess.PIPE,
    )


def test_a_killed_campaign_goes_on_and_does_nothing_twice_but_what_was_open(tmp_path):
    """On processes, and killed ten times: tests/benchmarks/campaign.py."""
    kind, count, log = "threads", 120, tmp_path / "log"
    kills = np.random.default_rng(1)
    opened = 0
    for _ in range(2):
        process = start(tmp_path / "folder", log, count, kind)
        process.stdout.readline()
        time.sleep(kills.uniform(0.05, 0.5))
        process.kill()
        process.wait()
        process.stdout.close()
        opened += _states(tmp_path / "folder").count("open")
    done = run(work.tasks(log, count, 0.01), folder=tmp_path / "folder", executor=work.KINDS[kind])
    assert list(done.results) == [f"task {i}" for i in range(count)]
    for i, result in enumerate(done.results.values()):
        assert np.array_equal(result, np.random.default_rng(i).standard_normal(3))
    ran = log.read_text().split()
    assert set(map(int, ran)) == set(range(count))
    assert len(ran) <= count + opened
    assert (
        run(work.tasks(log, count, 0.01), folder=tmp_path / "folder").results["task 7"] is not None
    )
    assert log.read_text().split() == ran


def _states(folder):
    if not (folder / "ledger.sqlite").exists():
        return []
    try:
        return [
            row[0]
            for row in sqlite3.connect(folder / "ledger.sqlite").execute("select state from tasks")
        ]
    except sqlite3.OperationalError:  # killed before the table was made
        return []


def test_two_campaigns_in_one_folder_refuse_each_other(tmp_path):
    with pytest.raises(
        ValueError, match=r"folder .* must be of no other campaign that runs; one holds it"
    ):
        run(
            {"a": (_nested, (tmp_path,), {})},
            folder=tmp_path,
            each=lambda name, result: run({}, folder=tmp_path),
        )
    assert run({"a": (_nested, (tmp_path,), {})}, folder=tmp_path).results["a"] == 1


def _nested(path):
    return 1


def test_folders_of_other_tasks_and_versions_are_refused(tmp_path):
    tasks = {"a": (work.square, (3,), {}), "b": (work.square, (4,), {})}
    run(tasks, folder=tmp_path)
    for other, what in (
        ({"z": (work.square, (3,), {})}, "its task 0 is 'a', got 'z'"),
        ({"a": (work.square, (5,), {})}, "other work of this name"),
        ({"a": (work.failing, (3,), {})}, "other work of this name"),
    ):
        with pytest.raises(ValueError, match=what):
            run(other, folder=tmp_path)
    run(tasks | {"c": (work.square, (5,), {})}, folder=tmp_path)  # more may follow
    with sqlite3.connect(tmp_path / "ledger.sqlite") as base:
        base.execute("update campaign set value = 'other' where key = 'versions'")
    base.close()
    with pytest.raises(ValueError, match=r"must be of the versions .* got other\. Give another"):
        run(tasks, folder=tmp_path)
    (tmp_path / "text").mkdir()
    (tmp_path / "text" / "ledger.sqlite").write_text("no base, " * 200)
    with pytest.raises(ValueError, match="must be a ledger of campaign"):
        run(tasks, folder=tmp_path / "text")


class Times:
    def __init__(self, factor):
        self.factor = factor

    def by(self, x):
        return self.factor * x


def made(factor):
    return lambda x: factor * x


@pytest.mark.parametrize("of", [lambda k: functools.partial(pow, k), lambda k: Times(k).by, made,
                                lambda k: lambda x, k=k: k * x])  # fmt: skip
def test_functions_that_hold_other_numbers_are_other_work(tmp_path, of):
    campaign({"a": (of(3), (2,), {})}, folder=tmp_path, progress=False)
    assert campaign({"a": (of(3), (2,), {})}, folder=tmp_path, progress=False).results
    with pytest.raises(ValueError, match="other work of this name"):
        campaign({"a": (of(4), (2,), {})}, folder=tmp_path, progress=False)


class Slotted:
    __slots__ = ("factor",)

    def __init__(self, factor):
        self.factor = factor

    def __call__(self, x):
        return self.factor * x


def double(function):
    @functools.wraps(function)
    def wrapper(x):
        return 2 * function(x)

    return wrapper


def triple(function):
    @functools.wraps(function)
    def wrapper(x):
        return 3 * function(x)

    return wrapper


def cached(factor):
    return functools.lru_cache(lambda x: factor * x)


def local(factor):
    class Local:
        def __call__(self, x):
            return factor * x

    return Local()


def typed_in(text):
    """A function without source text, as of an interactive session."""
    return eval(text, {})  # noqa: S307 - texts of this file


def first_of(functions, x):
    return functions[0](x)


def holding(functions):
    return lambda x: functions[0](x)


def negative(x):
    return -x


TWICE, THRICE = (lambda x: 2 * x), (lambda x: 3 * x)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((first_of, ([abs], -2)), (first_of, ([negative], -2))),
        ((first_of, ({0: abs}, -2)), (first_of, ({0: negative}, -2))),
        ((holding([abs]), (-2,)), (holding([negative]), (-2,))),
        ((functools.partial(first_of, (abs,)), (2,)), (functools.partial(first_of, (int,)), (2,))),
        ((operator.itemgetter(0), ("ab",)), (operator.itemgetter(1), ("ab",))),
        ((np.sin, (1,)), (np.cos, (1,))),
        ((Slotted(2), (1,)), (Slotted(3), (1,))),
        (({"x": 1}.get, ("x",)), ({"x": 2}.get, ("x",))),
        ((cached(2), (1,)), (cached(3), (1,))),
        ((double(negative), (1,)), (triple(negative), (1,))),
        ((local(2), (1,)), (local(3), (1,))),
        ((TWICE, (1,)), (THRICE, (1,))),
        ((typed_in("lambda x: 2 * x"), (1,)), (typed_in("lambda x: 3 * x"), (1,))),
        ((typed_in("lambda x: abs(x)"), (1,)), (typed_in("lambda x: str(x)"), (1,))),
        ((str, (Path("a"),)), (str, (Path("b"),))),
        ((len, (b"a",)), (len, (b"ab",))),
        ((len, ({"a"},)), (len, ({"a", "b"},))),
        ((len, (defaultdict(int),)), (len, (defaultdict(str),))),
    ],
)
def test_work_that_differs_in_what_it_holds_gives_no_result_of_the_other(tmp_path, one, other):
    """The folder knows the same work again, and refuses the other."""
    for _ in range(2):
        done = run({"a": (*one, {})}, folder=tmp_path)
        assert not done.errors
    with pytest.raises(ValueError, match="other work of this name"):
        run({"a": (*other, {})}, folder=tmp_path)


def test_work_is_the_same_in_every_process(tmp_path):
    """A set has another order there, and a function that numba compiles another number."""
    script = tmp_path / "script.py"
    script.write_text(
        "import sys\n"
        "import numba\n"
        "from ctc import campaign\n"
        "@numba.njit\n"
        "def twice(x):\n"
        "    return 2 * x\n"
        "tasks = {\n"
        "    'a': (twice, (1,), {}),\n"
        "    'b': (len, ({'a', 'b', 'c', 'd', 'e'},), {}),\n"
        "    'c': (lambda x: x in {'a', 'b', 'c', 'd', 'e'}, ('a',), {}),\n"
        "}\n"
        "done = campaign(tasks, folder=sys.argv[1], progress=False)\n"
        "print(sorted(done.results))\n"
    )
    for seed in "12":
        process = subprocess.run(  # noqa: S603 - the script above
            [sys.executable, script, tmp_path / "folder"],
            env={**os.environ, "PYTHONPATH": os.getcwd(), "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=False,
        )
        assert process.stdout.strip() == "['a', 'b', 'c']", process.stderr


def test_an_object_that_holds_itself_is_known_again(tmp_path):
    ring = []
    ring.append(ring)
    for _ in range(2):
        assert run({"a": (len, (ring,), {})}, folder=tmp_path).results["a"] == 1


def test_what_a_later_call_cannot_compare_is_refused(tmp_path):
    tasks = {"a": (sum, ((i for i in range(3)),), {})}
    with pytest.raises(ValueError, match=r"tasks of a folder must hold .* type generator"):
        run(tasks, folder=tmp_path)
    assert run(tasks).results == {"a": 3}


def test_each_is_called_with_successes_alone():
    names = []
    tasks = {"a": (work.square, (3,), {}), "b": (work.failing, (3,), {})}
    run(tasks, each=lambda name, result: names.append(name))
    assert names == ["a"]


def test_a_folder_answers_what_is_asked_and_makes_anew_what_was_deleted(tmp_path):
    tasks = {name: (puma560.rig, (), {}) for name in "abc"}
    campaign(tasks, folder=tmp_path, progress=False)
    assert list(campaign({"a": tasks["a"]}, folder=tmp_path, progress=False).results) == ["a"]
    next(tmp_path.glob("results/000/000001_*")).unlink()
    assert campaign(tasks, folder=tmp_path, progress=False).results["b"] == puma560.rig()


def test_a_failure_is_tried_again_by_the_next_call(tmp_path):
    path = tmp_path / "given"
    tasks = {"a": (_read, (path,), {})}
    assert "FileNotFoundError" in run(tasks, folder=tmp_path / "folder").errors["a"]
    path.write_text("7")
    again = run(tasks, folder=tmp_path / "folder")
    assert (dict(again.results), dict(again.errors)) == ({"a": "7"}, {})


def test_a_task_that_is_tried_again_has_the_seconds_of_its_last_attempt(tmp_path):
    """The time between two calls is not the work of a task."""
    run({"a": (int, ("none",), {})}, folder=tmp_path / "folder")
    with sqlite3.connect(tmp_path / "folder" / "ledger.sqlite") as ledger:
        ledger.execute("update tasks set began = began - 1000")
    run({"a": (int, ("none",), {})}, folder=tmp_path / "folder")
    with sqlite3.connect(tmp_path / "folder" / "ledger.sqlite") as ledger:
        ((seconds,),) = ledger.execute("select seconds from tasks")
    assert seconds < 1000


def test_a_ledger_that_cannot_be_opened_frees_its_folder(tmp_path):
    """The folder takes the next campaign as soon as its ledger can be opened."""
    ledger = tmp_path / "folder" / "ledger.sqlite"
    # A folder in the place of the ledger: no database can be opened there.
    ledger.mkdir(parents=True)
    with pytest.raises(ValueError, match="must be one that can be written") as refusal:
        run({"a": (work.square, (3,), {})}, folder=tmp_path / "folder")
    ledger.rmdir()
    # The refusal holds the frames of the first call: the lock must not wait for their end.
    assert dict(run({"a": (work.square, (3,), {})}, folder=tmp_path / "folder").results) == {"a": 9}
    del refusal


def _read(path):
    return path.read_text()


def test_a_folder_that_fills_loses_nothing(tmp_path, monkeypatch):
    law = ComputedTorque(puma560.arm(), puma560.rig(), bandwidth=150)
    tasks = {"a": (work.square, (1,), {}), "b": (_same, (law,), {}), "c": (work.square, (2,), {})}
    full = OSError(28, "No space left on device")

    def save(self, path):
        raise full

    with monkeypatch.context() as patched:
        patched.setattr(type(law), "save", save)
        with pytest.raises(
            ValueError, match=r"folder .* can be written; No space left on device.*kept"
        ):
            run(tasks, folder=tmp_path, executor=lambda: ThreadPoolExecutor(1))
    done = run(tasks, folder=tmp_path)
    assert list(done.results) == ["a", "b", "c"]
    assert done.results["b"] == law


@pytest.mark.parametrize(
    ("tasks", "options", "said"),
    [
        (3, {}, "tasks must be a mapping or pairs; got a value of type int"),
        ([("a",)], {}, "a task must be a name and"),
        ([("a", (3, (), {}))], {}, r"task 'a' must be \(function, args, kwargs\)"),
        ([("a", (abs, 3, {}))], {}, r"task 'a' must be \(function, args, kwargs\)"),
        ([("a", (abs, (1,), {}))] * 2, {}, "names of tasks must differ; 'a' comes twice"),
        ({}, {"executor": 3}, "executor must take calls; got a value of type int"),
        ({}, {"executor": lambda: 3}, "executor must make an executor; it made a int"),
        ({}, {"retries": -1}, "retries must be a whole number"),
        ([("a", (abs, (1,), {}))], {"each": 1}, "each must be a function; got 1"),
    ],
)
def test_bad_input_is_one_line(tasks, options, said, tmp_path):
    for more in ({}, {"folder": tmp_path}):
        with pytest.raises(ValueError, match=said) as caught:
            run(tasks, **options, **more)
        assert "\n" not in str(caught.value)


def test_a_closed_executor_is_refused():
    pool = ThreadPoolExecutor(1)
    pool.shutdown()
    with pytest.raises(ValueError, match="executor must be open; it is closed"):
        run({"a": (abs, (1,), {})}, executor=pool)


def test_the_users_own_executor_stays_open():
    with ThreadPoolExecutor(1) as pool:
        assert run({"a": (abs, (-1,), {})}, executor=pool).results == {"a": 1}
        assert pool.submit(abs, -2).result() == 2

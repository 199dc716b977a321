"""The process of the estimators: shared by threads, never waited for, and missed when it ends.

Functions of the standard library stand for estimators, since the process can import them.
"""

import os
import subprocess
import threading
import time
import types
from functools import partial
from multiprocessing.connection import Connection

import numpy as np
import pytest

from identification.payload import LoadShape, Specification, Worker, shared_worker
from identification.payload import worker as module
from plant import puma560


@pytest.fixture(scope="module")
def worker():
    process = Worker()
    yield process
    process.close()
    assert not process.alive


def made(worker, function, *arguments):
    """Number of an "estimator" that calls a function of these arguments and of the window."""
    return worker.prepare(types.SimpleNamespace(made=partial(partial, function, *arguments)))


def sleep(seconds):
    """A "window" of `subprocess.call`, whose answer is 0."""
    return ["sleep", str(seconds)]


def test_a_poll_returns_at_once_where_another_thread_takes_the_answer_that_it_saw(
    worker, monkeypatch
):
    power, call = made(worker, pow, 2), made(worker, subprocess.call)
    ready = Connection.poll

    def seen_by_both(self, timeout=0.0):
        """As `Connection.poll`; then the other thread has its turn, as it may anywhere."""
        seen = ready(self, timeout)
        time.sleep(0.1)
        return seen

    monkeypatch.setattr(Connection, "poll", seen_by_both)
    quick, slow = worker.submit(power, 5), worker.submit(call, sleep(2))
    time.sleep(0.5)
    polls = {}

    def poll(job):
        begin = time.perf_counter()
        polls[job] = worker.poll(job), time.perf_counter() - begin

    threads = [threading.Thread(target=poll, args=(job,)) for job in (quick, slow)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [polls[quick][0], polls[slow][0]] == [32, None]
    assert max(seconds for _, seconds in polls.values()) < 0.8
    assert worker.wait(slow, 20) == 0


def test_threads_get_their_own_answers(worker):
    power = made(worker, pow, 2)
    answers = {}

    def loop(numbers):
        jobs = {number: worker.submit(power, number) for number in numbers}
        answers.update({number: worker.wait(job, 20) for number, job in jobs.items()})

    threads = [threading.Thread(target=loop, args=(range(k, 400, 4),)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == {k: 2**k for k in range(400)}


def test_a_full_pipe_does_not_hold_up_the_one_who_submits(worker):
    call, size = made(worker, subprocess.call), made(worker, len)
    busy = worker.submit(call, sleep(1))
    # Far more than the 64 KiB of a pipe, while the process does not read.
    jobs = [worker.submit(size, bytes(300_000 + k)) for k in range(3)]
    assert worker.poll(busy) is None
    assert [worker.wait(job, 20) for job in jobs] == [300_000, 300_001, 300_002]


def test_the_limit_of_a_wait_is_that_of_all_answers_together(worker):
    call = made(worker, subprocess.call)
    jobs = [worker.submit(call, sleep(0.3)) for _ in range(5)]
    with pytest.raises(ValueError, match="the process of the estimator must answer"):
        worker.wait(jobs[-1], 0.6)
    assert worker.wait(jobs[-1], 20) == 0


class Unreadable:
    def __reduce__(self):
        return int, ("no number",)


def test_a_request_that_cannot_be_read_is_its_own_error_and_no_end_for_others(worker):
    power = made(worker, pow, 2)
    with pytest.raises(ValueError, match="invalid literal for int"):
        worker.prepare(Unreadable())
    job = worker.submit(power, Unreadable())
    with pytest.raises(ValueError, match="invalid literal for int"):
        worker.wait(job, 20)
    assert worker.wait(worker.submit(power, 5), 20) == 32


def test_an_error_of_an_estimator_is_raised_where_its_answer_is_asked_for(worker):
    power = made(worker, pow, 0)
    job = worker.submit(power, -1)
    with pytest.raises(ValueError, match="cannot be raised to a negative power"):
        worker.wait(job, 20)


def test_a_process_that_ends_is_missed_at_once():
    worker = Worker()
    leave = made(worker, os._exit)
    lost = worker.submit(leave, 3)
    begin = time.perf_counter()
    with pytest.raises(ValueError, match="the process of the estimator must run; it has ended"):
        worker.wait(lost, 60)
    assert time.perf_counter() - begin < 20
    # Requests to it do not raise in a control loop; their answers do.
    for _ in range(3):
        job = worker.submit(leave, 3)
        with pytest.raises(ValueError, match="it has ended"):
            worker.poll(job)
    worker.close()
    assert not worker.alive


def test_two_threads_start_one_process(monkeypatch):
    class Slow:
        alive = True

        def __init__(self):
            time.sleep(0.1)

        def close(self):
            """As of a worker; there is nothing to close."""

    monkeypatch.setattr(module, "Worker", Slow)
    storage, workers = [], []
    threads = [
        threading.Thread(target=lambda: workers.append(shared_worker(storage))) for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len({id(worker) for worker in workers}) == 1


def test_an_unknown_method_is_refused():
    arm, rig = puma560.arm(), puma560.rig()
    with pytest.raises(ValueError, match="method must be one of 'kernel', 'genetic'; got 'kernal'"):
        Specification(
            method="kernal",
            arm=arm,
            rig=rig,
            shape=LoadShape.of(arm, (0, 5), (0.0, -0.4, 0.0), None, (0.2, 0.5), (0,) * 6),
            unknown=(),
            root=np.zeros((0, 0)),
            samples=300,
            seed=0,
        )

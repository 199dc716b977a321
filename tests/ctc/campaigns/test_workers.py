"""Campaigns on processes and on Dask: the same bits, and workers that are killed."""

import campaign_tasks as work
import numpy as np
import pytest

from ctc import campaign


def run(tasks, **options):
    return campaign(tasks, progress=False, **options)


def test_a_poisoned_task_is_named_and_the_others_are_done(tmp_path):
    tasks = {str(i): (work.square, (i,), {}) for i in range(12)}
    tasks |= {"poison": (work.killer, (), {})} | {
        str(i): (work.square, (i,), {}) for i in range(12, 20)
    }
    done = run(tasks, executor=work.pool, folder=tmp_path)
    assert dict(done.results) == {str(i): i * i for i in range(20)}
    assert list(done.errors) == ["poison"]
    assert done.errors["poison"].startswith("its worker was killed")


def test_a_pool_without_a_factory_says_so():
    with (
        work.pool() as pool,
        pytest.raises(ValueError, match=r"one was killed while .*poison.* Give a function"),
    ):
        run({"poison": (work.killer, (), {})}, executor=pool)


def test_what_cannot_be_sent_is_named():
    done = run({"a": (lambda: 1, (), {}), "b": (work.square, (2,), {})}, executor=work.pool)
    assert done.results == {"b": 4}
    assert "cannot be sent to another process" in done.errors["a"]


@pytest.fixture(scope="module")
def client():
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with (
        # by default it kills four workers
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.mark.filterwarnings("ignore")  # of Dask's own workers that end
def test_dask_gives_the_same_bits(client, tmp_path):
    tasks = dict(work.tasks(tmp_path / "log", 40, 0.0))
    alone = run(tasks)
    for executor in (client, client.get_executor()):
        there = run(tasks, executor=executor)
        assert list(alone.results) == sorted(there.results, key=list(tasks).index)
        assert all(np.array_equal(alone.results[name], there.results[name]) for name in tasks)


@pytest.mark.filterwarnings("ignore")
def test_dask_names_what_kills_and_what_fails(client):
    tasks = {
        "poison": (work.killer, (), {}),
        "bad": (work.failing, (2,), {}),
        "good": (work.square, (3,), {}),
    }
    done = run(tasks, executor=client, retries=0)
    assert done.results == {"good": 9}
    assert done.errors["bad"] == "RuntimeError: no 2 at all"
    assert "its worker was killed" in done.errors["poison"]


@pytest.mark.filterwarnings("ignore")
def test_a_closed_client_is_refused():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:
        closed = distributed.Client(cluster)
        closed.close()
        with pytest.raises(ValueError, match="executor must be open; it is closed"):
            run({"a": (work.square, (3,), {})}, executor=closed)

"""Campaigns measured: ``python tests/benchmarks/campaign.py [--tasks N] [--kills N] [--logs N] [--rare]``.

- Overhead: time of tasks that do nothing, by threads and by Dask with two workers, with and without a folder; beside
  Dask's own `submit` in the same run, and the memory that the coordinator takes.
- Efficiency: identifications of simulated logs of several robots by one thread, two threads, two processes and Dask
  with two workers: times and whether all bits are the same.
- Kills: a campaign killed at random instants and called again: what was lost, and what was done twice.
- ``--rare``: subset simulation against an exact 1e-6 and against brute force on the arm.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import campaign_tasks as work  # noqa: E402

from ctc import ComputedTorque, Uncertainty, campaign, certify  # noqa: E402
from ctc.certification.rare import subset_simulation  # noqa: E402
from identification import identify  # noqa: E402
from plant import puma560, simulate  # noqa: E402


def cluster():
    import distributed

    return distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)


def per_task(count, make, executor):
    """Time of a task [ms], wall and processor of this process, and peak memory of Python [MB]."""
    began, own = time.perf_counter(), time.process_time()
    make(count, executor)
    wall, own = time.perf_counter() - began, time.process_time() - own
    tracemalloc.start()
    make(count // 5, executor)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return f"{1e3 * wall / count:6.2f} ms a task (processor {1e3 * own / count:.2f} ms), peak {peak:.1f} MB"


def small(count, executor, folder=None):
    tasks = ((str(i), (work.square, (i,), {})) for i in range(count))
    done = campaign(tasks, executor=executor, folder=folder, progress=False)
    assert len(done.results) == count


def small_in_folder(count, executor):
    with tempfile.TemporaryDirectory() as folder:
        small(count, executor, folder)


def plain_dask(count, client):
    open_ = deque()
    for i in range(count):
        open_.append(client.submit(work.square, i, pure=False))
        if len(open_) >= 256:
            open_.popleft().result()
    while open_:
        open_.popleft().result()


def overhead(count):
    print(f"overhead of {count} tasks that do nothing; memory of a fifth of them")
    for name, make in (("in memory", small), ("in a folder", small_in_folder)):
        print(f"  threads, {name}: {per_task(count, make, lambda: ThreadPoolExecutor(2))}", flush=True)
    import distributed

    with cluster() as two, distributed.Client(two) as client:
        for name, make in (("in memory", small), ("in a folder", small_in_folder), ("its own submit", plain_dask)):
            print(f"  Dask, {name}: {per_task(count, make, client)}", flush=True)


def one_log(robot, week):
    """Identification of one simulated log: f of the robot is the paper's, changed by its number."""
    random = np.random.default_rng(robot)
    arm = puma560.dynamics().arm(puma560.arm().f * (1 + 0.02 * random.standard_normal(9)))
    record = simulate(arm, puma560.rig(), puma560.p_law(), puma560.reference(), duration=1.0 + 0.002 * week)
    return identify(puma560.dynamics(), record, seed=week, progress=False).f


def efficiency(count):
    import distributed

    tasks = {f"robot {i % 20}, week {i // 20}": (one_log, (i % 20, i // 20), {}) for i in range(count)}
    one_log(0, 0)
    print(f"{count} logs of {min(count, 20)} robots, identified")
    with cluster() as two, distributed.Client(two) as client:
        kinds = {
            "one thread": lambda: ThreadPoolExecutor(1), "two threads": lambda: ThreadPoolExecutor(2),
            "one process": lambda: work.pool(1), "two processes": lambda: work.pool(2), "Dask, two workers": client,
        }  # fmt: skip
        first = None
        for name, executor in kinds.items():
            began = time.perf_counter()
            done = campaign(tasks, executor=executor, progress=False)
            lasted = time.perf_counter() - began
            first = first or done.results
            same = all(np.array_equal(first[name], done.results[name]) for name in tasks)
            print(f"  {name}: {lasted:.1f} s, same bits: {same}", flush=True)


def kills(count):
    random, tasks = np.random.default_rng(0), 200
    for kind in work.KINDS:
        lost = twice = beyond = 0
        for _ in range(count):
            with tempfile.TemporaryDirectory() as place:
                folder, log = Path(place, "folder"), Path(place, "log")
                process = subprocess.Popen(  # noqa: S603 - the script of the tests
                    [sys.executable, work.__file__, folder, log, str(tasks), kind], stdout=subprocess.PIPE
                )
                process.stdout.readline()
                time.sleep(random.uniform(0.0, 2.0))
                process.kill()
                process.wait()
                process.stdout.close()
                done = campaign(work.tasks(log, tasks, 0.01), folder=folder, progress=False)
                expected = (np.random.default_rng(i).standard_normal(3) for i in range(tasks))
                lost += sum(not np.array_equal(*each) for each in zip(done.results.values(), expected, strict=True))
                ran = log.read_text().split()
                twice += len(ran) - tasks
                beyond += len(ran) - tasks > 4  # no more than two open per worker
        print(f"{count} kills, {kind}: {lost} results lost or other, {twice} done twice, {beyond} beyond what was open")


def rare():
    weights, limit = np.ones(10) / np.sqrt(10), 4.753424308822899
    found = [subset_simulation(lambda u: u @ weights, limit, 10, 1e-9, seed) for seed in range(60)]
    p = np.array([each.probability for each in found])
    print(f"exact 1e-6, 60 seeds: mean {p.mean():.2e}, spread {p.std(ddof=1) / p.mean():.2f}, stated "
          f"{np.mean([each.variation for each in found]):.2f}, {np.mean([each.evaluations for each in found]):.0f} "
          f"samples; bounds (95 %) below it: {np.mean([each.upper < 1e-6 for each in found]):.0%}")  # fmt: skip
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law = ComputedTorque(arm, rig, bandwidth=62)
    stated = Uncertainty(covariance=np.diag((0.02 * np.abs(arm.f)) ** 2), friction=0.0)
    options = {"duration": 0.05, "progress": False, "steps_per_sample": 4}
    brute = certify(arm, rig, law, path, stated, samples=40_000, seed=99, **options).runs.unrounded.max(axis=1)
    for share in (1e-2, 1e-3, 1e-4):
        limit = float(np.quantile(brute, 1 - share))
        for seed in range(3):
            found = certify(arm, rig, law, path, stated, samples=1, within=limit, rare=1e-6, seed=seed, **options).rare
            print(f"{share:g} of 40,000 exceed {limit:.3f} pulses; {found}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--rare", action="store_true")
    given = parser.parse_args()
    if given.rare:
        rare()
    else:
        overhead(given.tasks)
        kills(given.kills)
        efficiency(given.logs)

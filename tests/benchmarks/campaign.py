"""Campaigns measured: ``python tests/benchmarks/campaign.py [--fleet | --scale | --rare]
[--write]``.

- Overhead: time of tasks that do nothing, by threads and by Dask with two workers, with and without
  a folder; beside Dask's own `submit` in the same run, and the memory that the coordinator takes.
- Efficiency: 200 simulated logs of 20 robots over ten weeks, identified by one thread, two threads,
  one process, two processes and Dask with two workers: times, and whether all bits are the same;
  beside processes without a campaign.
- Fleet (``--fleet`` for it and efficiency alone): friction of one robot and an inertia of another
  grow; in which week each is named, and how many of the healthy are accused; then of 20 fleets of
  the same truth.
- Kills: a campaign killed at random instants and called again: what was lost, and what was done
  twice.
- ``--scale``: costs on one core, bytes per task, and what follows; ``--write`` puts them into
  docs/background/scale.md, and the picture of the fleet into docs/images.
- ``--rare``: subset simulation against an exact 1e-6 and against brute force on the arm.
"""

import argparse
import dataclasses
import datetime
import multiprocessing
import os
import pickle
import platform
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from llvmlite.binding import get_host_cpu_name
from scipy.stats import t as student

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:2])
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import campaign_tasks as work  # noqa: E402

from ctc import ComputedTorque, Fleet, Uncertainty, campaign, certify  # noqa: E402
from ctc.certification import subset_simulation  # noqa: E402
from identification import fit_torque, identify  # noqa: E402
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
    return (
        f"{1e3 * wall / count:6.2f} ms a task (processor {1e3 * own / count:.2f} ms), peak"
        f" {peak:.1f} MB"
    )


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
        print(
            f"  threads, {name}: {per_task(count, make, lambda: ThreadPoolExecutor(2))}", flush=True
        )
    import distributed

    with cluster() as two, distributed.Client(two) as client:
        for name, make in (
            ("in memory", small),
            ("in a folder", small_in_folder),
            ("its own submit", plain_dask),
        ):
            print(f"  Dask, {name}: {per_task(count, make, client)}", flush=True)


ARM, RIG, PATH, WEEKS, ROBOTS = puma560.arm(), puma560.rig(), puma560.reference(), 10, 20
NAMES = (
    *ARM.dynamics.names,
    *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(2)),
)
SCALE, PICTURE = ROOT / "docs" / "background" / "scale.md", ROOT / "docs" / "images" / "fleet.png"
PRICE = 0.05  # of a core hour, in dollars: an assumption, of the order of what clouds ask
# robot -> what grows, by which share a week
DEFECTS = {3: ("drive.coulomb[1]", 0.03), 12: ("f1", 0.01)}


def truth(robot, week):
    """Values of a robot in a week, and its temperature: robots differ by 5 %, friction also by 1.5
    % from week to week and, where it is viscous, by -0.6 % per degree.
    """
    own, now = np.random.default_rng(robot), np.random.default_rng([robot, week])
    values = np.concatenate([ARM.f, RIG.drive.viscous, RIG.drive.coulomb]) * (
        1 + 0.05 * own.standard_normal(13)
    )
    warm = 22 + 4 * now.standard_normal()
    values[9:] *= 1 + 0.015 * now.standard_normal(4)
    values[9:11] *= 1 - 0.006 * (warm - 22)
    if robot in DEFECTS:
        name, rate = DEFECTS[robot]
        values[NAMES.index(name)] *= 1 + rate * week
    return values, warm, now


def one_log(robot, week):
    """A log of 3.65 s of one robot in one week, and what its torques say."""
    values, warm, now = truth(robot, week)
    drive = dataclasses.replace(RIG.drive, viscous=values[9:11], coulomb=values[11:])
    start = PATH(np.zeros(1))
    begin = np.array([start.q[0] + RIG.to_angle(now.uniform(-0.5, 0.5, 2)), start.qd[0]])
    rig = dataclasses.replace(RIG, drive=drive)
    log = simulate(ARM.dynamics.arm(values[:9]), rig, puma560.p_law(), PATH, initial=begin)
    notes = {"robot": f"cell_{robot}", "time": 1772409600.0 + 7 * 86400 * week, "temperature": warm}
    log = dataclasses.replace(log, rig=RIG, notes=notes)
    return log, fit_torque(ARM.dynamics, log, band=64.0, unknown=NAMES)


def part_of_logs(first, step):
    """Some of the logs, handed back to nobody."""
    for i in range(first, ROBOTS * WEEKS, step):
        one_log(i % ROBOTS, i // ROBOTS)


def alone(processes):
    """Time [s] of the logs by processes that know nothing of one another: what the machine has
    to give.
    """
    context = multiprocessing.get_context("forkserver")
    began = time.perf_counter()
    each = [context.Process(target=part_of_logs, args=(i, processes)) for i in range(processes)]
    for process in each:
        process.start()
    for process in each:
        process.join()
    return time.perf_counter() - began


def efficiency():
    import distributed

    tasks = {f"robot {i % ROBOTS}, week {i // ROBOTS}": (one_log, (i % ROBOTS, i // ROBOTS), {})
             for i in range(ROBOTS * WEEKS)}  # fmt: skip
    one_log(0, 0)
    print(f"{len(tasks)} logs of {ROBOTS} robots, identified")
    with cluster() as two, distributed.Client(two) as client:
        kinds = {
            "one thread": lambda: ThreadPoolExecutor(1),
            "two threads": lambda: ThreadPoolExecutor(2),
            "one process": lambda: work.pool(1),
            "two processes": lambda: work.pool(2),
            "Dask, two workers": client,
        }
        first = None
        for name, executor in kinds.items():
            began = time.perf_counter()
            done = campaign(tasks, executor=executor, progress=False)
            lasted = time.perf_counter() - began
            assert not done.errors, done
            first = first or done.results
            same = all(
                np.array_equal(first[name][1].values, done.results[name][1].values)
                for name in tasks
            )
            print(f"  {name}: {lasted:.1f} s, same bits: {same}", flush=True)
    print(
        "  without a campaign: " + ", ".join(f"{n} process(es) {alone(n):.1f} s" for n in (1, 2)),
        flush=True,
    )
    return [
        [first[f"robot {robot}, week {week}"] for robot in range(ROBOTS)] for week in range(WEEKS)
    ]


def fleet_of(weeks, picture=None):
    """Each log judged, then added: first week in which each robot is accused of each parameter, and
    in which its defect is larger than the interval at that level.
    """
    accused, due = {}, {}
    with tempfile.TemporaryDirectory() as place:
        fleet = Fleet(Path(place, "fleet.sqlite"))
        for week, logs in enumerate(weeks):
            judged = [fleet.judge(*each) for each in logs]
            for robot, each in enumerate(judged):
                for change in each.changes:
                    accused.setdefault((robot, change.name), week)
                if robot in DEFECTS and each.looked:
                    name, rate = DEFECTS[robot]
                    change = next(change for change in each.looked if change.name == name)
                    true = abs(truth(robot, 0)[0][NAMES.index(name)]) * rate
                    true *= week if change.since else (week + 1) / 2
                    tests, freedom = (1 + (week > 2)) * len(each.looked), fleet.effects()[0].freedom
                    if true > student.isf(1e-3 / 2 / tests, freedom) * change.std:
                        due.setdefault(robot, week)
            for each in logs:
                fleet.add(*each)
        size = (Path(place) / "fleet.sqlite").stat().st_size
        fleet.report(Path(place, "fleet.html"))
        if picture is not None:
            fleet.plot()[0, 0].figure.savefig(picture, dpi=110)
        page = Path(place, "fleet.html").stat().st_size
        print(f"  {len(fleet)} logs: {size / 1e3:.0f} kB of SQLite, {page / 1e3:.0f} kB of HTML")
    for robot, (name, rate) in DEFECTS.items():
        named = accused.get((robot, name))
        beyond = f"{name} {rate:+.0%} a week: beyond its interval from week {due.get(robot)}"
        print(f"  robot {robot}, {beyond}, named in week {named}")
    wrong = sorted(key for key in accused if key[0] not in DEFECTS)
    print(
        f"  healthy robots accused: {len({robot for robot, _ in wrong})} of {ROBOTS - len(DEFECTS)}"
        f" {wrong}",
        flush=True,
    )


def fleets(weeks, count):
    """The same with values drawn from the covariance of each log's fit, about the same truth."""
    print(f"{count} fleets of the same truth, values drawn from the covariances of the logs")
    for seed in range(count):
        random, drawn = np.random.default_rng(1000 + seed), []
        for week, logs in enumerate(weeks):
            values = [random.multivariate_normal(truth(robot, week)[0], fit.covariance)
                      for robot, (_, fit) in enumerate(logs)]  # fmt: skip
            drawn.append(
                [
                    (log, dataclasses.replace(fit, values=own))
                    for (log, fit), own in zip(logs, values, strict=True)
                ]
            )
        fleet_of(drawn)


def kills(count):
    random, tasks = np.random.default_rng(0), 200
    for kind in work.KINDS:
        lost = twice = beyond = 0
        for _ in range(count):
            with tempfile.TemporaryDirectory() as place:
                folder, log = Path(place, "folder"), Path(place, "log")
                process = subprocess.Popen(  # noqa: S603 - the script of the tests
                    [sys.executable, work.__file__, folder, log, str(tasks), kind],
                    stdout=subprocess.PIPE,
                )
                process.stdout.readline()
                time.sleep(random.uniform(0.0, 2.0))
                process.kill()
                process.wait()
                process.stdout.close()
                done = campaign(work.tasks(log, tasks, 0.01), folder=folder, progress=False)
                expected = (np.random.default_rng(i).standard_normal(3) for i in range(tasks))
                lost += sum(
                    not np.array_equal(*each)
                    for each in zip(done.results.values(), expected, strict=True)
                )
                ran = log.read_text().split()
                twice += len(ran) - tasks
                beyond += len(ran) - tasks > 4  # no more than two open per worker
        print(
            f"{count} kills, {kind}: {lost} results lost or other, {twice} done twice, {beyond}"
            " beyond what was open"
        )


def scale(write):
    """The table of docs/background/scale.md: costs on one core of this machine, bytes, and what
    follows from them.
    """
    log, fit = one_log(0, 0)
    found, seconds = identify(ARM.dynamics, log, unknown=("f", "friction"), progress=False), {}
    laws, stated = ComputedTorque(found), Uncertainty(friction=0.02)
    options = {"samples": 2000, "progress": False, "threads": 1}

    def timed(call):
        call()  # kernels are compiled
        began = time.process_time()
        call()
        return time.process_time() - began

    each = seconds["`identify`, f and friction, a log of 3.65 s"] = timed(
        lambda: identify(ARM.dynamics, log, unknown=("f", "friction"), progress=False)
    )
    seconds["`fit_torque`, f and friction, the same log, band stated"] = timed(
        lambda: fit_torque(ARM.dynamics, log, band=64.0, unknown=NAMES)
    )
    motion = seconds["`certify`, one motion of 3.65 s, 2,000 samples"] = timed(
        lambda: certify(found, found.rig, laws, PATH, stated, **options)
    )
    overhead = {}
    for name, executor in (("threads", ThreadPoolExecutor(1)), ("processes", work.pool(1))):
        with executor:
            small(1, executor)
            began = time.perf_counter()
            small(2000, executor)
            overhead[name] = (time.perf_counter() - began) / 2000
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        small(2000, lambda: ThreadPoolExecutor(1), folder)
        overhead["a folder, beside"] = (time.perf_counter() - began) / 2000 - overhead["threads"]
        ledger = sum(path.stat().st_size for path in Path(folder).glob("ledger*")) / 2000
        found.save(Path(folder, "found.json"))
        saved = Path(folder, "found.json").stat().st_size
    sizes = {
        "a task of `one_log` (two numbers), sent": len(pickle.dumps((one_log, (0, 0), {}))),
        "its log and fit, sent back": len(pickle.dumps((log, fit))),
        "an identification with its log, sent": len(pickle.dumps(found)), "the same, saved": saved,
        "a small task in the ledger": ledger,
    }  # fmt: skip
    hours = {
        "10,000 robots a week (a log identified, one motion certified)": (
            1e4 * (each + motion) / 3600
        ),
        "10^9 samples of one motion": 1e9 * motion / 2000 / 3600,
    }
    lines = [
        (
            f"`python tests/benchmarks/campaign.py --scale --write`, {datetime.date.today()}, one"
            f" core of {platform.processor() or platform.machine()} ({get_host_cpu_name()}):"
        ),
        "",
    ]
    lines += [
        "| work | processor time |",
        "|---|---|",
        *(f"| {name} | {s:.3g} s |" for name, s in seconds.items()),
    ]
    lines += [
        f"| a task that does nothing: {name} | {1e3 * s:.2g} ms |" for name, s in overhead.items()
    ]
    lines += [
        "",
        "| bytes | |",
        "|---|---|",
        *(f"| {name} | {float(f'{size / 1e3:.3g}'):,g} kB |" for name, size in sizes.items()),
    ]
    lines += [
        "",
        (
            f"| what follows | core hours | at {PRICE:g} a core hour | workers that one coordinator"
            " feeds |"
        ),
        "|---|---|---|---|",
    ]
    for (name, hour), task in zip(hours.items(), (each + motion, motion), strict=True):
        lines.append(
            f"| {name} | {hour:.3g} | {PRICE * hour:.3g} | {round(task / overhead['processes'], -2):,.0f} |"
        )
    text = "\n".join(lines)
    print(text)
    if write:
        page = SCALE.read_text(encoding="utf-8")
        begin, end = "<!-- measured -->\n", "<!-- end -->"
        head, rest = page.split(begin)
        SCALE.write_text(f"{head}{begin}{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def rare():
    weights, limit = np.ones(10) / np.sqrt(10), 4.753424308822899
    found = [subset_simulation(lambda u: u @ weights, limit, 10, 1e-9, seed) for seed in range(60)]
    p = np.array([each.probability for each in found])
    print(
        f"exact 1e-6, 60 seeds: mean {p.mean():.2e}, spread {p.std(ddof=1) / p.mean():.2f}, stated"
        f" {np.mean([each.variation for each in found]):.2f},"
        f" {np.mean([each.evaluations for each in found]):.0f} samples; bounds (95 %) below it:"
        f" {np.mean([each.upper < 1e-6 for each in found]):.0%}"
    )
    arm, rig, path = puma560.arm(), puma560.rig(), puma560.reference()
    law = ComputedTorque(arm, rig, bandwidth=62)
    stated = Uncertainty(covariance=np.diag((0.02 * np.abs(arm.f)) ** 2), friction=0.0)
    options = {"duration": 0.05, "progress": False, "steps_per_sample": 4}
    brute = certify(
        arm, rig, law, path, stated, samples=40_000, seed=99, **options
    ).runs.unrounded.max(axis=1)
    for share in (1e-2, 1e-3, 1e-4):
        limit = float(np.quantile(brute, 1 - share))
        for seed in range(3):
            found = certify(
                arm,
                rig,
                law,
                path,
                stated,
                samples=1,
                within=limit,
                rare=1e-6,
                seed=seed,
                **options,
            ).rare
            print(f"{share:g} of 40,000 exceed {limit:.3f} pulses; {found}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, default=10_000)
    parser.add_argument("--kills", type=int, default=10)
    for name in ("--fleet", "--scale", "--rare", "--write"):
        parser.add_argument(name, action="store_true")
    given = parser.parse_args()
    if given.rare:
        rare()
    elif given.scale:
        scale(given.write)
    else:
        if not given.fleet:
            overhead(given.tasks)
            kills(given.kills)
        found = efficiency()
        fleet_of(found, PICTURE if given.write else None)
        fleets(found, 20)

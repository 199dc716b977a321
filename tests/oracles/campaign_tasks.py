"""Tasks of campaigns that processes can import, and a script: python campaign_tasks.py FOLDER
LOG COUNT KIND.
"""

import multiprocessing
import os
import signal
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np

from ctc import campaign


def square(x):
    return x * x


def failing(x):
    raise RuntimeError(f"no {x}\nat all")


def logged(path, i, pause=0.0):
    """Numbers of a seed; that it ran is written down."""
    with open(path, "a", encoding="utf-8") as file:
        file.write(f"{i}\n")
    time.sleep(pause)
    return np.random.default_rng(i).standard_normal(3)


def killer():
    os.kill(os.getpid(), signal.SIGKILL)


def pool(workers=2):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["ctc", "campaign_tasks"])
    return ProcessPoolExecutor(workers, mp_context=context)


def tasks(log, count, pause):
    return ((f"task {i}", (logged, (str(log), i), {"pause": pause})) for i in range(count))


KINDS = {"threads": lambda: ThreadPoolExecutor(2), "processes": pool}


if __name__ == "__main__":
    folder, log, count, kind = sys.argv[1:]
    print("begins", flush=True)
    campaign(tasks(log, int(count), 0.01), folder=folder, executor=KINDS[kind], progress=False)

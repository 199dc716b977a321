"""Load estimators in a separate process, so that the interpreter's lock stays with the controller.

One process serves all controllers of this one: it starts with the first of them and ends with this
process. It receives windows of counts and torque (some ten kilobytes) and returns estimates.
"""

import atexit
import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from identification.payload.genetic_estimate import GeneticEstimator
from identification.payload.kernel_estimate import KernelEstimator, Window
from identification.payload.posterior import LoadShape, PayloadEstimate
from plant import Arm, Rig
from plant.parts.fields import Floats

# Memory of a replay of the genetic algorithm [s]: with 0.04 its errors were three times as large.
FORGETTING = 0.02


@dataclasses.dataclass(frozen=True)
class Specification:
    """Arguments of an estimator, which are sent to the process.

    `method`: "kernel" or "genetic". `samples`: of a window. `unknown`, `root`: as for
    `KernelEstimator`. `seed`: as for `GeneticEstimator`.
    """

    method: str
    arm: Arm
    rig: Rig
    shape: LoadShape
    unknown: tuple[str, ...]
    root: Floats
    samples: int
    seed: int

    def made(self) -> KernelEstimator | GeneticEstimator:
        """The estimator, compiled: a motion of 0.1 rad as a window calls every kernel once."""
        estimator: KernelEstimator | GeneticEstimator
        if self.method == "genetic":
            estimator = GeneticEstimator(self.arm, self.rig, self.shape, FORGETTING, seed=self.seed)
        else:
            estimator = KernelEstimator(self.arm, self.rig, self.shape, self.unknown, self.root)
        time = np.arange(self.samples)[:, None] * self.rig.period
        counts = self.rig.counts(0.1 * np.sin(10 * time) * np.ones(self.arm.n))
        estimator(Window(counts, np.zeros(counts.shape), np.zeros(self.arm.n)))
        return estimator


# Longest time for a process to start or an estimator to compile [s], on a busy machine without a
# cache of kernels. Chosen by hand.
_STARTING = 120.0

# Niceness of the process, so that the controller runs first where both share a core.
_NICE = 5


class Worker:
    """The process of the estimators, as the controller's process uses it."""

    def __init__(self) -> None:
        # The process needs the same packages. One thread: it must not take the controller's cores.
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-c", "from identification.payload.worker import serve; serve()"]
        # A plain process, since `multiprocessing` would run the user's script once more.
        self._process = subprocess.Popen(  # noqa: S603 - this file
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        pipes: list[Any] = [self._process.stdin, self._process.stdout]
        # The connections get copies of the pipes, so that each has one owner that closes it.
        self._out = Connection(os.dup(pipes[0].fileno()), readable=False)
        self._in = Connection(os.dup(pipes[1].fileno()), writable=False)
        for pipe in pipes:
            pipe.close()
        self._sent = 0
        self._answers = dict[int, Any]()
        self._lock = threading.Lock()

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def prepare(self, specification: Specification) -> int:
        """Number of a new estimator, after it is compiled."""
        number = self._send("make", specification)
        self.wait(number, _STARTING)
        return number

    def submit(self, estimator: int, window: Window) -> int:
        """Number of a new job: an estimate from a window."""
        return self._send("find", (estimator, window))

    def poll(self, job: int) -> PayloadEstimate | None:
        """Answer of a job, or None if it is not ready; returns at once."""
        return self._answer(job, 0.0)

    def wait(self, job: int, seconds: float) -> Any:
        """Answer of a job within this time [s].

        Raises
        ------
        ValueError
            The process does not answer.
        """
        answer = self._answer(job, seconds)
        if answer is None:
            raise ValueError(
                "the process of the estimator must answer; it does not. Start the controller anew."
            )
        return answer

    def close(self) -> None:
        """End the process: it returns when its input closes, and is killed after five seconds."""
        with contextlib.suppress(OSError):
            self._out.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._in.close()

    def _send(self, kind, content):
        # Controllers of several threads share the process.
        with self._lock:
            self._sent += 1
            self._out.send((self._sent, kind, content))
            return self._sent

    def _answer(self, job, seconds):
        with contextlib.suppress(EOFError, OSError):
            # Answers of other jobs arrive on the way; keep them for their callers.
            while job not in self._answers and self._in.poll(seconds):
                number, answer = self._in.recv()
                self._answers[number] = answer
        answer = self._answers.pop(job, None)
        if isinstance(answer, Exception):
            raise answer
        return answer


# The default argument is the storage of the one worker of a process.
def shared_worker(workers: list[Worker] = []) -> Worker:  # noqa: B006
    """The worker of this process, started at the first call and again after it has ended."""
    if not workers or not workers[0].alive:
        workers[:] = [Worker()]
        atexit.register(workers[0].close)
    return workers[0]


def serve() -> None:
    """Main loop of the process: answer until the controller's process ends."""
    out = Connection(os.dup(1), readable=False)
    incoming = Connection(os.dup(0), writable=False)
    # Ctrl-C is the controller's; this process ends with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # whatever a library prints must not get into the answers
    if hasattr(os, "nice"):
        os.nice(_NICE)
    estimators = {}
    while True:
        try:
            number, kind, content = incoming.recv()
        except (EOFError, OSError):
            return
        answer: Any = True
        try:
            if kind == "make":
                estimators[number] = content.made()
            else:
                answer = estimators[content[0]](content[1])
        except Exception as error:  # `_answer` raises it in the controller's process
            answer = ValueError(str(error))
        out.send((number, answer))

"""Estimators in a process of their own, so that the interpreter's lock stays with the controller.

One process serves all controllers of this one; it starts with the first and ends with this process.
What is sent are windows of counts and torque (some ten kilobytes), what comes back are estimates.
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

# Over which a replay of the genetic algorithm forgets [s]; with 0.04 its errors were three times as
# large.
FORGETTING = 0.02


@dataclasses.dataclass(frozen=True)
class Specification:
    """An estimator of either kind, for windows of so many `samples`; the rest is as for the
    estimators.
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
        """The estimator, with all compiled that it needs."""
        estimator: KernelEstimator | GeneticEstimator
        if self.method == "genetic":
            estimator = GeneticEstimator(self.arm, self.rig, self.shape, FORGETTING, seed=self.seed)
        else:
            estimator = KernelEstimator(self.arm, self.rig, self.shape, self.unknown, self.root)
        time = np.arange(self.samples)[:, None] * self.rig.period
        counts = self.rig.counts(0.1 * np.sin(10 * time) * np.ones(self.arm.n))
        estimator(Window(counts, np.zeros(counts.shape), np.zeros(self.arm.n)))
        return estimator


_STARTING = 120.0  # seconds that a process may take to start, or an estimator to compile

_NICE = 5  # by how much the process gives way to the controller's where they share a core


class Worker:
    """The process, seen from the controller's."""

    def __init__(self) -> None:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-c", "from identification.payload.worker import serve; serve()"]
        self._process = subprocess.Popen(  # noqa: S603 - this file
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        pipes: list[Any] = [self._process.stdin, self._process.stdout]
        self._out = Connection(os.dup(pipes[0].fileno()), readable=False)
        self._in = Connection(os.dup(pipes[1].fileno()), writable=False)
        for pipe in pipes:
            pipe.close()
        self._sent, self._answers, self._lock = 0, dict[int, Any](), threading.Lock()

    @property
    def alive(self) -> bool:
        """Whether it still works."""
        return self._process.poll() is None

    def prepare(self, specification: Specification) -> int:
        """Number of an estimator that is made, compiled and warm."""
        number = self._send("make", specification)
        self.wait(number, _STARTING)
        return number

    def submit(self, estimator: int, window: Window) -> int:
        """Number of a job."""
        return self._send("find", (estimator, window))

    def poll(self, job: int) -> PayloadEstimate | None:
        """The answer of a job if it is there; at once."""
        return self._answer(job, 0.0)

    def wait(self, job: int, seconds: float) -> Any:
        """The answer of a job."""
        answer = self._answer(job, seconds)
        if answer is None:
            raise ValueError(
                "the process of the estimator must answer; it does not. Start the controller anew."
            )
        return answer

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._out.close()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._in.close()

    def _send(self, kind: str, content: Any) -> int:
        with self._lock:
            self._sent += 1
            self._out.send((self._sent, kind, content))
            return self._sent

    def _answer(self, job: int, seconds: float) -> Any:
        with contextlib.suppress(EOFError, OSError):
            while job not in self._answers and self._in.poll(seconds):
                number, answer = self._in.recv()
                self._answers[number] = answer
        answer = self._answers.pop(job, None)
        if isinstance(answer, Exception):
            raise answer
        return answer


# one per process, started when first needed
def shared_worker(kept: list[Worker] = []) -> Worker:  # noqa: B006
    """The worker of this process."""
    if not kept or not kept[0].alive:
        kept[:] = [Worker()]
        atexit.register(kept[0].close)
    return kept[0]


def serve() -> None:
    """The process itself: answer until the controller's has gone."""
    out = Connection(os.dup(1), readable=False)
    incoming = Connection(os.dup(0), writable=False)
    # Ctrl-C is the controller's; this process ends with it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # whatever a library prints must not get into the answers
    if hasattr(os, "nice"):
        os.nice(_NICE)
    estimators: dict[int, Any] = {}
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
        except Exception as error:  # told to the one who asked
            answer = ValueError(str(error))
        out.send((number, answer))

"""A separate process for estimators of the load, so that they do not hold the controller's GIL.

One such process serves all controllers of the process that started it. It starts with the first
controller and ends with the process that started it. It receives windows of counts and torque (some
ten kilobytes) and returns estimates.
"""

import atexit
import contextlib
import dataclasses
import os
import queue
import signal
import subprocess
import sys
import threading
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from typing import Any

import numpy as np

from identification.payload.genetic_estimate import GeneticEstimator
from identification.payload.kernel_estimate import KernelEstimator, Window
from identification.payload.posterior import LoadShape, PayloadEstimate
from plant import Arm, Rig
from plant.parts import Floats, choice

# Memory of a replay of the genetic algorithm [s]: with 0.04 its errors were three times as large.
FORGETTING = 0.02


@dataclasses.dataclass(frozen=True)
class Specification:
    """Arguments of an estimator; the controller's process sends them to the estimators' process.

    `method` is "kernel" or "genetic". `samples` is the number of samples of a window. Only
    `KernelEstimator` uses `unknown` and `root`, and only `GeneticEstimator` uses `seed`.
    """

    method: str
    arm: Arm
    rig: Rig
    shape: LoadShape
    unknown: tuple[str, ...]
    root: Floats
    samples: int
    seed: int

    def __post_init__(self) -> None:
        choice("method", self.method, ("kernel", "genetic"))

    def made(self) -> KernelEstimator | GeneticEstimator:
        """The estimator, compiled by one call on the window of a sine motion of 0.1 rad."""
        estimator: KernelEstimator | GeneticEstimator
        if self.method == "genetic":
            estimator = GeneticEstimator(self.arm, self.rig, self.shape, FORGETTING, seed=self.seed)
        else:
            estimator = KernelEstimator(self.arm, self.rig, self.shape, self.unknown, self.root)
        time = np.arange(self.samples)[:, None] * self.rig.period
        counts = self.rig.counts(0.1 * np.sin(10 * time) * np.ones(self.arm.n))
        estimator(Window(counts, np.zeros(counts.shape), np.zeros(self.arm.n)))
        return estimator


# Longest time [s] for the process to start and compile an estimator, on a busy machine without a
# cache of kernels. The value is chosen by hand.
_STARTING = 120.0

# Niceness of the process, so that the controller runs first where both share a core.
_NICE = 5


class Worker:
    """The process of the estimators, as the controller's process uses it; threads may share it.

    A thread writes the requests and another one reads the answers, so that no control loop waits
    for a pipe. An estimator stays in the process until the process ends, with some 0.1 MB for two
    joints, and so does an answer that nobody takes: reset a controller rather than start another.
    """

    def __init__(self) -> None:
        # The process needs the same packages. Its libraries get one thread, so that they leave the
        # other cores to the controller.
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-c", "from identification.payload.worker import serve; serve()"]
        # A plain process, since `multiprocessing` would run the user's script once more.
        self._process = subprocess.Popen(  # noqa: S603 - this file
            command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        pipes: list[Any] = [self._process.stdin, self._process.stdout]
        # Each connection owns a copy of its pipe's descriptor, so that none is closed twice.
        out = Connection(os.dup(pipes[0].fileno()), readable=False)
        incoming = Connection(os.dup(pipes[1].fileno()), writable=False)
        for pipe in pipes:
            pipe.close()
        self._sent = 0
        self._ended = False
        self._answers = dict[int, Any]()
        # Guards these three, and tells the waiting threads of a change.
        self._changed = threading.Condition()
        self._requests = queue.SimpleQueue[tuple[memoryview, memoryview] | None]()
        # Each thread alone uses its connection, and closes it. Daemons do not keep the interpreter
        # from its end.
        for transfer, connection in ((self._write, out), (self._read, incoming)):
            threading.Thread(target=transfer, args=(connection,), daemon=True).start()

    @property
    def alive(self) -> bool:
        """Whether the process is running."""
        return self._process.poll() is None

    def prepare(self, specification: Specification) -> int:
        """Number of a new estimator, after it is compiled.

        Raises
        ------
        ValueError
            As of `wait`.
        """
        number = self._send("make", specification)
        self.wait(number, _STARTING)
        return number

    def submit(self, estimator: int, window: Window) -> int:
        """Number of a new job, at once: an estimate from a window."""
        return self._send("find", (estimator, window))

    def poll(self, job: int) -> PayloadEstimate | None:
        """Answer of a job, or None if it is not ready; returns at once.

        Raises
        ------
        ValueError
            The process has ended, or the estimator raised an error.
        """
        return self._answer(job, 0.0)

    def wait(self, job: int, seconds: float) -> Any:
        """Answer of a job within this time [s].

        Raises
        ------
        ValueError
            The process does not answer or has ended, or the estimator raised an error.
        """
        answer = self._answer(job, seconds)
        if answer is None:
            raise ValueError(
                "the process of the estimator must answer; it does not. Start the controller anew."
            )
        return answer

    def close(self) -> None:
        """Close the input of the process, which ends it; kill it if it still runs after 5 s."""
        self._requests.put(None)
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _send(self, kind, content):
        # Serialised here, so that an error is the caller's, and the window may change afterwards.
        message = ForkingPickler.dumps(content)
        with self._changed:
            self._sent += 1
            number = self._sent
        self._requests.put((ForkingPickler.dumps((number, kind)), message))
        return number

    def _write(self, out):
        """Send the requests, until `close` or the end of the process."""
        with out, contextlib.suppress(OSError):
            for request in iter(self._requests.get, None):
                for message in request:
                    out.send_bytes(message)

    def _read(self, incoming):
        """Keep the answers for their callers, until the process ends."""
        try:
            with incoming, contextlib.suppress(EOFError, OSError):
                while True:
                    number, answer = incoming.recv()
                    with self._changed:
                        self._answers[number] = answer
                        self._changed.notify_all()
        # Also where an answer cannot be read: nobody may wait for one that will not come.
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
            # The other thread would wait for a request for ever.
            self._requests.put(None)

    def _answer(self, job, seconds):
        with self._changed:
            self._changed.wait_for(lambda: job in self._answers or self._ended, seconds)
            answer = self._answers.pop(job, None)
            ended = self._ended
        if isinstance(answer, Exception):
            raise answer
        if answer is None and ended:
            raise ValueError(
                "the process of the estimator must run; it has ended. Start the controller anew."
            )
        return answer


# Two controllers that start in two threads share one process.
_SHARING = threading.Lock()


# The default argument is the storage of the one worker of a process.
def shared_worker(workers: list[Worker] = []) -> Worker:  # noqa: B006
    """The worker of this process, started at the first call and again after it has ended."""
    with _SHARING:
        if not workers or not workers[0].alive:
            workers[:] = [Worker()]
            atexit.register(workers[0].close)
        return workers[0]


def serve() -> None:
    """Main loop of the process: answer until the controller's process ends."""
    out = Connection(os.dup(1), readable=False)
    incoming = Connection(os.dup(0), writable=False)
    # Ctrl-C is meant for the controller's process; this process ends when its input closes.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # whatever a library prints must not get into the answers
    if hasattr(os, "nice"):
        os.nice(_NICE)
    estimators = dict[int, KernelEstimator | GeneticEstimator]()
    # The end of either pipe is that of the controller's process.
    with contextlib.suppress(EOFError, OSError):
        while True:
            number, kind = incoming.recv()
            out.send((number, _served(estimators, number, kind, incoming)))


def _served(estimators, number, kind, incoming):
    """Answer of a request: an estimate, True for a new estimator, or the error."""
    try:
        # A message of its own: a class of the user's script may be one that this process cannot
        # import, and then the number is known that the error belongs to.
        content = incoming.recv()
        if kind == "find":
            estimator, window = content
            return estimators[estimator](window)
        estimators[number] = content.made()
    except Exception as error:  # `_answer` raises it in the controller's process
        return ValueError(str(error))
    return True

"""Long work in processes that are killed, and called again until they end: the same bits as in one
that is left alone.

A server imports the library once and forks for every call, so that a kill hits the work and not the
imports.
"""

import hashlib
import json
import os
import subprocess
import sys
import time

import numpy as np

from ctc import ComputedTorque, Uncertainty, certify
from identification import GeneticSettings, identify, spread
from plant import puma560, simulate
from plant.parts import fingerprint

KINDS = ("identify", "spread", "certify")


class Works:
    """Three kinds of long work on a log of so many seconds."""

    def __init__(self, duration, loops):
        self.rig, self.path, self.arm = puma560.rig(), puma560.reference(), puma560.arm()
        self.record = simulate(self.arm, self.rig, puma560.p_law(), self.path, duration=duration)
        self.settings, self.loops, self.duration = GeneticSettings(generations=20), loops, duration

    def run(self, kind, checkpoint):
        """Fingerprint of what it ends in."""
        dynamics, same = (
            puma560.dynamics(),
            {"progress": False, "checkpoint": checkpoint, "threads": 2},
        )
        if kind == "identify":
            result = identify(dynamics, self.record, seed=3, settings=self.settings, **same)
        elif kind == "spread":
            runs = spread(
                dynamics, self.record, seeds=range(2), settings=self.settings, **same
            ).runs
            return hashlib.sha256("".join(map(fingerprint, runs)).encode()).hexdigest()
        else:
            covariance = np.diag((0.02 * puma560.PUBLISHED) ** 2)
            law = ComputedTorque(self.arm, self.rig)
            stated = Uncertainty(covariance=covariance)
            result = certify(
                self.arm,
                self.rig,
                law,
                self.path,
                stated,
                samples=self.loops,
                duration=self.duration,
                **same,
            )
        return fingerprint(result)


def serve(duration, loops):
    works = Works(duration, loops)
    for kind in KINDS:
        works.run(kind, None)  # kernels
    print("ready", flush=True)
    for line in sys.stdin:
        kind, checkpoint, out, seconds = json.loads(line)
        began, process = time.monotonic(), os.fork()
        if not process:
            try:
                said = works.run(kind, checkpoint)
            except BaseException as error:
                said = repr(error)
            with open(out, "w") as file:
                file.write(said)
            os._exit(0)
        status = 0
        while not (ended := os.waitpid(process, os.WNOHANG))[0]:
            if seconds is not None and time.monotonic() - began > seconds:
                os.kill(process, 9)
                ended = os.waitpid(process, 0)
                break
            time.sleep(0.0005)
        status = os.waitstatus_to_exitcode(ended[1])
        print(json.dumps([status, time.monotonic() - began]), flush=True)


class Server:
    """Runs of a kind, alone or killed after so many seconds."""

    def __init__(self, duration, loops):
        self.process = subprocess.Popen(  # noqa: S603 - this file
            [sys.executable, __file__, str(duration), str(loops)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout.readline() == "ready\n"

    def run(self, kind, checkpoint, out, seconds=None):
        """What it ended in, or None if it was killed before; and the seconds that it took."""
        given = [kind, None if checkpoint is None else str(checkpoint), str(out), seconds]
        print(json.dumps(given), file=self.process.stdin, flush=True)
        status, took = json.loads(self.process.stdout.readline())
        assert status in (0, -9)
        return None if status else out.read_text(), took

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


if __name__ == "__main__":
    serve(float(sys.argv[1]), int(sys.argv[2]))

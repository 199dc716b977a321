"""How long does Ctrl-C take to come through long work, and does the same work then run as before?

python tests/benchmarks/interrupts.py [interrupts] : so many at random instants of each kind of
work, kernels from the cache. While they are compiled: tests/plant/compiler/test_background.py.
"""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
from killed_work import KINDS, Works


def interrupted(work, seconds):
    """Seconds from the signal until the caller has it, or None where the work had ended before."""
    sent = []

    def send():
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(seconds, send)
    timer.start()
    try:
        work()
        timer.cancel()
        time.sleep(0.01)
    except KeyboardInterrupt:
        return time.perf_counter() - sent[0]
    return None


def main(count):
    rng, works = np.random.default_rng(17), Works(2.0, 10_000)
    print(
        f"{'work':12}{'alone':>8}{'interrupted':>13}{'median':>9}{'longest':>9}{'same bits after':>17}"
    )
    for kind in KINDS:
        expected = works.run(kind, None)
        began = time.perf_counter()
        expected = works.run(kind, None)
        alone = time.perf_counter() - began
        took = [
            interrupted(lambda kind=kind: works.run(kind, None), rng.uniform(0, alone))
            for _ in range(count)
        ]
        took = [each for each in took if each is not None]
        same = works.run(kind, None) == expected
        print(
            f"{kind:12}{alone:6.1f} s{len(took):13}{np.median(took):7.2f} s{max(took):7.2f}"
            f" s{same!s:>17}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)

"""Do works that are killed at random instants go on to the same bits?

python tests/benchmarks/kills.py [kills] : so many SIGKILLs at random instants of each of three
kinds of work, each on a checkpoint of its own, then the work called again until it ends.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "oracles"))
from killed_work import KINDS, Server


def main(kills):
    rng = np.random.default_rng(17)
    print(
        f"{'work':10}{'alone':>8}{'kills':>7}{'in the work':>13}{'same bits':>11}{'median time of the end':>24}"
    )
    with tempfile.TemporaryDirectory() as folder, Server(2.0, 10_000) as server:
        place = Path(folder)
        for kind in KINDS:
            expected, alone = server.run(kind, None, place / "out")
            hit, same, ends = 0, 0, []
            for i in range(kills):
                checkpoint = place / f"{kind}_{i}.json"
                hit += server.run(kind, checkpoint, place / "out", rng.uniform(0, alone))[0] is None
                said, took = server.run(kind, checkpoint, place / "out")
                same += said == expected
                ends.append(took)
                left = [
                    name for name in place.iterdir() if name.name.startswith(f".{checkpoint.name}")
                ]
                for name in [checkpoint, *left]:
                    name.unlink()
            print(
                f"{kind:10}{alone:6.1f} s{kills:7}{hit:13}{same:11}{np.median(ends):22.1f} s",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)

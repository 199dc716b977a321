"""What `tune` finds on stated gears: plants that leave out of 120 fresh ones, and chatter, beside
what was asked.

    python tests/benchmarks/tuning.py [--quick]
    python tests/benchmarks/tuning.py --time

Literature arm with 1.5 kg, f drawn with 0.3 %, damping ratio 1 to 3 %, friction to 2 % (last row:
10 %), path (6). Each row takes 1 to 3 min on two free cores. `--quick` takes 15-40 and 150-300 Hz.
`--time` takes rigid gears, friction to 2 %: the paper's arm along path (6) and in all everyday
motions, a UR5e in one of them.
"""

import sys
import time

import numpy as np

from ctc import ComputedTorque, Uncertainty, certify, tune
from plant import everyday_motions, puma560, read_robot

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
COVARIANCE = np.diag((0.003 * ARM.f) ** 2)
FRESH = 120
ASKED = (
    ((15, 40), 0.02, 0.0, 26.0), ((40, 80), 0.02, 0.0, 24.0), ((80, 150), 0.02, 0.0, 20.0),
    ((150, 300), 0.02, 0.0, 2.0), ((15, 40), 0.10, 0.05, 40.0),
)  # fmt: skip
"""Range [Hz], friction, share that may leave, chatter of joint 2 [N m]."""


def main(quick):
    print(
        f"{'Hz':>10} {'friction':>8} {'leave, of 120':>14} {'asked':>6} {'chatter [N m]':>14}"
        f" {'asked':>6} {'observer 150 leaves':>20}  time, law"
    )
    for resonance, friction, share, chatter in ASKED[::3] if quick else ASKED:
        stated = Uncertainty(resonance=resonance, friction=friction, covariance=COVARIANCE)
        started = time.perf_counter()
        found = tune(ARM, RIG, PATH, stated, allowed=share, progress=False)
        seconds = time.perf_counter() - started
        fresh = certify(ARM, RIG, found.law, PATH, stated, samples=FRESH, seed=1234)
        observer = certify(
            ARM,
            RIG,
            ComputedTorque(ARM, RIG, bandwidth=150),
            PATH,
            stated,
            samples=FRESH,
            seed=1234,
        )
        best = min(found.trials, key=lambda trial: trial.rank)
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in best.numbers.items())
        print(
            f"{resonance!s:>10} {friction:8.0%} {fresh.failures:14} {share * FRESH:6.0f}"
            f" {fresh.runs.chatter[:, 0].mean():14.1f} {chatter:6.0f} {observer.failures:20} "
            f" {seconds:.0f} s, {best.family}: {numbers}; certificate: {found.certificate.verdict}",
            flush=True,
        )


def timed():
    """How long each takes, what it found, and how many of 10,000 samples exceed the limit under
    it.
    """
    robot = read_robot("ur5e")
    for name, arm, rig, motions, spread in (
        ("path (6)", ARM, RIG, PATH, 0.003),
        ("everyday motions", ARM, RIG, everyday_motions(ARM, RIG), 0.003),
        (
            "UR5e, far and fast",
            robot.arm,
            robot.rig,
            everyday_motions(robot.arm, robot.rig)["far and fast"],
            0.01,
        ),
    ):
        stated = Uncertainty(friction=0.02, covariance=np.diag((spread * arm.f) ** 2))
        started = time.perf_counter()
        found = tune(arm, rig, motions, stated, progress=False)
        seconds = time.perf_counter() - started
        print(
            f"{name}: {seconds:.0f} s, of 10,000 exceed"
            f" {found.certificate.failures}\n{found.table}",
            flush=True,
        )


if __name__ == "__main__":
    timed() if "--time" in sys.argv else main("--quick" in sys.argv)

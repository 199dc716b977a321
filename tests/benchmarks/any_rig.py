"""Rigs, laws and logs drawn at random: is a value ever off by more than five deviations, unsaid?

    python tests/benchmarks/any_rig.py [--logs 200] [--first 0]  # 200: an hour on one core
    python tests/benchmarks/any_rig.py --period 0.005 [--logs 200] [--first 0]
    python tests/benchmarks/any_rig.py --check [--logs 300]  # 300: twenty minutes

Arms of one to three joints (turning, sliding, with springs, with any gravity) under P, PD, PID and
cascades, simulated by an engine that shares no code with the library (`random_rigs`). All that is
stated is right, so each warning accuses a right log; a refusal is an answer. A value that is off by
more than five of its deviations under a clean verdict must not occur. `--period` samples all logs
so slowly; by default they have 0.5 or 1 ms. With `--check` it is
`record.check()` that must name no cause, and `identify` is left out.
"""

import argparse
import sys
import time
import warnings
from pathlib import Path

import numpy as np

from identification import identify

sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))

from random_rigs import drawn

MOST = 5.0  # deviations


def deviations(case, estimate):
    """Error of each value in its deviations (k,); of a value without deviation it is infinite."""
    error = estimate.fit.values - case.truth
    std = np.sqrt(np.diag(estimate.covariance))
    return error / np.where(std > 0, std, 1e-30)


def checked(seeds, period):
    """Print the causes that `record.check()` names of right logs; whether it names any."""
    accused = []
    for seed in seeds:
        case = drawn(seed, period=period)
        causes = case.record.check().causes
        if causes:
            accused.append(seed)
            print(f"{seed}: {case.about}: {'; '.join(map(str, causes))}", flush=True)
    print(f"{len(accused)} of {len(seeds)} right logs accused: {accused}")
    return bool(accused)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--period", type=float, help="of all logs [s]")
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.logs)
    if asked.check:
        return checked(seeds, asked.period)
    wrong, refused, accused, clean = [], [], [], []
    for seed in seeds:
        case = drawn(seed, period=asked.period)
        begun = time.perf_counter()
        label = f"{seed}: {case.about}"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                estimate = identify(
                    case.dynamics, case.record, unknown=case.unknown, progress=False
                )
        except ValueError as error:
            refused.append(seed)
            print(f"{label}: refused, {str(error)[:160]}", flush=True)
            continue
        seconds = time.perf_counter() - begun
        if estimate.covariance is None:
            refused.append(seed)
            print(f"{label}: no covariance, {estimate.fit.fallback_reason}", flush=True)
            continue
        z = deviations(case, estimate)
        worst = int(np.argmax(np.abs(z)))
        relative = estimate.fit.values[worst] / case.truth[worst] - 1
        (accused if estimate.doubts else clean).append(z)
        # A fit of torques alone has no innovations.
        innovation = estimate.fit.rms_innovation
        followed = "no innovation" if innovation is None else f"innovation {innovation:.3f}"
        far = abs(z[worst]) > MOST
        if far and not estimate.doubts:
            wrong.append(seed)
        print(
            f"{label}: {'WRONG ' if far and not estimate.doubts else ''}z {z[worst]:.1f} of"
            f" {case.unknown[worst]} ({relative:+.1%}), rms z {np.sqrt(np.mean(z**2)):.2f},"
            f" {followed}, {seconds:.1f} s",
            flush=True,
        )
        if estimate.diagnostics.detection.reason is not None:
            print(f"    not tested: {estimate.diagnostics.detection.reason}", flush=True)
        for line in estimate.doubts:
            print(f"    {line[:200]}", flush=True)
    rms = np.sqrt(np.mean(np.concatenate(clean) ** 2)) if clean else np.nan
    print(
        f"{len(wrong)} of {asked.logs} wrong under a clean verdict: {wrong}; {len(clean)} clean"
        f" (rms {rms:.2f} deviations), {len(accused)} with a warning, {len(refused)} refused"
    )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

"""Mistakes in what is stated of a robot that used to pass in silence: is each said, and by which
message?

    python tests/benchmarks/silent_mistakes.py [--logs 10] [--runs 50] [--kinds gain_1.5 ...]

An arm of two links under a P law, simulated at 16 sub-steps with f drawn within 10 % of the
paper's, or of another arm with links of 0.35 m where a length is wrong. Nine mistakes, each in as
many logs, with the torque in the log (as amplifiers report it) and without. Caught is a refusal, or
a warning of `simulate` or `identify`; `record.check()` is counted beside it. Then RUNS right logs:
how many have a warning.
"""

import argparse
import collections
import dataclasses
import sys
import time
import warnings

import numpy as np

from identification import identify
from plant import Chain, Dynamics, Harmonics, Link, P, puma560, simulate

RIG, LAW, PATH = puma560.rig(), puma560.p_law(), puma560.reference()


def of_length(length):
    """Two links with parallel axes in a vertical plane, by their base parameters."""
    links = (Link(name="2", alpha=-np.pi / 2), Link(name="3", a=length))
    return Dynamics.from_chain(Chain(links=links))


def drawn(dynamics, f, random):
    return dynamics.arm(f * (1 + 0.1 * random.uniform(-1, 1, len(f))))


def right(random, dynamics=None):
    """A log of the paper's arm, or of one of the same torques with links of 0.35 m."""
    given = (puma560.dynamics(), puma560.arm().f) if dynamics is None else (dynamics, LONG[1])
    arm = drawn(*given, random)
    return simulate(arm, RIG, LAW, PATH, steps_per_sample=16)


def rigged(record, *, encoder=None, **drive):
    rig = dataclasses.replace(
        RIG, drive=dataclasses.replace(RIG.drive, **drive), encoder=encoder or RIG.encoder
    )
    return dataclasses.replace(record, rig=rig, reference=None, true_q=None, true_qd=None)


def gained(record, factor):
    return dataclasses.replace(record, law=P(gain=factor * LAW.gain))


def per_radian(record):
    resolution = RIG.encoder.resolution / (2 * np.pi)
    return rigged(record, encoder=dataclasses.replace(RIG.encoder, resolution=resolution))


def in_degrees(random):
    cosine, offset = np.rad2deg(np.array(PATH.cosine)), np.rad2deg(np.array(PATH.offset))
    path = Harmonics(period=PATH.period, offset=offset, cosine=cosine, sine=PATH.sine)
    return simulate(drawn(puma560.dynamics(), puma560.arm().f, random), RIG, LAW, path)


def slow(random):
    rig = dataclasses.replace(RIG, period=1.0)
    return simulate(drawn(puma560.dynamics(), puma560.arm().f, random), rig, LAW, PATH)


KINDS = {
    "gain 1.5": lambda record: gained(record, 1.5),
    "sign of the error": lambda record: dataclasses.replace(
        record, error_pulses=-record.error_pulses
    ),
    "length 0.45 for 0.35 m": None,
    "gain 1.1": lambda record: gained(record, 1.1),
    "resolution per radian": per_radian,
    "gear 120 for 100": lambda record: rigged(record, gear=1.2 * RIG.drive.gear),
    "period 1.0 s": None,
    "viscous joint side": lambda record: rigged(
        record, viscous=RIG.drive.viscous * RIG.drive.gear**2
    ),
    "path in degrees": None,
}


def said(kind, torque, seed):
    """First message about a log with this mistake, or about a right one (kind None); and whether
    check() finds it.
    """
    random = np.random.default_rng(seed)
    checked = False
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            if kind == "path in degrees":
                record = in_degrees(random)
            elif kind == "period 1.0 s":
                record = slow(random)
            elif kind == "length 0.45 for 0.35 m":
                record = right(random, LONG[0])
            else:
                record = right(random)
                record = record if kind is None else KINDS[kind](record)
            if not torque:
                record = dataclasses.replace(record, torque=None, current=None)
            checked = any(
                finding.verdict in ("wrong", "look") for finding in record.check().findings
            )
            dynamics = of_length(0.45) if kind == "length 0.45 for 0.35 m" else puma560.dynamics()
            identify(dynamics, record, seed=seed, progress=False)
        except ValueError as error:
            return f"refused: {error}", checked
    lines = [str(each.message) for each in caught]
    return "\n".join(lines), checked


def as_base(dynamics):
    """f of the paper's torques in base parameters: least squares over states."""
    random = np.random.default_rng(0)
    arm, rows, torques = puma560.literature_arm(1.5), [], []
    for _ in range(200):
        q, qd, qdd = random.uniform(-2, 2, (3, 2))
        rows.append(np.array(dynamics.Y(q, qd, qdd)))
        torques.append(arm.inverse(q, qd, qdd))
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(torques), rcond=None)[0]


LONG = (of_length(0.35), as_base(of_length(0.35)))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=10)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS))
    options = parser.parse_args()
    for kind in options.kinds:
        for torque in (True, False):
            started, results = (
                time.perf_counter(),
                [said(kind, torque, seed) for seed in range(options.logs)],
            )
            number = sum(bool(text) for text, _ in results)
            checks = sum(checked for _, checked in results)
            heads = collections.Counter(
                line[:150]
                for text, _ in results
                for line in text.splitlines()
                if "identified with" not in line
            )
            print(
                f"{kind}, {'torque' if torque else 'no torque'}: caught {number} of {options.logs},"
                f" by check() {checks} ({time.perf_counter() - started:.0f} s)",
                flush=True,
            )
            for line, count in heads.most_common(4):
                print(f"    {count} x {line}")
    if options.runs:
        loud = []
        for seed in range(1000, 1000 + options.runs):
            text = said(None, bool(seed % 2), seed)[0]
            loud += [f"{seed}: {text}"] if text else []
        print(f"right logs with a warning: {len(loud)} of {options.runs}")
        print("\n".join(loud))
    return 0


if __name__ == "__main__":
    sys.exit(main())

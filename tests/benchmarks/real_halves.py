"""Two fits of one real machine from disjoint halves of its logs: do their intervals overlap as they
claim?

    CTC_DATA=... python tests/benchmarks/real_halves.py [--splits 20] [--methods identify
    fit_torque]

Double pendulum, both designs: the open-loop excitation runs, split at random into disjoint halves;
each half gives its own intervals, |a - b| is compared with the root of the sum of the squared
half-widths. Six-axis arm: the first half of its moving time against the second.
"""

import argparse
import os
import sys
from importlib import import_module
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from identification import fit_torque

pendulum, tx40 = import_module("8_real_double_pendulum"), import_module("5_real_tx40")

RATE, REST = 5000, 1.5
"""Of the six-axis log [Hz], and its end without motion [s]."""

RUNS = {
    "C.0": ("00", "01", "02", "03", "04", "05", "06"),
    "A.0": ("00", "01", "02", "03", "04", "05"),
}


def found(method, dynamics, records):
    """Names, values and half-widths of 95 % of one half."""
    if method == "identify":
        fit = pendulum.fit(dynamics, records)
        if fit.covariance is None:
            raise ValueError(fit.fit.fallback_reason)
        return fit.fit.unknown, fit.fit.values, 1.96 * fit.fit.std
    friction = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in range(2))
    fit = fit_torque(dynamics, records, unknown=(*dynamics.names, *friction))
    return fit.names, fit.values, 1.96 * fit.std


def halves(folder, design, method, splits):
    """|a - b| and the width that it is compared with (splits, k), and the names."""
    lengths = pendulum.DESIGNS[design][0]
    dynamics = pendulum.dynamics(lengths)
    records = [pendulum.load(folder, design, run) for run in RUNS[design]]
    off, wide = [], []
    for k in range(splits):
        order = np.random.default_rng([20, k]).permutation(len(records))
        parts = (order[: len(order) // 2], order[len(order) // 2 :])
        try:
            (names, a, of_a), (_, b, of_b) = (
                found(method, dynamics, [records[i] for i in part]) for part in parts
            )
        except ValueError as error:
            print(f"  split {k}: {error}")
            continue
        off.append(np.abs(a - b))
        wide.append((of_a, of_b))
    return names, np.array(off), np.array(wide)


def report(label, names, off, wide):
    """A row per parameter, and the pooled numbers."""
    shown = (wide > 0).all(axis=(0, 1))
    names, off, wide = np.array(names)[shown], off[:, shown], wide[:, :, shown]
    held = off < np.hypot(wide[:, 0], wide[:, 1])
    ratio = np.median(wide, axis=(0, 1)) / np.sqrt(np.mean(off**2, axis=0))
    print(
        f"{label}: {held.mean():.1%} of {held.size} hold; median over parameters of half-width /"
        f" rms |a - b| {np.median(ratio):.2f}"
    )
    for name, share, each in zip(names, held.mean(axis=0), ratio, strict=True):
        print(f"  {name:40} {share:6.1%}  half-width {each:5.2f} of the rms")


def six_axis():
    """Both halves of the moving time of the six-axis log."""
    q, torque = tx40.load(Path(os.environ["CTC_DATA"]) / "staubli_tx40")
    half = (len(q) - int(REST * RATE)) // 2
    fits = [tx40.fit(q[part], torque[part]) for part in (slice(half), slice(half, 2 * half))]
    off = np.abs(fits[0].values - fits[1].values)
    return fits[0].names, off[None], 1.96 * np.array([[fit.std for fit in fits]])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--splits", type=int, default=20)
    parser.add_argument("--methods", nargs="*", choices=["identify", "fit_torque", "six axes"],
                        default=["identify", "fit_torque", "six axes"])  # fmt: skip
    given = parser.parse_args()
    folder = Path(os.environ["CTC_DATA"]) / "dfki_double_pendulum"
    for method in given.methods:
        if method == "six axes":
            report("six axes", *six_axis())
            continue
        for design in RUNS:
            report(f"{method}, {design}", *halves(folder, design, method, given.splits))


if __name__ == "__main__":
    main()

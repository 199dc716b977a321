"""How the cost of an objective grows with joints, samples, individuals and sub-steps; the slopes of
both logarithms.

    python tests/benchmarks/growth.py [--write]

Time of the process on one thread, the least of several calls: other load on the machine makes it
only longer. The arms are the first joints of the PUMA 560, and for seven one more in the wrist; all
of f differs between candidates. With --write the figure of docs/background/speed.md is drawn anew.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from identification import Objective
from plant import Chain, Drive, Dynamics, Encoder, Harmonics, Link, P, Rig, read_robot, simulate
from plant.parts import colour_of

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "growth.png"
JOINTS, SAMPLES, INDIVIDUALS, STEPS = 3, 500, 80, 4
"""What is kept where another number varies."""

GROWING = {
    "joints": (2, 3, 4, 5, 6, 7),
    "samples": (125, 250, 500, 1000, 2000, 4000, 8000),
    "individuals": (1, 10, 40, 80, 160, 320, 640),
    "sub-steps per sample": (1, 2, 4, 8, 16, 32),
}


def experiment(n, samples):
    """The first joints of the arm with their record under P control."""
    robot = read_robot("puma560")
    chain, rig = robot.dynamics.chain, robot.rig
    if n < 6:
        chain = Chain(links=chain.links[:n], bodies=chain.bodies[:n])
    if n > 6:
        extra = Link(name="5b", alpha=-np.pi / 2, d=0.1, frame=chain.links[4].frame)
        links = (*chain.links[:5], extra, chain.links[5])
        chain = Chain(links=links, bodies=(*chain.bodies[:5], *chain.bodies[4:]))
    pick = [min(i, 5) for i in range(n)]
    names = ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
    drive = Drive(**{name: getattr(rig.drive, name)[pick] for name in names})
    rig = Rig(
        drive=drive, encoder=Encoder(resolution=rig.encoder.resolution[pick]), period=rig.period
    )
    dynamics = Dynamics.from_chain(chain)
    path = Harmonics(period=4.0, offset=(0.0,) * n, cosine=((0.3,),) * n, sine=((0.2,),) * n)
    law = P(gain=np.array((0.11, 0.07, 0.04, 0.004, 0.004, 0.004))[pick])
    arm = dynamics.arm(dynamics.f())
    return arm, simulate(arm, rig, law, path, duration=samples * rig.period)


def seconds(n=JOINTS, samples=SAMPLES, individuals=INDIVIDUALS, steps=STEPS, rounds=7):
    """Time of one call of the objective."""
    arm, record = experiment(n, samples)
    objective = Objective(arm.dynamics, record, steps_per_sample=steps, threads=1)
    candidates = arm.f * np.random.default_rng(0).uniform(0.999, 1.001, (individuals, len(arm.f)))
    if not np.isfinite(objective(candidates)).all():
        raise RuntimeError(
            "every candidate must follow the record, or its time is not that of a whole run"
        )
    times = []
    for _ in range(rounds):
        started = time.process_time()
        objective(candidates)
        times.append(time.process_time() - started)
    return min(times)


def measured():
    """Seconds of each number that grows, by its name."""
    keywords = dict(zip(GROWING, ("n", "samples", "individuals", "steps"), strict=True))
    return {
        name: [seconds(**{keywords[name]: x}) for x in values] for name, values in GROWING.items()
    }


def slope(values, times):
    """Exponent of the upper half of the numbers, where what a call costs in any case no longer
    counts.
    """
    half = len(values) // 2
    return float(np.polyfit(np.log(values[half:]), np.log(times[half:]), 1)[0])


def draw(times):
    """One panel for each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.4), layout="constrained")
    for axes, (name, values) in zip(figure.subplots(1, 4), GROWING.items(), strict=True):
        spent, exponent = 1e3 * np.array(times[name]), slope(values, times[name])
        line = spent[-1] * (np.array(values) / values[-1]) ** exponent
        axes.loglog(values, spent, "o", color=colour_of(0))
        axes.loglog(values, line, "-", color="0.6", zorder=0)
        axes.set(xlabel=name, title=f"slope {exponent:.2f}")
        shown = values if name == "joints" else values[::2]
        axes.set_xticks(shown, [str(x) for x in shown])
        axes.minorticks_off()
        low, high = np.floor(np.log2(min(spent))), np.ceil(np.log2(max(spent)))
        heights = 2.0 ** np.arange(low, high + 1)
        axes.set_yticks(heights, [f"{y:g}" for y in heights])
        axes.set_ylim(heights[0], heights[-1])
        axes.grid(True, color="0.9")
    figure.axes[0].set_ylabel("objective, one thread [ms]")
    return figure


def main():
    """Print times and slopes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    options, times = parser.parse_args(), measured()
    for name, values in GROWING.items():
        cells = " | ".join(f"{x}: {1e3 * t:.2f}" for x, t in zip(values, times[name], strict=True))
        print(f"{name} | {cells} | slope {slope(values, times[name]):.2f}")
    if options.write:
        draw(times).savefig(PICTURE, dpi=110)


if __name__ == "__main__":
    main()

"""What an elastic gear costs per sub-step, and friction beyond Coulomb's: `python
tests/benchmarks/elastic.py`.

Rigid, elastic and other loops take turns in one process: one individual with its log, and 40 side
by side without.
"""

import dataclasses
import statistics
import time

import numpy as np

from plant import Elasticity, FrictionDrift, Presliding, TorqueRipple, puma560
from plant.simulation import LANES, Clock, ClosedLoop, LoopKernel, Path, time_tables

ROUNDS = 15
ARM, RIG, PATH, LAW = (
    puma560.literature_arm(1.5),
    puma560.rig(),
    puma560.reference(),
    puma560.p_law(),
)


def runner(rig, *, population):
    """A call that runs the loop of trajectory (6) once, by its kernel."""
    loop = ClosedLoop(dynamics=ARM.dynamics, rig=rig, law=LAW, steps_per_sample=4)
    clock, path = Clock.regular(5215, rig.period), Path(PATH, rig)
    lanes = tuple(range(loop.dynamics.p)) if population else ()
    kernel = LoopKernel(loop, lanes)
    tables = (*time_tables(loop, path, clock), np.empty((5215, 0)))
    prepared = kernel.prepared(tables, logged=not population)
    numbers = loop.number_values(ARM.f)
    state = loop.initial_state(*path.start(), loop.number_values(ARM.f))[:, None]
    if population:
        state = np.repeat(state, LANES, axis=1)
        given = np.repeat(ARM.f[:, None], LANES, axis=1), numbers[list(kernel.uniform)]
        return lambda: kernel.run(prepared, state, *given)
    log, error = np.empty((5215, loop.n_log)), np.empty((4 * 5215, 2))
    return lambda: kernel.run(prepared, state, np.empty((0, 1)), numbers, (log, error))


def main():
    elastic = Elasticity.from_resonance(ARM, 60, 0.02, drive=RIG.drive)
    effects = {
        "presliding": Presliding(distance=RIG.encoder.to_angle(np.array([5.0, 5.0]))),
        "load_friction": (0.1, 0.1),
        "friction_drift": FrictionDrift(amount=(-0.2, -0.2), time=(2.0, 2.0)),
        "ripple": TorqueRipple(amplitude=(0.05, 0.05), cycles=(6, 6)),
    }
    drives = {
        "rigid": {},
        "elastic": {"elasticity": elastic},
        "elastic, backlash": {"elasticity": dataclasses.replace(elastic, backlash=(2e-4, 2e-4))},
        **{name.replace("_", " "): {name: each} for name, each in effects.items()},
        "all four": effects,
        "elastic, all four": {"elasticity": elastic, **effects},
    }
    rigs = {name: dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **each))
            for name, each in drives.items()}  # fmt: skip
    for population in (False, True):
        runs = {name: runner(rig, population=population) for name, rig in rigs.items()}
        seconds = {name: [] for name in runs}
        for _ in range(ROUNDS + 1):
            for name, run in runs.items():
                started = time.perf_counter()
                run()
                seconds[name].append(time.perf_counter() - started)
        base = statistics.median(seconds["rigid"][1:])
        per = 4 * 5215 * (LANES if population else 1)
        print(f"{LANES} side by side" if population else "one individual")
        for name, each in seconds.items():
            median = statistics.median(each[1:])
            print(
                f"  {name:<20} {1e9 * median / per:7.1f} ns per sub-step {median / base:6.2f} times"
                " the rigid one"
            )


if __name__ == "__main__":
    main()

"""What an identification says of robots whose gears give or play, whose currents lag, whose friction is not the rig's.

    python tests/benchmarks/detection.py [--quick] [--seed 0] [--most 200] [--row "compliance, 60"]
    python tests/benchmarks/detection.py --cost                    # what the tests cost within one identification
    python tests/benchmarks/detection.py --shown 20                # gears at the resonance that a rigid log would show

Robots: f drawn around two arms, the encoders' phase and the path's offset drawn anew, 16 steps per sample; the model
is rigid, at 4. A robot whose loop does not stay bounded is drawn again. Rows say what it has, columns what is named
first (`found.diagnostics.detection`).
"""

import argparse
import collections
import dataclasses
import time

import numpy as np

from identification import identify
from identification.results import Detection, diagnostics, seen
from plant import (
    PD,
    Elasticity,
    Harmonics,
    LoggedTorque,
    Phase,
    puma560,
    read_robot,
    simulate,
)
from plant.machine import least_inertia_margin

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
ARMS = (puma560.literature_arm(1.5), puma560.arm())
LOW, HIGH = (0.1, 0.08), (0.2, 0.15)
SAMPLED = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period)
COLUMNS = ("none", "compliance", "backlash", "lag", "friction", "delay", "disagreement")


def arm_near(base, rng):
    """An arm of the same structure whose D leaves the motors their inertia."""
    while True:
        f = base.f * (1 + 0.1 * rng.normal(size=9)) + 0.01 * rng.normal(size=9)
        if least_inertia_margin(DYNAMICS, RIG, f[None])[0] > 0.1:
            return DYNAMICS.arm(f)


def with_gears(drive, arm, path, hertz, ratio, **options):
    elasticity = Elasticity.from_resonance(
        arm, hertz, ratio, drive=drive, q=path([0.0]).q[0], **options
    )
    return dataclasses.replace(drive, elasticity=elasticity)


def compliance(hertz):
    return lambda drive, arm, path, rng: with_gears(
        drive, arm, path, hertz, rng.uniform(0.01, 0.03)
    )


def backlash(drive, arm, path, rng):
    return with_gears(
        drive, arm, path, 200, 0.02, backlash=(np.deg2rad(rng.uniform(0.01, 0.05)),) * 2
    )


def lag(low, high):
    return lambda drive, arm, path, rng: dataclasses.replace(
        drive, current_lag=rng.uniform(low, high)
    )


def friction(drive, arm, path, rng):
    times = 1 + rng.choice([-1, 1], size=(2, 2)) * rng.uniform(0.2, 0.5, size=(2, 2))
    return dataclasses.replace(
        drive, viscous=drive.viscous * times[0], coulomb=drive.coulomb * times[1]
    )


def logs(seed, change, laws):
    """One robot, its logs under these laws; the rig of a record knows nothing of what was
    changed.
    """
    for attempt in range(100):
        rng = np.random.default_rng([seed, attempt])
        arm = arm_near(ARMS[seed % 2], rng)
        try:
            records = []
            for law in laws:
                path = dataclasses.replace(
                    PATH, offset=np.asarray(PATH.offset) + rng.uniform(-0.05, 0.05, 2)
                )
                drive = (
                    RIG.drive
                    if change is None
                    else change(RIG.drive, arm, path, np.random.default_rng(seed))
                )
                encoder = dataclasses.replace(RIG.encoder, phase=Phase(shift=rng.uniform(0, 1, 2)))
                rig = dataclasses.replace(RIG, drive=drive, encoder=encoder)
                record = simulate(arm, rig, law, path, steps_per_sample=16)
                known = LoggedTorque() if law.period else law
                records.append(
                    dataclasses.replace(record, rig=RIG, law=known, true_q=None, true_qd=None)
                )
            return records, identify(DYNAMICS, records, progress=False)
        except ValueError:  # diverges, or saturates for most of the log
            continue
    raise RuntimeError(f"robot {seed} stays bounded in no attempt")


def one(seed):
    return [puma560.p_law((LOW, HIGH)[seed // 2 % 2])]


def two(seed):
    return [puma560.p_law(LOW), puma560.p_law(HIGH)]


ROWS = (  # what the robot has, logs, how many robots, and in a quick run
    ("as modelled, one log", None, one, 200, 8),
    ("as modelled, two logs", None, two, 60, 2),
    ("compliance, 60 Hz, one log", compliance(60), one, 100, 4),
    ("compliance, 100 Hz, one log", compliance(100), one, 60, 2),
    ("compliance, 100 Hz, two logs", compliance(100), two, 100, 4),
    ("backlash 0.01-0.05 degrees", backlash, one, 60, 4),
    ("lag 0.03-0.05 ms, gains (0.1, 0.08)", lag(3e-5, 5e-5), lambda seed: two(seed)[:1], 60, 2),
    ("lag 0.015-0.03 ms, two logs", lag(1.5e-5, 3e-5), two, 60, 2),
    ("friction 20-50 % off", friction, one, 60, 4),
    ("as modelled, torques replayed", None, lambda seed: [SAMPLED], 40, 2),
    ("lag 0.1-0.3 ms, torques replayed", lag(1e-4, 3e-4), lambda seed: [SAMPLED], 40, 2),
    ("compliance, 60 Hz, torques replayed", compliance(60), lambda seed: [SAMPLED], 40, 2),
)


def six_joints():
    """A log of a UR5e at 2 ms."""
    robot = read_robot("ur5e")
    cosine, sine = np.random.default_rng(1).uniform(-0.4, 0.4, (2, 6, 4)) / np.arange(1, 5)
    path = Harmonics(period=4.0, offset=(0, -1.2, 1.0, -0.5, 0.8, 0), cosine=cosine, sine=sine)
    arm = robot.dynamics.arm(robot.dynamics.f())
    record = simulate(arm, robot.rig, robot.law, path, steps_per_sample=16)
    return robot.dynamics, dataclasses.replace(record, true_q=None, true_qd=None)


def cost(rounds=7):
    """Seconds of one identification, with the tests and without, in turn; of the wall clock, and
    of the processors.
    """
    yield (
        "| robot | seconds without | with | ratio | processor, without | with"
        " |\n|---|---|---|---|---|---|"
    )
    tested = diagnostics.detect
    robots = [
        (name, DYNAMICS, logs(0, change, one(0))[0][0])
        for name, change in (("as modelled", None), ("compliance, 60 Hz", compliance(60)))
    ]
    robots.append(("six joints, as modelled", *six_joints()))
    for name, dynamics, record in robots:
        spent = {True: [], False: []}
        for i in range(2 * rounds):
            diagnostics.detect = tested if i % 2 else lambda *_: Detection(reason="left out")
            started = time.perf_counter(), time.process_time()
            identify(dynamics, record, seed=1, progress=False)
            spent[bool(i % 2)].append(
                (time.perf_counter() - started[0], time.process_time() - started[1])
            )
        diagnostics.detect = tested
        (wall, cpu), (wall_tested, cpu_tested) = (
            np.median(spent[which], axis=0) for which in (False, True)
        )
        yield (
            f"| {name} | {wall:.2f} | {wall_tested:.2f} | {wall_tested / wall:.2f} | {cpu:.2f} |"
            f" {cpu_tested:.2f} |"
        )


SHARES = (1.2, 1.0, 0.7, 0.4)
"""Of the resonance below which a log of rigid gears says that it would show them."""


def shown(robots):
    """The same robots on gears of shares of the resonance that their log on rigid ones says it
    would show.
    """
    named, limits = collections.Counter(), []
    for seed in range(robots):
        records, found = logs(seed, None, one(seed))
        limits.append(seen(found, records[0].reference, records[0].reference.duration).resonance)
        for share in SHARES:
            _, soft = logs(seed, compliance(share * limits[-1]), one(seed))
            named[share] += "compliance" in soft.diagnostics.detection.names
    yield (
        f"shown below {min(limits):.0f} to {max(limits):.0f} Hz; gears of a share of that,"
        " named in:"
    )
    yield from (f"{share:g}: {named[share]} of {robots}" for share in SHARES)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seed", type=int, default=0, help="of the first robot")
    parser.add_argument("--most", type=int, default=200, help="robots in a row")
    parser.add_argument("--row", help="only rows that begin so")
    parser.add_argument("--cost", action="store_true")
    parser.add_argument("--shown", type=int, metavar="ROBOTS")
    given = parser.parse_args()
    if given.cost or given.shown:
        for line in cost() if given.cost else shown(given.shown):
            print(line, flush=True)
        return
    print(
        f"| robot | {' | '.join(COLUMNS)} | and others | chi-square over its threshold, median |"
        " seconds |"
    )
    print(f"|---|{'---|' * len(COLUMNS)}---|---|---|")
    for i, (name, change, laws, count, few) in enumerate(ROWS):
        if given.row and not name.startswith(given.row):
            continue
        named, more, strength, started = collections.Counter(), 0, [], time.perf_counter()
        for robot in range(min(given.most, few if given.quick else count)):
            seed = given.seed + 1000 * i + robot
            _, found = logs(seed, change, laws(seed))
            detection = found.diagnostics.detection
            assert detection.reason is None, (seed, detection.reason)
            first = detection.names[0] if detection.names else "none"
            named[first] += 1
            more += len(detection.names) > 1
            strength.append(max(sign.chi_square / sign.threshold for sign in detection.signs))
            if first not in name or len(detection.names) > 1:
                print(f"    {name}, seed {seed}: {detection.names}", flush=True)
        cells = " | ".join(str(named[column]) for column in COLUMNS)
        seconds = (time.perf_counter() - started) / sum(named.values())
        print(
            f"| {name} | {cells} | {more} | {np.median(strength):.1f} | {seconds:.1f} |", flush=True
        )


if __name__ == "__main__":
    main()

"""How long a user waits for each command, in two trees: processor time and time on the clock.

    python tests/benchmarks/waiting.py [--old FOLDER] [--only NAME ...] [--joints 4 6 7] [--once]
        [--profile]

The arms: a SCARA with a ball-screw slide (4 joints) under PID with 20 mA of noise on its logged
currents, a PUMA 560 (6) and the same with one more joint in the wrist (7) under P control, 10 s of
log each. The robot file states four fifths of their friction, which is unknown. Each row is a
process of its own, old and new in turns, with a cache of kernels that a run before has filled; the
processor time counts its children, too, and hardly depends on what else the machine does. `--profile`
prints where the time of this tree goes instead.
"""

import argparse
import contextlib
import cProfile
import dataclasses
import os
import pstats
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
SECONDS = 10.0
"""Of each log."""
NOISE = 0.02
"""Of logged currents [A], rms."""
TARGETS = {
    ("python", 4): 8, ("python", 6): 8, ("python", 7): 12, ("print", 4): 0.5, ("print", 6): 0.5,
    ("print", 7): 0.5, ("report", 4): 15, ("certify", 4): 30, ("tune", 4): 60, ("everyday", 4): 300,
}  # fmt: skip
"""Asked on two idle cores [s]; the command line may add 3 s to Python."""
ROWS = ("python", "print", "identify", "report", "certify", "tune", "everyday")


# -- arms ----------------------------------------------------------------------------------------
def scara():
    """Two joints, a slide on a ball screw of 20 mm, a wrist; a PID per joint, its torque logged."""
    from plant import PID, Body, Chain, Drive, Dynamics, Encoder, Harmonics, Link, Rig

    # A slide has motor radians per metre.
    gear = np.array((80.0, -50.0, 2 * np.pi / 0.02, 30.0))
    drive = Drive(
        gear=gear, motor_inertia=(6e-5, 4e-5, 2e-5, 1e-5), viscous=(4e-4, 3e-4, 2e-4, 5e-5),
        coulomb=(0.06, 0.05, 0.03, 0.01), motor_gain=(0.1, 0.1, 0.1, 0.05),
        current_limit=(20, 20, 20, 20),
    )  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=(16384,) * 4), period=1e-3)
    bodies = [
        Body(mass=m, com=(x, 0, 0), inertia=(0.02, 0, 0, i, 0, i), rotor=rotor)
        for m, x, i, rotor in zip(
            (9, 6, 2, 0.8), (0.16, 0.14, 0, 0.03), (0.12, 0.06, 0.01, 0.003),
            drive.reflected_inertia(), strict=True,
        )
    ]  # fmt: skip
    links = (
        Link(name="base"), Link(name="elbow", a=0.35),
        Link(name="slide", a=0.3, prismatic=True), Link(name="wrist"),
    )  # fmt: skip
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    cosine, sine = np.random.default_rng(2).uniform(-0.4, 0.4, (2, 4, 3)) / np.arange(1, 4)
    cosine[2] *= 0.1
    sine[2] *= 0.1
    path = Harmonics(period=5.0, offset=(0.2, -0.4, -0.05, 0.1), cosine=cosine, sine=sine)
    arm = dynamics.arm(dynamics.f())
    # Poles at 60 rad/s for the inertia that each motor sees.
    unit = np.diag(arm.D(np.zeros(4))) / np.abs(gear) * 2 * np.pi / (16384 * np.abs(gear))
    gains = {"gain": unit * 60.0**2, "derivative": unit * 84.0, "integral": unit * 60.0**3 / 8}
    return arm, rig, PID(filter=600.0, period=1e-3, **gains), path


def wrist(n):
    """A PUMA 560 under P control; of seven joints with one more in the wrist."""
    from plant import Chain, Drive, Dynamics, Encoder, Harmonics, Link, Rig, p_gains, read_robot

    robot = read_robot("puma560")
    chain, rig = robot.dynamics.chain, robot.rig
    if n > 6:
        extra = Link(name="5b", alpha=-np.pi / 2, d=0.1, frame=chain.links[4].frame)
        links = (*chain.links[:5], extra, chain.links[5])
        chain = Chain(links=links, bodies=(*chain.bodies[:5], *chain.bodies[4:]))
        pick = [0, 1, 2, 3, 4, 4, 5]
        names = ("gear", "motor_inertia", "viscous", "coulomb", "motor_gain", "current_limit")
        drive = Drive(**{name: getattr(rig.drive, name)[pick] for name in names})
        rig = Rig(
            drive=drive, encoder=Encoder(resolution=rig.encoder.resolution[pick]), period=rig.period
        )
    dynamics = Dynamics.from_chain(chain)
    arm = dynamics.arm(dynamics.f())
    cosine, sine = np.random.default_rng(1).uniform(-0.4, 0.4, (2, n, 4)) / np.arange(1, 5)
    offset = (0, -0.5, 0.5, 0, 0.3, 0, 0)[:n]
    path = Harmonics(period=5.0, offset=offset, cosine=cosine, sine=sine)
    return arm, rig, p_gains(arm, rig, path, peak=12), path


def files(folder, n):
    """The log and the robot file of an arm with n joints, as a user has them."""
    from plant import Record, Robot, simulate, write_robot

    arm, rig, law, path = scara() if n == 4 else wrist(n)
    log = simulate(arm, rig, law, path, duration=SECONDS, steps_per_sample=16)
    drive = rig.drive
    stated = dataclasses.replace(drive, viscous=0.8 * drive.viscous, coulomb=0.8 * drive.coulomb)
    rig = dataclasses.replace(rig, drive=stated)
    current = None
    if n == 4:
        noise = np.random.default_rng(3).normal(scale=NOISE, size=log.torque.shape)
        current = drive.current(log.torque) + noise
    measured = Record(
        t=log.t, reference_pulses=log.reference_pulses, error_pulses=log.error_pulses, rig=rig,
        law=law, reference=path, current=current,
    )  # fmt: skip
    measured.to_csv(folder / "log.csv")
    robot = Robot(rig=rig, arm=arm, dynamics=arm.dynamics, law=law, name=f"{n} joints")
    write_robot(robot, folder / "robot.toml")


# -- what is timed -------------------------------------------------------------------------------
def run(name, folder):
    """The work of a row: a list of (part, processor seconds, seconds on the clock)."""
    from ctc.commandline import main

    if name == "python":
        from identification import identify
        from plant import Record, read_robot

        robot = read_robot(folder / "robot.toml")
        dynamics = robot.dynamics
        # With the rig of the robot file, as the command line: the log's own may be of another tree.
        record = Record.from_csv(folder / "log.csv", rig=robot.rig, law=robot.law)
        with timed() as fit:
            found = identify(dynamics, record, unknown="friction", progress=False)
        with timed() as shown:
            text = str(found)
        print(text, file=sys.stderr)
        return [("python", *fit), ("print", *shown)]
    found, page = str(folder / "found.json"), str(folder / "page.html")
    log, robot = str(folder / "log.csv"), str(folder / "robot.toml")
    arguments = {
        "identify": [
            "identify",
            log,
            "--robot",
            robot,
            "--unknown",
            "friction",
            "-o",
            found,
            "--force",
        ],
        "report": ["report", found, "-o", page, "--force"],
        "certify": ["certify", found, "--everyday"],
        "tune": ["tune", found, "--friction", "0.02"],
        "everyday": ["tune", found, "--friction", "0.02", "--everyday"],
    }
    with timed() as spent, contextlib.redirect_stdout(sys.stderr):
        main([*arguments[name], "--quiet"])
    return [(name, *spent)]


@contextlib.contextmanager
def timed():
    """Processor time of this process and its children, and time on the clock [s]."""
    spent = []
    started = processor(), time.perf_counter()
    yield spent
    spent += [processor() - started[0], time.perf_counter() - started[1]]


def processor():
    """Processor time so far, user and system [s]."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def child(tree, name, folder):
    """One row in a tree: (part, processor time, time on the clock) of each part."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "MPLBACKEND": "Agg"}
    command = [sys.executable, "-P", __file__, "--child", name, "--folder", str(folder)]
    with timed() as spent:
        answer = subprocess.run(  # noqa: S603
            command, capture_output=True, text=True, env=environment, cwd=tree, check=False,
        )  # fmt: skip
    (folder / f"{name}.txt").write_text(answer.stderr)
    if answer.returncode:
        return [(name, float("nan"), float("nan"))]
    parts = [line.split() for line in answer.stdout.splitlines()]
    if name == "python":
        return [(part, float(a), float(b)) for part, a, b in parts]
    # A command includes the start of its process.
    return [(name, *spent)]


def profile(name, folder):
    """Where the time of one row goes, by function."""
    profiler = cProfile.Profile()
    profiler.enable()
    run(name, folder)
    profiler.disable()
    pstats.Stats(profiler).sort_stats("cumulative").print_stats(70)


def main():
    """Print a table, a row for each command and number of joints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--old", type=Path, help="another checkout")
    parser.add_argument("--only", nargs="+", choices=ROWS, default=ROWS)
    parser.add_argument("--joints", nargs="+", type=int, default=(4, 6, 7))
    parser.add_argument("--once", action="store_true", help="without a run that fills the cache")
    parser.add_argument("--profile", action="store_true")
    parser.add_argument("--child", help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=Path, help="keep the files there")
    options = parser.parse_args()
    if options.child:
        for part in run(options.child, options.folder):
            print(*part)
        return
    base = options.folder or Path(tempfile.mkdtemp())
    trees = ({"old": options.old.resolve()} if options.old else {}) | {"new": ROOT}
    head = [f"{name}, {kind} [s]" for name in trees for kind in ("processor", "clock")]
    print(f"| command | joints | {' | '.join(head)} | asked, idle [s] |")
    print("|---" * (len(head) + 3) + "|", flush=True)
    for n in options.joints:
        rows: dict[tuple[str, str], list[float]] = {}
        for name in ROWS:
            # Everything but Python's own and `identify` is asked of four joints alone.
            if name not in options.only or (name in ("certify", "tune", "everyday") and n != 4):
                continue
            if name == "print":
                continue
            for tree, place in trees.items():
                folder = base / tree / str(n)
                folder.mkdir(parents=True, exist_ok=True)
                if not (folder / "log.csv").exists():
                    files(folder, n)
                if options.profile:
                    profile(name, folder)
                    continue
                if not options.once:
                    child(place, name, folder)
                for part, *seconds in child(place, name, folder):
                    rows.setdefault((part, tree), []).extend(seconds)
        for part in dict.fromkeys(part for part, _ in rows):
            cells = [f"{x:.1f}" for tree in trees for x in rows.get((part, tree), [np.nan] * 2)]
            asked = TARGETS.get((part, n), "")
            print(f"| {part} | {n} | {' | '.join(cells)} | {asked} |", flush=True)


if __name__ == "__main__":
    main()

"""Accuracy of the default identification on known robots, and coverage of its intervals.

    python tests/benchmarks/identification_study.py # tables of docs/background/identification.md, 20 minutes
    python tests/benchmarks/identification_study.py seeds     # or some of them, by name

Robots are simulated at 16 steps per sample, models at 4. Errors are in per cent of the width of the printed ranges.
"""

import dataclasses
import sys
import time

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import Objective, design_motion, identify, nearest_physical, pulse_budget
from identification.replay import Prediction, gauss_newton
from plant import Body, Dynamics, FrictionCurve, Harmonics, P, puma560, read_robot, simulate

DYNAMICS, RIG, PATH = puma560.dynamics(), puma560.rig(), puma560.reference()
WIDTH = np.diff(puma560.PRINTED_RANGES, axis=1).ravel()
ARMS = {"published f": puma560.arm(), "literature + 1.5 kg": puma560.literature_arm(1.5)}
GAINS = ((0.1, 0.08), (0.2, 0.15))
PERIODS = (3.65, 2.5, 2.0)
# where mass can be [m]
BOXES = [[(-0.1, 0.5), (-0.15, 0.15), (0, 0)], [(-0.15, 0.15), (-0.7, 0.15), (0, 0)]]


def off(values, arm):
    """Errors of f in per cent of the printed ranges."""
    return 100 * np.abs(values[:9] - arm.f) / WIDTH


def log(arm, gain, **options):
    """What the robot does."""
    return simulate(arm, RIG, puma560.p_law(gain), PATH, steps_per_sample=16, **options)


def seeds(count=20):
    """Default identification, many seeds: worst and median error, objective, cost."""
    yield (
        "| robot | gains | median error, worst seed | worst of f without f3 | f3, worst seed | "
        "objective over that of the true f, worst | evaluations | s |"
    )
    yield "|---|---|---|---|---|---|---|---|"
    for name, arm in ARMS.items():
        for gain in GAINS:
            record = log(arm, gain)
            true = Objective(DYNAMICS, record)(arm.f[None])[0]
            runs = [identify(DYNAMICS, record, seed=seed, progress=False) for seed in range(count)]
            wrong = np.array([off(run.f, arm) for run in runs])
            others = np.delete(wrong, 2, axis=1)
            yield (
                f"| {name} | {gain} | {np.median(wrong, axis=1).max():.2f} % | {others.max():.1f} %"
                f" | {wrong[:, 2].max():.1f} % | {max(run.objective for run in runs) / true:.2f} |"
                f" {max(run.evaluations for run in runs):,} |"
                f" {np.median([run.seconds for run in runs]):.2f} |"
            )


def methods():
    """Every method on the same four logs."""
    yield (
        "| method | median error, worst of 4 logs | worst error of the 4 | objective over that of"
        " the true f | s |"
    )
    yield "|---|---|---|---|---|"
    logs = [(arm, log(arm, gain)) for arm in ARMS.values() for gain in GAINS]
    true = [Objective(DYNAMICS, record)(arm.f[None])[0] for arm, record in logs]
    for method in ("paper", "equation_error", "output_error", "prediction_error", "seeded"):
        runs = [identify(DYNAMICS, record, method=method, progress=False) for _, record in logs]
        wrong = np.array([off(run.f, arm) for run, (arm, _) in zip(runs, logs, strict=True)])
        ratio = [run.objective / floor for run, floor in zip(runs, true, strict=True)]
        yield (
            f"| {method} | {np.median(wrong, axis=1).max():.1f} % | {wrong.max():.1f} % |"
            f" {min(ratio):.2f} to {max(ratio):.2f} |"
            f" {np.median([run.seconds for run in runs]):.2f} |"
        )


def knowledge(count=5):
    """The physical arm, with its link's length known (7 parameters), or with three records;
    errors of all nine f.
    """
    yield (
        "| gains | given | median error, worst seed | worst error | its standard deviation,"
        " estimated |"
    )
    yield "|---|---|---|---|---|"
    arm, base = ARMS["literature + 1.5 kg"], Dynamics.from_chain(DYNAMICS.chain)
    seven, nine = (np.array(each.lumping.matrix) for each in (base, DYNAMICS))
    back = np.linalg.lstsq(seven.T, nine.T, rcond=None)[0].T  # f1..f9 from the seven
    for gain in GAINS:
        once = log(arm, gain)
        pulse, start = np.abs(RIG.to_angle(np.eye(2)).diagonal()), once.true_q[0]
        again = [log(arm, gain, initial=(start + share * pulse, (0, 0))) for share in (0.3, -0.4)]
        faster = [
            simulate(
                arm,
                RIG,
                puma560.p_law(gain),
                puma560.reference(period),
                steps_per_sample=16,
                duration=3.65,
            )
            for period in (2.5, 2.0)
        ]
        designed = [
            simulate(arm, RIG, puma560.p_law(gain), motion, steps_per_sample=16)
            for motion in designed_motions(arm, gain)
        ]
        for name, dynamics, records, turned in (
            ("(6) once", DYNAMICS, [once], np.eye(9)),
            ("(6) once, length of the link known", base, [once], back),
            ("(6) three times", DYNAMICS, [once, *again], np.eye(9)),
            ("(6) at T = 3.65, 2.5 and 2.0 s, 3.65 s each", DYNAMICS, [once, *faster], np.eye(9)),
            ("one designed motion of 3.65 s", DYNAMICS, designed[:1], np.eye(9)),
            ("three designed motions", DYNAMICS, designed, np.eye(9)),
        ):
            runs = [
                identify(dynamics, records, seed=seed, held_out=(), progress=False)
                for seed in range(count)
            ]
            wrong = np.array([100 * np.abs(turned @ run.f - arm.f) / WIDTH for run in runs])
            said = 100 * np.sqrt(np.diag(turned @ runs[0].covariance @ turned.T)) / WIDTH
            yield (
                f"| {gain} | {name} | {np.median(wrong, axis=1).max():.2f} % | {wrong.max():.1f} %"
                f" | {said[wrong.max(axis=0).argmax()]:.1f} % |"
            )
        runs = [identify(DYNAMICS, once, seed=seed, progress=False) for seed in range(count)]
        wrong = np.array([off(nearest_physical(run, BOXES).arm.f, arm) for run in runs])
        name = "(6) once, bodies within boxes (`nearest_physical`)"
        yield (
            f"| {gain} | {name} | {np.median(wrong, axis=1).max():.2f} % | {wrong.max():.1f} % | |"
        )


def starts(count=50):
    """The paper's claim of 3.1: how many of so many wide starts end in a local minimum."""
    yield (
        "| search | at the global minimum (objective (4) below 1.3 times the true f's) | elsewhere"
        " | failed |"
    )
    yield "|---|---|---|---|"
    arm, record, random = (
        ARMS["published f"],
        log(ARMS["published f"], GAINS[1]),
        np.random.default_rng(0),
    )
    objective, low = Objective(DYNAMICS, record), np.array(puma560.PRINTED_RANGES)[:, 0]
    bottom = 1.3 * objective(arm.f[None])[0]
    points = []
    while len(points) < count:  # wide, but an arm: gradients need one
        drawn = low + random.uniform(size=(2000, 9)) * WIDTH
        points += list(drawn[np.isfinite(objective(drawn))])
    everywhere, ends, lost = np.array([(-np.inf, np.inf)] * 9), [], 0
    for start in points[:count]:
        try:
            fit = gauss_newton(
                Prediction(DYNAMICS, record, simulated=True),
                start,
                1e-4 * WIDTH,
                everywhere,
                rounds=40,
            )
            ends.append(objective(fit.values[None])[0])
        except ValueError:
            lost += 1
    seeds = [
        identify(DYNAMICS, record, seed=seed, method="paper", progress=False).objective
        for seed in range(count)
    ]
    best = [identify(DYNAMICS, record, seed=seed, progress=False).objective for seed in range(10)]
    for name, costs, gone in (
        ("gradient (Gauss-Newton on simulated positions)", ends, lost),
        ("genetic algorithm of the paper", seeds, 0),
        ("default (ten seeds)", best, 0),
    ):
        yield (
            f"| {name} | {np.sum(np.array(costs) <= bottom)} | {np.sum(np.array(costs) > bottom)} |"
            f" {gone} |"
        )


def designed_motions(arm, gain, count=3):
    """Motions of `design_motion` within limits that the arm's data sheet could have."""
    return [
        design_motion(
            arm,
            RIG,
            puma560.p_law(gain),
            period=3.65,
            position=[(-1.6, 0.1), (-0.1, 1.7)],
            velocity=(3.0, 4.0),
            acceleration=(12.0, 16.0),
            starts=1,
            seed=seed,
        )
        for seed in range(count)
    ]


def verdict(count=10):
    """Computed torque with what was found, on the robot it was found on."""
    yield (
        "| robot | gains | T [s] | all samples within ±1 | worst share | true error, peak [pulses]"
        " | joint 2, peak [N m] |"
    )
    yield "|---|---|---|---|---|---|---|"
    for name, arm in ARMS.items():
        for gain in GAINS:
            record = log(arm, gain)
            laws = []
            for seed in range(count):
                found = identify(DYNAMICS, record, seed=seed, progress=False)
                laws.append(ComputedTorque(found.arm, found.rig))
            for period in PERIODS:
                path = puma560.reference(period)
                reports = [evaluate(arm, RIG, law, path, backend="numba") for law in laws]
                yield (
                    f"| {name} | {gain} | {period} | {sum(r.within(1) for r in reports)} of {count}"
                    f" | {100 * min(r.fraction_within(1) for r in reports):.2f} % |"
                    f" {max(r.max_true_error_pulses.max() for r in reports):.2f} |"
                    f" {max(r.peak_torque[0] for r in reports):.0f} |"
                )


def random_arm(random):
    """The literature's arm with masses, centres and inertias off by up to 30 %, and a tool of up
    to 3 kg.
    """

    def body(mass, x, y, izz, rotor):
        scale = random.uniform(0.7, 1.3, 4)
        inertia = (0, 0, 0, 0, 0, izz * scale[3])
        return Body(
            mass=mass * scale[0], com=(x * scale[1], y * scale[2], 0), inertia=inertia, rotor=rotor
        )

    rotor2, rotor3 = RIG.drive.reflected_inertia()
    link2, link3 = (
        body(17.4, 0.068, 0.006, 0.539, rotor2),
        body(6.05, -0.0046, -0.148, 0.19, rotor3),
    )
    tool = Body(mass=random.uniform(0, 3), com=(0, -0.55, 0))
    return DYNAMICS.arm(DYNAMICS.f((link2, link3.joined(tool))))


def arms(count=25, realisations=25):
    """Random arms, each measured and identified several times: error, bound, coverage of the 95
    % intervals.
    """
    random, lost, unsure, started = np.random.default_rng(0), 0, 0, time.perf_counter()
    pulse = np.abs(RIG.to_angle(np.eye(2)).diagonal())
    wrong, inside, ratio, largest = [], [], [], []
    for k in range(count):
        arm, gain = random_arm(random), GAINS[k % 2]
        bound = pulse_budget(arm, RIG, puma560.p_law(gain), PATH).bound
        errors = []
        for seed in range(realisations):
            start = PATH(np.zeros(1)).q[0] + random.uniform(-1, 1, 2) * pulse
            record = log(arm, gain, initial=(start, (0, 0)))
            # the robot does not say where in the cell it was
            record = dataclasses.replace(record, initial=None)
            try:
                found = identify(DYNAMICS, record, seed=seed, progress=False)
            except ValueError:
                lost += 1
                continue
            errors.append(found.f - arm.f)
            if found.covariance is None:  # it says itself that it did not come to an end
                unsure += 1
            else:
                inside.append(np.abs(found.fit.values - arm.f) < 1.96 * found.fit.std)
        wrong.append(100 * np.abs(errors) / WIDTH)
        ratio.append(np.sqrt(np.mean(np.square(errors), axis=0)) / bound)
        largest.append(wrong[-1].max(axis=0))
    runs = sum(map(len, wrong))
    yield (
        f"{count} random arms, {realisations} logs each: {runs} identifications, {lost} lost,"
        f" {unsure} that say themselves that they know no interval (with a warning, and counted"
        f" among the errors), {time.perf_counter() - started:.0f} s"
    )
    yield ""
    yield "| | " + " | ".join(DYNAMICS.names) + " |"
    yield "|---|" + "---|" * 9
    rows = {
        "mean error [% of the range]": (np.concatenate(wrong).mean(axis=0), ".2f"),
        "worst error [%]": (np.max(largest, axis=0), ".1f"),
        "rms error over the bound, median of the arms": (np.median(ratio, axis=0), ".1f"),
        "95 % intervals that cover the truth [%]": (100 * np.mean(inside, axis=0), ".0f"),
    }
    for name, (values, form) in rows.items():
        yield f"| {name} | " + " | ".join(f"{value:{form}}" for value in values) + " |"


def unknowns(count=12):
    """Coverage of the 95 % intervals when more than f is unknown, or the reference is known by
    its counts only.
    """
    yield (
        "| unknown | 95 % intervals that cover the truth | error over standard deviation, RMS |"
        " worst |"
    )
    yield "|---|---|---|---|"
    friction = tuple(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1))
    curve = FrictionCurve(offset=(0.0, 0.0), breakaway=(0.0, 0.0), speed=(1.0, 1.0))
    curved = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve))
    for name, more, rig, keep in (
        ("f", (), RIG, True),
        ("f, reference by its counts", (), RIG, False),
        ("f and friction", friction, RIG, True),
        ("f and P gains", ("law.gain[0]", "law.gain[1]"), RIG, True),
        (
            "f and offsets of friction",
            ("drive.curve.offset[0]", "drive.curve.offset[1]"),
            curved,
            True,
        ),
        ("f and one gear", ("drive.gear[0]",), RIG, True),
    ):
        random, scaled = np.random.default_rng(1), []
        for k in range(count):
            arm, p = random_arm(random), puma560.p_law(GAINS[k % 2])
            record = simulate(arm, rig, p, PATH, steps_per_sample=16)
            record = record if keep else dataclasses.replace(record, reference=None)
            found = identify(
                DYNAMICS, record, unknown=(*DYNAMICS.names, *more), seed=k, progress=False
            )
            if found.covariance is None:
                continue
            known = dict(zip(rig.number_names(), rig.number_values(), strict=True))
            known |= dict(zip(p.number_names("law."), p.number_values(), strict=True))
            true = np.append(arm.f, [known[each] for each in more])
            scaled.append((found.fit.values - true) / found.fit.std)
        z = np.abs(scaled)
        yield (
            f"| {name} | {100 * np.mean(z < 1.96):.0f} % | {np.sqrt(np.mean(z**2)):.2f} |"
            f" {z.max():.1f} |"
        )


def whole():
    """All six joints of the PUMA 560: forty base parameters from one log, no ranges."""
    yield (
        "| method | error over standard deviation, RMS and worst | 95 % intervals that cover the"
        " truth | RMS innovation [pulses] | computed torque, share within ±1 | s, kernels built |"
    )
    yield "|---|---|---|---|---|---|"
    robot = read_robot("puma560")
    dynamics, arm, rig = robot.dynamics, robot.arm, robot.rig
    path = Harmonics(
        period=4.0, offset=(0.0,) * 6,
        cosine=((0.5, 0.2), (-0.4, 0.2), (0.3, -0.3), (0.5, 0.1), (-0.4, 0.3), (0.2, 0.5)),
        sine=((0.3, 0.1), (0.2, -0.1), (-0.3, 0.2), (0.4, 0.2), (0.3, 0.3), (0.6, -0.2)),
    )  # fmt: skip
    record = simulate(
        arm, rig, P(gain=(0.11, 0.07, 0.04, 0.004, 0.004, 0.004)), path, steps_per_sample=16
    )
    for method in ("equation_error", "prediction_error", "seeded"):
        found = identify(dynamics, record, method=method, progress=False)
        z = np.abs(found.f - arm.f) / found.fit.std
        report = evaluate(arm, rig, ComputedTorque(found.arm, found.rig), path, backend="numba")
        rms = "" if found.fit.rms_innovation is None else f"{found.fit.rms_innovation:.3f}"
        yield (
            f"| {method} | {np.sqrt(np.mean(z**2)):.2f}, {z.max():.1f} |"
            f" {100 * np.mean(z < 1.96):.0f} % | {rms} | {report.share_within(1)} |"
            f" {found.seconds:.1f} |"
        )


TABLES = {
    table.__name__: table
    for table in (seeds, knowledge, methods, starts, verdict, arms, unknowns, whole)
}

if __name__ == "__main__":
    for title in sys.argv[1:] or TABLES:
        print(f"\n## {title}\n")
        for line in TABLES[title]():
            print(line, flush=True)

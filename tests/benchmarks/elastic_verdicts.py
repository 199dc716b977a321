"""Is the bound of a certificate a bound on the machine? Elastic robots, identified from their P log
and certified.

    python tests/benchmarks/elastic_verdicts.py [--quick] [--mujoco]

For each resonance, damping ratio and pair of P gains: the robot's log is identified with rigid
gears, a law is built on what was found, and certified with the resonance stated to +-10 % and
friction to 2 %: by 10,000 plants, or by the first 2,000 where some of those leave. Beside it what
the robot does: the true f on gears of the true resonance and damping, in 1,000 loops with friction
and encoder zeros of their own. A bound holds if it is at least the lower 99 % bound of the robot's
share; it is useful if it is below 1 % where a range of +-10 % around the robot is clean. With
`--mujoco` log and robot are simulated by MuJoCo, in 24 loops of the robot.
"""

import dataclasses
import sys
import time
from pathlib import Path

import numpy as np

from ctc import ComputedTorque, ComputedTorquePID, FeedForward, Uncertainty, certify
from ctc.certification import clopper_pearson
from identification import identify
from plant import PD, Elasticity, P, puma560, simulate

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
START = PATH([0.0]).q[0]
FRICTION, SHARE, REAL, USEFUL, AFTER, FEW = 0.02, 0.1, 1000, 0.01, 0.02, 2000
PD_LAW = PD(gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period)
LAWS = {
    "observer 60": lambda found: ComputedTorque(found, RIG, bandwidth=60),
    "observer 150": lambda found: ComputedTorque(found, RIG, bandwidth=150),
    "PID that rolls off": lambda found: ComputedTorquePID(
        found,
        RIG,
        bandwidth=170.6,
        ratio=1.041,
        integral=11.62,
        roll_off=2188,
        roll_off_damping=1.185,
    ),
    "feed-forward + PD": lambda found: FeedForward(found, RIG, feedback=PD_LAW),
}


def on_gears(hz, ratio):
    elasticity = Elasticity.from_resonance(ARM, hz, ratio, drive=RIG.drive, q=START)
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, elasticity=elasticity))


def real(law, hz, ratio, seed):
    """Loops of the robot itself that leave: share, and its lower 99 % bound."""
    own = certify(
        ARM,
        on_gears(hz, ratio),
        law,
        PATH,
        Uncertainty(plants=ARM.f[None], friction=FRICTION),
        samples=REAL,
        seed=seed,
    )
    return own.probability, clopper_pearson(own.failures, REAL, 0.98)[0]


def elsewhere(law, hz, ratio, seed, loops=24):
    """Loops of the robot in MuJoCo that leave: share, and its lower 99 % bound."""
    from mujoco_elastic import run

    random, left, gears = np.random.default_rng(seed), 0, on_gears(hz, ratio)
    link = simulate(ARM, gears, law, PATH, duration=2 * RIG.period).true_q[0]
    for _ in range(loops):
        friction, shift = 1 + FRICTION * random.standard_normal(2), random.uniform(-0.5, 0.5, 2)
        errors, _ = run(
            ARM, gears.drive.elasticity, law, link, PATH, PATH.duration, 20, friction, shift
        )
        left += np.abs(errors[RIG.period * np.arange(len(errors)) >= AFTER]).max() > 1
    return left / loops, clopper_pearson(left, loops, 0.98)[0]


def log_of(hz, ratio, gain, engine):
    """What the robot logs under P; the rig of the record knows of no gears."""
    gears = on_gears(hz, ratio)
    if not engine:
        return dataclasses.replace(
            simulate(ARM, gears, P(gain=gain), PATH, steps_per_sample=16), rig=RIG
        )
    from mujoco_elastic import p_loop

    link = simulate(ARM, gears, P(gain=gain), PATH, duration=2 * RIG.period).true_q[0]
    return p_loop(ARM, gears.drive.elasticity, np.array(gain), link, PATH.duration, 16)


def cells_of(quick, engine):
    """Gains, resonances [Hz] and damping ratios of the study."""
    if engine:
        return [((0.1, 0.08), hz, 0.02) for hz in (25, 60, 100)]
    hertz = (25, 60, 100, 200) if quick else (15, 25, 40, 60, 100, 150, 200, 300)
    ratios = (0.02,) if quick else (0.01, 0.02, 0.03)
    return [
        (gain, hz, ratio) for gain in ((0.1, 0.08), (0.2, 0.15)) for hz in hertz for ratio in ratios
    ]


def main(quick, engine):
    share_of, most = elsewhere if engine else real, FEW if quick or engine else 10_000
    broken, dull, cells = [], [], 0
    print(
        f"{'gains':>12} {'Hz':>4} {'damping':>7}  {'law':<20} {'robot leaves':>12}"
        f" {'lower 99 %':>10} {'upper':>7}"
    )
    for gain, hz, ratio in cells_of(quick, engine):
        here = f"{gain!s:>12} {hz:4} {ratio:7} "
        stated = Uncertainty(resonance=((1 - SHARE) * hz, (1 + SHARE) * hz), friction=FRICTION)
        try:
            found = identify(ARM.dynamics, log_of(hz, ratio, gain, engine), seed=1, progress=False)
        except ValueError as error:
            print(f"{here} not identified: {error}")
            continue
        for name, build in LAWS.items():
            started = time.perf_counter()
            try:
                law = build(found)
                certificate = certify(found, RIG, law, PATH, stated, samples=FEW)
                if most > FEW and not certificate.failures:
                    certificate = certify(found, RIG, law, PATH, stated, samples=most)
                upper = certificate.upper
            except ValueError as error:
                print(f"{here} {name:<20} refused: {error}")
                continue
            share, lower = share_of(law, hz, ratio, seed=hz)
            clean = (
                upper > USEFUL
                and share == 0
                and all(
                    real(law, hz * factor, each, seed=hz)[0] == 0
                    for factor in (1 - SHARE, 1.0, 1 + SHARE)
                    for each in (0.01, 0.03)
                )
            )
            cells += 1
            if upper < lower:
                broken.append((gain, hz, ratio, name))
            elif clean:
                dull.append((gain, hz, ratio, name))
            note = "BROKEN" if upper < lower else "not below 1 %, though clean" if clean else ""
            seconds = time.perf_counter() - started
            print(
                f"{here} {name:<20} {share:12.2%} {lower:10.2%} {upper:7.2%} {seconds:5.1f} s"
                f" {note}",
                flush=True,
            )
    print(
        f"{cells} cells: bound below the robot's share in {len(broken)}, above 1 % though clean in"
        f" {len(dull)}"
    )


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parent.parent / "oracles"))
    main("--quick" in sys.argv, "--mujoco" in sys.argv)

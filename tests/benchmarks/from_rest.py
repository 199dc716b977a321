"""Plants that leave ±1 pulse on paths that begin gently, and on others: by how fast the law's observer begins.

    python tests/benchmarks/from_rest.py [--samples 400]

Three observers: never faster than it ends (start_boost=1), faster as the first sample of the reference asks for
(start_boost=3, the default), and faster always. Arms, friction identified too: the paper's, and one of two links behind
gears of 100 and 80 with finer counts. Paths from rest: without acceleration at first (of fifth order), with one (half
a cosine), and the paper's, which begins with one, too.
"""

import argparse
import dataclasses

import casadi as ca
import numpy as np

from ctc import ComputedTorque, certify
from identification import identify
from plant import PID, Body, Chain, Drive, Dynamics, Encoder, Harmonics, Link, PointToPoint, Rig, puma560, simulate
from plant.parts.part import part

FRICTION = tuple(f"drive.{kind}[{joint}]" for kind in ("viscous", "coulomb") for joint in (0, 1))


@part
class AlwaysFaster(ComputedTorque):
    """The observer begins at its full boost, whatever the reference asks for."""

    def _asked(self, rig, setpoint):
        return ca.SX(1)


def paper():
    """The paper's arm, identified with its friction."""
    log = simulate(puma560.arm(), puma560.rig(), puma560.p_law(), puma560.reference())
    dynamics = puma560.dynamics()
    return identify(dynamics, log, seed=1, unknown=[*dynamics.names, *FRICTION], progress=False)


def geared():
    """An arm under PID, identified with its friction."""
    drive = Drive(gear=(100, -80), motor_inertia=(1.2e-4, 8e-5), viscous=(6e-4, 5e-4), coulomb=(0.09, 0.06),
                  motor_gain=(0.15, 0.12), current_limit=(15, 12))  # fmt: skip
    rig = Rig(drive=drive, encoder=Encoder(resolution=(4000, 4000)), period=1e-3)
    bodies = [
        Body(mass=mass, com=(length / 2, 0.01, 0), inertia=(0, 0, 0, inertia, 0, inertia), rotor=rotor)
        for mass, length, inertia, rotor in zip(
            (7, 4), (0.4, 0.35), (0.10, 0.04), drive.reflected_inertia(), strict=True
        )
    ]
    links = (Link(name="shoulder", alpha=np.pi / 2), Link(name="elbow", a=0.4))
    dynamics = Dynamics.from_chain(Chain(links=links, bodies=bodies))
    path = Harmonics(period=4.0, offset=(0.5, -0.6), cosine=((-0.5, -0.1), (0.4, -0.5)), sine=((0.3, 0.2), (-0.4, 0.3)))
    law = PID(gain=(0.03, 0.02), integral=(0.15, 0.1), derivative=(1e-4, 8e-5), filter=2000.0, period=1e-3)
    log = simulate(dynamics.arm(dynamics.f()), rig, law, path, steps_per_sample=16)
    return identify(dynamics, log, seed=1, unknown=[*dynamics.names, *FRICTION], progress=False)


def paths(moves):
    """Name and reference: moves of fifth order and of half a cosine, each of 1, 2 and 4 s."""
    for start, goal in moves:
        middle, half = np.add(start, goal) / 2, np.subtract(start, goal) / 2
        for time in (1.0, 2.0, 4.0):
            yield f"fifth order, {time:g} s", PointToPoint(start=start, goal=goal, duration=time)
            yield (
                f"half a cosine, {time:g} s",
                Harmonics(period=2 * time, offset=middle, cosine=half[:, None], sine=np.zeros((2, 1))),
            )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, default=400)
    samples = parser.parse_args().samples
    print("| arm | path | start_boost=1 | as asked for | always 3 |\n|---|---|---|---|---|")
    arms = (
        ("paper's", paper(), (((-1, 0.5), (0, 1.2)), ((0, 0), (0.3, -0.3)), ((0.5, 1), (0.5, 1.5)))),
        ("geared", geared(), (((0.1, -0.5), (0.7, -1)), ((0.1, -1), (0.5, -0.6)), ((-0.3, 0), (-0.3, -1)))),
    )
    for name, found, moves in arms:
        known = [("trajectory (6)", puma560.reference())] if name == "paper's" else []
        for path_name, path in [*paths(moves), *known]:
            law = ComputedTorque(found)
            cells = []
            for each in (
                dataclasses.replace(law, start_boost=1.0),
                law,
                AlwaysFaster(law.arm, law.rig, bandwidth=law.bandwidth),
            ):
                certificate = certify(found, found.rig, each, path, samples=samples, duration=1.0, progress=False)
                cells.append(f"{certificate.failures / samples:.0%}")
            print(f"| {name} | {path_name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

"""What real drives, encoders and clocks do to the promise of one pulse, law by law: a table.

    python tests/benchmarks/effects.py [name of a row, or its beginning ...]

Literature arm with 1.5 kg on trajectory (6), every law with the true f and with the friction that
it believes in. In a cell: share of the samples after 20 ms at which both joints' counts are within
±1, and the mean change of joint 2's torque per sample [N m]. Backlash is that of gears whose links
swing at 200 Hz, 2 % damped. Cogging is six per turn of the motor, 3 % of its largest torque. Where
four runs are made (backlash: phases of the encoders; cogging: its own phases; jitter: seeds) a cell
has the least and the largest share, and the largest change of torque.
"""

import argparse
import dataclasses

import numpy as np

from ctc import ComputedTorque, FeedForward, compare
from plant import (
    PD,
    Elasticity,
    FrictionDrift,
    Jitter,
    Phase,
    Presliding,
    QuadratureError,
    TorqueRipple,
    Transport,
    puma560,
)

ARM, RIG, PATH = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
LAWS = {
    "computed torque 250": ComputedTorque(ARM, RIG),
    "computed torque 150": ComputedTorque(ARM, RIG, bandwidth=150),
    "computed torque 60": ComputedTorque(ARM, RIG, bandwidth=60),
    "feed-forward + PD": FeedForward(ARM, RIG, feedback=PD(
        gain=(0.1, 0.075), derivative=(4e-4, 3e-4), filter=3000.0, period=RIG.period)),
}  # fmt: skip
SETTLED = 0.02
"""Time from which samples count [s]."""


def drive(**changes):
    return dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, **changes))


def geared(backlash):
    """Elastic gears at 200 Hz with so much backlash [degree]."""
    gears = Elasticity.from_resonance(
        ARM, 200, 0.02, drive=RIG.drive, backlash=np.full(2, np.deg2rad(backlash))
    )
    shifts = (np.full(2, shift) for shift in (-0.5, -0.25, 0.0, 0.25))
    encoders = [dataclasses.replace(RIG.encoder, phase=Phase(shift=shift)) for shift in shifts]
    return [dataclasses.replace(drive(elasticity=gears), encoder=encoder) for encoder in encoders]


def bristles(pulses, damping=None):
    distance = RIG.encoder.to_angle(np.full(2, float(pulses)))
    return [
        drive(
            presliding=Presliding(
                distance=distance, damping=None if damping is None else (damping,) * 2
            )
        )
    ]


def cogging(share):
    amplitude = share * RIG.drive.motor_gain * RIG.drive.current_limit
    phases = np.deg2rad((0, 90, 180, 270))
    return [
        drive(ripple=TorqueRipple(amplitude=amplitude, cycles=(6, 6), phase=(phase, phase)))
        for phase in phases
    ]


def shaken(share):
    return [dataclasses.replace(RIG, jitter=Jitter(share=share, seed=seed)) for seed in range(4)]


def tracks(amplitude):
    error = QuadratureError(amplitude=(amplitude, amplitude))
    return [dataclasses.replace(RIG, encoder=dataclasses.replace(RIG.encoder, quadrature=error))]


EFFECTS = {
    "none": [RIG],
    "200 Hz": [drive(elasticity=Elasticity.from_resonance(ARM, 200, 0.02, drive=RIG.drive))],
    "200 Hz, backlash 0.01 degree": geared(0.01),
    "200 Hz, backlash 0.05 degree": geared(0.05),
    "cogging 3 %": cogging(0.03),
    "LuGre, 5 pulses": bristles(5),
    "LuGre, 20 pulses": bristles(20),
    "LuGre, 5 pulses, micro-damping 0.01 N m s/rad": bristles(5, 0.01),
    "LuGre, 20 pulses, micro-damping 0.01 N m s/rad": bristles(20, 0.01),
    "current lag 0.3 ms": [drive(current_lag=3e-4)],
    "current lag 1 ms": [drive(current_lag=1e-3)],
    "delay of one sample": [dataclasses.replace(RIG, transport=Transport(delay=RIG.period))],
    "jitter 5 %": shaken(0.05),
    "jitter 10 %": shaken(0.1),
    "jitter 20 %": shaken(0.2),
    "viscous +50 %": [drive(viscous=1.5 * RIG.drive.viscous)],
    "Coulomb +50 %": [drive(coulomb=1.5 * RIG.drive.coulomb)],
    "viscous and Coulomb +50 %": [
        drive(viscous=1.5 * RIG.drive.viscous, coulomb=1.5 * RIG.drive.coulomb)
    ],
    "load-dependent friction 0.1": [drive(load_friction=(0.1, 0.1))],
    "drift of friction by -20 % in 2 s": [
        drive(friction_drift=FrictionDrift(amount=(-0.2, -0.2), time=(2.0, 2.0)))
    ],
    "quadrature error 0.2 pulses": tracks(0.2),
}
"""Rigs of each row."""


def share(evaluation):
    record = evaluation.record
    return (np.abs(record.error_pulses[record.t >= SETTLED - 1e-9]) <= 1).all(axis=1).mean()


def cell(evaluations):
    """Shares, rounded down, so that 100.00 means all samples, and chatter, of the runs under one
    law.
    """
    if None in evaluations:
        return "diverges"
    shares = sorted({f"{np.floor(share(each) * 1e4) / 100:.2f}" for each in evaluations}, key=float)
    said = " to ".join(dict.fromkeys((shares[0], shares[-1])))
    return f"{said} % / {max(each.chatter[0] for each in evaluations):.1f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rows", nargs="*", help="by default all: " + "; ".join(EFFECTS))
    wanted = tuple(parser.parse_args().rows)
    print(f"| effect | {' | '.join(LAWS)} |\n|---|{'---|' * len(LAWS)}")
    for name, rigs in EFFECTS.items():
        if not wanted or name.startswith(wanted):
            runs = [compare(ARM, rig, LAWS, PATH).evaluations for rig in rigs]
            print(
                f"| {name} | {' | '.join(cell([run.get(law) for run in runs]) for law in LAWS)} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

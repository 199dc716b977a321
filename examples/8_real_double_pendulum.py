"""A real arm from its logs: a double pendulum with geared motors, identified, simulated, and
controlled.

Give the folder that holds ``dfki_double_pendulum`` as CTC_DATA; the public original is the
repository dfki-ric-underactuated-lab/double_pendulum (BSD-3-Clause), commit
1e8544e67f3da72a51ee52fbbb278e131ce2a43f.

The arm was driven in open loop: torques in, positions out, 10 s per run, at about 500 Hz with
jitter and gaps. So the model replays the logged torques at the logged times. In each run the
counters were zeroed where friction held the arm: the encoder offset of every run is estimated as
well.
"""

import os
import sys
from pathlib import Path

import numpy as np

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import (
    Chain,
    Drive,
    Dynamics,
    Encoder,
    Harmonics,
    Link,
    LoggedTorque,
    Lumping,
    Record,
    Rig,
    replay,
    visibility,
)

STEP = 25 / 65535  # [rad] of the joint: 16 bits for 25 rad
DESIGNS = {  # lengths of the links [m], runs for the fit, runs for validation
    "C.0": ((0.2, 0.3), ("00", "02", "04", "06"), ("01", "03", "05")),
    "A.0": ((0.3, 0.2), ("00", "02", "12"), ("01", "03", "13")),
}
PATH = Harmonics(
    period=4.0,
    offset=(0.5, 0.7),
    cosine=((-0.4, -0.1), (-0.5, -0.2)),
    sine=((0.0, 0.0), (0.3, -0.15)),
)
TERMS = ("I1 + l1^2 m2", "m1 r1 + l1 m2", "m2 r2", "I2")
# from the models that the authors fitted: model_3.0 of C.0, model_2.0 of A.0; of the rotor, gear^2
# Ir
PUBLISHED = {
    "C.0": {
        "I1": 0.026710765,
        "I2": 0.053878130,
        "m1": 0.64169378,
        "m2": 0.56393595,
        "r1": 0.2,
        "r2": 0.32126699,
        "rotor": 36 * 9.9372812e-05,
    },
    "A.0": {
        "I1": 0.053470810,
        "I2": 0.023923745,
        "m1": 0.55938062,
        "m2": 0.60434595,
        "r1": 0.3,
        "r2": 0.18377686,
        "rotor": 36 * 7.6592980e-05,
    },
}


def rig():
    """Quasi-direct drives: gear 6, torque constant and rotor as published by the maker; friction
    is a first guess.
    """
    drive = Drive(
        gear=(6, 6),
        motor_inertia=(6.07e-5, 6.07e-5),
        motor_gain=(0.091, 0.091),
        current_limit=(18, 18),
        viscous=(1e-4, 1e-4),
        coulomb=(0.02, 0.02),
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(2 * np.pi / STEP / 6,) * 2), period=0.002)


def dynamics(lengths, *, every=False):
    """Two links in a vertical plane; at q = 0 both hang down, q2 is counted from link 1. Every:
    all 22 parameters.
    """
    links = (Link(name="1", alpha=np.pi / 2, theta=-np.pi / 2), Link(name="2", a=lengths[0]))
    chain = Chain(links=links)
    return (
        Dynamics(chain=chain, lumping=Lumping.standard(chain))
        if every
        else Dynamics.from_chain(chain)
    )


def load(folder, design, run):
    """One run as a record."""
    columns = {
        "t": "time",
        "position": ["pos_meas1", "pos_meas2"],
        "torque": ["tau_meas1", "tau_meas2"],
    }
    return Record.read(
        folder / f"sysid_{design}.npz",
        rig=rig(),
        law=LoggedTorque(),
        prefix=f"trajectory_{run}/",
        columns=columns,
        units={"t": "s", "position": "rad", "torque": "N m"},
    )


def fit(dynamics, records, held_out=()):
    """Identify f and friction. Ranges are wide, a factor of 25 from end to end; links are
    symmetric, so that my = 0.
    """
    guesses = (
        0.3,
        0.0,
        0.07,
        0.15,
        0.0,
        0.035,
        0.003,
    )  # of f: a link of 0.6 kg, half a metre long, a rotor of 8e-5 kg m^2
    friction = {"drive.viscous": 2e-4, "drive.coulomb": 0.02}
    unknown = (*dynamics.names, *(f"{kind}[{i}]" for kind in friction for i in range(2)))
    ranges = [
        (guess / 5, guess * 5)
        for guess in (*guesses, *(guess for guess in friction.values() for _ in range(2)))
    ]
    return identify(
        dynamics,
        records,
        unknown=unknown,
        ranges=ranges,
        zeros=True,
        held_out=held_out,
        progress=False,
    )


def four_terms(design, found):
    """Identified and published values of the identifiable terms; the first includes its rotor."""
    p, length = PUBLISHED[design], DESIGNS[design][0][0]
    first, inertia = (
        p["m1"] * p["r1"] + length * p["m2"],
        p["I1"] + length**2 * p["m2"] + p["rotor"],
    )
    return found.f[[2, 0, 3, 5]], np.array([inertia, first, p["m2"] * p["r2"], p["I2"]])


def misses(found, records):
    """Root mean square (n,) [rad] of the error of an open-loop simulation, all samples of all
    runs together.
    """
    missed = [replay(found.arm, record, rig=found.rig).counts - record.counts for record in records]
    return np.sqrt(np.mean(np.vstack(missed) ** 2, axis=0)) * STEP


def draw(found, record, name):
    """A run kept aside: what the encoders counted, and a free simulation from the torques alone."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    free = replay(found.arm, record, rig=found.rig)
    figure, axes = plt.subplots(2, 1, figsize=(9, 4.5), sharex=True, layout="constrained")
    for joint, axis in enumerate(axes):
        for log, colour, width, label in (
            (record, "#b3bcc0", 2.6, "measured"),
            (free, "#d55e00", 0.8, "simulated from its torques alone"),
        ):
            axis.plot(
                log.t, log.counts[:, joint] * STEP, color=colour, linewidth=width, label=label
            )
        axis.set_ylabel(f"joint {joint + 1} [rad]")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].set_title(
        f"{name}: a run that the identification has not seen", fontsize=10, loc="left"
    )
    axes[0].legend(frameon=False, fontsize=8, ncols=2, loc="lower right", bbox_to_anchor=(1, 1))
    axes[1].set_xlabel("time [s]")
    path = Path("figures") / f"{name.replace(' ', '_')}_run.png"
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return path


def study(folder, design):
    """Identification of one design, and the runs kept aside."""
    lengths, learn, aside = DESIGNS[design]
    records, kept = ([load(folder, design, run) for run in runs] for runs in (learn, aside))
    return fit(dynamics(lengths), records, kept), kept


def controlled(found, other):
    """The verdict on computed torque from one identification, on the arm that another one found."""
    law = ComputedTorque(found, bandwidth=120)
    return evaluate(other.arm, other.rig, law, PATH)


def main():
    if not os.environ.get("CTC_DATA"):
        print(
            "CTC_DATA is not set: no log to identify from. Give the folder that holds"
            " dfki_double_pendulum."
        )
        return 0
    folder = Path(os.environ["CTC_DATA"]) / "dfki_double_pendulum"
    if not folder.is_dir():
        print(f"CTC_DATA must hold a folder dfki_double_pendulum; {folder} is not there.")
        return 1
    print(load(folder, "C.0", "01").check(), "\n")
    shown = visibility(dynamics(DESIGNS["C.0"][0], every=True), PATH)
    print(
        f"identifiable combinations: {', '.join(shown.combinations)}; m1, r1, I1 not separately\n"
    )
    for design in DESIGNS:
        found, kept = study(folder, design)
        print(f"design {design}, {found.seconds:.0f} s\n{found.summary()}\n")
        print(f"{'':16}{'found':>10}{'published':>11}{'ratio':>8}")
        for name, ours, theirs in zip(TERMS, *four_terms(design, found), strict=True):
            print(f"{name:16}{ours:10.5f}{theirs:11.5f}{ours / theirs:8.3f}")
        off = misses(found, kept)
        print(
            f"validation runs, open-loop simulation for 10 s: error {off[0]:.4f} and {off[1]:.4f}"
            " rad (rms)"
        )
        print(f"figure: {draw(found, kept[0], f'design {design}')}\n")
        # in place of the real arm: the same arm from other runs
        again = fit(found.arm.dynamics, kept)
        print("the controller from the first runs, on the arm identified from the validation runs:")
        report = controlled(found, again)
        print(report, "\n")
        assert report.within(2)
        assert report.fraction_within(1) > 0.99
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""A load in the gripper, identified during operation: pick 2.5 kg, carry, drop, ten cycles; then
the whole PUMA 560.

The figure ``payload.png`` in the folder where this runs shows error and estimated mass over the
first two cycles.
"""

import sys
from pathlib import Path

import numpy as np

from ctc import ComputedTorque, PayloadEstimator
from plant import Body, Harmonics, SteppedArm, puma560, read_robot

TAKES, DROPS, CYCLE = 0.9, 2.3, 3.0
"""When a load is taken and dropped in each cycle, and how long that is [s]."""


def work(arm, rig, path, estimator, load, cycles):
    """Errors [pulses] and the mass in the model [kg] of so many cycles, and the controller."""
    samples = round(cycles * CYCLE / rig.period)
    motion = path(np.arange(samples) * rig.period)
    stepped = SteppedArm(arm, rig, motion.q[0], motion.qd[0])
    controller, pulses = estimator.start(rig, stepped.pulses), stepped.pulses
    errors, masses = np.zeros((samples, rig.n)), np.zeros(samples)
    takes, drops = (
        {round((k * CYCLE + t) / rig.period) for k in range(cycles)} for t in (TAKES, DROPS)
    )
    for k, state in enumerate(zip(*motion, strict=True)):
        if k in takes or k in drops:
            stepped.carry(load if k in takes else None)
        errors[k] = rig.counts(state[0]) - pulses
        pulses = stepped.step(controller.step(pulses, *state))
        masses[k] = controller.load.mass
    return errors, masses, controller


def told(controller):
    """One line per event."""
    for event in controller.events:
        print(
            f"  {event.time:6.3f} s  {event.kind:8} {event.before:5.2f} -> {event.after:5.2f} kg,"
            f" in the model at {event.swapped:6.3f} s"
        )


def drawn(rig, errors, masses, controller, seconds, true):
    """Error and mass over time, with the stages marked."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    t = np.arange(len(errors)) * rig.period
    some = t < seconds
    above.plot(
        t[some], errors[some], lw=0.6, label=[f"joint {name}" for name in ("2", "3")[: rig.n]]
    )
    above.axhspan(-1, 1, color="0.9", zorder=0)
    above.set_ylabel("tracking error [pulses]")
    above.legend(loc="upper right")
    below.plot(t[some], true(t[some]), color="0.6", lw=2, label="true")
    below.plot(t[some], masses[some], color="#d55e00", label="in the model")
    below.set_ylabel("load [kg]")
    below.set_xlabel("time [s]")
    named = False
    for event in controller.events:
        if event.time < seconds and np.isfinite(event.swapped):
            for axis in (above, below):
                axis.axvspan(
                    event.time,
                    event.swapped,
                    color="#e69f00",
                    alpha=0.25,
                    label=None if named else "collecting",
                )
                axis.axvline(event.swapped, color="#009e73", lw=1, label=None if named else "swap")
            named = True
    handles, labels = below.get_legend_handles_labels()
    below.legend(handles, labels, loc="center right")
    return figure


def main(folder="."):
    rig, arm, path = puma560.rig(), puma560.arm(), puma560.reference()
    load = Body(mass=2.5, com=(0.0, -0.4, 0.0))
    law = ComputedTorque(arm, rig, bandwidth=150)
    estimator = PayloadEstimator(law, mass=(0, 6), position=load.com)
    errors, masses, controller = work(arm, rig, path, estimator, load, cycles=10)
    print("links 2 and 3, ten cycles:")
    told(controller)
    late = max(event.swapped - event.time for event in controller.events[1:])
    print(
        f"  {np.mean(np.abs(errors).max(axis=1) <= 1):.2%} of the samples within 1 pulse, largest"
        f" {np.abs(errors).max():.0f}; each load in the model {late * 1e3:.0f} ms after its"
        " detection"
    )
    taken = [event.after for event in controller.events if event.kind == "taken"]
    assert len(taken) == 10
    assert np.abs(np.array(taken) - 2.5).max() < 0.05
    figure = drawn(rig, errors, masses, controller, 2 * CYCLE,
                   lambda t: 2.5 * ((t % CYCLE >= TAKES) & (t % CYCLE < DROPS)))  # fmt: skip
    figure.savefig(Path(folder) / "payload.png", dpi=120)

    robot = read_robot("puma560")
    arm, rig = robot.arm, robot.rig
    waves = np.array([0.5, 0.4, 0.5, 0.6, 0.5, 0.8])[:, None] * [[0.7, 0.3]]
    path = Harmonics(period=4.0, offset=(0, -0.4, 2.4, 0, 0.3, 0), cosine=-waves, sine=0.4 * waves)
    load = Body(mass=2.5, com=(0.0, 0.0, 0.2))
    law = ComputedTorque(arm, rig, bandwidth=100)
    estimator = PayloadEstimator(law, mass=(0, 6), position=load.com)
    errors, masses, controller = work(arm, rig, path, estimator, load, cycles=2)
    print("the whole PUMA 560, two cycles:")
    told(controller)
    print(f"  largest error {np.abs(errors).max(axis=0)} pulses")
    taken = [event.after for event in controller.events if event.kind == "taken"]
    assert len(taken) == 2
    assert np.abs(np.array(taken) - 2.5).max() < 0.1


if __name__ == "__main__":
    main(*sys.argv[1:])

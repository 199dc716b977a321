"""A controller made of a torque fit holds an arm whose friction is of each kind, as the truth does."""

import dataclasses

import numpy as np
import pytest

from ctc import ComputedTorque
from identification import fit_torque
from plant import FrictionCurve, Harmonics, puma560, simulate

ARM = puma560.literature_arm(1.5)
PLAIN = puma560.rig()
PATH = Harmonics(
    period=4.0, offset=(-0.8, 0.8), cosine=((-0.4, 0.2, 0.1), (0.3, -0.3, 0.1)),
    sine=((0.3, -0.2, 0.1), (0.2, 0.3, -0.2)),
)  # fmt: skip
OTHER = dataclasses.replace(puma560.reference(), period=2.8)
NAMES = (
    *ARM.dynamics.names,
    *(f"drive.{kind}[{i}]" for kind in ("viscous", "coulomb") for i in (0, 1)),
)
FRICTION = {
    "saturating viscous": {
        "viscous": (4e-3, 6e-3),
        "curve": FrictionCurve(offset=(0, 0), saturation=(15.0, 15.0)),
    },
    "load-dependent": {"load_friction": (0.25, 0.25)},
    "Stribeck": {"curve": FrictionCurve(offset=(0, 0), breakaway=(0.2, 0.2), speed=(40.0, 20.0))},
}


def rig_with(**drive):
    return dataclasses.replace(PLAIN, drive=dataclasses.replace(PLAIN.drive, **drive))


def error(law, rig):
    """RMS of the tracking error on another motion [pulses]."""
    run = simulate(ARM, rig, law, OTHER, duration=2.0, steps_per_sample=8)
    return float(np.sqrt(np.mean(run.error_pulses[200:] ** 2.0)))


@pytest.mark.parametrize("kind", FRICTION)
def test_the_kind_is_named_and_its_controller_is_as_good_as_the_truth(kind):
    rig = rig_with(**FRICTION[kind])
    options = {"bandwidth": 60.0, "learn_friction": False}
    # The torque of a controller that follows well, without chatter, which would load the gears.
    log = simulate(ARM, rig, ComputedTorque(ARM, rig, **options), PATH, steps_per_sample=8)
    noise = np.random.default_rng(0).normal(size=log.torque.shape)
    log = dataclasses.replace(log, torque=log.torque + 0.3 * noise, rig=PLAIN)
    before = fit_torque(ARM.dynamics, log, unknown=NAMES)
    assert before.friction[0].kind == kind
    assert before.friction[0].clear
    stated = dataclasses.replace(PLAIN, drive=before.friction[0].drive(PLAIN.drive))
    after = fit_torque(ARM.dynamics, dataclasses.replace(log, rig=stated), unknown=NAMES)
    errors = [fit.error_on(log, least_speed=0.2).total for fit in (before, after)]
    assert errors[1] < errors[0]
    errors = [
        error(ComputedTorque(arm, machine, **options), rig)
        for arm, machine in ((ARM, rig), (after.arm, after.rig), (ARM, PLAIN))
    ]
    truth, informed, plain = errors
    assert informed < truth + 0.3
    assert informed <= plain

"""Arms that are not the paper's, through all three packages."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from packaged_arms import planar, puma560, puma560_rig

from ctc import ComputedTorque, evaluate
from identification import identify
from plant import Drive, Dynamics, Encoder, Harmonics, P, Rig, simulate


def test_the_page_on_your_own_arm_is_true():
    """Its code runs as it stands, from the rows of the table to the verdict."""
    page = (Path(__file__).parent.parent / "docs" / "tutorials" / "own_arm.md").read_text(
        encoding="utf-8"
    )
    names = {}
    # our own page
    exec("\n".join(re.findall(r"```{code-cell}\n(.*?)```", page, re.DOTALL)), names)  # noqa: S102
    said = re.search(r"dynamics\.names\n# (\(.*?\))\n", page)[1]
    assert repr(names["dynamics"].names) == said
    assert np.abs(names["measured"].error_pulses).max() <= 12


def rig_of(n):
    drive = Drive(
        gear=(80.0, -60.0, 50.0)[:n],
        motor_inertia=(2e-4,) * n,
        viscous=(1e-3,) * n,
        coulomb=(0.1, 0.1, 0.05)[:n],
        motor_gain=(0.2,) * n,
        current_limit=(20.0,) * n,
    )
    return Rig(drive=drive, encoder=Encoder(resolution=(1000,) * n), period=0.7e-3)


def path_of(n):
    cosine = ((-0.5, -0.1, 0.2), (0.4, -0.5, 0.1), (0.3, 0.4, -0.6))[:n]
    sine = ((0.3, 0.2, -0.3), (-0.4, 0.3, 0.2), (0.5, -0.2, 0.3))[:n]
    return Harmonics(period=3.0, offset=(0.3, -0.2, 0.1)[:n], cosine=cosine, sine=sine)


@pytest.mark.parametrize(
    ("n", "seed"),
    [(2, 1), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((1, 0), (3, 2), (3, 3)))],
)
def test_planar_arm_of_random_truth_is_identified_and_tracked_within_one_pulse(n, seed):
    random, rig = np.random.default_rng(seed), rig_of(n)
    chain = planar(n)
    bodies = [
        dataclasses.replace(body, mass=body.mass * random.uniform(0.6, 1.4), rotor=float(rotor))
        for body, rotor in zip(chain.bodies, rig.drive.reflected_inertia(), strict=True)
    ]
    dynamics = Dynamics.from_chain(chain)
    truth = dynamics.arm(dynamics.f(bodies))
    guess = dynamics.f(
        [dataclasses.replace(b, rotor=t.rotor) for b, t in zip(chain.bodies, bodies, strict=True)]
    )
    width = np.maximum(0.5 * np.abs(guess), 0.1)
    measured = simulate(truth, rig, P(gain=(0.1, 0.08, 0.05)[:n]), path_of(n), steps_per_sample=16)
    found = identify(
        dynamics, measured, ranges=np.column_stack([guess - width, guess + width]), progress=False
    )
    # Objective (4) is no measure here: two runs of the true arm differ by as much as the start does.
    assert (np.abs(found.f - truth.f) < 3 * found.fit.std).all()
    report = evaluate(truth, rig, ComputedTorque(found.arm, found.rig), path_of(n), backend="numba")
    assert report.within(1), report


def test_whole_puma_560_runs_under_p_and_under_computed_torque():
    """Six joints, the literature's parameters and friction: within one pulse with f known to 5
    %.
    """
    dynamics, rig = Dynamics.from_chain(puma560()), puma560_rig()
    truth = dynamics.arm(dynamics.f())
    path = Harmonics(
        period=4.0, offset=(0.0,) * 6,
        cosine=((0.5, 0.2), (-0.4, 0.2), (0.3, -0.3), (0.5, 0.1), (-0.4, 0.3), (0.2, 0.5)),
        sine=((0.3, 0.1), (0.2, -0.1), (-0.3, 0.2), (0.4, 0.2), (0.3, 0.3), (0.6, -0.2)),
    )  # fmt: skip
    p = P(gain=(0.11, 0.07, 0.04, 0.004, 0.004, 0.004))
    measured = simulate(truth, rig, p, path, duration=1.0)
    assert 5 < np.abs(measured.error_pulses).max() < 20
    model = dynamics.arm(truth.f * (1 + 0.05 * np.random.default_rng(0).uniform(-1, 1, dynamics.p)))
    report = evaluate(
        truth,
        rig,
        ComputedTorque(model, rig),
        path,
        backend="numba",
        duration=1.0,
        steps_per_sample=4,
    )
    assert report.within(1), report

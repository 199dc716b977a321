"""Gains in another unit are named with the unit, with a logged torque and without one."""

import dataclasses

import numpy as np
import pytest
from random_rigs import drawn

from plant import Cascade, puma560, simulate

# Seed 0: a joint under a sampled PD; 1: two under a cascade; 3: a slide under fast P.
WRONG = [
    (0, {"gain": 1e3}, False, "N m and mN m"),
    pytest.param(0, {"derivative": 1e3}, False, "seconds and milliseconds", marks=pytest.mark.slow),
    (0, {"derivative": 1e-3}, True, "seconds and milliseconds"),
    pytest.param(
        0, {"gain": 0.01, "derivative": 0.01}, True, "1 and per cent", marks=pytest.mark.slow
    ),
    (1, {"position": 1 / 60}, False, "seconds and minutes"),
    pytest.param(1, {"integral": 1e3}, True, "seconds and milliseconds", marks=pytest.mark.slow),
    pytest.param(
        1,
        {"speed": np.pi / 180, "integral": np.pi / 180},
        False,
        "radians and degrees",
        marks=pytest.mark.slow,
    ),
    (3, {"gain": 180 / np.pi}, False, "radians and degrees"),
    (3, {"gain": 1e-3}, True, "N m and mN m"),
]


@pytest.mark.parametrize(("seed", "factors", "torque", "units"), WRONG)
def test_a_gain_in_another_unit_is_named(seed, factors, torque, units):
    record = drawn(seed, torque=torque).record
    wrong = {name: factor * getattr(record.law, name) for name, factor in factors.items()}
    law = dataclasses.replace(record.law, **wrong)
    checkup = dataclasses.replace(record, law=law).check()
    cause = checkup.causes[0]
    name, factor = (*factors, "gains")[0 if len(factors) == 1 else -1], min(factors.values())
    assert cause.name == f"unit of {name}"
    assert cause.size == pytest.approx(factor)
    assert units in cause.sentence
    # The corrected law is the right one.
    for gain in factors:
        corrected = getattr(checkup.first_corrected.law, gain)
        np.testing.assert_allclose(corrected, getattr(record.law, gain), rtol=1e-6)


@pytest.mark.slow
def test_one_joint_of_two_is_named():
    record = drawn(1, torque=True).record
    law = dataclasses.replace(record.law, speed=record.law.speed * (1.0, 100.0))
    cause = dataclasses.replace(record, law=law).check().causes[0]
    assert (cause.name, cause.joints) == ("unit of speed", (1,))


@pytest.mark.parametrize("torque", [False, True])
@pytest.mark.parametrize(
    "seed", [0, 3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 4, 6))]
)
def test_right_gains_are_not_accused(seed, torque):
    assert not drawn(seed, torque=torque).record.check().causes


def test_an_integral_that_began_before_the_log_accuses_no_gain():
    """Its unknown value would take the law's torque beyond the amplifiers' limits."""
    law = Cascade(
        position=(20, 20), speed=(0.004, 0.003), integral=(0.06, 0.05), filter=600, period=7e-4
    )
    arm, rig, path = puma560.literature_arm(1.5), puma560.rig(), puma560.reference()
    record = simulate(arm, rig, law, path, duration=3.0).cut(2.5, 2.88)
    assert not dataclasses.replace(record, torque=None, current=None).check().causes


@pytest.mark.parametrize("torque", [False, True])
def test_a_gain_that_is_wrong_by_no_unit_s_factor_is_in_no_other_unit(torque):
    record = drawn(0, torque=torque).record
    law = dataclasses.replace(record.law, gain=5 * record.law.gain)
    causes = dataclasses.replace(record, law=law).check().causes
    assert not any(cause.name.startswith("unit of") for cause in causes)

"""Gains of a law with memory, and a limit of its torque: the counts alone tell them."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from identification import identify
from identification.results import cut_off
from plant import PID, Harmonics, Record, puma560, simulate
from plant.laws import AlongLog

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()
PATH = Harmonics(
    period=2.5,
    offset=(0.1, -0.1),
    cosine=((0.3, 0.1), (0.1, 0.2)),
    sine=((0.1, -0.1), (-0.3, 0.1)),
)
LAW = PID(
    gain=(0.04, 0.03),
    derivative=(1.6e-4, 1.2e-4),
    integral=(0.2, 0.15),
    filter=2000.0,
    period=7e-4,
)


@pytest.fixture(scope="module")
def record() -> Record:
    return simulate(ARM, RIG, LAW, PATH, duration=2.0)


def causes(record, **numbers):
    """What is named of a log of counts alone, whose law has these numbers."""
    stated = dataclasses.replace(record.law, **numbers)
    logged = dataclasses.replace(record, torque=None, current=None, law=stated)
    return identify(ARM.dynamics, logged, progress=False).diagnostics.detection.named


def test_the_stated_gains_are_not_accused(record):
    assert causes(record) == ()


def test_gains_that_are_too_low_are_named_with_their_size(record):
    sign, *_ = causes(record, gain=0.75 * np.array(LAW.gain))
    assert sign.name == "law gain"
    np.testing.assert_allclose([*sign.values.values()], 1 / 3, atol=0.12)
    assert [*sign.values] == ["controller.gain[0]", "controller.gain[1]"]


@pytest.mark.parametrize("share", [0.75, 1.4])
def test_another_derivative_is_named_with_its_size(record, share):
    sign, *_ = causes(record, derivative=share * np.array(LAW.derivative))
    assert sign.name == "law gain"
    assert {name.partition("[")[0] for name in sign.values} == {"controller.derivative"}
    np.testing.assert_allclose([*sign.values.values()], 1 / share - 1, atol=0.15)


def test_another_integral_is_no_backlash(record):
    """Innovations are largest where loads change sign, but the other causes explain them."""
    assert "reversals" not in {sign.name for sign in causes(record, integral=(0.15, 0.1125))}


def test_a_derivative_that_is_not_stated_is_a_lead(record):
    sign, *_ = causes(record, derivative=(0.0, 0.0))
    assert sign.name == "lead"
    np.testing.assert_allclose([*sign.values.values()], 4e-3, atol=1.2e-3)


def test_torques_that_are_cut_off_are_named():
    limits = np.array((3.6, 2.7))
    weak = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, current_limit=limits))
    cut = simulate(ARM, weak, LAW, PATH, duration=2.0)
    logged = dataclasses.replace(cut, torque=None, current=None, rig=RIG)
    cause, *_ = identify(ARM.dynamics, logged, progress=False).causes
    assert cause.name == "limit"


def test_the_effect_of_a_limit_is_what_it_takes_from_the_law(record):
    """Along the log, of a limit at three quarters of the largest torque, joint by joint."""
    counts_alone = dataclasses.replace(
        record, torque=None, current=None, law=AlongLog(law=LAW, state=LAW.initial_state(2))
    )
    model = SimpleNamespace(records=[counts_alone], dynamics=ARM.dynamics)
    torques = cut_off(SimpleNamespace(model=model))
    largest = np.abs(record.torque).max(axis=0)
    for i in range(2):
        (change,) = torques[f"limit.0.75[{i}]"]
        limited = np.clip(record.torque[:, i], -0.75 * largest[i], 0.75 * largest[i])
        # The first torques depend on the speed at which the log begins.
        np.testing.assert_allclose(
            change[100:, i], (limited - record.torque[:, i])[100:], atol=0.02 * largest[i]
        )
        assert not change[:, 1 - i].any()

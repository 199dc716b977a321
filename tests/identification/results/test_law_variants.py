"""Which variant of a law made a log: the logged torque tells, or the counts alone."""

import dataclasses

import numpy as np
import pytest
from driven_arm import CHAIN, DYNAMICS, LAW, PATH, RIG
from random_rigs import log_of

from identification import identify
from identification.equation_error import likelier_variant, torque_apart
from plant import Record

# An integral that makes 5 % of the proportional part in a sample.
FAST = dataclasses.replace(LAW, integral=50 * LAW.speed)


@pytest.fixture(scope="module")
def record():
    """Three seconds by another engine, whose cascade integrates this sample, too."""
    return log_of(CHAIN, RIG, None, FAST, PATH, 3.0)


def test_the_right_law_has_no_likelier_variant(record: Record):
    apart = torque_apart(record)
    assert apart.max() < 1e-3
    assert likelier_variant(record, apart) is None


@pytest.mark.parametrize("begin", [0.0, 0.7])
def test_the_variant_that_made_the_log_is_named(record: Record, begin):
    """Stated is a law that integrates the samples before."""
    wrong = dataclasses.replace(FAST, integration="forward")
    stated = dataclasses.replace(record.cut(begin) if begin else record, law=wrong)
    apart = torque_apart(stated)
    named = likelier_variant(stated, apart)
    assert named is not None, apart
    assert named[0] == "integration='backward'"
    assert named[1].max() < 0.25 * apart.max()


def test_noise_of_the_current_makes_no_other_variant(record: Record):
    noise = 0.02 * np.random.default_rng(3).normal(size=record.torque.shape)
    noisy = dataclasses.replace(
        record, torque=record.torque + RIG.drive.joint_torque(RIG.drive.motor_gain * noise)
    )
    assert likelier_variant(noisy, torque_apart(noisy)) is None


@pytest.mark.parametrize(
    ("stated", "begin"),
    [("forward", 0.7), pytest.param("tustin", 0.0, marks=pytest.mark.slow)],
)
def test_counts_alone_name_the_variant_that_made_the_log(record: Record, stated, begin):
    """The model followed the counts to 1.5 pulses, and 0.5 ms of lag explained that best."""
    wrong = dataclasses.replace(FAST, integration=stated)
    logged = dataclasses.replace(record.cut(begin) if begin else record, torque=None, law=wrong)
    (sign, *_) = identify(DYNAMICS, logged, progress=False).diagnostics.detection.named
    assert sign.name == "variant"
    assert [*sign.values] == ["variant.integration='backward'"]
    assert sign.values["variant.integration='backward'"] == pytest.approx(1.0, abs=0.05)


def test_counts_of_the_right_law_name_no_variant(record: Record):
    logged = dataclasses.replace(record, torque=None)
    detection = identify(DYNAMICS, logged, progress=False).diagnostics.detection
    assert detection.named == ()

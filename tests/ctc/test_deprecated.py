"""Old orders of arguments and old names work for one release, give what the new ones give, and say what to write."""

import inspect

import numpy as np
import pytest

from ctc import ComputedTorque, certify, compare, error_loop, margins
from plant import puma560

ARM, RIG, PATH = puma560.arm(), puma560.rig(), puma560.reference()
LAW = ComputedTorque(puma560.dynamics().arm(1.02 * ARM.f), RIG)
DRAWN = {
    "covariance": np.diag((0.02 * puma560.PUBLISHED) ** 2), "samples": 40, "duration": 0.05, "steps_per_sample": 4,
}  # fmt: skip
Z = np.exp(1j * np.geomspace(0.01, 1, 5))


def certified(certificate):
    return certificate.runs.peak, certificate.runs.unrounded, certificate.runs.current, certificate.plants.values


def compared(comparison):
    return [each.record.error_pulses for each in comparison.evaluations.values()]


def reached(found):
    return found.gain_up, found.phase, found.delay, found.response


def loop(system):
    return system(Z)


LAWS = {"P": puma560.p_law(), "computed torque": LAW}
SHORT = {"duration": 0.05, "steps_per_sample": 4}
OLD = {
    "certify": (
        certified, lambda: certify(LAW, ARM, RIG, PATH, **DRAWN), lambda: certify(ARM, RIG, LAW, PATH, **DRAWN),
        r"certify\(law, found, rig, reference\) .* Use certify\(found, rig, law, reference\)\.",
    ),
    "certify, in part by keyword": (
        certified, lambda: certify(LAW, ARM, rig=RIG, reference=PATH, **DRAWN),
        lambda: certify(found=ARM, law=LAW, rig=RIG, reference=PATH, **DRAWN), r"Use certify\(found, rig, law",
    ),
    "compare": (
        compared, lambda: compare(LAWS, ARM, RIG, PATH, **SHORT), lambda: compare(ARM, RIG, LAWS, PATH, **SHORT),
        r"compare\(laws, arm, rig, reference\) .* Use compare\(arm, rig, laws, reference\)\.",
    ),
    "margins": (
        reached, lambda: margins(LAW, RIG), lambda: margins(LAW.arm, RIG, LAW),
        r"margins\(law, rig\) .* Use margins\(arm, rig, law\)\.",
    ),
    "margins of an arm": (
        reached, lambda: margins(LAW, RIG, arm=ARM, pose=(0.3, -0.4)), lambda: margins(ARM, RIG, LAW, pose=(0.3, -0.4)),
        r"Use margins\(arm, rig, law\)\.",
    ),
    "margins by keyword": (
        reached, lambda: margins(law=LAW, rig=RIG), lambda: margins(arm=None, law=LAW, rig=RIG), r"Use margins\(arm",
    ),
    "error_loop": (
        loop, lambda: error_loop(LAW, RIG, joint=1), lambda: error_loop(None, RIG, LAW, joint=1),
        r"error_loop\(law, rig\) .* Use error_loop\(arm, rig, law\)\.",
    ),
    "error_loop of an arm": (
        loop, lambda: error_loop(LAW, RIG, arm=ARM), lambda: error_loop(ARM, RIG, LAW), r"Use error_loop\(arm, rig",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("numbers", "old", "new", "said"), OLD.values(), ids=OLD)
def test_both_orders_give_the_same(numbers, old, new, said):
    with pytest.warns(DeprecationWarning, match=said) as warned:
        before = numbers(old())
    assert [each.filename for each in warned] == [__file__]
    for was, is_now in zip(before, numbers(new()), strict=True):  # which does not warn
        np.testing.assert_array_equal(was, is_now)


@pytest.mark.parametrize(
    ("function", "names"),
    [
        (certify, ["found", "rig", "law", "reference"]),
        (compare, ["arm", "rig", "laws", "reference"]),
        (margins, ["arm", "rig", "law"]),
        (error_loop, ["arm", "rig", "law"]),
    ],
)
def test_what_an_editor_shows_is_the_new_order(function, names):
    parameters = inspect.signature(function).parameters.values()
    assert [each.name for each in parameters if each.kind is each.POSITIONAL_OR_KEYWORD] == names
    with pytest.raises(ValueError, match="Did you mean"):
        function(ARM, RIG, LAW, **{[each.name for each in parameters][-1] + "s": 1})


def test_more_arguments_than_there_ever_were_are_refused():
    with pytest.raises(ValueError, match=r"margins takes .* this call does not fit"):
        margins(LAW, RIG, ARM, (0, 0))


def test_old_names_of_a_certificate():
    certificate = certify(ARM, RIG, LAW, PATH, **DRAWN)
    with pytest.warns(DeprecationWarning, match=r"Certificate\.hurts .* Use Certificate\.sensitivities\."):
        assert certificate.hurts == certificate.sensitivities
    with pytest.warns(DeprecationWarning, match=r"Certificate\.margins .* Use Certificate\.reserves\."):
        old = certificate.margins(samples=5)
    assert old.tried == certificate.reserves(samples=5).tried

"""A stated law against the torque that was logged: right ones give it, others do not, and it is said."""

import dataclasses

import numpy as np
import pytest
from logged_laws import LAWS

from identification import identify
from identification.equation_error.stated_law import torque_apart
from plant import LoggedTorque, puma560, simulate

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()


def cut(law):
    record = simulate(ARM, RIG, law, puma560.reference(), duration=1.6)
    return dataclasses.replace(record.cut(0.437), true_q=None, true_qd=None, link_counts=None)


@pytest.mark.parametrize("name", ["P", "PID", "cascade", "computed torque", "sliding mode"])
def test_the_law_that_made_a_cut_log_gives_its_torque(name):
    """An observer that learns friction forgets more slowly what was before the cut."""
    record = cut(LAWS[name])
    assert torque_apart(record).max() < (2e-3 if name == "computed torque" else 1e-4)
    others = [other for other in ("P", "PID", "cascade") if other != name]
    for other in others:
        assert torque_apart(dataclasses.replace(record, law=LAWS[other])).min() > 0.3


def test_another_gain_shows_by_its_share_of_the_torque():
    record = cut(LAWS["P"])
    other = dataclasses.replace(record, law=puma560.p_law(1.1 * np.asarray(LAWS["P"].gain)))
    assert torque_apart(other) == pytest.approx((0.1, 0.1), rel=1e-9)


def test_where_it_cannot_be_told():
    fast, sampled = cut(LAWS["PD, fast"]), cut(LAWS["computed torque"])
    assert torque_apart(fast) is None
    assert torque_apart(dataclasses.replace(sampled, torque=None, current=None)) is None
    assert torque_apart(dataclasses.replace(sampled, law=LoggedTorque())) is None
    assert torque_apart(dataclasses.replace(sampled, reference=None)) is None  # its rounding hides the torque


def test_an_identification_says_so():
    record = cut(LAWS["P"])
    right = identify(ARM.dynamics, record, progress=False)
    assert not any("cannot have made" in text for text in right.warnings)
    wrong = dataclasses.replace(record, law=puma560.p_law(1.5 * np.asarray(LAWS["P"].gain)))
    found = identify(ARM.dynamics, wrong, progress=False)
    (said,) = [text for text in found.warnings if "cannot have made" in text]
    assert said.startswith(
        "the stated P cannot have made the log: along it, it gives another torque than was logged, by"
    )
    assert said.count("50%") == 2

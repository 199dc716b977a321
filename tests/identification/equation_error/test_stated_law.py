"""A stated law against the torque that was logged: right ones give it, others do not, and it is
said.
"""

import dataclasses
from functools import cache

import numpy as np
import pytest
from logged_laws import LAWS

from identification import identify
from identification.equation_error import torque_apart
from plant import FrictionCurve, LoggedTorque, puma560, simulate
from plant.checkup import bridged

ARM, RIG = puma560.literature_arm(1.5), puma560.rig()


@cache
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


def test_a_law_that_began_with_its_log_is_not_accused_of_another_torque():
    """From a state later in the log its observer learns other friction, also of right logs."""
    curve = FrictionCurve(offset=(0.3 * RIG.drive.coulomb).round(3))
    truth = dataclasses.replace(RIG, drive=dataclasses.replace(RIG.drive, curve=curve))
    record = simulate(ARM, truth, LAWS["computed torque"], puma560.reference(), duration=1.6)
    assert torque_apart(dataclasses.replace(record, rig=RIG)).max() < 1e-9


def test_another_gain_shows_by_its_share_of_the_torque():
    record = cut(LAWS["P"])
    other = dataclasses.replace(record, law=puma560.p_law(1.1 * np.asarray(LAWS["P"].gain)))
    assert torque_apart(other) == pytest.approx((0.1, 0.1), rel=1e-9)


def test_where_it_cannot_be_told():
    fast, sampled = cut(LAWS["PD, fast"]), cut(LAWS["computed torque"])
    assert torque_apart(fast) is None
    assert torque_apart(dataclasses.replace(sampled, torque=None, current=None)) is None
    assert torque_apart(dataclasses.replace(sampled, law=LoggedTorque())) is None
    # its rounding hides the torque
    assert torque_apart(dataclasses.replace(sampled, reference=None)) is None


def test_counts_beside_a_reference_with_fractions_are_those_of_the_controller():
    """The difference of reference and error may lose its last digits, which moves no count."""
    record = cut(LAWS["cascade"])
    reference = record.rig.position_in_pulses(record.reference(record.t - record.t[0]).q)
    errors = reference - record.counts
    for digits, compared in ((1e-11, True), (0.1, False)):
        logged = dataclasses.replace(
            record, reference_pulses=reference, error_pulses=errors + digits
        )
        assert (logged.counts != record.counts).any()
        assert (torque_apart(logged) is not None) is compared


@pytest.mark.slow
def test_an_identification_says_so():
    record = cut(LAWS["P"])
    right = identify(ARM.dynamics, record, progress=False)
    assert not any("cannot have made" in text for text in right.warnings)
    wrong = dataclasses.replace(record, law=puma560.p_law(1.5 * np.asarray(LAWS["P"].gain)))
    found = identify(ARM.dynamics, wrong, progress=False)
    (said,) = [text for text in found.warnings if "cannot have made" in text]
    assert said.startswith(
        "the stated P cannot have made the log: along it, it gives another torque than was"
        " logged, by"
    )
    assert said.count("50%") == 2


def lost(record, share=0.01):
    """The record with rows that repeat those before."""
    row = np.arange(len(record))
    for k in np.flatnonzero(np.random.default_rng(1).random(len(row)) < share)[1:]:
        row[k] = row[k - 1]
    names = ("error_pulses", "reference_pulses", "torque", "current")
    return dataclasses.replace(record, **{name: getattr(record, name)[row] for name in names})


def test_lost_rows_are_no_other_law():
    """A law that derives sees counts on straight lines for a while; elsewhere it gives the
    logged torque.
    """
    record = cut(LAWS["PID"])
    assert torque_apart(bridged(lost(record))).max() < 0.01
    every = np.arange(len(record)) % 20 > 0  # nowhere are filters free of bridged counts
    assert torque_apart(dataclasses.replace(record, valid=every.astype(float))) is None


@pytest.mark.slow
def test_identification_names_late_counts_and_lost_rows_first():
    record, labels = cut(LAWS["PID"]), ARM.dynamics.chain.joint_labels
    late = np.array(record.counts)
    late[1:, 1] = record.counts[:-1, 1]
    moved = dataclasses.replace(record, error_pulses=record.reference_pulses - late)
    first, *more = identify(ARM.dynamics, moved, progress=False).warnings
    assert first.startswith(
        f"the counts of the log are late by samples: +1 of {labels[1]}; in time the stated PID"
    )
    assert not any("current_lag" in text or "cannot have made" in text for text in more)
    # its torque changes from row to row
    quick = dataclasses.replace(LAWS["PID"], derivative=(2e-3, 1.5e-3))
    first, *more = identify(ARM.dynamics, lost(cut(quick), 0.05), progress=False).warnings
    assert "rows of the log are lost" in first
    assert not any("cannot have made" in text for text in more)

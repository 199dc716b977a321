"""A log with two mistakes: the second one shows once the first one is corrected."""

import dataclasses

import numpy as np
import pytest

from identification import Identification, RecordError, identify
from identification.search import METHODS
from plant import Chain, Dynamics, Link, P, Record, puma560, simulate
from plant.checkup import Cause, Check, Checkup, counts_in_time

CHAIN = Chain(links=(Link(name="2", alpha=-np.pi / 2), Link(name="3", a=puma560.LINK_LENGTH)))
DYNAMICS = Dynamics.from_chain(CHAIN)


def log(law):
    """A log without what only a simulation knows; joint 3 turns the other way in it."""
    made = simulate(puma560.literature_arm(1.5), puma560.rig(), law, puma560.reference())
    sign = np.array((1.0, -1.0))
    columns = {
        name: sign * getattr(made, name) for name in ("error_pulses", "reference_pulses", "torque")
    }
    bare = dict.fromkeys(("reference", "true_q", "true_qd", "current"))
    return dataclasses.replace(made, **bare, **columns)


def test_a_second_mistake_is_named_and_a_file_keeps_it(tmp_path):
    law = puma560.p_law()
    right = dataclasses.replace(log(law), torque=None)
    wrong = dataclasses.replace(right, law=P(gain=1.5 * law.gain))
    with pytest.warns(match="turns the other way"):
        found = identify(DYNAMICS, wrong, method="prediction_error", progress=False)
    assert [cause.name for cause in found.causes[:2]] == ["joint sign", "gain"]
    # It was tested in the corrected log, so it is no effect of the first mistake.
    assert not found.causes[1].behind
    assert any("gains of law or motor" in line for line in found.left)
    # A page lists notes apart from warnings, so that no line may point at its neighbours.
    (effects,) = [line for line in found.warnings if "be their effects" in line]
    assert not {"above", "below"} & set(effects.split())
    found.save(tmp_path / "found.json")
    assert Identification.load(tmp_path / "found.json") == found


@pytest.mark.slow
def test_a_single_mistake_leaves_nothing_beside_it():
    right = dataclasses.replace(log(puma560.p_law()), torque=None)
    with pytest.warns(match="turns the other way"):
        found = identify(DYNAMICS, right, method="prediction_error", progress=False)
    assert (found.beside, found.left) == ((), ())


def test_a_refusal_says_both():
    late = counts_in_time(log(P(gain=(0.2, 0.15))), (), -1.8)
    with pytest.raises(
        RecordError, match=r"samples late .* joint 3 .* turns the other way"
    ) as said:
        identify(DYNAMICS, late, progress=False)
    np.testing.assert_array_equal(said.value.record.counts, late.counts)


def test_a_wrong_log_is_named_before_the_search_and_checked_once(monkeypatch, capsys):
    arm, rig = puma560.arm(), puma560.rig()
    right = simulate(arm, rig, puma560.p_law(), puma560.reference(), duration=0.3)
    turned = dataclasses.replace(right, torque=right.torque * [1, -1], current=None)
    cause = Cause(
        name="turned torque",
        joints=(1,),
        size=1.0,
        unit="",
        log_odds=99.0,
        sentence="The torque of q[1] has the wrong sign",
        remedy="Change its sign.",
        check="drive sign",
    )
    checked, said = [], []

    def check(record):
        checked.append(record)
        finding = Check(cause.check, 1).wrong(None, cause.line)
        if record == right:
            return Checkup(findings=(), records=(record,))
        return Checkup(
            findings=(finding,),
            joint_labels=("q[0]", "q[1]"),
            causes=(cause,),
            records=(record, right),
        )

    def search(problem, search=METHODS["equation_error"]):
        said.append(capsys.readouterr().err.count(cause.line))
        return search(problem)

    monkeypatch.setattr(Record, "check", check)
    monkeypatch.setitem(METHODS, "equation_error", search)
    found = identify(arm.dynamics, turned, method="equation_error")
    assert said == [1]
    assert found.warnings.count(cause.line) == 1
    assert checked.count(turned) == 1

"""A user's own hypotheses in `identify`, as docs/guides/own_hypothesis.md says."""

from dataclasses import replace

import numpy as np
import pytest

from identification import Identification, identify, procedure
from identification.equation_error import ranked_own_rows
from plant import Hypothesis, puma560, simulate
from plant.checkup import each_joint

RIG = puma560.rig()
SPRING = 200.0  # [N m/rad]


def with_spring(record, joints, stiffness):
    """The log with the torque of a spring at the shoulder."""
    pull = np.zeros_like(record.torque)
    pull[:, 0] = stiffness * record.rig.to_angle(record.counts)[:, 0]
    return replace(record, torque=record.torque + pull, current=None)


def refuse(record, joints, size):
    raise ValueError("this log has no such column.")


WORDS = {"sentence": "Something is wrong", "remedy": "Look."}
OWN = (
    Hypothesis(
        name="spring",
        sentence="A spring of {value:.0f} N m/rad pulls at the shoulder",
        remedy="Add its torque to the column.",
        undo=with_spring,
        sizes=(100.0, SPRING, 400.0),
        against=8.0,
    ),
    Hypothesis(name="nothing", undo=lambda record, joints, size: record, **WORDS),
    Hypothesis(name="refused", undo=refuse, scope=each_joint, **WORDS),
    Hypothesis(name="broken", undo=lambda record, joints, size: record.no_such_field, **WORDS),
)


@pytest.fixture(scope="module")
def record():
    return simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference())


def test_the_arm_names_what_no_log_shows_without_it(record):
    """Without the law only the equation of motion knows the torque; others are named, left out."""
    lawless = replace(with_spring(record, (), -SPRING), law=None, reference=None)
    causes, failed = ranked_own_rows(puma560.dynamics(), lawless, OWN)
    assert [(cause.name, cause.size) for cause in causes] == [("spring", SPRING)]
    assert [line.partition(":")[0] for line in failed] == ["nothing", "refused", "broken"]


def test_a_right_log_is_not_accused(record):
    assert ranked_own_rows(puma560.dynamics(), record, OWN[:1]).causes == ()


def test_identify_lists_own_causes_first_and_a_file_keeps_them(record, tmp_path):
    limit = RIG.drive.torque_limit()
    share = Hypothesis(
        name="share of the limit",
        sentence="The torque is a share of the limit",
        remedy="Multiply it.",
        undo=lambda record, joints, size: replace(record, torque=limit * record.torque),
    )
    logged = replace(record, torque=record.torque / limit, current=None)
    with pytest.warns(match="share of the limit"):
        found = identify(
            puma560.dynamics(),
            logged,
            method="equation_error",
            hypotheses=[share, *OWN[1:3]],
            progress=False,
        )
    assert found.causes[0].name == "share of the limit"
    assert [line.partition(":")[0] for line in found.failed] == ["nothing", "refused"]
    assert any(line in found.warnings for line in found.failed)
    assert not any(line in found.doubts for line in found.failed)
    found.save(tmp_path / "found.json")
    assert Identification.load(tmp_path / "found.json") == found


def test_a_refusal_begins_with_the_cause(record, monkeypatch):
    """A wrong statement explains any error."""

    def refused(*arguments):
        raise ValueError("no arm follows from the log.")

    monkeypatch.setattr(procedure, "_identified", refused)
    sprung = with_spring(record, (), -SPRING)
    with pytest.raises(ValueError, match=r"spring of 200 .* as it is, no arm follows"):
        identify(puma560.dynamics(), sprung, hypotheses=OWN[:1], progress=False)

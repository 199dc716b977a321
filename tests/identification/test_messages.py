"""Refusals of several records say which of them, and which column of its file."""

import dataclasses
import pickle
import re

import numpy as np
import pytest

from identification import Objective, RecordError, find_gears, find_load, fit_torque, identify
from identification.equation_error import each_named
from plant import (
    Chain,
    Dynamics,
    Link,
    LoggedTorque,
    PointToPoint,
    Record,
    puma560,
    read_robot,
    simulate,
)

RIG, DYNAMICS = puma560.rig(), puma560.dynamics()
COLUMNS = {"t": "time", "counts": ("c_shoulder", "c_elbow"), "torque": ("u_shoulder", "u_elbow")}


@pytest.fixture(scope="module")
def record():
    """A log of the paper's arm as if it had been read from a file."""
    made = simulate(puma560.arm(), RIG, puma560.p_law(), puma560.reference(), duration=0.5)
    return dataclasses.replace(made, name="run_00.csv", columns=COLUMNS)


def stuck(record):
    """A run in which the elbow stands still."""
    error = record.error_pulses.copy()
    error[:, 1] = record.reference_pulses[:, 1] - record.counts[0, 1]
    return dataclasses.replace(record, error_pulses=error, name="run_01.csv")


def test_a_run_in_which_the_elbow_sticks_is_named(record):
    """Its place, its file, the joint and the column; not where it is the only record, which has
    no other name.
    """
    said = (
        r"^records\[1\] \(run_01.csv\): every motor must move by at least 20 pulses; that of .*,"
        r" column 'c_elbow' "
    )
    with pytest.raises(ValueError, match=said + r"\(counts\), moves by 0\. "):
        identify(DYNAMICS, [record, stuck(record), record], progress=False)
    with pytest.raises(ValueError, match=r"^the record \(run_01.csv\): every motor must move"):
        identify(DYNAMICS, stuck(record), progress=False)
    nameless = dataclasses.replace(stuck(record), name="", columns=None)
    with pytest.raises(
        ValueError, match=r"^every motor must move by at least 20 pulses; that of .* moves by 0\. "
    ):
        identify(DYNAMICS, nameless, progress=False)


def test_a_record_without_a_law_is_named_also_among_those_that_are_held_out(record):
    lawless = dataclasses.replace(record, law=None, name="run_02.csv")
    for records, held_out, place in (
        ([record, lawless, record], None, r"records\[1\]"),
        ([record, record, lawless], None, r"records\[2\]"),
        ([record], [record, lawless], r"held_out\[1\]"),
        ([record, record], lawless, r"held_out\[0\]"),
    ):
        with pytest.raises(
            ValueError, match=rf"^{place} \(run_02.csv\): the record must name the law"
        ):
            identify(DYNAMICS, records, held_out=held_out, progress=False)


def test_a_record_of_another_arm_is_named(record):
    robot = read_robot("ur5e")
    other = simulate(robot.dynamics.arm(robot.dynamics.f()), robot.rig, robot.law, PointToPoint(
        start=np.zeros(6), goal=np.full(6, 0.1), duration=0.5), duration=0.5)  # fmt: skip
    with pytest.raises(
        ValueError, match=r"^records\[1\]: rig must have 2 joints like the arm; got 6"
    ):
        identify(DYNAMICS, [record, other], progress=False)


@pytest.mark.parametrize(
    "called",
    [
        pytest.param(lambda robot, record: identify(robot.dynamics, record), id="identify"),
        pytest.param(
            lambda robot, record: identify(robot.dynamics, record, elasticity=True), id="elasticity"
        ),
        pytest.param(lambda robot, record: fit_torque(robot.dynamics, record), id="fit_torque"),
        pytest.param(lambda robot, record: Objective(robot.dynamics, record), id="Objective"),
        pytest.param(lambda robot, record: find_load(robot.arm, record), id="find_load"),
        pytest.param(lambda robot, record: find_gears(robot.arm, record), id="find_gears"),
    ],
)
def test_a_single_record_of_another_arm_is_refused_by_its_rig(record, called):
    with pytest.raises(RecordError, match="rig must have 6 joints like the arm; got 2"):
        called(read_robot("ur5e"), record)


def test_a_turned_column_is_named_where_no_arm_explains_the_torque(record):
    """All torques of one run turned: the torque equation gives no arm, and the refusal begins
    with the first cause of the checkup, in its words and once.
    """
    turned = dataclasses.replace(
        record, torque=-record.torque, law=LoggedTorque(), reference=None, name="run_03.csv"
    )
    cause, *_ = turned.check().causes
    assert (cause.name, cause.joints) == ("turned torque of all joints", ())
    with pytest.raises(ValueError, match="Correct that first; as it is, ") as refusal:
        identify(DYNAMICS, turned, progress=False)
    assert str(refusal.value).startswith(f"the record (run_03.csv): {cause.line} ")
    assert str(refusal.value).count(cause.sentence) == 1
    assert "u_shoulder" in re.findall(r"\w+", str(refusal.value))


def test_only_the_innermost_record_is_named_and_the_refusal_can_be_sent(record):
    def refuse():
        raise ValueError("it must not.")

    (_, inner), (_, outer) = next(each_named([stuck(record)])), next(each_named([record, record]))
    with pytest.raises(RecordError) as refusal, outer, inner:
        refuse()
    assert str(refusal.value) == "the record (run_01.csv): it must not."
    # our own
    assert str(pickle.loads(pickle.dumps(refusal.value))) == str(refusal.value)  # noqa: S301


def test_names_and_columns_of_a_record_do_not_count_where_records_are_compared(record):
    plain = dataclasses.replace(record, name="", columns=None)
    assert plain == record
    assert hash(plain) == hash(record)
    assert record.resampled(2 * RIG.period).name == "run_00.csv"
    assert record.column("torque", 1) == "column 'u_elbow' (torque)"
    assert record.column("error", 0) == "column 'c_shoulder' (counts)"
    assert (record.column("reference", 0), plain.column("torque", 1)) == ("reference", "torque")
    block = dataclasses.replace(record, columns={"position": "q"})
    assert block.column("counts", 1) == "column 'q', place 1 (position)"
    for wrong, message in (
        ({"name": 3}, "name must be of type str"),
        ({"columns": "q"}, "columns must be of type dict"),
    ):
        with pytest.raises(ValueError, match=message):
            Record(t=[0, 1], error_pulses=np.zeros((2, 2)), rig=RIG, **wrong)


def test_short_names_of_f_are_names(record):
    """f1, f2, ... as results print them, where the model's own names are sums of inertias."""
    chain = Chain(links=(Link(name="shoulder", alpha=np.pi / 2), Link(name="elbow", a=0.4)))
    dynamics = Dynamics.from_chain(chain)
    assert dynamics.short_names != dynamics.names
    unknown = (*dynamics.short_names[::-1], "drive.viscous[1]")
    assert Objective(dynamics, record, unknown).unknown == (
        *dynamics.names[::-1],
        "drive.viscous[1]",
    )
    with pytest.raises(ValueError, match=r"each number once; .* comes twice"):
        Objective(dynamics, record, (dynamics.short_names[0], *dynamics.names))


@pytest.mark.parametrize("wrong", [0, False, ()])
def test_tolerances_that_count_as_false_are_refused(record, wrong):
    with pytest.raises(ValueError, match=r"tolerances must be of type Tolerances; got"):
        identify(DYNAMICS, record, tolerances=wrong, progress=False)

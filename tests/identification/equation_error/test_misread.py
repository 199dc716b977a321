"""Mistakes of a log that an identification, or a fit of torques, repeats from its checkup."""

import dataclasses
from functools import cache

import pytest

from identification import fit_torque
from identification.equation_error import checkup_of, misread, wrong_statements
from plant import Record, puma560, simulate
from plant.checkup import (
    TABLE,
    Cause,
    Check,
    Checkup,
    Experiment,
    Rival,
    SelectionSettings,
    Trials,
    ranking,
)

ARM, RIG = puma560.arm(), puma560.rig()


class Checked:
    """What `misread` takes of a record."""

    columns = None

    def __init__(self, checkup):
        self.check = lambda: checkup


@cache
def log():
    made = simulate(ARM, RIG, puma560.p_law(), puma560.reference(), duration=1.5)
    return dataclasses.replace(made, current=None, true_q=None, true_qd=None, reference=None)


def turned(record, *columns):
    """A record with the sign of these columns of joint q[1] turned."""
    changes = {name: getattr(record, name) * [1, -1] for name in columns}
    return dataclasses.replace(record, **changes)


def cause_of(name, check):
    return Cause(
        name=name,
        joints=(1,),
        size=1.0,
        unit="",
        log_odds=200.0,
        sentence=f"{name} it is",
        remedy="Mend it.",
        check=check,
    )


def checked(monkeypatch, cause, corrected):
    """Records whose checkup names a cause, but for the corrected one."""

    def check(record):
        if record == corrected:
            return Checkup(findings=(), records=(record,))
        finding = Check(cause.check, 1).wrong(1.0, cause.line)
        records = (record, corrected)
        labels = ("1", "2")
        return Checkup(findings=(finding,), joint_labels=labels, causes=(cause,), records=records)

    monkeypatch.setattr(Record, "check", check)


@pytest.mark.parametrize(("samples", "lines"), [(1.0, 1), (0.4, 0)])
def test_torques_late_by_whole_rows_are_a_mistake_of_the_export(samples, lines):
    """A drive may lag by a part of a row, and then its current_lag is identified."""
    late = Cause(
        name="late torques",
        joints=(),
        size=samples,
        unit="samples",
        log_odds=200.0,
        sentence=f"The torques of all joints are {samples} samples late",
        remedy="Shift them.",
        check="delay",
    )
    findings = tuple(Check("delay", i, "samples").look(samples, late.line) for i in range(2))
    checkup = Checkup(findings=findings, joint_labels=("1", "2"), causes=(late,))
    assert misread(Checked(checkup)) == (late.line,) * lines


def test_a_fit_of_torques_names_what_the_checkup_names(monkeypatch):
    """Currents look like a turned torque to the equation of motion alone."""
    currents = log().torque / (RIG.drive.gear * RIG.drive.motor_gain)
    wrong = dataclasses.replace(log(), torque=currents)
    cause = cause_of("torque a motor current in A", "units of torque")
    checked(monkeypatch, cause, log())
    fit = fit_torque(ARM.dynamics, wrong, band=20.0, least_speed=0.1)
    assert fit.causes == (cause,)
    assert fit.warnings[0] == cause.line
    assert fit_torque(ARM.dynamics, log(), band=20.0, least_speed=0.1).causes == ()


def test_what_the_equation_of_motion_explains_better_comes_before_the_checkup(monkeypatch):
    wrong = turned(log().cut(0.0, 1.4), "torque")
    halved = dataclasses.replace(wrong, torque=wrong.torque / 2)
    checked(monkeypatch, cause_of("torque scale", "units of torque"), halved)
    fit = fit_torque(ARM.dynamics, wrong, band=20.0, least_speed=0.1)
    assert [cause.name for cause in fit.causes] == ["torque sign"]


@pytest.mark.parametrize(
    ("columns", "name"),
    [
        (("torque",), "turned torque"),
        (("error_pulses", "reference_pulses"), "turned counts and reference"),
    ],
)
def test_an_arm_tells_a_turned_torque_from_a_turned_axis(monkeypatch, columns, name):
    """Alone the log tells one of the two, and the other as its rival."""
    wrong = turned(log(), *columns)
    rows = [row for row in TABLE if row.name == "turned torque"]
    alone = SelectionSettings(causes=1)
    (told,) = ranking(Experiment(wrong), Trials(rows), ("1", "2"), alone).causes
    rival = Rival("turned counts and reference", (1,), 1.0, told.log_odds - 1)
    checked(monkeypatch, dataclasses.replace(told, rivals=(rival,)), turned(wrong, "torque"))
    cause, *others = checkup_of(wrong, ARM.dynamics).causes
    assert (cause.name, cause.joints, cause.rivals) == (name, (1,), ())
    assert wrong_statements(ARM.dynamics, wrong)[:1] == (cause.line,)

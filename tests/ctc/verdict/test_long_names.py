"""Tables of six joints with long names: every cell apart, every row of one length, every label in full."""

import dataclasses
import re
from functools import cache

import numpy as np
import pytest

from ctc import Comparison, ComputedTorque, LowestResonance, certify, evaluate, margins
from ctc.verdict.table import aligned, by_joint
from plant import Dynamics, Harmonics, catalogue, p_gains

NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
LABELS = [f"{name} (q[{i}])" for i, name in enumerate(NAMES)]
NUMBER = r"-?\d[\d.,e+-]*( ?%| Hz|°)?"


@cache
def robot():
    chain = catalogue.puma560()
    links = tuple(dataclasses.replace(link, name=name) for link, name in zip(chain.links, NAMES, strict=True))
    dynamics, rig = Dynamics.from_chain(dataclasses.replace(chain, links=links)), catalogue.puma560_rig()
    q = (0.0, -0.4, 0.3, 0.2, 0.5, 0.1)
    path = Harmonics(period=4.0, offset=q, cosine=((0.1,),) * 6, sine=((0.1,),) * 6)
    return dynamics.arm(dynamics.f()), rig, path


@cache
def p_law():
    return p_gains(*robot(), 12.0)


@cache
def evaluation():
    arm, rig, path = robot()
    return evaluate(arm, rig, p_law(), path, backend="numba", duration=0.2, steps_per_sample=8)


def cells(line):
    return re.split(r"\s{2,}", line.strip())


def test_columns_are_as_wide_as_their_cells():
    assert aligned([("a", "long title"), ("longer", "1")]) == ["a       long title", "longer           1"]
    few = by_joint(["joint 2 (q[0])", "joint 3 (q[1])"], [("torque, peak [N m]", "1", "22")])
    assert few == [
        "                    joint 2 (q[0])  joint 3 (q[1])",
        "torque, peak [N m]               1              22",
    ]
    many = by_joint(LABELS, [("torque chatter per sample [N m]", *"123456")])
    assert [line.split() for line in many[:3]] == [["torque", "chatter"], ["per", "sample"], ["[N", "m]"]]
    assert [cells(line) for line in many[3:]] == [[label, str(i + 1)] for i, label in enumerate(LABELS)]


@pytest.mark.parametrize("table", ["evaluation", "margins", "certificate"])
def test_six_long_names_have_a_row_each(table, monkeypatch):
    arm, rig, path = robot()
    gears = LowestResonance(hz=60.0, damping_ratio=0.01, within=1)
    monkeypatch.setattr("ctc.certification.certificate.lowest_resonance", lambda *_, **__: gears)
    drawn = {"covariance": np.diag((0.02 * arm.f) ** 2), "samples": 8, "duration": 0.02, "steps_per_sample": 8}
    text = str({
        "evaluation": evaluation,
        "margins": lambda: margins(arm, rig, ComputedTorque(arm, rig, bandwidth=60)),
        "certificate": lambda: certify(arm, rig, p_law(), path, **drawn),
    }[table]())  # fmt: skip
    rows = [line for line in text.splitlines() if line.startswith(NAMES)]
    assert [cells(row)[0] for row in rows] == LABELS
    assert len(set(map(len, rows))) == 1
    for row in rows:
        numbers = cells(row)[1:]
        assert len(numbers) == len(cells(rows[0])) - 1 > 4
        assert all(re.fullmatch(NUMBER, cell) for cell in numbers if "samples" not in cell), row
    assert max(map(len, text.splitlines())) <= 130


def test_a_comparison_of_six_joints_has_the_largest_and_says_whose():
    head, row, *labels, _ = str(Comparison(evaluations={"P": evaluation()}, diverged={})).splitlines()
    assert len(head) == len(row)
    peak, rms = evaluation().max_error_pulses, evaluation().rms_error_pulses
    assert cells(row)[2] == f"{peak.max():.0f} q[{peak.argmax()}]"
    assert cells(row)[3] == f"{rms.max():.2f} q[{rms.argmax()}]"
    assert " ".join(labels) == f"largest of the joints, and which: {', '.join(LABELS)}"


def test_figures_have_the_labels_of_the_tables():
    import matplotlib

    matplotlib.use("Agg")
    axes = evaluation().plot().axes
    assert [axis.get_ylabel().splitlines()[0] for axis in axes[::2]] == LABELS
    matplotlib.pyplot.close("all")

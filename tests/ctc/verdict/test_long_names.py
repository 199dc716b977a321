"""Tables of six joints with long names: every cell apart, every row of one length, every label
in full.
"""

import dataclasses
import re
from functools import cache

import numpy as np
import pytest
from uncertain import with_uncertainty

from ctc import ComputedTorque, certify, evaluate, margins
from ctc.verdict import Comparison, LowestResonance
from plant import Dynamics, Harmonics, p_gains, read_robot

NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
LABELS = [f"{name} (q[{i}])" for i, name in enumerate(NAMES)]
NUMBER = r"-?\d[\d.,e+-]*( ?%| Hz|°)?"


@cache
def robot():
    robot = read_robot("puma560")
    chain = robot.dynamics.chain
    links = tuple(
        dataclasses.replace(link, name=name) for link, name in zip(chain.links, NAMES, strict=True)
    )
    dynamics, rig = Dynamics.from_chain(dataclasses.replace(chain, links=links)), robot.rig
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


@pytest.mark.parametrize(
    "table", ["evaluation", pytest.param("margins", marks=pytest.mark.slow), "certificate"]
)
def test_six_long_names_have_a_row_each(table, monkeypatch):
    arm, rig, path = robot()
    gears = LowestResonance(hz=60.0, damping_ratio=0.01, within=1)
    monkeypatch.setattr("ctc.certification.certificate.lowest_resonance", lambda *_, **__: gears)
    drawn = {
        "covariance": np.diag((0.02 * arm.f) ** 2),
        "samples": 8,
        "duration": 0.02,
        "steps_per_sample": 8,
    }
    text = str({
        "evaluation": evaluation,
        "margins": lambda: margins(arm, rig, ComputedTorque(arm, rig, bandwidth=60)),
        "certificate": lambda: certify(arm, rig, p_law(), path, **with_uncertainty(**drawn)),
    }[table]())  # fmt: skip
    rows = [line for line in text.splitlines() if line.startswith(NAMES)]
    assert [cells(row)[0] for row in rows] == 2 * LABELS  # some of the columns below the others
    for part in (rows[i : i + 6] for i in range(0, len(rows), 6)):
        assert len(set(map(len, part))) == 1
        for row in part:
            numbers = cells(row)[1:]
            assert 1 <= len(numbers) <= 4
            assert all(re.fullmatch(NUMBER, cell) for cell in numbers if "samples" not in cell), row
    assert max(map(len, text.splitlines())) <= 80


def test_a_comparison_of_six_joints_has_the_largest_and_says_whose():
    verdict, *_, row, first, second, third, _, _ = str(
        Comparison(evaluations={"P": evaluation()}, diverged={})
    ).splitlines()
    assert verdict.startswith("0 of 1 controllers within")
    peak, rms = evaluation().max_error_pulses, evaluation().rms_error_pulses
    assert cells(row)[2] == f"{peak.max():.0f} q[{peak.argmax()}]"
    assert cells(row)[3] == f"{rms.max():.2f} q[{rms.argmax()}]"
    assert (
        " ".join(f"{first} {second} {third}".split())
        == f"largest of the joints, and which: {', '.join(LABELS)}"
    )


def test_figures_have_the_labels_of_the_tables():
    import matplotlib

    matplotlib.use("Agg")
    axes = evaluation().plot()
    assert [axis.get_title(loc="left").splitlines()[-1] for axis in axes[:, 0]] == LABELS
    matplotlib.pyplot.close("all")
